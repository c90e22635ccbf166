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
from hjprofile.problem.units import Units
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


@pytest.mark.parametrize("change", [{"length": 100.0}, {"critical_slope": 0.3}, {"x_top": 900.0}, {"height_top": 0.0}])
def test_runs_in_different_units_are_not_compared(change):
    """The same ground differs by any amount in the numbers of two units."""
    first = dataclasses.replace(solved(100), units=UNITS)
    other = dataclasses.replace(solved(100), units=dataclasses.replace(UNITS, **change))
    words = (
        r"surveys in different units \(length = 200, critical_slope = 0.25, crest at x = 1000, height 450; and length"
    )
    for compared in (compare, lambda one, two: draw_comparison(one, two, NAMES)):
        with pytest.raises(hj.InputError, match=words):
            compared(first, other)
    rounded = {name: getattr(UNITS, name) * (1 + 1e-15) for name in ("length", "critical_slope", "x_top", "height_top")}
    assert compare(first, dataclasses.replace(other, units=Units(**rounded))).height_sup == 0.0


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
    assert document == norms._asdict() | {"files": ["both/comparison.png", "both/comparison.svg"]}
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
