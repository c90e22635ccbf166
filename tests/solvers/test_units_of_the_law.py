"""A problem and the same one in other units of length: the same steps, and u in proportion."""

import dataclasses

import numpy as np
import pytest
from random_scenes import twin, twin_grid

import hjprofile as hj
from hjprofile.solvers.units_of_the_law import Units

GRID = hj.Grid(-9.0, 400)
PROBLEMS = {
    "bumps": hj.Problem(hj.rational(), hj.bumps([0.9, -0.3], [-5.0, -2.0], [0.6, 0.4]), end=2.0, snapshots=3),
    "kinks": hj.Problem(hj.log(), hj.kinks([-6.0, -3.0], [0.8, 1.5]), end=3.0, snapshots=4),
    "steps": hj.Problem(hj.log(), hj.steps([-6.0, -4.0, -2.0], [0.5, -0.4]), end=1.0, snapshots=[0.5, 1.0]),
    "linear growth": hj.Problem(
        hj.expression("q+q/(1+q)", growth="linear"), hj.kinks([-4.0, -2.0], [0.5, 1.0]), end=0.5, snapshots=3
    ),
}
METHODS = {
    "fronts": lambda problem, grid, ratio: hj.track_fronts(problem, grid, 200),
    "characteristics": lambda problem, grid, ratio: hj.solve_characteristics(problem, grid, 1e-10 * ratio),
    "auto": lambda problem, grid, ratio: hj.solve(problem, 1e-3 * ratio, grid),
}
AS_LENGTHS = "u", "x", "x_cell"


PAIRS = [(name, m) for name in PROBLEMS for m in METHODS if name in ("bumps", "steps") or m == "fronts"]


@pytest.mark.parametrize("ratio", [2.0**-9, 2.0**4])
@pytest.mark.parametrize(("name", "method"), PAIRS)
def test_units_in_powers_of_two_change_no_bit(name, method, ratio):
    """Lengths, heights and times of a twin are multiplied without rounding, and so is all that comes out."""
    problem = twin(PROBLEMS[name], 1.0)  # with a law by its expression, as that of the other twin
    run = METHODS[method](problem, GRID, 1.0)
    other = METHODS[method](twin(problem, ratio), twin_grid(GRID, ratio), ratio)
    assert (other.status, other.steps, other.method) == (run.status, run.steps, run.method)
    for name in ("time", "u", "x", "q", "K"):
        factor = ratio**2 if name == "time" else ratio if name in AS_LENGTHS else 1.0
        np.testing.assert_array_equal(getattr(other, name), factor * getattr(run, name), err_msg=name)
    assert other.eroded_volume == ratio**2 * run.eroded_volume and other.crest_lowering == ratio * run.crest_lowering
    assert other.error_estimate == (run.error_estimate if run.error_estimate is None else ratio * run.error_estimate)
    assert [k._replace(time=k.time / ratio**2, x=k.x / ratio) for k in other.kinks] == [
        k._replace(speed=k.speed / ratio, rankine_hugoniot_speed=k.rankine_hugoniot_speed / ratio) for k in run.kinks
    ]
    assert [e._replace(time=e.time / ratio**2, x=e.x / ratio) for e in other.events] == list(run.events)
    assert {n: b.holds for n, b in other.bounds.items()} == {n: b.holds for n, b in run.bounds.items()}


@pytest.mark.parametrize("ratio", [0.03, 37.0, 1e3])
def test_other_units_give_the_same_solution(ratio):
    """Not a power of 2: the law of the solver's units is another one, and its result agrees to the estimate."""
    problem = PROBLEMS["bumps"]
    run = hj.solve_characteristics(problem, GRID, 1e-11)
    other = hj.solve_characteristics(twin(problem, ratio), twin_grid(GRID, ratio), 1e-11 * ratio)
    assert np.abs(other.u / ratio - run.u).max() <= run.error_estimate + other.error_estimate / ratio <= 1e-9
    assert [e.event for e in other.events] == [e.event for e in run.events]


def test_the_case_of_a_run_is_that_of_its_problem():
    """Not that of the units in which it was solved; a message, too, is in the problem's units."""
    problem = twin(PROBLEMS["bumps"], 64.0)
    run = hj.solve(problem, 1e-2, twin_grid(GRID, 64.0))
    assert run.case["time"]["end"] == problem.end and run.case["domain"]["left"] == -9.0 * 64.0
    assert run.case["erosion"] == problem.law.table and run.case["solver"]["tolerance"] == 1e-2
    steep = dataclasses.replace(problem, profile=hj.steps([-64e4, -64.0], [5.0]))
    stopped = hj.solve_characteristics(steep, hj.Grid(-64.1e4, 1000))
    assert stopped.status.startswith("stopped at t = 0, before t = ")
    assert f"{problem.times[1]:.6g}" in stopped.status or f"{problem.times[0]:.6g}" in stopped.status


def test_the_unit_is_the_power_of_two_nearest_to_R_at_0():
    assert Units.of(hj.rational()).length == 1.0
    assert Units.of(hj.expression("0.001*q/(1+q)")).length == 1024.0
    assert Units.of(hj.expression("1000*q/(1+q)")).length == 2.0**-10
