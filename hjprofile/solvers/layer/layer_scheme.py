"""Scheme for the bed below a rolling layer of finite thickness (§15)."""

from __future__ import annotations

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem.grid import Grid
from hjprofile.problem.supply import SupplyFlux
from hjprofile.solvers.grids.conservation import FirstOrder
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.layer.kernels.layer_pass import layer_pass
from hjprofile.solvers.run import Array, Breakdown, Halt
from hjprofile.solvers.stop import Reason, Stop


class WithLayer(FirstOrder):
    """The telescoping flux below a rolling layer of finite thickness, by the 2x2 model (§15).

    With ε the supplied flux, the thickness of the layer is ε H. H lives on the cells and is initially 0; K is the grain
    flux at the nodes in the last step, relative to ε. For ε -> 0 the scheme is `FirstOrder`. `toe_gain` includes the
    grains in the layer, so the volume budget is the conservation of grains.

    If ε depends on t, each step has the mean of ε over its physical time, `supply_flux`. Between two steps H is scaled
    so that the thickness does not change.
    """

    checkpoint_fields: tuple[str, ...] = ("q", "H", "K", "supply_flux", "W_left", "toe_gain", "crest_lowering")

    def __init__(
        self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, flux: Flux, supply: float | SupplyFlux
    ):  # fmt: skip
        super().__init__(law, grid, q, W_left, inflow, flux)
        self.supply = supply
        self.supply_flux = supply if isinstance(supply, float) else float(supply.values(0.0))
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
        self.save()
        self.q, self.H, self.K = self.q.copy(), self.H.copy(), self.K.copy()
        fastest = 0.0
        for supply_flux, taken in self._supplied(dt, steps):
            if supply_flux != self.supply_flux:
                self.H *= self.supply_flux / supply_flux
                self.supply_flux = supply_flux
            speed, toe_gain, crest_lowering = layer_pass(
                self.q, self.H, self.K, self.F, self.grid.dx, dt, taken, bound, supply_flux, self.inflow
            )
            self.toe_gain += toe_gain
            self.crest_lowering += crest_lowering
            fastest = max(fastest, float(speed))
            if not fastest <= bound:  # the steps are repeated
                break
        self.W_left -= dt * steps * self.inflow
        return fastest

    def _supplied(self, dt: float, steps: int) -> list[tuple[float, int]]:
        """Return supply fluxes, each with the number of steps that it lasts. Raise Halt if one is not positive."""
        if isinstance(self.supply, float):
            return [(self.supply, steps if dt > 0.0 else 0)]
        try:
            means = self.supply.means(self.factor.t, dt, steps)
        except RunError as error:
            raise Halt(Stop(Reason.BAD_SUPPLY, "{said}", values={"said": error})) from None
        return [(float(mean), 1 if dt > 0.0 else 0) for mean in means]
