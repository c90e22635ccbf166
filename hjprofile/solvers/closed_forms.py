"""Closed forms: steady slopes, and one kink that moves into a neutral or a steady slope (§5).

In each of them the solution at any time is a profile of `problem.profiles` with its kink at s(t).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.model import Prescribed, SlowErosion, WholeLine
from hjprofile.problem.profiles import Kinks, Profile, Steady
from hjprofile.problem.ranges import instance
from hjprofile.solvers.run import Array, Event, KinkRecord, Run
from hjprofile.solvers.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.solvers.snapshots import Solution, assembled, walk

CLOSED_FORM_ERROR = 1e-13  # of u of order 1; measured: 2e-14 for rational laws, 1e-12 for others, as the volume shows


@dataclass(frozen=True, repr=False)
class ClosedForm:
    """An exact solution with at most one kink.

    Attributes:
        path: t -> s(t), the position of the kink before exit_time; -inf if there is none.
        at: s -> the profile with its kink at s.
        factor: (s, x) -> K at x >= s, an array. Left of s q = 0, and K is constant.
        exit_time: the time at which the kink reaches x = 0; from then on the slope is neutral.
        sinking: rate at which u decreases at the left end, which is the flux that enters there.
    """

    law: ErosionLaw
    path: Callable[[float], float]
    at: Callable[[float], Profile]
    factor: Callable[[float, Array], Array]
    exit_time: float
    sinking: float = 0.0

    def __repr__(self) -> str:
        kink = f"its kink leaves at t = {self.exit_time:.6g}" if self.exit_time < np.inf else "no kink leaves"
        return f"ClosedForm under {self.law!r}: {kink}"

    def kink(self, t: float) -> float:
        """Return the position of the kink at time t; NaN if there is none."""
        s = self.path(t) if t < self.exit_time else np.nan
        return s if np.isfinite(s) else np.nan

    def u(self, t: float, x: Array) -> Array:
        """Return the height at x (increasing); u = x left of the kink, or at x[0] at time 0 if a flux enters there."""
        if t >= self.exit_time:
            return x.copy()
        return x + self.at(self.path(t)).W(x, self.law) - self.sinking * t

    def q_means(self, t: float, grid: Grid) -> Array:
        """Return the exact cell means of q."""
        return self.at(self.path(t)).q_means(grid, self.law) if t < self.exit_time else np.zeros(grid.cells)

    def K(self, t: float, x: Array) -> Array:
        """Return the grain flux K at x."""
        if t >= self.exit_time:
            return np.ones_like(x)
        s = self.path(t)
        return self.factor(s, np.maximum(x, s))

    def eroded(self, t: float, x: float) -> float:
        """Return ∫_x^0 (u(0,y) - u(t,y)) dy = ∫_0^t (K(τ,x) - 1) dτ (§5g), by quadrature of the latter."""
        from scipy.integrate import quad
        from scipy.optimize import brentq

        end = min(t, self.exit_time)
        passes = []  # K has a corner when the kink passes x
        if self.path(0.0) < x < self.path(end):
            passes.append(brentq(lambda tau: self.path(tau) - x, 0.0, end, xtol=1e-14))
        marks = [0.0, *passes, end]
        return sum(
            quad(lambda tau: float(self.K(tau, np.array([x]))[0]) - 1.0, a, b, epsabs=1e-12, epsrel=1e-12)[0]
            for a, b in pairwise(marks)
        )


def exact(problem: Problem) -> ClosedForm | None:
    """Return the closed form of the solution of a problem if it is known.

    It is known for slow erosion with one kink on a neutral slope, also on the whole line, for a steady slope, and for
    one kink that moves into a steady slope.

    Args:
        problem: law, profile and model; its end is not used.

    Returns:
        The exact solution, or None if no closed form is known.

    Raises:
        InputError: if the argument is of another type.

    >>> import numpy as np
    >>> import hjprofile as hj
    >>> form = hj.exact(hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=1.0))
    >>> print(f"{form.kink(0.5):.4f} {form.u(0.5, np.array([-1.0]))[0]:.4f}")
    -1.5722 -0.5643
    >>> hj.exact(hj.Problem(hj.rational(), hj.bumps([1.0], [-2.0], [0.5]), end=1.0)) is None
    True
    """
    instance("problem", problem, Problem)
    return closed_form(problem) if isinstance(problem.model, SlowErosion | WholeLine) else None


def closed_form(problem: Problem) -> ClosedForm | None:
    """Return the exact solution of a problem with the nonlocal K if its data have one of the forms below; else None."""
    if isinstance(problem.model, Prescribed):
        return None
    match problem.profile:
        case Kinks(positions, amplitudes) if isinstance(problem.model, WholeLine):
            one = len(positions) == 1
            return travelling_wave(problem.law, float(amplitudes[0]), float(positions[0])) if one else None
        case Kinks(positions, amplitudes) if len(positions) == 1:
            return travelling_kink(problem.law, float(amplitudes[0]), float(positions[0]))
        case Steady(flux, float(kink)):
            return kink_into_steady_slope(problem.law, flux, kink)
        case Steady(flux):
            return steady_slope(problem.law, flux)
    return None


class _Evaluated(Solution):
    """A closed form on a grid at given times."""

    moment, steps = 0.0, 0

    def __init__(self, form: ClosedForm, grid: Grid, times: Array):
        self.form, self.grid, self.t = form, grid, 0.0
        self.u = {t: form.u(t, grid.nodes) for t in times.tolist()}
        self.events: list[Event] = []

    def advance(self, target: float) -> None:
        self.t = target
        if self.form.exit_time <= target and not self.events:
            self.events.append(Event(self.form.exit_time, "exit", 1, None, 0.0))

    def read(self, nodes: Array) -> tuple[Array, Array]:
        return self.u[self.t] - self.grid.nodes, self.form.K(self.t, nodes)

    def volume(self) -> float:
        return _volume(self.form, self.t, self.grid)

    @property
    def totals(self) -> tuple[float, float]:  # type: ignore[override]
        """The integral ∫(K_left - 1) dt, and the crest lowering."""
        left = float(self.grid.nodes[0])
        return self.form.eroded(self.t, left), float(self.u[0.0][-1] - self.u[self.t][-1])

    def kinks(self) -> list[KinkRecord]:
        form, s = self.form, self.form.kink(self.t)
        if not s < 0.0:
            return []
        after = float(form.at(s).breaks(form.law)[0, 2])
        speed = float(form.K(self.t, np.array([s]))[0] * form.law.f(after) / after)
        return [KinkRecord(self.t, 1, s, 0.0, after, after, speed, speed)]


def evaluate(form: ClosedForm, problem: Problem, grid: Grid) -> Run:
    """Return the exact solution as a run on a grid. Two expressions of the volume give the estimate of its error."""
    started = time.perf_counter()
    times, judged = problem.times, [0.0, problem.end]
    solution = _Evaluated(form, grid, np.unique(np.append(times, judged)))
    u = np.array([solution.u[t] for t in times.tolist()])
    scale = 1.0 + float(np.abs(u - grid.nodes).max())
    allowed = dict.fromkeys(BOUNDS, (100.0 * CLOSED_FORM_ERROR * scale, "rounding"))
    watch = SnapshotBounds(grid, float(solution.u[0.0][-1]), _volume(form, 0.0, grid), allowed, variation_I=0.0)
    run = assembled("closed form", solution, walk(solution, problem, grid, watch, judged=judged), watch, problem, grid)
    return replace(
        run,
        case=resolved_case(problem, grid, "auto"),
        u=u,  # as the formula gives it
        q=np.diff(u, axis=1) / grid.dx - 1.0,
        wall_seconds=time.perf_counter() - started,
        error_estimate=10.0 * max(watch.budget_error, CLOSED_FORM_ERROR * scale),
    )


def _volume(form: ClosedForm, t: float, grid: Grid) -> float:
    """Return ∫(u - x) dx over the grid, by Gauss-Legendre quadrature right of the kink."""
    s = form.kink(t)
    edges = np.linspace(grid.left if np.isnan(s) else s, 0.0, 17)
    z, weights = np.polynomial.legendre.leggauss(16)
    x = edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (1.0 + z)
    W = form.u(t, np.append(grid.left, x))[1:].reshape(x.shape) - x
    flat = form.u(t, grid.nodes[:1])[0] - grid.left
    return float(0.5 * np.diff(edges) @ (W @ weights)) + flat * float(edges[0] - grid.left)


def _one_kink(amplitude: float) -> Callable[[float], Profile]:
    return lambda s: Kinks(np.array([s]), np.array([amplitude]))


def steady_slope(law: ErosionLaw, flux: float) -> ClosedForm:
    """Return §5e: q = f⁻¹(a/(1 - a x)) at all times, sinking at the rate a; the flux a enters at the left end."""
    return ClosedForm(law, lambda t: -np.inf, lambda s: Steady(flux), lambda s, x: 1.0 - flux * x, np.inf, flux)


def travelling_kink(law: ErosionLaw, amplitude: float, start: float) -> ClosedForm:
    """Return §5a-b: q = Q(x - s(t)) right of s, Q(0) = amplitude, R'(Q) Q' = -Q; s' = 1/R(Q(-s))."""
    at = _one_kink(amplitude)

    def factor(s: float, x: Array) -> Array:
        return law.R(law.decay(amplitude, x - s)) / law.R(law.decay(amplitude, -s))

    if law.name == "rational":
        from scipy.special import lambertw

        def path_by_lambert(t: float) -> float:
            # s + A e^s = c; A e^s = W(A e^c)
            c = start + amplitude * np.exp(start) + t
            return float(c - lambertw(amplitude * np.exp(c)).real)

        return ClosedForm(law, path_by_lambert, at, factor, -start + amplitude * -np.expm1(start))

    # the remaining time T(y) at x = -y satisfies dT/dy = R(Q(y)); ln Q is a second state
    def rates(y: float, state: Array) -> list[float]:
        q = np.exp(state[1])
        return [float(law.R(q)), -1.0 / float(law.R_derivative(q))]

    path, exit_time = _path(rates, -start, [0.0, np.log(amplitude)])
    return ClosedForm(law, path, at, factor, exit_time)


def travelling_wave(law: ErosionLaw, amplitude: float, start: float) -> ClosedForm:
    """Return §10: the kink of §5b on the whole line moves with the constant speed f'(0) for any amplitude; K(∞) = 1."""
    at = _one_kink(amplitude)

    def factor(s: float, x: Array) -> Array:
        return law.R(law.decay(amplitude, x - s)) / law.R(0.0)

    return ClosedForm(law, lambda t: start + t / float(law.R(0.0)), at, factor, np.inf)


def kink_into_steady_slope(law: ErosionLaw, flux: float, start: float) -> ClosedForm:
    """Return §5f: q = 0 left of s(t), the steady slope of that flux right of it; s' = flux/q(s⁺)."""
    at = partial(Steady, flux)

    def factor(s: float, x: Array) -> Array:
        return 1.0 - flux * x

    if law.name == "rational":
        b = (1.0 - flux) / flux
        exit_time = float(np.log((b - start) / b) / flux)
        return ClosedForm(law, lambda t: b - (b - start) * np.exp(-flux * t), at, factor, exit_time)

    slope = Steady(flux)
    path, exit_time = _path(lambda y, state: [float(slope.excess(np.array(-y), law)) / flux], -start, [0.0])
    return ClosedForm(law, path, at, factor, exit_time)


def _path(
    rates: Callable[[float, Array], list[float]], distance: float, state: list[float]
) -> tuple[Callable[[float], float], float]:
    """Return the position of a kink over time, and its exit time, from dT/dy: T is the time for the last distance y."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    passage = solve_ivp(rates, (0.0, distance), state, method="DOP853", rtol=1e-13, atol=1e-13, dense_output=True)
    exit_time = float(passage.y[0, -1])

    def path(t: float) -> float:
        left = exit_time - t
        if left <= 0.0:
            return 0.0
        return -brentq(lambda y: passage.sol(y)[0] - left, 0.0, distance * (1 + 1e-12), xtol=1e-14)

    return path, exit_time
