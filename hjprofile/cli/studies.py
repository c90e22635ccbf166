"""The commands for studies: check, chart, stability, dependence, statements."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

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
    from hjprofile.output.store import Written
    from hjprofile.studies.chart import Point, Reference


@app.command
def check(*case: CasePath, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Test the Hamilton-Jacobi equation against the conservation law on one or several cases.

    Writes check.json. A case passes, fails, or is not resolved on these grids. If a comparison fails, the exit code is
    1.
    """
    from hjprofile.output.store import to_json
    from hjprofile.studies.consistency import check as check_case
    from hjprofile.studies.verdict import verdict_of_all

    require_cases("check", case)
    folder, loaded = load_cases(case, out)
    folder.open()
    verdicts = []
    for one in loaded:
        with Progress(f"checking {one.name}", not quiet) as progress:
            verdicts.append(check_case(one, progress))
    failed = [v.case for v in verdicts if not v.passes]
    report = {"passes": not failed, "verdict": verdict_of_all(verdicts), "cases": [v.report() for v in verdicts]}
    files = folder.write({"check.json": to_json(report)})
    say(quiet or json, "\n".join([*map(str, verdicts), f"written to {files[0]}"]))
    answer(json, report | {"files": files})
    if failed:
        raise RunError(
            f"the consistency test fails on {', '.join(failed)}; the lines marked FAILS name the comparisons"
        )


@app.command
def chart(*case: CasePath, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Measure the error of every method against its run time in seconds, on one or several cases.

    Writes chart.csv and chart.png.
    """
    from hjprofile.output.plots.study_pictures import chart_picture
    from hjprofile.output.store import to_csv, write_study
    from hjprofile.studies.chart import Point, pareto
    from hjprofile.studies.chart import chart as chart_case

    require_cases("chart", case)
    folder, loaded = load_cases(case, out)
    folder.open()
    charts, reports, lines = {}, [], []
    for one in loaded:
        with Progress(f"charting {one.name}", not quiet) as progress:
            charts[one.name] = points, reference = chart_case(one.name, one.problem, one.grid, one.cfl, progress)
        known = f" (errors of u {reference.error:.1g}, of q {reference.error_q:.1g})" if reference.error else ""
        best = pareto(points)
        head = f"{one.name}: {len(points)} runs; reference: {reference.name}{known}. Pareto front of seconds and error:"
        lines += [head, *(_point(p, reference) for p in best)]
        known_to = {"reference_error": reference.error, "reference_error_q": reference.error_q}
        found = {"case": one.name, "reference": reference.name} | known_to
        reports.append(found | {"points": [p._asdict() for p in points], "pareto": [p._asdict() for p in best]})
    table = to_csv(Point._fields, [p for points, _ in charts.values() for p in points])
    written = write_study(folder, {"chart.csv": table}, {"chart.png": partial(chart_picture, charts)})
    say(quiet or json, "\n".join([*lines, _written(folder, written)]))
    answer(json, {"cases": reports, "files": written.files})


@app.command
def stability(case: CasePath, /, *, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Scan the limits of stability of each method on a grid, on one case.

    Writes stability.csv and stability.png.
    """
    from hjprofile.output.plots.study_pictures import stability_picture
    from hjprofile.output.store import to_csv, write_study
    from hjprofile.studies.stability import Trial
    from hjprofile.studies.stability import stability as scan

    folder, (loaded,) = load_cases((case,), out)
    folder.open()
    with Progress(f"scanning {loaded.name}", not quiet) as progress:
        found = scan(loaded, progress)
    limits = {m: {"holds_at": low, "fails_at": high, "theory": p} for m, (low, high, p) in found.limits.items()}
    table = to_csv(Trial._fields[:6], [t[:6] for t in found.rows])
    written = write_study(folder, {"stability.csv": table}, {"stability.png": partial(stability_picture, found.rows)})
    say(quiet or json, f"{found}\n{_written(folder, written)}")
    answer(
        json,
        {"case": loaded.name, "limits": limits, "trials": [t._asdict() for t in found.rows]} | {"files": written.files},
    )


@app.command
def dependence(case: CasePath, /, *, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Measure the distance between solutions with close initial data or close coefficients, on one case.

    Writes dependence.csv and dependence.png. The exit code is 1 if a distance exceeds its bound.
    """
    from hjprofile.output.plots.study_pictures import dependence_picture
    from hjprofile.output.store import to_csv, write_study
    from hjprofile.studies.dependence import Distance
    from hjprofile.studies.dependence import dependence as study

    folder, (loaded,) = load_cases((case,), out)
    folder.open()
    with Progress(f"measuring {loaded.name}", not quiet) as progress:
        found = study(loaded.problem, loaded.grid, progress, loaded.name)
    table = to_csv(Distance._fields, found.rows)
    pictures = {"dependence.png": partial(dependence_picture, found.rows)}
    written = write_study(folder, {"dependence.csv": table}, pictures)
    say(quiet or json, "\n  ".join([f"{loaded.name}:", *found.found]))
    say(quiet or json, _written(folder, written))
    answer(
        json,
        {"case": loaded.name, "passes": found.holds, "found": found.found, "files": written.files},
    )
    if not found.holds:
        raise RunError(f"{loaded.source}: {found.violated}")


@app.command
def statements(case: CasePath, /, *, out: Out = None, quiet: Quiet = False, json: Json = False) -> None:
    """Evaluate the statements of the source paper, with computed constants, on one case.

    Writes statements.csv, characteristics.csv, statements.png and invariant.png. The exit code is 1 if a statement is
    violated.
    """
    from hjprofile.output.plots.statement_pictures import invariant_picture, statements_picture
    from hjprofile.output.store import to_csv, write_study
    from hjprofile.output.survey_columns import with_survey_columns
    from hjprofile.problem.grid import Grid
    from hjprofile.studies.characteristic_statements import COLUMNS
    from hjprofile.studies.statements import CELLS, StatementRow
    from hjprofile.studies.statements import statements as study

    folder, (loaded,) = load_cases((case,), out)
    folder.open()
    grid = Grid(loaded.grid.left, min(loaded.grid.cells, CELLS), loaded.grid.right)
    with Progress(f"evaluating {loaded.name}", not quiet) as progress:
        found = study(loaded.problem, grid, progress)
    units = loaded.problem.profile.units
    tables = {
        "statements.csv": to_csv(*with_survey_columns(StatementRow._fields, found.rows, units)),
        "characteristics.csv": to_csv(*with_survey_columns(COLUMNS, found.characteristics.rows(), units)),
    }
    invariant = partial(invariant_picture, loaded.name, found.characteristics)
    pictures = {
        "statements.png": partial(statements_picture, loaded.name, found),
        "invariant.png": invariant if found["invariant"].applies else None,
    }
    written = write_study(folder, tables, pictures)
    failed = [result.equation for result in found.results if not result.holds]
    head = f"{loaded.name}, {grid.cells} cells: value / bound where the value is largest relative to its bound"
    say(quiet or json, "\n  ".join([head, *map(str, found.results)]))
    say(quiet or json, _written(folder, written))
    answer(
        json,
        {"case": loaded.name, "passes": not failed, "statements": [v._asdict() for v in found.results]}
        | {"files": written.files},
    )
    if failed:
        raise RunError(f"{loaded.source}: violated statements: {', '.join(failed)}")


def _written(folder: ResultFolder, written: Written) -> str:
    """Return the last line of an account, after a warning if the picture could not be drawn."""
    lines = [f"WARNING: {warning}" for warning in written.warnings]
    return "\n".join([*lines, f"written to {folder}: {listing(folder.path, written.files)}"])


def _point(p: Point, reference: Reference) -> str:
    """Return a line of the account, with `<` before an error that is not above the error of the reference."""
    q = f"{'<' * bool(p.error_q_l1 <= reference.error_q):>1}{p.error_q_l1:7.1e}"
    u = f"{'<' * bool(p.error_u_sup <= reference.error):>1}{p.error_u_sup:7.1e}"
    return f"  {p.method:22} {p.cells:6}  {q} of q  {u} of u  {p.seconds:.2g} s"
