"""Interface between time stepping and a scheme."""

from __future__ import annotations

from typing import Protocol

from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.run import Array

MOST_STEPS = 64  # in one batch: the number of lanes of the sweeps
HALO = 64  # cells of neutral slope on either side of the active cells, at least the width of the monitors' stencils


class Scheme(Protocol):
    """A discretisation with its own time steps. `q` and `K` belong to the current state after `evaluate`.

    `checkpoint_fields` names the attributes that form its state, for a checkpoint.
    """

    @property
    def W(self) -> Array: ...

    law: GridLaw
    factor: Factor
    q: Array
    K: Array
    toe_gain: float
    crest_lowering: float
    checkpoint_fields: tuple[str, ...]
    cfl_limit: float  # Δt max(K f')/Δx at which the scheme is still monotone (limited: total variation diminishing)

    def evaluate(self) -> float:
        """Compute q and K of the current state; return max K f'. Raise Breakdown if the state is not admissible."""
        ...

    def means(self) -> tuple[int, Array]:
        """Return the first active cell, and q on the active cells with a halo of neutral cells."""
        ...

    def advance(self, dt: float, steps: int, bound: float) -> float:
        """Advance by at most MOST_STEPS steps; return the largest K f', which should not exceed `bound`.

        If the state breaks down, the speed is not finite or Breakdown is raised.
        """
        ...

    def roll_back(self) -> None:
        """Return to the state before the last `advance`."""
        ...

    def volume(self) -> float:
        """Return ∫(u - x) dx by the sum whose change the budget of the scheme states."""
        ...


class WithRollback:
    """A state that can be saved and rolled back. Saved arrays must not be modified in place."""

    checkpoint_fields: tuple[str, ...]

    def save(self) -> None:
        """Save the current state."""
        self.saved_state = {name: getattr(self, name) for name in self.checkpoint_fields}

    def roll_back(self) -> None:
        """Return to the saved state."""
        vars(self).update(self.saved_state)
