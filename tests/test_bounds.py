"""What each method promises, on random data as rough as the theory admits; and that broken schemes are told."""

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.monitors.bounds import BoundsMonitor
from hjprofile.problem.profiles import steps
from hjprofile.solvers import hj as hj_form
from hjprofile.solvers.methods import HJ_METHODS, PROMISES

LAWS = {"rational": hj.rational(), "log": hj.log(), "power": hj.power(2.0)}
FIRST_ORDER_METHODS = [name for name in PROMISES if name.removeprefix("conservative-") in hj_form.FLUXES]


def random_problem(rng, law):
    """Steps of total variation up to some 400 with q in [-0.95, 20], where K spans at most e^12, on 20 to 120 cells."""
    while True:
        cells, dx = int(rng.integers(20, 120)), 10.0 ** rng.uniform(-2.5, -0.7)
        n = int(rng.integers(1, min(cells // 2, 25)))
        q = np.exp(rng.uniform(np.log(0.05), np.log(21.0), n)) - 1.0
        kind = rng.integers(5)
        if kind == 0:
            q = np.abs(q)
        elif kind == 1:
            q = -np.abs(np.minimum(q, 0.0)) + 0.0
        elif kind == 2:
            q = np.sort(q)[:: rng.choice([-1, 1])]
        elif kind == 3:
            q = np.where(rng.random(n) < 0.5, 0.0, q)
        edges = -cells * dx * np.sort(rng.uniform(0.0, 0.9, n + 1))[::-1]
        if np.abs(LAWS[law].f(q) @ np.diff(edges)) > 12.0 or np.diff(edges).min() < 1e-3 * dx:
            continue
        speed = float(np.max(LAWS[law].derivative(np.append(q, 0.0))))
        end = float(cells * dx / speed * rng.uniform(0.1, 20.0))
        return hj.Problem(LAWS[law], steps(edges, q), end=end, snapshots=2), hj.Grid(-cells * dx, cells)


def check_promises(seed, law, method):
    rng = np.random.default_rng(seed)
    problem, grid = random_problem(rng, law)
    solver = hj.solve_hj if method in HJ_METHODS else hj.solve_conservative
    run = solver(problem, grid, method, cfl=1.0)
    assert run.done, (seed, run.status)
    assert all(np.isfinite(a).all() for a in (run.u, run.q, run.K)) and run.q.min() > -1.0
    assert run.warnings == [], (seed, law, method, run.warnings)


@pytest.fixture
def watchful(monkeypatch):
    """Every lot of steps is looked at, and every lot is one step: between them nothing can hide."""
    monkeypatch.setattr(BoundsMonitor, "wants", lambda self, state: True)
    monkeypatch.setattr(BoundsMonitor, "FROZEN_STEPS", 1)


@pytest.mark.parametrize("method", FIRST_ORDER_METHODS)
@pytest.mark.parametrize("law", LAWS)
def test_promises_on_random_data(law, method, watchful):
    for seed in range(8):
        check_promises(seed, law, method)


@pytest.mark.slow
@pytest.mark.parametrize("method", FIRST_ORDER_METHODS)
@pytest.mark.parametrize("law", LAWS)
def test_promises_on_5000_random_data(law, method, watchful):
    for seed in range(1000, 1000 + 5000 // len(LAWS) + 1):
        check_promises(seed, law, method)
