"""The conservation law q_t + (K f(q))_x = 0 on cells.

`SecondOrder` is a discretisation of its own: it shares neither reconstruction, nor quadrature for K, nor time step
with the Hamilton-Jacobi solver, so that agreement of the two is evidence. `FirstOrder` takes the Hamilton-Jacobi
solver's fluxes through another code path, plainly: differencing one form gives the other identically (theory, §2), so
the two must agree to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grid_law import GridLaw, grid_law
from hjprofile.solvers.high_order import HighOrder
from hjprofile.solvers.kernels import grid as kernels
from hjprofile.solvers.kernels import wavefront
from hjprofile.solvers.march import BESIDE, NEGLIGIBLE, Breakdown
from hjprofile.solvers.nonlocal_factor import fill_factor
from hjprofile.solvers.run import Array


def _heights(q: Array, dx: float, W_left: float) -> Array:
    """W on the nodes."""
    return W_left + np.concatenate([[0.0], np.cumsum(q) * dx])


# F at the nodes 1..N and the K f' that bounds the step, from q on either side, K and max K f' of all steps
FirstOrderFlux = Callable[[GridLaw, float, Array, Array, Array, float], tuple[Array, Array]]


def _growth(law: GridLaw, z: Array) -> Array:
    """K_{i-1}/K_i for z = f Δx, as in the sweeps of the Hamilton-Jacobi solver."""
    if law.law.grows_linearly:
        return np.exp(z)
    z = np.maximum(z, -1.0)
    return 1.0 + z + 0.5 * z**2


def _local_lax_friedrichs(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    left, right = law.derivative(ql), law.derivative(qr)
    viscosity = K * np.maximum(left, right)
    thickest = np.maximum(
        np.maximum(K, K * _growth(law, law.f(ql) * dx)), np.append(K[1:], 1.0)
    )  # of neighbouring nodes
    speed = thickest * (np.maximum(left, right) + np.maximum(right - left, 0.0) / 2)
    return K * law.f((ql + qr) / 2) - viscosity / 2 * (qr - ql), speed


def _lax_friedrichs(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    return K * law.f((ql + qr) / 2) - bound / 2 * (qr - ql), K * law.derivative(np.minimum(ql, qr))


def _godunov(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    return K * law.f(ql), K * law.derivative(ql)


def _telescoping(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    z = law.f(ql) * dx
    steepest = np.exp(np.maximum(z, 0.0)) if law.law.grows_linearly else 1 + np.maximum(z, 0.0)
    return (K * _growth(law, z) - K) / dx, K * law.derivative(ql) * steepest


FLUXES: Mapping[str, FirstOrderFlux] = MappingProxyType(
    {
        "conservative-local-lax-friedrichs": _local_lax_friedrichs,
        "conservative-lax-friedrichs": _lax_friedrichs,
        "conservative-godunov": _godunov,
        "conservative-telescoping": _telescoping,
    }
)
HIGH_ORDER: Mapping[str, str] = MappingProxyType({"conservative-eno2": "eno2", "conservative-weno5": "weno5"})


class FirstOrder:
    """Forward Euler with one of FLUXES, in plain numpy."""

    memory: tuple[str, ...] = ("q", "W_left", "growth", "outflow")

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, flux: FirstOrderFlux):
        self.law, self.grid, self.inflow, self.flux = law, grid, inflow, flux
        self.cfl_limit = 2 / 3 if flux is _lax_friedrichs else 1.0
        self.q, self.W_left = q.copy(), W_left
        self.K = np.ones(grid.cells + 1)
        self.growth = self.outflow = 0.0

    @property
    def W(self) -> Array:
        return _heights(self.q, self.grid.dx, self.W_left)

    def evaluate(self) -> float:
        if not np.min(self.q) > -1.0:
            raise Breakdown(self.q, self.K)
        self.law = self.law.covering(self.q)
        exponent = self.grid.dx * np.cumsum(self.law.f(self.q)[::-1])[::-1]
        self.K = np.exp(np.append(exponent, 0.0))
        speed = float(np.max(np.maximum(self.K[:-1], self.K[1:]) * self.law.derivative(self.q)))
        if not 0.0 < speed < np.inf:
            raise Breakdown(self.q, self.K)
        return speed

    def means(self) -> tuple[int, Array]:
        return 0, self.q

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.kept = self.q, self.W_left, self.growth, self.outflow
        fastest, dx = 0.0, self.grid.dx
        for _ in range(steps):
            if not np.min(self.q) > -1.0:
                return np.inf
            K = np.append(np.cumprod(_growth(self.law, self.law.f(self.q) * dx)[::-1])[::-1], 1.0)
            neighbour = np.append(self.q[1:], self.q[-1])  # outflow at x = 0
            F, speed = self.flux(self.law, dx, self.q, neighbour, K[1:], bound)
            fastest = max(fastest, float(np.max(speed)))
            if self.flux in (_lax_friedrichs, _local_lax_friedrichs):  # viscosity can carry q to the left end
                fastest = max(fastest, float(K[0] * np.max(self.law.derivative(np.array([0.0, self.q[0]])))))
            self.q = self.q - dt / dx * np.diff(F, prepend=self.inflow)
            self.W_left -= dt * self.inflow
            self.growth += dt * (float(K[0]) - 1.0)
            self.outflow += dt * float(F[-1])
        return fastest

    def restore(self) -> None:
        self.q, self.W_left, self.growth, self.outflow = self.kept

    def volume(self) -> float:
        return self.grid.dx * float(np.sum(self.W[1:]))


class SecondOrder:
    """MUSCL-Hancock: limited slopes, upwind flux, q and K half a step ahead, many steps in one sweep.

    With K frozen at the start of the step the scheme would be first order.
    """

    cfl_limit = 1.0
    memory: tuple[str, ...] = ("q", "W_left", "active", "growth", "outflow")

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float):
        self.law, self.grid, self.inflow = law, grid, inflow
        self.q, self.before, self.W_left = q.copy(), q.copy(), W_left
        self.K = np.ones(grid.cells + 1)
        self.growth = self.outflow = 0.0
        self.active = kernels.flat_ends(self.q, 0, grid.cells - 1, 0.0, 0.0, NEGLIGIBLE)  # the first and last q /= 0

    @property
    def W(self) -> Array:
        return _heights(self.q, self.grid.dx, self.W_left)

    def evaluate(self) -> float:
        self.law, speed = fill_factor(self.law, self.q, self.grid.dx, self.K)
        return speed

    def means(self) -> tuple[int, Array]:
        a, b = max(self.active[0] - BESIDE, 0), min(self.active[1] + 1 + BESIDE, self.grid.cells)
        return a, self.q[a:b]

    def advance(self, dt: float, steps: int, bound: float) -> float:
        a, b = max(self.active[0] - steps - 3, 0), min(self.active[1] + steps + 4, self.grid.cells)
        self.kept = a, b, self.active, self.W_left, self.growth, self.outflow
        self.before[a:b] = self.q[a:b]
        inflow = self.inflow if a == 0 else 0.0
        speed, grown, outflow = wavefront.hancock_pass(self.q[a:b], self.grid.dx, dt, steps, inflow, self.law.kernel)
        self.W_left -= dt * steps * inflow
        self.growth += grown
        self.outflow += outflow
        self.active = kernels.flat_ends(self.q, a, b - 1, 0.0, 0.0, NEGLIGIBLE)
        return float(speed)

    def restore(self) -> None:
        a, b, self.active, self.W_left, self.growth, self.outflow = self.kept
        self.q[a:b] = self.before[a:b]

    def volume(self) -> float:
        W = self.W
        return self.grid.dx * float(np.sum(W) - 0.5 * (W[0] + W[-1]))


class HighOrderConservation(HighOrder):
    """q_t = -F_x with F = K f(q⁻) and q⁻ reconstructed from the cell means."""

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, order: str):
        super().__init__(law, grid, q, order, inflow)
        self.memory = (*self.memory, "t")
        self.W_left, self.t = W_left, 0.0

    @property
    def W(self) -> Array:
        return _heights(self.state, self.grid.dx, self.W_left - self.t * self.inflow)

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.t_before = self.t
        self.t += steps * dt
        return super().advance(dt, steps, bound)

    def restore(self) -> None:
        self.t = self.t_before
        super().restore()

    def _flat_ends(self, first: int, last: int) -> tuple[int, int]:
        return kernels.flat_ends(self.state, first, last, 0.0, 0.0, NEGLIGIBLE)

    def _means(self, state: Array) -> Array:
        return state.copy()

    def _rate(self, F: Array) -> Array:
        return -np.diff(F) / self.grid.dx


def scheme(problem: Problem, grid: Grid, method: str) -> FirstOrder | SecondOrder | HighOrderConservation:
    """The scheme of that name: "conservative", or a key of FLUXES or HIGH_ORDER."""
    W = problem.profile.W(grid.nodes, problem.law)
    q = np.diff(W) / grid.dx
    data = (grid_law(problem.law, q), grid, q, float(W[0]), problem.profile.inflow)
    if method in HIGH_ORDER:
        return HighOrderConservation(*data, HIGH_ORDER[method])
    return SecondOrder(*data) if method == "conservative" else FirstOrder(*data, FLUXES[method])
