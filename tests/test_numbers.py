"""Numbers at the edge of the range, everywhere where one is given: a result, or one sentence, and at once."""

import time
import warnings

import numpy as np
import pytest
from bad_cases import with_files

import hjprofile as hj
from hjprofile.evidence.dependence import dependence
from hjprofile.evidence.fractional import fractional_steps
from hjprofile.evidence.stability import stability
from hjprofile.output.plots.animation import animation

STRANGE = [
    1e308, -1e308, 5e-324, 1e-310, -0.0, float("inf"), float("nan"), 10**400, -(10**400), True, "1", None, [], 1j,
    np.float32(0.5), np.array(1e308), np.array([0.5]), 1e150, 1e16, 1e-16, 1e-10, 1e-8, 1e30, 7,
]  # fmt: skip
LONGEST = 5.0  # seconds of this process

LAW = hj.rational()
SLOPE = hj.kinks([-3.0, -2.0], [0.4, 1.2])
GRID = hj.Grid(-6.0, 200)


def problem(profile=SLOPE, end=0.1, **named):
    return hj.Problem(LAW, profile, end=end, snapshots=2, **named)


def solved(problem, grid=GRID, method="godunov", **named):
    return hj.solve_hj(problem, grid, method, **named)


def run_profile(profile, left=-6.0):
    return [solve(problem(profile)) for solve in (solved, lambda p: hj.solve_conservative(p, GRID))]


def fronts(profile):
    return hj.track_fronts(problem(profile), GRID, 40)


def characteristics(profile):
    return hj.solve_characteristics(problem(profile), GRID, 1e-8)


def accurately(profile):
    return hj.solve(problem(profile), 1e-3, GRID)


PROFILE_OF = {
    "kinks.positions": lambda v: hj.kinks([v], [0.4]),
    "kinks.amplitudes": lambda v: hj.kinks([-3.0], [v]),
    "bumps.amplitudes": lambda v: hj.bumps([v], [-3.0], [0.5]),
    "bumps.centres": lambda v: hj.bumps([0.5], [v], [0.5]),
    "bumps.widths": lambda v: hj.bumps([0.5], [-3.0], [v]),
    "steps.edges": lambda v: hj.steps([v, -2.0], [0.5]),
    "steps.edges, right": lambda v: hj.steps([-3.0, v], [0.5]),
    "steps.values": lambda v: hj.steps([-3.0, -2.0], [v]),
    "points.x": lambda v: hj.points([v, -2.0], [0.5, 0.5]),
    "points.q": lambda v: hj.points([-3.0, -2.0], [0.5, v]),
    "steady.flux": lambda v: hj.steady(v, -2.0),
    "steady.kink": lambda v: hj.steady(0.3, v),
    "profile": lambda v: hj.profile(lambda x: x + np.where(x > -3.0, 1.0, 0.0) * v),
    "profile itself": lambda v: hj.profile(v),
}
SOLVERS = {"grids": run_profile, "fronts": fronts, "characteristics": characteristics, "auto": accurately}
CALLS = {
    f"{name} by {solver}": (lambda v, make=make, solve=solve: solve(make(v)))
    for name, make in PROFILE_OF.items()
    for solver, solve in SOLVERS.items()
}
CALLS |= {
    "Problem.law": lambda v: hj.Problem(v, SLOPE, 1.0),
    "Problem.profile": lambda v: hj.Problem(LAW, v, 1.0),
    "Problem.end": lambda v: solved(problem(end=v)),
    "Problem.end, fronts": lambda v: hj.track_fronts(problem(end=v), GRID, 40),
    "Problem.end, bumps fronts": lambda v: hj.track_fronts(problem(hj.bumps([0.5], [-3.0], [0.5]), end=v), GRID, 40),
    "Problem.end, bumps characteristics": lambda v: hj.solve_characteristics(
        problem(hj.bumps([0.5], [-3.0], [0.5]), end=v), GRID, 1e-8
    ),
    "Problem.end, solve": lambda v: hj.solve(problem(hj.bumps([0.5], [-3.0], [0.5]), end=v), 1e-3, GRID),
    "Problem.end, whole": lambda v: solved(problem(end=v, line="whole"), hj.Grid(-6.0, 40, 1.0)),
    "Problem.end, conservative": lambda v: hj.solve_conservative(problem(end=v), GRID),
    "Problem.end, weno5": lambda v: hj.solve_hj(problem(end=v), GRID, "weno5"),
    "Problem.snapshots": lambda v: solved(hj.Problem(LAW, SLOPE, 0.1, snapshots=v)),
    "Problem.snapshots, one": lambda v: solved(hj.Problem(LAW, SLOPE, 0.1, snapshots=[v])),
    "Problem.title": lambda v: hj.Problem(LAW, SLOPE, 0.1, title=v),
    "Problem.coefficient": lambda v: hj.Problem(LAW, SLOPE, 0.1, coefficient=v),
    "Problem.line": lambda v: hj.Problem(LAW, SLOPE, 0.1, line=v),
    "Problem.thickness": lambda v: hj.solve_conservative(problem(thickness=v), GRID, "conservative-telescoping"),
    "Grid.left": lambda v: solved(problem(), hj.Grid(v, 40)),
    "Grid.left, fronts": lambda v: hj.track_fronts(problem(), hj.Grid(v, 40)),
    "Grid.left, bumps fronts": lambda v: hj.track_fronts(problem(hj.bumps([0.5], [-3.0], [0.5])), hj.Grid(v, 40), 40),
    "Grid.left, bumps characteristics": lambda v: hj.solve_characteristics(
        problem(hj.bumps([0.5], [-3.0], [0.5])), hj.Grid(v, 40), 1e-8
    ),
    "Grid.left, python": lambda v: solved(problem(hj.profile(lambda x: x)), hj.Grid(v, 40)),
    "Grid.cells": lambda v: hj.Grid(-6.0, v),
    "Grid.right": lambda v: solved(problem(line="whole"), hj.Grid(-6.0, 40, v)),
    "power.m": lambda v: solved(hj.Problem(hj.power(v), SLOPE, 0.1)),
    "expression": lambda v: hj.expression(v),
    "expression of a constant": lambda v: solved(hj.Problem(hj.expression(f"{v!r}*q/(1+q)"), SLOPE, 0.1)),
    "growth": lambda v: hj.erosion_law(np.log1p, growth=v),
    "erosion_law": lambda v: hj.erosion_law(v),
    "derivative": lambda v: hj.erosion_law(np.log1p, derivative=v),
    "inverse": lambda v: hj.erosion_law(np.log1p, inverse=v),
    "coefficient": lambda v: hj.coefficient(v),
    "a coefficient's value": lambda v: solved(problem(coefficient=hj.coefficient(lambda t, x: v + 0 * x * t))),
    "solve.tolerance": lambda v: hj.solve(problem(), v, GRID),
    "solve.grid": lambda v: hj.solve(problem(), 1e-3, v),
    "solve.problem": lambda v: hj.solve(v, 1e-3),
    "solve_hj.problem": lambda v: hj.solve_hj(v, GRID),
    "solve_hj.grid": lambda v: hj.solve_hj(problem(), v),
    "solve_hj.method": lambda v: hj.solve_hj(problem(), GRID, v),
    "solve_hj.cfl": lambda v: solved(problem(), cfl=v),
    "solve_hj.refresh": lambda v: solved(problem(), refresh=v),
    "solve_conservative.cfl": lambda v: hj.solve_conservative(problem(), GRID, cfl=v),
    "solve_conservative.problem": lambda v: hj.solve_conservative(v, GRID),
    "solve_case": lambda v: hj.solve_case(v),
    "track_fronts.problem": lambda v: hj.track_fronts(v),
    "track_fronts.fronts": lambda v: hj.track_fronts(problem(hj.bumps([0.5], [-3.0], [0.5])), GRID, v),
    "solve_characteristics.tolerance": lambda v: hj.solve_characteristics(problem(), GRID, v),
    "solve_characteristics.problem": lambda v: hj.solve_characteristics(v),
    "survey.critical_slope": lambda v: solved(problem(hj.survey("survey.csv", v, 2.0, "isotonic"))),
    "survey.length": lambda v: solved(problem(hj.survey("survey.csv", 0.5, v, "isotonic"))),
    "survey.file": lambda v: hj.survey(v, 0.5, 2.0),
    "survey.repair": lambda v: hj.survey("survey.csv", 0.5, 2.0, v),
    "read_survey": lambda v: hj.read_survey(v),
    "load_case": lambda v: hj.load_case(v),
    "load_case.overrides": lambda v: hj.load_case("two_kinks", v),
    "load_case.overrides, key": lambda v: hj.load_case(
        "two_kinks", {v: 1} if v != [] and not isinstance(v, np.ndarray) else {}
    ),
    "load_run": lambda v: hj.load_run(v),
    "stored_coefficient": lambda v: hj.stored_coefficient(v),
    "write_run": lambda v: hj.write_run(v, "out", False, False),
    "compare": lambda v: hj.compare(v, v),
    "observed_order": lambda v: hj.observed_order([1.0, v], [2.0, v]),
    "check": lambda v: hj.check(v),
    "check_consistency": lambda v: hj.check_consistency(v, GRID),
    "check_consistency.grid": lambda v: hj.check_consistency(problem(), v),
    "check_consistency.cfl": lambda v: hj.check_consistency(problem(), GRID, v) if v not in (7,) else None,
    "chart.problem": lambda v: hj.chart("", v, GRID),
    "chart.grid": lambda v: hj.chart("", problem(end=0.0), v),
    "slow_erosion": lambda v: hj.slow_erosion(problem(), GRID, [v]),
    "slow_erosion, list": lambda v: hj.slow_erosion(problem(), GRID, v),
    "sweep.case": lambda v: hj.sweep(v, {"time.end": [0.1]}),
    "sweep.vary": lambda v: hj.sweep("two_kinks", v),
    "sweep.values": lambda v: hj.sweep("two_kinks", {"time.end": v}),
    "fit.sigma": lambda v: (
        hj.fit("hillslope", [0.0, 1.0, 2.0], [0.0, 1.0, 2.0], ["time.end"], v) if v not in (7,) else None
    ),
    "fit.x": lambda v: hj.fit("hillslope", [0.0, v, 2.0], [0.0, 1.0, 2.0], ["time.end"]),
    "fit.vary": lambda v: hj.fit("hillslope", [0.0, 1.0, 2.0], [0.0, 1.0, 2.0], v),
    "fit.vary, name": lambda v: hj.fit("hillslope", [0.0, 1.0, 2.0], [0.0, 1.0, 2.0], [v]),
    "stability": lambda v: stability("", v, GRID),
    "dependence": lambda v: dependence("", v, GRID),
    "fractional": lambda v: fractional_steps(problem(), GRID, "godunov", [v]),
    "animation.fps": lambda v: animation(None, ".gif", v) if v is None or v in (0, float("inf"), 1e308) else None,
}


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    import os

    here = os.getcwd()
    os.chdir(with_files(tmp_path_factory.mktemp("numbers")))
    yield
    os.chdir(here)


def in_order(call):
    started = time.process_time()
    with np.errstate(all="warn", under="ignore"), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            call()
        except (hj.InputError, hj.RunError) as error:
            assert "\n" not in str(error)
    assert time.process_time() - started < LONGEST


@pytest.mark.parametrize("value", STRANGE, ids=lambda v: repr(v)[:16])
@pytest.mark.parametrize("name", CALLS)
def test_a_call(name, value):
    in_order(lambda: CALLS[name](value))
