"""Run of a method on a grid: the scheme, its monitors, and the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import number
from hjprofile.solvers.data_resolution import cells_resolve
from hjprofile.solvers.grids.bounds_monitor import BoundsMonitor
from hjprofile.solvers.grids.kink_tracker import KinkTracker, with_kinks
from hjprofile.solvers.grids.march import NOBODY, march
from hjprofile.solvers.method import Method
from hjprofile.solvers.run import Keeper, Monitor, Run
from hjprofile.solvers.states import Callback

Progress = Callable[[float], None]


def solve_on_grid(
    problem: Problem, grid: Grid, method: Method, cfl: float, progress: Progress | None,
    strict: bool = False, keeper: Keeper | None = None, refresh: float | None = None, identity: Mapping = NOBODY,
    callback: Callback | None = None,
) -> Run:  # fmt: skip
    """Run a method on a grid, with monitors and a callback of the user.

    `identity` distinguishes the checkpoints of the run from others.
    """
    cfl, setup = number("cfl", cfl), method.setup_for(problem)
    scheme = setup.scheme(problem, grid, refresh)
    bounds = BoundsMonitor(problem, grid, scheme.W, setup.guarantees, method.flux, strict, scheme.factor.refresh)
    extension = setup.extension(problem, grid, scheme) if setup.extension else None
    hidden = {"hidden": extension.hidden} if extension else {}
    tracker = KinkTracker(problem.law, grid, least=problem.profile.rounding, **hidden)
    watching: dict[str, Monitor] = {"bounds": bounds, "kinks": tracker, **(extension.monitors if extension else {})}
    case = resolved_case(problem, grid, method.name, cfl, refresh=scheme.factor.refresh)
    shown = None if callback is None else with_kinks(callback, tracker)
    record = march(scheme, problem, grid, cfl, watching, progress, tracker.kinks_changed, keeper, identity, shown)
    kinks, events = tracker.result(record.times)
    u = record.W
    u += grid.nodes
    run = Run(
        title=problem.title,
        method=method.name,
        case=case,
        time=record.times,
        x=grid.nodes,
        x_cell=grid.centres,
        u=u,
        q=record.q,
        K=record.K,
        stop=record.stop,
        steps=record.steps,
        step_range=record.step_range,
        wall_seconds=record.wall_seconds,
        kinks=kinks,
        events=events,
        bounds=bounds.bounds,
        eroded_volume=bounds.eroded_volume,
        toe_outflow=math.nan if problem.coefficient else bounds.toe_outflow,
        crest_lowering=bounds.crest_lowering,
        volume_budget_error=bounds.budget_error,
        units=problem.profile.units,
        surveyed=problem.profile.surveyed,
        account=problem.profile.account,
        law=problem.law,
        cautions=cells_resolve(problem, grid).caution(f"{grid.cells} cells", "more cells, or the method auto"),
    )
    return extension.complete(run) if extension else run
