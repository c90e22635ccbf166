"""Shock-fitted characteristics: the solution to rounding, through births, merges and exits of kinks (§14).

Over the labels of characteristics r = R(q) and X satisfy ordinary differential equations with one quadrature. A shock
is the pair of labels that meet in it, found by algebra. Steps are of order 8, panels are halved where necessary, and
events are located in time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.solvers.characteristics.label_events import FINE
from hjprofile.solvers.characteristics.moving_labels import MovingLabels
from hjprofile.solvers.characteristics.panels import Panels, cut_into_panels, interpolation
from hjprofile.solvers.invariant import law_table
from hjprofile.solvers.kernels.law import LawTable, Rational, law_q_f
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.solvers.snapshots import assembled, walk
from hjprofile.solvers.stop import Stop, Stopped, Time
from hjprofile.solvers.units_of_the_law import Units, in_units_of_the_law

TOLERANCE = 1e-12
FINEST, COARSEST = 1e-13, 1e-4  # limits of the tolerance of steps: finer ones are below rounding
STEPS = 1e-7  # coarsest tolerance of the steps: coarser ones save no time, and at 1e-4 they can miss a birth
DATA = 1e-3  # error of the panels at t = 0, relative to the tolerance of steps: both runs share it
COARSER, COARSE_STEPS = 10.0, 1e-6  # ratio of the two tolerances for the estimate; the largest second one
BUDGET = 30.0  # allowance of a budget in tolerances, relative to its terms; 2000 random runs satisfied it
FEWEST_STEPS = 20  # for an estimate of rounding
W_ROUNDING = 1e-14  # of W of order 1, after some hundred steps; measured 7e-14 at most on the rational closed forms


def solve_characteristics(
    problem: Problem,
    grid: Grid,
    tolerance: float | None = None,
    progress: Callable[[float], None] | None = None,
    patience: float = np.inf,
) -> Run:
    """Solve by shock-fitted characteristics on the half line; arguments as for `solve.solve_characteristics`."""
    asked, tolerance = tolerance, TOLERANCE if tolerance is None else tolerance
    steps = float(np.clip(tolerance / Units.of(problem.law).length, FINEST, STEPS))
    run = _two_runs(problem, grid, steps, progress, patience)
    return replace(run, case=resolved_case(problem, grid, "characteristics", tolerance=asked))


@in_units_of_the_law
def _two_runs(
    problem: Problem, grid: Grid, steps: float, progress: Callable[[float], None] | None, patience: float
) -> Run:
    """Return a run with a tolerance of its steps, and its error by comparison with a coarser one."""
    try:
        panels = cut_into_panels(problem, grid.left, DATA * steps)
    except Stopped as error:
        why = {"t": Time(0.0), "why": error.stop}
        raise Stopped(Stop(error.stop.reason, "stopped at t = {t:.6g}: {why}", "use the method fronts", why)) from None
    table = _table(problem, panels)
    first = MovingLabels(problem, panels, table, min(COARSER * steps, COARSE_STEPS), patience)
    coarse = walk(first, problem, grid)
    W_coarse = coarse.rows(grid)[0]
    fine, W = _march(MovingLabels(problem, panels, table, steps, first.patience), problem, grid, progress)
    if not len(W):
        assert fine.stop is not None
        raise Stopped(fine.stop)
    apart = float(np.abs(W_coarse[: len(W)] - W).max()) if len(W) <= len(W_coarse) else COARSER * steps
    # of r = R(q) of order 1, in each step; the budget is that of a length times u
    rounding = 5.0 * np.finfo(float).eps * (FEWEST_STEPS + fine.steps) * (1.0 + float(np.abs(W).max()))
    budget = 10.0 * fine.volume_budget_error / -float(panels.mesh.base[0])
    return replace(
        fine,
        wall_seconds=fine.wall_seconds + coarse.seconds,
        error_estimate=max(2.0 * apart, budget) + rounding,
    )


def _march(
    solver: MovingLabels, problem: Problem, grid: Grid, progress: Callable[[float], None] | None
) -> tuple[Run, Array]:
    """Return the run through all saved times that the method reaches, and W, which has less rounding than u."""
    start = solver.now.panels
    ends = np.array([start.mesh.base[0] + start.X[0, 0], 0.0])
    mass = float(np.diff(problem.profile.W(ends, problem.law))[0])
    volume = start.volume()
    # a step may add its tolerance, a panel its own, and the grid reads u to rounding
    allowance = BUDGET * (solver.requested + W_ROUNDING) * (1.0 + abs(volume) + float(np.ptp(start.mesh.I)))
    read = allowance + 4.0 * W_ROUNDING / grid.dx
    allowed = {n: (allowance if n == "volume_budget" else read, "the tolerance") for n in BOUNDS}
    # the smallest r lies below the minimum on many points, by less than this minimum lies below that on few points
    few, many = float(start.r.min()), float((start.r @ interpolation(FINE.s).T).min())
    least = float(law_q_f(max(2.0 * many - few, 0.5 * many), solver.table)[0])
    variation_I = float(np.abs(np.diff(start.mesh.I.ravel(), prepend=float(problem.law.R(0.0)))).sum())
    watch = SnapshotBounds(grid, mass, volume, allowed, least, variation_I)
    snapshots = walk(solver, problem, grid, watch, progress)
    return assembled("characteristics", solver, snapshots, watch, problem, grid), snapshots.rows(grid)[0]


@np.errstate(over="ignore")  # R is 0 where f overflows, far from the root
def _table(problem: Problem, panels: Panels) -> Rational | LawTable:
    """Return the table of the law over all values that r may take: dead labels exceed the range of living ones."""
    from scipy.optimize import brentq

    most = float(panels.r.max() + np.ptp(panels.mesh.I))
    low, high = (
        np.expm1(brentq(lambda v, r: float(problem.law.R(np.expm1(v))) - r, -30.0, 60.0, args=(r,)))
        for r in (float(panels.r.min()), most)
    )
    return law_table(problem.law, 0.5 * (1.0 + min(low, 0.0)) - 1.0, 2.0 * high + 1.0)
