"""Initial profiles against quadrature of what defines them, surveys and their repair, and bad arguments."""

import math
import re
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.erosion import expression, log, power, rational
from hjprofile.problem.given import profile
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import (
    TAIL,
    bumps,
    kinks,
    points,
    steady,
    steps,
)
from hjprofile.problem.survey import survey

LAWS = {  # name -> (law, R' in closed form, inverse in closed form)
    "rational": (rational(), lambda q: 1.0, lambda y: y / (1 - y)),
    "log": (log(), lambda q: (math.log1p(q) - q / (1 + q)) / math.log1p(q) ** 2, math.expm1),
    "power 2": (power(2.0), lambda q: 2 * (1 + q) * (3 + q) / (2 + q) ** 2, lambda y: (1 - 2 * y) ** -0.5 - 1),
    "roots": (  # with r = sqrt(1+q): f = r - 1/r = q/r, R = r
        expression("sqrt(1+q) - 1/sqrt(1+q)"),
        lambda q: 0.5 / math.sqrt(1 + q),
        lambda y: (y / 2 + math.sqrt(1 + y * y / 4)) ** 2 - 1,
    ),
}
GRID = Grid(left=-9.0, cells=90)
laws = pytest.mark.parametrize("name", LAWS)


def means_by_quadrature(q, breaks=(), grid=GRID):
    """Cell means of a function of single numbers, with its jumps and corners told to the integrator."""
    means = []
    for a, b in zip(grid.nodes[:-1], grid.nodes[1:], strict=True):
        inner = [a, *sorted(x for x in breaks if a < x < b), b]
        means.append(sum(quad(q, *ends, epsabs=1e-14, epsrel=1e-13)[0] for ends in pairwise(inner)) / grid.dx)
    return np.array(means)


def assert_means(given_profile, law, q, breaks=(), rtol=0.0):
    found = given_profile.q_means(GRID, law)
    expected = means_by_quadrature(q, breaks)
    # a difference of two W of order one, divided by dx = 0.1, keeps 1e-14; so does the quadrature
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=5e-14)
    assert np.max(np.abs(expected)) > 0.1


def fall(derivative, a, distance):
    """q at a distance right of a place with q = a: the q at which ∫_q^a R'(p) dp/p is the distance."""
    if distance == 0:
        return a

    def short(s):
        return quad(lambda z: derivative(a * math.exp(z)), s, 0.0, epsabs=1e-13, epsrel=1e-13)[0] - distance

    return a * math.exp(brentq(short, -5 * distance, 0.0, xtol=1e-14, rtol=1e-14))


@laws
def test_means_of_kinks(name):
    law, derivative, _ = LAWS[name]
    positions, amplitudes = [-2.53, -1.7, -0.6], [0.7, 1.3, 2.0]
    grid = Grid(left=-3.0, cells=6)

    def q(x):
        j = sum(x > s for s in positions) - 1
        return fall(derivative, amplitudes[j], x - positions[j]) if j >= 0 else 0.0

    found = kinks(positions, amplitudes).q_means(grid, law)
    # R' of a law given as a difference is good to 1e-12
    np.testing.assert_allclose(found, means_by_quadrature(q, positions, grid), rtol=0, atol=2e-12)


def test_many_bumps_take_little_memory():
    """The sum is taken bump by bump: a table of all places and bumps would grow with the square of their number."""
    tracemalloc.start()
    bumps(np.full(60, 0.1), np.linspace(-8.0, -4.0, 60), np.full(60, 0.3)).q_means(GRID, rational())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * 8 * 60 * 2001  # ten numbers for each place that is looked at; the table held 3 * 60


def test_means_of_bumps():
    a, c, w = [0.8, -0.3, 2.0, 0.5], [-5.0, -3.0, 0.4, -4.0], [1.0, 0.5, 0.9, 0.02]

    def q(x):
        return sum(ai * math.exp(-(((x - ci) / wi) ** 2)) for ai, ci, wi in zip(a, c, w, strict=True))

    assert_means(bumps(a, c, w), rational(), q, breaks=[-4.04, -4.02, -4.0, -3.98, -3.96])


def test_means_of_steps():
    edges, values = [-6.03, -4.0, -3.97, -1.0], [-0.4, 5.0, 1.5]

    def q(x):
        return next((v for v, a, b in zip(values, edges, edges[1:], strict=False) if a < x < b), 0.0)

    assert_means(steps(edges, values), rational(), q, edges)


@pytest.mark.parametrize(
    ("x", "q"),
    [
        ([-6.03, -4.0, -4.0, -3.97, -1.0], [0.0, 2.0, -0.5, 3.0, 0.25]),
        ([-6.03, -6.03, -2.0], [0.0, 2.0, 1.0]),
        ([-6.03, -2.0, -2.0], [1.0, 2.0, 7.0]),  # a jump at the last point, right of which q = 0 anyway
        ([-6.03, 0.0], [1.0, 2.0]),
    ],
)
def test_means_of_points(x, q):
    def at(s):
        for a, b, qa, qb in zip(x, x[1:], q, q[1:], strict=False):
            if a < s < b:
                return qa + (qb - qa) * (s - a) / (b - a)
        return 0.0

    assert_means(points(x, q), rational(), at, x)


@pytest.mark.parametrize("kink", [-2.53, None])
@laws
def test_steady_slope_and_its_flux(name, kink):
    law, _, inverse = LAWS[name]
    a = 0.3
    slope = steady(a, kink)

    def q(x):
        return inverse(a / (1 - a * x)) if kink is None or x > kink else 0.0

    assert_means(slope, law, q, [] if kink is None else [kink])
    assert slope.inflow == (a if kink is None else 0.0)
    for x in (-2.5, -1.0, -0.01, 0.0):
        exponent, _ = quad(lambda s: float(law.f(slope.excess(np.array(s), law))), x, 0.0, epsabs=1e-13, epsrel=1e-13)
        # K f(q) = a: root finding and quadrature keep 1e-13
        assert math.exp(exponent) * law.f(slope.excess(np.array(x), law)) == pytest.approx(a, rel=1e-12)


def test_means_of_a_python_function():
    def u(x):
        return x + math.exp(-((x + 4) ** 2)) if x < -4 else x + 1.0

    def q(x):
        return -2 * (x + 4) * math.exp(-((x + 4) ** 2)) if x < -4 else 0.0

    assert_means(profile(u), rational(), q, [-4.0])
    arrays = profile(lambda x: np.where(x < -4, x + np.exp(-((x + 4) ** 2)), x + 1.0))
    arrays.check(GRID, rational())
    np.testing.assert_allclose(arrays.q_means(GRID, rational()), profile(u).q_means(GRID, rational()), atol=5e-14)


positive = st.floats(0.01, 3.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(positive, positive), min_size=1, max_size=5), st.floats(0.0, 2.0))
def test_any_upward_kinks(pairs, last):
    """Under the rational law q falls as e^{-x}: masses, heights of the jumps, and the least that is allowed."""
    positions, amplitudes, met, mass, q = [-last - sum(gap for gap, _ in pairs)], [], [], [], 0.0
    for gap, jump in pairs:
        met.append(q)
        amplitudes.append(q + jump)
        q = amplitudes[-1] * math.exp(-gap)
        mass.append(amplitudes[-1] - q)
        positions.append(positions[-1] + gap)
    mass[-1] = amplitudes[-1] * -math.expm1(positions[-2])
    *positions, _ = positions
    assume(positions[-1] < 0)
    grid, law, slope = Grid(left=positions[0] - 1.0, cells=200), rational(), kinks(positions, amplitudes)
    slope.check(grid, law)
    W = slope.W(np.array([grid.left, *positions, 0.0]), law)
    # exponentials, sums of at most 5 masses of at most 20
    np.testing.assert_allclose(np.diff(W), [0.0, *mass], rtol=1e-13, atol=1e-13)
    q = slope.q_means(grid, law)
    assert np.all(q >= -1e-12)
    assert grid.dx * q.sum() == pytest.approx(sum(mass), rel=1e-12)
    for x, before, after in zip(positions, met, amplitudes, strict=True):
        h = 1e-6
        left, right = np.diff(slope.W(np.array([x - h, x, x + h]), law)) / h
        # one-sided differences are off by q h/2 and by rounding 1e-14/h
        assert left == pytest.approx(before, abs=1e-6 * before + 5e-8)
        assert right == pytest.approx(after, abs=1e-6 * after + 5e-8)
    if len(met) > 1:
        amplitudes[-1] = met[-1] * (1 - 1e-9)
        with pytest.raises(InputError, match=re.escape(f"amplitudes[{len(met) - 1}] = ")):
            kinks(positions, amplitudes).check(grid, law)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.01, 2.0), st.floats(-0.999, 20.0)), min_size=1, max_size=8), st.integers(4, 300))
def test_any_steps(pieces, cells):
    edges = np.concatenate([[0.0], np.cumsum([length for length, _ in pieces])])
    edges, values = edges - edges[-1], [v for _, v in pieces]
    grid, slope = Grid(left=float(edges[0]) - 0.5, cells=cells), steps(edges, values)
    slope.check(grid, rational())
    q = slope.q_means(grid, rational())
    assert np.all(q > -1.0)
    # sums of masses of at most 300, and their differences divided by dx
    assert grid.dx * q.sum() == pytest.approx(float(np.diff(edges) @ values), abs=1e-11)
    assert np.all((q >= min(0.0, *values) - 1e-9) & (q <= max(0.0, *values) + 1e-9))
    own = Grid(left=float(edges[0]), cells=cells)  # cells that lie within one step have its value
    at = np.searchsorted(edges, own.centres) - 1
    inside = (own.nodes[:-1] >= edges[at]) & (own.nodes[1:] <= edges[at + 1])
    np.testing.assert_allclose(slope.q_means(own, rational())[inside], np.array(values)[at][inside], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(-0.999, 20.0)), min_size=2, max_size=8))
def test_any_points(steps_and_values):
    gaps, q = (np.array(column) for column in zip(*steps_and_values, strict=True))
    x = np.cumsum(gaps) - np.cumsum(gaps)[-1]
    assume(x[0] < 0 and not np.any((np.diff(x)[1:] == 0) & (np.diff(x)[:-1] == 0)))
    grid, slope = Grid(left=float(x[0]) - 0.5, cells=64), points(x, q)
    slope.check(grid, rational())
    means = slope.q_means(grid, rational())
    assert np.all(means > -1.0)
    assert grid.dx * means.sum() == pytest.approx(np.trapezoid(q, x), abs=1e-11)  # masses of at most 300
    W = slope.W(x, rational())
    np.testing.assert_allclose(np.diff(W), 0.5 * np.diff(x) * (q[1:] + q[:-1]), atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(-0.3, 5.0), st.floats(-6.0, 1.0), st.floats(0.05, 1.0)), min_size=1, max_size=3))
def test_any_bumps(rows):
    a, c, w = map(np.array, zip(*rows, strict=True))
    slope = bumps(a, c, w)
    grid = Grid(left=-12.0, cells=120)
    slope.check(grid, rational())
    means = slope.q_means(grid, rational())
    assert np.all(means > -1.0)
    # ∫ over the half line, from Python's own error function
    mass = sum(0.5 * math.sqrt(math.pi) * ai * wi * math.erfc(ci / wi) for ai, ci, wi in rows)
    assert grid.dx * means.sum() == pytest.approx(mass, abs=1e-13)
    assert means[0] == pytest.approx(0.0, abs=1e-13)


@pytest.mark.parametrize(
    ("slope", "start"),
    [
        (kinks([-7.0, -5.0], [0.4, 1.2]), -7.0),
        (steps([-6.0, -4.0], [-0.4]), -6.0),
        (points([-3.0, -1.0], [0.0, 1.0]), -3.0),
        (steady(0.3, -2.0), -2.0),
        (bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5]), -5.0 - math.sqrt(math.log(0.8 / TAIL))),
    ],
)
def test_a_profile_must_fit_the_grid(slope, start):
    law = rational()
    assert slope.start() == pytest.approx(start, rel=1e-14)
    slope.check(Grid(left=start * (1 + 1e-9), cells=50), law)
    with pytest.raises(InputError, match=r"reaches left to x = .* but the domain begins at left = .* at most"):
        slope.check(Grid(left=start * (1 - 1e-9), cells=50), law)


def test_the_steady_slope_without_a_kink_fits_every_grid():
    steady(0.3).check(Grid(left=-1.0, cells=10), rational())


BAD_ARGUMENTS = [
    (lambda: kinks([], []), "positions = "),
    (lambda: kinks([-1.0], ["much"]), "amplitudes = "),
    (lambda: kinks([[-1.0]], [1.0]), "positions = "),
    (lambda: kinks([-1.0, -2.0], [1.0, 2.0]), "positions = [-1.0, -2.0] must increase"),
    (lambda: kinks([-1.0, -1.0], [1.0, 2.0]), "positions = [-1.0, -1.0] must increase"),
    (
        lambda: kinks([-1.0, 0.5], [1.0, 2.0]).check(GRID, log()),
        "positions[1] = 0.5 lies past the crest; the domain ends at x = 0",
    ),
    (lambda: kinks([-1.0, -0.5], [1.0]), "amplitudes has 1 entries and positions has 2"),
    (lambda: kinks([-1.0, math.nan], [1.0, 2.0]), "positions[1] = nan must be a finite number"),
    (lambda: kinks([-1.0], [math.inf]), "amplitudes[0] = inf must be a finite number"),
    (lambda: kinks([-1.0], [0.0]).check(GRID, log()), "amplitudes[0] = 0 must exceed q = 0"),
    (lambda: kinks([-1.0], [-0.5]).check(GRID, log()), "amplitudes[0] = -0.5 must exceed q = 0"),
    (lambda: kinks([-3.0, -2.0], [1.0, 0.3]).check(GRID, rational()), "amplitudes[1] = 0.3 must exceed q = 0.3678"),
    (lambda: bumps([1.0], [-1.0], [0.0]), "widths[0] = 0 must be a positive number"),
    (lambda: bumps([1.0, 1.0], [-1.0, -2.0], [1.0, -2.0]), "widths[1] = -2 must be a positive number"),
    (lambda: bumps([1.0], [-1.0, -2.0], [1.0, 2.0]), "centres has 2 entries and amplitudes has 1"),
    (lambda: bumps([-1.0], [-2.0], [1.0]), "q = -1 at x = -2; q must be above -1"),
    (lambda: bumps([3.0, -4.2], [-2.0, -2.0], [1.0, 0.001]), "q = -1.2 at x = -2; q must be above -1"),
    (lambda: steps([-1.0], []), "edges = "),
    (lambda: steps([-2.0, -1.0], [1.0, 2.0]), "edges has 2 entries and values has 2; edges must have one more"),
    (lambda: steps([-1.0, -2.0], [1.0]), "edges = [-1.0, -2.0] must increase"),
    (lambda: steps([-1.0, 1.0], [1.0]).check(GRID, log()), "edges[1] = 1 lies past the crest"),
    (lambda: steps([-2.0, -1.0, 0.0], [1.0, -1.0]), "values[1] = -1 must be above -1"),
    (lambda: points([-1.0], [1.0]), "x = "),
    (lambda: points([-1.0, -2.0], [1.0, 1.0]), "x[1] must not be left of the point before it"),
    (
        lambda: points([-1.0, -1.0, -1.0], [1.0, 2.0, 3.0]),
        "x holds a position three times; a jump is a position that is given twice",
    ),
    (lambda: points([-1.0, 1.0], [1.0, 2.0]).check(GRID, log()), "x[1] = 1 lies past the crest"),
    (lambda: points([-2.0, -1.0], [0.0, -1.5]), "q[1] = -1.5 must be above -1"),
    (lambda: points([-2.0, -1.0], [0.0]), "q = "),
    (lambda: points([-2.0, -1.0], [0.0, 1.0, 2.0]), "q has 3 entries and x has 2"),
    (lambda: steady(0.0), "flux = 0.0 must be a positive number"),
    (lambda: steady(math.nan), "flux = nan must be a positive number"),
    (lambda: steady(0.5, 0.0), "kink = 0.0 must be a negative number"),
    (lambda: steady(0.5, -math.inf), "kink = -inf must be a negative number"),
    (lambda: steady(1.0).check(GRID, rational()), "flux = 1 is not a value of the law 'rational'"),
    (lambda: steady(0.5).check(GRID, power(2.0)), "flux = 0.5 is not a value of the law 'power'"),
    (lambda: steady(1.0).check(GRID, expression("1-1/(1+q)")), "flux = 1 is not a value of the law 'expression'"),
    (lambda: profile(lambda x: 1 / 0).check(GRID, log()), "the profile cannot be evaluated: ZeroDivisionError"),
    (lambda: profile(lambda x: x * math.nan).check(GRID, log()), "the profile is not finite near x = -8.95"),
    (lambda: profile(lambda x: -x).check(GRID, log()), "the profile does not rise near x = -8.85, where q = -2;"),
    (lambda: profile(lambda x: 0.5 * x).check(GRID, log()), "q = -0.5 at the left end x = -9;"),
    (
        lambda: profile(lambda x: x if x < -4 else -8 - x).check(GRID, log()),
        "does not rise near x = -",
    ),
    (lambda: survey("a.csv", 0.0, 1.0), "critical_slope = 0.0 must be a positive number"),
    (lambda: survey("a.csv", 1.0, math.nan), "length = nan must be a positive number"),
    (lambda: survey("a.csv", 1.0, 1.0, "mend"), "repair = 'mend' is not known; allowed is 'isotonic'"),
    (lambda: profile(x=[-1.0, -2.0], u=[0.0, 1.0]), "x and u must increase from left to right"),
    (lambda: profile(x=[-2.0, -1.0], u=[0.0, 0.0]), "x and u must increase from left to right"),
    (lambda: profile(x=[-2.0, -1.0], u=[0.0]), "u = "),
    (lambda: profile(x=[-3.0, -2.0, -1.0], u=[0.0, 1.0]), "u has 2 entries and x has 3"),
    (lambda: Grid(left=0.0, cells=10), "left = 0.0 must be a negative number"),
    (lambda: Grid(left=-math.inf, cells=10), "left = -inf must be a negative number"),
    (lambda: Grid(left=-1.0, cells=3), "cells = 3 must be a whole number, 4 or more"),
    (lambda: Grid(left=-1.0, cells=5.0), "cells = 5.0 must be a whole number"),
    (lambda: Grid(left=-1.0, cells=True), "cells = True must be a whole number"),
    (lambda: Grid(left=-1.0, cells=10**400).check_memory(1), "with 1 snapshots needs"),
    (lambda: Problem(log(), steady(0.1), end=-1.0), "end = -1.0 must be a number, 0 or more"),
    (lambda: Problem(log(), steady(0.1), end=math.inf), "end = inf must be a number, 0 or more"),
    (lambda: Problem(log(), steady(0.1), 1.0, snapshots=0), "snapshots = 0 must be 1 or more"),
    (lambda: Problem(log(), steady(0.1), 1.0, snapshots=True), "snapshots = True must be 1 or more"),
    (lambda: Problem(log(), steady(0.1), 1.0, snapshots=[]), "snapshots = [] must be a count or a list of times"),
    (lambda: Problem(log(), steady(0.1), 1.0, snapshots=[0.5, 0.5]), "snapshots = [0.5, 0.5] must increase"),
    (
        lambda: Problem(log(), steady(0.1), 1.0, snapshots=[0.0, 1.5]),
        "snapshots holds 1.5; times must lie between 0 and",
    ),
    (lambda: Problem(log(), steady(0.1), 5e-324, snapshots=31), "end = 5e-324 must be a number, 0 or more, from"),
]


@pytest.mark.parametrize(("make", "words"), BAD_ARGUMENTS, ids=[words for _, words in BAD_ARGUMENTS])
def test_bad_arguments_are_named(make, words):
    with pytest.raises(InputError, match=re.escape(words)):
        make()


@pytest.mark.parametrize(
    ("end", "snapshots", "times"),
    [
        (2.0, 5, [0.0, 0.5, 1.0, 1.5, 2.0]),
        (2.0, 1, [2.0]),
        (2.0, (0.25, 1.0), [0.25, 1.0]),
        (0.0, 31, [0.0]),
        (0.0, [0.0], [0.0]),
    ],
)
def test_kept_times(end, snapshots, times):
    problem = Problem(log(), steady(0.1), end, snapshots)
    assert problem.times.tolist() == times
    assert problem.kept == len(times)
