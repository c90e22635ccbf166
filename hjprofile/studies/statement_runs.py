"""Solutions for the study of statements: states at saved times, and sums over all time steps between them.

Every time step is a step of METHOD with a coefficient that is frozen for that step. The steps are short enough for the
method to be monotone between any two constants in the range of q. Sums over the steps therefore bound the states as the
integrals of the theory bound a solution, without an error of quadrature.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem import Problem
from hjprofile.problem.case_keys import DEFAULT_CFL
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.run import Array, Breakdown, Halt
from hjprofile.solvers.stop import ROBUST_METHOD
from hjprofile.studies.dependence import NOTHING

METHOD = ROBUST_METHOD  # a monotone method: the inequalities of the theory hold for each of its steps
MOMENTS = 41  # number of saved times, both ends included
FRACTIONAL_STEPS = 20  # number of intervals with a frozen coefficient
SECOND = 0.9  # q of the second slope relative to that of the first
SHIFTS = 64  # the shift h of (3.10) is the length of the domain divided by this number
SHORTEST = 1e-9  # T(δ, M) relative to the end, below which (3.5) is evaluated at t = 0 only
MOST_STEPS = 2_000_000  # on 1000 cells they take some ten minutes

NO_CELLS = np.empty(0)


class Local(NamedTuple):
    """The bounds of (3.5) with their constants: low <= q <= high until `end`, q with extremes `lowest` and `highest`.

    `end` is the time T(δ, M), or the end of the run if that is earlier. A bound is None if the data need none, because
    they have one sign.
    """

    end: float
    low: float | None
    high: float | None
    lowest: float
    highest: float

    def seen(self, q: Array) -> Local:
        """Return the bounds with the extremes of another state."""
        return self._replace(lowest=min(self.lowest, float(q.min())), highest=max(self.highest, float(q.max())))


class History(NamedTuple):
    """A solution at the saved times, a second one with its own coefficient, and one in between.

    Attributes:
        law, inflow: of the problem; nonlocal_: True unless k is prescribed.
        time: saved times, shape (times,); x: nodes, shape (cells + 1,).
        q, k: the solution on cells, and its coefficient on nodes, shape (times, cells) and (times, cells + 1).
        q2, k2: the second solution, which starts at SECOND times the excess slope; empty if a flux enters.
        middle: q of the solution with the data of the second and the coefficient of the first; empty if k2 = k.
        shift: the shift h of (3.10), in cells.
        sums: sums over the time steps up to each saved time, name -> shape (times,); see `_Sums`.
        local: the bounds of (3.5); None if k is prescribed or a flux enters.
    """

    law: ErosionLaw
    inflow: float
    nonlocal_: bool
    time: Array
    x: Array
    q: Array
    k: Array
    q2: Array
    k2: Array
    middle: Array
    shift: int
    sums: dict[str, Array]
    local: Local | None

    @property
    def dx(self) -> float:
        """The cell width."""
        return float(self.x[1] - self.x[0])

    @property
    def F(self) -> Array:
        """The flux k f(q) at the nodes, shape (times, cells + 1)."""
        return flux(self.law, self.q, self.k, self.inflow)


class FractionalStep(NamedTuple):
    """The flux F = k f(q) in an interval with a frozen coefficient, and at the refresh that follows.

    Attributes:
        start, end: times of the interval.
        maximum, variation: sup|F| and TV(F) at its start.
        largest_maximum, largest_variation: their largest values after the time steps of the interval.
        last_maximum, last_variation: at its end, before the refresh.
        next_maximum, next_variation: after the refresh.
        relative: sup|(k_new - k_old)/k_old|.
        coarse: sup|k_new - k_old| / inf k_old.
        relative_variation: TV((k_new - k_old)/k_old).
    """

    start: float
    end: float
    maximum: float
    variation: float
    largest_maximum: float
    largest_variation: float
    last_maximum: float
    last_variation: float
    next_maximum: float
    next_variation: float
    relative: float
    coarse: float
    relative_variation: float


def flux(law: ErosionLaw, q: Array, k: Array, inflow: float) -> Array:
    """Return F = k f(q) at the nodes: the upwind flux, and the inflow at the left end."""
    inner = k[..., 1:] * law.f(q)
    return np.concatenate([np.full((*inner.shape[:-1], 1), inflow), inner], axis=-1)


def total_variation(values: Array) -> Any:
    """Return the total variation along the last axis."""
    return np.abs(np.diff(values)).sum(axis=-1)


def maximum(values: Array) -> Any:
    """Return the largest modulus along the last axis."""
    return np.abs(values).max(axis=-1)


class _Stepper:
    """One scheme with a coefficient of its own, or that of another one."""

    def __init__(self, problem: Problem, grid: Grid, part: float = 1.0):
        setup = METHODS[METHOD].setup
        assert setup is not None
        self.scheme = setup.scheme(problem, grid, None)
        self.law, self.dx = problem.law, grid.dx
        if part != 1.0:  # in place, so that the active cells stay the same
            W = self.scheme.W
            W[:] = W[0] + part * (W - W[0])

    def at(self, t: float, k: Array = NO_CELLS) -> None:
        """Compute q, and the coefficient k unless it is given, and freeze k. Raise Breakdown or Halt."""
        factor = self.scheme.factor
        factor.t, factor.frozen_K = t, k
        self.scheme.evaluate()
        factor.frozen_K = self.k  # the next step uses exactly these values

    @property
    def q(self) -> Array:
        """A copy of q on the cells."""
        return self.scheme.q.copy()

    @property
    def k(self) -> Array:
        """A copy of the coefficient on the nodes."""
        return self.scheme.K.copy()


def _steps(steppers: Sequence[_Stepper], t: float, target: float) -> Iterator[tuple[float, float]]:
    """Advance all schemes to `target` with common time steps; yield the length of each, and the time after it.

    The caller evaluates the schemes after each step. Raise Breakdown or Halt.
    """
    done = 0
    while t < target:
        top = max([float(s.scheme.K.max()) for s in steppers])
        low = min([float(s.scheme.q.min()) for s in steppers])
        speed = top * float(steppers[0].law.derivative(np.array([low, 0.0])).max())
        left = target - t
        needed = left * speed / (DEFAULT_CFL * steppers[0].scheme.cfl_limit * steppers[0].dx)
        done += 1
        if not needed + done < MOST_STEPS:
            raise RunError(f"the study would need more than {MOST_STEPS:,} time steps from t = {t:.6g} on")
        dt = left / max(1, math.ceil(needed))
        for s in steppers:
            s.scheme.advance(dt, 1, speed)
        t = target if needed <= 1.0 else t + dt
        yield dt, t


def _stops(steppers: Sequence[_Stepper], t: float, target: float, between: float) -> Iterator[tuple[float, float]]:
    """Advance as `_steps`, and hit the time `between` exactly if it lies before `target`."""
    if t < between < target:
        yield from _steps(steppers, t, between)
        t = between
    yield from _steps(steppers, t, target)


class _Sums:
    """Sums over time steps, and products of growth factors; each attribute is the value so far.

    Attributes:
        variation: ∫ TV(F) dt.
        rate: ∫ sup|k_t/k| dt, the sum of the largest |Δ ln k| at a node (L₂ t of the paper).
        k_rate, k_variation_rate: the largest sup|Δk|/Δt and TV(Δk)/Δt.
        flux_variation: bound of TV(F) by products of (2.17).
        deepest, highest: bounds of sup[q]₋ and sup[q]₊ by (3.6) and (3.7).
        shifted: ∫ of the variation of (k - k(· - h)) f(q(· - h)) (3.10).
        apart: ∫ E dt (3.20).
    """

    NAMES = (
        "variation", "rate", "k_rate", "k_variation_rate", "flux_variation", "deepest", "highest", "shifted", "apart",
    )  # fmt: skip

    def __init__(self, law: ErosionLaw, inflow: float, dx: float, shift: int, q: Array, k: Array):
        self.law, self.inflow, self.dx, self.shift = law, inflow, dx, shift
        self.variation = self.rate = self.k_rate = self.k_variation_rate = self.shifted = self.apart = 0.0
        self.flux_variation = float(total_variation(flux(law, q, k, inflow)))
        self.deepest, self.highest = 0.0 - min(float(q.min()), 0.0), max(float(q.max()), 0.0)

    def add(self, dt: float, q: Array, k: Array, k_after: Array) -> None:
        """Add a time step from q and k to a state with the coefficient `k_after`."""
        F = flux(self.law, q, k, self.inflow)
        self.variation += dt * float(total_variation(F))
        change = (k_after - k) / k
        self.rate += float(maximum(np.log1p(change)))
        self.k_rate = max(self.k_rate, float(maximum(k_after - k)) / dt)
        self.k_variation_rate = max(self.k_variation_rate, float(total_variation(k_after - k)) / dt)
        if self.inflow:
            change[0] = 0.0  # the flux at the left end is prescribed
        growth, rise = float(maximum(change)), float(total_variation(change))
        self.flux_variation = (1.0 + growth) * self.flux_variation + float(maximum(F)) * rise
        steepest = dt * float(maximum(np.diff(k))) / self.dx
        f = self.law.f(np.array([min(float(q.min()), 0.0), max(float(q.max()), 0.0)]))
        self.deepest -= steepest * float(f[0])
        self.highest += steepest * float(f[1])
        m = self.shift
        moved = (k[m + 1 :] - k[1:-m]) * self.law.f(q[:-m])
        self.shifted += dt * float(total_variation(np.append(0.0, moved)))

    def add_pair(self, dt: float, k: Array, k2: Array, states: Sequence[Array]) -> None:
        """Add a time step of E: two coefficients, and the two states to either of which the estimate applies."""
        d = k - k2
        size, rise = float(maximum(d)), float(total_variation(d))
        fs = [np.append(0.0, self.law.f(q)) for q in states]
        self.apart += dt * min([size * float(total_variation(f)) + float(maximum(f)) * rise for f in fs])

    def row(self) -> list[float]:
        """Return the values so far."""
        return [float(getattr(self, name)) for name in self.NAMES]


def local_bounds(law: ErosionLaw, q: Array, dx: float, end: float) -> Local:
    """Return the bounds of (3.5) for data q and a run that ends at `end`."""
    lowest, highest = (float(value) if abs(value) > NOTHING else 0.0 for value in (q.min(), q.max()))
    lowest, highest = min(lowest, 0.0), max(highest, 0.0)
    delta, low, high = 0.5 * (1.0 + lowest), 0.5 * (lowest - 1.0) if lowest < 0.0 else 0.0, 2.0 * highest
    f_low, f_high = (abs(float(f)) for f in law.f(np.array([low, high])))
    slope = float(law.derivative(np.array([low]))[0])
    with np.errstate(over="ignore"):
        C = max(f_low, f_high) * float(np.exp(slope * dx * np.abs(q).sum()))
    times = ([delta / (C * slope)] if lowest < 0.0 else []) + ([highest / (C * f_high)] if highest > 0.0 else [])
    until = min([*times, end])
    if until < SHORTEST * end:
        until = 0.0  # rounding would dominate the rates of so short a time step
    return Local(until, low if lowest < 0.0 else None, high if highest > 0.0 else None, lowest, highest)


def evolve(problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None) -> History:
    """Solve the problem and, unless a flux enters, a second one, with common time steps.

    Raise RunError if one of them cannot continue.
    """
    inflow, nonlocal_ = float(problem.profile.inflow), problem.coefficient is None
    steppers = [_Stepper(problem, grid)]
    if not inflow:
        steppers += [_Stepper(problem, grid, SECOND) for _ in range(1 + nonlocal_)]  # the second, the middle
    shift = max(1, grid.cells // SHIFTS)
    targets = np.linspace(0.0, problem.end, MOMENTS)
    saved, table = [], []
    with _failures_stated(grid):
        _evaluate(steppers, 0.0)
        q, k = steppers[0].q, steppers[0].k
        sums = _Sums(problem.law, inflow, grid.dx, shift, q, k)
        local = local_bounds(problem.law, q, grid.dx, problem.end) if nonlocal_ and not inflow else None
        for start, target in zip([0.0, *targets.tolist()[:-1]], targets.tolist(), strict=True):
            for dt, t in _stops(steppers, start, target, local.end if local else target):
                _add(sums, dt, steppers, t)
                if local and t <= local.end:
                    local = local.seen(steppers[0].q)
            saved.append(_state(steppers))
            table.append(sums.row())
            if progress:
                progress(target / problem.end)
    q, k, q2, k2, middle = (np.array(rows) for rows in zip(*saved, strict=True))
    columns = dict(zip(_Sums.NAMES, np.array(table).T, strict=True))
    return History(
        problem.law, inflow, nonlocal_, targets, grid.nodes, q, k, q2, k2, middle, shift, columns, local
    )  # fmt: skip


def _evaluate(steppers: Sequence[_Stepper], t: float) -> None:
    """Evaluate all schemes at time t; the third takes the coefficient of the first."""
    for s in steppers[:2]:
        s.at(t)
    for s in steppers[2:]:
        s.at(t, steppers[0].k)


def _state(steppers: Sequence[_Stepper]) -> list[Array]:
    """Return q and k of the first two schemes and q of the third, empty where there is none."""
    second = [steppers[1].q, steppers[1].k] if len(steppers) > 1 else [NO_CELLS, NO_CELLS]
    return [steppers[0].q, steppers[0].k, *second, steppers[2].q if len(steppers) > 2 else NO_CELLS]


def _add(sums: _Sums, dt: float, steppers: Sequence[_Stepper], t: float) -> None:
    """Add the time step that ended at t; the schemes hold q and k of its start, and then those of its end."""
    q, k, _, k2, middle = _state(steppers)
    if middle.size:
        sums.add_pair(dt, k, k2, (middle, steppers[1].q))
    _evaluate(steppers, t)
    sums.add(dt, q, k, steppers[0].scheme.K)


def freeze(problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None) -> list[FractionalStep]:
    """Solve the problem with a coefficient that is refreshed at the ends of FRACTIONAL_STEPS intervals only.

    Raise RunError if the run cannot continue.
    """
    inflow, found = float(problem.profile.inflow), []
    own = _Stepper(problem, grid)
    times = np.linspace(0.0, problem.end, FRACTIONAL_STEPS + 1)

    def size() -> tuple[float, float]:
        F = flux(problem.law, own.scheme.q, own.scheme.K, inflow)
        return float(maximum(F)), float(total_variation(F))

    with _failures_stated(grid):
        own.at(0.0)
        after = size()
        for start, end in zip(times[:-1].tolist(), times[1:].tolist(), strict=True):
            before, largest = after, (0.0, 0.0)
            old = own.k
            for _, t in _steps([own], start, end):
                own.at(t, old)
                after = size()
                largest = max(largest[0], after[0]), max(largest[1], after[1])
            last = after
            own.at(end)
            after = size()
            change = own.k - old
            relative = change / old
            if inflow:
                relative[0] = 0.0  # the flux at the left end is prescribed
            found.append(
                FractionalStep(
                    start, end, *before, *largest, *last, *after, float(maximum(relative)),
                    float(maximum(change) / old.min()), float(total_variation(relative)),
                )
            )  # fmt: skip
            if progress:
                progress(end / problem.end)
    return found


@contextmanager
def _failures_stated(grid: Grid) -> Iterator[None]:
    """Turn the failure of a scheme into a RunError with its position."""
    try:
        yield
    except Halt as halt:
        raise RunError(str(halt)) from None
    except Breakdown as broken:
        raise RunError(
            f"the slope breaks down near x = {grid.centres[broken.cell]:.6g}, where q = {broken.q:.6g}; "
            "K spans too many decades there, or q is too near -1"
        ) from None
