"""Continuous dependence on data and coefficient, against the bound that the proof gives with its constants."""

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.errors import InputError
from hjprofile.output.plots.study_pictures import draw_dependence
from hjprofile.problem.coefficient import coefficient
from hjprofile.studies import dependence as study
from hjprofile.studies.dependence import distance_bound, largest_distances, observed_constant

T2 = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5]), end=2.0)


@pytest.fixture(scope="module")
def distances():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "CELLS", 400)
        patch.setattr(study, "PAIRS", 5)
        patch.setattr(study, "WAVES", 2)
        return study.distances_of("T2", T2, hj.Grid(-10.0, 2000))


@pytest.mark.parametrize(
    "k", ["exp(-0.2*x)", "exp(-0.3*x)*(1 + 0.5*t*exp(-(x + 1.5)**2))", lambda t, x: np.exp(-0.2 * x) + 0.0 * t]
)
def test_with_one_prescribed_coefficient_no_distance_grows(k, monkeypatch):
    """The theorem gives L = 0 (2.3), and a monotone conservative scheme keeps it to rounding."""
    monkeypatch.setattr(study, "CELLS", 400)
    monkeypatch.setattr(study, "PAIRS", 3)
    monkeypatch.setattr(study, "WAVES", 1)
    problem = hj.Problem(T2.law, T2.profile, 2.0, coefficient=coefficient(k))
    found = study.distances_of("k", problem, hj.Grid(-10.0, 100))
    for member in {d.member for d in of(found, "data")}:
        pair = [d.distance for d in of(found, "data") if d.member == member]
        assert np.diff(pair).max() <= 1e-13  # measured 8e-15
    sentences, failed = study.summary(found)
    assert not failed and "never grows, 9 pairs" in sentences[0]
    steady = not (isinstance(k, str) and "t" in k)  # the function of t and x does not depend on t
    assert (sentences[3] == "refresh      not applicable: the coefficient is constant in time") == steady
    assert bool(of(found, "refresh")) != steady
    assert len(draw_dependence(found).axes) == 4 + (not steady)  # with an axis for the distance of kinks


def test_a_pair_takes_the_same_time_steps():
    """Of two slopes of unlike speed; each is then still a solution, to first order in the steps."""
    slow = hj.Problem(hj.rational(), hj.bumps([0.1], [-3.0], [0.5]), 1.0, 5)
    fast = hj.Problem(hj.rational(), hj.bumps([-0.5], [-3.0], [0.5]), 1.0, 5)
    grid = hj.Grid(-6.0, 400)
    for problem, path in zip((slow, fast), study.solve_together(slow, fast, grid), strict=True):
        alone = hj.solve_hj(problem, grid, "godunov")
        assert np.array_equal(path.time, alone.time) and path.K[:, -1].tolist() == [1.0] * 5
        assert grid.dx * np.abs(path.q - alone.q).sum(axis=1).max() < 3e-3  # dx = 0.015
    mirrored = study.solve_together(fast, slow, grid)
    assert np.array_equal(mirrored[1].q, study.solve_together(slow, fast, grid)[0].q)
    alone = study.solve_together(slow, slow, grid)
    assert np.array_equal(alone[0].q, alone[1].q) and not np.array_equal(alone[0].q, mirrored[1].q)


def test_what_goes_wrong_on_the_way_is_a_sentence():
    """A coefficient that is positive at both ends in time only."""
    problem = hj.Problem(T2.law, T2.profile, 2.0, coefficient=coefficient("(t - 1)**2 - 0.01"))
    with pytest.raises(hj.RunError, match=r"k: .*is not a positive number"):
        study.distances_of("k", problem, hj.Grid(-10.0, 100))


def test_distances_of_zero_have_no_order(distances):
    """A run so short that nothing moves: words in the place of a number that does not exist."""
    still = [
        d._replace(distance=0.0) if d.study in ("coefficient", "refresh", "refresh kinks") else d for d in distances
    ]
    sentences, failed = study.summary(still)
    assert not failed and "nan" not in " ".join(sentences)
    assert "‖q - q̃‖₁ is too small to have an order in k - k̃" in sentences[2]
    assert sentences[3] == "refresh      ‖q - q̃‖₁ is too small to have an order in the fractional step"


def of(distances, name):
    return [d for d in distances if d.study == name]


def test_no_pair_comes_further_apart_than_the_proof_allows(distances):
    """Measured 0.96 of the bound at most for data, 0.27 for coefficients: neither is far off.

    Without an allowance, because the two take the same time steps.
    """
    for name, least in (("data", 0.5), ("coefficient", 0.1)):
        shares = [d.distance / d.bound for d in of(distances, name) if d.time > 0.0]
        assert least < max(shares) <= 1.0


def test_the_flow_expands_some_distances_but_by_no_more_the_closer_they_are(distances):
    """One cannot expect L = 0 in general; but L must not grow as the pairs get closer (here a hundredfold)."""
    data = of(distances, "data")
    far, near = (observed_constant([d for d in data if (d.member - 1) // 5 == i]) for i in (0, len(study.SIZES) - 1))
    assert far > 0.5 and near > 0.5
    assert near < 3.0 * far


def test_the_flow_is_a_contraction_towards_the_critical_slope(distances):
    zero = of(distances, "zero")
    for member in {d.member for d in zero}:
        norms = [d.distance for d in zero if d.member == member]
        assert np.all(np.diff(norms) <= 1e-12)  # rounding
        assert norms[-1] < norms[0]


@pytest.mark.parametrize("name, low, high", [("coefficient", 0.93, 1.07), ("refresh", 0.85, 1.25)])
def test_distances_are_of_first_order(distances, name, low, high):
    """In the coefficient's error, and in the fractional step; 1.00 and 1.02 on 1000 cells."""
    size, largest = zip(*largest_distances(distances, name).values(), strict=True)
    assert low < -hj.observed_order(size, largest) < high
    assert min(largest) < max(largest) / 5.0  # sizes are eightfold, or sixteenfold


def test_the_bound_is_sharp():
    """k = 1 and 1 + δ move an upward jump apart at the speed δ f(a)/a: the distance is δ f(a) t, as is the bound."""
    a, delta = 1.5, 0.2
    runs = [
        hj.solve_hj(
            hj.Problem(hj.rational(), hj.steps([-5.0, 0.0], [a]), 2.0, 9, coefficient=coefficient(k)),
            hj.Grid(-6.0, 3000), "godunov",
        )
        for k in ("1", f"1 + {delta}")
    ]  # fmt: skip
    dx = 6.0 / 3000
    apart = dx * np.abs(runs[0].q - runs[1].q).sum(axis=1)
    exact = delta * a / (1 + a) * runs[0].time
    assert np.allclose(distance_bound(hj.rational(), *runs), exact, rtol=1e-9)
    assert np.allclose(apart[1:], exact[1:], rtol=0.02)  # shocks spread over some cells, 0.24 apart at the end
    assert np.all(apart <= exact + 1e-12)


def test_the_bound_counts_what_a_coefficient_varies_by():
    """q constant: (k f)_x makes q grow where k falls; at once the distance grows by f TV(k - k̃), which is the bound."""
    problem = [
        hj.Problem(hj.rational(), hj.steps([-8.0, 0.0], [0.5]), 0.01, 2, coefficient=coefficient(k))
        for k in ("1", "1 + 0.1*exp(-(x + 3)**2)")
    ]
    runs = [hj.solve_hj(p, hj.Grid(-10.0, 4000), "godunov") for p in problem]
    apart = 10.0 / 4000 * np.abs(runs[0].q[-1] - runs[1].q[-1]).sum()
    bound = distance_bound(hj.rational(), *runs)[-1]
    assert 0.99 * 0.2 / 3.0 * 0.01 < apart <= bound  # f(0.5) = 1/3, TV = 0.2; and ‖k - k̃‖_∞ TV(f) adds half as much
    assert bound == pytest.approx(0.01 * (0.2 + 0.1) / 3.0, rel=0.01)


def test_what_cannot_be_studied_is_refused():
    steady = hj.Problem(hj.rational(), hj.steady(0.5), end=1.0)
    with pytest.raises(InputError, match="flux that enters"):
        study.distances_of("steady", steady, hj.Grid(-2.0, 100))
    gone = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=400.0)  # it leaves at t = 1.3
    for nothing in (gone, hj.Problem(hj.rational(), hj.steps([-2.0, -1.0], [0.0]), end=1.0)):
        with pytest.raises(
            InputError, match=r"gone: the slope is neutral from the first measurement on, at t = \S+; set"
        ):
            study.distances_of("gone", nothing, hj.Grid(-2.0, 100))
    still = hj.Problem(hj.rational(), hj.bumps([0.5], [-3.0], [0.5]), end=0.0)
    with pytest.raises(InputError, match="end = 0; the study of dependence"):
        study.distances_of("still", still, hj.Grid(-6.0, 100))


@pytest.mark.parametrize(
    ("name", "words"),
    [("thin_layer", "rolling layer"), ("vertical_step", "growth = 'linear'"), ("travelling_wave", "line = 'whole'")],
)
def test_other_models_are_refused_by_their_case(name, words):
    case = hj.load_case(name)
    with pytest.raises(InputError, match=f"^{name}: .*{words}"):
        study.distances_of(name, case.problem, case.grid)


def test_the_picture_shows_every_pair(distances):
    panels = draw_dependence(distances).axes
    assert len(panels) == 5  # the last is the axis for the distance of kinks
    pairs = len({d.member for d in of(distances, "data")})
    assert len([line for line in panels[0].lines if len(line.get_xdata()) == study.MOMENTS]) == pairs
    shown = sum(len(line.get_xdata()) for line in panels[2].lines[:-1])
    assert shown == len(largest_distances(distances, "coefficient"))
