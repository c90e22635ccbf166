"""Kinks of rounded heights: which are reported, and the books of the others."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hjprofile as hj
from hjprofile.problem.heights import rounding_of
from hjprofile.solvers.run import Event, KinkRecord
from hjprofile.solvers.weak_kinks import without_weak_kinks


def record(t, kink, x, jump):
    return KinkRecord(t, kink, x, 0.0, jump, jump, np.nan, 1.0)


def test_weak_kinks_and_their_events_are_omitted():
    """Kinks 1 and 3 are strong from the start; 2 merges into 1 unseen; 4 grows; 5 is born weak and strengthens."""
    kinks = [
        record(0.0, 1, -5.0, 1.0), record(0.0, 2, -4.5, 0.1), record(0.0, 3, -3.0, 0.8), record(0.0, 4, -1.0, 0.2),
        record(1.0, 1, -4.6, 1.0), record(1.0, 3, -2.8, 0.8), record(1.0, 4, -0.9, 0.4), record(1.0, 5, -0.5, 0.1),
        record(2.0, 1, -4.0, 0.2), record(2.0, 3, -2.5, 0.8), record(2.0, 5, -0.4, 0.9),
    ]  # fmt: skip
    events = [
        Event(0.5, "merge", 2, 1, -4.7), Event(0.7, "birth", 5, None, -0.6), Event(1.5, "exit", 4, None, 0.0),
    ]  # fmt: skip
    kept, found = without_weak_kinks(kinks, events, 0.3)
    assert [(k.time, k.kink, k.x) for k in kept] == [
        (0.0, 1, -5.0), (0.0, 2, -3.0), (1.0, 1, -4.6), (1.0, 2, -2.8), (1.0, 3, -0.9), (2.0, 1, -4.0), (2.0, 2, -2.5),
        (2.0, 4, -0.4),
    ]  # fmt: skip
    assert found == [
        Event(1.0, "birth", 3, None, -0.9), Event(1.5, "exit", 3, None, 0.0), Event(2.0, "birth", 4, None, -0.4),
    ]  # fmt: skip
    assert without_weak_kinks(kinks, events, 0.0) == (kinks, events)


def test_a_strong_kink_that_merges_into_a_weak_one_goes_on():
    """The survivor has the number of the weak one, and is the strong one in what is reported."""
    kinks = [record(0.0, 1, -3.0, 0.1), record(0.0, 2, -2.0, 1.0), record(1.0, 1, -2.0, 1.1), record(2.0, 1, -1.5, 1.2)]
    events = [Event(0.5, "merge", 2, 1, -2.2), Event(2.5, "exit", 1, None, 0.0)]
    kept, found = without_weak_kinks(kinks, events, 0.3)
    assert [(k.time, k.kink, k.x) for k in kept] == [(0.0, 1, -2.0), (1.0, 1, -2.0), (2.0, 1, -1.5)]
    assert found == [Event(2.5, "exit", 1, None, 0.0)]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.floats(0.01, 1.5))
def test_the_books_balance(seed, least):
    """On random steps by fronts: kinks at the end = at the start + births - merges - exits, each with one number."""
    rng = np.random.default_rng(seed)
    edges = np.sort(rng.uniform(-6.0, -0.1, 13))
    problem = hj.Problem(hj.rational(), hj.steps(edges, rng.uniform(-0.6, 1.5, 12)), 2.0, 6)
    run = hj.track_fronts(problem, hj.Grid(-8.0, 200), 300)
    kinks, events = without_weak_kinks(run.kinks, run.events, least)
    at = {t: [k.kink for k in kinks if k.time == t] for t in run.time.tolist()}
    count = Counter(event.event for event in events)
    start, end = len(at[0.0]), len(at[run.time[-1]])
    born = {event.kink for event in events if event.event == "birth"}
    assert end == start + count["birth"] - count["merge"] - count["exit"]
    assert all(len(set(numbers)) == len(numbers) for numbers in at.values())
    assert len(born) == count["birth"] and not born & set(at[0.0])
    numbers = {k.kink for k in kinks}
    assert numbers == set(range(1, len(numbers) + 1))
    positions = {(k.time, k.x) for k in run.kinks}
    assert all((k.time, k.x) in positions for k in kinks)
    reached = {(k.time, k.x) for k in run.kinks if k.jump >= least}
    assert reached <= {(k.time, k.x) for k in kinks}  # no strong kink is lost


@pytest.mark.parametrize(
    ("heights", "unit"),
    [
        (np.round(400.0 + 0.37 * np.arange(60) ** 0.9, 2), 0.01),
        (np.round(400.0 + 0.37 * np.arange(60) ** 0.9, 0), 1.0),
        (np.round(4000.0 + 37 * np.arange(60) ** 0.9, -1), 10.0),
        (np.round(5e6 + 0.37 * np.arange(60) ** 0.9, 3), 1e-3),
        (400.0 + 0.37 * np.arange(60) ** 0.9, 0.0),
        (np.arange(10.0), 0.0),  # so few may be drawn by hand
    ],
)
def test_the_rounding_of_heights_is_estimated(heights, unit):
    """From the heights alone: all are multiples of a power of 10."""
    assert rounding_of(heights) == unit


def test_rounded_heights_have_the_kinks_of_the_slope():
    """Heights in cm at a spacing of 1 m have the kinks of the slope with all digits; without the threshold they do not.

    The kink at the start is the toe. A weak kink near the threshold may be one birth more.
    """
    x = np.arange(0.0, 121.0)
    height = 412.0 + 0.36 * x + 2.0 * np.sin(x / 14.0) + np.tanh((x - 60.0) / 12.0)

    def solved(slope, method="godunov"):
        run = hj.solve_hj(hj.Problem(hj.rational(), slope, 3.0), hj.Grid(-10.5, 1000), method)
        return len(run.kinks_at(0)), len(run.kinks_at(-1)), Counter(e.event for e in run.events)["birth"]

    exact, slope = (
        hj.survey(x=x, height=heights, critical_slope=0.36, length=12.0) for heights in (height, np.round(height, 2))
    )
    for method in ("local-lax-friedrichs", "godunov"):
        start, end, births = solved(exact, method)
        found = solved(slope, method)
        assert (start, end) == found[:2] == (1, 2) and abs(found[2] - births) <= 1
    assert solved(dataclasses.replace(slope, rounding=0.0))[0] > 1
    assert slope.rounding == pytest.approx(1.6 * 2 * 0.01 / 0.36)
    assert "heights are rounded to 0.01, so kinks with a jump of q below 0.089 are not reported" in slope.account
    fronts = hj.track_fronts(hj.Problem(hj.rational(), slope, 3.0), hj.Grid(-10.5, 1000))
    assert (len(fronts.kinks_at(0)), len(fronts.kinks_at(-1))) == (1, 2)
