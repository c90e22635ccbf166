"""Schemes for the Hamilton-Jacobi equation u_t + K f(u_x - 1) = 0 on nodes.

The unknown is W = u - x, which satisfies the same equation with less rounding than u. With q the difference quotients
of W on the cells and F the numerical flux, a step is W_i -= Δt F_i (§12).
"""

from __future__ import annotations

import numpy as np

from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.grids.high_order import HighOrder
from hjprofile.solvers.grids.kernels import grid_loops, wavefront
from hjprofile.solvers.grids.scheme import HALO
from hjprofile.solvers.run import Array


def _means(W: Array, dx: float, q: Array) -> None:
    """Fill q on the cells with the difference quotients of W on the nodes."""
    np.divide(np.subtract(W[1:], W[:-1], out=q), dx, out=q)


class HamiltonJacobi:
    """A first-order scheme for W = u - x with a numerical flux and forward Euler steps, many of them in one sweep."""

    checkpoint_fields: tuple[str, ...] = ("W", "active", "toe_gain", "crest_lowering")

    def __init__(
        self, law: GridLaw, grid: Grid, W: Array, flux: Flux, inflow: float = 0.0, factor: Factor | None = None
    ):
        self.cfl_limit = flux.cfl_limit
        self.law, self.grid, self.flux, self.inflow = law, grid, flux, inflow
        self.factor = factor or Factor(grid)
        self.W, self.before = W.copy(), W.copy()
        self.q, self.K = np.empty(grid.cells), np.ones(grid.cells + 1)
        self.toe_gain = self.crest_lowering = 0.0
        # the first and the last node at which W differs from its value at that end
        self.active = grid_loops.flat_ends(self.W, 0, grid.cells, W[0], W[-1])

    def evaluate(self) -> float:
        _means(self.W, self.grid.dx, self.q)
        self.law, speed = self.factor.fill(self.law, self.q, self.K)
        return speed

    def means(self) -> tuple[int, Array]:
        a, b = max(self.active[0] - HALO, 0), min(self.active[1] + HALO, self.grid.cells)
        _means(self.W[a : b + 1], self.grid.dx, self.q[a:b])
        return a, self.q[a:b]

    def advance(self, dt: float, steps: int, bound: float) -> float:
        n = self.grid.cells
        a, b = max(self.active[0] - steps - 2, 0), min(self.active[1] + steps + 2, n)
        self.saved_state = a, b, self.active, self.toe_gain, self.crest_lowering
        W = self.W[a : b + 1]
        self.before[a : b + 1] = W
        inflow = self.inflow if a == 0 else 0.0
        factor, speed_outside = self.factor.window(self.law, dt * np.arange(steps), a, b)
        speed, toe_gain = wavefront.hj_pass(
            W, self.grid.dx, dt, steps, inflow, self.law.kernel, self.flux.kernel(bound), factor
        )
        self.toe_gain += toe_gain
        self.crest_lowering += float(self.before[b] - W[-1])
        self.active = grid_loops.flat_ends(self.W, a, b, self.W[0], self.W[-1])
        return max(float(speed), speed_outside)

    def roll_back(self) -> None:
        a, b, self.active, self.toe_gain, self.crest_lowering = self.saved_state
        self.W[a : b + 1] = self.before[a : b + 1]

    def volume(self) -> float:
        """Return the sum without node 0, whose flux is the inflow, so the telescoping flux changes it by K - 1."""
        return self.grid.dx * float(np.sum(self.W[1:]))


class HighOrderHamiltonJacobi(HighOrder):
    """The scheme W_t = -F with F = K f(q⁻) and q⁻ reconstructed from the difference quotients of W."""

    @property
    def W(self) -> Array:
        return self.state

    def _flat_ends(self, first: int, last: int) -> tuple[int, int]:
        return grid_loops.flat_ends(self.state, first, last, self.state[0], self.state[-1])

    def _means(self, state: Array, q: Array) -> None:
        _means(state, self.grid.dx, q)

    def _rate(self, F: Array) -> Array:
        return np.negative(F, out=F)
