"""What each method promises, on random data as rough as the theory admits; and that broken schemes are told."""

import tracemalloc

import numpy as np
import pytest
from grid_methods import solve_by
from random_steps import LAWS, random_problem

import hjprofile as hj
from hjprofile.problem.profiles import steps
from hjprofile.solvers.grids import grid_law
from hjprofile.solvers.grids import hamilton_jacobi as hj_form
from hjprofile.solvers.grids.bounds_monitor import MONOTONE, BoundsMonitor
from hjprofile.solvers.grids.kernels import watch
from hjprofile.solvers.grids.kernels.sweep_law import Rational
from hjprofile.solvers.grids.kernels.watch import frozen_step
from hjprofile.solvers.methods import FLUXES, METHODS
from hjprofile.solvers.run import State

FIRST_ORDER_METHODS = [name for name, method in METHODS.items() if method.flux]


def check_promises(seed, law, method):
    rng = np.random.default_rng(seed)
    problem, grid = random_problem(rng, law)
    run = solve_by(problem, grid, method, cfl=1.0)
    assert run.done, (seed, run.status)
    assert all(np.isfinite(a).all() for a in (run.u, run.q, run.K)) and run.q.min() > -1.0
    assert run.broken_bounds == [], (seed, law, method, run.broken_bounds)


@pytest.fixture
def watchful(monkeypatch):
    """Every lot of steps is looked at, and every lot is one step: between them nothing can hide."""
    monkeypatch.setattr(BoundsMonitor, "wants", lambda self, state: True)
    monkeypatch.setattr(BoundsMonitor, "FROZEN_STEPS", 1)


@pytest.mark.parametrize("method", FIRST_ORDER_METHODS)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 8), marks=pytest.mark.slow)])
def test_promises_on_random_data(law, method, seeds, watchful):
    for seed in seeds:
        check_promises(seed, law, method)


@pytest.mark.slow  # the other form takes the same steps, see test_consistency.py
@pytest.mark.parametrize("method", FLUXES)
@pytest.mark.parametrize("law", LAWS)
def test_promises_on_5000_random_data(law, method, watchful):
    for seed in range(1000, 1000 + 5000 // len(LAWS) + 1):
        check_promises(seed, law, method)


def shifted(cells, by):
    """Adds mass to some cells, and takes it from the next."""

    def change(scheme):
        for cell in cells:
            scheme.W[cell] += by * scheme.grid.dx

    return change


def saw(scheme):
    scheme.W[60:140:2] += 0.2 * scheme.grid.dx


def lost_at_the_top(scheme):
    scheme.crest_lowering += 1e-6


def lost_at_the_foot(scheme):
    scheme.toe_gain += 1e-6


def spike(scheme):
    """A cell is made steeper by 3, at the cost of the thirty next to it."""
    scheme.W[115:146] += 3.0 * scheme.grid.dx * np.linspace(1.0, 0.0, 31)


def longer_step(q, K, dx, dt, law, flux):
    return frozen_step(q, K, dx, 6.0 * dt, law, flux)


FAULTS = {  # what is broken -> the bound that must tell; a hollow keeps its sign, a bump its own
    "mass_budget": ("godunov", 0.5, lost_at_the_top),
    "volume_budget": ("telescoping", 0.5, lost_at_the_foot),
    "minimum_principle": ("godunov", -0.5, shifted([120], -0.4)),
    "signs": ("godunov", -0.5, shifted([120], 0.7)),
    "l1_decay": ("godunov", 0.5, saw),
    "factor_bounds": ("godunov", 0.5, shifted([158], 0.4)),
    "upper_bound": ("godunov", 0.5, spike),
    "tv_growth": ("godunov", 0.5, saw),
    "uniform_tv": ("godunov", 0.5, saw),
    "flux_maximum": ("godunov", 0.5, None),
    "flux_variation": ("godunov", 0.5, None),
    "kruzkov": ("godunov", 0.5, None),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_monitor_fires(name, monkeypatch):
    """Sound, every bound holds; with a fault, or too long a step with K frozen, this one does not."""
    method, value, fault = FAULTS[name]
    problem = hj.Problem(hj.rational(), steps([-3.0, -2.0, -1.0], [value, 0.3 * value]), end=0.3, snapshots=2)
    assert hj.solve_hj(problem, hj.Grid(-4.0, 200), method).warnings == []
    if fault:
        advance, calls = hj_form.HamiltonJacobi.advance, []

        def faulty(scheme, dt, steps, bound):
            met = advance(scheme, dt, steps, bound)
            calls.append(steps)
            if len(calls) == 3:  # the first only compiles
                fault(scheme)
            return met

        monkeypatch.setattr(hj_form.HamiltonJacobi, "advance", faulty)
        monkeypatch.setattr(BoundsMonitor, "wants", lambda self, state: True)
    else:
        monkeypatch.setattr(watch, "frozen_step", longer_step)
    run = hj.solve_hj(problem, hj.Grid(-4.0, 200), method)
    assert not run.bounds[name].holds
    verdict = run.bounds[name]
    assert 0.0 < verdict.time <= 0.3 and verdict.worst_margin < 0.0
    if name in ("minimum_principle", "signs"):
        assert verdict.x == pytest.approx(-4.0 + 120 * 0.02, abs=0.1)  # where it was done
    stopping = name in ("mass_budget", "volume_budget")
    assert run.done != stopping
    if stopping:
        assert run.status.startswith("stopped at t = ") and f"{name} does not hold" in run.status


def test_what_a_method_does_not_promise_is_not_watched():
    problem = hj.Problem(hj.rational(), steps([-3.0, -2.0], [0.5]), end=0.3, snapshots=2)
    everything = set(hj.solve_hj(problem, hj.Grid(-4.0, 100), "godunov").bounds)
    assert everything == {name for name, kept in METHODS["godunov"].setup.guarantees.items() if kept}
    local = set(hj.solve_hj(problem, hj.Grid(-4.0, 100), "local-lax-friedrichs").bounds)
    assert everything - local == {"flux_maximum", "flux_variation", "kruzkov"}
    inflow = hj.Problem(hj.rational(), hj.steady(0.4), end=0.5)
    assert set(hj.solve_hj(inflow, hj.Grid(-3.0, 100)).bounds) == {"mass_budget", "volume_budget", "minimum_principle"}


def test_a_frozen_step_allows_for_K_of_the_next_node():
    """K rises from 1 to 4 where q = -1/2 arrives: K f' = 4 at its node, 16 at the next.

    After a step of dx/4, F at the next node would be 4 f(-1/4) = -4/3, beyond sup|F| = 1. After dx/16 it is -4/15.
    """
    grid, cell = hj.Grid(-1.0, 20), np.arange(20)
    q, K = np.where(cell == 10, -0.5, 0.0), np.append(1.0, np.where(cell <= 10, 1.0, 4.0))
    W = np.append(0.0, np.cumsum(q) * grid.dx)
    problem = hj.Problem(hj.rational(), hj.steps([-0.5, -0.45], [-0.5]), end=1.0, coefficient=hj.coefficient("1 - x"))
    monitor = BoundsMonitor(problem, grid, W, MONOTONE, flux=FLUXES["godunov"])
    monitor.observe(
        State(
            t=0.1, steps=BoundsMonitor.FROZEN_STEPS, first=0, q=q, law=Rational(), speed=4.0, bound=4.0,
            dt=grid.dx / 4.0, toe_gain=0.0, crest_lowering=0.0, volume=lambda: 0.0, K=K,
        )
    )  # fmt: skip
    assert monitor.bounds["flux_maximum"].worst_margin == 1.0
    assert all(bound.holds for bound in monitor.bounds.values())


def look(monitor, q, t, **known):
    """The monitor is shown the slopes q at the time t, as a scheme shows them after many steps."""
    steps = monitor.steps_frozen + BoundsMonitor.FROZEN_STEPS
    rest = dict(dt=1e-3 * monitor.grid.dx, toe_gain=0.0, crest_lowering=0.0, volume=lambda: 0.0)
    rest |= dict(K=np.ones(q.size + 1)) | known
    monitor.observe(State(t=t, steps=steps, first=0, q=q, law=Rational(), speed=4.0, bound=4.0, **rest))


@pytest.mark.parametrize(("low", "least"), [(0.1, 15), (-0.8, 10)])
def test_the_constants_of_kruzkovs_inequality_are_slopes_from_all_over(low, least, monkeypatch):
    """Forty looks take most of twenty slopes as the constant, but none with K f' above the 4 that bounds the step."""
    constants = []

    def step(q, *rest):
        constants.extend(q[:1] if np.ptp(q) == 0.0 else [])
        return frozen_step(q, *rest)

    monkeypatch.setattr(watch, "frozen_step", step)
    grid, q = hj.Grid(-1.0, 20), np.linspace(low, 0.3, 20)
    W = np.append(0.0, np.cumsum(q) * grid.dx)
    problem = hj.Problem(hj.rational(), steps(grid.nodes, q), end=1.0)
    monitor = BoundsMonitor(problem, grid, W, MONOTONE, flux=FLUXES["godunov"])
    for n in range(40):
        look(monitor, q, 0.01 * n)
    assert set(constants) <= set(q[q >= -0.5].tolist()) and len(set(constants)) >= least


def test_rounding_is_allowed_by_all_that_flows_through():
    """The mass budget holds if one part in 1e11 of what has come in is lost, and not if it is one in 1e9."""
    problem, grid = hj.Problem(hj.rational(), hj.steady(0.4), end=1e4), hj.Grid(-1.0, 20)
    q = np.full(20, float(hj.rational().inverse(0.4)))
    for part, holds in ((1e-11, True), (1e-9, False)):
        monitor = BoundsMonitor(problem, grid, np.append(0.0, np.cumsum(q) * grid.dx), {"mass_budget": "first order"})
        look(monitor, q, 1e4, crest_lowering=0.4 * 1e4 * (1.0 + part))
        assert monitor.bounds["mass_budget"].holds == holds


def test_bounds_hold_for_a_profile_that_begins_at_the_left_end():
    """The slope left of the grid is critical, so that the jump at its left end is a part of TV(q) from the start."""
    problem = hj.Problem(hj.rational(), steps([-1.0, -0.5], [0.5]), end=0.1, snapshots=2)
    run = hj.solve_hj(problem, hj.Grid(-1.0, 50), "godunov")
    assert run.q[0, 0] == pytest.approx(0.5) and "tv_growth" in run.bounds and run.broken_bounds == []


@pytest.mark.parametrize("form", ["hj", "conservative"])
def test_a_grid_of_many_blocks_has_the_verdicts_of_one_block(form, monkeypatch):
    """The last block has one cell. Sums differ by rounding, extremes do not differ."""
    problem = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-3.0, -1.5], [0.7, 0.4]), end=0.5, snapshots=2)

    def run():
        solve, method = (hj.solve_hj, "godunov") if form == "hj" else (hj.solve_conservative, "conservative-godunov")
        return solve(problem, hj.Grid(-6.0, 361), method)

    one = run()
    monkeypatch.setattr(grid_law, "BLOCK", 60)
    assert [b - a for a, b in grid_law.blocks(361)] == [60] * 6 + [1]
    many = run()
    for name in ("u", "q", "K"):
        assert np.array_equal(getattr(many, name), getattr(one, name))
    assert (
        many.bounds.keys() == one.bounds.keys() and {"kruzkov", "flux_maximum", "flux_variation"} <= one.bounds.keys()
    )
    for name, verdict in one.bounds.items():
        assert many.bounds[name].worst_margin == pytest.approx(verdict.worst_margin, rel=1e-9), name


@pytest.mark.parametrize("method", ["eno2", "weno5", "conservative-weno5"])
def test_high_order_fluxes_do_not_depend_on_blocks(method, monkeypatch):
    solve = hj.solve_conservative if method.startswith("conservative") else hj.solve_hj
    for law in (hj.rational(), hj.log()):
        problem = hj.Problem(law, hj.bumps([0.8, -0.3], [-3.0, -1.5], [0.7, 0.4]), end=0.5, snapshots=2)
        monkeypatch.setattr(grid_law, "BLOCK", 1 << 14)
        one = solve(problem, hj.Grid(-6.0, 361), method)
        monkeypatch.setattr(grid_law, "BLOCK", 60)
        many = solve(problem, hj.Grid(-6.0, 361), method)
        for name in ("u", "q", "K"):
            assert np.array_equal(getattr(many, name), getattr(one, name))


@pytest.mark.parametrize("profile", [hj.kinks([-3.0], [1.0]), hj.bumps([0.8, -0.3], [-3.0, -1.5], [0.3, 0.2])])
@pytest.mark.parametrize(
    ("method", "most"),
    [
        ("local-lax-friedrichs", 11.5), ("godunov", 11.5), ("telescoping", 11.5), ("conservative", 11.5),
        ("eno2", 13.0), ("weno5", 14.0),
    ],
)  # fmt: skip
def test_the_memory_of_a_run_in_arrays_of_its_size(method, most, profile):
    """Three of them are the result with one saved time, and two its positions. Up to all cells are active."""
    solve = hj.solve_conservative if method == "conservative" else hj.solve_hj
    cells = 200_000

    def run(n):
        problem = hj.Problem(hj.rational(), profile, end=100.0 / n, snapshots=[100.0 / n])
        return solve(problem, hj.Grid(-5.0, n), method)

    run(2000)  # compiles
    tracemalloc.start()
    try:
        assert run(cells).done
        arrays = tracemalloc.get_traced_memory()[1] / (8 * cells)
    finally:
        tracemalloc.stop()
    assert 5.0 < arrays <= most
