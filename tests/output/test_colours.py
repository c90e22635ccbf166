"""Colours that mean something stay apart also for those who see no red, or no green."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from hjprofile.output.plots import style

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
SEEN = {
    "all": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}
seen = pytest.mark.parametrize("eyes", SEEN)
APART = 20.0  # of CIELAB's units, in which 2.3 is just noticeable


def lab(colour, eyes):
    """CIELAB (D65) of an sRGB colour as these eyes see it."""
    rgb = np.asarray(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.asarray(SEEN[eyes]) @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ linear / to_xyz.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def apart(first, second, eyes):
    return float(np.linalg.norm(lab(first, eyes) - lab(second, eyes)))


def on_paper(colour, alpha=0.4):
    """As areas are drawn."""
    return tuple(alpha * np.asarray(to_rgb(colour)) + 1.0 - alpha)


def test_the_yardstick():
    """White and black are 100 apart; a red and an olive green come close without green, blue and yellow do not."""
    for eyes in SEEN:
        assert apart("white", "black", eyes) == pytest.approx(100.0, abs=0.1)
        assert apart("#0000ff", "#ffff00", eyes) > 100.0
    assert apart("#d02020", "#708020", "all") > 80.0 > 10.0 > apart("#d02020", "#708020", "deuteranopia")


@seen
def test_areas_and_runs(eyes):
    eroded, deposited = on_paper(style.ERODED), on_paper(style.DEPOSITED)
    for pair in ((eroded, deposited), (eroded, "white"), (deposited, "white"), style.TWO_RUNS, ("0.45", "white")):
        assert apart(*pair, eyes) > APART
    for area in (eroded, deposited):  # lines, kinks and trails on them
        assert apart(area, style.INK, eyes) > 2.0 * APART


@seen
def test_times(eyes):
    """Later is lighter throughout, so that the order shows also in grey; no line fades into the paper."""
    lightness = np.array([lab(style.TIMES(t), eyes)[0] for t in np.linspace(0.0, 1.0, 33)])
    assert np.all(np.diff(lightness) > 0.5) and apart(style.TIMES(0.0), style.TIMES(1.0), eyes) > 3.0 * APART
    between = np.linspace(0.0, 1.0, style.LINES)
    assert min(apart(style.TIMES(a), style.TIMES(b), eyes) for a, b in pairwise(between)) > 8.0
    assert apart(style.TIMES(1.0), "white", eyes) > 2.0 * APART


@seen
def test_both_sides_of_the_critical_slope(eyes):
    """q and -q look different, the more the larger; the critical slope is the lightest."""
    excess = colormaps[style.EXCESS]
    distances = [apart(excess(0.5 - d), excess(0.5 + d), eyes) for d in (0.05, 0.1, 0.2, 0.3, 0.4)]
    assert np.all(np.array(distances) > [5.0, 15.0, 40.0, 50.0, 55.0])  # measured 9, 19, 42, 55, 60 at least
    lightness = np.array([lab(excess(v), eyes)[0] for v in np.linspace(0.0, 1.0, 21)])
    assert np.all(np.diff(lightness[:11]) > 0) and np.all(np.diff(lightness[10:]) < 0)
