"""Consistency test: the Hamilton-Jacobi equation against the conservation law, on the case of the user.

Identity: with the same numerical flux the two forms agree to rounding, which detects an error in either code path.
Independence: the second-order conservative solver shares no code with the Hamilton-Jacobi solver, so convergence of one
to the other is evidence that both solve the equation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.case import AnyCase, Case, as_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.model import LinearGrowth, Prescribed
from hjprofile.problem.profiles import bumps
from hjprofile.problem.ranges import instance
from hjprofile.solvers.data_resolution import cells_resolve
from hjprofile.solvers.method import Feature, Form, require, requirements
from hjprofile.solvers.methods import METHODS, find_method
from hjprofile.solvers.run import Run
from hjprofile.solvers.solve import solve_characteristics, solve_inverse, solve_with, track_fronts
from hjprofile.solvers.stop import ROBUST_METHOD
from hjprofile.studies.accuracy import Comparison, compare, observed_order
from hjprofile.studies.records import EPS, records
from hjprofile.studies.verdict import Check, Consistency

# Methods of first order for u whose orders are measured; `telescoping` conserves the volume exactly
CONVERGING = tuple(
    name for name, method in METHODS.items() if method.form is Form.HEIGHT and method.flux and name != "telescoping"
)
LEAST_CELLS, MOST_CELLS = 2000, 4000  # limits for the finest grid; orders on coarser ones are misleading

FEWEST_GRIDS = 3  # an order needs two differences
ABSOLUTE_ROUNDING = 1e-10  # allowance for volumes and distances
SAFETY = 2.0  # factor of estimates from three differences: the error of a kink depends on its position in a cell
WORST_ORDER = 0.5  # order of the theory in L1; below it a run is not in its asymptotic range
BEST_ORDER = 1.0  # order of any method on a fixed grid across a kink
WITNESS = 1e-9  # tolerance of characteristics: far below the error of any grid here
FRONTS = (400, 800, 1600)
INVERSE = "inverse"  # the method for x as a function of u, which solves neither form
ORDER_SMOOTH = 1.5  # smallest order of higher methods on smooth data; measured: 2.0 to 5.0; first-order: 1.0
# A smooth bump, which does not break before this time under any of the laws with f'(0) = 1
SMOOTH = {"amplitudes": [0.3], "centres": [-3.0], "widths": [1.0]}
SMOOTH_END, SMOOTH_CELLS = 0.5, (200, 400, 800)


Runs = dict[tuple[str, int], Run]


def check(case: AnyCase, progress: Callable[[float], None] | None = None) -> Consistency:
    """Run the consistency test of a case: the Hamilton-Jacobi equation against the conservation law.

    - `case`: a `Case`, the path of a case file, the name of a shipped case, or the tables of a case file.
    - `progress`: a function that is called with the completed fraction in [0, 1].

    Return a `Consistency`, which is true unless a comparison fails. Raise InputError for invalid input, and RunError if
    a reference solution fails.

    >>> import hjprofile as hj
    >>> hj.check("travelling_kink").verdict  # doctest: +SKIP
    'passes'
    """
    case = as_case(case)
    comparisons = check_consistency(case.problem, case.grid, case.cfl, progress, case.refresh, case.method)
    return Consistency(case.name, case.problem.title, comparisons, _remedy(case))


def _remedy(case: Case) -> str:
    """Return the advice for a case that the grids do not resolve."""
    advice = [f"use more cells (this test uses up to {MOST_CELLS})"] if case.grid.cells < MOST_CELLS else []
    if case.problem.profile.units:
        advice.append("smooth the survey with `resample`")
    if METHODS["auto"].supports >= requirements(case.problem, case.refresh):
        advice.append("use the method auto with a tolerance, which needs no grid")
    return ", or ".join(advice) or "smooth the profile"


def check_consistency(
    problem: Problem,
    grid: Grid,
    cfl: float = 0.9,
    progress: Callable[[float], None] | None = None,
    refresh: float | None = None,
    method: str | None = None,
) -> list[Check]:
    """Return all comparisons for one problem, on four grids up to the given one (2000 to 4000 cells).

    - `problem`, `grid`, `cfl`, `refresh`: as for `solve_hj`.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `method`: the case's own method, whose comparisons decide. One on a grid is compared as the others are.

    With a prescribed coefficient, and with a refresh interval, the volume budget of the nonlocal K and the third
    witness do not exist, and both are omitted. Under a law of linear growth only the methods that support vertical
    steps are compared (§11). Raise InputError and RunError as `check`.

    >>> import hjprofile as hj
    >>> case = hj.load_case("travelling_kink")
    >>> all(c.passes for c in hj.check_consistency(case.problem, case.grid))  # doctest: +SKIP
    True
    """
    instance("problem", problem, Problem)
    instance("grid", grid, Grid)
    asked = requirements(problem, refresh)
    require("the consistency test", set(Feature) - {Feature.LAYER}, asked)
    steep = isinstance(problem.model, LinearGrowth)
    finest = min(max(grid.cells, LEAST_CELLS), MOST_CELLS) // 8 * 8
    grids = [finest // 8, finest // 4, finest // 2, finest]
    chosen = find_method(method) if method else None
    carried = () if steep else CONVERGING
    ordered = ["telescoping", "conservative"] if steep else [*CONVERGING, "conservative"]
    if chosen and chosen.on_grid and chosen.supports >= asked and chosen.name not in ordered:
        ordered.append(chosen.name)
    plan = [(m, n) for m in ordered for n in grids]
    plan += [(m, finest) for m in ("telescoping", *(f"conservative-{m}" for m in (*carried, "telescoping")))]
    plan = list(dict.fromkeys(plan))
    runs: Runs = {}
    for i, (name, cells) in enumerate(plan):
        runs[name, cells] = solve_with(METHODS[name], problem, replace(grid, cells=cells), cfl, refresh=refresh)
        if progress:
            progress((i + 1) / len(plan))
    coarse = {n for n in grids if not cells_resolve(problem, replace(grid, cells=n)).holds}
    usable = _usable(runs, ordered, grids)
    checks = [*_completed(runs, coarse, decides=not usable)]
    for (name, cells), run in runs.items():
        if cells == finest and run.done:
            checks += records(run, problem, refresh, f":{name}")
    checks += [_identity(runs, finest, m, problem, finest in coarse) for m in (*carried, "telescoping")]
    if not all(c.passes for c in checks if c.name.startswith("saved-times")):
        return checks  # runs at other times cannot be compared
    own_factor = not isinstance(problem.model, Prescribed) and refresh is None
    high = [m for m in ordered if not METHODS[m].flux]
    smooth = [*_second_order(problem, cfl, high)] if own_factor and not steep else []
    if not usable:
        return checks + smooth
    deciding = {"telescoping" if steep else ROBUST_METHOD, "conservative"} | ({chosen.name} if chosen else set())
    witness = None
    if own_factor and not problem.profile.inflow:
        witness = _third_witness(problem, replace(grid, cells=finest))
        if chosen and not chosen.on_grid:
            checks += _own_witness(witness, chosen.name, finest)
            if witness and witness.confirmed:
                deciding = set()  # two methods without a grid agree, and the case uses neither grid
    ladders = {m: Ladder(m, [runs[m, n] for n in usable], m in deciding) for m in ordered}
    if METHODS[INVERSE].supports >= asked:
        checks += _by_levels(ladders, problem, [replace(grid, cells=n) for n in usable], method == INVERSE)
    judged = Judged(problem, ladders, len(coarse) <= len(grids) - FEWEST_GRIDS)
    checks += _independence(judged)
    if own_factor:
        checks += [*_budgets(runs, judged), *(_against(witness, judged) if witness else ())]
    return checks + smooth


def _by_levels(ladders: dict[str, Ladder], problem: Problem, grids: Sequence[Grid], decides: bool) -> Iterator[Check]:
    """Add the ladder for x as a function of u, with as many levels as each grid has cells, unless a run fails.

    Check its finest run. It `decides` if the case uses this method; the comparison is open if it then fails.
    """
    found: list[Run] = []
    with suppress(RunError):
        found = [solve_inverse(problem, grid) for grid in grids]
    if found and all(run.done for run in found) and all(_sound(run) for run in found[-FEWEST_GRIDS:]):
        ladders[INVERSE] = Ladder(INVERSE, found, decides)
        yield from records(found[-1], problem, None, f":{INVERSE}")
    elif decides:
        yield _unsolved(INVERSE, grids[-1].cells)


def _usable(runs: Runs, methods: Sequence[str], grids: Sequence[int]) -> list[int]:
    """Return the finest grids on which every run reaches its end; none if they are too few for an order."""
    ended = [all(runs[m, n].done for m in methods) for n in grids]
    first = len(grids) - ended[::-1].index(False) if False in ended else 0
    return list(grids[first:]) if len(grids) - first >= FEWEST_GRIDS else []


@dataclass(frozen=True)
class Ladder:
    """Runs by one method on grids of which each is twice as fine as the one before."""

    method: str
    runs: Sequence[Run]
    decides: bool = True  # open comparisons of this method decide the verdict

    @property
    def cells(self) -> list[int]:
        """The numbers of cells."""
        return [r.cells for r in self.runs]

    @cached_property
    def steps(self) -> list[Comparison]:
        """The distances of each run from the next finer one."""
        return [compare(a, b) for a, b in pairwise(self.runs)]

    def estimate(self, norm: str) -> float:
        """Return Richardson's estimate of the error of the finest run, with that of sharp vertical steps."""
        sharp = self._sharp() if self.method == INVERSE and norm == "height_l1" else 0.0
        return sharp + _richardson([getattr(c, norm) for c in self.steps])

    def _sharp(self) -> float:
        """Return the change of ∫|u| dx if vertical steps move by a cell: nodes do not resolve a smaller distance."""
        run = self.runs[-1]
        heights = [sum(step.height for step in run.steps_at(i)) for i in range(run.time.size)]
        return float(np.ptp(run.x)) / run.cells * max(heights)

    def converges(self, norm: str = "height_l1") -> bool:
        """Return True if heights, or slopes, converge at least with the order of the theory."""
        away = [getattr(c, norm) for c in self.steps]
        return max(away) <= ABSOLUTE_ROUNDING or observed_order(self.cells[1:], away) >= WORST_ORDER


@dataclass(frozen=True)
class Judged:
    """The ladders of a case; `represented` is True if enough grids represent its profile at t = 0.

    An order is a statement on the solver only if the grids represent the profile. If the pieces of a survey are
    narrower than the cells, each finer grid solves a different profile.
    """

    problem: Problem
    ladders: dict[str, Ladder]
    represented: bool

    def resolved(self, norm: str = "height_l1") -> bool:
        """Return True if the grids represent the profile and a first-order method converges in the norm."""
        first_order = [one for one in self.ladders.values() if one.method in CONVERGING or one.method == "telescoping"]
        return self.represented and any(one.converges(norm) for one in first_order)

    def change(self, norm: str) -> float:
        """Return the L1 norm of the change of heights, or of slopes, since the start, the mean over the saved times."""
        run = self.ladders["conservative"].runs[-1]
        moved = (
            np.diff(run.u - run.u[0], axis=1) if norm == "slope_l1" else (run.u - run.u[0]) * np.ptp(run.x) / run.cells
        )
        return float(np.mean(np.abs(moved).sum(axis=1)))


def _richardson(steps: Sequence[float]) -> float:
    """Return the error of the finest of several grids, each twice as fine as the last, from their differences.

    It is the largest of the estimates from each difference, because the last one can be small by chance.
    """
    order = observed_order([2**i for i in range(len(steps))], steps)
    order = min(max(order, WORST_ORDER), BEST_ORDER) if np.isfinite(order) else WORST_ORDER
    fall = 2.0 ** (-order * np.arange(len(steps))[::-1])
    return float(np.max(fall * steps)) / (2.0**order - 1.0)


def _completed(runs: Runs, coarse: set[int], decides: bool) -> Iterator[Check]:
    """Check that every run reached the end and satisfied the bounds of its method; the error counts the failures.

    A run that stops on a grid that does not represent the profile is no evidence against the solver: the comparison is
    open. It `decides` if too few grids remain for the others.
    """
    for method in dict.fromkeys(m for m, _ in runs):
        mine = {n: r for (m, n), r in runs.items() if m == method}
        stopped = {n: r.status for n, r in mine.items() if not r.done}
        violated = {n: sum(not b.holds for b in r.bounds.values()) for n, r in mine.items()}
        broken = [float(n in stopped) + violated[n] for n in mine]
        excused = set(stopped) <= coarse and not sum(violated.values())
        rule = next(iter(stopped.values()), "every run ends and satisfies its bounds")
        yield Check(f"bounds:{method}", list(mine), broken, None, 0.0, excused, rule, not stopped, decides=decides)


def _bounded(name: str, cells: int, error: float, threshold: float, rule: str) -> Check:
    """Return a Check of an error against a threshold."""
    return Check(name, [cells], [error], None, threshold, bool(error <= threshold), rule)


def _within(
    name: str, cells: list[int], error: list[float], estimate: float, sound: bool, resolved: bool, decides: bool = True,
    change: float = np.inf,
) -> Check:  # fmt: skip
    """Compare the distance of two solutions on the finest grid with the sum of their estimated errors.

    If the profile is not `resolved`, an estimate is unreliable, and a distance that exceeds it leaves the comparison
    open. It fails if one of the solutions is not `sound`, that is, if it does not converge although a less accurate one
    does. A distance that converges is evidence that both solutions do. A threshold above the `change` of the solution
    since the start leaves the comparison open, because a slope that never changes would pass.
    """
    allowed = SAFETY * estimate + ABSOLUTE_ROUNDING
    near = bool(error[-1] <= allowed)
    order = _finite(observed_order(cells, error))
    if resolved and not sound and (order is None or order < WORST_ORDER):
        rule = "does not converge, though the profile is resolved"
        return Check(name, cells, error, order, allowed, False, rule)
    rule = f"at most {allowed:.2g}, {SAFETY:g} times the estimated errors"
    if near and SAFETY * estimate > change + ABSOLUTE_ROUNDING:
        rule = f"the threshold {allowed:.2g} exceeds the change of the profile, {change:.2g}"
        return Check(name, cells, error, order, allowed, True, rule, False, decides=decides)
    return Check(name, cells, error, order, allowed, near or not resolved, rule, near or resolved, decides=decides)


def _identity(runs: Runs, finest: int, method: str, problem: Problem, coarse: bool) -> Check:
    """Compare D u - 1 - q with the rounding of u over Δx, summed over the steps at random, and steep slopes.

    An error δ of q in one cell changes ln K to its left by Δx f'(q) δ, and with it each flux there.
    """
    a, b = runs[method, finest], runs[f"conservative-{method}", finest]
    if coarse and not (a.done or b.done):  # both forms stop, as `bounds` reports
        return Check(f"identity:{method}", [finest], [np.inf], None, 0.0, True, a.status, False, decides=False)
    steep = 1.0 + float(np.abs(a.q).max())
    dx = float(np.ptp(a.x)) / a.cells
    passed_on = 1.0 + dx * float(np.max(problem.law.derivative(a.q)))
    rounding = EPS * (steep + float(np.abs(a.u).max()) / dx) * np.sqrt(max(a.steps, a.cells))
    allowed = 8.0 * rounding * steep * passed_on
    error = compare(a, b).slope_max if a.done and b.done else np.inf
    return _bounded(f"identity:{method}", finest, error, allowed, f"max |D u - 1 - q| <= {allowed:.1g}, to rounding")


def _independence(judged: Judged) -> Iterator[Check]:
    """Compare each method with the second-order conservative one, which shares nothing with those of first order."""
    other = judged.ladders["conservative"]
    for method, one in judged.ladders.items():
        if one is other:
            continue
        apart = [compare(a, b) for a, b in zip(one.runs, other.runs, strict=True)]
        for name, norm in (("q", "slope_l1"), ("u", "height_l1")):
            estimate = one.estimate(norm) + other.estimate(norm)
            sound = other.converges() or not one.converges()
            distances = [getattr(c, norm) for c in apart]
            yield _within(f"independence:{method}:{name}", one.cells, distances, estimate, sound,
                          judged.resolved(norm), one.decides and name == "u", judged.change(norm))  # fmt: skip
        distances = [c.kinks for c in apart]
        steps = [c.kinks for c in (*one.steps, *other.steps)]
        if np.all(np.isfinite([*distances, *steps])):
            cell = float(np.ptp(other.runs[-1].x)) / other.cells[-1]  # a kink is located within one, by either
            estimate = one.estimate("kinks") + other.estimate("kinks") + cell
            yield _within(f"kinks:{method}", one.cells, distances, estimate, True, judged.resolved(), one.decides)


def _finite(order: float) -> float | None:
    """Return the order, or None if it is not finite."""
    return order if np.isfinite(order) else None


class Witness(NamedTuple):
    """A run without a grid, an estimate of its ∫|u - u_exact| dx, and the comparison of fronts with characteristics."""

    run: Run
    estimate: float
    fronts: Check | None

    @property
    def confirmed(self) -> bool:
        """True if fronts and characteristics agree."""
        return self.fronts is not None and self.fronts.passes and self.fronts.resolved


def _third_witness(problem: Problem, fine: Grid) -> Witness | None:
    """Return the solution by characteristics, or else by fronts; None if neither reaches its end within its bounds."""
    tracked: list[Run] = []
    with suppress(RunError):
        tracked = [track_fronts(problem, fine, n) for n in FRONTS]
    fronts = Ladder("fronts", tracked) if tracked else None
    exact = None
    with suppress(RunError, InputError):
        exact = solve_characteristics(problem, fine, WITNESS)
    usable = fronts is not None and all(_sound(f) for f in tracked)
    if exact is None or not _sound(exact):
        return Witness(tracked[-1], fronts.estimate("height_l1"), None) if fronts and usable else None
    estimate = (exact.error_estimate or 0.0) * float(np.ptp(exact.x))
    if fronts is None or not usable:
        return Witness(exact, estimate, None)
    away = [compare(f, exact).height_l1 for f in tracked]
    allowed = fronts.estimate("height_l1") + estimate
    resolved = max(c.height_l1 for c in fronts.steps) < 1.0
    check = _within("characteristics:fronts:u", [*FRONTS], away, allowed, True, resolved)
    return Witness(exact, estimate, check._replace(unit="fronts"))


def _own_witness(witness: Witness | None, method: str, cells: int) -> Iterator[Check]:
    """Leave the case open if its own method is one without a grid that does not resolve the profile."""
    if method in ("fronts", "characteristics") and not (witness and (witness.fronts or witness.run.method == method)):
        yield _unsolved(method, cells)


def _unsolved(method: str, cells: int) -> Check:
    """Return the open comparison of a method without a grid that does not solve the case."""
    rule = f"the method {method} does not reach its end, or its data do not represent the profile"
    return Check(f"bounds:{method}", [cells], [1.0], None, 0.0, True, rule, resolved=False)


def _against(witness: Witness, judged: Judged) -> Iterator[Check]:
    """Compare the solvers on grids that decide, and the case's own, with a witness."""
    if witness.fronts:
        yield witness.fronts
    run = witness.run
    yield from records(run, judged.problem, None, f":{run.method}")
    some = any(one.converges() for one in judged.ladders.values() if one.method != "conservative")
    for method, one in judged.ladders.items():
        if one.decides or method in (ROBUST_METHOD, "telescoping", "conservative", INVERSE):
            away = [compare(mine, run).height_l1 for mine in one.runs]
            estimate = one.estimate("height_l1") + witness.estimate
            sound = one.converges() or not some
            yield _within(f"{run.method}:{method}:u", one.cells, away, estimate, sound, judged.resolved(), one.decides,
                          judged.change("height_l1"))  # fmt: skip


def _sound(run: Run) -> bool:
    """Return True if a run reached its end without cautions and with all bounds satisfied."""
    return run.done and not run.cautions and all(b.holds for b in run.bounds.values())


def _second_order(problem: Problem, cfl: float, methods: Sequence[str]) -> Iterator[Check]:
    """Measure orders of methods of higher order under the case's law, on a smooth bump before it breaks."""
    speed = float(problem.law.derivative(0.0))
    bump = Problem(problem.law, bumps(**SMOOTH), end=SMOOTH_END / speed, snapshots=2)
    grids = [Grid(-8.0, n) for n in SMOOTH_CELLS]
    try:
        exact = solve_characteristics(bump, grids[-1], WITNESS)
    except RunError:
        return
    if not _sound(exact):
        return
    for method in methods:
        runs = [solve_with(METHODS[method], bump, g, cfl) for g in grids]
        error = [compare(run, exact).height_l1 if run.done else np.inf for run in runs]
        order = observed_order(SMOOTH_CELLS, error)
        rule = f"order >= {ORDER_SMOOTH:g} on a smooth bump under this law"
        passes = bool(order >= ORDER_SMOOTH)
        yield Check(f"order:{method}", [*SMOOTH_CELLS], error, _finite(order), ORDER_SMOOTH, passes, rule)


def _budgets(runs: Runs, judged: Judged) -> Iterator[Check]:
    """Compare the eroded volume with ∫(K(left) - 1) dt: equal to rounding, or with an error that converges."""
    for method, one in judged.ladders.items():
        if method == INVERSE:  # its time steps are few, and saved times shorten them: its bound is checked instead
            continue
        error = [r.volume_budget_error for r in one.runs]
        if method not in CONVERGING and max(error) <= ABSOLUTE_ROUNDING:
            yield _bounded(f"budget:{method}", one.cells[-1], error[-1], ABSOLUTE_ROUNDING, "to rounding")
        else:
            estimate = _richardson([abs(a - b) for a, b in pairwise(error)])
            yield _within(f"budget:{method}", one.cells, error, estimate, True, judged.resolved(), one.decides)
    finest = judged.ladders["conservative"].cells[-1]
    telescoping = runs["telescoping", finest]
    if "telescoping" not in judged.ladders and telescoping.done:
        error = [telescoping.volume_budget_error]
        yield _bounded("budget:telescoping", finest, error[0], ABSOLUTE_ROUNDING, "to rounding")
