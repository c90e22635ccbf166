"""Commands that ask whether it is right: check, chart, stability, dependence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hjprofile.cli.common import CasePath, Json, Out, Progress, answer, app, load_cases, say
from hjprofile.errors import InputError, RunError

if TYPE_CHECKING:
    from hjprofile.evidence.chart import Point


@app.command
def check(*case: CasePath, out: Out = None, json: Json = False) -> None:
    """Test the Hamilton-Jacobi equation against the conservation law on one case or several.

    Writes check.json; ends with exit code 1 if a comparison fails.
    """
    from hjprofile.evidence.consistency import check as check_case
    from hjprofile.files import write_whole
    from hjprofile.output.store import open_folder, to_json

    if not case:
        raise InputError("check needs at least one CASE: a TOML file or the name of a shipped case", "the-command-line")
    folder, loaded = load_cases(case, out)
    open_folder(folder)
    verdicts = []
    for one in loaded:
        with Progress(f"checking {one.name}") as progress:
            verdicts.append(check_case(one, progress))
        say(json, str(verdicts[-1]))
    failed = [v.case for v in verdicts if not v.passes]
    report = {"passes": not failed, "cases": [v.report() for v in verdicts]}
    write_whole(folder / "check.json", to_json(report))
    say(json, f"written to {folder / 'check.json'}")
    answer(json, report | {"files": [folder / "check.json"]})
    if failed:
        raise RunError(f"the consistency test fails on {', '.join(failed)}; lines marked FAILS above say where")


@app.command
def chart(*case: CasePath, out: Out = None, json: Json = False) -> None:
    """Chart the accuracy of every method against its seconds, on one case or several.

    Writes chart.csv and chart.png.
    """
    from hjprofile.evidence.chart import Point, pareto
    from hjprofile.evidence.chart import chart as chart_case
    from hjprofile.files import write_whole
    from hjprofile.output.plots.studies import chart_picture
    from hjprofile.output.store import open_folder, to_csv

    if not case:
        raise InputError("chart needs at least one CASE: a TOML file or the name of a shipped case", "the-command-line")
    folder, loaded = load_cases(case, out)
    open_folder(folder)
    charts, reports = {}, []
    for one in loaded:
        with Progress(f"charting {one.name}") as progress:
            charts[one.name] = points, reference = chart_case(one.name, one.problem, one.grid, one.cfl, progress)
        known = f" (u to {reference.error:.1g})" if reference.error else ""
        best = pareto(points)
        head = f"{one.name}: {len(points)} runs against {reference.name}{known}. None beats in seconds and in error:"
        say(json, "\n".join([head, *map(_point, best)]))
        found = {"case": one.name, "reference": reference.name, "reference_error": reference.error}
        reports.append(found | {"points": [p._asdict() for p in points], "pareto": [p._asdict() for p in best]})
    write_whole(folder / "chart.csv", to_csv(Point._fields, [p for points, _ in charts.values() for p in points]))
    write_whole(folder / "chart.png", chart_picture(charts))
    say(json, f"written to {folder}: chart.csv, chart.png")
    answer(json, {"cases": reports} | {"files": [folder / "chart.csv", folder / "chart.png"]})


@app.command
def stability(case: CasePath, /, *, out: Out = None, json: Json = False) -> None:
    """Scan where each method on a grid holds and where it fails, on one case.

    Writes stability.csv and stability.png.
    """
    from hjprofile.evidence.stability import Trial, measured_limit
    from hjprofile.evidence.stability import stability as scan
    from hjprofile.files import write_whole
    from hjprofile.output.plots.studies import stability_picture
    from hjprofile.output.store import open_folder, to_csv

    folder, (loaded,) = load_cases((case,), out)
    open_folder(folder)
    with Progress(f"trying {loaded.name}") as progress:
        trials = scan(loaded.name, loaded.problem, loaded.grid, progress)
    say(json, f"{loaded.name}: {len(trials)} trials. CFL number up to which a method holds (by theory):")
    limits = {}
    for method, theory in {t.method: t.theory for t in trials if t.parameter == "cfl"}.items():
        low, high = measured_limit(trials, method)
        limits[method] = {"holds_at": low, "fails_at": high, "theory": theory}
        limit = f"{low:.4g} to {high:.4g}" if high < float("inf") else f"all up to {low:.4g}"
        say(json, f"  {method:22} {limit:18} ({theory:.4g})")
    write_whole(folder / "stability.csv", to_csv(Trial._fields[:-1], [t[:-1] for t in trials]))
    write_whole(folder / "stability.png", stability_picture(trials))
    say(json, f"written to {folder}: stability.csv, stability.png")
    answer(
        json,
        {"case": loaded.name, "limits": limits, "trials": [t._asdict() for t in trials]}
        | {"files": [folder / "stability.csv", folder / "stability.png"]},
    )


@app.command
def dependence(case: CasePath, /, *, out: Out = None, json: Json = False) -> None:
    """Follow how far solutions come apart that begin close together, or erode by close coefficients, on one case.

    Writes dependence.csv and dependence.png; ends with exit code 1 if a distance exceeds its bound.
    """
    from hjprofile.evidence.dependence import Distance, summary
    from hjprofile.evidence.dependence import dependence as study
    from hjprofile.files import write_whole
    from hjprofile.output.plots.studies import dependence_picture
    from hjprofile.output.store import open_folder, to_csv

    folder, (loaded,) = load_cases((case,), out)
    open_folder(folder)
    with Progress(f"disturbing {loaded.name}") as progress:
        distances = study(loaded.name, loaded.problem, loaded.grid, progress)
    sentences, failed = summary(distances)
    say(json, "\n  ".join([f"{loaded.name}:", *sentences]))
    write_whole(folder / "dependence.csv", to_csv(Distance._fields, distances))
    write_whole(folder / "dependence.png", dependence_picture(distances))
    say(json, f"written to {folder}: dependence.csv, dependence.png")
    answer(
        json,
        {"case": loaded.name, "passes": not failed, "found": sentences}
        | {"files": [folder / "dependence.csv", folder / "dependence.png"]},
    )
    if failed:
        raise RunError(f"{loaded.source}: {failed}")


def _point(p: Point) -> str:
    errors = f"{p.error_q_l1:8.1e} of q  {p.error_u_sup:8.1e} of u"
    return f"  {p.method:22} {p.cells:6}  {errors}  {p.seconds:.2g} s"
