"""Noise in the heights of a survey: its size, its effect, and the smoothed survey."""

import re

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.problem.case import parse_case
from hjprofile.problem.heights import scatter_of
from hjprofile.problem.survey import smoothed

X = np.arange(0.0, 121.0)
SMOOTH = 412.0 + 0.36 * X + 2.0 * np.sin(X / 14.0)


def survey(height, **options):
    return hj.survey(x=X, height=height, critical_slope=0.36, length=12.0, repair="isotonic", **options)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("even", [True, False])
def test_the_scatter_of_heights_is_that_of_their_noise(sigma, even):
    """Within 20 %: the standard error of a median of 3000 is 2 %, and uneven spacing changes the variance somewhat."""
    rng = np.random.default_rng(5)
    x = np.arange(3000.0) if even else np.cumsum(rng.uniform(0.7, 1.3, 3000))
    height = 0.3 * x + 20.0 * np.sin(x / 200.0) + sigma * rng.normal(size=x.size)
    assert scatter_of(x, height) == pytest.approx(sigma, rel=0.2)


def test_smooth_and_angular_slopes_have_no_scatter():
    """Curvature and a few corners are no noise."""
    assert scatter_of(X, SMOOTH) < 1e-3
    assert scatter_of(X, np.interp(X, [0.0, 30.0, 70.0, 120.0], [0.0, 20.0, 25.0, 60.0])) < 1e-12
    assert smoothed(survey(SMOOTH)) is None and smoothed(hj.kinks([-2.0], [1.0])) is None
    assert smoothed(survey(SMOOTH + np.random.default_rng(1).normal(size=121), resample=6.0)) is None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_increases_deposition_and_smoothing_undoes_it(seed):
    """The toe outflow falls by 3 % of the supply; that of the smoothed survey is near that of the slope itself."""

    def outflow(profile):
        return hj.track_fronts(hj.Problem(hj.rational(), profile, 3.0), hj.Grid(-10.5, 200), 800).toe_outflow

    noisy = survey(SMOOTH + 0.1 * np.random.default_rng(seed).normal(size=121))
    truth, found = outflow(survey(SMOOTH)), smoothed(noisy)
    assert outflow(noisy) < truth - 0.02
    assert abs(outflow(found.profile) - truth) < 0.5 * abs(outflow(noisy) - truth)
    assert found.scatter == pytest.approx(0.1, rel=0.4)  # of 119 differences
    assert found.spacing == pytest.approx(2.0 * (np.sqrt(3.0) * found.scatter / 0.036) ** (2 / 3), rel=0.05)


@pytest.mark.parametrize("method", ["godunov", "auto"])
def test_a_run_reports_the_effect_of_noise(tmp_path, method):
    """With both values; without noise, and with the advice taken, there is no such sentence."""

    def cautions(height, **more):
        profile = {"kind": "survey", "x": X.tolist(), "height": height.tolist(), "critical_slope": 0.36, "length": 12.0}
        solver = {"method": method} | ({"tolerance": 1e-2} if method == "auto" else {})
        content = {
            "erosion": {"law": "rational"}, "profile": profile | {"repair": "isotonic", "unit": "m"} | more,
            "domain": {"cells": 1200}, "time": {"end": 3.0}, "solver": solver,
        }  # fmt: skip
        run = hj.solve_case(parse_case(content, "noise", "noise", tmp_path))
        return [sentence for sentence in run.cautions if "scatter" in sentence]

    noisy = SMOOTH + 0.3 * np.random.default_rng(7).normal(size=121)
    assert cautions(SMOOTH) == []
    short = 30.0 * (SMOOTH - SMOOTH[0]) / np.ptp(SMOOTH)
    assert cautions(np.round(short, 2)) == []
    assert cautions(SMOOTH + 0.1 * np.random.default_rng(7).normal(size=121), resample=5.7) == []
    mild = cautions(SMOOTH + 0.1 * np.random.default_rng(7).normal(size=121))
    if method == "auto":  # the error of the grid is as large as the effect
        (sentence,) = mild
        words = r"the heights scatter by about .* \(resample = .*\) the toe outflow is (.*) instead of (.*)\. If .*"
        smooth, rough = map(float, re.fullmatch(words, sentence).groups())
        assert smooth - rough > 0.06  # 2 % of the supply
    assert cautions(noisy) == []  # smoothing would take more than a sixteenth of the slope
