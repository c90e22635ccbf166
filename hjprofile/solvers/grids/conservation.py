"""Schemes for the conservation law q_t + (K f(q))_x = 0 on cells.

`SecondOrder` is an independent discretisation: it shares neither reconstruction, quadrature for K, nor time step with
the Hamilton-Jacobi solver, so agreement of the two is evidence. `FirstOrder` uses the fluxes of the Hamilton-Jacobi
solver in a separate numpy implementation. Differencing one form gives the other identically (§12), so the two
must agree to rounding.
"""

from __future__ import annotations

import numpy as np

from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.grids.high_order import HighOrder
from hjprofile.solvers.grids.kernels import grid_loops as kernels
from hjprofile.solvers.grids.kernels import hancock
from hjprofile.solvers.grids.scheme import HALO, WithRollback
from hjprofile.solvers.run import Array, Breakdown


def _heights(q: Array, dx: float, W_left: float) -> Array:
    """Return W on the nodes."""
    return W_left + np.concatenate([[0.0], np.cumsum(q) * dx])


def _K_ratio(law: GridLaw, z: Array) -> Array:
    """Return K_{i-1}/K_i for z = f Δx, as in the sweeps of the Hamilton-Jacobi solver."""
    if law.law.grows_linearly:
        return np.exp(z)
    z = np.maximum(z, -1.0)
    return 1.0 + z + 0.5 * z**2


def local_lax_friedrichs(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float) -> tuple[Array, Array]:
    """Compute F and the bounding K f' of `wavefront.LocalLaxFriedrichs` in numpy."""
    left, right = law.derivative(ql), law.derivative(qr)
    viscosity = K[1:] * np.maximum(left, right)
    K_max = np.maximum(np.maximum(K[1:], K[:-1]), np.append(K[2:], K[-1]))  # of neighbouring nodes
    speed = K_max * (np.maximum(left, right) + np.maximum(right - left, 0.0) / 2)
    return K[1:] * law.f((ql + qr) / 2) - viscosity / 2 * (qr - ql), speed


def lax_friedrichs(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float) -> tuple[Array, Array]:
    """Compute F and the bounding K f' of `wavefront.LaxFriedrichs` in numpy."""
    return K[1:] * law.f((ql + qr) / 2) - bound / 2 * (qr - ql), K[1:] * law.derivative(np.minimum(ql, qr))


def godunov(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float) -> tuple[Array, Array]:
    """Compute F and the bounding K f' of `wavefront.Godunov` in numpy."""
    return K[1:] * law.f(ql), K[1:] * law.derivative(ql)


def telescoping(law: GridLaw, dx: float, ql: Array, qr: Array, K: Array, bound: float) -> tuple[Array, Array]:
    """Compute F and the bounding K f' of `wavefront.Telescoping` in numpy."""
    z = law.f(ql) * dx
    K_ratio_derivative = np.exp(np.maximum(z, 0.0)) if law.law.grows_linearly else 1 + np.maximum(z, 0.0)
    return K[1:] * (_K_ratio(law, z) - 1.0) / dx, K[1:] * law.derivative(ql) * K_ratio_derivative


class FirstOrder(WithRollback):
    """Forward Euler steps with a numerical flux, in plain numpy."""

    checkpoint_fields: tuple[str, ...] = ("q", "W_left", "toe_gain", "crest_lowering")

    def __init__(
        self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, flux: Flux,
        factor: Factor | None = None,
    ):  # fmt: skip
        self.law, self.grid, self.inflow, self.flux = law, grid, inflow, flux
        self.factor = factor or Factor(grid)
        self.cfl_limit = flux.cfl_limit
        self.q, self.W_left = q.copy(), W_left
        self.K = np.ones(grid.cells + 1)
        self.toe_gain = self.crest_lowering = 0.0

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
        self.save()
        fastest, dx = 0.0, self.grid.dx
        for step in range(steps):
            if not np.min(self.q) > -1.0:
                return np.inf
            given = self.factor.given(step * dt)
            own = np.append(np.cumprod(_K_ratio(self.law, self.law.f(self.q) * dx)[::-1])[::-1], 1.0)
            K = own if given is None else given[0]
            neighbour = np.append(self.q[1:], self.q[-1])  # outflow at x = 0
            F, speed = self.flux.twin(self.law, dx, self.q, neighbour, K, bound)
            fastest = max(fastest, float(np.max(speed)))
            # viscosity can spread q to the left end, and a prescribed K can be largest there
            if given is not None or self.flux.viscous:
                fastest = max(fastest, float(K[0] * np.max(self.law.derivative(np.array([0.0, self.q[0]])))))
            self.q = self.q - dt / dx * np.diff(F, prepend=self.inflow)
            self.W_left -= dt * self.inflow
            self.toe_gain += dt * (float(K[0]) - 1.0)
            self.crest_lowering += dt * float(F[-1])
        return fastest

    def volume(self) -> float:
        return self.grid.dx * float(np.sum(self.W[1:]))


class SecondOrder:
    """MUSCL-Hancock: limited slopes, upwind flux, q and K half a step ahead, many steps in one sweep.

    With K frozen at the start of the step the scheme would be first order.
    """

    cfl_limit = 1.0
    checkpoint_fields: tuple[str, ...] = ("q", "W_left", "active", "toe_gain", "crest_lowering")

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, factor: Factor | None = None):
        self.law, self.grid, self.inflow = law, grid, inflow
        self.factor = factor or Factor(grid)
        self.q, self.before, self.W_left = q.copy(), q.copy(), W_left
        self.K = np.ones(grid.cells + 1)
        self.toe_gain = self.crest_lowering = 0.0
        self.active = kernels.flat_ends(self.q, 0, grid.cells - 1, 0.0, 0.0)  # the first and last q /= 0

    @property
    def W(self) -> Array:
        return _heights(self.q, self.grid.dx, self.W_left)

    def evaluate(self) -> float:
        self.law, speed = self.factor.fill(self.law, self.q, self.K)
        return speed

    def means(self) -> tuple[int, Array]:
        a, b = max(self.active[0] - HALO, 0), min(self.active[1] + 1 + HALO, self.grid.cells)
        return a, self.q[a:b]

    def advance(self, dt: float, steps: int, bound: float) -> float:
        a, b = max(self.active[0] - steps - 3, 0), min(self.active[1] + steps + 4, self.grid.cells)
        self.saved_state = a, b, self.active, self.W_left, self.toe_gain, self.crest_lowering
        self.before[a:b] = self.q[a:b]
        inflow = self.inflow if a == 0 else 0.0
        factor, speed_outside = self.factor.window(self.law, dt * (np.arange(steps) + 0.5), a, b)
        speed, toe_gain, crest_lowering = hancock.hancock_pass(
            self.q[a:b], self.grid.dx, dt, steps, inflow, self.law.kernel, factor
        )
        self.W_left -= dt * steps * inflow
        self.toe_gain += toe_gain
        self.crest_lowering += crest_lowering
        self.active = kernels.flat_ends(self.q, a, b - 1, 0.0, 0.0)
        return max(float(speed), speed_outside)

    def roll_back(self) -> None:
        a, b, self.active, self.W_left, self.toe_gain, self.crest_lowering = self.saved_state
        self.q[a:b] = self.before[a:b]

    def volume(self) -> float:
        return self.grid.integral(self.W)


class HighOrderConservation(HighOrder):
    """The scheme q_t = -F_x with F = K f(q⁻) and q⁻ reconstructed from the cell means."""

    def __init__(
        self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, order: str,
        factor: Factor | None = None,
    ):  # fmt: skip
        super().__init__(law, grid, q, order, inflow, factor)
        self.checkpoint_fields = (*self.checkpoint_fields, "t")
        self.W_left, self.t = W_left, 0.0

    @property
    def W(self) -> Array:
        return _heights(self.state, self.grid.dx, self.W_left - self.t * self.inflow)

    def advance(self, dt: float, steps: int, bound: float) -> float:
        speed = super().advance(dt, steps, bound)
        self.t += steps * dt
        return speed

    def _flat_ends(self, first: int, last: int) -> tuple[int, int]:
        return kernels.flat_ends(self.state, first, last, 0.0, 0.0)

    def _means(self, state: Array, q: Array) -> None:
        q[:] = state

    def _rate(self, F: Array) -> Array:
        change = np.diff(F)
        change /= -self.grid.dx
        return change
