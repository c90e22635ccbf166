"""Front tracking on the invariant I = W + R(q), which is constant along characteristics (theory, §4 and §5).

I is piecewise constant between fronts that move at x' = K [f]/[q]. For data that are kinks only this is the exact
solution, integrated to 1e-12; smooth data and the fans of downward jumps become many small fronts, second order in
their number through the formation and the merging of shocks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import read_only, whole
from hjprofile.solvers.data_resolution import EXACT, Resolution, compare_data
from hjprofile.solvers.fronts.front_data import Fronts, cut_into_fronts
from hjprofile.solvers.fronts.kernels import moving_fronts as kernels
from hjprofile.solvers.fronts.kernels.exact_fronts import advance_exactly
from hjprofile.solvers.kernels.dormand_prince import tableau
from hjprofile.solvers.kernels.law import LawTable, law_q_f
from hjprofile.solvers.run import Array, Run, VerticalStep, in_order
from hjprofile.solvers.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Stopped, Time
from hjprofile.solvers.units_of_the_law import in_units_of_the_law
from hjprofile.solvers.vertical_steps.kernels.steps import StepLaw
from hjprofile.solvers.vertical_steps.step_fronts import KINK, StepTracker, Tracker

MOST = 1_000_000  # fronts: the time for a run grows with their square
TIME = 1.0  # times the area of a piece, the largest error that time steps may add: measured, a tenth of that in space
SAVED = 0.1  # part of the time for which error that was not used is kept for later steps
NEAR = 0.05  # longest stretch for a Taylor series, and ...
NEAR_AREA = 0.1  # ... its fourth power, of the area of a piece: its error is then a 24th of that
FINER = 1 / 8  # part of the mean spacing by which steps under linear growth are measured: fronts crowd at a step
STRONG = 0.95  # part of the small fronts whose jump is less than a KINK-th of that of a new kink
TOLERANCE = 1e-13  # of one step of the exact integration
ROUNDING = 1e-10  # relative, of the budgets of the exact integration; measured 1.5e-12 on 2000 random scenes
ROUGH = 3.0  # of the second-order allowances; measured 1.6 at worst on 300 random scenes of 50 jumps


class _Tracker(Tracker):
    """Fronts under a law of sublinear growth."""

    def __init__(self, fronts: Fronts, table: LawTable, exact: bool, end: float = 1.0):
        self.data, self.table, self.exact = fronts, table, exact
        self.x, self.jump, self.label = fronts.x.copy(), fronts.jump.copy(), fronts.label.copy()
        self.smooth = fronts.smooth.copy()
        room = max(self.x.size, 1)
        super().__init__(self.jump, self.label, room)
        small = np.abs(self.jump[self.label == 0])
        if small.size and not exact:  # jumps differ where lengths do
            self.strong = KINK * float(np.quantile(small, STRONG))
        self.since = np.full(room, np.inf)
        self.work, self.head = np.zeros((13 if exact else 16, room)), np.zeros(room, dtype=np.int64)
        self.near = 0.0 if exact else min(NEAR, (NEAR_AREA * fronts.area) ** 0.25)
        # the fourth power of the longest step falls like the square of the number of fronts, as the error in space does
        longest = max(end, 1e-300) / math.sqrt(room)
        first = np.array([min(math.sqrt(fronts.area), longest), SAVED * end])
        self.control = kernels.Control(TIME * fronts.area / max(end, 1e-300), longest, SAVED * end, first)

    def advance(self, end: float) -> bool:
        """To the time `end`, if steps are not too small for that; merges, births and exits are noted."""
        arrays = self.x, self.jump, self.label, self.since, self.smooth
        if self.exact:
            n, logged = advance_exactly(
                *arrays, self.n, self.t, end, self.data.r0, self.table, tableau(), TOLERANCE,
                self.strong, self.work, self.head, self.log, self.totals,
            )  # fmt: skip
        else:
            n, logged = kernels.advance(
                *arrays, self.n, self.t, end, self.control, self.data.r0, self.near, self.table,
                self.strong, self.work, self.head, self.log, self.totals,
            )  # fmt: skip
        self._note(n, logged)
        self.t = end
        return bool(logged >= 0)

    def _sweep(self) -> tuple[Array, Array, Array, Array]:
        """r on the left and on the right, [f]/[q] and K of the fronts."""
        rows = self.work[0], self.work[1], self.work[2], self.work[3]
        kernels.sweep(self.x, self.jump, self.n, self.n - 1, self.data.r0, self.near, self.table, *rows)
        return tuple(row[: self.n] for row in rows)  # type: ignore[return-value]

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """W and K at the nodes."""
        W, K = np.empty_like(nodes), np.empty_like(nodes)
        kernels.read(
            self.x, self.jump, self.label, self.smooth, self.n, self.data.area, self.data.r0, self.near, self.table,
            *self.work[:4], nodes, W, K,
        )  # fmt: skip
        return W, K

    def volume(self) -> float:
        """∫W dx."""
        return kernels.volume(self.x, self.jump, self.n, self.table, self.data.r0, self._sweep()[1])

    def least(self) -> float:
        right = self._sweep()[1]
        return float(law_q_f(right.min(), self.table)[0]) if self.n else 0.0

    def _sides(self) -> Iterator[tuple[int, float, float, float]]:
        left, right, slope, K = self._sweep()
        for j in np.flatnonzero(self.label[: self.n] > 0).tolist():
            yield j, law_q_f(left[j], self.table)[0], law_q_f(right[j], self.table)[0], float(K[j] * slope[j])


class Begun(NamedTuple):
    """A profile that is cut into fronts, their tracker before the first step, and the errors of the data."""

    data: Fronts
    tracker: _Tracker | StepTracker
    resolution: Resolution


def begin(problem: Problem, left: float, fronts: int, exact: bool | None = None) -> Begun:
    """Cut the profile of a problem in units of the law, right of `left`, into `fronts` fronts."""
    data, table = cut_into_fronts(problem, left, fronts)
    exact = data.kinks_only if exact is None else exact
    if not isinstance(table, StepLaw):
        return _proved(problem, data, _Tracker(data, table, exact, problem.end))
    if exact and not data.kinks_only:
        raise InputError("exact = True of other data than kinks is not available for a law with growth = 'linear'")
    spacing = FINER * data.spacing
    return _proved(problem, data, StepTracker(data.x, data.jump, data.label, spacing, exact, table))


def _proved(problem: Problem, data: Fronts, tracker: _Tracker | StepTracker) -> Begun:
    """Return these with the errors of the data that the tracker reads before the first step."""
    if data.sample is None:  # the fronts are the profile
        return Begun(data, tracker, EXACT)
    sample = data.sample
    W, K = tracker.read(read_only(sample.x))  # as the nodes of a grid are: one compiled form does for both
    with np.errstate(all="ignore"):
        return Begun(data, tracker, compare_data(problem, sample, W, np.log(K), data.area))


def track_fronts(
    problem: Problem,
    grid: Grid,
    fronts: int = 1600,
    progress: Callable[[float], None] | None = None,
    exact: bool | None = None,
) -> Run:
    """Tracks `fronts` fronts on the half line; arguments are those of `solve.track_fronts`."""
    return _in_units(problem, grid, whole("fronts", fronts, 4, MOST), progress, exact)


@in_units_of_the_law
def _in_units(
    problem: Problem, grid: Grid, fronts: int, progress: Callable[[float], None] | None, exact: bool | None
) -> Run:
    begun = begin(problem, grid.left, fronts, exact)
    caution = begun.resolution.caution(f"{fronts} fronts", "the method auto with a tolerance")
    return replace(track(problem, grid, begun, progress), cautions=caution)


class Witness:
    """W at nodes at times that are not saved; shape (times, nodes) where the run goes to its end."""

    def __init__(self, times: Array, nodes: Array):
        self.times, self.nodes = times, nodes
        self.W: list[Array] = []


def track(
    problem: Problem, grid: Grid, begun: Begun, progress: Callable[[float], None] | None = None,
    witness: Witness | None = None,
) -> Run:  # fmt: skip
    """Return the run of fronts that have begun, on the half line and in units of the law."""
    profile = problem.profile
    data, tracker, _ = begun
    height = float(profile.W(grid.nodes[:1], problem.law)[0])

    kept, saved, kinks = problem.times, [], []
    steps: list[VerticalStep] = []
    scale = 1.0 + float(np.abs(data.jump).sum())
    read = ROUNDING * scale
    allowed = dict.fromkeys(BOUNDS, (read, "rounding"))
    if not data.kinks_only:
        second = read + ROUGH * data.area * scale
        allowed = dict.fromkeys(BOUNDS, (second, "second order in the spacing of fronts"))
        # F(0) is a sawtooth while small fronts leave, and its integral over a step first order
        # u changes by -∫K f dt where the volume changes by ∫K dt
        allowed["volume_budget"] = read + (second - read) / min(data.most_eroded, 1.0), allowed["volume_budget"][1]
        allowed["mass_budget"] = second + math.sqrt(data.area) * scale, "first order in the spacing of fronts"
    if tracker.exact:
        allowed |= dict.fromkeys(("mass_budget", "volume_budget"), (read, "rounding"))
    watch = SnapshotBounds(grid, data.top, tracker.volume(), allowed, tracker.least())
    tracker.advance(0.0)  # compiles what is to be compiled
    seconds, stop = 0.0, None
    seen = witness.times if witness else np.empty(0)
    for target in np.unique(np.concatenate([kept, seen, [problem.end]])):
        started = time.perf_counter()
        arrived = tracker.advance(float(target))
        seconds += time.perf_counter() - started
        W, K = tracker.read(grid.nodes)
        broken = _first_fault(W, K, grid)
        if broken is None and not arrived:
            broken = int(np.argmax(K))
        if broken is not None:
            stop = Stop(
                Reason.NOT_RESOLVED,
                "stopped before t = {t:.6g}: front tracking loses the slope near x = {x:.6g}, where q is too near -1 "
                "for so few fronts, or K too large to separate events",
                f"use the method auto with a tolerance, or the method {ROBUST_METHOD}",
                {"t": Time(target), "x": Place(grid.nodes[broken])},
            )
            break
        watch.observe(float(target), W, tracker.volume(), *tracker.totals[:2])
        if witness and target in seen:
            witness.W.append(tracker.read(witness.nodes)[0])
        if target in kept:
            saved.append((W, K))
            kinks += tracker.kinks()
            if isinstance(tracker, StepTracker):
                steps += tracker.vertical_steps()
        if progress:
            progress(float(target) / problem.end if problem.end else 1.0)
    if not saved:
        assert stop is not None
        raise Stopped(stop)
    W, K = (np.array(rows) for rows in zip(*saved, strict=True))
    return Run(
        title=problem.title,
        method="fronts",
        case=resolved_case(problem, grid, "fronts"),
        time=kept[: len(saved)],
        x=grid.nodes,
        x_cell=grid.centres,
        u=grid.nodes + W + height,
        q=np.diff(W, axis=1) / grid.dx,
        K=K,
        stop=stop,
        steps=int(tracker.totals[2]),
        wall_seconds=seconds,
        kinks=kinks,
        events=in_order(tracker.events, tracker.moment * problem.end),
        vertical_steps=steps if problem.law.grows_linearly else None,
        bounds=watch.bounds,
        eroded_volume=watch.eroded_volume,
        outflow=float(tracker.totals[1]),
        volume_budget_error=watch.budget_error,
        units=profile.units,
        account=profile.account,
    )


def heights_at_end(problem: Problem, left: float, x: Array, fronts: int) -> Array:
    """u at the time `problem.end` at the places x, increasing, in [left, 0]: what a fit asks for a hundred times.

    As `track_fronts`, without a grid and those who watch. Raises RunError where front tracking loses the slope.
    """
    _, tracker, resolution = begin(problem, left, fronts)
    arrived = tracker.advance(problem.end)
    W, K = tracker.read(read_only(x))  # as the nodes of a grid are: one compiled form does for both
    u = x + W + float(problem.profile.W(np.array([left]), problem.law)[0])
    if not resolution.holds:
        raise RunError(f"{fronts} fronts do not resolve the profile")
    if not (arrived and np.all(np.isfinite(K))):
        raise RunError(f"front tracking loses the slope before t = {problem.end:.6g}, as q comes too near to -1")
    return u


def _first_fault(W: Array, K: Array, grid: Grid) -> int | None:
    """The rightmost node at which the state is not admissible, or None."""
    q = np.diff(W) / grid.dx
    bad = ~(np.isfinite(K) & (K > 0.0))
    bad[1:] |= ~(np.isfinite(q) & (q > -1.0))
    return int(np.flatnonzero(bad)[-1]) if bad.any() else None
