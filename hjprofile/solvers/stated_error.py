"""Estimates of the errors of a run, by comparison with independent solutions of the same problem (§18).

A reference is a closed form, fronts, characteristics, or runs on coarser grids. Each has an estimate of its own error,
which is added to its distance from the run. The work is counted, not timed, so a run has the same estimate on every
machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.case import Case
from hjprofile.problem.grid import FEWEST_CELLS
from hjprofile.problem.model import Prescribed, RollingLayer, SlowErosion
from hjprofile.problem.profiles import Kinks, Steady
from hjprofile.solvers import closed_forms
from hjprofile.solvers.method import Feature, requirements
from hjprofile.solvers.methods import METHODS, by_characteristics, by_fronts, on_grid
from hjprofile.solvers.run import Run
from hjprofile.solvers.select import EXACT_FRONTS_ERROR, FRONT_STEP, READ_FRONTS, TABLE_STEP, usual_work
from hjprofile.solvers.stop import Reason

CELL_STEP = 5e-9  # measured seconds of a time step of one cell, with monitors: 2e-9 to 2e-8
# Measured seconds for one front of the data, some 300 values of the law; the second for a law of single numbers
CUT, CUT_SCALARS = 5e-6, 1e-4
LEAST_WORK = 0.3  # seconds, by count, that an estimate may cost; more only if the run itself costs more
FEWEST, MOST = 200, 480  # fronts of the first reference
PER_BREAK = 8  # of these for each corner or jump of the profile
MOST_FRONTS = 25_600
MORE, FEWER = 3200, 800  # fronts of the reference of a run by 1600 fronts
CLEAR = 0.5  # largest error of a reference, as a fraction of its distance from the run, that ends the search
CLEAR_TOE = 0.01  # the same for the toe outflow, as a fraction of the toe outflow
MOST_READ = 1 << 23  # values of u of a run on a grid: references off the grid need 22 arrays of this size, 1.5 GB
LABELS = 1e-9  # tolerance of characteristics
EXACT = 10.0  # factor of the rounding errors of exact solutions
ROUGH = 2.0  # factor of an estimate from coarser grids
ORDERS = 1.5, 4.0  # smallest and largest ratio of the distances of three grids: orders between 0.6 and 2
SMOOTH = "conservative"  # the method of second order
DOUBTFUL = 0.05  # largest error of the toe outflow, as a fraction of the supply and of itself, without a caution
EXTREME = 1e6  # largest grain flux at the toe, relative to the supply, without a caution, and inverse of the smallest


class Errors(NamedTuple):
    """Errors, or distances, of u over all saved times, of the toe outflow, and of the eroded volume."""

    u: float
    toe: float
    volume: float

    def plus(self, other: Errors) -> Errors:
        """Return the sums."""
        return Errors(*(a + b for a, b in zip(self, other, strict=True)))

    def times(self, factor: float) -> Errors:
        """Return the products with a number."""
        return Errors(*(factor * a for a in self))

    def largest(self, other: Errors) -> Errors:
        """Return the larger one of each pair; NaN counts as absent."""
        return Errors(*(float(np.fmax(a, b)) for a, b in zip(self, other, strict=True)))

    def smallest(self, other: Errors) -> Errors:
        """Return the smaller one of each pair; NaN counts as absent."""
        return Errors(*(float(np.fmin(a, b)) for a, b in zip(self, other, strict=True)))


UNKNOWN = Errors(np.nan, np.nan, np.nan)


def with_stated_error(run: Run, case: Case) -> Run:
    """Return a run of a case with the estimates of its errors, and with the cautions that follow from them.

    An `error_estimate` of the method itself is not replaced. A run that stopped has an estimate for its saved times,
    but none of its totals.
    """
    problem, reached = case.problem, run.stop is None
    if run.stop is not None:
        reached = run.stop.reason is Reason.CALLBACK  # at a saved time, with the totals of that time
        problem = replace(problem, end=float(run.time[-1]), snapshots=run.time.tolist())
    search = _Search(run, case, problem)
    stated = search.own_errors() if run.error_estimate is not None else search.errors()
    if not reached:
        stated = Errors(stated.u, np.nan, np.nan)
    u, toe, volume = (float(error) if np.isfinite(error) else None for error in stated)
    run = replace(run, error_estimate=u, toe_outflow_error=toe, eroded_volume_error=volume)
    doubts = list(_doubtful_totals(run, _remedy(case, search.features)))
    if not isinstance(problem.model, Prescribed | RollingLayer):  # there K is given, or 0 until the layer arrives
        doubts += _extreme_flux(run)
    return replace(run, cautions=(*run.cautions, *doubts))


def _remedy(case: Case, features: frozenset[Feature]) -> str:
    """Return the advice for a run with large errors."""
    if case.tolerance is not None:
        return "Use a smaller tolerance"
    if METHODS["auto"].supports >= features:
        return "Use more cells, or --tolerance 1e-3, which selects the method auto"
    return "Use more cells"


def _doubtful_totals(run: Run, remedy: str) -> Iterator[str]:
    """Yield a sentence for each total with a large error."""
    supplied = float(run.time[-1]) if run.stop is not None else float(run.case["time"]["end"])
    toe, volume = run.toe_outflow_error or 0.0, run.eroded_volume_error or 0.0
    if toe > DOUBTFUL * min(supplied, abs(run.toe_outflow)):
        yield (
            f"the toe outflow {run.toe_outflow:.3g} has an error of about {toe:.2g}, more than "
            f"{100.0 * DOUBTFUL:g} % of it or of the supply {supplied:.3g}. {remedy}."
        )
    if volume > DOUBTFUL * supplied:
        yield (
            f"the eroded volume {run.eroded_volume:.3g} has an error of about {volume:.2g}, more than "
            f"{100.0 * DOUBTFUL:g} % of the supply {supplied:.3g}. {remedy}."
        )


def _extreme_flux(run: Run) -> Iterator[str]:
    """Yield a sentence if the grain flux at the toe is extreme at a saved time."""
    K = run.K[:, 0]
    for extreme, i, cause in (
        (K > EXTREME, int(np.argmax(K)), "steeper"), (K < 1.0 / EXTREME, int(np.argmin(K)), "gentler")
    ):  # fmt: skip
        if np.any(extreme):
            yield (
                f"the grain flux at the toe is {K[i]:.2g} times the supply at t = {run.time[i]:.4g}: the slope is "
                f"{cause} than the neutral slope over many exchange lengths. Check the exchange length, the critical "
                "slope and their units."
            )


def distance(run: Run, other: Run) -> Errors:
    """Return the distances of two runs of one problem at the saved times of the first; NaN if the other lacks some.

    The nodes of the other are nodes of the run, or the run is interpolated there.
    """
    n, every = len(run.time), run.cells // other.cells
    if len(other.time) < n:
        return UNKNOWN
    if run.cells == every * other.cells:
        u = run.u[:, ::every]
    else:
        u = np.array([np.interp(other.x, run.x, row) for row in run.u])
    return Errors(
        float(np.abs(u - other.u[:n]).max()),
        abs(run.toe_outflow - other.toe_outflow),
        abs(run.eroded_volume - other.eroded_volume),
    )


@dataclass
class _Search:
    """A search for references of a run; `problem` ends at the last saved time of the run.

    Attributes:
        stated: the estimates by the most accurate reference so far, and `known`, its own error.
        work: seconds, by count, that may still be spent.
    """

    run: Run
    case: Case
    problem: Problem
    stated: Errors = UNKNOWN
    known: float = np.inf

    def __post_init__(self) -> None:
        self.grid = self.case.grid
        self.features = requirements(self.problem, self.case.refresh)
        self.exact = isinstance(self.problem.profile, Kinks)  # by fronts
        self.work = max(LEAST_WORK, CELL_STEP * self.run.steps * self.run.cells if self.run.stepped else 0.0)

    def errors(self) -> Errors:
        """Return the estimates of the errors of a run that has none."""
        small = not self.run.stepped or self.run.u.size <= MOST_READ
        off_grid = small and self.features - {Feature.REFRESH} <= METHODS["fronts"].supports
        if self._closed_form():
            return self.stated
        if off_grid and self.run.method == "fronts":
            return self._of_fronts()
        if off_grid and (self._exact_fronts() if self.exact else self._fronts()):
            return self.stated
        if not np.isfinite(self.stated.u):
            self._coarser_grids()
        return self.stated

    def own_errors(self) -> Errors:
        """Return the estimates of a run with its own error of u: its balance of grains bounds those of its totals."""
        run = self.run
        assert run.error_estimate is not None
        total = run.error_estimate * float(np.ptp(run.x)) + run.volume_budget_error
        bound = Errors(run.error_estimate, total, total)
        if run.method == "fronts" and not self.exact and run.stop is None:
            # √2 times more fronts, because auto may have chosen either number
            near = self._from_fronts(FEWER).largest(self._from_fronts(int(np.sqrt(2.0) * FEWER)).times(ROUGH))
            bound = bound.smallest(near)
        return bound._replace(u=run.error_estimate)

    def _offer(self, other: Run | None, error: Errors) -> bool:
        """Compare the run with a reference and its own error. Return True if this error is clearly the smaller one."""
        if other is None:
            return False
        apart = distance(self.run, other)
        if not error.u <= self.known or not np.isfinite(apart.u):
            return False
        self.stated, self.known = apart.plus(error), error.u
        toe = not error.toe > max(CLEAR * apart.toe, CLEAR_TOE * abs(self.run.toe_outflow))
        return error.u <= CLEAR * apart.u and toe

    def _attempt(self, solve: Callable[[], Run]) -> Run | None:
        """Return a run that reaches its end, or None: a failed reference must not lose the run."""
        try:
            with np.errstate(all="ignore"):
                other = solve()
        except (RuntimeError, ValueError, ArithmeticError, LookupError, MemoryError):
            return None
        return other if other.done and np.isfinite(other.u).all() else None

    def _closed_form(self) -> bool:
        """Compare with the closed form of a steady slope."""
        if not (isinstance(self.problem.model, SlowErosion) and isinstance(self.problem.profile, Steady)):
            return False  # of kinks, too, but fronts are faster
        form = self._attempt(self._evaluated)
        return form is not None and (self._offer(form, _of_exact(form)) or True)

    def _evaluated(self) -> Run:
        form = closed_forms.closed_form(self.problem)
        if form is None:
            raise ValueError("there is no closed form")
        return closed_forms.evaluate(form, self.problem, self.grid)

    def _exact_fronts(self) -> bool:
        """Compare with kinks by fronts, which are exact."""
        other = self._attempt(lambda: by_fronts(self.problem, self.grid))
        if other is not None:
            self._offer(other, _of_exact(other))
        return other is not None

    def _of_fronts(self) -> Errors:
        """Return the estimates of a run by fronts."""
        if self._characteristics():
            return self.stated
        other = _of_exact(self.run) if self.exact else self._by_other_fronts()
        return other if np.isfinite(other.u) else self.stated

    def _by_other_fronts(self) -> Errors:
        """Return the estimates of a run by fronts from one with twice as many, or half if that is too much work."""
        more = self._work_of_fronts(MORE, self.run) <= self.work
        return self._from_fronts(MORE).times(ROUGH) if more else self._from_fronts(FEWER)

    def _from_fronts(self, fronts: int) -> Errors:
        """Return the distance from a run of so many fronts."""
        other = self._attempt(lambda: by_fronts(self.problem, self.grid, fronts))
        return UNKNOWN if other is None else distance(self.run, other)

    def _fronts(self) -> bool:
        """Compare with more and more fronts, and with characteristics if they need less work; True if found."""
        breaks = len(self.problem.profile.breaks(self.problem.law))
        fronts = int(np.clip(PER_BREAK * breaks, FEWEST, MOST))
        before, tried = self._resolved(fronts // 2), False
        while fronts <= MOST_FRONTS:
            other = self._resolved(fronts)
            if other is not None and before is not None and self._offer(other, distance(other, before)):
                return True
            ahead = self._work_of_fronts(2 * fronts, other or before)
            if not tried and (ahead > usual_work(self.problem) or ahead > self.work):
                tried = True
                if self._characteristics():
                    return True
            if ahead > self.work:
                break
            self.work -= ahead
            fronts, before = 2 * fronts, other
        return np.isfinite(self.stated.u)

    def _resolved(self, fronts: int) -> Run | None:
        """Return the run of so many fronts if they represent the profile."""
        other = self._attempt(lambda: by_fronts(self.problem, self.grid, fronts))
        return None if other is None or set(other.cautions) - {self.problem.caution(self.grid.left)} else other

    def _work_of_fronts(self, fronts: int, other: Run | None) -> float:
        """Return the seconds, by count, of a run of so many fronts, from the steps of another."""
        step = FRONT_STEP if self.problem.law.name == "rational" else TABLE_STEP
        steps = fronts if other is None else 2 * other.steps
        cut = CUT_SCALARS if self.problem.law.name == "python" else CUT
        return fronts * (cut + step * (self.problem.kept + steps)) + READ_FRONTS * self.problem.kept

    def _characteristics(self) -> bool:
        """Compare with characteristics if the remaining work permits; return True if they reach the end."""
        expected = usual_work(self.problem)
        if expected > self.work or not self.features - {Feature.REFRESH} <= METHODS["characteristics"].supports:
            return False
        other = self._attempt(
            lambda: by_characteristics(self.problem, self.grid, LABELS, None, self.work)  # type: ignore[call-arg]
        )
        self.work -= expected
        if other is None or other.error_estimate is None:
            return False
        total = other.error_estimate * float(np.ptp(other.x)) + EXACT * other.volume_budget_error
        self._offer(other, Errors(other.error_estimate, total, total))
        return True

    def _coarser_grids(self) -> None:
        """Compare with the same method on half and on a quarter of the cells, and with one of second order."""
        run, cells = self.run, self.run.cells
        half = self._on_grid(run.method, cells // 2)
        if half is None:
            return
        apart, ratio = distance(run, half), ORDERS[1] / 2.0
        quarter = self._on_grid(run.method, cells // 4)
        if quarter is not None and apart.u > 0.0:
            ratio = float(np.clip(distance(half, quarter).u / apart.u, *ORDERS))
        self.stated = apart.times(ROUGH / (ratio - 1.0))
        method = METHODS[run.method]
        if method.flux is not None and METHODS[SMOOTH].supports >= self.features:
            other = self._on_grid(SMOOTH, cells // 2)
            if other is not None:
                self.stated = self.stated.largest(distance(run, other))

    def _on_grid(self, method: str, cells: int) -> Run | None:
        """Return the run of a method on so many cells, with the current K or coefficient: u_exact has no other."""
        if cells < FEWEST_CELLS:
            return None
        coarse = replace(self.grid, cells=cells)

        def solve() -> Run:
            self.problem.check(coarse)
            row = METHODS[method]
            if row.solve is not None:
                return row.solve(self.problem, coarse, None, None)
            return on_grid(self.problem, coarse, row, self.case.cfl, None)

        return self._attempt(solve)


def _of_exact(run: Run) -> Errors:
    """Return the errors of an exact solution: the rounding of its budget, or of u."""
    size = EXACT * max(run.volume_budget_error, EXACT_FRONTS_ERROR * (1.0 + float(np.abs(run.u - run.x).max())))
    return Errors(size, size, size)
