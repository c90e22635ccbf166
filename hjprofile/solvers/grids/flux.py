"""What a numerical flux of first order is: one formula in two forms, of which a check compares the runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.run import Array

# F at the nodes 1..N and the K f' that bounds the step, from q on either side, K at the nodes 0..N and max K f'
Twin = Callable[[GridLaw, float, Array, Array, Array, float], tuple[Array, Array]]


@dataclass(frozen=True)
class Flux:
    """A numerical flux.

    Attributes:
        name: of the method that solves for u with it; that for q is conservative-NAME.
        kernel: its named tuple in compiled sweeps, made with a bound of K f' for the steps that are taken at once.
        twin: the same in numpy.
        cfl_limit: Δt max(K f')/Δx up to which the scheme is monotone, or its total variation does not grow.
        viscous: whether it carries q to the left end too.
        lasting: whether it is the same function of q and K in all steps.
    """

    name: str
    kernel: Callable[[float], Any]
    twin: Twin
    cfl_limit: float = 1.0
    viscous: bool = False
    lasting: bool = True
