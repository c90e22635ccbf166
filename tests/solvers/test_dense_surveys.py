"""Dense surveys with noise: a tolerance is met with bounded work, and the estimate of the error holds."""

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.front_tracking import begin


def noisy(points: int, noise: float, seed: int = 0) -> hj.Problem:
    """Return a survey of 1200 m with waves of 8 m and white noise, which is repaired."""
    x = np.linspace(0.0, 1200.0, points)
    height = 400.0 + 0.36 * x + 8.0 * np.sin(x / 60.0) + noise * np.random.default_rng(seed).normal(size=points)
    profile = hj.survey(x=x, height=height, critical_slope=0.36, length=100.0, repair="isotonic")
    return hj.Problem(hj.rational(), profile, 3.0)


def test_the_tolerance_is_met_on_noisy_points():
    """1000 points; the reference has eight fronts for each point, and an error below 4e-5 by second order."""
    problem = noisy(1000, 0.1)
    run = hj.solve(problem, tolerance=1e-3)
    reference = hj.track_fronts(problem, problem.grid(run.cells), 8000)
    error = float(np.abs(run.u - reference.u).max())
    assert run.status == "done"
    assert error <= run.error_estimate <= 1e-3
    assert run.error_estimate <= 30.0 * error


def test_graded_fans_are_of_second_order():
    """Ungraded fans of as many fronts err by 0.03, because those with few fronts win over their neighbours."""
    problem = noisy(1000, 0.1, seed=3)
    grid = problem.grid(200)
    finest = hj.track_fronts(problem, grid, 8000).u
    coarse, fine = (np.abs(hj.track_fronts(problem, grid, n).u - finest).max() for n in (1000, 2000))
    assert coarse < 0.003
    assert fine < 0.4 * coarse  # a fourth by second order


def test_a_noisy_survey_of_20000_points_takes_few_steps():
    """Steps of the active part of the slope; the number of fronts at the start is bounded, and few of them remain."""
    problem = noisy(20_000, 0.1)
    begun = begin(problem, problem.grid(500).left, 9000)
    assert begun.resolution.holds
    assert begun.data.dense > 10_000
    assert begun.data.x.size < 100_000
    begun.tracker.advance(problem.end)
    assert begun.tracker.arrived
    assert begun.tracker.n < 1000
    assert begun.tracker.steps < 1000


def test_fronts_without_grains_rest_until_grains_arrive():
    """The hollows of a noisy survey hold K below 1e-60 on its lower part; after they are full, grains reach the toe.

    The volume balance d/dt ∫u = 1 - K(toe) is independent of the part that is advanced.
    """
    problem = noisy(8000, 1.0)
    run = hj.track_fronts(problem, problem.grid(500), 6000)
    assert run.K[0, 0] < 1e-30
    assert run.K[-1, 0] == pytest.approx(1.0, abs=0.9)
    assert run.bounds["volume_budget"].holds
