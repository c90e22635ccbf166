"""Study of continuous dependence on the initial data and on the coefficient.

The study evaluates an estimate of the proof in the paper. For two solutions with coefficients k and k̃ (§9)

    ‖q - q̃‖₁(t) <= ‖q - q̃‖₁(0) + ∫_0^t E dτ ,      E = ‖k - k̃‖_∞ TV(f(q̃)) + TV(k - k̃) sup|f(q̃)| ,

which is (2.23) with its constants. With k = K(q), k̃ = K(q̃) it is the step before the Gronwall lemma
that gives (1.10).

Both solutions of a pair use the same time steps. So with one prescribed coefficient E = 0, and the scheme, which is
monotone and conservative, increases no distance except by rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.case_keys import DEFAULT_CFL
from hjprofile.problem.coefficient import Coefficient, tabulated
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.given import profile
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import instance
from hjprofile.problem.schema import with_origin
from hjprofile.solvers.method import Feature, require, requirements
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.run import Array, Breakdown, Halt, Run
from hjprofile.solvers.solve import solve_hj
from hjprofile.solvers.stop import ROBUST_METHOD
from hjprofile.studies.accuracy import observed_order
from hjprofile.studies.fractional import fractional_steps
from hjprofile.studies.proved_constant import proof

METHOD = ROBUST_METHOD  # a monotone method: the contractions of the theory hold for it too
CELLS = 1000
MOMENTS = 41  # number of saved times, ends included, over which E is integrated
SIZES = (0.3, 0.03, 0.003)  # sizes of a disturbance, as fractions of ‖q‖₁ (of 1 if that is smaller)
PAIRS = 8  # pairs of each size
PARTS = (0.2, 0.05, 0.0125)  # relative disturbances of a coefficient
WAVES = 4  # number of disturbances of a coefficient, each a sum of SUMMANDS
SUMMANDS = 3
REFRESHES = (64, 32, 16, 8)  # lengths of a fractional step, in mean time steps
TIMES_OF_K = 17  # number of times at which a coefficient is compared with itself
PIECES = 4  # largest number of pieces of a piecewise constant disturbance
NOTHING = 1e-12  # |q| of a slope that is neutral to rounding
BOUND_EXCESS = 1e-9  # relative excess of a distance over its bound that counts as rounding
FASTER = 0.02  # relative increase of the speed that a batch of steps allows
SHARE = 0.5  # largest disturbance as a fraction of 1 + q


class Distance(NamedTuple):
    """‖q - q̃‖₁ of one pair at one time.

    Attributes:
        study: "data" (two slopes), "zero" (a slope and the neutral one), "coefficient" (k and a disturbed k), "refresh"
            (K in every step and frozen in fractional steps; a mean over time), "refresh kinks" (the same, the distance
            of kinks; NaN if there are none).
        member: number of the pair.
        size: ‖q - q̃‖₁ at t = 0; the largest relative disturbance of k; the fractional step.
        bound: upper bound of `distance`: see the module; for "zero" ‖q‖₁ at t = 0; NaN for fractional steps.
        constant: L with ‖q - q̃‖₁ <= e^{Lt} ‖q - q̃‖₁(0) from the data of the pair alone (§9); 0 for "zero" and for pairs
            with one prescribed coefficient; NaN for the other studies.
    """

    case: str
    study: str
    member: int
    size: float
    time: float
    distance: float
    bound: float
    constant: float = np.nan


@dataclass(frozen=True)
class Dependence:
    """Results of the study.

    Attributes:
        case: the name of the problem.
        rows: the distances, by pair and time.
        found: a sentence on each study.
        violated: a sentence on a distance that exceeds its bound, or "".
    """

    case: str
    rows: tuple[Distance, ...]
    found: tuple[str, ...]
    violated: str

    @property
    def holds(self) -> bool:
        """True if no distance exceeds its bound."""
        return not self.violated

    def __str__(self) -> str:
        return "\n".join(self.found)


def dependence(
    problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None, name: str = ""
) -> Dependence:
    """Measure the distances of solutions with close initial data or close coefficients, and their bounds.

    The method is `godunov` on 1000 cells. The study takes about ten seconds.

    Args:
        problem: slow erosion on the half line, with K or with a prescribed coefficient.
        grid: its left end is used.
        progress: a function that is called with the completed fraction in [0, 1].
        name: the name of the problem in the rows and in messages; its title by default.

    Returns:
        The distances and bounds, and a sentence on each study.

    Raises:
        InputError: for another model, if a flux enters, if the end is 0, or if the slope is neutral at all saved times
            except the first.
        RunError: if a run stops.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [0.8]), end=1.0)
    >>> hj.dependence(problem, hj.Grid(-5.0, 200)).holds  # doctest: +SKIP
    True
    """
    instance("problem", problem, Problem)
    instance("name", name, str)
    case = name or problem.title or "the problem"
    rows = distances_of(case, problem, grid, progress)
    found, violated = summary(rows)
    return Dependence(case, tuple(rows), tuple(found), violated)


def distances_of(
    case: str, problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None
) -> list[Distance]:
    """Disturb the problem's profile, then its coefficient, and measure the distances of the solutions.

    The method is METHOD on CELLS cells. Raise InputError if a flux enters, if the end is 0, or if the slope is neutral
    at all saved times except the first. Raise RunError if a run stops.
    """
    instance("problem", problem, Problem)
    instance("grid", grid, Grid)
    require(f"{case}: the study of dependence", {Feature.COEFFICIENT}, requirements(problem))
    if not problem.end > 0.0:
        raise InputError(f"{case}: end = 0; the study of dependence needs an end above 0")
    study = _Study(case, replace(problem, snapshots=MOMENTS), Grid(grid.left, CELLS))
    found: list[Distance] = []
    total = len(SIZES) * PAIRS + len(PARTS) * WAVES + len(REFRESHES)
    for i, rows in enumerate(chain(study.pairs(), study.coefficients(), study.refreshes())):
        found += rows
        if progress:
            progress((i + 1) / total)
    return found


class Path(NamedTuple):
    """One of two solutions with the same time steps, at the saved times: q on cells, K and x on nodes."""

    time: Array
    x: Array
    q: Array
    K: Array


def solve_together(first: Problem, second: Problem, grid: Grid) -> tuple[Path, Path]:
    """Solve two problems by METHOD with the same time steps, limited by the faster of the two.

    They share their saved times. Raise Breakdown or Halt if one of them cannot continue.
    """
    setup = METHODS[METHOD].setup
    assert setup is not None
    schemes = [setup.scheme(problem, grid, None) for problem in (first, second)]
    rows: list[tuple[list[Array], list[Array]]] = [([], []), ([], [])]
    t = 0.0

    def evaluate() -> float:
        for one in schemes:
            one.factor.t = t
        return max([one.evaluate() for one in schemes])

    speed = evaluate()
    for target in first.times:
        while t < target:
            bound = speed * (1.0 + FASTER)
            remaining = float(target) - t
            steps = max(1, math.ceil(remaining * bound / (DEFAULT_CFL * schemes[0].cfl_limit * grid.dx)))
            batch = min(steps, *(one.factor.steps for one in schemes))
            dt = remaining / steps
            largest_speed = max([one.advance(dt, batch, bound) for one in schemes])
            if bound < largest_speed < np.inf:  # repeat with shorter steps
                for one in schemes:
                    one.roll_back()
                speed = largest_speed
                continue
            t = float(target) if batch == steps else t + batch * dt
            speed = evaluate()
        for one, (q, K) in zip(schemes, rows, strict=True):
            q.append(one.q.copy())
            K.append(one.K.copy())
    left, right = (Path(first.times, grid.nodes, np.array(q), np.array(K)) for q, K in rows)
    return left, right


class _Study:
    """A problem on a grid, its solution, and a random generator with a fixed seed."""

    def __init__(self, case: str, problem: Problem, grid: Grid):
        self.case, self.problem, self.grid, self.rng = case, problem, grid, np.random.default_rng(0)
        self.q = problem.profile.q_means(grid, problem.law)
        self.base = solve_hj(problem, grid, METHOD)
        if not self.base.done:
            raise RunError(f"{case}: {self.base.status}")
        if not np.abs(self.base.q[1:]).max() > NOTHING:
            raise InputError(
                f"{case}: the slope is neutral from the first measurement on, at t = {self.base.time[1]:.6g}; "
                "set an earlier end"
            )
        self.scale = max(1.0, float(np.abs(self.q).sum()) * grid.dx)

    def solve(self, first: Problem, second: Problem) -> tuple[Path, Path]:
        """Return the solutions of two problems. Raises RunError if there are none."""
        try:
            return solve_together(first, second, self.grid)
        except Halt as halt:
            raise RunError(f"{self.case}: {halt}") from None
        except Breakdown as broken:
            x = self.grid.centres[broken.cell]
            raise RunError(
                f"{self.case}: a disturbed slope breaks down near x = {x:.6g}, where q = {broken.q:.6g}; "
                "K spans too many decades there, or q is too near -1"
            ) from None

    def from_means(self, q: Array) -> Problem:
        """Return the problem with the cell means q."""
        nodes, W = self.grid.nodes, np.append(0.0, np.cumsum(q) * self.grid.dx)
        return replace(self.problem, profile=profile(lambda x: x + np.interp(x, nodes, W)))

    def disturbance(self, size: float) -> Array:
        """Return a random piecewise constant function with the L1 norm `size`, limited so that 1 + q > 0.

        It is 0 in the first cells.
        """
        n = self.grid.cells
        edges = np.sort(self.rng.integers(n // 20, n + 1, self.rng.integers(2, PIECES + 2)))
        d = np.zeros(n)
        for a, b, value in zip(edges[:-1], edges[1:], self.rng.normal(size=edges.size - 1), strict=True):
            d[a:b] = value
        norm = float(np.abs(d).sum()) * self.grid.dx
        return np.maximum(d * (size / norm), -SHARE * (1.0 + self.q)) if norm > 0.0 else self.disturbance(size)

    def pairs(self) -> Iterator[list[Distance]]:
        """Compare the problem's slope with a disturbed one, and the disturbed one with the neutral slope."""
        member = 0
        for size in SIZES:
            for _ in range(PAIRS):
                member += 1
                disturbed = self.from_means(self.q + self.disturbance(size * self.scale))
                first, other = self.solve(self.problem, disturbed)
                yield self.rows("data", member, first, other) + self.to_zero(member, other)

    def coefficients(self) -> Iterator[list[Distance]]:
        """Compare the problem's own coefficient, or its K as a prescribed one, with the same coefficient plus waves."""
        given = self.problem.coefficient or tabulated(self.base.time, self.base.x, self.base.K)
        waves = [self.waves() for _ in range(WAVES)]
        for member, (part, wave) in enumerate(product(PARTS, waves), start=1):
            disturbed = with_origin(given, function=_times(given.function, part, wave), steady=False, content=None)
            pair = (replace(self.problem, coefficient=k) for k in (given, disturbed))
            first, other = self.solve(*pair)
            yield self.rows("coefficient", member, first, other, part)

    def waves(self) -> Callable[[Any, Any], Any]:
        """Return a random smooth function of t and x with absolute values up to 1."""
        heights = self.rng.dirichlet(np.ones(SUMMANDS))
        turns = self.rng.normal(scale=3.0, size=(SUMMANDS, 2)) / (self.problem.end, -self.grid.left)
        phases = self.rng.uniform(0.0, 2.0 * np.pi, SUMMANDS)
        return lambda t, x: sum(
            h * np.sin(2.0 * np.pi * (a * t + b * x) + p) for h, (a, b), p in zip(heights, turns, phases, strict=True)
        )

    def refreshes(self) -> Iterator[list[Distance]]:
        """Compare K updated in every step with K frozen over fractional steps: means over time (see `fractional`).

        No distance is yielded if the coefficient does not depend on time, because freezing it changes nothing.
        """
        if self.problem.coefficient is not None and self._does_not_change(self.problem.coefficient):
            return
        lengths = [self.problem.end * min(steps / max(self.base.steps, 1), 1.0) for steps in REFRESHES]
        found = fractional_steps(self.problem, self.grid, METHOD, lengths)
        for member, step in enumerate(found.steps, start=1):
            yield [
                Distance(self.case, study, member, step.refresh, self.problem.end, distance, np.nan)
                for study, distance in (("refresh", step.error_q_l1), ("refresh kinks", step.error_kink))
            ]

    def _does_not_change(self, k: Coefficient) -> bool:
        """Return True if k is declared steady, or has the same values at uneven times."""
        if k.steady:
            return True
        times = self.problem.end * np.sqrt(np.linspace(0.0, 1.0, TIMES_OF_K))  # even times could miss a period
        values = k.values(times[:, None], self.grid.nodes)
        return bool(np.array_equal(values, np.broadcast_to(values[0], values.shape)))

    def rows(self, study: str, member: int, first: Path, second: Path, size: float | None = None) -> list[Distance]:
        """Return the distances between two solutions; the size is that at the start unless another is given."""
        apart = self.grid.dx * np.abs(first.q - second.q).sum(axis=1)
        bound = distance_bound(self.problem.law, first, second)
        constant = np.nan
        if study == "data":
            own = self.problem.coefficient is None
            constant = proof(self.problem.law, first.q[0], second.q[0], self.grid.dx).constant if own else 0.0
        start = float(apart[0]) if size is None else size
        return [
            Distance(self.case, study, member, start, float(t), float(d), float(b), constant)
            for t, d, b in zip(first.time, apart, bound, strict=True)
        ]

    def to_zero(self, member: int, run: Path) -> list[Distance]:
        """Return the distances from the neutral slope, to which the flow is a contraction."""
        norm = self.grid.dx * np.abs(run.q).sum(axis=1)
        return [
            Distance(self.case, "zero", member, float(norm[0]), float(t), float(d), float(norm[0]), 0.0)
            for t, d in zip(run.time, norm, strict=True)
        ]


def _times(k: Callable[[Any, Any], Any], part: float, wave: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a coefficient times 1 + part * wave."""
    return lambda t, x: k(t, x) * (1.0 + part * wave(t, x))


def distance_bound(law: ErosionLaw, first: Run | Path, second: Run | Path) -> Array:
    """Return ‖q - q̃‖₁(0) + ∫E dτ (see the module) at the saved times of two solutions, with the smaller of two E."""
    dx = float(first.x[1] - first.x[0])
    apart = first.K - second.K
    variation = np.abs(np.diff(apart, axis=1)).sum(axis=1)
    rate = np.full(first.time.size, np.inf)
    for run in (first, second):
        f = law.f(run.q)
        E = np.abs(apart).max(axis=1) * np.abs(np.diff(f, axis=1)).sum(axis=1) + variation * np.abs(f).max(axis=1)
        rate = np.minimum(rate, E)
    start = dx * float(np.abs(first.q[0] - second.q[0]).sum())
    return start + np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(first.time)))


def largest_distances(distances: Sequence[Distance], study: str) -> dict[int, tuple[float, float]]:
    """Return number of a pair -> its size, and its largest distance over the saved times."""
    largest: dict[int, tuple[float, float]] = {}
    for d in distances:
        if d.study == study:
            largest[d.member] = d.size, max(largest.get(d.member, (d.size, -np.inf))[1], d.distance)
    return largest


def observed_constant(distances: Sequence[Distance]) -> float:
    """Return the smallest L with ‖q - q̃‖₁(t) <= e^{Lt} ‖q - q̃‖₁(0) for all distances (1.10)."""
    rates = (float(np.log(d.distance / d.size)) / d.time for d in distances if d.time > 0.0 and d.distance > 0.0)
    return max(rates, default=-np.inf)


def summary(distances: Sequence[Distance]) -> tuple[list[str], str]:
    """Return the results, a sentence for each study, and a sentence on a violated bound, or ""."""
    studies = {
        study: [d for d in distances if d.study == study] for study in ("data", "zero", "coefficient", "refresh")
    }
    pairs = {study: len({d.member for d in mine}) for study, mine in studies.items()}
    share = {
        study: max((d.distance / d.bound for d in mine if d.time > 0.0 and d.bound > 0.0), default=0.0)
        for study, mine in studies.items()
    }
    order = {
        study: -observed_order(*zip(*largest_distances(distances, study).values(), strict=True))
        if pairs[study]
        else np.nan
        for study in ("coefficient", "refresh")
    }
    kinks = largest_distances(distances, "refresh kinks").values()
    order_of_kinks = -observed_order(*zip(*kinks, strict=True)) if kinks else np.nan
    grows = "never grows" if share["zero"] <= 1.0 + BOUND_EXCESS else "GROWS"
    sentences = [
        f"data         {_line_on_pairs(studies['data'], share['data'])}",
        f"zero         ‖q‖₁ {grows}, {pairs['zero']} slopes",
        f"coefficient  ‖q - q̃‖₁ is {_in_words(order['coefficient'])} in k - k̃, {pairs['coefficient']} pairs; at most "
        f"{share['coefficient']:.2g} of the bound",
        f"refresh      ‖q - q̃‖₁ is {_in_words(order['refresh'])} in the fractional step"
        + (f", the distance of kinks of order {order_of_kinks:.2f}" if np.isfinite(order_of_kinks) else "")
        if pairs["refresh"]
        else "refresh      not applicable: the coefficient is constant in time",
    ]
    worst = max(("data", "zero", "coefficient"), key=lambda study: share[study])
    failed = f"a distance of the study {worst!r} is {share[worst]:.4g} times its bound"
    return sentences, failed if share[worst] > 1.0 + BOUND_EXCESS else ""


def _in_words(order: float) -> str:
    """Return the words for an observed order, which is NaN if a distance is 0."""
    return f"of order {order:.2f}" if np.isfinite(order) else "too small to have an order"


def _line_on_pairs(data: Sequence[Distance], share: float) -> str:
    """Return a line on the distances of pairs of slopes; a prescribed coefficient bounds them by those at the start."""
    pairs = len({d.member for d in data})
    if all(math.isclose(d.bound, d.size, rel_tol=BOUND_EXCESS) for d in data):
        return f"‖q - q̃‖₁ {'never grows' if share <= 1.0 + BOUND_EXCESS else 'GROWS'}, {pairs} pairs"
    L = [observed_constant([d for d in data if (d.member - 1) // PAIRS == i]) for i in range(len(SIZES))]
    each = ", ".join(f"{value:.3g}" for value in L)
    return (
        f"‖q - q̃‖₁ <= e^(Lt) ‖q - q̃‖₁(0) with L = {max(L):.3g} for {pairs} pairs ({each} from far to near); "
        f"at most {share:.2g} of the bound; L = {max(d.constant for d in data):.3g} from the data alone"
    )
