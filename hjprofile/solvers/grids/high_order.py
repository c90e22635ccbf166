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
from hjprofile.solvers.grids.grid_law import GridLaw, blocks
from hjprofile.solvers.grids.kernels import grid_loops as kernels
from hjprofile.solvers.grids.scheme import HALO, WithRollback
from hjprofile.solvers.run import Array, Breakdown

Rate = Callable[[Array], Array]  # returns a new array, which the step changes


# The steps add an increment d, so a constant value does not change by rounding. They work in place, because their
# arrays are a large part of the memory of a run.
def _increment(rate: Rate, y: Array, dt: float) -> Array:
    """Return dt rate(y)."""
    d = rate(y)
    d *= dt
    return d


def ssp_rk2(y: Array, rate: Rate, dt: float) -> Array:
    """Return y after a step of Heun's method: y + (d + dt rate(y + d)) / 2 with d = dt rate(y)."""
    d = _increment(rate, y, dt)
    d += _increment(rate, y + d, dt)
    d *= 0.5
    d += y
    return d


def ssp_rk4(y: Array, rate: Rate, dt: float) -> Array:
    """Return y after a step of Ketcheson's fourth-order method of ten stages (SIAM J. Sci. Comput. 30, 2008)."""
    d = _increment(rate, y, dt / 6.0)
    for _ in range(4):
        d += _increment(rate, y + d, dt / 6.0)
    total = 0.36 * d  # y + 0.36 d of half way + 0.6 d of the ninth stage + dt/10 of the last rate
    d *= 0.4
    for _ in range(4):
        d += _increment(rate, y + d, dt / 6.0)
    last = _increment(rate, y + d, 0.1 * dt)
    d *= 0.6
    total += d
    total += last
    total += y
    return total


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

    def _means(self, state: Array, q: Array) -> None:
        """Fill q with the cell means."""
        raise NotImplementedError

    def _rate(self, F: Array) -> Array:
        """Return the rate of change of the state from F at the nodes; it may use the memory of F."""
        raise NotImplementedError

    def _flat_ends(self, first: int, last: int) -> tuple[int, int]:
        """Return the first and the last active entry of the state."""
        raise NotImplementedError

    def evaluate(self) -> float:
        edges, self.q[:] = self._edges(self.state, self.K)
        self.law = self.law.covering(self.q)
        self._fluxes(edges, self.inflow, self.K, self.factor.given())
        return self._speed(self.q, edges, self.K)

    def means(self) -> tuple[int, Array]:
        nodes = self.state.size - self.grid.cells
        a, b = max(self.active[0] - HALO, 0), min(self.active[1] + 1 + HALO, self.grid.cells)
        self._means(self.state[a : b + nodes], self.q[a:b])
        return a, self.q[a:b]

    def _edges(self, state: Array, K: Array, first: int = 0) -> tuple[Array, Array]:
        """Return q on the left of the nodes, and q on the cells. Raise Breakdown if q is not above -1."""
        g, nodes = kernels.GHOSTS, self.state.size - self.grid.cells
        padded = np.empty(state.size - nodes + 2 * g)
        q = padded[g:-g]
        self._means(state, q)
        if not q.min() > -1.0:  # excludes NaN
            raise Breakdown(q, K, first)
        kernels.ghosts(padded)
        edges = np.empty(q.size + 1)
        self.order.edges(padded, edges)
        return edges, q

    def _fluxes(self, edges: Array, inflow: float, K: Array, given: Array | None) -> Array:
        """Return F at the nodes; fill K from q on the left of the nodes, or as prescribed."""
        F = np.empty(edges.size)
        for a, b in blocks(F.size):
            F[a:b] = self.law.law.f(edges[a:b])
        if given is None:
            kernels.exponent_from_nodes(F, self.grid.dx, self.order.high_quadrature, K)
            np.exp(K, out=K)
        else:
            K[:] = given[0]
        F *= K
        F[0] = inflow
        return F

    def _speed(self, q: Array, edges: Array, K: Array, first: int = 0) -> float:
        """Return the largest K f'. Raise Breakdown if it is not finite and positive."""
        speed = self.law.fastest(np.minimum(q, edges[1:]), K)
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
        K = self.K[a : b + 1]
        speed_outside = self.factor.window(self.law, np.array([start]), a, b)[1]
        speeds: list[float] = []

        def fluxes(y: Array) -> Array:
            given = self.factor.given(start + y[-1], slice(a, b + 1))
            if speeds:
                return self._fluxes(self._edges(y[:-3], K, a)[0], inflow, K, given)
            edges, q = self._edges(y[:-3], K, a)
            F = self._fluxes(edges, inflow, K, given)
            speeds.append(max(self._speed(q, edges, K, a), speed_outside))  # of states, not of stages
            return F

        def rate(y: Array) -> Array:
            F = fluxes(y)  # its other arrays are free again
            sums = [K[0] - 1.0, F[-1], 1.0]
            return np.append(self._rate(F), sums)

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
