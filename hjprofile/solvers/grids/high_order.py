"""Reconstructions of second and fifth order with strong-stability-preserving Runge-Kutta steps.

The upwind flux is F = K f(q⁻) with q⁻ on the left of each node; K has the order of the scheme and is computed in every
stage. The state is W on the nodes or q on the cells. The two forms share this module and differ in their rates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.grids.kernels import grid_loops as kernels
from hjprofile.solvers.grids.scheme import HALO, WithRollback
from hjprofile.solvers.run import Array, Breakdown

Rate = Callable[[Array], Array]


# The steps add an increment d, so a constant value does not change by rounding
def ssp_rk2(y: Array, rate: Rate, dt: float) -> Array:
    """Return y after a step of Heun's method."""
    d = dt * rate(y)
    return y + 0.5 * (d + dt * rate(y + d))


def ssp_rk4(y: Array, rate: Rate, dt: float) -> Array:
    """Return y after a step of Ketcheson's fourth-order method of ten stages (SIAM J. Sci. Comput. 30, 2008)."""
    d = dt / 6.0 * rate(y)
    for _ in range(4):
        d += dt / 6.0 * rate(y + d)
    half_way = 0.36 * d
    d *= 0.4
    for _ in range(4):
        d += dt / 6.0 * rate(y + d)
    return y + (half_way + 0.6 * d + 0.1 * dt * rate(y + d))


class Order(NamedTuple):
    """The components of a scheme: a reconstruction, a quadrature for K, and a time step with its limit."""

    edges: Callable[[Array, Array], None]
    high_quadrature: bool
    step: Callable[[Array, Rate, float], Array]
    stages: int
    cfl_limit: float
    cfl_proved: float  # largest CFL number with bounds proved for any data
    smooth: float  # order of the error in the cells on smooth data


ORDERS: Mapping[str, Order] = MappingProxyType(
    {
        "eno2": Order(kernels.edges_eno2, False, ssp_rk2, 2, 0.5, 0.5, 2.0),
        # monotone for linear data up to 6; on smooth waves longer steps than this gain nothing
        "weno5": Order(kernels.edges_weno5, True, ssp_rk4, 10, 2.5, np.nan, 5.0),
    }
)


class HighOrder(WithRollback):
    """A scheme of the method of lines on the active part of the grid."""

    checkpoint_fields: tuple[str, ...] = ("state", "active", "toe_gain", "crest_lowering")

    def __init__(self, law: GridLaw, grid: Grid, state: Array, order: str, inflow: float, factor: Factor | None = None):
        self.law, self.grid, self.order, self.inflow = law, grid, ORDERS[order], inflow
        self.factor = factor or Factor(grid)
        self.cfl_limit = self.order.cfl_limit
        self.state = state.copy()
        self.q, self.K = np.empty(grid.cells), np.ones(grid.cells + 1)
        self.toe_gain = self.crest_lowering = 0.0
        self.active = self._flat_ends(0, self.state.size - 1)

    def _means(self, state: Array) -> Array:
        """Return the cell means."""
        raise NotImplementedError

    def _rate(self, F: Array) -> Array:
        """Return the rate of change of the state from F at the nodes."""
        raise NotImplementedError

    def _flat_ends(self, first: int, last: int) -> tuple[int, int]:
        """Return the first and the last active entry of the state."""
        raise NotImplementedError

    def evaluate(self) -> float:
        self.q = self._means(self.state)
        if not np.min(self.q) > -1.0:
            raise Breakdown(self.q, self.K)
        self.law = self.law.covering(self.q)
        return self._speed(self.q, self._fluxes(self.q, self.inflow, self.K, self.factor.given())[1], self.K)

    def means(self) -> tuple[int, Array]:
        nodes = self.state.size - self.grid.cells
        a, b = max(self.active[0] - HALO, 0), min(self.active[1] + 1 + HALO, self.grid.cells)
        self.q[a:b] = self._means(self.state[a : b + nodes])
        return a, self.q[a:b]

    def _fluxes(self, q: Array, inflow: float, K: Array, given: Array | None) -> tuple[Array, Array]:
        """Return F at the nodes and q on their left, from q on the cells; fill K from q, or as prescribed."""
        g = kernels.GHOSTS
        padded = np.empty(q.size + 2 * g)
        padded[g:-g] = q
        kernels.ghosts(padded)
        edges = np.empty(q.size + 1)
        self.order.edges(padded, edges)
        F = padded[: q.size + 1]  # the memory is needed no more
        f = self.law.law.f(edges)
        if given is None:
            kernels.exponent_from_nodes(f, self.grid.dx, self.order.high_quadrature, K)
            np.exp(K, out=K)
        else:
            K[:] = given[0]
        np.multiply(K, f, out=F)
        F[0] = inflow
        return F, edges

    def _speed(self, q: Array, edges: Array, K: Array, first: int = 0) -> float:
        """Return the largest K f'. Raise Breakdown if it is not finite and positive."""
        speed = float(kernels.fastest(K, self.law.derivative(np.minimum(q, edges[1:]))))
        if not 0.0 < speed < np.inf:
            raise Breakdown(q, K, first)
        return speed

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.save()
        self.state = self.state.copy()
        return max(self._step(dt, step * dt) for step in range(steps))

    def _step(self, dt: float, start: float) -> float:
        """Advance by one time step that begins `start` from now; return the largest K f' before it."""
        cells, nodes = self.grid.cells, self.state.size - self.grid.cells
        reach = kernels.GHOSTS * self.order.stages + 6  # stencil of a step, and six nodes for a quadrature
        a, b = max(self.active[0] - reach, 0), min(self.active[1] + 1 + reach, cells)
        inflow = self.inflow if a == 0 else 0.0
        K = np.ones(b - a + 1)
        speed_outside = self.factor.window(self.law, np.array([start]), a, b)[1]
        speeds: list[float] = []

        def rate(y: Array) -> Array:
            q = self._means(y[:-3])
            if not q.min() > -1.0:
                raise Breakdown(q, K, a)
            F, edges = self._fluxes(q, inflow, K, self.factor.given(start + y[-1], slice(a, b + 1)))
            if not speeds:  # of states, not of stages
                speeds.append(max(self._speed(q, edges, K, a), speed_outside))
            return np.concatenate([self._rate(F), [K[0] - 1.0, F[-1], 1.0]])

        part = slice(a, b + nodes)
        # the last entry is the time, so each stage has its own
        y = self.order.step(np.concatenate([self.state[part], [self.toe_gain, self.crest_lowering, 0.0]]), rate, dt)
        self.state[part] = y[:-3]
        self.toe_gain, self.crest_lowering = float(y[-3]), float(y[-2])
        self.active = self._flat_ends(a, b + nodes - 1)
        return speeds[0]

    def volume(self) -> float:
        return self.grid.integral(self.W)

    @property
    def W(self) -> Array:
        """The heights u - x on the nodes."""
        raise NotImplementedError
