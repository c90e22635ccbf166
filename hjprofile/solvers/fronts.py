"""Front tracking on the invariant I = W + R(q), which is constant along characteristics (theory, §4 and §5).

I is piecewise constant between fronts that move at x' = K [f]/[q]. For data that are kinks only this is the exact
solution, integrated to 1e-12; smooth data and the fans of downward jumps become many small fronts, second order in
their number through the formation and the merging of shocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.monitors.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import Kinks
from hjprofile.problem.ranges import read_only, whole
from hjprofile.solvers.data_resolution import EXACT, Resolution, compare_data, divided, fine_sample, log_slope
from hjprofile.solvers.invariant import law_table
from hjprofile.solvers.kernels import fronts as kernels
from hjprofile.solvers.kernels.dormand_prince import tableau
from hjprofile.solvers.kernels.exact_fronts import advance_exactly
from hjprofile.solvers.kernels.law import LawTable, law_q_f, start_pieces
from hjprofile.solvers.kernels.steps import StepLaw
from hjprofile.solvers.kernels.steps import start_pieces as start_steep_pieces
from hjprofile.solvers.run import Array, Run, VerticalStep, in_order
from hjprofile.solvers.units_of_the_law import in_units_of_the_law
from hjprofile.solvers.vertical_steps import REACH, WEAK, StepTracker, Tracker, step_law
from hjprofile.solvers.whole_line import also_on_the_whole_line

MOST = 1_000_000  # fronts: the time for a run grows with their square
FOLDS = 5000.0  # e-folds of K that are cut through: the time for a run grows with their square, 20 s for these
WIDEST = 0.15  # spacing by which steps are measured, in lengths R'(0) over which q decays
FINEST = 1 / 16  # part of the spacing below which the data do not shorten steps: it would take too long
# Limits of a piece, so that two numbers of fronts differ wherever the data are not resolved: parts of the range of
# ln(1 + q) and lengths in R'(0), each with the number of fronts below which they stay as they are
CHANGE, CHANGE_FRONTS = 0.5, 32
LENGTH, LENGTH_FRONTS = 0.4, 64
NEGLIGIBLE = 0.01  # part of that change: where ln(1 + q) is below it, pieces may be longer
MOST_ADDED = 25_600
FAN = 0.25  # most that a front of a fan may change ln R: coarser ones, where q changes its sign, run off towards q = -1
# Fronts in all fans, as a part of the others: a quarter for few fans, as many for so many fans and more. A survey of
# 60 pieces then costs twice the seconds and has a tenth of the error
FEWEST_IN_FANS, MANY_FANS = 0.25, 16
NEAR = 0.05  # longest stretch for a Taylor series: its error (0.05)^4/24 is far below that of a front so far away
TOLERANCE = 1e-13  # of one step of the exact integration
ROUNDING = 1e-10  # relative, of the budgets of the exact integration; measured 1.5e-12 on 2000 random scenes
ROUGH = 3.0  # of the second-order allowances; measured 1.6 at worst on 300 random scenes of 50 jumps


@dataclass
class Fronts:
    """Fronts and the pieces between them.

    Attributes:
        x, jump: places and jumps of I, from left to right; x may repeat where a fan opens.
        label: the number of the kink that a front is, or 0.
        smooth: whether the piece right of a front stands for a stretch in which I varies.
        spacing: distance of the fronts of smooth data, and not more than WIDEST.
        finest: their distance where the data ask for more fronts, and not less than FINEST of the spacing.
        r0: R(0), r on the far left.
        top: W at x = 0.
    """

    x: Array
    jump: Array
    label: Array
    smooth: Array
    spacing: float
    finest: float
    r0: float
    top: float

    @property
    def kinks_only(self) -> bool:
        """Whether the fronts are the data themselves, not an approximation."""
        return not self.smooth.any()


def cut_into_fronts(problem: Problem, left: float, fronts: int) -> tuple[Fronts, LawTable | StepLaw]:
    """Piecewise constant I whose W is exact at the ends of the pieces; downward jumps become fans of small fronts."""
    law, profile = problem.law, problem.profile
    breaks = profile.breaks(law)
    start = profile.start(tail=1e-14)
    start = max(start, left) if np.isfinite(start) and start < 0.0 else left
    spacing = min(-start / fronts, WIDEST * float(law.R_derivative(0.0)))
    finest, weak = spacing, np.inf
    if isinstance(profile, Kinks):
        cuts = breaks[:, 0]
    else:
        marks = np.unique([start, *breaks[breaks[:, 0] > start, 0], 0.0])
        cuts, shortest, weak = _resolved(problem, _cuts(problem, marks, -start / fronts), fronts)
        finest = float(np.clip(shortest, FINEST * spacing, spacing))
    ends = np.append(cuts, 0.0)
    W = profile.W(ends, law)
    W -= W[0]
    mass, h = np.diff(W), np.diff(ends)
    mean = np.divide(mass, h, out=np.zeros_like(mass), where=h > 0)

    reached = np.concatenate([mean, breaks[:, 1:].ravel(), [0.0]])
    ceiling = float(np.max(law.R(reached)) + np.ptp(W))
    # a front that jumps down lowers the q on its right a little where the exact fan would not
    floor = (1.0 + float(np.min(reached))) / 8.0 - 1.0
    table: LawTable | StepLaw
    table = step_law(law, floor) if law.grows_linearly else law_table(law, floor, _slope_at(law, 1.1 * ceiling))
    r0 = float(law.R(0.0))
    r = law.R(breaks[:, 2]) if isinstance(profile, Kinks) else _start_of_pieces(law, table, mass, h)
    I = W[:-1] + r
    jump = np.diff(np.concatenate([[r0], I]))
    smooth = np.abs(mass) > 1e-15 if not isinstance(profile, Kinks) else np.zeros(h.size, dtype=bool)

    r_left = np.append(r0, I[:-1]) - W[:-1]
    fan = _fans(law, breaks, weak, cuts, mean, r_left, r)
    drops = np.array([drop for _, _, drop in fan.values()])
    share = float(np.clip(len(drops) / MANY_FANS, FEWEST_IN_FANS, 1.0))
    columns: list[Array] = []
    number = 0
    upward = set(breaks[breaks[:, 2] > breaks[:, 1] + 1e-12, 0].tolist())
    for k, x in enumerate(cuts.tolist()):
        if x in fan:
            q_left, r_before, drop = fan[x]
            # as strong as the fronts of the smooth parts beside them, and in all no more than so many
            beside = spacing * max(0.1, float(np.min(np.abs(law.f(np.array([q_left, mean[k]]))))))
            n = int(np.ceil(max(4.0, drop / FAN, min(share * fronts * drop / drops.sum(), drop / beside))))
            level = W[k] + r_before * np.exp(-drop * (np.arange(n) + 0.5) / n)
            before = I[k - 1] if k else r0
            steps = np.diff(np.concatenate([[before], level, [I[k]]]))
            flags = np.append(np.ones(n), smooth[k])
            columns.append(np.array([np.full(n + 1, x), steps, np.zeros(n + 1), flags]))
        elif x in upward or abs(jump[k]) > 1e-15:
            number += x in upward
            columns.append(np.array([[x], [jump[k]], [number if x in upward else 0], [smooth[k]]]))
        elif columns:
            columns[-1][3, -1] = max(columns[-1][3, -1], smooth[k])
    x, jumps, label, flag = np.concatenate(columns, axis=1) if columns else np.empty((4, 0))
    return Fronts(x, jumps, label.astype(np.int64), flag.astype(bool), spacing, finest, r0, float(W[-1])), table


def _fans(
    law: ErosionLaw, breaks: Array, weak: float, cuts: Array, mean: Array, r_left: Array, r_right: Array
) -> dict[float, tuple[float, float, float]]:
    """Return the positions of fans, with q and r on the left and the fall of ln r: at all downward jumps.

    `mean` holds q in the pieces right of the cuts. A fall of ln(1 + q) by more than `weak` from piece to piece is a
    jump that the profile does not state. One front would carry it as an expansion shock.
    """
    downward = breaks[breaks[:, 1] > breaks[:, 2] + 1e-12]
    before = law.R(downward[:, 1])
    falls = np.log(before / law.R(downward[:, 2]))
    fans = dict(zip(downward[:, 0].tolist(), zip(downward[:, 1], before, falls, strict=True), strict=True))
    unstated = (-np.diff(log_slope(mean), prepend=0.0) > weak) & ~np.isin(cuts, breaks[:, 0]) & (r_left > r_right)
    for k in np.flatnonzero(unstated).tolist():
        before_fan = float(mean[k - 1]) if k else 0.0
        fans[float(cuts[k])] = before_fan, float(r_left[k]), float(np.log(r_left[k] / r_right[k]))
    return fans


def _cuts(problem: Problem, marks: Array, spacing: float) -> Array:
    """Return the left ends of pieces: all marks, and positions in between as spacing and K require."""
    law = problem.law
    cuts = divided(marks, np.maximum(np.ceil(np.diff(marks) / spacing - 1e-9).astype(int), 1))
    # K changes e-fold over a length 1/|f|, which is short where the slope is gentle
    folds = np.diff(cuts) * np.abs(law.f(np.diff(problem.profile.W(cuts, law)) / np.diff(cuts)))
    if not folds.sum() < FOLDS:
        raise RunError(
            f"front tracking cannot start: ln K changes by {folds.sum():.3g} along the slope, as q is too near -1 "
            f"over too long a way, and {FOLDS:g} is the most it can follow; use the method godunov"
        )
    return divided(cuts, np.maximum(np.ceil(2.0 * folds).astype(int), 1))


def _resolved(problem: Problem, cuts: Array, fronts: int) -> tuple[Array, float, float]:
    """Return the left ends of pieces that represent the profile, and the smallest length of a piece that was added.

    A piece of constant I holds one ln(1 + q), which decays over the length R'(0): a piece that is too long, or in which
    the ln(1 + q) of the profile changes too much, is divided. The third value is the largest fall of ln(1 + q) that is
    then expected from piece to piece.
    """
    part = CHANGE * min(1.0, CHANGE_FRONTS / fronts)
    longest = LENGTH * min(1.0, LENGTH_FRONTS / fronts) * float(problem.law.R_derivative(0.0))
    sample = fine_sample(problem, cuts[0], 0.0, cuts, 0.5 * part)
    v = log_slope(sample.q)
    weak = part * float(np.ptp(np.append(v, 0.0)))
    piece = np.clip(np.searchsorted(cuts, sample.x[:-1], side="right") - 1, 0, cuts.size - 2)
    low, high = np.full(cuts.size - 1, np.inf), np.full(cuts.size - 1, -np.inf)
    np.minimum.at(low, piece, v)
    np.maximum.at(high, piece, v)
    same = piece[1:] == piece[:-1]
    varied = np.cumsum(np.where(same, np.abs(np.diff(v)), 0.0)) / max(weak, 1e-300)
    passed = np.diff(np.floor(varied), prepend=0.0) > 0.0
    steep = same & passed & (high - low > weak)[piece[1:]]
    parts = np.where(np.maximum(high, -low) > NEGLIGIBLE * weak, np.ceil(np.diff(cuts) / longest), 1.0)
    added = np.setdiff1d(np.concatenate([divided(cuts, parts.astype(int)), sample.x[1:-1][steep]]), cuts)
    if not added.size or added.size > MOST_ADDED:
        return cuts[:-1], np.inf, 2.0 * weak
    finer = np.union1d(cuts, added)
    new = np.isin(finer, added)
    shortest = float(np.min(np.diff(finer)[new[1:] | new[:-1]]))
    return finer[:-1], shortest, 2.0 * weak


def _slope_at(law: ErosionLaw, r: float) -> float:
    """A q with R(q) >= r."""
    q = 1.0
    while law.R(q) < r:
        q *= 2.0
    return q


def _start_of_pieces(law: ErosionLaw, table: LawTable | StepLaw, mass: Array, h: Array) -> Array:
    """r at the left end of pieces of constant I that hold the given mass: r - r(h) = mass."""
    if isinstance(table, StepLaw):
        v = np.empty_like(mass)
        start_steep_pieces(mass, h, table, v)
        return law.R(np.expm1(v))
    if law.name == "rational":
        return 1.0 + mass / -np.expm1(-h)
    r = np.empty_like(mass)
    start_pieces(mass, h, table, r)
    return r


class _Tracker(Tracker):
    """Fronts under a law of sublinear growth."""

    def __init__(self, fronts: Fronts, table: LawTable, exact: bool):
        self.data, self.table, self.exact = fronts, table, exact
        self.x, self.jump, self.label = fronts.x.copy(), fronts.jump.copy(), fronts.label.copy()
        self.smooth = fronts.smooth.copy()
        room = max(self.x.size, 1)
        super().__init__(self.jump, self.label, room)
        self.since = np.full(room, np.inf)
        self.work, self.head = np.zeros((13, room)), np.zeros(room, dtype=np.int64)
        self.near = 0.0 if exact else NEAR

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
                *arrays, self.n, self.t, end, REACH, self.data.finest, self.data.r0, self.near, self.table,
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
            self.x, self.jump, self.label, self.smooth, self.n, self.data.r0, self.near, self.table,
            *self.work[:4], nodes, W, K,
        )  # fmt: skip
        return W, K

    def volume(self) -> float:
        """∫W dx."""
        return kernels.volume(self.x, self.jump, self.n, self.table, self.data.r0, self._sweep()[1])

    def least(self) -> float:
        right = self._sweep()[1]
        return float(law_q_f(right.min(), self.table)[0]) if self.n else 0.0

    def falls(self) -> Array:
        left, right, _, K = self._sweep()
        strong = np.flatnonzero(np.log(left / right) > WEAK).tolist()
        q = [(law_q_f(left[j], self.table)[0], law_q_f(right[j], self.table)[0], K[j]) for j in strong]
        return np.array(q).reshape(-1, 3).T

    def _sides(self) -> Iterator[tuple[int, float, float, float]]:
        left, right, slope, K = self._sweep()
        for j in np.flatnonzero(self.label[: self.n] > 0).tolist():
            yield j, law_q_f(left[j], self.table)[0], law_q_f(right[j], self.table)[0], float(K[j] * slope[j])


def _begin(
    problem: Problem, left: float, fronts: int, exact: bool | None = None
) -> tuple[Fronts, _Tracker | StepTracker, Resolution]:
    """Return the problem cut into fronts, their tracker, and the errors of the data."""
    data, table = cut_into_fronts(problem, left, fronts)
    exact = data.kinks_only if exact is None else exact
    if not isinstance(table, StepLaw):
        return data, *_proved(problem, left, data, _Tracker(data, table, exact))
    if exact and not data.kinks_only:
        raise InputError("exact = True of other data than kinks is not available for a law with growth = 'linear'")
    return data, *_proved(problem, left, data, StepTracker(data.x, data.jump, data.label, data.finest, exact, table))


def _proved(
    problem: Problem, left: float, data: Fronts, tracker: _Tracker | StepTracker
) -> tuple[_Tracker | StepTracker, Resolution]:
    """Return the tracker, and the errors of the data that it reads before the first step."""
    if data.kinks_only:  # the fronts are the profile
        return tracker, EXACT
    sample = fine_sample(problem, left)
    W, K = tracker.read(read_only(sample.x))  # as the nodes of a grid are: one compiled form does for both
    with np.errstate(all="ignore"):
        return tracker, compare_data(problem, sample, W, np.log(K), tracker.falls())


@also_on_the_whole_line
def track_fronts(
    problem: Problem,
    grid: Grid | None = None,
    fronts: int = 1600,
    progress: Callable[[float], None] | None = None,
    exact: bool | None = None,
) -> Run:
    """Solves by tracking `fronts` fronts (more where fans open), and reads the result on a grid (theory, §5).

    Data that are kinks only are solved exactly, whatever `fronts` is. With `exact` the fronts of other data are moved
    to rounding too: each meets its neighbour in its own time, so that mass and volume are kept to 1e-10, at some fifty
    times the seconds; the error that comes from the number of fronts stays.

    The grid is by default 2000 cells over the profile. Raises InputError for bad input and for a profile with q != 0 at
    the left end, and RunError if fronts lose the slope before the first saved time. Where q comes so near to -1 later
    that a piece is no longer resolved, `status` says so and the last saved time is the last good one.
    """
    grid = problem.grid() if grid is None else grid
    if problem.profile.inflow:
        raise InputError("front tracking needs q = 0 at the left end; this profile has a flux that enters there")
    problem.check(grid, "fronts")
    return _in_units(problem, grid, whole("fronts", fronts, 4, MOST), progress, exact)


@in_units_of_the_law
def _in_units(
    problem: Problem, grid: Grid, fronts: int, progress: Callable[[float], None] | None, exact: bool | None
) -> Run:
    return track_and_prove(problem, grid, fronts, progress, exact)[0]


def track_and_prove(
    problem: Problem,
    grid: Grid,
    fronts: int,
    progress: Callable[[float], None] | None = None,
    exact: bool | None = None,
) -> tuple[Run, Resolution]:
    """Return the run of `track_fronts` on the half line and in units of the law, and the errors of its data."""
    profile = problem.profile
    data, tracker, resolution = _begin(problem, grid.left, fronts, exact)
    height = float(profile.W(grid.nodes[:1], problem.law)[0])

    kept, saved, kinks = problem.times, [], []
    steps: list[VerticalStep] = []
    scale = 1.0 + float(np.abs(data.jump).sum())
    read = ROUNDING * scale
    allowed = dict.fromkeys(BOUNDS, (read, "rounding"))
    if not data.kinks_only:
        second = read + ROUGH * data.spacing**2 * scale
        allowed = dict.fromkeys(BOUNDS, (second, "second order in the spacing of fronts"))
        # F(0) is a sawtooth while small fronts leave, and its integral over a step first order
        allowed["mass_budget"] = second + data.spacing * scale, "first order in the spacing of fronts"
    if tracker.exact:
        allowed |= dict.fromkeys(("mass_budget", "volume_budget"), (read, "rounding"))
    watch = SnapshotBounds(grid, data.top, tracker.volume(), allowed, tracker.least())
    tracker.advance(0.0)  # compiles what is to be compiled
    seconds, status = 0.0, "done"
    for target in np.unique(np.append(kept, problem.end)):
        started = time.perf_counter()
        arrived = tracker.advance(float(target))
        seconds += time.perf_counter() - started
        W, K = tracker.read(grid.nodes)
        broken = _first_fault(W, K, grid)
        if broken is None and not arrived:
            broken = int(np.argmax(K))
        if broken is not None:
            status = (
                f"stopped before t = {target:.6g}: front tracking loses the slope near x = {grid.nodes[broken]:.6g}, "
                "where q is too near -1 for so few fronts, or K too large to separate events; use the method auto "
                "with a tolerance, or the method godunov"
            )
            break
        watch.observe(float(target), W, tracker.volume(), *tracker.totals[:2])
        if target in kept:
            saved.append((W, K))
            kinks += tracker.kinks()
            if isinstance(tracker, StepTracker):
                steps += tracker.vertical_steps()
        if progress:
            progress(float(target) / problem.end if problem.end else 1.0)
    if not saved:
        raise RunError(status)
    W, K = (np.array(rows) for rows in zip(*saved, strict=True))
    run = Run(
        title=problem.title,
        method="fronts",
        case=resolved_case(problem, grid, "fronts"),
        time=kept[: len(saved)],
        x=grid.nodes,
        x_cell=grid.centres,
        u=grid.nodes + W + height,
        q=np.diff(W, axis=1) / grid.dx,
        K=K,
        status=status,
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
        cautions=resolution.caution(f"{fronts} fronts", "the method auto with a tolerance"),
    )
    return run, resolution


def heights_at_end(problem: Problem, left: float, x: Array, fronts: int) -> Array:
    """u at the time `problem.end` at the places x, increasing, in [left, 0]: what a fit asks for a hundred times.

    As `track_fronts`, without a grid and those who watch. Raises RunError where front tracking loses the slope.
    """
    _, tracker, resolution = _begin(problem, left, fronts)
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
