"""Between saved times: characteristics against closed forms and the invariant, q beside moving kinks."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import lambertw

import hjprofile as hj
from hjprofile.studies.tracing import kink_paths, place, slope_between, trace_back, traceable_law

A, START, END = 1.2, -5.0, 4.0  # a travelling kink (theory, section 5a), which is at x = -1.31 in the end


def kink(t):
    """s + A e^s = START + A e^START + t."""
    c = START + A * np.exp(START) + t
    return c - lambertw(A * np.exp(c)).real


def exact_q(t, x):
    return np.where(x > kink(t), A * np.exp(-(x - kink(t))), 0.0)


def speed(t, x):
    """K f'(q) with K = (1 + q)/(1 + q(0)) right of the kink, and as at it on its left."""
    q, top = exact_q(t, x), A * np.exp(kink(t))
    K = (1.0 + A if x <= kink(t) else 1.0 + q) / (1.0 + top)
    return K / (1.0 + q) ** 2


@lru_cache
def travelling(snapshots, cells=2000):
    problem = hj.Problem(hj.rational(), hj.kinks([START], [A]), end=END, snapshots=snapshots)
    return hj.solve(problem, 1e-10, hj.Grid(-10.0, cells))


SAVED = (6, 11, 21, 41)


@pytest.mark.parametrize("x", [-0.3, -1.0, -2.0])  # two right of the kink, one left of it
def test_second_order_in_the_time_between_saved_times(x):
    errors = []
    for snapshots in SAVED:
        run = travelling(snapshots)
        (found,) = trace_back(run, hj.rational(), [(snapshots - 1, x)]).T
        exact = solve_ivp(lambda t, y: [speed(t, y[0])], (END, 0.0), [x], t_eval=run.time[::-1], rtol=1e-10, atol=1e-10)
        errors.append(np.abs(found - exact.y[0][::-1]).max())
    order = hj.observed_order([n - 1 for n in SAVED], errors)
    assert 1.9 < order < 2.1 and errors[-1] < 5e-4  # measured 2.00; 2.4e-4 at most


def test_none_crosses_a_kink():
    """Before a strong kink the trapezoidal rule alone has a second solution, on its other side."""
    problem = hj.Problem(hj.rational(), hj.kinks([-4.0], [5.0]), end=4.0, snapshots=9)
    run = hj.solve(problem, 1e-10, hj.Grid(-6.0, 2000))
    path = np.array([k.x for k in run.kinks])
    ends = [(8, path[-1] + aside) for aside in (-0.2, -0.01, 0.01, 0.1, 0.5)]
    places = trace_back(run, hj.rational(), ends) - path[:, None]
    assert np.nanmax(places[:, :2]) < 0.0 < np.nanmin(places[:, 2:])


def test_down_to_the_kinks_that_merged():
    """What is right of a kink was right of both of which it is made, and what is left of it was left of both."""
    run = hj.track_fronts(
        hj.Problem(hj.rational(), hj.kinks([-3.0, -2.0], [3.0, 6.0]), end=2.0, snapshots=9), hj.Grid(-4.0, 800)
    )
    paths = kink_paths(run)
    (merge,) = (e for e in run.events if e.event == "merge")
    at = place(paths, merge.into, 2.0)
    for side, slack in ((-1.0, 1e-6), (1.0, 1e-6)):
        (found,) = trace_back(run, hj.rational(), [(8, at + 0.02 * side)]).T
        both = np.array([[place(paths, n, t) for n in paths] for t in run.time])
        apart = side * (found[:, None] - both)
        assert np.nanmin(apart) > -slack


def test_steady_slope():
    """K = 1 - a x, dx/dt = (K - a)²/K: ln(K - a) - a/(K - a) + a t is constant (theory, section 5e)."""
    a, off = 0.5, []
    for snapshots in SAVED:
        run = hj.solve(
            hj.Problem(hj.rational(), hj.steady(a), end=3.0, snapshots=snapshots), 1e-10, hj.Grid(-2.0, 2000)
        )
        (x,) = trace_back(run, hj.rational(), [(snapshots - 1, -0.1)]).T
        K = 1.0 - a * x
        constant = np.log(K - a) - a / (K - a) + a * run.time
        off.append(np.ptp(constant))
    assert 1.9 < hj.observed_order([n - 1 for n in SAVED], off) < 2.2 and off[-1] < 1e-3  # measured 2.05, 4e-4


def test_fans_begin_in_one_point():
    """Whatever reaches the inside of a fan began at the edge from which it opens."""
    problem = hj.Problem(hj.rational(), hj.steps([-2.0, -1.0], [1.0]), end=0.5, snapshots=6)
    run = hj.track_fronts(problem, hj.Grid(-3.0, 1200))
    inside = run.x_cell[(run.q[-1] > 0.2) & (run.q[-1] < 0.8) & (run.x_cell > -1.0)]
    assert inside.size > 20
    first = trace_back(run, hj.rational(), [(5, float(x)) for x in inside])[0]
    assert np.abs(first + 1.0).max() < 2.0 * (run.x[1] - run.x[0])  # measured 0.5 cells


def test_the_invariant_is_carried_along():
    """W + R(q) is constant along characteristics, also of the law ln(1+q) and with hollows (theory, section 4)."""
    law, off = hj.log(), []
    for snapshots in SAVED:
        problem = hj.Problem(law, hj.bumps([0.5, -0.4], [-3.0, -1.5], [0.6, 0.5]), end=0.8, snapshots=snapshots)
        run = hj.solve_characteristics(problem, hj.Grid(-6.0, 2400))
        assert not run.kinks
        ends = [(snapshots - 1, x) for x in (-3.3, -2.6, -1.8, -1.2, -0.4)]
        places = trace_back(run, law, ends)
        invariant = [
            np.interp(x, run.x, u - run.x) + law.R(np.interp(x, run.x_cell, q))
            for x, u, q in zip(places, run.u, run.q, strict=True)
        ]
        off.append(np.ptp(invariant, axis=0).max())
    assert 1.8 < hj.observed_order([n - 1 for n in SAVED], off) < 2.2 and off[-1] < 1e-3


def test_only_where_K_and_q_say_how_they_move(tmp_path):
    assert traceable_law(travelling(6)).name == "rational"
    layer = hj.load_case("thin_layer", {"time.end": 0.0}).problem
    assert layer.supply_flux and traceable_law(resolved(layer)) is None
    assert traceable_law(resolved(hj.load_case("user_law", {"time.end": 0.0}).problem)) is None


def resolved(problem):
    """A run of nothing but its case."""
    from hjprofile.problem.case import resolved_case

    run = travelling(6)
    return type(run)(**(run.__dict__ | {"case": resolved_case(problem, hj.Grid(-4.0, 10), "godunov")}))


def test_places_of_kinks():
    run = hj.track_fronts(
        hj.Problem(hj.rational(), hj.kinks([-3.0, -2.0], [0.4, 1.2]), end=5.0, snapshots=11), hj.Grid(-4.0, 400)
    )
    paths = kink_paths(run)
    merge, leave = (next(e for e in run.events if e.event == kind) for kind in ("merge", "exit"))
    assert place(paths, 1, 0.0) == pytest.approx(-3.0) and place(paths, 2, 0.0) == pytest.approx(-2.0)
    assert place(paths, merge.kink, merge.time + 0.3) == place(paths, merge.into, merge.time + 0.3)
    assert place(paths, 1, leave.time + 0.1) == place(paths, 2, leave.time + 0.1) == leave.x
    assert np.isnan(place(paths, 1, -0.1)) and np.isnan(place(paths, 7, 1.0))


def test_q_between_saved_times_moves_with_the_kinks():
    """Second order in the mean, down to what the kink's cell costs; at fixed places the kink would be there twice."""
    part, x, saved = np.array([0.25, 0.5, 0.75]), np.linspace(-9.9, -0.01, 5000), (3, 5, 9)
    errors, at_fixed_places = [], []
    for snapshots in saved:
        run = travelling(snapshots, 4000)
        times = (run.time[:-1, None] + part * run.time[1]).ravel()
        exact = np.array([exact_q(t, x) for t in times])
        errors.append(np.abs(slope_between(run, times, x) - exact).mean() * np.ptp(x))
        q = np.array([np.interp(x, run.x_cell, [np.interp(t, run.time, row) for row in run.q.T]) for t in times])
        at_fixed_places.append(np.abs(q - exact).mean() * np.ptp(x))
    assert 1.85 < hj.observed_order([n - 1 for n in saved], errors) < 2.1  # measured 1.94
    assert errors[-1] < 0.008 < 0.1 * at_fixed_places[-1]  # measured 0.0052
    assert np.abs(slope_between(run, run.time, run.x_cell) - run.q).max() < 1e-8  # 1e-12 of the width, over dx
