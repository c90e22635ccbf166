"""The solvers by name, with what watches them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from hjprofile.errors import InputError, did_you_mean
from hjprofile.problem import OFF_GRID, Problem
from hjprofile.problem.case import DEFAULT_CFL, DEFAULT_METHOD, Case, resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.identity import identity
from hjprofile.problem.profiles import TAIL, Kinks
from hjprofile.problem.ranges import as_number, instance, number, shown
from hjprofile.solvers.characteristics.shock_fitting import COARSEST, FINEST, solve_characteristics
from hjprofile.solvers.data_resolution import cells_resolve
from hjprofile.solvers.front_tracking import track_fronts
from hjprofile.solvers.grids import conservation
from hjprofile.solvers.grids import hamilton_jacobi as hj
from hjprofile.solvers.grids.bounds_monitor import (
    HIGHER_ORDER,
    LOCAL,
    MONOTONE,
    STEEP,
    STEEP_SECOND_ORDER,
    TELESCOPING,
    WITH_LAYER,
    BoundsMonitor,
    Promises,
)
from hjprofile.solvers.grids.high_order import ORDERS
from hjprofile.solvers.grids.kink_tracker import KinkTracker
from hjprofile.solvers.grids.march import NOBODY, Scheme, march
from hjprofile.solvers.run import Keeper, Monitor, Run, in_order
from hjprofile.solvers.select import least_work
from hjprofile.solvers.vertical_steps.step_fronts import step_law
from hjprofile.solvers.vertical_steps.step_monitor import StepMonitor, with_dates
from hjprofile.solvers.whole_line import also_on_the_whole_line

Progress = Callable[[float], None]

HJ_METHODS = (*hj.FLUXES, *ORDERS)
CONSERVATIVE_METHODS = ("conservative", *conservation.FLUXES, *conservation.HIGH_ORDER)
# What each method on a grid keeps to; see bounds_monitor.py
PROMISES: Mapping[str, Promises] = MappingProxyType(
    {
        **dict.fromkeys((*HJ_METHODS, *CONSERVATIVE_METHODS), HIGHER_ORDER),
        **{f"{form}{name}": MONOTONE for form in ("", "conservative-") for name in ("godunov", "lax-friedrichs")},
        **{f"{form}telescoping": TELESCOPING for form in ("", "conservative-")},
        **{f"{form}local-lax-friedrichs": LOCAL for form in ("", "conservative-")},
    }
)
METHODS = (*HJ_METHODS, *CONSERVATIVE_METHODS, *OFF_GRID)


def solve_hj(
    problem: Problem,
    grid: Grid,
    method: str = DEFAULT_METHOD,
    cfl: float = DEFAULT_CFL,
    progress: Progress | None = None,
    refresh: float | None = None,
) -> Run:
    """Solves u_t + K f(u_x - 1) = 0 on the nodes, as W = u - x (theory, §2).

    `method` is "local-lax-friedrichs", "lax-friedrichs", "godunov", "telescoping" (first order), "eno2" or "weno5";
    `cfl` the time step as a part of the largest that the method admits, up to 1; `refresh` how long the factor is kept
    before it is taken anew (theory, §10; None: anew in every step). Raises InputError for bad input, and RunError if
    the run cannot start; one that breaks down later returns what was good, with the reason in `status`.
    """
    instance("problem", problem, Problem)
    _known(method, HJ_METHODS)
    problem.check(grid, method, refresh)
    return _solve(problem, grid, method, cfl, progress, refresh=refresh)


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
    instance("problem", problem, Problem)
    _known(method, CONSERVATIVE_METHODS)
    problem.check(grid, method, refresh)
    return _solve(problem, grid, method, cfl, progress, refresh=refresh)


def solve(problem: Problem, tolerance: float, grid: Grid | None = None, progress: Progress | None = None) -> Run:
    """Solves to a tolerance on sup|u - exact u| over all saved times with the least work (`solvers/select.py`).

    The result is read on `grid`, by default 2000 cells over the profile. `method` says what was chosen, `account` why,
    and `error_estimate` what was reached. Raises InputError for bad input, and RunError if no method gets through.
    """
    instance("problem", problem, Problem)
    asked, tolerance = tolerance, as_number(tolerance)
    if not FINEST <= tolerance <= 1.0:
        raise InputError(f"tolerance = {shown(asked)} must lie between {FINEST:g} and 1")
    grid = problem.grid(tail=min(TAIL, 0.01 * tolerance)) if grid is None else grid
    problem.check(grid, "auto")

    def on_grid(problem: Problem, grid: Grid, method: str) -> Run:
        return _solve(problem, grid, method, DEFAULT_CFL, progress)

    return least_work(problem, grid, tolerance, on_grid, progress)


def check_method(case: Case) -> None:
    """Raises InputError if the case asks for a method that does not exist, or for one without what it needs."""
    try:
        _known(case.method, METHODS)
        if case.tolerance is not None and case.method not in ("characteristics", "auto"):
            raise InputError(
                f"tolerance applies to the methods characteristics and auto, not to {case.method}; "
                "leave it out, or set method = 'auto'"
            )
        most = COARSEST if case.method == "characteristics" else 1.0
        if case.tolerance is not None and not FINEST <= case.tolerance <= most:
            raise InputError(f"tolerance = {case.tolerance:g} must lie between {FINEST:g} and {most:g}")
        if case.tolerance is None and case.method == "auto":
            raise InputError("method = 'auto' needs a tolerance: the largest error of u that will do")
        case.problem.check_method(case.method, case.refresh)
    except InputError as error:
        raise InputError(f"{case.source}: [solver] {error}", about="method-and-tolerance") from None


def solve_case(case: Case, progress: Progress | None = None, strict: bool = False, keeper: Keeper | None = None) -> Run:
    """Solves a case by its own method.

    With `strict` a run on a grid stops where it breaks a bound that its method promises; any other returns with that
    as its status. A keeper keeps checkpoints of runs on a grid; others take seconds. Raises InputError if the case asks
    for incompatible options, or for checkpoints of a Python function of no file. Raises RunError if the run cannot
    start, or if no method gets through with `auto`.
    """
    instance("case", case, Case)
    check_method(case)
    problem, grid, method = case.problem, case.grid, case.method
    if method in HJ_METHODS or method in CONSERVATIVE_METHODS:
        problem.check(grid, method, case.refresh)
        itself = identity(case) | {"strict": strict} if keeper else NOBODY
        return _solve(problem, grid, method, case.cfl, progress, strict, keeper, case.refresh, itself)
    if method == "auto":
        assert case.tolerance is not None
        run = solve(problem, case.tolerance, grid, progress)
    elif method == "characteristics":
        run = solve_characteristics(problem, grid, case.tolerance, progress)
        if case.tolerance and run.done and not run.meets(case.tolerance):
            finest = solve_characteristics(problem, grid, FINEST, progress)
            run = replace(finest, case=run.case) if finest.done else run
        run = run.judged(case.tolerance) if case.tolerance else run
    else:
        run = track_fronts(problem, grid, progress=progress)
    return (
        replace(run, status=f"went to its end, but {run.broken_bounds[0]}")
        if strict and run.done and run.broken_bounds
        else run
    )


def _known(method: str, methods: tuple[str, ...]) -> None:
    if not isinstance(method, str) or method not in methods:
        hint = did_you_mean(str(method), methods)
        raise InputError(f"method = {shown(method)} is not known{hint} (allowed: {', '.join(methods)})")


def _promises(problem: Problem, method: str) -> Promises:
    """What a method keeps to on this problem."""
    if problem.law.grows_linearly:
        return STEEP_SECOND_ORDER if method == "conservative" else STEEP
    return WITH_LAYER if problem.thickness else PROMISES[method]


@also_on_the_whole_line
def _solve(
    problem: Problem, grid: Grid, method: str, cfl: float, progress: Progress | None,
    strict: bool = False, keeper: Keeper | None = None, refresh: float | None = None, identity: Mapping = NOBODY,
) -> Run:  # fmt: skip
    """Run a method on a grid, watched; `identity` distinguishes a keeper's checkpoints from those of other runs."""
    cfl = number("cfl", cfl)
    scheme: Scheme = (hj if method in HJ_METHODS else conservation).scheme(problem, grid, method, refresh)
    bounds = BoundsMonitor(
        problem.law, grid, scheme.W, problem.profile.inflow, problem.end, _promises(problem, method),
        hj.FLUXES.get(method.removeprefix("conservative-")), strict, problem.coefficient, scheme.factor.refresh,
    )  # fmt: skip
    if problem.law.grows_linearly:
        table = step_law(problem.law, 0.5 * (float(np.min(np.diff(scheme.W))) / grid.dx - 1.0))
        steps = StepMonitor(table, grid, problem.times, problem.law.f)
        tracker = KinkTracker(problem.law, grid, steps.hidden)
        watching: dict[str, Monitor] = {"bounds": bounds, "kinks": tracker, "steps": steps}
    else:
        tracker = KinkTracker(problem.law, grid)
        watching = {"bounds": bounds, "kinks": tracker}
    case = resolved_case(problem, grid, method, cfl, refresh=scheme.factor.refresh)
    record = march(scheme, problem, grid, cfl, watching, progress, tracker.happened, keeper, identity)
    kinks, events = tracker.result(record.times)
    vertical_steps = None
    cautions = cells_resolve(problem, grid).caution(f"{grid.cells} cells", "more cells, or the method auto")
    if problem.law.grows_linearly:
        # a grid does not show from which kink a step came: steps are numbered after all kinks
        taken = max([k.kink for k in kinks] + [e.kink for e in events], default=0)
        vertical_steps, more = steps.result(taken)
        events, doubts = with_dates(in_order(events + more), grid, table, isinstance(problem.profile, Kinks))
        cautions = (*cautions, *doubts)
    u = record.W
    u += grid.nodes
    return Run(
        title=problem.title,
        method=method,
        case=case,
        time=record.times,
        x=grid.nodes,
        x_cell=grid.centres,
        u=u,
        q=record.q,
        K=record.K,
        status=record.status,
        steps=record.steps,
        step_range=record.step_range,
        wall_seconds=record.wall_seconds,
        kinks=kinks,
        events=events,
        vertical_steps=vertical_steps,
        bounds=bounds.bounds,
        eroded_volume=bounds.eroded_volume,
        outflow=bounds.outflow,
        volume_budget_error=bounds.budget_error,
        units=problem.profile.units,
        account=problem.profile.account,
        cautions=cautions,
    )
