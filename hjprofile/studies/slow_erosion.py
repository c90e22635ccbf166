"""Study of the limit of a thin rolling layer, which is slow erosion (§2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import instance, shown
from hjprofile.problem.supply import ABOUT, SupplyFlux, in_words, supply_flux
from hjprofile.solvers.method import Feature
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.solve import solve_with


class Departure(NamedTuple):
    """Distance of a slope below a rolling layer with that supply flux from the limit, on the same grid.

    Attributes:
        supply_flux: ε, a number, or a `SupplyFlux` if it depends on t; 0 for the limit itself.
        slope_l1, height_sup: ∫|q - q_limit| dx and sup|u - u_limit|, the largest of the saved times.
        steps: number of time steps.
    """

    supply_flux: float | SupplyFlux
    slope_l1: float
    height_sup: float
    steps: int


def slow_erosion(
    problem: Problem, grid: Grid, supply_fluxes: Sequence[float | str | Callable[[Any], Any]], cfl: float = 0.9
) -> list[Departure]:
    """Solve (1.6) for each supply flux, and (1.1), all with the same numerical flux on the same grid.

    - `problem`: the problem without a rolling layer.
    - `grid`: left end and number of cells.
    - `supply_fluxes`: values of ε > 0, the thickness of the rolling layer at the crest of a neutral slope. An entry may
      also be an expression in the supplied mass t, or a Python function of t: the limit is the same.
    - `cfl`: the time step as a fraction of the largest one that the method admits.

    Return a list of `Departure`: that of the limit, with the supply flux 0, then one for each supply flux. Raise
    InputError for invalid input, and RunError if a run does not reach its end.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> study = hj.slow_erosion(problem, hj.Grid(left=-5.0, cells=200), [0.1, 0.01])
    >>> [round(one.height_sup, 2) for one in study]
    [0.0, 0.18, 0.02]
    """
    instance("problem", problem, Problem)
    (method,) = (m for m in METHODS.values() if Feature.LAYER in m.supports)
    departures, limit = [], None
    if not isinstance(supply_fluxes, list | tuple | np.ndarray) or len(supply_fluxes) == 0:
        raise InputError(f"supply_fluxes = {shown(supply_fluxes)} must be a list of supply fluxes", ABOUT)
    for flux in (0.0, *(supply_flux(f"supply_fluxes[{i}]", each) for i, each in enumerate(supply_fluxes))):
        run = solve_with(method, replace(problem, supply_flux=flux), grid, cfl)
        if not run.done:
            raise RunError(f"supply_flux = {in_words(flux)}: {run.status}")
        limit = limit or run
        slope = grid.dx * float(np.abs(run.q - limit.q).sum(axis=1).max())
        departures.append(Departure(flux, slope, float(np.abs(run.u - limit.u).max()), run.steps))
    return departures
