"""The command that solves cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from hjprofile.cli.common import (
    CasePath,
    Cells,
    Cfl,
    End,
    Json,
    Method,
    NoPlots,
    NoVtk,
    Out,
    Progress,
    Quiet,
    Resume,
    Set,
    Strict,
    Tolerance,
    answer,
    app,
    case_folders,
    folder_for,
    listing,
    require_cases,
    say,
)  # fmt: skip
from hjprofile.cli.messages import FAILURES, report
from hjprofile.errors import RunError


class _Options(NamedTuple):
    """The options of all cases of a command.

    Attributes:
        values: values that replace those of the case, by dotted key.
        strict: True to stop a run that violates a bound.
        resume: True to continue from a checkpoint.
        quiet: True to print no account.
        bar: True to show progress.
    """

    values: dict[str, Any]
    strict: bool
    resume: bool
    quiet: bool
    bar: bool


@app.command
def run(
    *case: CasePath,
    method: Method = None,
    cells: Cells = None,
    cfl: Cfl = None,
    tolerance: Tolerance = None,
    end: End = None,
    set_: Set = (),
    strict: Strict = False,
    resume: Resume = False,
    no_vtk: NoVtk = False,
    no_plots: NoPlots = False,
    out: Out = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Solve one or several cases, and write a result folder for each.

    If a case fails, the others are solved all the same, and the exit code is the largest one of all.
    """
    from hjprofile.problem.case_files import read_values

    require_cases("run", case)
    if tolerance is not None and method is None:
        method = "auto"
    options = {
        "solver.method": method, "solver.cfl": cfl, "solver.tolerance": tolerance, "domain.cells": cells,
        "time.end": end, "output.vtk": False if no_vtk else None, "output.plots": False if no_plots else None,
    }  # fmt: skip
    given = {key: value for key, value in options.items() if value is not None}
    asked = _Options(read_values(set_, given), strict, resume, json or quiet, not quiet)
    if len(case) == 1:
        document, stopped = _solve(case[0], out, asked, "solving")
        answer(json, document)
        if stopped:
            raise stopped
        return 0
    documents, worst, stopped = [], 0, None
    for i, (name, path) in enumerate(case_folders(case, out).items(), start=1):
        say(asked.quiet or i == 1, "")
        try:
            document, stopped = _solve(name, path, asked, f"solving {name.stem} ({i} of {len(case)})")
            documents.append({"case": str(name)} | document)
            if stopped:
                raise stopped
        except FAILURES as error:
            if isinstance(error, BrokenPipeError) or getattr(error, "about", "") == "interrupted":
                raise
            worst = max(worst, report(error, "run"))
            if error is not stopped:
                documents.append({"case": str(name), "error": str(error)})
    answer(json, {"cases": documents})
    return worst


def _solve(name: Path, path: Path | None, asked: _Options, label: str) -> tuple[dict[str, Any], RunError | None]:
    """Solve a case and write its result folder. Return the document, and an error if the run has stopped early."""
    from hjprofile.output.checkpoint import NAME, Checkpoint
    from hjprofile.output.run_account import run_account
    from hjprofile.output.store import check_memory, summary, write_results
    from hjprofile.output.workers import drawing_helper
    from hjprofile.problem.case import load_case

    loaded = load_case(name, asked.values)
    folder = folder_for((name,), path, NAME if asked.resume else "", asked.values)
    with drawing_helper(loaded.plots) as helper:
        from hjprofile.solvers.solve import check_case, solve_and_keep

        check_case(loaded)
        check_memory(loaded)
        folder.open()
        checkpoint = Checkpoint(folder.path, loaded.checkpoint, asked.resume, folder.claim)
        with Progress(label, asked.bar) as progress:
            result = solve_and_keep(loaded, checkpoint, progress, asked.strict)
        result, files = write_results(result, folder, loaded.vtk, loaded.plots, helper)
        checkpoint.discard()
    say(asked.quiet, run_account(result))
    if checkpoint.resumed_at is not None:
        say(asked.quiet, f"  resumed     from the checkpoint at t = {checkpoint.resumed_at:.6g}")
    elif asked.resume:
        say(asked.quiet, "  resumed     no: there is no checkpoint, so the run started at t = 0")
    say(asked.quiet, f"  written     {folder}: {listing(folder.path, files)}")
    stopped = None
    if not result.done:
        stopped = RunError(f"{loaded.source}: {result.status.rstrip('.')}; the last good state is in {folder}")
    return summary(result) | {"resumed_at": checkpoint.resumed_at, "files": files}, stopped
