"""Shock-fitted characteristics: closed forms, births, merges and fans to 1e-11, and never a wrong answer."""

import contextlib
import dataclasses
import warnings
from itertools import product

import numpy as np
import oracles
import pytest
from numpy.polynomial import Polynomial
from random_profiles import random_bumps, random_pieces

import hjprofile as hj
from hjprofile.solvers.characteristics import label_events
from hjprofile.solvers.characteristics import shock_fitting as characteristics
from hjprofile.solvers.characteristics.kernels import labels
from hjprofile.solvers.characteristics.label_events import parted
from hjprofile.solvers.characteristics.moving_labels import MovingLabels
from hjprofile.solvers.characteristics.panels import RULE, cut_into_panels, interpolation, tails
from hjprofile.solvers.closed_forms import kink_into_steady_slope, travelling_kink
from hjprofile.solvers.invariant import law_table
from hjprofile.solvers.snapshots import Lost
from hjprofile.solvers.stop import Reason, Stop

LAWS = {"rational": hj.rational(), "log": hj.log(), "power": hj.power(3.0)}
LAWS["user"] = hj.expression("sqrt(1+q) - 1/sqrt(1+q)")
T2 = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5])
GRID = hj.Grid(-11.0, 1000)


@pytest.mark.parametrize("law", LAWS)
def test_one_kink(law):
    """Measured 7e-14 for the rational law, 1e-12 for the others, whose closed form is an integration itself."""
    exact = travelling_kink(LAWS[law], 1.0, -6.0)
    problem = hj.Problem(LAWS[law], hj.kinks([-6.0], [1.0]), end=1.1 * exact.exit_time, snapshots=9)
    run = hj.solve_characteristics(problem, GRID)
    most = 2e-13 if law == "rational" else 1e-11
    for i, t in enumerate(run.time):
        assert np.abs(run.u[i] - exact.u(t, run.x)).max() <= most
        assert np.abs(run.K[i] - exact.K(t, run.x)).max() <= 10 * most
    oracles.check_kinks(run, exact, most)
    (leaving,) = run.events
    assert leaving.event == "exit" and abs(leaving.time - exact.exit_time) <= most
    assert run.done and all(b.holds for b in run.bounds.values())


def test_kink_into_the_steady_slope():
    exact = kink_into_steady_slope(hj.rational(), 0.5, -1.0)
    problem = hj.Problem(hj.rational(), hj.steady(0.5, -1.0), end=1.2 * exact.exit_time, snapshots=7)
    run = hj.solve_characteristics(problem, hj.Grid(-2.0, 700))
    assert max(np.abs(run.u[i] - exact.u(t, run.x)).max() for i, t in enumerate(run.time)) <= 1e-13
    assert abs(run.events[0].time - exact.exit_time) <= 1e-13


def test_three_kinks_merge_twice_and_leave():
    positions, amplitudes = [-7.0, -6.2, -5.0], [0.4, 1.2, 2.0]
    events, _ = oracles.kinks_to_the_end(positions, amplitudes, 20.0)
    problem = hj.Problem(hj.rational(), hj.kinks(positions, amplitudes), end=10.0, snapshots=11)
    run = hj.solve_characteristics(problem, GRID)
    assert [(e.event, e.kink, e.into) for e in run.events] == [("merge", 2, 1), ("merge", 3, 1), ("exit", 1, None)]
    for found, (t, event, x) in zip(run.events, events, strict=True):
        assert found.event == event and abs(found.time - t) <= 1e-11 and abs(found.x - x) <= 1e-11
    fronts = hj.track_fronts(problem, GRID)
    assert np.abs(fronts.u - run.u).max() <= 1e-11  # measured 4e-13
    assert np.abs(fronts.K - run.K).max() <= 1e-10


def test_two_births_on_the_double_bump():
    """Times and places of birth known to twelve digits; the solution against half its tolerance and against fronts."""
    problem = hj.Problem(hj.rational(), T2, end=2.0, snapshots=5)
    run = hj.solve_characteristics(problem, GRID)
    births = [(0.835607544264, -1.487658502086), (0.86999046738, -5.190940861589)]
    for event, (t, x) in zip(run.events, births, strict=True):
        assert event.event == "birth" and abs(event.time - t) <= 1e-11 and abs(event.x - x) <= 1e-11
    finest = hj.solve_characteristics(problem, GRID, 1e-13)
    assert np.abs(run.u - finest.u).max() <= 1e-12  # measured 6e-14
    assert run.error_estimate <= 1e-10 and run.volume_budget_error <= 1e-12  # measured 3e-11, 3e-13
    coarse, fine = (hj.track_fronts(problem, GRID, n).u for n in (800, 1600))
    apart = [np.abs(fronts - run.u).max() for fronts in (coarse, fine)]
    assert apart[1] <= 2e-5 and 3.5 <= apart[0] / apart[1] <= 4.6  # second order


def test_the_smooth_double_bump():
    W = oracles.t2_smooth_solution(0.5)
    grid, problem = hj.Grid(-10.0, 1000), hj.Problem(hj.rational(), T2, end=0.5, snapshots=2)
    run, sharp = (hj.solve_characteristics(problem, grid, e) for e in (1e-12, 1e-13))
    assert np.abs(run.u[-1] - run.x - W(run.x)).max() <= 1e-7  # the oracle's own error is 3e-8
    assert np.abs(run.u - sharp.u).max() <= 1e-13


SCENES = {
    "merging bumps": hj.bumps([0.9, 0.6], [-7.0, -5.2], [0.5, 0.6]),
    "hat": hj.points([-6.0, -5.0, -4.0], [0.0, 0.8, 0.0]),
    "steps up and down": hj.steps([-6.0, -5.0, -4.0, -3.0], [0.5, 1.5, 0.3]),
    "shock and fan": hj.steps([-6.0, -5.0], [1.0]),
    "below critical": hj.steps([-6.0, -5.0, -3.5], [-0.5, 0.8]),
}


QUICK = {(scene, "rational") for scene in SCENES} | {("hat", "log"), ("below critical", "log")}  # a second or less


@pytest.mark.parametrize(
    ("scene", "law"),
    [pair if pair in QUICK else pytest.param(*pair, marks=pytest.mark.slow) for pair in product(SCENES, LAWS)],
)
def test_scenes_with_births_merges_and_fans(scene, law):
    """Against its own finest run, and against fronts extrapolated from 800 and 1600."""
    problem = hj.Problem(LAWS[law], SCENES[scene], end=4.0, snapshots=3)
    run, finest = (hj.solve_characteristics(problem, GRID, e) for e in (1e-11, 1e-13))
    assert run.done and all(b.holds for b in run.bounds.values())
    assert np.abs(run.u - finest.u).max() <= 1e-10
    assert [e[1:4] for e in run.events] == [e[1:4] for e in finest.events]
    coarse, fine = (hj.track_fronts(problem, GRID, n).u for n in (800, 1600))
    off = np.abs(fine + (fine - coarse) / 3.0 - run.u).max()
    assert off <= 0.4 * np.abs(fine - coarse).max()  # extrapolation leaves a part of what the last doubling changed


def test_two_kinks_born_at_one_moment():
    """Two bumps far apart over flat ground, the left one slower by what the right one adds to K: nearly one moment."""
    run = hj.solve_characteristics(
        hj.Problem(hj.rational(), hj.points([-8, -7, -6.5, -4, -3, -2.5], [0, 0.8, 0, 0, 0.8, 0]), end=3.0), GRID
    )
    assert run.done and sum(e.event == "birth" for e in run.events) == 2
    assert run.volume_budget_error <= 1e-10


def test_three_kinks_meet_in_one_point():
    """The middle amplitude is such that both merges fall on one moment, to 1e-15."""
    profile = hj.kinks([-4.0, -3.3, -2.9], [0.5, 1.0869393748571268, 3.0])
    problem = hj.Problem(hj.rational(), profile, end=8.0, snapshots=3)
    run, fronts = hj.solve_characteristics(problem, GRID), hj.track_fronts(problem, GRID)
    assert run.done and [e.event for e in run.events] == ["merge", "merge", "exit"]
    assert np.abs(run.u - fronts.u).max() <= 1e-10 and abs(run.events[0].time - run.events[1].time) <= 1e-10


@pytest.mark.parametrize("right", [1.2, -0.6])
def test_a_slope_that_ends_in_a_jump_at_the_very_top(right):
    problem = hj.Problem(hj.rational(), hj.steps([-3.0, -1.0, 0.0], [0.5, right]), end=1.0, snapshots=3)
    run = hj.solve_characteristics(problem, GRID)
    assert run.done and all(b.holds for b in run.bounds.values())
    coarse, fine = (np.abs(hj.track_fronts(problem, GRID, n).u - run.u).max() for n in (800, 1600))
    assert fine <= 1e-5 and fine <= 0.4 * coarse


def test_hillslope():
    case = hj.load_case("hillslope")
    run = hj.solve_characteristics(case.problem, case.grid, 1e-9)
    assert run.done and run.error_estimate <= 1e-7
    apart = [np.abs(hj.track_fronts(case.problem, case.grid, n).u - run.u).max() for n in (1600, 3200)]
    assert apart[1] <= 1e-4 and apart[1] <= 0.5 * apart[0]


def check_random(make, count, seed):
    rng = np.random.default_rng(seed)
    failures, doubtful = 0, 0
    for i in range(count):
        profile, law, end = make(rng), list(LAWS.values())[i % 3], float(rng.choice([0.3, 1.0, 3.0]))
        problem = hj.Problem(law, profile, end=end, snapshots=3)
        try:
            run, finest = (hj.solve_characteristics(problem, hj.Grid(-13.0, 400), e) for e in (1e-9, 1e-11))
        except hj.RunError as error:
            assert "fronts" in str(error)
            failures += 1
            continue
        if not (run.done and finest.done):
            assert "fronts" in run.status + finest.status
            failures += 1
            continue
        assert np.isfinite(run.u).all() and (run.q > -1.0).all() and (run.K >= 0.0).all()  # 0 where ln K < -745
        assert all(b.holds for b in run.bounds.values()), (i, run.bounds)
        error = np.abs(run.u - finest.u).max()
        doubtful += error > run.error_estimate
        fronts = hj.track_fronts(problem, hj.Grid(-13.0, 400), 800)
        assert np.abs(fronts.u - run.u).max() <= 0.1  # rough data, few fronts: against gross errors
    assert failures <= 0.005 * count and doubtful <= max(0.02 * count, 1)


@pytest.mark.parametrize("make", [random_bumps, random_pieces])
def test_random_profiles(make):
    check_random(make, 5, seed=3)


@pytest.mark.slow
@pytest.mark.parametrize("make", [random_bumps, random_pieces])
def test_a_thousand_random_profiles(make):
    check_random(make, 1000, seed=4)


def test_what_is_refused_and_what_is_told():
    with pytest.raises(hj.InputError, match="flux that enters"):
        hj.solve_characteristics(hj.Problem(hj.rational(), hj.steady(0.4), end=1.0), hj.Grid(-3.0, 100))
    with pytest.raises(hj.InputError, match="tolerance = 1e-20 must lie between"):
        hj.solve_characteristics(hj.Problem(hj.rational(), T2, end=1.0), GRID, 1e-20)
    kinked = hj.profile(lambda x: x + np.where(x > -2.1234567, 0.3 * (x + 2.1234567), 0.0))
    with pytest.raises(hj.RunError, match=r"not smooth near x = -2\.12.*use the method fronts"):
        hj.solve_characteristics(hj.Problem(hj.rational(), kinked, end=1.0), hj.Grid(-4.0, 100))


def test_lost_labels_stop_the_run_with_the_last_good_state(monkeypatch):
    advance = MovingLabels.advance

    def lose(self, target):
        if target > 1.0:
            raise Lost(Stop(Reason.LABELS_LOST, "the labels of kink 1 cannot be told"))
        advance(self, target)

    monkeypatch.setattr(MovingLabels, "advance", lose)
    run = hj.solve_characteristics(hj.Problem(hj.rational(), T2, end=2.0, snapshots=5), GRID)
    assert not run.done and run.time.tolist() == [0.0, 0.5, 1.0]
    assert run.status.startswith("stopped at t = 1, before t = 1.5: the labels of kink 1")
    assert run.status.endswith("use the method fronts")


def test_flat_slope_and_a_kink_at_the_very_top():
    for profile in (hj.steps([-2.0, -1.0], [0.0]), hj.kinks([0.0], [1.0])):
        run = hj.solve_characteristics(hj.Problem(hj.log(), profile, end=1.0, snapshots=3), hj.Grid(-3.0, 60))
        assert run.done and np.abs(run.u - run.x).max() <= 1e-12


def test_panels():
    s = np.linspace(-1.2, 1.2, 7)
    values = np.exp(RULE.s)
    assert np.abs(interpolation(s) @ values - np.exp(s)).max() <= 1e-12
    assert np.abs(RULE.D @ values - values).max() <= 1e-11
    assert np.abs(values @ RULE.B - (np.e - np.exp(RULE.s))).max() <= 1e-14
    assert tails(values[None, :])[0] <= 1e-12 < 1e-3 < tails(np.abs(RULE.s)[None, :])[0]
    panels = cut_into_panels(hj.Problem(hj.rational(), T2, end=1.0), -11.0)
    split = panels.split({2: 0.3, 5: -0.7})
    assert split.volume() == pytest.approx(panels.volume(), abs=1e-13)
    assert len(split.r) == len(panels.r) + 2 and np.all(np.diff((split.mesh.base[:, None] + split.X).ravel()) >= -1e-15)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-4])
def test_a_coarse_tolerance_is_kept_too(tolerance):
    """T2 with its two births: steps as coarse as that would miss one, with an error of 0.3."""
    problem = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5]), end=2.0, snapshots=5)
    grid = hj.Grid(-10.0, 500)
    run, exact = hj.solve(problem, tolerance, grid), hj.solve_characteristics(problem, grid)
    assert np.abs(run.u - exact.u).max() <= run.error_estimate <= tolerance


@pytest.mark.parametrize("values", [[-0.7361], [0.5]])
def test_a_law_may_overflow_where_no_slope_is(values):
    """f of a power law has no number long before q is -1; the search for the range of the law's table starts there."""
    problem = hj.Problem(hj.power(30.0), hj.steps([-1.0, -0.97], values), end=1e-3, snapshots=[1e-3])
    with contextlib.suppress(hj.RunError):  # of the first, K may be too large
        hj.solve_characteristics(problem, hj.Grid(-2.0, 40), 1e-5)


def test_a_factor_beyond_all_numbers_is_told_of_without_a_warning():
    problem = hj.Problem(hj.rational(), hj.steps([-2000.0, -1.0], [5.0]), end=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = hj.solve_characteristics(problem, hj.Grid(-2001.0, 2001))
    assert run.status.startswith("stopped at t = 0, before")


def on_labels(X_left, q_left, X_right, q_right):
    """r, X and the mesh of polynomials X and q on labels -2..0 and 0..2, W = 0 between; q = 0 on the left if None."""
    sides = [(-1.0, X_left, q_left), (1.0, X_right, q_right)] if X_left else [(1.0, X_right, q_right)]
    xi = [middle + RULE.s for middle, _, _ in sides]
    I = [(q * X.deriv()).integ() + 1.0 + q for _, X, q in sides]

    def sampled(fields):
        return np.array([f(at) for f, at in zip(fields, xi, strict=True)])

    mesh = labels.Mesh(
        sampled(I), sampled([f.deriv() for f in I]), np.ones(len(sides)), np.zeros(len(sides)),
        np.zeros(len(sides), dtype=bool),
        np.array([0, 1, 2] if X_left else [0, 0, 1]),
    )  # fmt: skip
    r, X = sampled([1.0 + q for _, _, q in sides]), sampled([X for _, X, _ in sides])
    return r, X, mesh, RULE, law_table(hj.rational(), -0.5, 5.0), np.empty(RULE.s.size)


ROOT = np.sqrt(0.5)
CUBIC, RISING = Polynomial([0.0, -0.5, 0.0, 1.0]), Polynomial([1.0, 0.5])  # X odd, W - X even: the labels are ±√0.5
LINE, LOW, HIGH = Polynomial([0.0, 1.0]), Polynomial([0.5]), Polynomial([2.0])


@pytest.mark.parametrize(
    ("sides", "start", "exact"),
    [
        ((CUBIC, RISING, CUBIC, RISING), [1e-16, 1e-16], [ROOT, ROOT]),
        ((CUBIC, RISING, CUBIC, RISING), [0.3, 0.3], [ROOT, ROOT]),
        ((CUBIC, RISING, CUBIC, RISING), [1.9, 1.9], [ROOT, ROOT]),
        # X falls from 0 on one side alone, to 0 again at a distance of 1.2
        ((Polynomial([0.0, -1.2, -1.0]), LOW, LINE, HIGH), [1e-16, 0.0], [1.2, 0.0]),
        ((LINE, LOW, Polynomial([0.0, -1.2, 1.0]), HIGH), [0.0, 1e-16], [0.0, 1.2]),
        ((None, None, Polynomial([0.0, -1.2, 1.0]), HIGH), [0.0, 1e-16], [0.0, 1.2]),
    ],
)
def test_labels_of_a_shock_are_those_at_which_X_rises(sides, start, exact):
    """X and W are the same on both sides of the joint too, but X falls with the label there: this is no shock."""
    off = np.array([start])
    assert labels.shock_labels(0, off, *on_labels(*sides))
    assert off[0] == pytest.approx(exact, abs=1e-13)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_folds_and_labels_by_bisection(side):
    """X = ξ³ - ξ/2 turns at ξ² = 1/6 and is ±1/2 at ξ = ±1, where W - X is 1/4; ±ξ² - ξ/10 turns at ±1/20."""
    r, X, mesh, rule, _, w = on_labels(CUBIC, RISING, CUBIC, RISING)
    fold = labels.fold(side, 0, r, X, mesh, rule, w)
    assert fold == pytest.approx(np.sqrt(1.0 / 6.0), abs=1e-12)
    for of_W, target in ((0.0, 0.5 * side), (1.0, 0.5 * side + 0.25)):
        label = labels.label_of(side, 0, target, of_W, fold, r, X, mesh, rule, w)
        assert label == pytest.approx(1.0, abs=1e-12)
    assert np.isnan(labels.label_of(side, 0, 100.0 * side, 0.0, fold, r, X, mesh, rule, w))
    for X, turn in ((Polynomial([0.0, -0.1, side]), 0.05), (LINE, 0.0)):
        r, X, mesh, rule, _, w = on_labels(X, LOW, X, HIGH)
        assert labels.fold(side, 0, r, X, mesh, rule, w) == pytest.approx(turn, abs=1e-12)


def test_labels_of_a_newborn_shock_are_at_the_joint():
    """At its birth X has a level tangent, and there is no fold between which labels could be found."""
    off, cube = np.zeros((1, 2)), Polynomial([0.0, 0.0, 0.0, 1.0])
    assert labels.shock_labels(0, off, *on_labels(cube, RISING, cube, RISING)) and not off.any()


@pytest.mark.parametrize(
    "profile",
    [hj.bumps([0.8], [-3.0], [0.5]), hj.points([-4.0, -3.0, -2.0, -1.0], [0.0, 0.5, 0.8, 0.0])],
    ids=["smooth", "corner"],
)
def test_the_labels_of_a_young_shock_part_as_their_asymptotics(profile, monkeypatch):
    """Each like coefficient * τ^power: both like τ^(1/2) at a smooth fold, like τ² and τ at a corner of q."""
    problem, born = hj.Problem(hj.rational(), profile, end=2.0), []

    def noted(panels, cut, t, tau, sides, number):
        born.append((t, sides))
        return parted(panels, cut, t, tau, sides, number)

    def solver():
        panels = cut_into_panels(problem, -11.0)
        return MovingLabels(problem, panels, characteristics._table(problem, panels), 1e-12, np.inf)

    with monkeypatch.context() as patch:
        patch.setattr(label_events, "parted", noted)
        first = solver()
        while not born:
            first.advance(first.now.t + 0.002)
    ((t, sides),) = born
    assert [power for _, power in sides] == ([0.5, 0.5] if profile.breaks(hj.rational()).size == 0 else [2.0, 1.0])
    later, tau = solver(), 1e-4
    later.advance(t + tau)
    (found,) = later.now.panels.off
    # the next term is smaller by sqrt(τ) or τ; measured 9e-4
    assert found == pytest.approx([coefficient * tau**power for coefficient, power in sides], rel=2e-3)


def test_a_hollow_between_two_cells_may_come_to_lie_in_one():
    """The mean of a cell then falls from -0.22 to -0.36, and the minimum principle holds: inf q of the data is -0.5."""
    problem = hj.Problem(hj.rational(), hj.bumps([-0.5], [-3.0], [0.05]), end=0.3, snapshots=21)
    run = hj.solve_characteristics(problem, hj.Grid(-5.0, 50))
    assert run.q[0].min() > -0.25 and -0.5 < run.q.min() < -0.35
    assert run.bounds["minimum_principle"].worst_margin == 1.0


@pytest.mark.parametrize("width", [1e-3, 0.03, 0.7])
@pytest.mark.parametrize("amplitude", [0.8, -0.5, 3.0])
def test_a_bump_far_down_the_slope_moves_as_one_near_the_crest(width, amplitude):
    """K = 1 right of it, so that distance is nothing but rounding of x: 1e-13 at x = -990."""
    records = []
    for centre in (-990.0, -30.0 * width):
        problem = hj.Problem(hj.rational(), hj.bumps([amplitude], [centre], [width]), end=4.0 * width, snapshots=3)
        run = hj.solve_characteristics(problem, hj.Grid(centre - 8.0 * width, 500), 1e-11)
        assert run.done and all(bound.holds for bound in run.bounds.values())
        events = [(e.time / width, e.event, (e.x - centre) / width) for e in run.events]
        records.append((events, [((k.x - centre) / width, k.q_left, k.q_right) for k in run.kinks]))
    (far_events, far_kinks), (events, kinks) = records
    rounding = 1e-8 + 1e-11 / width
    assert [e[1] for e in far_events] == [e[1] for e in events]
    for (t, _, x), (t0, _, x0) in zip(far_events, events, strict=True):
        assert (t, x) == pytest.approx((t0, x0), abs=10.0 * rounding)
    np.testing.assert_allclose(far_kinks, kinks, atol=rounding)


LOST = {
    # a shock that runs through pieces of very different length
    "pieces": hj.steps([-3.0, -2.999, -2.0, -1.995, -1.99, -1.0, -0.9995], [0.4, 4.0, 0.2, -0.6, 3.7, 0.03]),
    "points": hj.points([-5.0, -4.0, -4.0, -3.0, -3.0, -2.9999, -2.0], [0.0, 1.0, 0.2, 0.2, -0.5, 2.0, 0.0]),
    # labels that flow through a layer of the exchange length ahead of a shock
    "layer": hj.bumps([0.02], [-150.0], [40.0]),
    "narrow": hj.bumps([2.0, -0.5, 1.0], [-20.0, -19.97, -5.0], [0.01, 0.01, 0.005]),
}


@pytest.mark.parametrize("name", LOST)
def test_features_of_very_different_length(name):
    """Characteristics go through, and agree with those of another tolerance, and with extrapolated cells."""
    end = 60.0 if name == "layer" else 2.0
    problem = hj.Problem(hj.rational(), LOST[name], end=end, snapshots=2)
    grid = problem.profile.grid(500)
    run, finer = (hj.solve_characteristics(problem, grid, tolerance) for tolerance in (1e-9, 1e-11))
    assert run.done and finer.done
    assert np.abs(run.u - finer.u).max() <= 2.0 * run.error_estimate <= 1e-6
    cells = hj.solve_conservative(problem, dataclasses.replace(grid, cells=8000))
    assert np.abs(cells.u[:, ::16] - finer.u).max() <= 2e-3 * max(1.0, np.ptp(finer.u[0] - finer.x))


@pytest.mark.parametrize(("error", "tries"), [(0.0, 0), (1.0, 2)])
def test_an_event_is_found_within_the_step(error, tries):
    """The root at 0.4 of the growth of a step is found, though the sign changes back at 1.6, beyond its end.

    It takes no further step where the interpolant is good enough, and else two that end there.
    """
    problem = hj.Problem(hj.rational(), T2, end=0.5)
    panels = cut_into_panels(problem, -11.0)
    moving = MovingLabels(problem, panels, characteristics._table(problem, panels), 1e-12, 1e3)
    end, _ = moving._try(0.01)
    one = 1e3 - moving.patience

    def least(panels):
        part = panels.totals[0] / end.totals[0]
        return (0.4 - part) * (1.6 - part)

    part, there, _ = moving._root(0.01, end, least, (least(panels), least(end)), error)
    assert there.totals[0] == pytest.approx(0.4 * end.totals[0], rel=1e-12) and 0.3 < part < 0.5
    assert 1e3 - moving.patience <= (1.0 + tries) * one * (1.0 + 1e-9)


def test_a_slope_of_a_hundred_thousand_lengths():
    """Places on its panels, which are as long, are known to their rounding only, and the label at the crest to that."""
    problem = hj.Problem(hj.rational(), hj.bumps([1e-3], [-1e5], [50.0]), end=1.0, snapshots=2)
    run = hj.solve_characteristics(problem, hj.Grid(-1.1e5, 200))
    assert run.done and run.steps <= 20 and run.error_estimate <= 1e-12
