"""Accuracy against seconds: every method at several resolutions on one problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.case import AnyCase, as_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.model import LinearGrowth
from hjprofile.problem.ranges import instance
from hjprofile.solvers.closed_forms import closed_form
from hjprofile.solvers.method import Feature, require, requirements
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.solve import solve_characteristics, solve_inverse, solve_with, track_fronts

# Neighbouring grids, not doubled ones, because an error varies with the position of a kink in its cell. All of them are
# coarsenings of one grid, on which the reference is evaluated once.
FINEST = 25200
CELLS = tuple(FINEST // n for n in (200, 144, 100, 72, 50, 36, 25, 18, 12, 9, 6, 4, 3))
FRONTS = 100, 200, 400, 800, 1600, 3200
TOLERANCES = 1e-7, 1e-9, 1e-11
REFERENCE_FRONTS = 12800
STEEP_REFERENCE_FRONTS = 3200  # under a law of linear growth, where a front costs ten times as much
REPEATS = 3
REPEATED = 0.03  # seconds of a run above which it is not repeated, unless it was disturbed
FINER_WORK, DISTURBED = 2.0, 1.5  # usual ratio of the seconds of neighbouring runs; ratio to them of a disturbed run
LONGEST_RUN = 0.06  # seconds of a run above which finer runs of its method are omitted
U_ROUNDING = 4.0 * float(np.finfo(float).eps)  # of u - x of order 1 at a node
INTEGRATED = 1e-12  # error of solutions integrated to 1e-13: exact fronts; closed forms, except for the rational law
NOTHING = 1e-12  # |q| of a slope that is neutral to rounding
SAFETY = 2.0  # error of a reference in q, as a multiple of its distance to a coarser run of its method


class Point(NamedTuple):
    """A run on the chart.

    Attributes:
        case, method: their names.
        cells: of the grid; the number of fronts for `fronts`, and the cells of the result for characteristics.
        error_u_sup: sup|u - u_exact|, the largest of all saved times.
        error_q_l1: ∫|q - q_exact| dx, the largest of these times. Both errors are at least those of the reference.
        seconds, steps: of the time stepping.
    """

    case: str
    method: str
    cells: int
    error_u_sup: float
    error_q_l1: float
    seconds: float
    steps: int


class Reference(NamedTuple):
    """A reference solution, relative to which errors are measured.

    Attributes:
        name: of the method.
        error, error_q: of its u and of its q in the norms of `Point`, by its own estimate; 0 for a closed form in
            elementary functions.
        u, q: at the saved times on FINEST cells, shapes (times, FINEST + 1) and (times, FINEST).
    """

    name: str
    error: float
    error_q: float
    u: Array
    q: Array

    def on(self, cells: int) -> tuple[Array, Array]:
        """Return u and q on a grid of one of CELLS, which is nested in the finest one."""
        every = FINEST // cells
        return self.u[:, ::every], self.q.reshape(len(self.q), cells, every).mean(axis=2)


@dataclass(frozen=True)
class Chart:
    """Runs of every method on one case, with their errors and seconds; as text, the Pareto front of seconds and error.

    Attributes:
        case: the name of the case.
        points: the runs.
        reference: the solution relative to which errors are measured.

    >>> import hjprofile as hj
    >>> hj.chart("travelling_kink").pareto[-1].method  # doctest: +SKIP
    'characteristics'
    """

    case: str
    points: tuple[Point, ...]
    reference: Reference

    @property
    def pareto(self) -> list[Point]:
        """The points that no other exceeds in both speed and accuracy of q, from the fastest to the most exact."""
        return pareto(self.points)

    def __str__(self) -> str:
        known = ""
        if self.reference.error:
            known = f" (errors of u {self.reference.error:.1g}, of q {self.reference.error_q:.1g})"
        return "\n".join(
            [
                f"{self.case}: {len(self.points)} runs; reference: {self.reference.name}{known}. "
                "Pareto front of seconds and error:",
                *(self._line(point) for point in self.pareto),
            ]
        )

    def _line(self, p: Point) -> str:
        """Return a point as text, with `<` before an error that is not above the error of the reference."""
        q = f"{'<' * bool(p.error_q_l1 <= self.reference.error_q):>1}{p.error_q_l1:7.1e}"
        u = f"{'<' * bool(p.error_u_sup <= self.reference.error):>1}{p.error_u_sup:7.1e}"
        return f"  {p.method:22} {p.cells:6}  {q} of q  {u} of u  {p.seconds:.2g} s"

    def report(self) -> dict[str, Any]:
        """Return the results as a document for scripts."""
        reference = {"reference": self.reference.name, "reference_error": self.reference.error}
        points = {"points": [p._asdict() for p in self.points], "pareto": [p._asdict() for p in self.pareto]}
        return {"case": self.case} | reference | {"reference_error_q": self.reference.error_q} | points


def chart(case: AnyCase, progress: Callable[[float], None] | None = None) -> Chart:
    """Run every method at several resolutions on a case, and measure its error and its seconds.

    Seconds are those of the time stepping alone, without compilation and output: the median of three runs, or those of
    one run above 0.03 s. Errors are sup|u - u_exact| and ∫|q - q_exact| dx, the largest of all saved times. Methods
    that break down at a resolution are omitted there.

    Args:
        case: a `Case`, the path of a case file, the name of a shipped case, or the tables of a case file.
        progress: a function that is called with the completed fraction in [0, 1].

    Returns:
        The points and the reference. Printed, they are the Pareto front of seconds and error.

    Raises:
        InputError: for invalid input, if the end is 0, if a coefficient is prescribed, for a rolling layer, or if the
            slope is neutral at all saved times after the start.
        RunError: if no method reaches the end.

    >>> import hjprofile as hj
    >>> hj.chart("travelling_kink").reference.name  # doctest: +SKIP
    'the closed form'
    """
    case = as_case(case)
    return chart_of(case.name, case.problem, case.grid, case.cfl, progress)


def chart_of(
    case: str, problem: Problem, grid: Grid, cfl: float = 0.9, progress: Callable[[float], None] | None = None
) -> Chart:
    """Run every method at several resolutions on a problem, as `chart`; `case` is its name in points and messages."""
    instance("problem", problem, Problem)
    instance("grid", grid, Grid)
    if not problem.end > 0.0:
        raise InputError(f"{case}: end = {problem.end:g}; a chart needs an end above 0, because it measures run times")
    known_exactly = set(Feature) - {Feature.COEFFICIENT, Feature.LAYER}
    require(f"{case}: a chart, which needs the exact solution,", known_exactly, requirements(problem))
    later = problem.times > 0.0
    if not later.any():
        raise InputError(f"{case}: no time after 0 is saved; a chart measures errors at the saved times")
    nested = replace(grid, cells=min(CELLS, key=lambda cells: abs(cells - grid.cells)))
    reference = _reference(problem, nested)
    if not np.abs(reference.q[later]).max() > max(reference.error_q, NOTHING):
        raise InputError(
            f"{case}: the slope is neutral from the first measurement on, at t = {problem.times[later][0]:.6g}, "
            "so every method is exact; save earlier times, or set an earlier end"
        )
    points: list[Point] = []
    plan = list(_plan(problem, nested, cfl))
    for i, (method, ladder) in enumerate(plan):
        expected = 0.0  # seconds, by those of the coarser run; the first run also loads compiled loops
        for cells, once in ladder:
            try:
                run, seconds = _timed(once, expected)
            except RunError:
                continue
            expected = seconds * FINER_WORK
            if run.done:
                u, q = reference.on(run.cells)
                u_sup = max(float(np.abs(run.u - u).max()), reference.error)
                q_l1 = max(_distance(run.q, q, replace(grid, cells=run.cells)), reference.error_q)
                points.append(Point(case, method, cells, u_sup, q_l1, seconds, run.steps))
            if progress:
                progress((i + (cells / ladder[-1][0]) ** 2) / len(plan))
            if seconds > LONGEST_RUN:
                break
    if not points:
        raise RunError(f"{case}: no method reaches the end; `hjprofile run {case}` reports the reason")
    return Chart(case, tuple(points), reference)


def _timed(once: Callable[[], Run], expected: float) -> tuple[Run, float]:
    """Return a run and its seconds. A short run is repeated, and one that something else on the machine slowed."""
    run = once()
    seconds = [run.wall_seconds]
    while len(seconds) < REPEATS and (seconds[0] <= REPEATED or min(seconds) > DISTURBED * expected):
        seconds.append(once().wall_seconds)
    return run, float(np.median(seconds)) if seconds[0] <= REPEATED else min(seconds)


Ladder = Sequence[tuple[int, Callable[[], Run]]]


def _plan(problem: Problem, grid: Grid, cfl: float) -> Iterator[tuple[str, Ladder]]:
    """Yield every method with its resolutions: a number for the chart, and the run; `grid` is for exact solutions."""
    able = [method for method in METHODS.values() if method.supports >= requirements(problem)]
    for method in (m for m in able if m.on_grid):
        yield method.name, [(n, partial(solve_with, method, problem, replace(grid, cells=n), cfl)) for n in CELLS]
    if METHODS["fronts"] in able:
        yield "fronts", [(n, partial(track_fronts, problem, grid, n)) for n in FRONTS]
    if METHODS["inverse"] in able:
        yield "inverse", [(n, partial(solve_inverse, problem, replace(grid, cells=n))) for n in CELLS]
    if METHODS["characteristics"] in able:
        exact = partial(solve_characteristics, problem, grid)
        yield "characteristics", [(grid.cells, partial(exact, tolerance)) for tolerance in TOLERANCES]


def _distance(q: Array, other: Array, grid: Grid) -> float:
    """Return the largest ∫|q - other| dx of all times."""
    return grid.dx * float(np.abs(q - other).sum(axis=1).max())


def _reference(problem: Problem, grid: Grid) -> Reference:
    """Return the closed form if the data have one, else characteristics, else fronts, both at their finest.

    The less accurate run that the error follows from is compared on `grid`, one of CELLS.
    """
    exact, finest = closed_form(problem), replace(grid, cells=FINEST)
    if exact is not None:
        error = 0.0 if problem.law.name == "rational" else INTEGRATED
        u = np.array([exact.u(t, finest.nodes) for t in problem.times])
        return Reference(
            "the closed form", error, error, u, np.array([exact.q_means(t, finest) for t in problem.times])
        )
    steep = isinstance(problem.model, LinearGrowth)
    if not steep:  # only fronts resolve vertical steps
        tolerance, _ = METHODS["characteristics"].tolerance or (0.0, 0.0)
        with suppress(RunError):
            run = solve_characteristics(problem, finest, tolerance)
            coarser = solve_characteristics(problem, grid, 100.0 * tolerance)
            if run.done and coarser.done and run.error_estimate is not None:
                rounding = U_ROUNDING * grid.cells * (1.0 + float(np.abs(run.u - run.x).max()))  # of differences of u
                found = Reference("characteristics", run.error_estimate, rounding, run.u, run.q)
                apart = SAFETY * _distance(found.on(grid.cells)[1], coarser.q, grid)
                return found._replace(error_q=max(run.error_estimate, apart) + rounding)
    fronts = STEEP_REFERENCE_FRONTS if steep else REFERENCE_FRONTS
    run, coarser = track_fronts(problem, finest, fronts), track_fronts(problem, grid, fronts // 2)
    for tracked in (run, coarser):
        if not tracked.done:
            raise RunError(tracked.status)
    found = Reference(f"{fronts} fronts", INTEGRATED, INTEGRATED, run.u, run.q)
    u, q = found.on(grid.cells)
    error = max(float(np.abs(u - coarser.u).max()), INTEGRATED)
    return found._replace(error=error, error_q=max(_distance(q, coarser.q, grid), error))


def pareto(points: Sequence[Point]) -> list[Point]:
    """Return the points that no other exceeds in both speed and accuracy of q, from the fastest to the most exact."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error_q_l1)):
        if not front or point.error_q_l1 < front[-1].error_q_l1:
            front.append(point)
    return front


def seconds_to(points: Sequence[Point], error: float) -> float:
    """Return the seconds in which one method reaches that ∫|q - q_exact| dx; NaN if its points show no order.

    The required cells follow from the line through the logarithms of all errors, because single errors vary. The
    seconds are interpolated between the adjacent points. Beyond the finest point they grow like cells², as for all
    these methods; below the coarsest they are constant.
    """
    points = sorted(points, key=lambda p: p.cells)
    cells, errors, seconds = (np.array([p[i] for p in points], dtype=float) for i in (2, 4, 5))
    if len(points) < 2 or not np.all(errors > 0.0):
        return float("nan")
    slope, offset = np.polyfit(np.log(cells), np.log(errors), 1)
    if slope >= 0.0:
        return float("nan")
    needed = np.exp((np.log(error) - offset) / slope)
    within = np.exp(np.interp(np.log(needed), np.log(cells), np.log(seconds)))
    return float(within * max(needed / cells[-1], 1.0) ** 2)
