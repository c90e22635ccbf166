"""Solutions known exactly: one kink that travels into a profile which does not change otherwise (theory, §6).

Both families are a moving cut: at every time the solution is a profile of `problem.profiles` with its kink at s(t).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import Kinks, Profile, Steady
from hjprofile.solvers.run import Array


@dataclass(frozen=True)
class MovingKink:
    """An exact solution with one kink.

    Attributes:
        path: t -> s(t), positive after the kink has left.
        at: s -> the profile with its kink at s.
        exit_time: when the kink reaches x = 0.
    """

    law: ErosionLaw
    path: Callable[[float], float]
    at: Callable[[float], Profile]
    exit_time: float

    def profile(self, t: float) -> Profile | None:
        """The profile at time t, or None once it is flat."""
        return self.at(self.path(t)) if t < self.exit_time else None

    def u(self, t: float, x: Array) -> Array:
        """Height at x; u = x left of the kink."""
        profile = self.profile(t)
        return x + (profile.W(x, self.law) if profile else 0.0)

    def q_means(self, t: float, grid: Grid) -> Array:
        """Exact cell means of q."""
        profile = self.profile(t)
        return profile.q_means(grid, self.law) if profile else np.zeros(grid.cells)


def travelling_kink(law: ErosionLaw, amplitude: float, start: float) -> MovingKink:
    """§6a-b: q = Q(x - s(t)) right of s, Q(0) = amplitude, R'(Q) Q' = -Q; s' = 1/R(Q(-s))."""

    def at(s: float) -> Profile:
        return Kinks(np.array([s]), np.array([amplitude]))

    if law.name == "rational":
        from scipy.special import lambertw

        def path_by_lambert(t: float) -> float:
            # s + A e^s = c; A e^s = W(A e^c)
            c = start + amplitude * np.exp(start) + t
            return float(c - lambertw(amplitude * np.exp(c)).real)

        return MovingKink(law, path_by_lambert, at, -start + amplitude * -np.expm1(start))

    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    # time to run a distance y from x = 0 backwards: dT/dy = R(Q(y)), in ln Q as state
    log_a = np.log(amplitude)
    passage = solve_ivp(
        lambda y, state: [-1.0 / law.R_derivative(np.exp(state[0])), law.R(np.exp(state[0]))],
        (0.0, -start), [log_a, 0.0], method="DOP853", rtol=1e-13, atol=1e-13, dense_output=True,
    )  # fmt: skip
    exit_time = float(passage.y[1, -1])

    def path(t: float) -> float:
        return -brentq(lambda y: passage.sol(y)[1] - (exit_time - t), 0.0, -start, xtol=1e-14)

    return MovingKink(law, path, at, exit_time)


def kink_into_steady_slope(law: ErosionLaw, flux: float, start: float) -> MovingKink:
    """§6f: q = 0 left of s(t), the steady slope of that flux right of it; s' = flux/q(s⁺)."""
    at = partial(Steady, flux)
    if law.name == "rational":
        b = (1.0 - flux) / flux
        exit_time = np.log((b - start) / b) / flux
        return MovingKink(law, lambda t: b - (b - start) * np.exp(-flux * t), at, float(exit_time))

    from scipy.integrate import quad
    from scipy.optimize import brentq

    slope = Steady(flux)

    def passage(s: float) -> float:
        return quad(lambda x: float(slope.q(np.array(x), law)) / flux, start, s, epsabs=1e-13, epsrel=1e-13)[0]

    exit_time = passage(0.0)
    return MovingKink(law, lambda t: brentq(lambda s: passage(s) - t, start, 0.0, xtol=1e-14), at, exit_time)
