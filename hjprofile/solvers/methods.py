"""Table of the methods: one row for each, with its properties.

A numerical flux is a row of FLUXES and defines two methods: one for u, and one for q by its numpy twin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from hjprofile.errors import InputError, did_you_mean
from hjprofile.problem import Problem
from hjprofile.problem.case_keys import DEFAULT_CFL
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import shown
from hjprofile.solvers.characteristics.shock_fitting import COARSEST, FINEST, solve_characteristics
from hjprofile.solvers.front_tracking import track_fronts
from hjprofile.solvers.grids import conservation as twins
from hjprofile.solvers.grids.bounds_monitor import (
    HIGHER_ORDER,
    LOCAL,
    MONOTONE,
    STEEP,
    STEEP_SECOND_ORDER,
    TELESCOPING,
    UNLIMITED,
    WITH_LAYER,
)
from hjprofile.solvers.grids.conservation import FirstOrder, HighOrderConservation, SecondOrder
from hjprofile.solvers.grids.factor import Factor
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import GridLaw, grid_law
from hjprofile.solvers.grids.grid_run import Progress, solve_on_grid
from hjprofile.solvers.grids.hamilton_jacobi import HamiltonJacobi, HighOrderHamiltonJacobi
from hjprofile.solvers.grids.high_order import ORDERS
from hjprofile.solvers.grids.kernels import wavefront
from hjprofile.solvers.grids.scheme import Scheme
from hjprofile.solvers.grids.setup import Setup
from hjprofile.solvers.inverse.inverse_levels import solve_inverse
from hjprofile.solvers.layer.layer_scheme import WithLayer
from hjprofile.solvers.method import Feature, Form, Method
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.select import least_work
from hjprofile.solvers.stop import ROBUST_METHOD
from hjprofile.solvers.vertical_steps.on_grids import SecondOrderTelescoping, StepsOnGrid
from hjprofile.solvers.whole_line import also_on_the_whole_line

ON_GRIDS = frozenset({Feature.INFLOW, Feature.COEFFICIENT, Feature.REFRESH, Feature.WHOLE_LINE})
MakeScheme = Callable[[Problem, Grid, float | None], Scheme]

FLUXES: Mapping[str, Flux] = MappingProxyType(
    {
        flux.name: flux
        for flux in (
            Flux(
                "lax-friedrichs", wavefront.LaxFriedrichs, twins.lax_friedrichs, cfl_limit=2 / 3, viscous=True,
                lasting=False,
            ),
            Flux("local-lax-friedrichs", wavefront.LocalLaxFriedrichs, twins.local_lax_friedrichs, viscous=True),
            Flux("godunov", wavefront.Godunov, twins.godunov),
            Flux("telescoping", wavefront.Telescoping, twins.telescoping),
        )
    }
)  # fmt: skip
_GUARANTEES = {"local-lax-friedrichs": LOCAL, "telescoping": TELESCOPING}  # else MONOTONE


def _data(problem: Problem, grid: Grid, refresh: float | None) -> tuple[GridLaw, Array, Factor]:
    """Return the law for compiled loops, W on the nodes, and the factor."""
    W = problem.profile.W(grid.nodes, problem.law)
    return grid_law(problem.law, np.diff(W) / grid.dx), W, Factor(grid, problem.coefficient, refresh)


def _for_height(make: Callable[..., Scheme], part: Flux | str) -> MakeScheme:
    """Return a constructor of schemes of heights from law, grid, W, a flux or name of an order, inflow and factor."""

    def scheme(problem: Problem, grid: Grid, refresh: float | None = None) -> Scheme:
        law, W, factor = _data(problem, grid, refresh)
        return make(law, grid, W, part, problem.profile.inflow, factor)

    return scheme


def _for_slope(make: Callable[..., Scheme], *parts: object) -> MakeScheme:
    """Return a constructor of schemes of cell means from law, grid, q, W at the left, inflow, `parts` and factor."""

    def scheme(problem: Problem, grid: Grid, refresh: float | None = None) -> Scheme:
        law, W, factor = _data(problem, grid, refresh)
        return make(law, grid, np.diff(W) / grid.dx, float(W[0]), problem.profile.inflow, *parts, factor)

    return scheme


def _without_factor(make: Callable[..., Scheme], *parts: object) -> MakeScheme:
    """Return a constructor as `_for_slope`, for a scheme that supports only the nonlocal K."""
    return _for_slope(lambda *given: make(*given[:-1]), *parts)


def _below_a_layer(problem: Problem, grid: Grid, refresh: float | None = None) -> Scheme:
    """Return the scheme for the bed below a rolling layer."""
    return _without_factor(WithLayer, FLUXES["telescoping"], problem.supply)(problem, grid, refresh)


def _second_order() -> Method:
    """Return the second-order method for q."""
    steps = _without_factor(SecondOrderTelescoping, FLUXES["telescoping"])
    return Method(
        "conservative", Form.SLOPE, ON_GRIDS | {Feature.LINEAR_GROWTH}, Setup(_for_slope(SecondOrder), HIGHER_ORDER),
        {Feature.LINEAR_GROWTH: Setup(steps, STEEP_SECOND_ORDER, StepsOnGrid)}, midpoint=True, cfl_proved=1.0,
        order=2.0,
    )  # fmt: skip


def _first_order() -> Iterator[Method]:
    """Yield the methods of first order, two for each flux."""
    for flux in FLUXES.values():
        steep = flux is FLUXES["telescoping"]  # correct speed of a vertical step for any K (§16)
        guarantees = _GUARANTEES.get(flux.name, MONOTONE)
        supports = ON_GRIDS | {Feature.LINEAR_GROWTH} if steep else ON_GRIDS
        about = {"flux": flux, "midpoint": True, "cfl_proved": 2 / 3 if flux.viscous else 1.0, "order": 1.0}
        for name, form, scheme in (
            (flux.name, Form.HEIGHT, _for_height(HamiltonJacobi, flux)),
            (f"conservative-{flux.name}", Form.SLOPE, _for_slope(FirstOrder, flux)),
        ):
            carries = flux.name if form is Form.SLOPE else ""
            method = Method(name, form, supports, Setup(scheme, guarantees), carries=carries, **about)  # type: ignore[arg-type]
            if steep:
                method = replace(method, variants={Feature.LINEAR_GROWTH: Setup(scheme, STEEP, StepsOnGrid)})
            if steep and form is Form.SLOPE:  # this flux conserves grains exactly (§15)
                layer = {Feature.LAYER: Setup(_below_a_layer, WITH_LAYER)}
                method = replace(method, supports=supports | {Feature.LAYER}, variants={**method.variants, **layer})
            yield method


def _high_order() -> Iterator[Method]:
    """Yield the methods of higher order, two for each order."""
    for name, order in ORDERS.items():
        guarantees = UNLIMITED if np.isnan(order.cfl_proved) else HIGHER_ORDER
        high = Setup(_for_height(HighOrderHamiltonJacobi, name), guarantees)
        row = Method(name, Form.HEIGHT, ON_GRIDS, high, cfl_proved=order.cfl_proved, order=order.smooth)
        yield row
        high = Setup(_for_slope(HighOrderConservation, name), guarantees)
        yield replace(row, name=f"conservative-{name}", form=Form.SLOPE, setup=high, carries=name)


on_grid = also_on_the_whole_line(solve_on_grid)
by_fronts = also_on_the_whole_line(track_fronts)
by_inverse = also_on_the_whole_line(solve_inverse)
by_characteristics = also_on_the_whole_line(solve_characteristics)
with_least_work = also_on_the_whole_line(least_work)


def _fronts(problem: Problem, grid: Grid, tolerance: float | None, progress: Progress | None) -> Run:
    """Solve by fronts."""
    return by_fronts(problem, grid, progress=progress)


def _inverse(problem: Problem, grid: Grid, tolerance: float | None, progress: Progress | None) -> Run:
    """Solve for x as a function of u, with as many levels as cells."""
    return by_inverse(problem, grid, progress=progress)


def _characteristics(problem: Problem, grid: Grid, tolerance: float | None, progress: Progress | None) -> Run:
    """Solve by characteristics to the tolerance, or to the finest one if that is not sufficient."""
    run = by_characteristics(problem, grid, tolerance, progress)
    if tolerance and run.done and not run.meets(tolerance):
        finest = by_characteristics(problem, grid, FINEST, progress)
        run = replace(finest, case=run.case) if finest.done else run
    return run.judged(tolerance) if tolerance else run


def _auto(problem: Problem, grid: Grid, tolerance: float | None, progress: Progress | None) -> Run:
    """Solve with the least work that meets the tolerance."""
    assert tolerance is not None

    def fallback(name: str) -> Callable[[Problem, Grid], Run]:
        return lambda problem, grid: on_grid(problem, grid, METHODS[name], DEFAULT_CFL, progress)

    fallbacks = {name: fallback(name) for name in ("conservative", ROBUST_METHOD)}
    return with_least_work(problem, grid, tolerance, fallbacks, progress)


_OFF_GRID = (
    Method("fronts", Form.OFF_GRID, frozenset({Feature.WHOLE_LINE, Feature.LINEAR_GROWTH}), solve=_fronts, order=2.0),
    Method("inverse", Form.OFF_GRID, frozenset({Feature.WHOLE_LINE, Feature.LINEAR_GROWTH}), solve=_inverse, order=1.0),
    Method(
        "characteristics", Form.OFF_GRID, frozenset({Feature.WHOLE_LINE}), solve=_characteristics,
        tolerance=(FINEST, COARSEST),
    ),
    Method(
        "auto", Form.OFF_GRID, frozenset({Feature.WHOLE_LINE, Feature.INFLOW}), solve=_auto, tolerance=(FINEST, 1.0),
        needs_tolerance=True,
    ),
)  # fmt: skip
_ROWS = (_second_order(), *_first_order(), *_high_order(), *_OFF_GRID)
_TABLE = {row.name: row for form in Form for row in _ROWS if row.form is form}
METHODS: Mapping[str, Method] = MappingProxyType(_TABLE)


def named(form: Form | None = None) -> tuple[str, ...]:
    """Return the names of the methods of a form, or of all."""
    return tuple(name for name, method in METHODS.items() if form in (None, method.form))


def find_method(name: str, among: tuple[str, ...] = ()) -> Method:
    """Return the method of that name, one of `among` if that is given. Raise InputError if there is none."""
    among = among or tuple(METHODS)
    if not isinstance(name, str) or name not in among:
        hint = did_you_mean(str(name), among)
        raise InputError(f"method = {shown(name)} is not known{hint} (allowed: {', '.join(among)})")
    return METHODS[name]
