"""The bounds that hold for all times [theorem 1, §6.2], in runs that come as near to them as they can (§6)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hjprofile as hj
from hjprofile.problem.erosion import rational

LAWS = {"rational": hj.rational(), "log": hj.log(), "power": hj.power(3.0)}


def height(run):
    """u - x above its value on the far left, shape (times, nodes)."""
    return run.u - run.x - (run.u - run.x)[:, :1]


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_the_upper_bound_is_reached_by_the_last_kink(law):
    """q/f(q) <= sup(q/f(q) + W) at t = 0 (3.16): when the last kink has swallowed the others, W = 0 on its left and
    its crest has the largest value there was; until it leaves."""
    positions, amplitudes = [-14.0, -12.5, -11.0], [0.3, 0.6, 0.9]
    problem = hj.Problem(law, hj.kinks(positions, amplitudes), end=10.0, snapshots=101)
    run = hj.track_fronts(problem, hj.Grid(-15.0, 1000))
    heights = problem.profile.W(np.array(positions), law)
    most = float(np.max(law.R(np.array(amplitudes)) + heights))
    crests = np.array([(k.time, float(law.R(k.q_right))) for k in run.kinks])
    last_merge = max(e.time for e in run.events if e.event == "merge")
    after = crests[:, 0] > last_merge
    assert np.all(crests[:, 1] <= most + 1e-9)  # rounding of the exact integration
    assert after.sum() > 5  # saved times
    assert np.allclose(crests[after, 1], most, rtol=0.0, atol=1e-9)


def test_the_factor_reaches_its_bound_as_the_same_mass_is_spread():
    """ln K <= f'(0) ‖q⁺‖₁: a mass 2 spread over a length 2/δ has ln K(left) = 2/(1+δ), while nothing leaves."""
    missing = []
    deltas = [0.4, 0.2, 0.1, 0.05]
    for delta in deltas:
        length = 2.0 / delta
        problem = hj.Problem(hj.rational(), hj.steps([-length - 3.0, -3.0], [delta]), end=0.5, snapshots=2)
        run = hj.track_fronts(problem, hj.Grid(-length - 4.0, 2000))
        share = np.log(run.K[:, 0]) / 2.0
        assert share[0] == pytest.approx(1.0 / (1.0 + delta), rel=1e-5)  # K of the fronts' data: second order
        assert np.all(share < 1.0)
        missing.append(1.0 - share[-1])
    order = -hj.observed_order(deltas, missing)
    assert 0.85 < order < 1.05  # 1 - 1/(1+δ) has 0.9 on these δ
    assert missing[-1] < 0.055  # 0.048 at t = 0; slopes steepen a little until t = 0.5


def test_the_lower_bound_is_kept_far_down_a_settling_slope():
    """inf q(t) >= inf q(0): where K is e^-18 a hollow has not begun to fill, and keeps its least slope."""
    problem = hj.Problem(hj.rational(), hj.steps([-20.0, -2.0], [-0.5]), end=5.0, snapshots=6)
    run = hj.solve_hj(problem, hj.Grid(-21.0, 2100), "godunov")
    lowest = run.q.min(axis=1)
    assert np.all(lowest >= -0.5 - 1e-12)
    assert np.all(lowest <= -0.5 + 1e-6)
    assert np.all(np.diff(np.abs(run.q).sum(axis=1)) <= 0.0)


def test_the_mass_is_kept_until_something_leaves_and_then_goes_to_nothing():
    problem = hj.Problem(hj.rational(), hj.bumps([1.0], [-6.0], [0.7]), end=11.0, snapshots=221)
    run = hj.track_fronts(problem, hj.Grid(-10.0, 2000))
    mass = np.abs(run.q).sum(axis=1)
    inside = int(np.argmax(np.abs(run.q[:, -200:]).max(axis=1) > 1e-9))  # the first time at which q has come to the top
    assert inside > 20 and np.all(np.abs(mass[:inside] / mass[0] - 1.0) < 1e-9)
    assert np.all(np.diff(mass) <= 1e-12)
    assert mass[-1] == 0.0


values = st.lists(st.floats(-0.4, 1.0), min_size=1, max_size=6)  # so that K is e^-1 at least, and `end` not far


@settings(max_examples=25, deadline=None)
@given(values, st.sampled_from(["godunov", "local-lax-friedrichs"]))
def test_every_slope_ends_critical_with_the_volume_that_lay_above_it(data, method):
    """Once all has left, u = x as on the far left: the eroded volume is ∫(u(0,x) - x) dx, of either sign.

    By `end` even the slowest has left: its speed is at least K f' with the least K and the least f' there can be.
    """
    q = np.array(data)
    edges = np.linspace(-4.0, -2.5, q.size + 1)
    law = rational()
    width = 1.5 / q.size
    least_K = float(np.exp(width * np.minimum(law.f(q), 0.0).sum()))
    most = float(np.max(1.0 + np.maximum(q, 0.0)) + width * np.abs(q).sum())
    end = 4.5 * most**2 / least_K
    problem = hj.Problem(law, hj.steps(edges, q), end=end, snapshots=3)
    grid = hj.Grid(-5.0, 200)
    run = hj.solve_hj(problem, grid, method)
    assert run.done and all(b.holds for b in run.bounds.values())
    before = float(np.trapezoid(height(run)[0], run.x))
    assert np.abs(run.q[-1]).max() < 1e-3  # a monotone scheme's tail decays exponentially
    # the sums at the ends differ by half a cell of the height at the top
    assert run.eroded_volume == pytest.approx(before, abs=grid.dx * (1.0 + np.abs(height(run)).max()))
