"""Choice of method and resolution with the least work for a tolerance on u (§17).

The method is a closed form if the data have one, and fronts if the data are kinks only. Otherwise a pilot run of few
fronts predicts the number of fronts for the tolerance, and characteristics are preferred if they need less work. Work
is counted, not timed, so the choice is the same on every machine and a case is reproducible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import Bumps, Kinks
from hjprofile.solvers import closed_forms
from hjprofile.solvers.characteristics.moving_labels import LABEL, READ, TRY
from hjprofile.solvers.characteristics.shock_fitting import FINEST, solve_characteristics
from hjprofile.solvers.data_resolution import cells_resolve
from hjprofile.solvers.front_tracking import begin, track, track_fronts
from hjprofile.solvers.fronts.fans import DENSE, FRONTS_PER_JUMP, JUMP
from hjprofile.solvers.run import Array, KinkRecord, Run
from hjprofile.solvers.snapshots import Witness
from hjprofile.solvers.stop import ROBUST_METHOD, Reason, Stop, Stopped
from hjprofile.solvers.units_of_the_law import Units

Progress = Callable[[float], None]

# Factor SAFETY (1 + FEW/fronts) of an estimate from two resolutions. In 19 of 20 random problems true errors are within
# 1.3 with 1000 fronts and more, and within 4 with 100.
SAFETY, FEW = 1.3, 300
JUMPS = 2.0  # replaces SAFETY if q jumps: new fronts of fans have irregular positions
AVERAGED = 1000  # number of jumps above which the errors of graded fans average, and the safety tends to SAFETY
AIM = 0.6  # error of the next resolution, as a fraction of the tolerance
PILOT, MOST_PILOT = 64, 1024  # fronts of the pilot; more if these fail
USUAL, MOST_GUESS = 30.0, 500  # usual estimate times the square of fronts, and the largest pilot by it
PER_BREAK = 8  # fronts of the pilot for each corner or jump: fewer do not distinguish two resolutions
MANY_BREAKS = 60  # number of breaks above which fronts merge the weaker ones
APART = 1.6, 2.6  # smallest and largest ratio of two resolutions for an estimate; forecasts may use larger ones
MOST_FRONTS = 25600
MOST_FOR_JUMPS = 8  # the same, relative to the smallest number with graded fans of many jumps
MORE_MERGED = 4  # ratio of the numbers of fronts of two pilots in which jumps are merged
HOPELESS = 2.0  # multiple of MOST_FRONTS above which fronts are not tried if there is another result
# Measured seconds of a step of one front, under a rational law and under others
FRONT_STEP, TABLE_STEP = 8e-8, 2.7e-7
READ_FRONTS = 5e-4  # measured seconds of a saved time
MORE = 1.25  # smallest ratio of the next number of fronts if a try misses the tolerance
FORECAST, MOST_FORECAST = 8.0, 600  # largest ratio of a forecast to the tried fronts; most fronts of another pilot
# Of characteristics, measured on random problems: steps tried, for all data and for each feature; labels
TRIES, TRIES_EACH, LABELS = 30, 4.5, 160
CORNERS = 3  # number of corners that count as one feature
WORTH_A_TRY = 0.2  # remaining seconds of fronts: some problems with many features take few steps
# First tolerance of characteristics, as a fraction of that of u, and its range: coarser ones save no time
FIRST, DIGITS = 0.1, (1e-12, 1e-6)
EXACT_FRONTS_ERROR = 1e-12  # of kinks by fronts, per unit of u
MOST_CELLS = 64_000  # of a grid
COARSE_CELLS, COARSE_TIMES = 200, 10  # smallest numbers of cells and times on which two runs are compared
BETWEEN = 0.25, 0.5, 0.75  # fractions of the end at which runs are also compared: two wrong runs may agree later


UNRESOLVED = Stop(Reason.NOT_RESOLVED, "do not resolve the profile")


@dataclass
class _Search:
    """The results and failures of a search, in the units of the law."""

    problem: Problem
    grid: Grid
    tolerance: float
    progress: Progress | None
    units: Units
    done: list[tuple[Run, str, Stop | None]] = field(default_factory=list)  # with an estimate; why it was tried
    failed: list[Stop] = field(default_factory=list)
    seconds: float = 0.0

    def offer(self, run: Run, reason: str, estimate: float | None = None, because: Stop | None = None) -> bool:
        """Store a run with the estimate of its error, by default its own; return True if that meets the tolerance."""
        known = estimate if estimate is not None else run.error_estimate
        assert known is not None
        self.done.append((replace(run, error_estimate=known), reason, because))
        return known <= self.tolerance

    def fail(self, name: str, why: Stop) -> None:
        """Record the failure of a method."""
        self.failed.append(Stop(why.reason, "{name} {why}", values={"name": name, "why": why}))

    def attempt(self, solve: Callable[[], Run], name: str) -> Run | None:
        """Return a run that reaches its end, or None after recording the reason."""
        try:
            run = solve()
        except Stopped as error:
            self.fail(name, error.stop)
            return None
        self.seconds += run.wall_seconds
        if run.stop is not None:
            self.fail(name, run.stop)
            return None
        return run

    def result(self, problem: Problem, grid: Grid, tolerance: float) -> Run:
        """Return the best result, in the units of a problem. Raise RunError if no run reached its end."""
        if not self.done:
            causes = {f"why{i}": self.units.stop(stop) for i, stop in enumerate(self.failed)}
            words = f"no method meets the tolerance {tolerance:g}: " + "; ".join(f"{{{name}}}" for name in causes)
            raise Stopped(Stop(Reason.NO_METHOD, words, f"use the method {ROBUST_METHOD}", causes))
        best, reason, because = min(self.done, key=lambda offered: float(offered[0].error_estimate or 0.0))
        run = self.units.run(best, problem, grid)
        reason += f", because {self.units.stop(because).cause}" if because else ""
        account = f"{reason}: error of u about {run.error_estimate:.1g} (tolerance {tolerance:g}), {self.seconds:.2g} s"
        case = resolved_case(problem, grid, "auto", tolerance=tolerance)
        account = "\n".join(filter(None, (problem.profile.account, account)))
        return replace(run, case=case, account=account, wall_seconds=self.seconds).judged(tolerance)


def least_work(
    problem: Problem,
    grid: Grid,
    tolerance: float,
    fallbacks: Mapping[str, Callable[[Problem, Grid], Run]],
    progress: Progress | None = None,
) -> Run:
    """Solve to a tolerance on sup|u - u_exact| over all saved times with the least predicted work.

    `fallbacks` solve on grids if all other methods fail, by their names. Raise RunError if no run reaches its end.
    """
    units = Units.of(problem.law)

    def scaled(solve: Callable[[Problem, Grid], Run]) -> Callable[[Grid], Run]:
        def on_grid(scaled: Grid) -> Run:
            fine = replace(grid, cells=scaled.cells)
            return units.inverse.run(solve(problem, fine), units.problem(problem), scaled)

        return on_grid

    search = _Search(units.problem(problem), units.grid(grid), tolerance / units.length, progress, units)
    reached = _closed_form(search) or (not problem.profile.inflow and _fronts_or_characteristics(search))
    if not (reached or search.done):
        for name, solve in fallbacks.items():
            if _on_grids(search, name, scaled(solve)):
                break
    return search.result(problem, grid, tolerance)


def _closed_form(search: _Search) -> bool:
    """Offer the closed form; return True if it meets the tolerance."""
    if isinstance(search.problem.profile, Kinks):  # fronts are exact for these, too, and faster
        return False
    try:
        form = closed_forms.closed_form(search.problem)
        run = closed_forms.evaluate(form, search.problem, search.grid) if form else None
    except (ArithmeticError, ValueError, RuntimeError):  # numbers out of range
        return False
    if run is None or not np.isfinite(run.u).all():
        return False
    search.seconds += run.wall_seconds
    return search.offer(run, "the closed form, which exists for this profile")


def _fronts_or_characteristics(search: _Search) -> bool:
    """Return True if one of them meets the tolerance; the one with less predicted work is tried first."""
    problem = search.problem
    if isinstance(problem.profile, Kinks):
        run = search.attempt(lambda: track_fronts(problem, search.grid, progress=search.progress), "front tracking")
        if run is not None:
            scale = 1.0 + float(np.abs(run.u - run.x).max())
            estimate = 10.0 * max(run.volume_budget_error, EXACT_FRONTS_ERROR * scale)
            if search.offer(run, "fronts, which are exact because the profile consists of kinks", estimate):
                return True
        return _characteristics(search, np.inf, "because fronts do not meet the tolerance")
    ladder = _Ladder(search)
    needed = ladder.pilot()
    least, spent = max(min(usual_work(problem), WORTH_A_TRY), _least_work(problem)), 0.0  # of characteristics
    while True:
        # characteristics may spend as much as all fronts would cost, in tries each twice as long as the last
        ahead = ladder.work(needed) if needed > ladder.first else 0.0
        work = ahead + sum(ladder.work(n) for n in ladder.u)
        if ahead > least and work > 2.0 * spent:
            spent = work if needed <= ladder.most else np.inf
            why = f"because {needed:.2g} fronts would cost more" if np.isfinite(needed) else "because fronts fail"
            if _characteristics(search, spent, why):
                return True
            if not (search.failed and search.failed[-1].reason is Reason.TOO_LONG):
                spent = np.inf
        if not np.isfinite(needed) or (needed > HOPELESS * ladder.most and search.done):
            break
        reached, needed = ladder.solve(needed)
        if reached:
            return True
    return np.isfinite(spent) and _characteristics(search, np.inf, "because fronts do not meet the tolerance")


def _features(problem: Problem) -> float:
    """Return the number of features of a profile that characteristics resolve."""
    profile = problem.profile
    bumps = profile.amplitudes.size if isinstance(profile, Bumps) else 0
    return max(1.0, bumps, len(profile.breaks(problem.law)) / CORNERS)


def usual_work(problem: Problem) -> float:
    """Return the seconds, by count, that characteristics usually take."""
    features = _features(problem)
    return (TRIES + TRIES_EACH * features) * (TRY + LABEL * LABELS * features) + READ * problem.kept


def _least_work(problem: Problem) -> float:
    """Return the seconds, by count, of as few steps as characteristics of any profile take."""
    return TRIES * (TRY + LABEL * LABELS * _features(problem)) + READ * problem.kept


def _characteristics(search: _Search, patience: float, why: str) -> bool:
    """Solve by characteristics, with a second tolerance if the first is not sufficient; return True if it is met."""
    first = float(np.clip(FIRST * search.tolerance, *DIGITS))
    for tolerance in (first, FINEST):
        run = search.attempt(
            lambda e=tolerance: solve_characteristics(search.problem, search.grid, e, search.progress, patience),  # type: ignore[misc]
            "characteristics",
        )
        if run is not None and search.offer(run, f"characteristics in {run.steps} steps, {why}"):
            return True
        if run is None and search.failed[-1].reason in (Reason.TOO_LONG, Reason.NOT_SMOOTH):
            return False
    return False


def beside_kinks(kinks: Sequence[KinkRecord], others: Sequence[KinkRecord], times: Array, length: float) -> float:
    """Return the largest difference of u between the kinks of one run and the mutually nearest ones of another.

    Between two positions of a kink, d apart, u differs by jump ∫ exp(-x/length) dx up to d, as q decays over the length
    R'(0). Nodes that are further apart than d may not show this difference.
    """
    largest = 0.0
    for t in times.tolist():
        found, known = (np.array([(k.x, k.jump) for k in of if k.time == t]).reshape(-1, 2) for of in (kinks, others))
        if found.size and known.size:
            first, second = _nearest(found[:, 0], known[:, 0]), _nearest(known[:, 0], found[:, 0])
            same = second[first] == np.arange(len(first))  # other kinks exist in one run only
            d = np.abs(found[:, 0] - known[first, 0])[same]
            jump = np.minimum(found[same, 1], known[first[same], 1])
            largest = max(largest, float(np.max(-jump * length * np.expm1(-d / length), initial=0.0)))
    return largest


def _nearest(x: Array, places: Array) -> Array:
    """Return the index of the nearest of the increasing places to each x, the first of two."""
    right = np.minimum(np.searchsorted(places, x), places.size - 1)
    left = np.maximum(right - 1, 0)
    return np.where(np.abs(x - places[left]) <= np.abs(x - places[right]), left, right)


class _Ladder:
    """Runs by fronts at several resolutions."""

    def __init__(self, search: _Search):
        self.search = search
        self.coarse = _coarser(search.problem, search.grid)
        times = search.problem.times
        self.rows = np.arange(times.size)[:: -max(1, times.size // COARSE_TIMES)][::-1]  # with the last
        self.few = replace(search.problem, snapshots=times[self.rows].tolist())
        self.u: dict[int, Array] = {}  # fronts -> u on the coarse grid at these times
        self.past: dict[int, Array] = {}  # fronts -> u - x between these times
        self.kinks: dict[int, Sequence[KinkRecord]] = {}
        self.breaks = search.problem.profile.breaks(search.problem.law)
        jumps = int(np.count_nonzero(np.abs(self.breaks[:, 2] - self.breaks[:, 1]) > JUMP))
        # the fronts of the first run with a graded fan at each jump
        self.dense = math.ceil(FRONTS_PER_JUMP * jumps) if jumps > DENSE else 0
        self.most = max(MOST_FRONTS, MOST_FOR_JUMPS * self.dense)
        self.jumps = jumps if np.any(self.breaks[:, 1] != self.breaks[:, 2]) else 0
        self.missed: dict[int, float] = {}  # fronts -> sup|W_d - W| of the data
        self.plain: dict[int, float] = {}  # fronts -> the error by second order, without a safety factor
        self.steps = 0.0  # for each front
        self.first = 0  # fronts of the pilot, which is read on all nodes because it may suffice
        self.whole: Run | None = None

    def _run(self, fronts: int, last: bool = False) -> Run | None:
        """Return a run read at few nodes and times, or, for the last one, at all."""
        problem, grid = (self.search.problem, self.search.grid) if last else (self.few, self.coarse)
        try:
            begun = begin(problem, grid.left, fronts)
        except Stopped as error:
            self.search.fail(f"{fronts} fronts", error.stop)
            return None
        if not begun.resolution.holds:
            self.search.fail(f"{fronts} fronts", UNRESOLVED)
            return None
        witness = Witness(problem.end * np.array(BETWEEN), self.coarse.nodes)
        run = self.search.attempt(
            lambda: track(problem, grid, begun, self.search.progress, witness), f"{fronts} fronts"
        )
        if run is not None:
            self.missed[fronts] = begun.resolution.height
            self.past[fronts] = np.array(witness.W)
            self.u[fronts] = run.u[self.rows if last else slice(None), :: run.cells // self.coarse.cells]
            self.kinks[fronts] = run.kinks
            self.steps = max(run.steps - problem.kept, 0) / fronts  # each saved time may shorten a step
        return run

    def _safety(self, fronts: float) -> float:
        """Return the factor of an estimate with so many fronts."""
        if not self.jumps:
            return SAFETY
        graded = self.dense and fronts >= 2 * self.dense
        return SAFETY + (JUMPS - SAFETY) * (min(1.0, AVERAGED / self.jumps) if graded else 1.0)

    def _estimate(self, fronts: int, apart_at_most: float = APART[1]) -> float:
        """Return the Richardson estimate of the error with `fronts` fronts; inf without a coarser run."""
        below = [n for n in self.u if APART[0] * n <= fronts <= apart_at_most * n]
        if not below:
            return np.inf
        n = max(below)
        length = float(self.search.problem.law.R_derivative(0.0))
        apart = max(float(np.abs(of[fronts] - of[n]).max(initial=0.0)) for of in (self.u, self.past))
        apart = max(apart, beside_kinks(self.kinks[fronts], self.kinks[n], self.few.times, length))
        self.plain[fronts] = apart / ((fronts / n) ** 2 - 1.0)
        plain = self._safety(fronts) * (1.0 + FEW / fronts) * self.plain[fronts]
        return max(plain, self.missed[fronts]) + EXACT_FRONTS_ERROR

    def pilot(self) -> float:
        """Return the number of fronts for the tolerance; inf if the pilot fails."""
        breaks = len(self.breaks)
        fronts = max(
            PILOT, PER_BREAK * min(breaks, MANY_BREAKS), int(min(np.sqrt(USUAL / self.search.tolerance), MOST_GUESS))
        )
        most = max(MOST_PILOT, 2 * PER_BREAK * breaks)
        while fronts <= most:
            if self._run(fronts // 2) and (run := self._run(fronts, last=True)):
                self.first, self.whole = fronts, run
                needed = self._needed(fronts)
                while (
                    FORECAST * fronts < needed <= MOST_FRONTS and 4 * fronts <= MOST_FORECAST and self._run(4 * fronts)
                ):  # a far forecast
                    fronts *= 4
                    needed = self._needed(fronts)
                if not fronts < self.dense < needed:  # else merged jumps predict nothing about graded fans
                    return needed
                fronts = 2 * self.dense
            elif fronts < self.dense:
                fronts = MORE_MERGED * fronts if MORE_MERGED * fronts < self.dense // 2 else 2 * self.dense
            else:
                fronts *= 2
        return np.inf

    def _needed(self, fronts: int) -> float:
        """Return the number of fronts for the tolerance, from the error with `fronts` fronts."""
        estimate = self._estimate(fronts, np.inf)
        if estimate <= self.search.tolerance:
            return float(fronts)
        wanted = AIM * self.search.tolerance
        error = self._safety(fronts) * self.plain[fronts]
        n = fronts * np.sqrt(error / wanted)
        n = fronts * np.sqrt(error * (1.0 + FEW / max(n, fronts)) / wanted)
        return float(np.ceil(max(n, MORE * fronts)))

    def work(self, fronts: float) -> float:
        """Return the seconds, by count, of a run with so many fronts."""
        problem = self.search.problem
        step = FRONT_STEP if problem.law.name == "rational" else TABLE_STEP
        moved = step * fronts * (problem.kept + self.steps * fronts) if np.isfinite(fronts) else np.inf
        return moved + READ_FRONTS * problem.kept

    def solve(self, needed: float) -> tuple[bool, float]:
        """Solve with about `needed` fronts; return True if the tolerance is met, and the number of fronts to try."""
        search, fronts = self.search, int(min(needed, self.most))
        most = max(self.u)
        if fronts > APART[1] * most:  # half as many improve the prediction, and give the error later
            half = max(fronts // 2, int(APART[0] * most) + 1)
            if not self._run(half):
                return False, np.inf
            needed = max(self._needed(half), APART[0] * half + 1.0)
            fronts = int(min(needed, APART[1] * half, self.most))
        if not any(APART[0] * n <= fronts <= APART[1] * n for n in self.u):
            fronts = int(APART[0] * max(self.u)) + 1
        run = self.whole if fronts == self.first else self._run(fronts, last=True)
        if run is None:
            return False, np.inf
        estimate = self._estimate(fronts)
        reason, because = f"{fronts} fronts, because their error is of second order in their number", None
        if fronts == self.first:
            reason = f"{fronts} fronts, the smallest number for which the error can be estimated"
        elif search.failed:
            reason, because = f"{fronts} fronts", search.failed[-1]
        if search.offer(run, reason, estimate, because):
            return True, fronts
        return False, max(self._needed(fronts), MORE * fronts) if fronts < self.most else np.inf


def _coarser(problem: Problem, grid: Grid) -> Grid:
    """Return a coarser grid of nodes of this grid, fine enough to compare two runs."""
    for every in range(10, 1, -1):
        if grid.cells % every == 0 and grid.cells // every >= COARSE_CELLS:
            coarse = replace(grid, cells=grid.cells // every)
            try:
                problem.check(coarse)
            except InputError:  # the first cell of a Python profile is too wide
                continue
            if cells_resolve(problem, coarse).holds:  # else two runs may differ between all these nodes
                return coarse
    return grid


def _on_grids(search: _Search, method: str, on_grid: Callable[[Grid], Run]) -> bool:
    """Solve on finer and finer grids, read on the requested nodes; return True if the tolerance is met."""
    grid, cells = search.grid, search.grid.cells
    before: Run | None = None
    apart = np.inf
    while cells <= max(MOST_CELLS, 2 * grid.cells):
        fine = replace(grid, cells=cells)
        if not cells_resolve(search.problem, fine).holds:  # then a small difference of two runs is no evidence
            search.fail(f"{cells} cells", UNRESOLVED)
            cells *= 2
            continue
        run = search.attempt(lambda g=fine: on_grid(g), method)  # type: ignore[misc]
        if run is None:
            return False
        every = cells // grid.cells
        run = replace(
            run, x=grid.nodes, x_cell=grid.centres, u=run.u[:, ::every], K=run.K[:, ::every],
            q=run.q.reshape(len(run.time), grid.cells, every).mean(axis=2),
        )  # fmt: skip
        if before is not None:
            previous, apart = apart, float(np.abs(run.u - before.u).max())
            # the observed order, between one (a kink) and two; one without an observation
            ratio = float(np.clip(previous / apart if np.isfinite(previous) and apart > 0.0 else 2.0, 1.5, 4.0))
            reason = f"{method} on {cells} cells, because neither fronts nor characteristics reach the end"
            if search.offer(run, reason, SAFETY * apart / (ratio - 1.0)):
                return True
        before, cells = run, 2 * cells
    return False
