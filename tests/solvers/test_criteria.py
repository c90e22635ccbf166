"""Criteria that stop a run, against the run that they do not stop."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import hjprofile as hj

PROBLEM = hj.Problem(hj.rational(), hj.kinks([-3.0, -1.0], [0.4, 1.2]), end=6.0, snapshots=121)
GRID = hj.Grid(-6.0, 300)
SOLVERS = {
    "godunov": lambda problem, callback=None: hj.solve_hj(problem, GRID, "godunov", callback=callback),
    "conservative": lambda problem, callback=None: hj.solve_conservative(problem, GRID, callback=callback),
    "fronts": lambda problem, callback=None: hj.track_fronts(problem, GRID, callback=callback),
    "characteristics": lambda problem, callback=None: hj.solve_characteristics(problem, GRID, callback=callback),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_each_stops_at_the_first_time_of_the_whole_run_that_meets_it(name):
    """The whole run has a row for each saved time; the criterion is evaluated on its arrays by other means."""
    solver = SOLVERS[name]
    whole = solver(PROBLEM)
    eroded = np.array([np.sum((whole.u[0, :-1] - u[:-1] + whole.u[0, 1:] - u[1:]) / 2) * GRID.dx for u in whole.u])
    lowering = np.abs(np.diff(whole.u, axis=0)).max(axis=1) / np.diff(whole.time)
    kinks = np.array([len(whole.kinks_at(i)) for i in range(whole.time.size)])
    assert kinks[0] == 2 and kinks[-1] == 0 and lowering[-1] < 0.1 < lowering.max()  # each criterion has its time
    for criterion, met, first in (
        (hj.until_eroded(1.0), eroded >= 1.0, 0),
        (hj.until_steady(0.1), lowering <= 0.1, 1),
        (hj.until_kinks(1), kinks <= 1, 0),
        (hj.until_kinks(), kinks == 0, 0),
    ):
        run = solver(PROBLEM, criterion)
        t = whole.time[first + int(np.argmax(met))]
        assert 0.0 < t < PROBLEM.end and run.done and run.time[-1] == pytest.approx(t, abs=1e-12)
        assert str(run.stop) == f"{criterion!r} returned True at t = {t:.6g}"
        assert np.abs(run.u[-1] - whole.at(t).u).max() <= 1e-9


def test_a_kink_is_gone_when_closed_forms_say_so():
    """One travelling kink of the rational law leaves at t = |s| + a (1 - e^s) (test_chart): here 2 + 0.5 (1 - e^-2)."""
    leaves = 2.0 + 0.5 * (1.0 - np.exp(-2.0))
    problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [0.5]), end=4.0, snapshots=401)
    run = hj.track_fronts(problem, callback=hj.until_kinks())
    assert leaves <= run.time[-1] <= leaves + 0.01


def test_a_criterion_serves_many_runs_and_travels_to_other_processes():
    for criterion in (hj.until_eroded(1.0), hj.until_steady(0.1), hj.until_kinks(1)):
        first = SOLVERS["godunov"](PROBLEM, criterion)
        again = SOLVERS["godunov"](PROBLEM, criterion)
        sent = SOLVERS["godunov"](PROBLEM, pickle.loads(pickle.dumps(criterion)))
        assert first.time[-1] == again.time[-1] == sent.time[-1] < PROBLEM.end


def test_a_criterion_that_is_never_met_changes_nothing():
    short = replace(PROBLEM, end=0.5, snapshots=6)
    for criterion in (hj.until_eroded(1e6), hj.until_steady(1e-9), hj.until_kinks(0)):
        run = SOLVERS["godunov"](short, criterion)
        assert run.stop is None and run.time[-1] == 0.5


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf, "1", None, [1.0], True])
def test_bad_criteria(wrong):
    for criterion, name in ((hj.until_steady, "rate"), (hj.until_eroded, "volume")):
        with pytest.raises(hj.InputError, match=f"{name} = .* must be a positive number"):
            criterion(wrong)
    if wrong != 0.0:
        with pytest.raises(hj.InputError, match=r"most = .* must be a whole number, 0 or larger"):
            hj.until_kinks(wrong)
    with pytest.raises(hj.InputError, match=r"most = 0\.5 must be a whole number"):
        hj.until_kinks(0.5)
