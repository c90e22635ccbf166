"""The conservation law q_t + (K f(q))_x = 0 on cells.

`SecondOrder` is a discretisation of its own: it shares neither reconstruction, nor quadrature for K, nor time step,
nor compiled loop with the Hamilton-Jacobi solver, so that agreement of the two is evidence. `FirstOrder` takes the
Hamilton-Jacobi solver's fluxes through another code path: differencing one form gives the other identically
(theory, §2), so the two must agree to rounding.
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


class _Cells:
    """Cell means q with W = u - x summed up from the left, where only the inflow changes it."""

    def __init__(self, law: ErosionLaw, grid: Grid, q: Array, W_left: float, inflow: float):
        self.law, self.grid, self.inflow = law, grid, inflow
        self.q, self.last = q.copy(), q.copy()
        self.K = np.ones(grid.cells + 1)
        self.W_left = W_left
        self.growth = self.outflow = 0.0

    @property
    def W(self) -> Array:
        return self.W_left + np.concatenate([[0.0], np.cumsum(self.q) * self.grid.dx])

    def restore(self) -> None:
        np.copyto(self.q, self.last)

    def _finish(self, dt: float, growth: float, outflow: float) -> None:
        self.W_left -= dt * self.inflow
        self.growth += dt * growth
        self.outflow += dt * outflow


FirstOrderFlux = Callable[[ErosionLaw, float, Array, Array, Array, float], Array]


def _local_lax_friedrichs(law: ErosionLaw, dx: float, ql: Array, qr: Array, K: Array, speed: float) -> Array:
    viscosity = K * law.derivative(np.minimum(ql, qr))
    return K * law.f((ql + qr) / 2) - viscosity / 2 * (qr - ql)


def _lax_friedrichs(law: ErosionLaw, dx: float, ql: Array, qr: Array, K: Array, speed: float) -> Array:
    return K * law.f((ql + qr) / 2) - speed / 2 * (qr - ql)


def _godunov(law: ErosionLaw, dx: float, ql: Array, qr: Array, K: Array, speed: float) -> Array:
    return K * law.f(ql)


def _telescoping(law: ErosionLaw, dx: float, ql: Array, qr: Array, K: Array, speed: float) -> Array:
    return (K * np.exp(law.f(ql) * dx) - K) / dx


# F at the nodes right of each cell, from q on either side, K there and max K f'
FLUXES: Mapping[str, FirstOrderFlux] = MappingProxyType(
    {
        "conservative-local-lax-friedrichs": _local_lax_friedrichs,
        "conservative-lax-friedrichs": _lax_friedrichs,
        "conservative-godunov": _godunov,
        "conservative-telescoping": _telescoping,
    }
)


class FirstOrder(_Cells):
    """Forward Euler with one of FLUXES and K by the midpoint rule, in plain numpy."""

    cfl_limit = 1.0

    def __init__(self, law: ErosionLaw, grid: Grid, q: Array, W_left: float, inflow: float, flux: FirstOrderFlux):
        super().__init__(law, grid, q, W_left, inflow)
        self.flux = flux

    def evaluate(self) -> float:
        if not np.min(self.q) > -1.0:
            raise Breakdown(self.q, self.K)
        exponent = self.grid.dx * np.cumsum(self.law.f(self.q)[::-1])[::-1]
        self.K = np.exp(np.append(exponent, 0.0))
        speed = float(np.max(np.maximum(self.K[:-1], self.K[1:]) * self.law.derivative(self.q)))
        if not 0.0 < speed < np.inf:
            raise Breakdown(self.q, self.K)
        neighbour = np.append(self.q[1:], self.q[-1])  # outflow at x = 0
        self.F = np.append(self.inflow, self.flux(self.law, self.grid.dx, self.q, neighbour, self.K[1:], speed))
        return speed

    def advance(self, dt: float) -> None:
        self.last = self.q
        self.q = self.q - dt / self.grid.dx * np.diff(self.F)
        self._finish(dt, self.K[0] - 1.0, self.F[-1])

    def volume(self) -> float:
        return self.grid.dx * float(np.sum(self.W[1:]))


class SecondOrder(_Cells):
    """Limited linear reconstruction, upwind flux, K from the reconstruction, Heun's method (SSP-RK2).

    K is evaluated in both stages: frozen over a step it would make the scheme first order.
    """

    cfl_limit = 0.5
    floor_share = 0.5  # part of 1 + q that a reconstruction may use up; keeps q > -1 (cf. `limited_edges`)

    def __init__(self, law: ErosionLaw, grid: Grid, q: Array, W_left: float, inflow: float):
        super().__init__(law, grid, q, W_left, inflow)
        self.left, self.right = np.empty_like(q), np.empty_like(q)
        self.F = np.empty(grid.cells + 1)
        self.F[0] = inflow

    def _reconstruct(self) -> None:
        """Edge values, K and F of the present q."""
        kernels.limited_edges(self.q, self.floor_share, self.left, self.right)
        f_left, f_right = self.law.f(self.left), self.law.f(self.right)
        kernels.edge_exponent(f_left, f_right, self.grid.dx, self.K)
        np.exp(self.K, out=self.K)
        np.multiply(self.K[1:], f_right, out=self.F[1:])

    def evaluate(self) -> float:
        if not np.min(self.q) > -1.0:
            raise Breakdown(self.q, self.K)
        self._reconstruct()
        df = self.law.derivative(np.minimum(self.left, self.right))
        speed = float(np.max(np.maximum(self.K[:-1], self.K[1:]) * df))
        if not 0.0 < speed < np.inf:
            raise Breakdown(self.q, self.K)
        return speed

    def advance(self, dt: float) -> None:
        np.copyto(self.last, self.q)
        growth, outflow = self.K[0] - 1.0, self.F[-1]
        self.q -= dt / self.grid.dx * np.diff(self.F)
        if not np.min(self.q) > -1.0:
            raise Breakdown(self.q, self.K)
        self._reconstruct()
        self.q -= dt / self.grid.dx * np.diff(self.F)
        self.q += self.last
        self.q *= 0.5
        self._finish(dt, 0.5 * (growth + self.K[0] - 1.0), 0.5 * (outflow + self.F[-1]))

    def volume(self) -> float:
        W = self.W
        return self.grid.dx * float(np.sum(W) - 0.5 * (W[0] + W[-1]))


def scheme(problem: Problem, grid: Grid, method: str) -> FirstOrder | SecondOrder:
    """The scheme of that name: "conservative", or a key of FLUXES."""
    W = problem.profile.W(grid.nodes, problem.law)
    data = (problem.law, grid, np.diff(W) / grid.dx, float(W[0]), problem.profile.inflow)
    return SecondOrder(*data) if method == "conservative" else FirstOrder(*data, FLUXES[method])
