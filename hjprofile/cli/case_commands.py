"""The commands on case files and on methods: validate, new, methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hjprofile.cli.common import CasePath, Json, Quiet, answer, app, expanded, require_cases, say
from hjprofile.errors import InputError

NewName = Annotated[Path, Parameter(converter=expanded, help="Name of the case; its file is NAME with .toml.")]


@app.command
def validate(*case: CasePath, quiet: Quiet = False, json: Json = False) -> None:
    """Check one or several cases without solving them, and report all faults of all files."""
    from hjprofile.problem.case import load_case
    from hjprofile.solvers.solve import check_case

    require_cases("validate", case)
    found: list[InputError] = []
    reports: list[dict[str, Any]] = []
    for name in case:
        faults: tuple[InputError, ...] = ()
        try:
            loaded = load_case(name)
            check_case(loaded)
        except InputError as error:
            faults = error.faults
        else:
            solved = f"{loaded.method}, {loaded.grid.cells} cells, to t = {loaded.problem.end:g}"
            say(quiet or json, f"{name}: valid ({solved})")
        found += faults
        listed = [{"message": " ".join(str(fault).split()), "about": fault.about} for fault in faults]
        reports.append({"case": str(name), "valid": not faults, "faults": listed})
    answer(json, {"valid": not found, "cases": reports})
    if found:
        raise InputError.of(found)


@app.command
def new(name: NewName, /, *, json: Json = False) -> None:
    """Write a case file with comments, which runs and is a start for a case of your own. No file is replaced."""
    from hjprofile.problem.new_case import new_case

    path = new_case(name)
    say(json, f"written: {path}\nnext: hjprofile run {path}")
    answer(json, {"case": str(path)})


@app.command
def methods(*, json: Json = False) -> None:
    """List the methods with their unknown, their order, their proved CFL number and the problems that they support."""
    from hjprofile.solvers.method_table import methods as table

    rows = table()
    say(json, repr(rows))
    answer(json, {"methods": [row._asdict() for row in rows]})
