"""Callbacks: what they see, and the runs that they stop, for every solver."""

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.stop import Reason

GRID = hj.Grid(left=-6.0, cells=100)
PROBLEM = hj.Problem(hj.rational(), hj.kinks([-4.0], [1.0]), end=2.0, snapshots=9)
SHORTER = hj.Problem(hj.rational(), hj.kinks([-4.0], [1.0]), end=1.0, snapshots=5)
CASE = {
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-4.0], "amplitudes": [1.0]},
    "domain": {"left": -6.0, "cells": 100},
    "time": {"end": 2.0, "snapshots": 9},
}


def case_by(method):
    return lambda problem, callback=None: hj.solve_case(
        hj.load_case(CASE, {"solver.method": method, "time.end": problem.end, "time.snapshots": problem.snapshots}),
        callback=callback,
    )


SOLVERS = {
    "hj": lambda problem, callback=None: hj.solve_hj(problem, GRID, callback=callback),
    "conservative": lambda problem, callback=None: hj.solve_conservative(problem, GRID, callback=callback),
    "fronts": lambda problem, callback=None: hj.track_fronts(problem, GRID, callback=callback),
    "characteristics": lambda problem, callback=None: hj.solve_characteristics(problem, GRID, callback=callback),
    "inverse": lambda problem, callback=None: hj.solve_inverse(problem, GRID, callback=callback),
    "auto": lambda problem, callback=None: hj.solve(problem, 1e-4, GRID, callback=callback),
    "a case on a grid": case_by("godunov"),
    "a case by fronts": case_by("fronts"),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_a_callback_sees_each_saved_state(name):
    seen = []
    run = SOLVERS[name](PROBLEM, lambda t, state: seen.append((t, state)))
    assert run.done and run.stop is None
    assert [t for t, _ in seen] == run.time.tolist()
    for i, (t, state) in enumerate(seen):
        assert state.t == t
        for field in ("u", "q", "K"):
            assert np.array_equal(getattr(state, field), getattr(run, field)[i])
            assert not getattr(state, field).flags.writeable


@pytest.mark.parametrize("name", SOLVERS)
def test_a_callback_changes_nothing(name):
    plain, seen = SOLVERS[name](PROBLEM), SOLVERS[name](PROBLEM, lambda t, state: False)
    assert np.array_equal(plain.u, seen.u) and plain.eroded_volume == seen.eroded_volume


@pytest.mark.parametrize("name", SOLVERS)
def test_a_callback_stops_a_run(name):
    """The run is that of a problem that ends there, with the totals of that time."""
    calls = []

    def late(t, state):
        calls.append(t)
        return t >= 1.0

    run, shorter = SOLVERS[name](PROBLEM, late), SOLVERS[name](SHORTER)
    assert run.done and run.status == "done"
    assert run.stop.reason is Reason.CALLBACK and str(run.stop) == "late returned True at t = 1"
    assert calls == run.time.tolist() == shorter.time.tolist()
    assert run.case["time"]["end"] == 2.0
    # the lengths of time steps on a grid may differ, because their choice depends on the next saved time only
    assert np.abs(run.u - shorter.u).max() < 1e-12
    for total in ("eroded_volume", "toe_outflow", "crest_lowering"):
        assert getattr(run, total) == pytest.approx(getattr(shorter, total), abs=1e-9)
    assert [k.time for k in run.kinks] == [k.time for k in shorter.kinks]
    if name.startswith("a case"):
        assert run.error_estimate == pytest.approx(shorter.error_estimate, rel=1e-6)
        assert run.toe_outflow_error == pytest.approx(shorter.toe_outflow_error, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("at", [0.0, 2.0])
def test_the_first_and_the_last_saved_time(name, at):
    run = SOLVERS[name](PROBLEM, lambda t, state: t >= at)
    assert run.done and run.stop.reason is Reason.CALLBACK
    assert run.time[-1] == at


def test_on_a_grid_the_run_waits_for_the_callback():
    """The state is shown before the next step, so that a long run ends early."""
    fractions, count = [], []

    def second(t, state):
        count.append(len(fractions))
        return len(count) == 2

    hj.solve_hj(PROBLEM, GRID, progress=fractions.append, callback=second)
    assert len(fractions) == count[-1] and fractions[-1] < 0.2


def test_a_window_of_the_whole_line_is_shown_in_the_time_of_the_line():
    grid = hj.Grid(left=-6.0, cells=100, right=3.0)
    problem = hj.Problem(hj.rational(), hj.kinks([-4.0], [1.0]), end=2.0, snapshots=5, line="whole")
    seen = []
    for solver in (hj.solve_hj, hj.track_fronts):
        run = solver(problem, grid, callback=lambda t, state: seen.append((t, state.x[-1])) or t >= 1.0)
        assert run.time.tolist() == [0.0, 0.5, 1.0] and run.done and run.stop.reason is Reason.CALLBACK
    assert seen == 2 * [(0.0, 3.0), (0.5, 3.0), (1.0, 3.0)]


def test_laws_with_other_units():
    """With f'(0) = 100 the solvers compute in other units; the callback sees those of the problem."""
    law = hj.expression("100*q/(1+q)")
    problem = hj.Problem(law, hj.kinks([-4.0], [1.0]), end=0.02, snapshots=5)
    seen = []
    run = hj.track_fronts(problem, GRID, callback=lambda t, state: seen.append(t) or t >= 0.01)
    assert seen == run.time.tolist() == problem.times[:3].tolist()


def test_an_exception_of_a_callback_is_not_changed():
    def fails(t, state):
        raise KeyError("mine")

    for solve in SOLVERS.values():
        with pytest.raises(KeyError, match="mine"):
            solve(PROBLEM, fails)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_callback_that_is_no_function_is_rejected(name):
    with pytest.raises(hj.InputError, match="callback = 'stop' must be a function"):
        SOLVERS[name](PROBLEM, "stop")


@pytest.mark.parametrize("answer", [1, "yes", np.array([True, True]), None, np.False_])
def test_only_true_stops(answer):
    assert hj.solve_hj(PROBLEM, GRID, callback=lambda t, state: answer).stop is None


def test_a_stopped_run_is_stored_and_read(tmp_path):
    run = hj.solve_hj(PROBLEM, GRID, callback=lambda t, state: np.bool_(t >= 1.0))
    hj.write_run(run, tmp_path / "run", vtk=False, plots=False)
    again = hj.load_run(tmp_path / "run")
    assert again.done and again.time[-1] == 1.0 and np.array_equal(again.u, run.u)
