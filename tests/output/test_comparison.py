"""Two runs beside each other: what can be compared, the picture, and the command."""

import dataclasses
import json
from functools import lru_cache

import numpy as np
import pytest
from legible import assert_legible

import hjprofile as hj
from hjprofile.output.plots import style
from hjprofile.output.plots.comparison import LONGEST, draw_comparison
from hjprofile.output.plots.style import TWO_RUNS
from hjprofile.output.store import write_run
from hjprofile.problem.case import parse_case
from hjprofile.problem.units import Units
from hjprofile.solvers.solve import solve_case
from hjprofile.studies.accuracy import compare, kink_distances, shared

NAMES = ("coarse", "fine")


@lru_cache
def solved(cells, end=4.0, snapshots=9, left=-4.0, line="half"):
    problem = hj.Problem(
        hj.rational(), hj.kinks([-3.0, -2.0], [0.4, 1.2]), end=end, snapshots=snapshots, title="Two kinks", line=line
    )
    return hj.solve_hj(problem, hj.Grid(left, cells, 0.0 if line == "half" else 1.0))


def test_what_is_shared():
    """Nodes and cell means of the coarser grid, at the times of both, in either order."""
    coarse, fine = solved(100), solved(400, snapshots=5)
    for first, second in ((coarse, fine), (fine, coarse)):
        both = shared(first, second)
        assert np.array_equal(first.time[both.first], fine.time) and np.array_equal(second.time[both.second], fine.time)
        assert np.array_equal(both.x, coarse.x)
        u = {id(coarse): coarse.u[::2], id(fine): fine.u[:, ::4]}
        q = {id(coarse): coarse.q[::2], id(fine): fine.q.reshape(5, 100, 4).mean(axis=2)}
        for k, run in enumerate((first, second)):
            assert np.array_equal(both.height[k], u[id(run)])
            assert np.allclose(both.slope[k], q[id(run)], rtol=0, atol=1e-12)  # q is D u - 1 to rounding


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (solved(150), "100 and 150 cells do not nest"),
        (solved(100, left=-5.0), r"grids over \[-4, 0\] and \[-5, 0\] differ, so .*; set left .* to the same value"),
        (solved(100, line="whole"), r"grids over \[-4, 0\] and \[-4, 1\] differ"),  # on which x would lie elsewhere
        (dataclasses.replace(solved(100), time=solved(100).time + 0.1), "share no saved time"),
    ],
)
def test_what_cannot_be_compared(other, words):
    with pytest.raises(hj.InputError, match=words):
        compare(solved(100), other)
    with pytest.raises(hj.InputError, match=words):
        draw_comparison(solved(100), other, NAMES)


@pytest.mark.parametrize(
    "other", [solved(400, snapshots=5), solved(100), solved(100, end=0.0)], ids=["fine", "same", "0"]
)
def test_the_picture(other):
    first = solved(100)
    figure = draw_comparison(first, other, NAMES)
    figure.canvas.draw()
    assert_legible(figure)
    top, middle, bottom, last, ways, bar = figure.axes
    both = shared(first, other)
    for k, colour in enumerate(TWO_RUNS):
        drawn = [line.get_ydata() for line in top.lines if line.get_color() == colour]
        assert len(drawn) == min(both.first.size, 4) and np.array_equal(drawn[-1], both.height[k, -1])
    for axes, field in ((middle, both.height), (bottom, both.slope)):
        assert any(np.array_equal(line.get_ydata(), field[0, -1] - field[1, -1]) for line in axes.lines)
    (curve,), (dots,) = last.lines, ways.lines
    largest = np.abs(both.height[0] - both.height[1]).max(axis=1)
    assert np.array_equal(np.nan_to_num(curve.get_ydata()), np.where(largest > 1e-12, largest, 0.0))
    apart = [kink_distances(first.kinks_at(i), other.kinks_at(j)) for i, j in zip(both.first, both.second, strict=True)]
    assert list(dots.get_ydata()) == [d for each in apart for d in each if d > 1e-12]
    assert [t.get_text() for t in figure.texts] == [
        "Two kinks", "coarse: local-lax-friedrichs, 100 cells", f"fine: local-lax-friedrichs, {other.cells} cells"
    ]  # fmt: skip


UNITS = Units(200.0, 0.25, 1000.0, 450.0)


def test_two_runs_of_one_survey_are_drawn_in_its_units():
    first, other = (dataclasses.replace(solved(n), units=UNITS) for n in (400, 100))
    both, figure = shared(first, other), draw_comparison(first, other, NAMES)
    figure.canvas.draw()
    assert_legible(figure)
    top, middle, bottom, last, ways, _ = figure.axes
    assert (top.get_ylabel(), middle.get_ylabel()) == ("height (survey units)", "difference of height\n(survey units)")
    assert bottom.get_xlabel() == "x (survey units)" and bottom.get_xlim() == (200.0, 1000.0)
    u, metres = both.height[:, -1], 200.0 * 0.25
    early = both.height[:, 1]
    assert any(np.allclose(line.get_ydata(), 450.0 + metres * u[0]) for line in top.lines)
    assert any(np.allclose(line.get_ydata(), metres * (u[0] - u[1])) for line in middle.lines)
    assert any(np.array_equal(line.get_ydata(), both.slope[0, -1] - both.slope[1, -1]) for line in bottom.lines)
    (largest,), (apart,) = ([line.get_ydata() for line in axes.lines] for axes in (last, ways))
    assert largest[1] == pytest.approx(metres * np.abs(early[0] - early[1]).max())
    of_kinks = np.concatenate([kink_distances(first.kinks_at(i), other.kinks_at(i)) for i in range(first.time.size)])
    assert list(apart) == pytest.approx(200.0 * of_kinks[of_kinks > 1e-12])
    of_no_survey = dataclasses.replace(other, units=None)
    assert draw_comparison(first, of_no_survey, NAMES).axes[0].get_ylabel() == "height u"


def test_units_that_agree_to_rounding_are_one():
    rounded = Units(*(value * (1 + 1e-15) for value in (200.0, 0.25, 1000.0, 450.0)))
    first, other = (dataclasses.replace(solved(100), units=units) for units in (UNITS, rounded))
    found = compare(first, other)
    assert (found.height_sup, found.unit, found.shared_times) == (0.0, "", 9) and not shared(first, other).metric


GROUND = "x,height\n100,10\n200,30\n300,95\n420,150\n500,155\n"  # slopes of 0.2, 0.65, 0.46, 0.06


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory):
    """Runs of one survey in any units, with a volume of 4500 in all of them."""
    folder = tmp_path_factory.mktemp("ground")
    (folder / "slope.csv").write_text(GROUND)

    @lru_cache
    def solve(length=150.0, slope=0.4, cells=90, supplied=4500.0, snapshots=5, unit="", left=-3.0):
        content = {
            "title": "A slope",
            "erosion": {"law": "rational"},
            "profile": {"kind": "survey", "file": "slope.csv", "critical_slope": slope, "length": length},
            "domain": {"left": left * 150.0 / length, "cells": cells},
            "time": {"supplied": supplied, "snapshots": snapshots},
        }
        run = solve_case(parse_case(content, "slope", "slope", folder))
        return dataclasses.replace(run, units=dataclasses.replace(run.units, unit=unit))

    return solve


SLOPES = np.array([0.2, 0.65, 55 / 120, 5 / 80])
CORNER = np.abs(np.diff(SLOPES)).max()  # of the ground, height over length


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"length": 90.0}, 1e-12),  # the same nodes on the ground: rounding of heights of 155
        ({"length": 240.0}, 1e-12),
        ({"slope": 0.5}, 1e-12),
        ({"length": 90.0, "cells": 180}, 1e-12),  # the grids nest
        ({"length": 90.0, "cells": 70}, 450 / 70 * CORNER / 4),  # a line across a corner: a quarter of cell times jump
        ({"length": 70.0, "slope": 0.3, "cells": 101, "left": -2.8}, 450 / 90 * CORNER / 4),
    ],
)
def test_the_same_ground_in_two_units_is_the_same_at_the_start(surveyed, change, error):
    first, other = (at_start(run) for run in (surveyed(), surveyed(**change)))
    for one, two in ((first, other), (other, first)):
        both, found = shared(one, two), compare(one, two)
        assert both.metric and found.height_sup <= error and found.unit == "survey units" and found.shared_times == 1
        assert both.time.tolist() == [0.0] and 100.0 <= both.x[0] <= 113.0 and 493.0 <= both.x[-1] <= 500.0 + 1e-9
        truth = np.interp(both.x, *np.array([row.split(",") for row in GROUND.split()[1:]], dtype=float).T)
        assert np.abs(both.height - truth).max() <= error
        dx = np.diff(both.x)
        assert np.allclose(np.diff(both.height, axis=2), both.slope * dx, rtol=0, atol=4 * error)


def at_start(run):
    """The run with its first saved time only."""
    arrays = {name: getattr(run, name)[:1] for name in ("time", "u", "q", "K")}
    return dataclasses.replace(run, **arrays, kinks=run.kinks_at(0), events=[])


def test_runs_in_different_units_are_compared_at_equal_volumes(surveyed):
    """All five are shared; each distance is that of heights interpolated here."""
    first, other = surveyed(), surveyed(length=90.0, slope=0.5)
    assert first.time[-1] == 0.5 and other.time[-1] == pytest.approx(4500.0 / (90.0**2 * 0.5))
    both, found = shared(first, other), compare(first, other)
    assert np.allclose(both.time, np.linspace(0.0, 4500.0, 5)) and both.first.tolist() == both.second.tolist() == list(
        range(5)
    )
    assert (found.shared_times, found.interpolated) == (5, 0)
    x = 500.0 + 150.0 * first.x
    heights = [
        155.0 + 60.0 * first.u,
        np.array([np.interp(x, 500.0 + 90.0 * other.x, 155.0 + 45.0 * u) for u in other.u]),
    ]
    away = np.abs(heights[0] - heights[1])[:, (x >= both.x[0] - 1e-9)]
    assert found.height_sup == pytest.approx(away.max(), rel=1e-12) and found.height_sup > 0.1
    assert found.height_l1 == pytest.approx(5.0 * away[:, :].sum(axis=1).mean(), rel=1e-12)
    slopes = np.abs(0.4 * (1.0 + first.q) - 0.5 * (1.0 + other.q))[:, -both.x_cell.size :]  # the same cells
    assert found.slope_max == pytest.approx(slopes.max(), rel=1e-9)
    assert found.slope_l1 == pytest.approx(5.0 * slopes.sum(axis=1).mean(), rel=1e-9)
    strong = [[k for k in run.kinks_at(-1) if k.jump > 0.25] for run in (first, other)]
    if len(strong[0]) == len(strong[1]):
        last = [abs(150.0 * a.x - 90.0 * b.x) for a, b in zip(*strong, strict=True)]
        assert both.kinks[-1] == pytest.approx(last, rel=1e-9)


def test_other_saved_volumes_are_those_of_the_first_run(surveyed):
    """The second run is linear between its saved times, at the volumes of the first that lie within it."""
    first, other = surveyed(), surveyed(length=90.0, supplied=3000.0, snapshots=4)
    both, found = shared(first, other), compare(first, other)
    assert np.allclose(both.time, [0.0, 1125.0, 2250.0]) and both.second.tolist() == [0, -1, -1]
    assert (found.shared_times, found.interpolated) == (3, 2)
    at = [other.u[1] * 0.875 + other.u[2] * 0.125, other.u[2] * 0.75 + other.u[3] * 0.25]  # 1125 and 2250 of 1000 each
    heights = np.array([np.interp(both.x, 500.0 + 90.0 * other.x, 155.0 + 36.0 * u) for u in at])
    assert np.allclose(both.height[1, 1:], heights, rtol=0, atol=1e-10)
    assert [k.size for k in both.kinks[1:]] == [0, 0]  # the kinks of the second run are not known there
    back = shared(other, first)
    assert np.allclose(back.time, [0.0, 1000.0, 2000.0, 3000.0])


def test_surveys_without_common_ground_or_volume_are_rejected(surveyed):
    first = surveyed()
    far = dataclasses.replace(first, units=dataclasses.replace(first.units, x_top=5000.0))
    late = dataclasses.replace(surveyed(length=90.0), time=surveyed(length=90.0).time + 10.0)
    no_ground = "the runs share no ground: the data of one cover x = 105 to 500, those of the other x = 4605"
    for other, words in ((far, no_ground), (late, "the runs share no supplied volume")):
        for compared in (compare, lambda one, two: draw_comparison(one, two, NAMES)):
            with pytest.raises(hj.InputError, match=words):
                compared(first, other)


def test_slopes_that_rise_to_the_left_are_compared_on_their_ground(surveyed):
    """As their mirror images are, at mirrored positions; slopes to different sides share no ground."""
    runs = surveyed(), surveyed(length=90.0, slope=0.5)
    left = [dataclasses.replace(r, units=dataclasses.replace(r.units, x_top=0.0, direction=-1.0)) for r in runs]
    right = [dataclasses.replace(r, units=dataclasses.replace(r.units, x_top=0.0)) for r in runs]
    one, two = shared(*left), shared(*right)
    assert np.array_equal(one.x, -two.x) and np.array_equal(one.height, two.height)
    assert compare(*left) == compare(*right)
    with pytest.raises(hj.InputError, match="share no ground: one slope rises to the left, the other to the right"):
        compare(left[0], right[1])


@pytest.mark.parametrize("length", [150.0, 90.0])
def test_units_of_different_names_are_rejected(surveyed, length):
    metres, feet, unnamed = (surveyed(length=length if unit else 150.0, unit=unit) for unit in ("m", "ft", ""))
    with pytest.raises(hj.InputError, match="the runs are of surveys in m and in ft; convert one of the surveys"):
        compare(metres, feet)
    assert shared(metres, unnamed).units.label == shared(unnamed, metres).units.label == "m"  # the only known name


def test_runs_in_different_units_are_drawn_in_metres(surveyed):
    first, other = surveyed(unit="m"), surveyed(length=90.0, unit="m", cells=70)
    both, figure = shared(first, other), draw_comparison(first, other, NAMES)
    figure.canvas.draw()
    assert_legible(figure)
    top, middle, bottom, last, ways, bar = figure.axes
    labels = [axes.get_ylabel() for axes in (top, middle, bottom, last, ways, bar)]
    assert labels == [
        "height (m)", "difference of height\n(m)", "difference of slope", "sup|Δ height|\n(m)", "kinks apart\n(m)",
        "supplied volume per width (m²)",
    ]  # fmt: skip
    assert (bottom.get_xlabel(), ways.get_xlabel()) == ("x (m)", "supplied volume per width (m²)")
    assert any(np.array_equal(line.get_ydata(), both.height[1, -1]) for line in top.lines)
    assert any(np.array_equal(line.get_ydata(), both.height[0, -1] - both.height[1, -1]) for line in middle.lines)
    assert any(np.array_equal(line.get_ydata(), both.slope[0, -1] - both.slope[1, -1]) for line in bottom.lines)
    (largest,) = last.lines
    assert np.allclose(largest.get_xdata(), both.time, rtol=1e-14)
    assert figure.texts[-1].get_text() == "on their common ground, at equal supplied volumes"


def test_the_command_compares_metres(surveyed, in_tmp, call, monkeypatch):
    monkeypatch.setattr(style, "encode", lambda figure, form: "a picture")
    for name, run in (
        ("a", surveyed(unit="m")), ("b", surveyed(length=90.0, unit="m")), ("c", surveyed(cells=180, unit="m")),
        ("d", surveyed(length=90.0, supplied=3000.0, snapshots=4)),
    ):  # fmt: skip
        write_run(run, name, vtk=False, plots=False)
    found = compare(surveyed(unit="m"), surveyed(length=90.0, unit="m"))
    _, out, _ = call("compare", "a", "b")
    assert "  units       they differ; the runs are compared on their common ground, in m\n" in out
    assert "  times       5 equal supplied volumes, of 5 and 5 saved\n" in out
    assert f"∫|Δ height| dx = {found.height_l1:.2g} m², sup|Δ height| = {found.height_sup:.2g} m\n" in out
    document = json.loads(call("compare", "a", "b", "--json")[1])
    assert document["unit"] == document["survey"]["unit"] == "m" and document["height_sup"] == found.height_sup
    assert document["survey"]["height_sup"] == found.height_sup
    same = compare(surveyed(unit="m"), surveyed(cells=180, unit="m"))
    _, out, _ = call("compare", "a", "c")
    assert f"({same.height_l1 * 9000.0:.2g} m² and {same.height_sup * 60.0:.2g} m)" in out
    document = json.loads(call("compare", "a", "c", "--json")[1])
    assert document["unit"] == "" and document["survey"]["height_sup"] == pytest.approx(60.0 * same.height_sup)
    _, out, _ = call("compare", "a", "d")
    assert "3 equal supplied volumes, of 5 and 4 saved; the second run is interpolated at 2\n" in out


def test_times_that_differ_by_rounding_are_one():
    """0.1 + 0.1 + ... and a division are the same times: 31 of 31, in either order."""
    summed = np.append(0.0, np.cumsum(np.full(30, 0.1)))
    first, second = (solved(100, 3.0, tuple(times.tolist())) for times in (summed, np.arange(31) / 10))
    assert np.intersect1d(first.time, second.time).size < 31  # what `==` finds
    for one, other in ((first, second), (second, first)):
        found = compare(one, other)
        assert found.shared_times == 31 and found.kinks < 1e-10 and found.height_sup < 1e-10
    some = solved(100, 3.0, (0.3, 0.95, 3.0))
    both = shared(first, some)
    assert (both.first.tolist(), both.second.tolist()) == ([3, 30], [0, 2])
    assert compare(first, some).shared_times == compare(some, first).shared_times == 2


def test_long_names_find_room():
    names = ("a_name_that_goes_on_and_on_and_on", "results/of/another/time/and/place")
    figure = draw_comparison(solved(100), solved(400), names)
    figure.canvas.draw()
    assert_legible(figure)
    assert f"{names[0][: LONGEST - 1]}…" in figure.legends[0].get_texts()[0].get_text()


@pytest.fixture
def results(in_tmp):
    for name, run in (("a", solved(100)), ("b", solved(400)), ("c", solved(150))):
        write_run(run, name, vtk=False, plots=False)
    return in_tmp


def test_the_command(results, call, monkeypatch):
    monkeypatch.setattr(style, "encode", lambda figure, form: f"a picture as {form}")  # that takes half a second
    code, out, err = call("compare", "a", "b")
    norms = compare(solved(100), solved(400))
    assert (code, err) == (0, "") and f"{norms.height_l1:.2g}" in out and f"{norms.kinks:.2g}" in out
    assert (results / "a" / "comparison.png").is_file() and (results / "a" / "comparison.svg").is_file()
    code, out, err = call("compare", "a", "b", "--out", "both", "--json")
    document = json.loads(out)
    assert norms.shared_times == 9 and "9 shared, of 9 and 9 saved times" in call("compare", "a", "b")[1]
    assert document == norms._asdict() | {"survey": None, "files": ["both/comparison.png", "both/comparison.svg"]}
    code, out, err = call("compare", "a", "c", "--out", "none")
    assert (
        (code, out) == (2, "")
        and err.count("\n") == err.count("(see: hjprofile explain a-") == 1
        and "do not nest" in err
    )
    assert not (results / "none").exists()
    for name, cells in (("d", 100), ("e", 400)):
        write_run(dataclasses.replace(solved(cells), units=UNITS), name, vtk=False, plots=False)
    _, out, _ = call("compare", "d", "e")
    assert f"({norms.height_l1 * 1e4:.2g} and {norms.height_sup * 50.0:.2g} in the survey's units)" in out
    assert f"({norms.kinks * 200.0:.2g} in the survey's units)" in out
    assert "survey" not in call("compare", "a", "d")[1]
    write_run(solved(100), "a", vtk=False, plots=False)  # a new run there: the old comparison is of another
    assert not list((results / "a").glob("comparison.*"))
