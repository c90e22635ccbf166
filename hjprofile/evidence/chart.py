"""Accuracy against seconds: every method at several resolutions on one problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import CARRY_STEPS, Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import instance
from hjprofile.solvers.characteristics import solve_characteristics
from hjprofile.solvers.closed_forms import closed_form
from hjprofile.solvers.fronts import track_fronts
from hjprofile.solvers.methods import CONSERVATIVE_METHODS, HJ_METHODS, solve_conservative, solve_hj
from hjprofile.solvers.run import Array, Run

# Neighbouring grids, not doubled ones: an error jitters with the place of a kink inside its cell
CELLS = tuple(int(n) for n in np.geomspace(250, 8000, 12).round())
FRONTS = 100, 200, 400, 800, 1600, 3200
TOLERANCES = 1e-7, 1e-9, 1e-11
REFERENCE_FRONTS = 12800
STEEP_REFERENCE_FRONTS = 3200  # under a law of linear growth, where a front costs ten times as much
REPEATS = 3
PATIENCE = 0.3  # seconds that a run may take before finer ones of its method are left out
SNAPSHOTS = 5  # times over which the error of u is taken


class Point(NamedTuple):
    """A run on the chart.

    Attributes:
        case, method: their names.
        cells: of the grid; of `fronts` their number, and for characteristics the cells they are read on.
        error_u_sup: sup|u - exact u| over five times, both ends among them.
        error_q_l1: ∫|q - exact q| dx at the end.
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
    """What errors are measured against.

    Attributes:
        name: of the method.
        error: of its u, by its own estimate; 0 for a closed form.
        at: a function of a grid: u at the five times, shape (5, cells + 1), and q at the end, shape (cells,).
    """

    name: str
    error: float
    at: Callable[[Grid], tuple[Array, Array]]


def chart(
    case: str, problem: Problem, grid: Grid, cfl: float = 0.9, progress: Callable[[float], None] | None = None
) -> tuple[list[Point], Reference]:
    """Runs every method at several resolutions; each point has the median seconds of three runs.

    Seconds are those of the time stepping alone, compilation and output apart. Errors are sup|u - exact u| over
    five times, both ends among them, and ∫|q - exact q| dx at the end. Methods that break down at a resolution are left
    out there. Raises InputError if no time passes or a coefficient is prescribed, and RunError if no method reaches the
    end.
    """
    instance("problem", problem, Problem)
    instance("grid", grid, Grid)
    if not problem.end > 0.0:
        raise InputError(
            f"{case}: end = {problem.end:g}; a chart needs an end above 0, for it times what happens until then"
        )
    if problem.coefficient is not None:
        raise InputError(f"{case}: a chart needs the exact solution, which is not known with a prescribed coefficient")
    problem = replace(problem, snapshots=np.linspace(0.0, problem.end, SNAPSHOTS).tolist())
    reference = _reference(problem, grid)
    known: dict[int, tuple[Array, Array]] = {}
    points: list[Point] = []
    plan = list(_plan(problem, grid, cfl))
    for i, (method, ladder) in enumerate(plan):
        for cells, once in ladder:
            try:
                runs = [once() for _ in range(REPEATS)]
            except RunError:
                continue
            run, seconds = runs[0], float(np.median([r.wall_seconds for r in runs]))
            if run.done:
                if run.cells not in known:
                    known[run.cells] = reference.at(replace(grid, cells=run.cells))
                u, q = known[run.cells]
                u_sup = float(np.abs(run.u - u).max())
                q_l1 = replace(grid, cells=run.cells).dx * float(np.abs(run.q[-1] - q).sum())
                points.append(Point(case, method, cells, u_sup, q_l1, seconds, run.steps))
            if progress:
                progress((i + (cells / ladder[-1][0]) ** 2) / len(plan))
            if seconds > PATIENCE:
                break
    if not points:
        raise RunError(f"{case}: no method reaches the end; `hjprofile run {case}` says why")
    return points, reference


Ladder = Sequence[tuple[int, Callable[[], Run]]]


def _plan(problem: Problem, grid: Grid, cfl: float) -> Iterator[tuple[str, Ladder]]:
    """Every method with its resolutions: a number for the chart, and the run."""
    steep = problem.law.grows_linearly
    for solve, methods in ((solve_hj, HJ_METHODS), (solve_conservative, CONSERVATIVE_METHODS)):
        for method in (m for m in methods if m in CARRY_STEPS or not steep):
            yield method, [(n, partial(solve, problem, replace(grid, cells=n), method, cfl)) for n in CELLS]
    if not problem.profile.inflow:
        yield "fronts", [(n, partial(track_fronts, problem, grid, n)) for n in FRONTS]
        if not steep:
            exact = partial(solve_characteristics, problem, grid)
            yield "characteristics", [(grid.cells, partial(exact, tolerance)) for tolerance in TOLERANCES]


def _reference(problem: Problem, grid: Grid) -> Reference:
    """The closed form if the data have one, else characteristics, else fronts at their finest."""
    exact = closed_form(problem)
    times, end = problem.times, problem.times[-1]
    if exact is not None:
        return Reference(
            "the closed form", 0.0,
            lambda g: (np.array([exact.u(t, g.nodes) for t in times]), exact.q_means(end, g)),
        )  # fmt: skip

    def read(run: Run) -> tuple[Array, Array]:
        return run.u, run.q[-1]

    if not problem.law.grows_linearly:  # vertical steps are followed by fronts alone
        with suppress(RunError):
            run = solve_characteristics(problem, grid)
            if run.done and run.error_estimate is not None:
                estimate = run.error_estimate
                return Reference("characteristics", estimate, lambda g: read(solve_characteristics(problem, g)))
    fronts = STEEP_REFERENCE_FRONTS if problem.law.grows_linearly else REFERENCE_FRONTS
    finest, coarser = (track_fronts(problem, grid, n) for n in (fronts, fronts // 2))
    error = float(np.abs(finest.u - coarser.u).max())
    return Reference(f"{fronts} fronts", error, lambda g: read(track_fronts(problem, g, fronts)))


def pareto(points: Sequence[Point]) -> list[Point]:
    """The points that no other beats in seconds and in ∫|q - exact q| dx, from the fastest to the most accurate."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error_q_l1)):
        if not front or point.error_q_l1 < front[-1].error_q_l1:
            front.append(point)
    return front


def seconds_to(points: Sequence[Point], error: float) -> float:
    """Seconds in which one method reaches that ∫|q - exact q| dx; NaN if its points show no order.

    How many cells it takes follows from the line through all errors in logarithms, for single ones jitter; what they
    cost from the points between which they lie. Beyond the finest point the cost grows like cells², as that of all
    these methods does; below the coarsest it stays.
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
