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
from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.grid_law import GridLaw, grid_law
from hjprofile.solvers.grids.high_order import HighOrder
from hjprofile.solvers.grids.kernels import grid_loops as kernels
from hjprofile.solvers.grids.kernels import wavefront
from hjprofile.solvers.grids.scheme import BESIDE, Restorable
from hjprofile.solvers.layer.kernels.layer_pass import layer_pass
from hjprofile.solvers.run import Array, Breakdown
from hjprofile.solvers.vertical_steps.kernels import telescoping
from hjprofile.solvers.vertical_steps.step_fronts import step_law


def _heights(q: Array, dx: float, W_left: float) -> Array:
    """W on the nodes."""
    return W_left + np.concatenate([[0.0], np.cumsum(q) * dx])


# F at the nodes 1..N and the K f' that bounds the step, from q on either side, K at the nodes 0..N and max K f'
FirstOrderFlux = Callable[[GridLaw, float, Array, Array, Array, float], tuple[Array, Array]]


def _growth(law: GridLaw, z: Array) -> Array:
    """K_{i-1}/K_i for z = f Δx, as in the sweeps of the Hamilton-Jacobi solver."""
    if law.law.grows_linearly:
        return np.exp(z)
    z = np.maximum(z, -1.0)
    return 1.0 + z + 0.5 * z**2


def _local_lax_friedrichs(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    left, right = law.derivative(ql), law.derivative(qr)
    viscosity = K[1:] * np.maximum(left, right)
    thickest = np.maximum(np.maximum(K[1:], K[:-1]), np.append(K[2:], K[-1]))  # of neighbouring nodes
    speed = thickest * (np.maximum(left, right) + np.maximum(right - left, 0.0) / 2)
    return K[1:] * law.f((ql + qr) / 2) - viscosity / 2 * (qr - ql), speed


def _lax_friedrichs(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    return K[1:] * law.f((ql + qr) / 2) - bound / 2 * (qr - ql), K[1:] * law.derivative(np.minimum(ql, qr))


def _godunov(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    return K[1:] * law.f(ql), K[1:] * law.derivative(ql)


def _telescoping(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float):
    z = law.f(ql) * dx
    steepest = np.exp(np.maximum(z, 0.0)) if law.law.grows_linearly else 1 + np.maximum(z, 0.0)
    return K[1:] * (_growth(law, z) - 1.0) / dx, K[1:] * law.derivative(ql) * steepest


FLUXES: Mapping[str, FirstOrderFlux] = MappingProxyType(
    {
        "conservative-local-lax-friedrichs": _local_lax_friedrichs,
        "conservative-lax-friedrichs": _lax_friedrichs,
        "conservative-godunov": _godunov,
        "conservative-telescoping": _telescoping,
    }
)
HIGH_ORDER: Mapping[str, str] = MappingProxyType({"conservative-eno2": "eno2", "conservative-weno5": "weno5"})


class FirstOrder(Restorable):
    """Forward Euler with one of FLUXES, in plain numpy."""

    memory: tuple[str, ...] = ("q", "W_left", "growth", "outflow")

    def __init__(
        self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, flux: FirstOrderFlux,
        factor: Factor | None = None,
    ):  # fmt: skip
        self.law, self.grid, self.inflow, self.flux = law, grid, inflow, flux
        self.factor = factor or Factor(grid)
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
        given = self.factor.given()
        exponent = self.grid.dx * np.cumsum(self.law.f(self.q)[::-1])[::-1]
        self.K = np.exp(np.append(exponent, 0.0)) if given is None else given[0]
        speed = float(np.max(np.maximum(self.K[:-1], self.K[1:]) * self.law.derivative(self.q)))
        if not 0.0 < speed < np.inf:
            raise Breakdown(self.q, self.K)
        return speed

    def means(self) -> tuple[int, Array]:
        return 0, self.q

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.keep()
        fastest, dx = 0.0, self.grid.dx
        for step in range(steps):
            if not np.min(self.q) > -1.0:
                return np.inf
            given = self.factor.given(step * dt)
            own = np.append(np.cumprod(_growth(self.law, self.law.f(self.q) * dx)[::-1])[::-1], 1.0)
            K = own if given is None else given[0]
            neighbour = np.append(self.q[1:], self.q[-1])  # outflow at x = 0
            F, speed = self.flux(self.law, dx, self.q, neighbour, K, bound)
            fastest = max(fastest, float(np.max(speed)))
            # viscosity can carry q to the left end, and what is given can be largest there
            if given is not None or self.flux in (_lax_friedrichs, _local_lax_friedrichs):
                fastest = max(fastest, float(K[0] * np.max(self.law.derivative(np.array([0.0, self.q[0]])))))
            self.q = self.q - dt / dx * np.diff(F, prepend=self.inflow)
            self.W_left -= dt * self.inflow
            self.growth += dt * (float(K[0]) - 1.0)
            self.outflow += dt * float(F[-1])
        return fastest

    def volume(self) -> float:
        return self.grid.dx * float(np.sum(self.W[1:]))


class WithLayer(FirstOrder):
    """The telescoping flux below a rolling layer of finite thickness, by the 2x2 model (theory, §8).

    With ε the flux that is poured in, the layer is ε H thick. H lives on the cells, empty at first; K is the flux of
    grains at the nodes in the last step, in units of ε. For ε -> 0 this is `FirstOrder`.
    `growth` counts the grains that the layer holds as well: then the volume budget is the conservation of grains.
    """

    memory = ("q", "H", "K", "W_left", "growth", "outflow")

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, thickness: float):
        super().__init__(law, grid, q, W_left, inflow, _telescoping)
        self.thickness = thickness
        self.H, self.F = np.zeros(grid.cells), np.empty(grid.cells)
        self.K[:-1] = 0.0

    def evaluate(self) -> float:
        p = 1.0 + self.q
        if not np.min(p) > 0.0:
            raise Breakdown(self.q, self.K)
        speed = float(np.max(np.maximum(self.K[:-1], self.K[1:]) / np.minimum(p, p * p)))
        if not speed < np.inf:
            raise Breakdown(self.q, self.K)
        return speed

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.keep()
        self.q, self.H, self.K = self.q.copy(), self.H.copy(), self.K.copy()
        taken = steps if dt > 0.0 else 0
        speed, grown, outflow = layer_pass(
            self.q, self.H, self.K, self.F, self.grid.dx, dt, taken, bound, self.thickness, self.inflow
        )
        self.W_left -= dt * steps * self.inflow
        self.growth += grown
        self.outflow += outflow
        return float(speed)


class SecondOrder:
    """MUSCL-Hancock: limited slopes, upwind flux, q and K half a step ahead, many steps in one sweep.

    With K frozen at the start of the step the scheme would be first order.
    """

    cfl_limit = 1.0
    memory: tuple[str, ...] = ("q", "W_left", "active", "growth", "outflow")

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, factor: Factor | None = None):
        self.law, self.grid, self.inflow = law, grid, inflow
        self.factor = factor or Factor(grid)
        self.q, self.before, self.W_left = q.copy(), q.copy(), W_left
        self.K = np.ones(grid.cells + 1)
        self.growth = self.outflow = 0.0
        self.active = kernels.flat_ends(self.q, 0, grid.cells - 1, 0.0, 0.0)  # the first and last q /= 0

    @property
    def W(self) -> Array:
        return _heights(self.q, self.grid.dx, self.W_left)

    def evaluate(self) -> float:
        self.law, speed = self.factor.fill(self.law, self.q, self.K)
        return speed

    def means(self) -> tuple[int, Array]:
        a, b = max(self.active[0] - BESIDE, 0), min(self.active[1] + 1 + BESIDE, self.grid.cells)
        return a, self.q[a:b]

    def advance(self, dt: float, steps: int, bound: float) -> float:
        a, b = max(self.active[0] - steps - 3, 0), min(self.active[1] + steps + 4, self.grid.cells)
        self.kept = a, b, self.active, self.W_left, self.growth, self.outflow
        self.before[a:b] = self.q[a:b]
        inflow = self.inflow if a == 0 else 0.0
        factor, idle = self.factor.window(self.law, dt * (np.arange(steps) + 0.5), a, b)
        speed, grown, outflow = wavefront.hancock_pass(
            self.q[a:b], self.grid.dx, dt, steps, inflow, self.law.kernel, factor
        )
        self.W_left -= dt * steps * inflow
        self.growth += grown
        self.outflow += outflow
        self.active = kernels.flat_ends(self.q, a, b - 1, 0.0, 0.0)
        return max(float(speed), idle)

    def restore(self) -> None:
        a, b, self.active, self.W_left, self.growth, self.outflow = self.kept
        self.q[a:b] = self.before[a:b]

    def volume(self) -> float:
        return self.grid.integral(self.W)


class SecondOrderTelescoping(FirstOrder):
    """F̂_i = (K_{i-1/2} - K_{i+1/2})/Δx with K in the middle of cells, for laws of linear growth; Heun's method.

    Whatever these K are, a step moves with (K⁻ - K⁺)/m; q >= 0 and q <= 0 stay so where cfl <= 1 (theory, §14).
    """

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float):
        super().__init__(law, grid, q, W_left, inflow, _telescoping)
        self.cfl_limit = 0.5
        self.steep = float(telescoping.steepest_slope(grid.dx, step_law(law.law)))
        self.room = np.empty((4, grid.cells))

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.keep()
        f, df, *dq = self.room
        fastest = 0.0
        for _ in range(steps):
            q = self.q
            for stage in range(2):
                if not np.min(q) > -1.0:
                    return np.inf
                speed, K_left, F_top = telescoping.rates(
                    q, self.law.kernel, self.grid.dx, self.inflow, self.law.law.eta0, self.steep, f, df, dq[stage]
                )
                fastest = max(fastest, speed)
                q = self.q + dt * dq[0]
                self.growth += 0.5 * dt * (K_left - 1.0)
                self.outflow += 0.5 * dt * F_top
            self.q = 0.5 * (self.q + (q + dt * dq[1]))
            self.W_left -= dt * self.inflow
        return fastest

    def volume(self) -> float:
        return self.grid.integral(self.W)


class HighOrderConservation(HighOrder):
    """q_t = -F_x with F = K f(q⁻) and q⁻ reconstructed from the cell means."""

    def __init__(
        self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, order: str,
        factor: Factor | None = None,
    ):  # fmt: skip
        super().__init__(law, grid, q, order, inflow, factor)
        self.memory = (*self.memory, "t")
        self.W_left, self.t = W_left, 0.0

    @property
    def W(self) -> Array:
        return _heights(self.state, self.grid.dx, self.W_left - self.t * self.inflow)

    def advance(self, dt: float, steps: int, bound: float) -> float:
        met = super().advance(dt, steps, bound)
        self.t += steps * dt
        return met

    def _flat_ends(self, first: int, last: int) -> tuple[int, int]:
        return kernels.flat_ends(self.state, first, last, 0.0, 0.0)

    def _means(self, state: Array) -> Array:
        return state.copy()

    def _rate(self, F: Array) -> Array:
        return -np.diff(F) / self.grid.dx


def scheme(
    problem: Problem, grid: Grid, method: str, refresh: float | None = None
) -> FirstOrder | SecondOrder | HighOrderConservation:
    """The scheme of that name: "conservative", or a key of FLUXES or HIGH_ORDER."""
    W = problem.profile.W(grid.nodes, problem.law)
    q = np.diff(W) / grid.dx
    data = (grid_law(problem.law, q), grid, q, float(W[0]), problem.profile.inflow)
    factor = Factor(grid, problem.coefficient, refresh)
    if problem.thickness:
        return WithLayer(*data, problem.thickness)
    if method in HIGH_ORDER:
        return HighOrderConservation(*data, HIGH_ORDER[method], factor)
    if method == "conservative" and problem.law.grows_linearly:
        return SecondOrderTelescoping(*data)
    return SecondOrder(*data, factor) if method == "conservative" else FirstOrder(*data, FLUXES[method], factor)
