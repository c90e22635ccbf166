"""Public functions that solve a problem or a case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.case import AnyCase, Case, as_case
from hjprofile.problem.case_keys import DEFAULT_CFL, DEFAULT_METHOD
from hjprofile.problem.grid import Grid
from hjprofile.problem.identity import identity
from hjprofile.problem.model import WholeLine
from hjprofile.problem.profiles import TAIL
from hjprofile.problem.ranges import as_number, instance, shown
from hjprofile.solvers.callbacks import observed
from hjprofile.solvers.grids.march import NOBODY
from hjprofile.solvers.method import Form, Method, require, requirements
from hjprofile.solvers.methods import METHODS, by_characteristics, by_fronts, by_inverse, find_method, named, on_grid
from hjprofile.solvers.noise_bias import with_noise_bias
from hjprofile.solvers.run import Keeper, Run
from hjprofile.solvers.stated_error import with_stated_error
from hjprofile.solvers.states import Callback

Progress = Callable[[float], None]


def solve_hj(
    problem: Problem,
    grid: Grid,
    method: str = DEFAULT_METHOD,
    cfl: float = DEFAULT_CFL,
    progress: Progress | None = None,
    refresh: float | None = None,
    callback: Callback | None = None,
) -> Run:
    """Solve u_t + K f(u_x - 1) = 0 on the nodes of a grid, with the unknown W = u - x (§12).

    - `problem`: law, profile, end and saved times; all dimensionless.
    - `grid`: left end, in exchange lengths, and number of cells.
    - `method`: a method for u (docs/cases.md), by default a local Lax-Friedrichs scheme.
    - `cfl`: the time step as a fraction of the largest one that the method admits, up to 1.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `refresh`: refresh interval of a frozen K, in supplied mass (§8); None computes K in every step.
    - `callback`: a function that is called with t and a read-only `Snapshot` at each saved time. If it returns True,
      the run ends there; it is done, and `stop` is the reason.

    Return a `Run` at the saved times, with u and K of shape (times, cells + 1) and q of shape (times, cells). A run
    that breaks down later returns the good states, with the reason in `status`. Raise InputError for invalid input, and
    RunError if the run cannot start.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> run = hj.solve_hj(problem, hj.Grid(left=-5.0, cells=200))
    >>> run.status, run.u.shape
    ('done', (31, 201))
    """
    return solve_with(find_method(method, named(Form.HEIGHT)), problem, grid, cfl, progress, refresh, callback)


def solve_conservative(
    problem: Problem,
    grid: Grid,
    method: str = "conservative",
    cfl: float = DEFAULT_CFL,
    progress: Progress | None = None,
    refresh: float | None = None,
    callback: Callback | None = None,
) -> Run:
    """Solve q_t + (K f(q))_x = 0 on the cells of a grid.

    - `problem`, `grid`, `cfl`, `progress`, `refresh`, `callback`: as for `solve_hj`.
    - `method`: "conservative", which is second order and independent of `solve_hj`, or "conservative-" before the name
      of one of its methods. The latter uses the same flux, and the two forms agree to rounding.

    Return a `Run`, with the heights integrated from q. Raise InputError and RunError as `solve_hj`.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> grid = hj.Grid(left=-5.0, cells=200)
    >>> apart = hj.compare(hj.solve_hj(problem, grid), hj.solve_conservative(problem, grid))
    >>> apart.slope_l1 < 0.02
    True
    """
    return solve_with(find_method(method, named(Form.SLOPE)), problem, grid, cfl, progress, refresh, callback)


def solve_with(
    method: Method, problem: Problem, grid: Grid, cfl: float = DEFAULT_CFL, progress: Progress | None = None,
    refresh: float | None = None, callback: Callback | None = None,
) -> Run:  # fmt: skip
    """Solve with a method on a grid, as `solve_hj` and `solve_conservative`."""
    instance("problem", problem, Problem)
    _check_functions(progress, callback)
    check(method, problem, grid, refresh)
    return _on_grid(problem, grid, method, callback, cfl=cfl, progress=progress, refresh=refresh)


def _on_grid(problem: Problem, grid: Grid, method: Method, callback: Callback | None, **options: Any) -> Run:
    """Solve on a grid; a window of the whole line is observed after its run, in the time of the line."""
    if isinstance(problem.model, WholeLine):
        return observed(lambda problem: on_grid(problem, grid, method, **options), problem, callback)
    return on_grid(problem, grid, method, callback=callback, **options)


def _checked(
    method: Method, problem: Problem, grid: Grid | None, progress: Any, callback: Any, tail: float = TAIL
) -> Grid:
    """Return the grid of the result, by default one over the profile. Raise InputError for an invalid argument."""
    instance("problem", problem, Problem)
    _check_functions(progress, callback)
    on = problem.grid(tail=tail) if grid is None else grid
    check(method, problem, on)
    return on


def _check_functions(progress: Any, callback: Any) -> None:
    """Raise InputError unless each of these is a function, or None."""
    for name, function in (("progress", progress), ("callback", callback)):
        if not (function is None or callable(function)):
            raise InputError(f"{name} = {shown(function)} must be a function, or None")


def track_fronts(
    problem: Problem,
    grid: Grid | None = None,
    fronts: int = 1600,
    progress: Progress | None = None,
    exact: bool | None = None,
    callback: Callback | None = None,
) -> Run:
    """Solve by front tracking, and evaluate the result on a grid (§13).

    - `problem`: law, profile, end and saved times; q must be 0 at the left end.
    - `grid`: the nodes of the result, by default 2000 cells over the profile.
    - `fronts`: number of fronts; more where fans open. Data that are kinks only are solved exactly for any number.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `exact`: True moves the fronts of other data to rounding, too. Each merge is then located in time, and mass and
      volume are conserved to 1e-10, in about fifty times the seconds. The error of the number of fronts remains.
    - `callback`: as for `solve_hj`, but it is called after the run; if it stops the run, the problem is solved again up
      to that time.

    Return a `Run`. If a later state is not resolved because q is too near -1, `status` states it, and the last saved
    time is the last good one. Raise InputError for invalid input or q != 0 at the left end, and RunError if fronts lose
    the slope before the first saved time.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> run = hj.track_fronts(problem)
    >>> round(run.kinks[-1].x, 4)
    -2.0757
    """
    if exact is not None:
        instance("exact", exact, bool)
    on = _checked(METHODS["fronts"], problem, grid, progress, callback)
    return observed(lambda problem: by_fronts(problem, on, fronts, progress, exact), problem, callback)


def solve_inverse(
    problem: Problem,
    grid: Grid | None = None,
    levels: int | None = None,
    progress: Progress | None = None,
    callback: Callback | None = None,
) -> Run:
    """Solve for x as a function of u at evenly spaced heights, and evaluate the result on a grid (§19).

    - `problem`: law, profile, end and saved times; q must be 0 at the left end.
    - `grid`: the nodes of the result, by default 2000 cells over the profile.
    - `levels`: number of heights between the left end and the crest at t = 0, 4 to 100,000; by default the number of
      cells.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `callback`: as for `solve_hj`, but it is called after the run; if it stops the run, the problem is solved again up
      to that time.

    Return a `Run`. The method is of first order, under every law; vertical steps stay sharp. If a later state needs too
    small time steps, `status` states it, and the last saved time is the last good one. Raise InputError for invalid
    input or q != 0 at the left end, and RunError if no saved time is reached.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> run = hj.solve_inverse(problem, levels=1000)
    >>> round(run.kinks[-1].x, 2)
    -2.08
    """
    on = _checked(METHODS["inverse"], problem, grid, progress, callback)
    return observed(lambda problem: by_inverse(problem, on, levels, progress), problem, callback)


def solve_characteristics(
    problem: Problem,
    grid: Grid | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
    callback: Callback | None = None,
) -> Run:
    """Solve by shock-fitted characteristics, and evaluate the result on a grid (§13).

    - `problem`: law, profile, end and saved times; no flux may enter at the left end.
    - `grid`: the nodes of the result, by default 2000 cells over the profile.
    - `tolerance`: of steps and panels, an error of u; 1e-12 by default.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `callback`: as for `solve_hj`, but it is called after the run; if it stops the run, the problem is solved again up
      to that time.

    Return a `Run`. A second run with a coarser tolerance gives `error_estimate`, the error of u over the whole run. If
    the method cannot continue, `status` states time, position and reason, and the last saved time is the last good one.
    Raise InputError for invalid input or a flux at the left end, and RunError if the profile cannot be cut into panels.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> run = hj.solve_characteristics(problem)
    >>> bool(run.error_estimate < 1e-11)
    True
    """
    on = _checked(METHODS["characteristics"], problem, grid, progress, callback)
    asked = None if tolerance is None else _tolerance(METHODS["characteristics"], tolerance)
    return observed(lambda problem: by_characteristics(problem, on, asked, progress), problem, callback)


def solve(
    problem: Problem,
    tolerance: float,
    grid: Grid | None = None,
    progress: Progress | None = None,
    callback: Callback | None = None,
) -> Run:
    """Solve to a tolerance on sup|u - u_exact| over all saved times, with the least work.

    - `problem`: law, profile, end and saved times.
    - `tolerance`: the largest error of u, dimensionless, from 1e-13 to 1.
    - `grid`: the nodes of the result, by default 2000 cells over the profile.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `callback`: as for `solve_hj`, but it is called after the run; if it stops the run, the problem is solved again up
      to that time.

    Return a `Run`: `method` is the chosen method, `account` states the reason, and `error_estimate` the estimated
    error. If the tolerance is not met, `status` states it. Raise InputError for invalid input, and RunError if no
    method reaches the end.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> run = hj.solve(problem, tolerance=1e-6)
    >>> run.method, run.error_estimate < 1e-6
    ('fronts', True)
    """
    method = METHODS["auto"]
    most = _tolerance(method, tolerance)
    on = _checked(method, problem, grid, progress, callback, tail=min(TAIL, 0.01 * most))
    return _off_grid(method, problem, on, most, progress, callback)


def _off_grid(
    method: Method, problem: Problem, grid: Grid, tolerance: float | None, progress: Progress | None,
    callback: Callback | None,
) -> Run:  # fmt: skip
    """Solve by a method without a grid."""
    by = method.solve
    assert by is not None
    return observed(lambda problem: by(problem, grid, tolerance, progress), problem, callback)


def solve_case(
    case: AnyCase, progress: Progress | None = None, strict: bool = False, callback: Callback | None = None
) -> Run:
    """Solve a case by its own method, and estimate the errors by comparison with an independent solution (§18).

    - `case`: a `Case`, the path of a case file, the name of a case that comes with the package, or the tables of a case
      file.
    - `progress`: a function that is called with the completed fraction in [0, 1].
    - `strict`: True stops a run on a grid that violates a bound of its method. Runs of other methods return with the
      violated bound as `status`.
    - `callback`: as for `solve_hj`; for methods without a grid as for `track_fronts`.

    Return a `Run`. Raise InputError for incompatible options. Raise RunError if the run cannot start, or if no method
    reaches the end with `auto`.

    >>> import hjprofile as hj
    >>> hj.solve_case(hj.load_case("travelling_kink", {"domain.cells": 200})).status
    'done'
    """
    _check_functions(progress, callback)
    instance("strict", strict, bool)
    return solve_and_keep(as_case(case), None, progress, strict, callback)


def solve_and_keep(
    case: Case, keeper: Keeper | None, progress: Progress | None = None, strict: bool = False,
    callback: Callback | None = None,
) -> Run:  # fmt: skip
    """Solve a case as `solve_case`. The keeper stores checkpoints of runs on a grid; other methods take seconds.

    Raise InputError also for checkpoints with a Python function that is not in a file.
    """
    method = check_case(case)
    problem, grid = case.problem, case.grid
    problem.check(grid)
    if method.solve is None:
        itself = identity(case) | {"strict": strict} if keeper else NOBODY
        run = _on_grid(
            problem, grid, method, callback, cfl=case.cfl, progress=progress, strict=strict, keeper=keeper,
            refresh=case.refresh, identity=itself,
        )  # fmt: skip
        return with_noise_bias(with_stated_error(run, case), case)
    run = _off_grid(method, problem, grid, case.tolerance, progress, callback)
    run = with_noise_bias(with_stated_error(run, case), case)
    if strict and run.done and run.broken_bounds:
        return replace(run, status=f"reached the end, but {run.broken_bounds[0]}")
    return run


def check(method: Method, problem: Problem, grid: Grid, refresh: float | None = None) -> None:
    """Raise InputError if a method cannot solve a problem on a grid."""
    _require(method, problem, refresh)
    problem.check(grid)


def _require(method: Method, problem: Problem, refresh: float | None) -> None:
    """Raise InputError if a method does not support the features of a problem."""
    require(f"the method {method.name}", method.supports, requirements(problem, refresh), METHODS.values())


def check_case(case: Case) -> Method:
    """Return the method of a case. Raise InputError if there is none, or if it does not support the case."""
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
        _require(method, case.problem, case.refresh)
    except InputError as error:
        raise InputError(f"{case.source}: [solver] {error}", about="method-and-tolerance") from None
    return method


def _tolerance(method: Method, asked: object) -> float:
    """Return a tolerance. Raise InputError if the method cannot solve to it."""
    least, most = method.tolerance or (0.0, np.inf)
    if not least <= (tolerance := as_number(asked)) <= most:
        raise InputError(f"tolerance = {shown(asked)} must lie between {least:g} and {most:g}")
    return tolerance
