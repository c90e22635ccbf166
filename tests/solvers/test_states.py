"""States between saved times, time series, and restarts, against closed forms."""

import pickle

import numpy as np
import pytest

import hjprofile as hj

LEFT = -5.0
GRID = hj.Grid(left=LEFT, cells=400)
KINK = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, snapshots=11)


@pytest.fixture(scope="module")
def steady():
    """u sinks at the rate a everywhere, q and K do not change: linear interpolation in t is exact."""
    problem = hj.Problem(hj.rational(), hj.steady(0.5), end=2.0, snapshots=3)
    return hj.solve(problem, 1e-10, hj.Grid(left=-3.0, cells=300))


@pytest.fixture(scope="module")
def moving():
    return hj.track_fronts(KINK, GRID)


def exact_kink(t):
    """s + A e^s = s0 + A e^s0 + t, by Newton's method."""
    s = -3.0 + t / 2.0
    for _ in range(50):
        s -= (s + np.exp(s) + 3.0 - np.exp(-3.0) - t) / (1.0 + np.exp(s))
    return s


def exact_u(t, x):
    s = exact_kink(t)
    return x + np.where(x > s, 1.0 - np.exp(-np.maximum(x - s, 0.0)), 0.0)


def test_a_saved_state_is_the_stored_one(moving):
    state = moving.at(moving.time[3])
    for name in ("u", "q", "K"):
        assert np.array_equal(getattr(state, name), getattr(moving, name)[3])
    assert moving.at(moving.time[3] * (1 + 1e-12)).u is not None and state.x is not None


def test_linear_motion_is_exact_between_saved_times(steady):
    for t in (0.3, 0.999, 1.7):
        state = steady.at(t)
        assert state.t == t
        # 1e-9: a thousand times the error of the closed form
        assert np.abs(state.u - (steady.u[0] - 0.5 * t)).max() < 1e-9
        assert np.abs(state.q - steady.q[0]).max() < 1e-9
        assert np.abs(state.K - (1.0 - 0.5 * steady.x)).max() < 1e-9


def test_q_is_the_slope_of_u_between_saved_times(moving):
    state = moving.at(0.537)
    assert np.abs(np.diff(state.u) / np.diff(state.x) - 1.0 - state.q).max() < 1e-10  # rounding of u / Δx


def test_order_in_the_distance_of_saved_times():
    """First order, because a kink passes between them."""
    errors = []
    for count in (11, 21, 41):
        run = hj.track_fronts(hj.Problem(KINK.law, KINK.profile, 1.0, count), GRID)
        times = run.time[:-1] + 0.5 * np.diff(run.time)
        errors.append(max(np.abs(run.at(t).u - exact_u(t, run.x)).max() for t in times))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 0.8) & (orders < 1.2)), orders


def test_K_between_saved_times_is_geometric(moving):
    middle = 0.5 * (moving.time[2] + moving.time[3])
    assert np.abs(moving.at(middle).K ** 2 / (moving.K[2] * moving.K[3]) - 1.0).max() < 1e-13


def test_K_that_is_zero_is_linear():
    layer = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0, supply_flux=1.0, snapshots=11)
    run = hj.solve_conservative(layer, hj.Grid(left=LEFT, cells=50), "conservative-telescoping")
    assert (run.K[0] == 0.0).any()
    state = run.at(0.05)
    zero = (run.K[0] == 0.0) | (run.K[1] == 0.0)
    assert np.isfinite(state.K).all()
    assert state.K[zero] == pytest.approx(0.5 * (run.K[0] + run.K[1])[zero], abs=1e-15)


def test_samples_at_nodes_and_midpoints_are_the_stored_values(moving):
    assert np.array_equal(moving.sample(moving.x).u, moving.u)
    assert np.array_equal(moving.sample(moving.x_cell).q, moving.q)
    assert np.abs(moving.sample(moving.x).K / moving.K - 1.0).max() < 1e-13


def test_samples_of_a_constant_slope_are_exact():
    """q = 1 gives u linear and K = exp(-f x): both interpolations are exact."""
    problem = hj.Problem(hj.rational(), hj.steps([-4.0, 0.0], [1.0]), end=0.0)
    found = hj.solve_hj(problem, GRID).sample(x := np.array([[-3.1234, -2.0], [-0.777, 0.0]]))
    assert found.u.shape == found.q.shape == found.K.shape == (1, 2, 2)
    assert found.u[0] - 2.0 * x == pytest.approx(np.full((2, 2), 4.0), abs=1e-12)
    assert found.q[0] == pytest.approx(np.ones((2, 2)), abs=1e-11)
    assert found.K[0] == pytest.approx(np.exp(-0.5 * x), rel=1e-12)


def test_order_in_the_width_of_a_cell():
    """Second order where the slope is smooth."""
    slope, x = hj.bumps([1.0], [-3.0], [0.7]), np.linspace(-4.5, 0.0, 37) + 1e-3 * np.arange(37)[::-1] - 0.04
    errors = []
    for cells in (100, 200, 400):
        found = hj.track_fronts(hj.Problem(hj.rational(), slope, 0.0), hj.Grid(left=-6.0, cells=cells)).sample(x)
        errors.append([np.abs(found.u[0] - x - slope.W(x, hj.rational()) - found.u[0, 0] + x[0]
                              + slope.W(x[:1], hj.rational())).max(),
                       np.abs(found.q[0] - slope.excess(x)).max()])  # fmt: skip
    assert np.all(np.log2(np.array(errors[0]) / errors[2]) > 3.2), errors  # 4 if second order


def test_a_single_position(moving):
    found = moving.sample(-2.5)
    assert found.u.shape == found.q.shape == found.K.shape == moving.time.shape


def test_states_are_read_only_and_can_be_sent(moving):
    for found in (moving.at(0.3), moving.sample([-1.0])):
        with pytest.raises(ValueError, match="read-only"):
            found.u[...] = 0.0
        assert np.array_equal(pickle.loads(pickle.dumps(found)).u, found.u)
        assert len(repr(found)) < 100


@pytest.mark.parametrize("t", [-0.1, 1.001, np.nan, np.inf, "0.5", None, [0.5]])
def test_times_out_of_range_are_rejected(moving, t):
    with pytest.raises(hj.InputError, match="saved times"):
        moving.at(t)


@pytest.mark.parametrize("x", [-5.001, [-1.0, 0.001], np.nan, "left", None, [[-1.0], [-1.0, -2.0]], True])
def test_positions_out_of_range_are_rejected(moving, x):
    with pytest.raises(hj.InputError, match=r"^x "):
        moving.sample(x)


SOLVERS = [hj.solve_hj, hj.solve_conservative]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_restart_begins_with_the_same_state(solver):
    run = solver(KINK, GRID)
    again = solver(hj.Problem(KINK.law, run.restart(4), end=0.1), GRID)
    # rounding of sums of 400 cells
    assert np.abs(again.q[0] - run.q[4]).max() < 1e-12 and np.abs(again.u[0] - run.u[4]).max() < 1e-13


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_runs_replace_one(solver):
    """On one grid only the lengths of the time steps differ."""
    whole = solver(KINK, GRID)
    second = solver(hj.Problem(KINK.law, whole.restart(4), end=0.6, snapshots=7), GRID)
    assert np.abs(second.u - whole.u[4:]).max() < 1e-4  # measured: 1e-5; a cell is 1.25e-2 wide
    total = hj.solve_hj(hj.Problem(KINK.law, KINK.profile, 0.4), GRID).eroded_volume + second.eroded_volume
    assert total == pytest.approx(whole.eroded_volume, abs=2e-2)


def test_fronts_continue_a_run_to_first_order():
    errors = []
    for cells in (100, 200, 400):
        first = hj.track_fronts(hj.Problem(KINK.law, KINK.profile, 0.4), hj.Grid(left=LEFT, cells=cells))
        second = hj.track_fronts(hj.Problem(KINK.law, first.restart(), 0.6), GRID)
        errors.append(np.abs(second.u[-1] - exact_u(1.0, GRID.nodes)).max())
    assert errors[2] < 0.4 * errors[0] and errors[2] < LEFT / -400


def test_a_restart_has_the_units_of_the_survey():
    slope = hj.survey(x=[0.0, 10.0, 20.0, 30.0], height=[1.0, 3.0, 7.0, 10.0], critical_slope=0.3, length=5.0, unit="m")
    problem = hj.Problem(hj.rational(), slope, end=0.5)
    run = hj.solve_hj(problem, problem.grid())
    again = hj.solve_hj(hj.Problem(hj.rational(), run.restart(), end=0.5), problem.grid())
    assert again.units == run.units
    assert again.units.height(again.u[0]) == pytest.approx(run.units.height(run.u[-1]), abs=1e-11)


def test_a_stored_run_can_be_restarted(tmp_path):
    run = hj.solve_hj(KINK, GRID)
    hj.write_run(run, tmp_path / "run", vtk=False, plots=False)
    loaded = hj.load_run(tmp_path / "run")
    x = GRID.nodes
    assert np.array_equal(loaded.restart().W(x, KINK.law), run.restart().W(x, KINK.law))


def test_restarts_without_a_meaning_are_rejected(steady, moving):
    with pytest.raises(hj.InputError, match="flux that enters at the left end"):
        steady.restart()
    layer = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=0.1, supply_flux=1.0)
    with pytest.raises(hj.InputError, match="rolling layer"):
        hj.solve_conservative(layer, hj.Grid(left=LEFT, cells=50), "conservative-telescoping").restart()
    for index in (11, -12, 0.5, "last", True):
        with pytest.raises(hj.InputError, match="index"):
            moving.restart(index)


def test_a_window_of_the_whole_line_can_be_restarted():
    """A bump in a neutral slope: q = 0 at both ends of the window, now and later."""
    grid = hj.Grid(left=-6.0, cells=300, right=6.0)
    problem = hj.Problem(hj.rational(), hj.bumps([0.5], [0.0], [0.5]), end=1.0, snapshots=3, line="whole")
    whole = hj.solve_hj(problem, grid)
    second = hj.solve_hj(hj.Problem(hj.rational(), whole.restart(1), end=0.5, line="whole"), grid)
    assert np.abs(second.u[-1] - whole.u[-1]).max() < 0.01  # a quarter of a cell; measured: 2.4e-3
