"""The commands for studies: check, chart, stability, dependence, statements."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hjprofile.cli.common import (
    CasePath,
    Json,
    Out,
    Progress,
    Quiet,
    answer,
    app,
    listing,
    load_cases,
    require_cases,
    say,
)
from hjprofile.errors import RunError

if TYPE_CHECKING:
    from hjprofile.output.folder import ResultFolder
    from hjprofile.output.study_files import Study


@app.command
def check(*case: CasePath, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Test the Hamilton-Jacobi equation against the conservation law on one or several cases.

    Writes check.json. A case passes, fails, or is not resolved on these grids. If a comparison fails, the exit code is
    1.
    """
    from hjprofile.output.study_files import check_report
    from hjprofile.studies.consistency import check as check_case

    require_cases("check", case)
    folder, loaded = load_cases(case, out)
    folder.open()
    verdicts = []
    for one in loaded:
        with Progress(f"checking {one.name}", not quiet) as progress:
            verdicts.append(check_case(one, progress))
    _write(folder, verdicts, "\n".join(map(str, verdicts)), check_report(verdicts), quiet, json)
    failed = [v.case for v in verdicts if not v.passes]
    if failed:
        raise RunError(
            f"the consistency test fails on {', '.join(failed)}; the lines marked FAILS name the comparisons"
        )


@app.command
def chart(*case: CasePath, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Measure the error of every method against its run time in seconds, on one or several cases.

    Writes chart.csv and chart.png.
    """
    from hjprofile.studies.chart import chart as chart_case

    require_cases("chart", case)
    folder, loaded = load_cases(case, out)
    folder.open()
    charts = []
    for one in loaded:
        with Progress(f"charting {one.name}", not quiet) as progress:
            charts.append(chart_case(one, progress))
    _write(folder, charts, "\n".join(map(str, charts)), {"cases": [c.report() for c in charts]}, quiet, json)


@app.command
def stability(case: CasePath, /, *, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Scan the limits of stability of each method on a grid, on one case.

    Writes stability.csv and stability.png.
    """
    from hjprofile.studies.stability import stability as scan

    folder, (loaded,) = load_cases((case,), out)
    folder.open()
    with Progress(f"scanning {loaded.name}", not quiet) as progress:
        found = scan(loaded, progress)
    limits = {m: {"holds_at": low, "fails_at": high, "theory": p} for m, (low, high, p) in found.limits.items()}
    document = {"case": found.case, "limits": limits, "trials": [t._asdict() for t in found.rows]}
    _write(folder, found, str(found), document, quiet, json)


@app.command
def dependence(case: CasePath, /, *, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Measure the distance between solutions with close initial data or close coefficients, on one case.

    Writes dependence.csv and dependence.png. The exit code is 1 if a distance exceeds its bound.
    """
    from hjprofile.studies.dependence import dependence as study

    folder, (loaded,) = load_cases((case,), out)
    folder.open()
    with Progress(f"measuring {loaded.name}", not quiet) as progress:
        found = study(loaded.problem, loaded.grid, progress, loaded.name)
    document = {"case": found.case, "passes": found.holds, "found": found.found}
    _write(folder, found, "\n  ".join([f"{found.case}:", *found.found]), document, quiet, json)
    if not found.holds:
        raise RunError(f"{loaded.source}: {found.violated}")


@app.command
def statements(case: CasePath, /, *, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Evaluate the statements of the source paper, with computed constants, on one case.

    Writes statements.csv, characteristics.csv, statements.png and invariant.png. The exit code is 1 if a statement is
    violated.
    """
    from hjprofile.problem.grid import Grid
    from hjprofile.studies.statements import CELLS
    from hjprofile.studies.statements import statements as study

    folder, (loaded,) = load_cases((case,), out)
    folder.open()
    grid = Grid(loaded.grid.left, min(loaded.grid.cells, CELLS), loaded.grid.right)
    with Progress(f"evaluating {loaded.name}", not quiet) as progress:
        found = study(loaded.problem, grid, progress, loaded.name)
    head = f"{found.case}, {grid.cells} cells: value / bound where the value is largest relative to its bound"
    document = {"case": found.case, "passes": found.holds, "statements": [v._asdict() for v in found.results]}
    _write(folder, found, "\n  ".join([head, *map(str, found.results)]), document, quiet, json)
    if not found.holds:
        failed = ", ".join(result.equation for result in found.results if not result.holds)
        raise RunError(f"{loaded.source}: violated statements: {failed}")


def _write(
    folder: ResultFolder, study: Study | list, account: str, document: Mapping[str, Any], quiet: bool, json: bool
) -> None:
    """Write the files of a study. Then print its account and the files, or the document."""
    from hjprofile.output.study_files import study_files, write_files

    written = write_files(folder, study_files(study))
    lines = [f"WARNING: {warning}" for warning in written.warnings]
    files = f"written to {folder}: {listing(folder.path, written.files)}"
    say(quiet or json, "\n".join([account, *lines, files]))
    answer(json, {**document, "files": written.files})
