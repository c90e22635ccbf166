"""How a problem is set up on a grid: what a row of the table of methods holds for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.bounds_monitor import Promises
from hjprofile.solvers.grids.scheme import Scheme
from hjprofile.solvers.run import Monitor, Run, State


class Extension(Protocol):
    """What a model adds to a run on a grid: monitors, places that the tracker of kinks leaves out, parts of the run."""

    monitors: Mapping[str, Monitor]

    @property
    def hidden(self) -> Callable[[State], Sequence[tuple[float, float]]]:
        """The intervals of x at a state that belong to something else than kinks."""
        ...

    def complete(self, run: Run) -> Run:
        """Return the run with what the extension has found."""
        ...


class Setup(NamedTuple):
    """How a problem is set up on a grid: the scheme, the bounds that it keeps, and what its model adds."""

    scheme: Callable[[Problem, Grid, float | None], Scheme]
    promises: Promises
    extension: Callable[[Problem, Grid, Scheme], Extension] | None = None
