"""Set-up of a problem on a grid, as a row of the table of methods holds it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.bounds_monitor import Guarantees
from hjprofile.solvers.grids.scheme import Scheme
from hjprofile.solvers.run import Monitor, Run, State


class Extension(Protocol):
    """Additions of a model to a run on a grid: monitors, intervals that the kink tracker omits, parts of the run."""

    monitors: Mapping[str, Monitor]

    @property
    def hidden(self) -> Callable[[State], Sequence[tuple[float, float]]]:
        """The intervals of x at a state that do not belong to kinks."""
        ...

    def complete(self, run: Run) -> Run:
        """Return the run with the results of the extension."""
        ...


class Setup(NamedTuple):
    """Set-up of a problem on a grid: the scheme, the bounds that it satisfies, and the additions of its model."""

    scheme: Callable[[Problem, Grid, float | None], Scheme]
    guarantees: Guarantees
    extension: Callable[[Problem, Grid, Scheme], Extension] | None = None
