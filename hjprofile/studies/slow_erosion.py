"""How the model with a rolling layer tends to slow erosion as the layer gets thin (theory, §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.lists import numbers
from hjprofile.problem.ranges import instance
from hjprofile.solvers.method import Feature
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.solve import solve_with


class Departure(NamedTuple):
    """How far a slope below a layer with that supply flux is from the limit, on the same grid.

    Attributes:
        supply_flux: ε; 0 for the limit itself.
        slope_l1, height_sup: ∫|q - q of the limit| dx and sup|u - u of the limit|, the largest of the saved times.
        steps: time steps.
    """

    supply_flux: float
    slope_l1: float
    height_sup: float
    steps: int


def slow_erosion(problem: Problem, grid: Grid, supply_fluxes: Sequence[float], cfl: float = 0.9) -> list[Departure]:
    """Solves [eq2] for each supply flux, and [eq1], all with the same flux on the same grid.

    The limit itself comes first, with the supply flux 0. Raises RunError if a run stops early.
    """
    instance("problem", problem, Problem)
    (method,) = (m for m in METHODS.values() if Feature.LAYER in m.supports)
    departures, limit = [], None
    for supply_flux in (0.0, *numbers("supply_flux", supply_fluxes).tolist()):
        run = solve_with(method, replace(problem, supply_flux=supply_flux), grid, cfl)
        if not run.done:
            raise RunError(f"supply_flux = {supply_flux:g}: {run.status}")
        limit = limit or run
        slope = grid.dx * float(np.abs(run.q - limit.q).sum(axis=1).max())
        departures.append(Departure(supply_flux, slope, float(np.abs(run.u - limit.u).max()), run.steps))
    return departures
