"""Solving a problem or a case: the public functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.case import DEFAULT_CFL, DEFAULT_METHOD, Case
from hjprofile.problem.grid import Grid
from hjprofile.problem.identity import identity
from hjprofile.problem.profiles import TAIL
from hjprofile.problem.ranges import as_number, instance, shown
from hjprofile.solvers.grids.march import NOBODY
from hjprofile.solvers.method import Form, Method, require, requirements
from hjprofile.solvers.methods import METHODS, by_characteristics, by_fronts, find_method, named, on_grid
from hjprofile.solvers.run import Keeper, Run

Progress = Callable[[float], None]


def solve_hj(
    problem: Problem,
    grid: Grid,
    method: str = DEFAULT_METHOD,
    cfl: float = DEFAULT_CFL,
    progress: Progress | None = None,
    refresh: float | None = None,
) -> Run:
    """Solves u_t + K f(u_x - 1) = 0 on the nodes, as W = u - x (theory, §2).

    `method` is one of the methods for u (docs/cases.md), by default a local Lax-Friedrichs scheme; `cfl` the time step
    as a part of the largest that the method admits, up to 1; `refresh` how long the factor is kept before it is
    updated (theory, §10; None: it is updated in every step). Raises InputError for bad input, and RunError if the run
    cannot start; one that breaks down later returns what was good, with the reason in `status`.
    """
    return solve_with(find_method(method, named(Form.HEIGHT)), problem, grid, cfl, progress, refresh)


def solve_conservative(
    problem: Problem,
    grid: Grid,
    method: str = "conservative",
    cfl: float = DEFAULT_CFL,
    progress: Progress | None = None,
    refresh: float | None = None,
) -> Run:
    """Solves q_t + (K f(q))_x = 0 on the cells.

    `method` is "conservative", second order and independent of `solve_hj`, or "conservative-" before the name of one of
    its methods: that carries the flux over, and the two forms agree to rounding. Otherwise as `solve_hj`, with the same
    errors raised.
    """
    return solve_with(find_method(method, named(Form.SLOPE)), problem, grid, cfl, progress, refresh)


def solve_with(
    method: Method, problem: Problem, grid: Grid, cfl: float = DEFAULT_CFL, progress: Progress | None = None,
    refresh: float | None = None,
) -> Run:  # fmt: skip
    """Solves with a method on a grid, as `solve_hj` and `solve_conservative`."""
    instance("problem", problem, Problem)
    check(method, problem, grid, refresh)
    return on_grid(problem, grid, method, cfl, progress, refresh=refresh)


def track_fronts(
    problem: Problem,
    grid: Grid | None = None,
    fronts: int = 1600,
    progress: Progress | None = None,
    exact: bool | None = None,
) -> Run:
    """Solves by tracking `fronts` fronts (more where fans open), and reads the result on a grid (theory, §5).

    Data that are kinks only are solved exactly, whatever `fronts` is. With `exact` the fronts of other data are moved
    to rounding too: each meets its neighbour in its own time, so that mass and volume are kept to 1e-10, at some fifty
    times the seconds; the error that comes from the number of fronts stays.

    The grid is by default 2000 cells over the profile. Raises InputError for bad input and for a profile with q != 0 at
    the left end, and RunError if fronts lose the slope before the first saved time. Where q comes so near to -1 later
    that a piece is no longer resolved, `status` says so and the last saved time is the last good one.
    """
    instance("problem", problem, Problem)
    grid = problem.grid() if grid is None else grid
    check(METHODS["fronts"], problem, grid)
    return by_fronts(problem, grid, fronts, progress, exact)


def solve_characteristics(
    problem: Problem,
    grid: Grid | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
    patience: float = np.inf,
) -> Run:
    """Solve by shock-fitted characteristics, with steps and panels to `tolerance`, and read the result on a grid.

    The method is in theory, §5; the tolerance is 1e-12 by default. A second run with a coarser tolerance gives
    `error_estimate`, the error of u over the whole run. The grid is by default 2000 cells over the profile. `patience`
    is the largest work in counted seconds, the same on every machine. If the method cannot go on, `status` gives time,
    position and reason, and the last saved time is the last good one. Raises InputError for bad input or a flux at the
    left end, RunError if the data cannot be cut.
    """
    instance("problem", problem, Problem)
    grid = problem.grid() if grid is None else grid
    check(METHODS["characteristics"], problem, grid)
    if tolerance is not None:
        tolerance = _tolerance(METHODS["characteristics"], tolerance)
    return by_characteristics(problem, grid, tolerance, progress, patience)


def solve(problem: Problem, tolerance: float, grid: Grid | None = None, progress: Progress | None = None) -> Run:
    """Solves to a tolerance on sup|u - exact u| over all saved times with the least work (`solvers/select.py`).

    The result is read on `grid`, by default 2000 cells over the profile. `method` says what was chosen, `account` why,
    and `error_estimate` what was reached. Raises InputError for bad input, and RunError if no method gets through.
    """
    instance("problem", problem, Problem)
    method = METHODS["auto"]
    most = _tolerance(method, tolerance)
    assert method.solve is not None
    grid = problem.grid(tail=min(TAIL, 0.01 * most)) if grid is None else grid
    check(method, problem, grid)
    return method.solve(problem, grid, most, progress)


def solve_case(case: Case, progress: Progress | None = None, strict: bool = False, keeper: Keeper | None = None) -> Run:
    """Solves a case by its own method.

    With `strict` a run on a grid stops where it breaks a bound that its method promises; any other returns with that
    as its status. A keeper keeps checkpoints of runs on a grid; others take seconds. Raises InputError if the case asks
    for incompatible options, or for checkpoints of a Python function of no file. Raises RunError if the run cannot
    start, or if no method gets through with `auto`.
    """
    instance("case", case, Case)
    method = check_case(case)
    problem, grid = case.problem, case.grid
    problem.check(grid)
    if method.solve is None:
        itself = identity(case) | {"strict": strict} if keeper else NOBODY
        return on_grid(problem, grid, method, case.cfl, progress, strict, keeper, case.refresh, itself)
    run = method.solve(problem, grid, case.tolerance, progress)
    if strict and run.done and run.broken_bounds:
        return replace(run, status=f"reached the end, but {run.broken_bounds[0]}")
    return run


def check(method: Method, problem: Problem, grid: Grid, refresh: float | None = None) -> None:
    """Raise InputError if a method cannot solve a problem on a grid."""
    _require(method, problem, refresh)
    problem.check(grid)


def _require(method: Method, problem: Problem, refresh: float | None) -> None:
    require(f"the method {method.name}", method.supports, requirements(problem, refresh), METHODS.values())


def check_case(case: Case) -> Method:
    """Return the method of a case. Raises InputError if there is none, or it cannot do what the case asks for."""
    try:
        method = find_method(case.method)
        if case.tolerance is not None and method.tolerance is None:
            able = " and ".join(m.name for m in METHODS.values() if m.tolerance)
            raise InputError(
                f"tolerance applies to the methods {able}, not to {method.name}; leave it out, or set method = 'auto'"
            )
        if case.tolerance is None and method.needs_tolerance:
            raise InputError(f"method = {method.name!r} needs a tolerance: the largest allowed error of u")
        if case.tolerance is not None:
            _tolerance(method, case.tolerance)
        require(
            f"the method {method.name}", method.supports, requirements(case.problem, case.refresh), METHODS.values()
        )
    except InputError as error:
        raise InputError(f"{case.source}: [solver] {error}", about="method-and-tolerance") from None
    return method


def _tolerance(method: Method, asked: object) -> float:
    """Return a tolerance. Raises InputError if the method cannot solve to it."""
    least, most = method.tolerance or (0.0, np.inf)
    if not least <= (tolerance := as_number(asked)) <= most:
        raise InputError(f"tolerance = {shown(asked)} must lie between {least:g} and {most:g}")
    return tolerance
