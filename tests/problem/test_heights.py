"""Surveys that hold no heights in places, that pass a crest, or that cover little of the domain."""

import dataclasses

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.problem.heights import STAND_INS, crest, without_height
from hjprofile.problem.units import Units

X = np.arange(0.0, 121.0)
RISING = 412.0 + 0.35 * X + 2.0 * np.sin(X / 9.0)  # by 42, everywhere


def write(folder, x, height, name="survey.csv"):
    path = folder / name
    rows = zip(np.asarray(x, dtype=float).tolist(), np.asarray(height, dtype=float).tolist(), strict=True)
    path.write_text("x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows))
    return path


def refused(path, **named):
    with pytest.raises(hj.InputError) as error:
        hj.survey(path, 0.36, 12.0, **named)
    return str(error.value)


NOTHING = [*STAND_INS, 1e20, -1e20, 1e30, -3.4028234663852886e38, 9.969209968386869e36, 1.7e308, -1.7e308]
WHERE = {"first": [0], "last": [120], "inside": [40, 41], "many": list(range(7)), "all over": [0, 50, 120]}


@pytest.mark.parametrize("value", NOTHING)
@pytest.mark.parametrize("rows", WHERE.values(), ids=WHERE)
def test_what_stands_for_no_height_is_left_out(tmp_path, value, rows):
    """As a cliff at the foot or the top it would be a survey that rises all the same."""
    height = RISING.copy()
    height[rows] = value
    kept = np.delete(np.arange(X.size), rows)
    slope = hj.survey(write(tmp_path, X, height), 0.36, 12.0)
    assert f"{len(rows)} row{'s' * (len(rows) > 1)} without a height left out" in slope.account
    assert np.array_equal(slope.surveyed.x, X[kept]) and np.array_equal(slope.surveyed.height, RISING[kept])
    assert hj.read_survey(tmp_path / "survey.csv")[2] == (kept + 2).tolist()


def test_what_stands_for_no_height_is_not_fitted():
    """Arrays of a user as well as files."""
    x, height, _ = hj.read_survey(hj.shipped_cases()["hillslope"].with_suffix(".csv"))
    height[10] = -9999.0
    with pytest.raises(hj.InputError, match=rf"has -9999 at x = {x[10]:g}, which is not a measured height; omit it"):
        hj.fit("hillslope", x, height, ["time.end"])


def test_a_height_far_from_30_km_of_others(tmp_path):
    """A relief of 9 km, a gap of 10 km: no measure of the heights alone tells them apart, the slope does."""
    x, height = 30.0 * np.arange(1001), 200.0 + 9.0 * np.arange(1, 1001)
    slope = hj.survey(write(tmp_path, x, np.append(-9999.0, height)), 0.36, 12.0)
    assert slope.units.x(slope.start()) == pytest.approx(30.0) and "1 row without a height" in slope.account


@pytest.mark.parametrize(
    ("shift", "value"), [(-9999.0 - RISING[0], -9999.0), (9999.0 - RISING[-1], 9999.0), (-999.0 - RISING[60], -999.0)]
)
def test_such_a_number_may_be_a_height(tmp_path, shift, value):
    """At the foot, at the top and inside: the other rows lead up to it."""
    height = RISING + shift
    assert value in np.round(height, 9)
    assert not without_height(X, np.round(height, 9)).any()
    hj.survey(write(tmp_path, X, np.round(height, 9)), 0.36, 12.0)


def test_cliffs_are_heights(tmp_path):
    """200 m between two flats of 1 m each, in the midst and at the top, and 40 m above a plain of 10 cm."""
    for cliff, at, relief in ((200.0, 60, 1.0), (200.0, 115, 1.0), (40.0, 119, 0.1)):
        height = relief * X / X[-1] + np.where(at < X, cliff, 0.0)
        assert not without_height(X, height).any()
        hj.survey(write(tmp_path, X, height), 0.36, 12.0)


@pytest.mark.parametrize("wrong", [4.2e5, -4.2e5])
def test_a_height_off_by_orders_of_magnitude(wrong):
    """A decimal point lost, at the top; few rows are no survey to say so."""
    height = RISING.copy()
    height[-1 if wrong > 0 else 0] = wrong
    assert np.flatnonzero(without_height(X, height)).tolist() == [120 if wrong > 0 else 0]
    assert not without_height(X[:3], np.array([0.0, 1.0, 9e5])).any()


def hill(top=120, rows=241, noise=0.0):
    x = np.arange(float(rows))
    noise = noise * np.random.default_rng(3).normal(size=rows)
    return x, 412.0 + 0.35 * np.minimum(x, 2 * top - x) + noise


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("repair", [None, "isotonic"])
def test_a_survey_across_its_crest_is_told_so(tmp_path, noise, repair):
    """It was told to delete its highest rows, one after the other, or that its top is at the left."""
    x, height = hill(noise=noise)
    message, row = refused(write(tmp_path, x, height), repair=repair), int(np.argmax(height)) + 2
    assert abs(row - 122) <= 5
    assert f"has two flanks, with the crest at row {row} (x = {row - 2:g}); use from/to: to = {row - 2:g}" in message
    assert "repair" not in message
    if not noise:
        hj.survey(write(tmp_path, x[:121], height[:121]), 0.36, 12.0)
        hj.survey(write(tmp_path, -x[:119:-1], height[:119:-1]), 0.36, 12.0)


@pytest.mark.parametrize("top", [60, 180])
def test_a_crest_need_not_be_in_the_middle(top):
    assert crest(hill(top)[1]) == top


def test_what_is_no_crest():
    """A top at an end, a wrong height, noise, a knoll at the foot, a ledge below the top."""
    spike, late = RISING.copy(), RISING.copy()
    spike[40], late[118] = 600.0, 600.0
    knoll = np.array([0.0, 10, 9, 8, 7, 6, 5, 4, 3, 20])
    noisy = RISING + np.random.default_rng(1).normal(size=X.size)
    for height in (RISING, RISING[::-1], spike, late, knoll, noisy, np.minimum(RISING, 450.0), np.arange(2.0)):
        assert crest(height) is None


def test_a_top_at_the_right_is_not_told_to_be_at_the_left(tmp_path):
    """By the medians of its halves this one falls."""
    message = refused(write(tmp_path, range(0, 100, 10), [0, 10, 9, 8, 7, 6, 5, 4, 3, 20]))
    assert "to the left" not in message and "does not rise in rows 3-10;" in message


SOLVERS = {
    "grid": lambda p, g: hj.solve_hj(p, g),
    "conservative": lambda p, g: hj.solve_conservative(p, g),
    "fronts": lambda p, g: hj.track_fronts(p, g, 100),
    "characteristics": lambda p, g: hj.solve_characteristics(p, g, 1e-8),
    "auto": lambda p, g: hj.solve(p, 1e-2, g),
}


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_domain_in_metres_is_told(tmp_path, solver):
    """left = -120 for -10: the slope of 120 m lies in 34 of 400 cells, and all bounds hold."""
    slope = hj.survey(write(tmp_path, X[::12], RISING[::12]), 0.36, 12.0)
    problem = hj.Problem(hj.rational(), slope, 0.05, 2)
    assert SOLVERS[solver](problem, hj.Grid(-12.0, 400)).cautions == ()
    run = SOLVERS[solver](problem, hj.Grid(-120.0, 400))
    caution = run.cautions[-1]  # on a grid after that on cells that do not resolve the slope
    assert (len(run.cautions) == 2) == (solver in ("grid", "conservative"))
    assert caution.startswith("the survey covers only 0.083 of the domain, which begins at left = -120: left is in ")
    assert "exchange lengths, of 12 in the survey's unit; set it to -10.55, or leave it out" in caution
    assert caution in run.warnings
    moved = dataclasses.replace(problem, profile=dataclasses.replace(slope, units=None))
    others = SOLVERS[solver](moved, hj.Grid(-120.0, 400)).cautions
    assert not [other for other in others if "covers" in other]  # without units nothing could be metres


def test_a_coefficient_is_of_the_same_slope(tmp_path):
    """The K of a run of one survey on the slope of another: its x are other places."""
    units = Units(12.0, 0.36, 120.0, 454.0)
    slope = hj.survey(write(tmp_path, X[::12], RISING[::12]), 0.36, 12.0)
    problem, grid = hj.Problem(hj.rational(), slope, 0.05, 2), hj.Grid(-12.0, 60)
    hj.write_run(hj.solve_hj(problem, grid), tmp_path / "result", vtk=False, plots=False)
    K = hj.stored_coefficient(tmp_path / "result")
    assert K.units == slope.units and not K.units.same(units)
    assert dataclasses.replace(problem, coefficient=K).coefficient is K
    other = dataclasses.replace(slope, units=dataclasses.replace(slope.units, length=24.0))
    with pytest.raises(
        hj.InputError, match=r"the coefficient was found for a survey with length = 12, .* has length = 24, "
    ):
        dataclasses.replace(problem, profile=other, coefficient=K)
