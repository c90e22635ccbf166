"""The Hamilton-Jacobi equation u_t + K f(u_x - 1) = 0 on nodes, by monotone first-order schemes.

The unknown is W = u - x, which has the same equation and less rounding than u. With q on the cells the difference
quotients of W, K a suffix sum and F the numerical flux, a step is W_i -= Δt F_i (theory, §2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.kernels import grid as kernels
from hjprofile.solvers.march import Breakdown
from hjprofile.solvers.run import Array

# A flux fills F at the nodes 1..N from the scheme's arrays; speed = max K f'.
Flux = Callable[["HamiltonJacobi", float], None]


def flux_local_lax_friedrichs(s: HamiltonJacobi, speed: float) -> None:
    """Monotone with a viscosity from the neighbourhood of each node; an E-flux in the sense of Osher."""
    kernels.hj_local_lax_friedrichs(s.q, s.f_of_means(), s.df, s.K, s.F)
    s.F[-1] = s.K[-1] * s.f[-1]


def flux_lax_friedrichs(s: HamiltonJacobi, speed: float) -> None:
    """Monotone with one viscosity α = max K f'."""
    kernels.hj_lax_friedrichs(s.q, s.f_of_means(), speed, s.K, s.F)
    s.F[-1] = s.K[-1] * s.f[-1]


def flux_godunov(s: HamiltonJacobi, speed: float) -> None:
    """F = K f(q⁻): all speeds are positive, so Godunov's flux is upwind."""
    np.multiply(s.K[1:], s.f, out=s.F[1:])


def flux_telescoping(s: HamiltonJacobi, speed: float) -> None:
    """F_i = (K_{i-1} - K_i)/Δx, u_t = K_x literally; the volume budget then holds to rounding."""
    np.multiply(s.K[1:], np.expm1(s.f * s.grid.dx), out=s.F[1:])
    s.F[1:] /= s.grid.dx


FLUXES: Mapping[str, Flux] = MappingProxyType(
    {
        "local-lax-friedrichs": flux_local_lax_friedrichs,
        "lax-friedrichs": flux_lax_friedrichs,
        "godunov": flux_godunov,
        "telescoping": flux_telescoping,
    }
)


class HamiltonJacobi:
    """A first-order scheme for W = u - x with forward Euler steps."""

    cfl_limit = 1.0

    def __init__(self, law: ErosionLaw, grid: Grid, W: Array, flux: Flux, inflow: float = 0.0):
        n = grid.cells
        self.law, self.grid, self.flux = law, grid, flux
        self.W, self.last = W.copy(), W.copy()
        self.q, self.f, self.df = np.empty(n), np.empty(n), np.empty(n)
        self.K, self.F = np.ones(n + 1), np.zeros(n + 1)
        self.F[0] = inflow
        self.growth = self.outflow = 0.0

    def f_of_means(self) -> Array:
        """f(½(q⁻+q⁺)) at the inner nodes."""
        return self.law.f(0.5 * (self.q[:-1] + self.q[1:]))

    def evaluate(self) -> float:
        least = kernels.hj_slopes(self.W, self.grid.dx, self.q)
        if not least > -1.0:
            raise Breakdown(self.q, self.K)
        self.f, self.df = self.law.f(self.q), self.law.derivative(self.q)
        kernels.hj_exponent(self.f, self.grid.dx, self.K)
        np.exp(self.K, out=self.K)
        speed = kernels.hj_speed(self.df, self.K)
        if not 0.0 < speed < np.inf:
            raise Breakdown(self.q, self.K)
        self.flux(self, speed)
        return speed

    def advance(self, dt: float) -> None:
        np.copyto(self.last, self.W)
        kernels.hj_update(self.W, self.F, dt)
        self.growth += dt * (self.K[0] - 1.0)
        self.outflow += dt * self.F[-1]

    def restore(self) -> None:
        np.copyto(self.W, self.last)

    def volume(self) -> float:
        """Node 0 left out: its flux is the inflow, so that for the telescoping flux the sum changes by K - 1."""
        return self.grid.dx * float(np.sum(self.W[1:]))


def scheme(problem: Problem, grid: Grid, method: str) -> HamiltonJacobi:
    """The scheme of that name (a key of FLUXES), set up with the problem's profile."""
    W = problem.profile.W(grid.nodes, problem.law)
    return HamiltonJacobi(problem.law, grid, W, FLUXES[method], problem.profile.inflow)
