"""What time stepping needs of a scheme."""

from __future__ import annotations

from typing import Protocol

from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.run import Array

MOST_STEPS = 64  # at a time, the lanes of the sweeps
BESIDE = 64  # critical cells that monitors see beside what is not critical, as many as their stencils can ask for


class Scheme(Protocol):
    """A discretisation with its own time steps. `q`, `K` belong to the present state after `evaluate`.

    `memory` names the attributes that make up its state, for a checkpoint.
    """

    @property
    def W(self) -> Array: ...

    law: GridLaw
    factor: Factor
    q: Array
    K: Array
    growth: float
    crest_lowering: float
    memory: tuple[str, ...]
    cfl_limit: float  # Δt max(K f')/Δx at which the scheme is still monotone (limited: total variation diminishing)

    def evaluate(self) -> float:
        """Brings q and K up to the present state; returns max K f'. Raises Breakdown."""
        ...

    def means(self) -> tuple[int, Array]:
        """q at present on the cells where it need not be 0, and the first of these cells."""
        ...

    def advance(self, dt: float, steps: int, bound: float) -> float:
        """At most MOST_STEPS steps; returns the largest K f' met, which should not exceed `bound`.

        Where the state breaks down that is not finite, or Breakdown is raised.
        """
        ...

    def restore(self) -> None:
        """Back to the state before the last `advance`."""
        ...

    def volume(self) -> float:
        """∫(u - x) dx by the sum whose change the scheme's own budget states."""
        ...


class Restorable:
    """A state that is kept and restored by what it names as its memory: what is kept must not be written into."""

    memory: tuple[str, ...]

    def keep(self) -> None:
        """Keeps the present state."""
        self.kept = {name: getattr(self, name) for name in self.memory}

    def restore(self) -> None:
        """Back to it."""
        vars(self).update(self.kept)
