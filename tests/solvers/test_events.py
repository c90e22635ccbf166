"""Events by every method: numbers that do not depend on saved times, three kinks that meet, events at the end."""

from dataclasses import replace

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.closed_forms import travelling_kink
from hjprofile.solvers.grids import kink_tracker
from hjprofile.solvers.run import Event, in_order

TRIPLE = -5.893338246587875  # from here the first kink reaches the others as they meet, by bisection on fronts
EXACT = {"fronts": hj.track_fronts, "characteristics": hj.solve_characteristics}
GRID_METHODS = ("godunov", "local-lax-friedrichs", "lax-friedrichs", "telescoping", "weno5", "conservative")


def on_a_grid(problem, grid, method):
    return (hj.solve_conservative if method == "conservative" else hj.solve_hj)(problem, grid, method)


@pytest.mark.parametrize(("cells", "method"), [(8000, "local-lax-friedrichs"), (1000, "conservative")])
def test_numbers_do_not_depend_on_the_saved_times(cells, method):
    """Two births at t = 0.8356 and 0.8700, which a grid dates by the step in which it first sees a kink."""
    case = hj.load_case("breaking_bump")
    runs = []
    for snapshots in (41, 2, 11, [0.0, 0.7, 1.3, 2.0]):
        run = on_a_grid(replace(case.problem, snapshots=snapshots), replace(case.grid, cells=cells), method)
        runs.append(({k.kink: k.x for k in run.kinks_at(-1)}, {e.kink: (e.time, e.x) for e in run.events}))
    (places, events), *others = runs
    assert sorted(places) == [1, 2] and places[1] < places[2]
    for there, happened in others:
        assert there == pytest.approx(places, abs=0.1 * 10.0 / cells)  # the steps differ, so the positions by rounding
        for kink, event in happened.items():  # until a young jump stays in sight it comes and goes: ten cells
            assert event == pytest.approx(events[kink], abs=0.03)


def test_kinks_are_not_lost_where_they_merge():
    """The strongest kink of the hillslope takes in others; its speed then is not what it was before."""
    case = hj.load_case("hillslope")
    strongest = set()
    for snapshots in (2, 11, 41):
        run = hj.solve_conservative(replace(case.problem, snapshots=snapshots), case.grid)
        strongest.add(max(run.kinks_at(-1), key=lambda k: k.jump).kink)
    assert len(strongest) == 1 and strongest.pop() <= 18  # the number of kinks at the start


@pytest.mark.parametrize(
    ("method", "cells", "accuracy"),  # measured 0.0031, 0.0010, 0.018, 0.0068, 0.0017, 0.0002
    [
        ("local-lax-friedrichs", 500, 0.005), ("conservative", 500, 0.002), ("lax-friedrichs", 500, 0.03),
        ("lax-friedrichs", 2000, 0.01), ("local-lax-friedrichs", 2000, 0.003), ("conservative", 2000, 0.0005),
    ],
)  # fmt: skip
def test_measured_speed(method, cells, accuracy):
    """Of the travelling kink, in all of its life but the last 16 cells; a straight line would be off by 16 %."""
    exact = travelling_kink(hj.rational(), 1.0, -6.0)
    problem = hj.Problem(hj.rational(), hj.kinks([-6.0], [1.0]), end=6.99, snapshots=71)
    grid = hj.Grid(-10.0, cells)
    for k in on_a_grid(problem, grid, method).kinks:
        assert np.isnan(k.speed) == (k.x > -16 * grid.dx)
        if k.time and k.x <= -16 * grid.dx:
            assert k.speed == pytest.approx(
                (exact.path(k.time + 1e-6) - exact.path(k.time - 1e-6)) / 2e-6, rel=accuracy
            )


@pytest.mark.parametrize("method", ["local-lax-friedrichs", "conservative"])
def test_a_speed_that_cannot_be_measured_is_not_stated(method):
    """Beside the merge of two kinks: measured within 1.1 %, where a line through both paths is off by 160 %."""
    case = hj.load_case("two_kinks")
    speeds = np.array([(k.speed, k.rankine_hugoniot_speed) for k in on_a_grid(case.problem, case.grid, method).kinks])
    stated = speeds[np.isfinite(speeds[:, 0])]
    assert len(stated) >= 0.9 * len(speeds)
    assert np.abs(stated[:, 0] / stated[:, 1] - 1.0).max() <= 0.02


def test_speeds_are_the_same_in_many_blocks(monkeypatch):
    """Of sightings at many saved times."""
    case = hj.load_case("two_kinks")

    def speeds():
        return [k.speed for k in on_a_grid(replace(case.problem, snapshots=41), case.grid, "godunov").kinks]

    one = speeds()
    monkeypatch.setattr(kink_tracker, "MOST_ENTRIES", 1)
    many = speeds()
    assert 41 <= np.isfinite(one).sum() < len(one)
    assert many == pytest.approx(one, rel=1e-12, nan_ok=True)


def triple(end):
    return hj.Problem(hj.rational(), hj.kinks([TRIPLE, -5.0, -4.5], [0.4, 1.0, 2.0]), end=end, snapshots=3)


@pytest.mark.parametrize("method", [*EXACT, *(m for m in GRID_METHODS if m != "lax-friedrichs")])
def test_kinks_that_meet_at_one_moment_merge_into_the_lowest(method):
    grid = hj.Grid(-8.0, 2000)
    run = EXACT[method](triple(1.0), grid) if method in EXACT else on_a_grid(triple(1.0), grid, method)
    assert {(e.event, e.kink, e.into) for e in run.events} == {("merge", 2, 1), ("merge", 3, 1)}
    # lax-friedrichs is left out: it smears the first kink over more than 16 cells. Measured 0.02
    assert [e.time for e in run.events] == pytest.approx(2 * [0.60612672894464], abs=1e-11 if method in EXACT else 0.03)


@pytest.mark.parametrize("method", EXACT)
def test_an_exit_at_an_end_that_is_not_saved_is_listed(method):
    end = travelling_kink(hj.rational(), 1.0, -3.0).exit_time
    run = EXACT[method](hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=end, snapshots=[0.0, 1.0]))
    assert [(e.event, e.kink) for e in run.events] == [("exit", 1)]


@pytest.mark.parametrize("method", EXACT)
def test_a_meeting_of_three_at_the_end_is_listed(method):
    run = EXACT[method](triple(0.60612672894464))
    assert [(e.event, e.into) for e in run.events] == 2 * [("merge", 1)]
    assert [k.kink for k in run.kinks_at(-1)] == [1]


@pytest.mark.parametrize("law", [hj.rational(), hj.log()], ids=lambda law: law.name)
@pytest.mark.parametrize("method", [*EXACT, *GRID_METHODS])
def test_an_exit_at_the_end_is_listed(law, method):
    exact = travelling_kink(law, 1.0, -3.0)
    for end in (exact.exit_time, exact.exit_time * (1.0 - 1e-13)):
        problem, grid = hj.Problem(law, hj.kinks([-3.0], [1.0]), end=end, snapshots=3), hj.Grid(-5.0, 500)
        run = EXACT[method](problem, grid) if method in EXACT else on_a_grid(problem, grid, method)
        (leaving,) = run.events
        assert (leaving.event, leaving.kink) == ("exit", 1)
        assert leaving.time <= end and leaving.time == pytest.approx(end, abs=1e-11 if method in EXACT else 0.02)
        assert run.kinks_at(-1) == [] and len(run.kinks_at(1)) == 1


def test_a_birth_at_the_end_is_listed():
    def solve(end):
        profile = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5])
        return hj.solve_characteristics(hj.Problem(hj.rational(), profile, end=end, snapshots=2))

    first = solve(0.85).events[0]
    (birth,) = solve(first.time).events
    assert (birth.event, birth.kink) == ("birth", 1) and birth.time == pytest.approx(first.time, abs=1e-9)
    assert birth.x == pytest.approx(first.x, abs=1e-6)


def test_a_blow_up_or_merge_at_the_end_is_listed_under_linear_growth():
    case = hj.load_case("vertical_step")
    for event in hj.track_fronts(case.problem).events:
        problem = replace(case.problem, end=event.time, snapshots=2)
        last = hj.track_fronts(problem).events[-1]
        assert last[1:4] == event[1:4] and last.time == pytest.approx(event.time, abs=1e-11)


@pytest.mark.parametrize(("later", "moment", "into"), [(1.0, 0.0, 1), (1.5, 0.5, 1), (1.5, 0.25, 2)])
def test_kinks_that_meet_within_a_moment_merge_into_the_one_that_lives_on(later, moment, into):
    """Kink 3 merges into 2 at t = 1; it merges into 1 if 2 does so no more than a moment later."""
    meetings = [Event(later, "merge", 2, 1, -1.0), Event(1.0, "merge", 3, 2, -1.0)]
    assert {e.kink: e.into for e in in_order(meetings, moment)} == {2: 1, 3: into}
