"""The command line: one function a command; each parses, calls the library and says what came of it."""

from __future__ import annotations

import gc
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import App, CycloptsError, Parameter

import hjprofile
from hjprofile.errors import InputError, RunError

if TYPE_CHECKING:
    from hjprofile.evidence.consistency import Check
    from hjprofile.problem.case import Case
    from hjprofile.solvers.run import Run

app = App(
    name="hjprofile",
    version=hjprofile.__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,  # `main` has a sentence for it
    help="Slow erosion of granular slopes: a nonlocal Hamilton-Jacobi equation and its cross-checks.",
)


def _whole(_: Any, tokens: Any) -> int:
    """cyclopts would round 60.7 cells to 61."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value[:40]!r} is not a whole number") from None


Cells = Annotated[int | None, Parameter(converter=_whole, help="Number of grid cells, instead of the case's.")]
Method = Annotated[str | None, Parameter(help="Solver method, instead of the case's; a wrong name lists them all.")]
Cfl = Annotated[float | None, Parameter(help="Time step as a part of the largest monotone one.")]
Tolerance = Annotated[float | None, Parameter(help="Largest error of u; takes the method auto if none is named.")]
End = Annotated[float | None, Parameter(help="Mass of grains poured in at which the run ends.")]
Resume = Annotated[bool, Parameter(negative="", help="Go on from the checkpoint in the folder for the results.")]
Strict = Annotated[bool, Parameter(negative="", help="Stop, as a failure, where a bound is broken.")]
Fitted = Annotated[list[str], Parameter(help="A parameter to fit by its key, as in time.end; once for each.")]
Sigma = Annotated[float | None, Parameter(help="Standard deviation of a measured height; else from the residuals.")]
Out = Annotated[Path | None, Parameter(help="Folder for the results; results/<case name> by default.")]
Into = Annotated[Path | None, Parameter(help="Folder for the files; the result's own by default.")]

Vary = Annotated[
    list[str], Parameter(negative="", help="A key of the case and its values: erosion.m=0.5,1,2. May be repeated.")
]
Workers = Annotated[
    int | None, Parameter(converter=_whole, help="Number of processes; one for each processor by default.")
]
Kept = Annotated[bool, Parameter(negative="", help="Do not run again what is done in the folder for the results.")]


@app.command
def run(
    case: str,
    /,
    *,
    method: Method = None,
    cells: Cells = None,
    cfl: Cfl = None,
    tolerance: Tolerance = None,
    end: End = None,
    strict: Strict = False,
    resume: Resume = False,
    out: Out = None,
) -> None:
    """Solve a case and write its result folder.

    CASE is a TOML file, or the name of a case that comes with the package (`hjprofile cases` lists them).
    """
    from hjprofile.output.checkpoint import Checkpoint
    from hjprofile.output.store import open_folder, write_run
    from hjprofile.output.workers import drawing_helper
    from hjprofile.problem.case import load_case

    if tolerance is not None and method is None:
        method = "auto"
    solver = {"solver.method": method, "solver.cfl": cfl, "solver.tolerance": tolerance}
    asked = solver | {"domain.cells": cells, "time.end": end}
    loaded = load_case(case, {key: value for key, value in asked.items() if value is not None})
    folder = out or Path("results") / loaded.name
    with drawing_helper(loaded.plots) as helper:
        from hjprofile.solvers.methods import check_method, solve_case

        check_method(loaded)
        open_folder(folder)
        checkpoint = Checkpoint(folder, loaded.checkpoint, resume)
        with _Progress("eroding") as progress:
            result = solve_case(loaded, progress, strict, checkpoint)
        files = write_run(result, folder, loaded.vtk, loaded.plots, helper)
        checkpoint.discard()
    print(_account(result))
    if checkpoint.resumed_at is not None:
        print(f"  resumed     from the checkpoint at t = {checkpoint.resumed_at:.6g}")
    elif resume:
        print("  resumed     not: there was no checkpoint, so from the start")
    print(f"  written     {folder}: {_listing(folder, files)}")
    if not result.done:
        raise RunError(f"{loaded.source}: {result.status}; the last good state is in {folder}")


@app.command
def check(*case: str, out: Out = None) -> None:
    """Test the Hamilton-Jacobi equation against the conservation law on one case or several.

    Writes check.json; ends with exit code 1 if a comparison fails.
    """
    from hjprofile.evidence.consistency import check_consistency
    from hjprofile.output.store import open_folder, to_json, write_whole

    if not case:
        raise InputError("check needs at least one CASE: a TOML file or the name of a shipped case")
    folder, loaded = _cases(case, out)
    open_folder(folder)
    verdicts: list[dict[str, Any]] = []
    for one in loaded:
        with _Progress(f"checking {one.name}") as progress:
            checks = check_consistency(one.problem, one.grid, one.cfl, progress, one.refresh)
        passes = all(c.passes for c in checks)
        verdicts.append({"case": one.name, "title": one.problem.title, "passes": passes} | {
            "comparisons": [c._asdict() for c in checks]
        })  # fmt: skip
        print(f"{one.name}: {'passes' if passes else 'FAILS'}")
        print("\n".join(f"  {_check_line(c)}" for c in checks if not c.name.startswith("bounds:") or not c.passes))
    failed = [v["case"] for v in verdicts if not v["passes"]]
    write_whole(folder / "check.json", to_json({"passes": not failed, "cases": verdicts}))
    print(f"written to {folder / 'check.json'}")
    if failed:
        raise RunError(f"the consistency test fails on {', '.join(failed)}; lines marked FAILS above say where")


@app.command
def chart(*case: str, out: Out = None) -> None:
    """Chart the accuracy of every method against its seconds, on one case or several.

    Writes chart.csv and chart.png.
    """
    from hjprofile.evidence.chart import Point, pareto
    from hjprofile.evidence.chart import chart as chart_case
    from hjprofile.output.plots.studies import chart_picture
    from hjprofile.output.store import open_folder, to_csv, write_whole

    if not case:
        raise InputError("chart needs at least one CASE: a TOML file or the name of a shipped case")
    folder, loaded = _cases(case, out)
    open_folder(folder)
    charts = {}
    for one in loaded:
        with _Progress(f"charting {one.name}") as progress:
            charts[one.name] = points, reference = chart_case(one.name, one.problem, one.grid, one.cfl, progress)
        known = f" (u to {reference.error:.1g})" if reference.error else ""
        print(f"{one.name}: {len(points)} runs against {reference.name}{known}. None beats in seconds and in error:")
        for p in pareto(points):
            errors = f"{p.error_q_l1:8.1e} of q  {p.error_u_sup:8.1e} of u"
            print(f"  {p.method:22} {p.cells:6}  {errors}  {p.seconds:.2g} s")
    write_whole(folder / "chart.csv", to_csv(Point._fields, [p for points, _ in charts.values() for p in points]))
    write_whole(folder / "chart.png", chart_picture(charts))
    print(f"written to {folder}: chart.csv, chart.png")


@app.command
def stability(case: str, /, *, out: Out = None) -> None:
    """Scan where each method on a grid holds and where it fails, on one case.

    Writes stability.csv and stability.png.
    """
    from hjprofile.evidence.stability import Trial, measured_limit
    from hjprofile.evidence.stability import stability as scan
    from hjprofile.output.plots.studies import stability_picture
    from hjprofile.output.store import open_folder, to_csv, write_whole

    folder, (loaded,) = _cases((case,), out)
    open_folder(folder)
    with _Progress(f"trying {loaded.name}") as progress:
        trials = scan(loaded.name, loaded.problem, loaded.grid, progress)
    print(f"{loaded.name}: {len(trials)} trials. CFL number up to which a method holds (by theory):")
    for method, theory in {t.method: t.theory for t in trials if t.parameter == "cfl"}.items():
        low, high = measured_limit(trials, method)
        limit = f"{low:.4g} to {high:.4g}" if high < float("inf") else f"all up to {low:.4g}"
        print(f"  {method:22} {limit:18} ({theory:.4g})")
    write_whole(folder / "stability.csv", to_csv(Trial._fields[:-1], [t[:-1] for t in trials]))
    write_whole(folder / "stability.png", stability_picture(trials))
    print(f"written to {folder}: stability.csv, stability.png")


@app.command
def dependence(case: str, /, *, out: Out = None) -> None:
    """Follow how far solutions come apart that begin close together, or erode by close coefficients, on one case.

    Writes dependence.csv and dependence.png; ends with exit code 1 if a distance exceeds its bound.
    """
    from hjprofile.evidence.dependence import Distance, summary
    from hjprofile.evidence.dependence import dependence as study
    from hjprofile.output.plots.studies import dependence_picture
    from hjprofile.output.store import open_folder, to_csv, write_whole

    folder, (loaded,) = _cases((case,), out)
    open_folder(folder)
    with _Progress(f"disturbing {loaded.name}") as progress:
        distances = study(loaded.name, loaded.problem, loaded.grid, progress)
    sentences, failed = summary(distances)
    print(f"{loaded.name}:")
    print("\n".join(f"  {sentence}" for sentence in sentences))
    write_whole(folder / "dependence.csv", to_csv(Distance._fields, distances))
    write_whole(folder / "dependence.png", dependence_picture(distances))
    print(f"written to {folder}: dependence.csv, dependence.png")
    if failed:
        raise RunError(f"{loaded.source}: {failed}")


@app.command
def sweep(case: str, /, *, vary: Vary, workers: Workers = None, resume: Kept = False, out: Out = None) -> None:
    """Solve a case for every choice of values of some of its keys, and write one table.

    Writes sweep.csv and sweep.nc; ends with exit code 1 if no member could be solved.
    """
    from hjprofile.output.sweep import account
    from hjprofile.output.sweep import sweep as run_sweep
    from hjprofile.output.workers import processes
    from hjprofile.problem.case import find_case, read_choices

    choices = read_choices(vary)
    folder = out or Path("results") / find_case(case).stem
    with processes(workers) as executor, _Progress("sweeping") as progress:
        result = run_sweep(case, choices, executor, folder, resume, progress)
    print(account(result))
    print(f"written to {folder}: sweep.csv, sweep.nc")
    if not any(outcome.done for outcome in result.outcomes):
        raise RunError(f"{case}: no member could be solved; the reasons are in {folder / 'sweep.csv'}")


@app.command
def fit(case: str, after: Path, /, *, vary: Fitted, sigma: Sigma = None, out: Out = None) -> None:
    """Fit parameters of a case to a survey made afterwards, with 95 % intervals.

    AFTER is a CSV file with the header x,height; the case's own profile is the survey before. Writes fit.json, fit.png
    and fitted.toml, the case with the fitted values.
    """
    from hjprofile.evidence.calibration import fit as fit_case
    from hjprofile.output.fit_files import fit_account, fit_files
    from hjprofile.output.store import open_folder, write_whole
    from hjprofile.problem.survey import read_survey

    folder, (loaded,) = _cases((case,), out)
    x, height, _ = read_survey(after)
    found = fit_case(loaded.source, x, height, vary, sigma)
    open_folder(folder)
    files = fit_files(found)
    for name, data in files.items():
        write_whole(folder / name, data)
    print(fit_account(found))
    print(f"  written     {folder}: {', '.join(files)}")


@app.command
def plot(result: Path, /, *, out: Into = None) -> None:
    """Draw the pictures of a result folder again, into it or into another folder."""
    from hjprofile.output.plots.runs import pictures
    from hjprofile.output.store import load_run, write_whole

    folder = out or result
    for name, data in pictures(load_run(result)).items():
        write_whole(folder / name, data)
        print(folder / name)


@app.command
def export(result: Path, /, *, vtk: bool = False, out: Into = None) -> None:
    """Write the VTK files of a result folder, into its folder `vtk` or into another.

    Parameters
    ----------
    vtk
        Files for ParaView; the only format so far.
    """
    from hjprofile.output.store import VTK_FOLDER, load_run, write_whole

    if not vtk:
        raise InputError("export needs a format: --vtk")
    from hjprofile.output.vtk import vtk_files

    folder = out or result / VTK_FOLDER
    files = vtk_files(load_run(result))
    for name, data in files.items():
        write_whole(folder / name, data)
    print(f"{folder}: {_listing(folder, [folder / name for name in files])}")


@app.command
def cases() -> None:
    """List the cases that come with the package."""
    import tomllib

    from hjprofile.problem.case import shipped_cases

    shipped = shipped_cases()
    width = max(map(len, shipped), default=0)
    for name, path in shipped.items():
        print(f"{name:{width}}  {tomllib.loads(path.read_text(encoding='utf-8')).get('title', '')}")


def _cases(names: tuple[str, ...], out: Path | None) -> tuple[Path, list[Case]]:
    """The cases, and the folder for what comes of them all."""
    from hjprofile.problem.case import load_case

    loaded = [load_case(name) for name in names]
    return out or (Path("results") / loaded[0].name if len(loaded) == 1 else Path("results")), loaded


def _account(run: Run) -> str:
    """A few lines on what was solved and how it went."""
    eroded = run.eroded_volume
    volume = f"volume {abs(eroded):.6g} {'eroded' if eroded >= 0 else 'deposited'} on balance"
    poured = ""
    if run.units:
        volume += f" ({abs(eroded) * run.units.volume:.4g} in the survey's units, per unit width)"
        poured = f" = {run.time[-1] * run.units.volume:.4g} in the survey's units"
    count = {kind: sum(e.event == kind for e in run.events) for kind in ("birth", "merge", "exit")}
    plural = {"birth": "births", "merge": "merges", "exit": "exits"}
    events = ", ".join(f"{n} {plural[kind] if n != 1 else kind}" for kind, n in count.items())
    mass, budget = run.bounds["mass_budget"], run.bounds.get("volume_budget")
    lines = [
        run.title,
        f"  solved      {run.method}, {run.cells} cells, {run.steps} steps in {run.wall_seconds:.2g} s "
        f"to t = {run.time[-1]:g}{poured}",
        f"  eroded      {volume}",
        f"  kinks       {len(run.kinks_at(0))} at t = {run.time[0]:g}, {len(run.kinks_at(-1))} at the end; {events}",
        f"  budgets     mass {f'to {mass.allowance}' if mass.holds else 'NOT KEPT'}; "
        + (f"volume to {run.volume_budget_error:.2g} ({budget.allowance})" if budget else "none of volume promised"),
        f"  bounds      {'all hold' if not run.warnings else 'NOT HELD:'}",
        *(f"  WARNING     {warning}" for warning in run.warnings),
    ]
    if run.vertical_steps is not None:
        broke, now = (sum(e.event == "blow-up" for e in run.events), run.steps_at(-1))
        tallest = f"; the tallest is {max(s.height for s in now):.4g} high" if now else ""
        lines.insert(4, f"  steps       {len(now)} vertical at the end, {broke} blow-up{'s' * (broke != 1)}{tallest}")
    if run.error_estimate is not None:
        lines.append(f"  error       of u at most {run.error_estimate:.2g}, by estimate")
    if run.account:
        label = "chosen" if run.case["solver"]["method"] == "auto" else "data"
        lines.insert(1, f"  {label:11} {run.account}")
    return "\n".join(lines)


def _check_line(c: Check) -> str:
    order = f"order {c.order:.2f}, " if c.order is not None else ""
    cells = f" on {c.cells[-1]} {'fronts' if ':fronts:' in c.name else 'cells'}"
    return f"{'passes' if c.passes else 'FAILS '}  {c.name:36} {order}{c.error[-1]:.2g}{cells}  ({c.rule})"


def _listing(folder: Path, files: list[Path]) -> str:
    """File names, with folders as a count."""
    names = [f.relative_to(folder).as_posix() for f in files]
    flat = [n for n in names if "/" not in n]
    if len(flat) > 12:
        flat = [f"{len(flat)} files"]
    inside: dict[str, int] = {}
    for n in names:
        if "/" in n:
            inside[n.split("/")[0]] = inside.get(n.split("/")[0], 0) + 1
    return ", ".join(flat + [f"{name}/ ({count} files)" for name, count in inside.items()])


class _Progress:
    """A bar with the time that is left, on stderr, for what takes longer than a second on a terminal."""

    def __init__(self, label: str):
        self.label, self.started = label, time.monotonic()
        self.bar: Any = None

    def __enter__(self) -> _Progress:
        return self

    def __call__(self, fraction: float) -> None:
        if self.bar is None:
            if not sys.stderr.isatty() or time.monotonic() - self.started < 1.0:
                return
            from rich.console import Console
            from rich.progress import Progress

            self.bar = Progress(console=Console(stderr=True), transient=True)
            self.task = self.bar.add_task(self.label, total=1.0)
            self.bar.start()
        self.bar.update(self.task, completed=fraction)

    def __exit__(self, *_: Any) -> None:
        if self.bar is not None:
            self.bar.stop()


def main(arguments: list[str] | None = None) -> NoReturn:
    """Runs a command; 0 done, 1 the run or a check failed, 2 wrong usage or bad input. Never a traceback for these."""
    if arguments is None:  # a process of its own, whose imports would be searched for garbage again and again
        gc.disable()
    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except (InputError, CycloptsError) as error:
        _leave(f"hjprofile: {error}", 2)
    except RunError as error:
        _leave(f"hjprofile: {error}", 1)
    except MemoryError:
        _leave("hjprofile: the machine's memory is not enough; use fewer cells or snapshots", 1)
    except BrokenPipeError:  # whoever read stdout has left; nor is there anything to say when Python flushes at exit
        _drop_stdout()
        sys.exit(1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _leave(f"hjprofile: {where}{error.strerror or error}; nothing was left half-written", 1)
    except KeyboardInterrupt:
        try:
            _leave("hjprofile: interrupted; nothing was left half-written", 1)
        finally:
            if arguments is None:  # Python would end with the signal instead if it came while a module ran exec()
                os._exit(1)
    sys.exit(0)


def _leave(sentence: str, code: int) -> NoReturn:
    try:
        sys.stdout.flush()
    except OSError:  # a full disk: the sentence below says so, or says what matters more
        _drop_stdout()
    print(" ".join(sentence.split()), file=sys.stderr)
    sys.exit(code)


def _drop_stdout() -> None:
    """Lets go of what stdout still holds and cannot write, which Python would try again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
