"""Front tracking on the invariant I = W + R(q), which is constant along characteristics (§4 and §13).

I is piecewise constant between fronts that move at x' = K [f]/[q]. For data that are kinks only this is the exact
solution, integrated to 1e-12. Smooth data and the fans of downward jumps become many small fronts, with second order in
their number through the formation and the merging of shocks. Under laws of linear growth kinks can become vertical
steps (§11).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.model import LinearGrowth
from hjprofile.problem.ranges import read_only, whole
from hjprofile.solvers.data_resolution import EXACT, Resolution, compare_data
from hjprofile.solvers.fronts.front_data import FrontData, cut_into_fronts
from hjprofile.solvers.fronts.front_tracker import SUBLINEAR, FrontTracker
from hjprofile.solvers.fronts.tracker import Tracker
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.solvers.snapshots import Witness, assembled, walk
from hjprofile.solvers.stop import Stopped
from hjprofile.solvers.units_of_the_law import in_units_of_the_law
from hjprofile.solvers.vertical_steps.step_fronts import LINEAR, StepTracker

MOST_FRONTS = 1_000_000  # largest number of fronts: the time of a run grows with its square
BUDGET_ERROR = 1e-10  # relative, of the budgets of the exact integration; measured: 1.5e-12 on 2000 random problems
ROUGH = 3.0  # factor of the second-order allowances; measured: at most 1.6 on 300 random problems with 50 jumps


class Begun(NamedTuple):
    """A profile cut into fronts, their tracker before the first step, and the errors of the data."""

    data: FrontData
    tracker: Tracker
    resolution: Resolution


def begin(problem: Problem, left: float, fronts: int, exact: bool | None = None) -> Begun:
    """Cut the profile of a problem in units of the law, right of `left`, into `fronts` fronts."""
    linear = isinstance(problem.model, LinearGrowth)
    data, table = cut_into_fronts(problem, left, fronts, LINEAR if linear else SUBLINEAR)
    if linear and exact and not data.kinks_only:
        raise InputError("exact = True needs a profile of kinks under a law with growth = 'linear'")
    exact = data.kinks_only if exact is None else exact
    tracker = (StepTracker if linear else FrontTracker)(data, table, exact, problem.end)
    if data.sample is None:  # the fronts are the profile
        return Begun(data, tracker, EXACT)
    sample = data.sample
    W, K = tracker.read(read_only(sample.x))  # read-only like the nodes of a grid: one compiled signature
    with np.errstate(all="ignore"):
        return Begun(data, tracker, compare_data(problem, sample, W, np.log(K), data.area))


def track_fronts(
    problem: Problem,
    grid: Grid,
    fronts: int = 1600,
    progress: Callable[[float], None] | None = None,
    exact: bool | None = None,
) -> Run:
    """Track fronts on the half line; arguments as for `solve.track_fronts`."""
    return _in_units(problem, grid, whole("fronts", fronts, 4, MOST_FRONTS), progress, exact)


@in_units_of_the_law
def _in_units(
    problem: Problem, grid: Grid, fronts: int, progress: Callable[[float], None] | None, exact: bool | None
) -> Run:
    """Track fronts in units of the law."""
    begun = begin(problem, grid.left, fronts, exact)
    caution = begun.resolution.caution(f"{fronts} fronts", "the method auto with a tolerance")
    return replace(track(problem, grid, begun, progress), cautions=caution)


def track(
    problem: Problem, grid: Grid, begun: Begun, progress: Callable[[float], None] | None = None,
    witness: Witness | None = None,
) -> Run:  # fmt: skip
    """Return the run of fronts after `begin`, on the half line and in units of the law."""
    tracker, data = begun.tracker, begun.data
    variation_I = float(np.abs(data.jump).sum())
    watch = SnapshotBounds(grid, data.W_crest, tracker.volume(), _allowances(begun), tracker.least(), variation_I)
    tracker.advance(0.0)  # compiles the loops
    snapshots = walk(tracker, problem, grid, watch, progress, witness)
    if not snapshots.states:
        assert snapshots.stop is not None
        raise Stopped(snapshots.stop)
    return assembled("fronts", tracker, snapshots, watch, problem, grid)


def _allowances(begun: Begun) -> dict[str, tuple[float, str]]:
    """Return the allowance of each bound, and the reason for it."""
    data = begun.data
    scale = 1.0 + float(np.abs(data.jump).sum())
    read = BUDGET_ERROR * scale
    allowed = dict.fromkeys(BOUNDS, (read, "rounding"))
    if not data.kinks_only:
        second = read + ROUGH * data.area * scale
        allowed = dict.fromkeys(BOUNDS, (second, "second order in the spacing of fronts"))
        # F(0) is a sawtooth while small fronts leave, and its integral over a step is of first order
        # u changes by -∫K f dt if the volume changes by ∫K dt
        allowed["volume_budget"] = read + (second - read) / min(data.largest_f, 1.0), allowed["volume_budget"][1]
        allowed["mass_budget"] = second + math.sqrt(data.area) * scale, "first order in the spacing of fronts"
    if begun.tracker.exact:
        allowed |= dict.fromkeys(("mass_budget", "volume_budget"), (read, "rounding"))
    return allowed


def heights_at_end(problem: Problem, left: float, x: Array, fronts: int) -> Array:
    """Return u at the time `problem.end` at the positions x (increasing, in [left, 0]), for the fits.

    The method is `track_fronts`, without a grid and monitors. Raise RunError if front tracking loses the slope.
    """
    _, tracker, resolution = begin(problem, left, fronts)
    tracker.advance(problem.end)
    W, K = tracker.read(read_only(x))  # read-only like the nodes of a grid: one compiled signature
    u = x + W + float(problem.profile.W(np.array([left]), problem.law)[0])
    if not resolution.holds:
        raise RunError(f"{fronts} fronts do not resolve the profile")
    if not (tracker.arrived and np.all(np.isfinite(K))):
        raise RunError(f"front tracking fails before t = {problem.end:.6g}, because q comes too near to -1")
    return u
