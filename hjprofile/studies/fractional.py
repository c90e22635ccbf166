"""Study of fractional steps: the error of a frozen K (§8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.lists import numbers
from hjprofile.problem.ranges import instance
from hjprofile.solvers.methods import find_method
from hjprofile.solvers.run import Run
from hjprofile.solvers.solve import solve_with
from hjprofile.studies.accuracy import compare, observed_order

TIMES = 6  # number of times over which errors are measured, including both ends


class Step(NamedTuple):
    """Errors of one `refresh` interval Δt: ∫|Δq| dx and the distance of kinks, means over the saved times, and sup|Δu|.

    The distance of kinks is NaN if no kink exists in both runs.
    """

    refresh: float
    error_q_l1: float
    error_u_sup: float
    error_kink: float


class Fractional(NamedTuple):
    """Results of the study: the steps from the longest to the shortest, and the observed orders of the errors in Δt."""

    steps: list[Step]
    order_q_l1: float
    order_u_sup: float
    order_kink: float


def fractional_steps(
    problem: Problem, grid: Grid, method: str = "conservative", refresh: Sequence[float] | None = None
) -> Fractional:
    """Compare S^Δt (3.2) for several Δt with the same method and grid, with its K updated in every step.

    The solutions differ in the age of K and in their time steps, on which the errors of the scheme depend. This is
    small compared with the error of the fractional step if Δt contains several steps. By default Δt is a fifth of the
    end of the problem, and a half, a quarter and an eighth of that. The solutions are compared at TIMES even times.
    Raise InputError if the end is 0, and RunError if a run does not reach the end.
    """
    instance("problem", problem, Problem)
    if not problem.end > 0.0:
        raise InputError(f"end = {problem.end:g}; a study of fractional steps needs an end above 0")
    problem = replace(problem, snapshots=np.linspace(0.0, problem.end, TIMES).tolist())
    parts = [problem.end / n for n in (5, 10, 20, 40)]
    lengths = sorted(numbers("refresh", parts if refresh is None else refresh).tolist(), reverse=True)

    def solved(length: float | None) -> Run:
        run = solve_with(find_method(method), problem, grid, refresh=length)
        if not run.done:
            raise RunError(f"{method} with refresh = {length}: {run.status}")
        return run

    reference, steps = solved(None), []
    for length in lengths:
        apart = compare(solved(length), reference)
        steps.append(Step(length, apart.slope_l1, apart.height_sup, apart.kinks))
    orders = [
        observed_order([1.0 / length for length in lengths], errors) for errors in list(zip(*steps, strict=True))[1:]
    ]
    return Fractional(steps, *orders)
