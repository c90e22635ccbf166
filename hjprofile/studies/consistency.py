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
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.case import Case, load_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.model import LinearGrowth, Prescribed
from hjprofile.problem.profiles import bumps
from hjprofile.problem.ranges import instance
from hjprofile.solvers.method import Feature, Form, require, requirements
from hjprofile.solvers.methods import METHODS, find_method
from hjprofile.solvers.run import Run
from hjprofile.solvers.solve import solve_characteristics, solve_conservative, solve_with, track_fronts
from hjprofile.solvers.stop import ROBUST_METHOD
from hjprofile.studies.accuracy import Comparison, compare, observed_order
from hjprofile.studies.records import EPS, QUIET, Check, records

# Methods of first order for u whose orders are measured; `telescoping` conserves the volume exactly
CONVERGING = tuple(
    name for name, method in METHODS.items() if method.form is Form.HEIGHT and method.flux and name != "telescoping"
)
LEAST_CELLS, MOST_CELLS = 2000, 4000  # limits for the finest grid; orders on coarser ones are misleading

ABSOLUTE_ROUNDING = 1e-10  # allowance for volumes and distances
SAFETY = 2.0  # factor of estimates from three differences: the error of a kink depends on its position in a cell
WORST_ORDER = 0.5  # order of the theory in L1; below it a run is not in its asymptotic range
BEST_ORDER = 1.0  # order of any method on a fixed grid across a kink
WITNESS = 1e-9  # tolerance of characteristics: far below the error of any grid here
FRONTS = (400, 800, 1600)
ORDER_SMOOTH = 1.5  # smallest order of a second-order method on smooth data; measured: 1.9 to 2.1; first-order: 1.0
# A smooth bump, which does not break before this time under any of the laws with f'(0) = 1
SMOOTH = {"amplitudes": [0.3], "centres": [-3.0], "widths": [1.0]}
SMOOTH_END, SMOOTH_CELLS = 0.5, (200, 400, 800)


Runs = dict[tuple[str, int], Run]


@dataclass(frozen=True, repr=False)
class Consistency:
    """The consistency test of one case: true if every comparison passes; as text, a line for each.

    In a test suite, `assert hj.check("my_case.toml")` shows the failed comparisons.
    """

    case: str
    title: str
    comparisons: Sequence[Check]

    @property
    def passes(self) -> bool:
        """True if every comparison passes."""
        return all(c.passes for c in self.comparisons)

    def __bool__(self) -> bool:
        return self.passes

    def __str__(self) -> str:
        shown = [c for c in self.comparisons if not c.name.startswith(QUIET) or not c.passes]
        lines = [f"{self.case}: {'passes' if self.passes else 'FAILS'}", *(c.line() for c in shown)]
        return "\n  ".join([*lines, *(f"WARNING: {sentence}" for sentence in self.warnings)])

    @property
    def warnings(self) -> list[str]:
        """A sentence if the grids are too coarse for some comparisons."""
        unclear = [c.name for c in self.comparisons if not c.resolved]
        if not unclear:
            return []
        return [f"the profile is not resolved on these grids, which leaves {', '.join(unclear)} open; use more cells"]

    def __repr__(self) -> str:
        failed = [" ".join(c.line().split()) for c in self.comparisons if not c.passes]
        return f"<{self.case}: {'; '.join(failed) or 'passes'}>"

    def report(self) -> dict[str, Any]:
        """Return the entry of `check.json`."""
        comparisons = [c._asdict() for c in self.comparisons]
        about = {"case": self.case, "title": self.title, "passes": self.passes, "warnings": self.warnings}
        return about | {"comparisons": comparisons}


def check(case: Case | str | Path, progress: Callable[[float], None] | None = None) -> Consistency:
    """Run the consistency test of a case: the Hamilton-Jacobi equation against the conservation law.

    - `case`: a `Case`, the path of a case file, or the name of a shipped case.
    - `progress`: a function that is called with the completed fraction in [0, 1].

    Return a `Consistency`, which is true if all comparisons pass. Raise InputError for invalid input, and RunError if a
    reference solution fails.

    >>> import hjprofile as hj
    >>> bool(hj.check("travelling_kink"))  # doctest: +SKIP
    True
    """
    case = case if isinstance(case, Case) else load_case(case)
    comparisons = check_consistency(case.problem, case.grid, case.cfl, progress, case.refresh, case.method)
    return Consistency(case.name, case.problem.title, comparisons)


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
    - `method`: a method on a grid that is not compared; its bounds and its saved data are tested.

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
    require("the consistency test", set(Feature) - {Feature.LAYER}, requirements(problem, refresh))
    steep = isinstance(problem.model, LinearGrowth)
    finest = min(max(grid.cells, LEAST_CELLS), MOST_CELLS) // 8 * 8
    ladder = [finest // 8, finest // 4, finest // 2, finest]
    ordered = ("telescoping", "conservative") if steep else (*CONVERGING, "conservative")
    plan = [(m, n) for m in ordered for n in ladder]
    carried = () if steep else CONVERGING
    plan += [(m, finest) for m in ("telescoping", *(f"conservative-{m}" for m in (*carried, "telescoping")))]
    chosen = find_method(method) if method else None
    if chosen and chosen.on_grid and chosen.supports >= requirements(problem, refresh):
        plan.append((chosen.name, finest))
    plan = list(dict.fromkeys(plan))
    runs: Runs = {}
    for i, (name, cells) in enumerate(plan):
        runs[name, cells] = solve_with(METHODS[name], problem, replace(grid, cells=cells), cfl, refresh=refresh)
        if progress:
            progress((i + 1) / len(plan))
    checks = [*_completed(runs)]
    for (name, cells), run in runs.items():
        if cells == finest and run.done:
            checks += records(run, problem, refresh, f":{name}")
    checks += [_identity(runs, finest, m) for m in (*carried, "telescoping")]
    if not all(run.done for run in runs.values()):
        return checks
    if not all(c.passes for c in checks if c.name.startswith("saved-times")):
        return checks  # runs at other times cannot be compared
    ladders = {m: Ladder(m, [runs[m, n] for n in ladder]) for m in ordered}
    resolved = any(one.converges for one in ladders.values() if one.method in carried or steep)
    checks += _independence(ladders, resolved)
    if not isinstance(problem.model, Prescribed) and refresh is None:
        checks += [*_budgets(runs, ladders, resolved), *_third_witness(ladders, problem, grid, resolved)]
        checks += _second_order(problem, cfl) if not steep else []
    return checks


@dataclass(frozen=True)
class Ladder:
    """Runs by one method on grids of which each is twice as fine as the one before."""

    method: str
    runs: Sequence[Run]

    @property
    def cells(self) -> list[int]:
        """The numbers of cells."""
        return [r.cells for r in self.runs]

    @cached_property
    def steps(self) -> list[Comparison]:
        """The distances of each run from the next finer one."""
        return [compare(a, b) for a, b in pairwise(self.runs)]

    def estimate(self, norm: str) -> float:
        """Return Richardson's estimate of the error of the finest run."""
        return _richardson([getattr(c, norm) for c in self.steps])

    @property
    def converges(self) -> bool:
        """True if heights converge at least with the order of the theory."""
        away = [c.height_l1 for c in self.steps]
        return max(away) <= ABSOLUTE_ROUNDING or observed_order(self.cells[1:], away) >= WORST_ORDER


def _richardson(steps: Sequence[float]) -> float:
    """Return the error of the finest of several grids, each twice as fine as the last, from their differences.

    It is the largest of the estimates from each difference, because the last one can be small by chance.
    """
    order = observed_order([2**i for i in range(len(steps))], steps)
    order = min(max(order, WORST_ORDER), BEST_ORDER) if np.isfinite(order) else WORST_ORDER
    fall = 2.0 ** (-order * np.arange(len(steps))[::-1])
    return float(np.max(fall * steps)) / (2.0**order - 1.0)


def _completed(runs: Runs) -> Iterator[Check]:
    """Check that every run reached the end and satisfied the bounds of its method; the error counts the failures."""
    for method in dict.fromkeys(m for m, _ in runs):
        mine = {n: r for (m, n), r in runs.items() if m == method}
        broken = [float(not r.done) + sum(not b.holds for b in r.bounds.values()) for r in mine.values()]
        stopped = [r.status for r in mine.values() if not r.done]
        rule = stopped[0] if stopped else "every run ends and satisfies its bounds"
        yield Check(f"bounds:{method}", list(mine), broken, None, 0.0, sum(broken) == 0, rule)


def _bounded(name: str, cells: int, error: float, threshold: float, rule: str) -> Check:
    """Return a Check of an error against a threshold."""
    return Check(name, [cells], [error], None, threshold, bool(error <= threshold), rule)


def _within(name: str, cells: list[int], error: list[float], estimate: float, sound: bool, resolved: bool) -> Check:
    """Compare the distance of two solutions on the finest grid with the sum of their estimated errors.

    If the profile is not `resolved`, an estimate is unreliable, and the comparison stays open. It fails if one of the
    solutions is not `sound`, that is, if it does not converge although a less accurate one does.
    """
    allowed = SAFETY * estimate + ABSOLUTE_ROUNDING
    near = bool(error[-1] <= allowed)
    order = _finite(observed_order(cells, error))
    if resolved and not sound:
        return Check(name, cells, error, order, allowed, False, "does not converge, though the profile is resolved")
    rule = f"at most {allowed:.2g}, {SAFETY:g} times the estimated errors"
    return Check(name, cells, error, order, allowed, near or not resolved, rule, near or resolved)


def _identity(runs: Runs, finest: int, method: str) -> Check:
    """Compare D u - 1 - q with the rounding of u over Δx, summed over the steps at random, and steep slopes."""
    a, b = runs[method, finest], runs[f"conservative-{method}", finest]
    steep = 1.0 + float(np.abs(a.q).max())
    dx = float(np.ptp(a.x)) / a.cells
    allowed = 8.0 * EPS * (steep + float(np.abs(a.u).max()) / dx) * np.sqrt(max(a.steps, a.cells)) * steep
    error = compare(a, b).slope_max if a.done and b.done else np.inf
    return _bounded(f"identity:{method}", finest, error, allowed, f"max |D u - 1 - q| <= {allowed:.1g}, to rounding")


def _independence(ladders: dict[str, Ladder], resolved: bool) -> Iterator[Check]:
    """Compare each Hamilton-Jacobi method with the second-order conservative one, which shares nothing with it."""
    other = ladders["conservative"]
    for method in (m for m in ladders if m in CONVERGING):
        one = ladders[method]
        apart = [compare(a, b) for a, b in zip(one.runs, other.runs, strict=True)]
        for name, norm in (("q", "slope_l1"), ("u", "height_l1")):
            estimate = one.estimate(norm) + other.estimate(norm)
            sound = other.converges or not one.converges
            distances = [getattr(c, norm) for c in apart]
            yield _within(f"independence:{method}:{name}", one.cells, distances, estimate, sound, resolved)
        distances = [c.kinks for c in apart]
        steps = [c.kinks for c in (*one.steps, *other.steps)]
        if np.all(np.isfinite([*distances, *steps])):
            cell = float(np.ptp(other.runs[-1].x)) / other.cells[-1]  # a kink is located within one, by either
            estimate = one.estimate("kinks") + other.estimate("kinks") + cell
            yield _within(f"kinks:{method}", one.cells, distances, estimate, True, resolved)


def _finite(order: float) -> float | None:
    """Return the order, or None if it is not finite."""
    return order if np.isfinite(order) else None


def _third_witness(ladders: dict[str, Ladder], problem: Problem, grid: Grid, resolved: bool) -> Iterator[Check]:
    """Compare both solvers with characteristics, or else with fronts, which solve neither form on a grid.

    The comparison is left out if a flux enters, or if the witness itself does not reach its end within its bounds.
    """
    if problem.profile.inflow:
        return
    fine = replace(grid, cells=ladders["conservative"].cells[-1])
    try:
        tracked = [track_fronts(problem, fine, n) for n in FRONTS]
        steps = [compare(a, b).height_l1 for a, b in pairwise(tracked)]
        fronts_estimate = _richardson(steps)
        witnesses = [w for w in tracked[-1:] if all(_sound(f) for f in tracked)]
    except RunError:
        witnesses = []
    exact = None
    with suppress(RunError, InputError):
        exact = solve_characteristics(problem, fine, WITNESS)
    if exact and _sound(exact):
        estimate = (exact.error_estimate or 0.0) * float(np.ptp(exact.x))
        if witnesses:
            away = [compare(f, exact).height_l1 for f in tracked]
            allowed = fronts_estimate + estimate
            yield _within("characteristics:fronts:u", [*FRONTS], away, allowed, True, max(steps) < 1.0)._replace(
                unit="fronts"
            )
        witness = exact
    elif witnesses:
        witness, estimate = witnesses[0], fronts_estimate
    else:
        return
    yield from records(witness, problem, None, f":{witness.method}")
    for method in (ROBUST_METHOD, "telescoping", "conservative"):
        if one := ladders.get(method):
            away = [compare(run, witness).height_l1 for run in one.runs]
            sound = one.converges or not any(o.converges for o in ladders.values() if o.method != "conservative")
            yield _within(f"{witness.method}:{method}:u", one.cells, away, one.estimate("height_l1") + estimate, sound,
                          resolved)  # fmt: skip


def _sound(run: Run) -> bool:
    """Return True if a run reached its end without cautions and with all bounds satisfied."""
    return run.done and not run.cautions and all(b.holds for b in run.bounds.values())


def _second_order(problem: Problem, cfl: float) -> Iterator[Check]:
    """Measure the order of the second-order method under the case's law, on a smooth bump before it breaks."""
    speed = float(problem.law.derivative(0.0))
    bump = Problem(problem.law, bumps(**SMOOTH), end=SMOOTH_END / speed, snapshots=2)
    grids = [Grid(-8.0, n) for n in SMOOTH_CELLS]
    try:
        exact = solve_characteristics(bump, grids[-1], WITNESS)
    except RunError:
        return
    if not _sound(exact):
        return
    error = [compare(solve_conservative(bump, g, cfl=cfl), exact).height_l1 for g in grids]
    order = observed_order(SMOOTH_CELLS, error)
    rule = f"order >= {ORDER_SMOOTH:g} on a smooth bump under this law"
    yield Check("order:conservative", [*SMOOTH_CELLS], error, _finite(order), ORDER_SMOOTH,
                bool(order >= ORDER_SMOOTH), rule)  # fmt: skip


def _budgets(runs: Runs, ladders: dict[str, Ladder], resolved: bool) -> Iterator[Check]:
    """Compare the eroded volume with ∫(K(left) - 1) dt: equal to rounding, or with an error that converges."""
    for method, one in ladders.items():
        error = [r.volume_budget_error for r in one.runs]
        if method not in CONVERGING and max(error) <= ABSOLUTE_ROUNDING:
            yield _bounded(f"budget:{method}", one.cells[-1], error[-1], ABSOLUTE_ROUNDING, "to rounding")
        else:
            estimate = _richardson([abs(a - b) for a, b in pairwise(error)])
            yield _within(f"budget:{method}", one.cells, error, estimate, True, resolved)
    if "telescoping" not in ladders:
        finest = ladders["conservative"].cells[-1]
        error = [runs["telescoping", finest].volume_budget_error]
        yield _bounded("budget:telescoping", finest, error[0], ABSOLUTE_ROUNDING, "to rounding")
