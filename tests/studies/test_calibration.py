"""Parameters fitted to two surveys: recovered without noise, covered by intervals with it, refused where wrong."""

import io
import json
import re
from itertools import combinations

import numpy as np
import pytest
import tomli_w

import hjprofile as hj
from hjprofile.solvers.closed_forms import closed_form
from hjprofile.studies import calibration
from hjprofile.studies.calibration import _undetermined

BEFORE = """x,height
0,0
150,30
300,95
420,125
600,230
700,260
900,400
1000,455
"""
TRUTH = {"time.end": 2.0, "profile.critical_slope": 0.45, "profile.length": 150.0}
START = {"time.end": 1.5, "profile.critical_slope": 0.55, "profile.length": 120.0}
SURVEY = {
    "title": "A small slope",
    "erosion": {"law": "rational"},
    "profile": {"kind": "survey", "file": "before.csv", "critical_slope": 0.55, "length": 120.0},
    "domain": {"left": -9.0, "cells": 400},
    "time": {"end": 1.5, "snapshots": [0.0, 0.75, 1.5]},
}


def write(folder, content, name="case.toml"):
    (folder / name).write_text(tomli_w.dumps(content), encoding="utf-8")
    return folder / name


@pytest.fixture
def slope(tmp_path):
    """The case file, with starting values off by a quarter; and what a survey after sees, by another method."""
    (tmp_path / "before.csv").write_text(BEFORE)
    path = write(tmp_path, SURVEY)
    true = hj.load_case(path, TRUTH | {"domain.left": -1000.0 / 150.0, "domain.cells": 40, "time.snapshots": 1})
    run = hj.solve_characteristics(true.problem, true.grid, 1e-9)  # nodes every 25 m
    return path, run.units.x(run.x), run.units.height(run.u[-1])


def off(found, truth):
    """Relative differences of the fitted values."""
    return [p.value / truth[p.name] - 1.0 for p in found.parameters]


def test_a_survey_without_noise_gives_the_parameters_back(slope):
    """Against characteristics: what is left is the error of 1200 fronts, 1.2e-3 m r.m.s. of 455."""
    path, x, height = slope
    found = hj.fit(path, x, height, list(TRUTH))
    assert np.abs(off(found, TRUTH)).max() < 1e-4
    assert found.rms < 3e-3 and found.warnings == [] and found.left_out == 0
    volume = 2.0 * 150.0**2 * 0.45
    assert abs(found.volume.value / volume - 1.0) < 1e-4
    assert found.case["domain"]["left"] * found.parameters[2].value == pytest.approx(-9.0 * 120.0)
    assert found.case["time"]["snapshots"] == pytest.approx(
        [0.0, 0.5 * found.parameters[0].value, found.parameters[0].value]
    )


def stating(path, supplied):
    """The case with the supplied volume in place of the end."""
    content = SURVEY | {"time": {"supplied": supplied}}
    return write(path.parent, content, "supplied.toml")


def test_a_stated_volume_is_held_fixed(slope):
    """The length and the slope alone are found from the true volume, and the volume is that of the case."""
    path, x, height = slope
    volume = 2.0 * 150.0**2 * 0.45
    found = hj.fit(stating(path, volume), x, height, ["profile.critical_slope", "profile.length"])
    assert np.abs(off(found, TRUTH)).max() < 1e-4  # as with a free volume
    assert found.volume is None  # no parameter changes it
    p = {parameter.name: parameter.value for parameter in found.parameters}
    fitted = found.case["time"]["end"] * p["profile.length"] ** 2 * p["profile.critical_slope"]
    assert fitted == pytest.approx(volume, rel=1e-14)


@pytest.mark.parametrize("stated", [True, False])
def test_a_volume_is_fitted(slope, stated):
    """With or without a volume in the case, `time.supplied` is the volume, which the other parameters do not change."""
    path, x, height = slope
    volume, start = 2.0 * 150.0**2 * 0.45, 1.5 * 120.0**2 * 0.55
    case = stating(path, start) if stated else path
    found = hj.fit(case, x, height, ["time.supplied", "profile.length", "profile.critical_slope"])
    first = found.parameters[0]
    assert (first.name, first.start) == ("time.supplied", pytest.approx(start, rel=1e-14))
    assert (
        first.value == pytest.approx(volume, rel=1e-4)
        and np.abs(off(found, TRUTH | {"time.supplied": volume})).max() < 1e-4
    )
    for of_volume, of_parameter in zip(found.volume[1:], first[1:], strict=True):
        assert of_volume == pytest.approx(of_parameter, rel=1e-9)
    with pytest.raises(hj.InputError, match="end and supplied are both given"):
        hj.fit(case, x, height, ["time.supplied", "time.end"])


def test_an_end_replaces_a_stated_volume(slope):
    path, x, height = slope
    near = {"profile": SURVEY["profile"] | {"critical_slope": 0.45, "length": 150.0}, "time": {"supplied": 15000.0}}
    found = hj.fit(write(path.parent, SURVEY | near, "near.toml"), x, height, ["time.end"])
    assert found.parameters[0].value == pytest.approx(2.0, rel=1e-4)
    assert found.volume.value == pytest.approx(2.0 * 150.0**2 * 0.45, rel=1e-4)


def test_a_kink_gives_time_and_law_back(tmp_path):
    """Dimensionless, against the closed form, which fronts meet to 1e-12: the last relative step, 1e-6, is left."""
    content = {
        "erosion": {"law": "power", "m": 2.0},
        "profile": {"kind": "kinks", "positions": [-3.0], "amplitudes": [1.5]},
        "domain": {"left": -4.0, "cells": 40},
        "time": {"end": 1.6},
    }
    truth = {"time.end": 1.7, "erosion.m": 2.2}
    path = write(tmp_path, content)
    x = np.linspace(-4.0, 0.0, 23)
    height = closed_form(hj.load_case(path, truth).problem).u(1.7, x)
    found = hj.fit(path, x, height, list(truth))
    assert np.abs(off(found, truth)).max() < 1e-6
    assert found.volume is None


@pytest.fixture
def coarse(monkeypatch):
    """A model of few fronts: what is tested then is the statistics or the messages, not the solver."""
    monkeypatch.setattr(calibration, "FRONTS", 200)
    monkeypatch.setattr(calibration, "SLOPE_FRONTS", 100)


def noisy_fits(path, x, exact, number, noise, sigma):
    """Errors of the parameters and of the volume in halves of their intervals, in logarithms; started at the truth."""
    near = SURVEY | {"profile": SURVEY["profile"] | {"critical_slope": 0.45, "length": 150.0}, "time": {"end": 2.0}}
    path = write(path.parent, near, "near.toml")
    random = np.random.default_rng(20)
    truth = [*TRUTH.values(), 2.0 * 150.0**2 * 0.45]
    rows = []
    for _ in range(number):
        found = hj.fit(path, x, exact + noise * random.standard_normal(x.size), list(TRUTH), sigma)
        rows.append(
            [
                np.log(p.value / t) / (0.5 * np.log(p.high / p.low))
                for p, t in zip((*found.parameters, found.volume), truth, strict=True)
            ]
        )
    return np.array(rows)


def modelled(path, x):
    """What the model itself gives at the truth."""
    model = calibration._Model(path, list(TRUTH))
    return model.heights(np.log([TRUTH[n] / START[n] for n in TRUTH]), x)


@pytest.mark.parametrize("sigma", [None, pytest.param(0.5, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_as_often_as_they_say(slope, coarse, sigma):
    """Of 12 fits fewer than 8 in their interval has probability 2e-4. The spread of errors in standard errors is 1;
    of 12 it lies beyond 0.5 to 1.6 with probability 4e-3 for each. Intervals of half the length fail both."""
    path, x, _ = slope
    rows = noisy_fits(path, x, modelled(path, x), 12, 0.5, sigma)
    assert np.all(np.count_nonzero(np.abs(rows) <= 1.0, axis=0) >= 8)
    spread = 1.96 * np.sqrt(np.mean(rows**2, axis=0))
    assert np.all((spread > 0.5) & (spread < 1.6)), spread


@pytest.mark.slow
def test_coverage_of_a_hundred_fits(slope, coarse):
    """At least 90 of 100, as promised; and the spread of errors within 3.5 of its own standard errors of 1: 0.75 to
    1.25. That tells what 100 of 100 would: intervals that are too wide."""
    path, x, _ = slope
    rows = noisy_fits(path, x, modelled(path, x), 100, 0.5, None)
    assert np.all(np.count_nonzero(np.abs(rows) <= 1.0, axis=0) >= 90)
    spread = 1.96 * np.sqrt(np.mean(rows**2, axis=0))
    assert np.all((spread > 0.75) & (spread < 1.25)), spread


@pytest.fixture
def gentle(tmp_path):
    """A slope within 1 % of the critical one: f = q and K = 1 nearly, so it only moves, by end times length."""
    x = np.arange(0.0, 1001.0, 100.0)
    rows = zip(x.tolist(), (0.5 * (x + np.sin(x / 100.0))).tolist(), strict=True)
    (tmp_path / "before.csv").write_text("x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows))
    content = SURVEY | {
        "erosion": {"law": "power", "m": 1.5},
        "profile": SURVEY["profile"] | {"critical_slope": 0.5, "length": 100.0},
        "domain": {"left": -10.5, "cells": 400},
    }
    x = np.linspace(0.0, 1000.0, 30)
    path = write(tmp_path, content)
    model = calibration._Model(path, ["time.end"])
    return path, x, model.heights(np.log([2.0 / 1.5]), x) + 0.01 * np.random.default_rng(0).standard_normal(x.size)


def test_two_that_cannot_be_told_apart_are_named(gentle, coarse):
    path, x, height = gentle
    found = hj.fit(path, x, height, ["time.end", "profile.length"])
    assert "time.end and profile.length cannot be distinguished" in found.warnings[0]
    assert all(np.isnan([p.low, p.high]).all() for p in (*found.parameters, found.volume))
    assert found.correlation[0, 1] < -0.999
    end, length = (p.value for p in found.parameters)
    assert end * length == pytest.approx(200.0, rel=0.02)  # what is determined


def test_one_that_matters_too_little_is_named(gentle, coarse):
    """The power of a law tells itself in q² only."""
    path, x, height = gentle
    found = hj.fit(path, x, height, ["time.end", "erosion.m"])
    end, m = found.parameters
    assert end.value == pytest.approx(2.0, rel=0.01)  # its standard error is 0.25 %
    assert 0.97 < end.low < end.high < 1.03 * end.value
    assert np.isnan(m.low) and ["erosion.m is not determined" in w for w in found.warnings] == [True]


def test_one_without_effect_is_named(tmp_path, coarse):
    """On a critical slope nothing happens, whatever is poured."""
    content = SURVEY | {"profile": {"kind": "steps", "edges": [-2.0, -1.0], "values": [0.0]}}
    x = np.linspace(-3.0, 0.0, 20)
    found = hj.fit(write(tmp_path, content), x, x + 0.01 * np.sin(9.0 * x), ["time.end"])
    assert found.warnings[0] == "time.end has no effect on the surveyed heights near its value"
    assert "are 100% of the change between the surveys" in found.warnings[1] and len(found.warnings) == 2
    assert np.isnan(found.parameters[0].low)


def test_surveys_that_do_not_belong_together_are_told(slope, coarse, tmp_path):
    """Feet, or another datum; x in feet alone is refused, if too few of the points then lie on the slope."""
    path, x, height = slope
    feet = hj.fit(path, 3.28 * x, 3.28 * (height + 100.0), ["time.end"])
    assert feet.left_out == 28
    beyond, residuals = feet.warnings[-2:]
    assert (
        "28 of the 41 points of the survey after lie beyond the slope" in beyond
        and "the same unit, datum and location" in residuals
    )
    for shift in (100.0, -30.0):  # the change itself is 42 at most
        shifted = hj.fit(path, x, height + shift, ["time.end"])
        assert "unit, datum and location" in shifted.warnings[-1] and shifted.left_out == 0
    # a change that noise of a fifth of it hides is explained well enough
    change = np.std(height - calibration._Model(path, ["time.end"]).before(x))
    noisy = hj.fit(path, x, height + 0.2 * change * np.random.default_rng(3).standard_normal(x.size), list(TRUTH))
    assert not [w for w in noisy.warnings if "of the change" in w or "differ" in w]


def test_surveys_that_do_not_differ_are_told(slope, coarse):
    path, x, _ = slope
    before = calibration._Model(path, ["time.end"]).before(x)
    assert before == pytest.approx(np.interp(x, *np.loadtxt(io.StringIO(BEFORE), delimiter=",", skiprows=1).T))
    warning = hj.fit(path, x, before, ["time.end"]).warnings[-1]
    assert re.fullmatch(
        "the surveys do not differ: their difference, .* r.m.s., is within rounding; no parameter can be fitted",
        warning,
    )
    noisy = before + 0.5 * np.random.default_rng(4).standard_normal(x.size)
    assert "is within sigma" in hj.fit(path, x, noisy, ["time.end"], sigma=0.5).warnings[-1]
    assert "do not differ" not in "".join(hj.fit(path, x, noisy, ["time.end"], sigma=0.2).warnings)


def test_a_model_that_does_not_meet_the_survey_is_told(slope, coarse):
    """A slide of 5 m that no erosion law makes, where 0.5 m is claimed."""
    path, x, height = slope
    found = hj.fit(path, x, height - 5.0 * np.exp(-(((x - 500.0) / 50.0) ** 2)), ["time.end"], sigma=0.5)
    assert "does not fit the survey after" in found.warnings[0] and found.chi2 > 3.0 * found.degrees_of_freedom


def test_points_beyond_the_slope_are_left_out(slope, coarse):
    path, x, height = slope
    wider = np.concatenate([[-50.0, -1.0], x, [1001.0]])
    found = hj.fit(path, wider, np.concatenate([[9.0, 9.0], height, [9.0]]), ["time.end"])
    same = hj.fit(path, x, height, ["time.end"])
    assert (found.left_out, found.parameters) == (3, same.parameters)


def test_what_never_moves(slope):
    """Left of the support u stays, so that heights are compared as they are: the foot is the survey's first point."""
    path, x, height = slope
    assert height[0] == pytest.approx(0.0, abs=1e-9)
    model = calibration._Model(path, ["time.end"])
    assert model.heights(np.zeros(1), x)[0] == pytest.approx(0.0, abs=1e-9)


def save(path, x, height):
    rows = zip(np.asarray(x).tolist(), np.asarray(height).tolist(), strict=True)
    path.write_text("x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows))
    return path


def test_the_command_and_its_files(slope, coarse, call, tmp_path):
    path, x, _ = slope
    after = save(tmp_path / "after.csv", x, modelled(path, x) + 0.5 * np.sin(7.0 * x))
    out = tmp_path / "elsewhere" / "fit"
    vary = [v for name in TRUTH for v in ("--vary", name)]
    code, text, error = call("fit", path, after, *vary, "--sigma", "0.4", "--out", out)
    assert (code, error) == (0, "")
    assert "time.end" in text and "chi²" in text and "supplied_volume" in text
    report = json.loads((out / "fit.json").read_text())
    assert list(report["parameters"]) == list(TRUTH)
    for name, row in report["parameters"].items():
        low, high = row["interval_95"]
        assert low < row["value"] < high and row["start"] == START[name]
        assert f"{row['value']:.6g}" in text
    p = {name: row["value"] for name, row in report["parameters"].items()}
    assert report["supplied_volume"]["value"] == pytest.approx(
        p["time.end"] * p["profile.length"] ** 2 * p["profile.critical_slope"]
    )
    assert (report["points"], report["sigma"]) == (41, {"value": 0.4, "from": "given"})
    assert np.diag(report["correlation"]) == pytest.approx(1.0)
    (line,) = [line for line in text.splitlines() if line.startswith("  correlations ")]
    pairs = [f"{a} and {b} {report['correlation'][i][j]:.3f}" for (i, a), (j, b) in combinations(enumerate(TRUTH), 2)]
    assert line == "  correlations  " + "; ".join(pairs) and len(pairs) == 3
    assert (out / "fit.png").read_bytes()[:4] == b"\x89PNG"
    # the fitted case is run as it is, from anywhere, and ends where the fit says
    case = hj.load_case(out / "fitted.toml")
    assert case.problem.end == p["time.end"] and case.problem.profile.units.length == p["profile.length"]
    again = hj.fit(out / "fitted.toml", x, hj.read_survey(after)[1], list(TRUTH))
    assert np.abs(off(again, p)).max() < 1e-4  # a stop by chi² leaves hundredths of a standard error


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vary", "erosion.m"], "erosion.m cannot be varied; the positive numbers of this case are profile.critical"),
        (["--vary", "profile.file"], "profile.file cannot be varied"),
        (["--vary", "time.snapshots"], "time.snapshots cannot be varied"),
        (["--vary", "end"], "end cannot be varied; did you mean 'time.end'? the positive numbers of this case are"),
        (["--vary", "time.end,profile.length"], "profile.length cannot be varied (--vary once for each); the positive"),
        (["--vary", "time.end", "--vary", "time.end"], "each of them only once"),
        (["--vary", "time.end", "--sigma", "0"], "sigma = 0.0 must be a positive number"),
        (["--vary", "time.end", "--sigma", "nan"], "sigma = nan must be a positive number"),
        ([], "--vary"),
    ],
)
def test_bad_input(slope, coarse, call, tmp_path, arguments, words):
    path, x, height = slope
    after = save(tmp_path / "after.csv", x, height)
    code, text, error = call("fit", path, after, *arguments, "--out", tmp_path / "out")
    assert (code, text, error.count("\n")) == (2, "", 1) and words in " ".join(error.split())
    assert not (tmp_path / "out").exists()


def test_bad_surveys_after(slope, coarse, call, tmp_path):
    path, x, height = slope
    beside = save(tmp_path / "beside.csv", x + 2000.0, height)
    code, text, error = call("fit", path, beside, "--vary", "time.end", "--out", tmp_path)
    assert (code, text) == (2, "") and "0 of the 41 points of the survey after lie on the slope, from x = 0" in error
    (tmp_path / "words.csv").write_text("x,height\n0,0\n10,1\n15,high\n")
    code, _, error = call("fit", path, tmp_path / "words.csv", "--vary", "time.end", "--out", tmp_path)
    assert code == 2 and "row 4" in error
    code, _, error = call("fit", path, tmp_path / "nowhere.csv", "--vary", "time.end", "--out", tmp_path)
    assert code == 2 and "does not exist" in error
    with pytest.raises(hj.InputError, match="x increasing"):
        hj.fit(path, x[::-1], height, ["time.end"])
    inflow = write(tmp_path, SURVEY | {"profile": {"kind": "steady", "flux": 0.5}}, "inflow.toml")
    with pytest.raises(hj.InputError, match="made by fronts, does not take a profile with a flux"):
        hj.fit(inflow, x, height, ["time.end"])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (np.inf, "must be two lists of the same number of finite numbers"),
        (1e13, "must be two lists of the same number of finite numbers"),
        (-9999.0, "the survey after has -9999 at x = 75, which is not a measured height; omit it"),
    ],
)
def test_one_row_of_the_survey_after_that_is_no_height_is_refused(slope, wrong, words):
    path, x, height = slope
    with pytest.raises(hj.InputError, match=words):
        hj.fit(path, x, np.where(np.arange(x.size) == 3, wrong, height), ["time.end"])


def test_a_fit_that_does_not_converge(slope, coarse, call, tmp_path, monkeypatch):
    path, x, height = slope
    monkeypatch.setattr(calibration, "MOST_STEPS", 2)
    after = save(tmp_path / "after.csv", x, height)
    code, text, error = call("fit", path, after, "--vary", "time.end", "--vary", "profile.length", "--out", tmp_path)
    assert (code, text) == (1, "") and "does not converge in 2 steps; it has reached time.end = " in error
    assert not (tmp_path / "fit.json").exists()


def test_the_parameter_that_can_stand_in_for_another_is_named():
    """The largest correlation in size with any other, if it is above 0.9; the order of the names does not matter."""
    for place in range(4):
        names, correlation = ["a", "b", "c", "d"], np.eye(4)
        for other in {0, 1, 2, 3} - {place}:
            correlation[place, other] = correlation[other, place] = 0.1 * other
        partner = (place + 1) % 4
        correlation[place, partner] = correlation[partner, place] = -0.95
        sentence = _undetermined(place, names, correlation)
        assert sentence.startswith(f"{names[place]} is not determined")
        assert f"; {names[partner]} can replace it (correlation -0.950)" in sentence
        correlation[place, partner] = correlation[partner, place] = 0.89
        assert "can stand in" not in _undetermined(place, names, correlation)
