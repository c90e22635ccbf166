"""Numerical flux of first order: one formula in two implementations, whose runs the consistency check compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.run import Array

# (law, dx, q on the left, q on the right, K at the nodes 0..N, max K f') -> F at the nodes 1..N and the K f' that
# bounds the time step
Twin = Callable[[GridLaw, float, Array, Array, Array, float], tuple[Array, Array]]


@dataclass(frozen=True)
class Flux:
    """A numerical flux.

    Attributes:
        name: of the method that solves for u with it; that for q is conservative-NAME.
        kernel: its named tuple in compiled sweeps, made with a bound of K f' for the steps that are taken at once.
        twin: the same in numpy.
        cfl_limit: largest Δt max(K f')/Δx at which the scheme is monotone, or its total variation does not grow.
        viscous: True if it also spreads q to the left.
        lasting: True if it is the same function of q and K in all steps.
    """

    name: str
    kernel: Callable[[float], Any]
    twin: Twin
    cfl_limit: float = 1.0
    viscous: bool = False
    lasting: bool = True
