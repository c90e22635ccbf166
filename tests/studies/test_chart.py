"""Accuracy against seconds: what is on the chart, against what, and what is read off it."""

import csv
import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hjprofile as hj
from hjprofile import cli
from hjprofile.output.plots.study_pictures import draw_chart
from hjprofile.solvers.methods import METHODS
from hjprofile.studies import chart as charts
from hjprofile.studies.chart import Point, chart_of, pareto, seconds_to

KINK = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.5)
SMOOTH = hj.Problem(hj.log(), hj.bumps([0.5], [-2.0], [0.3]), end=0.2)


@pytest.fixture(autouse=True)
def few_and_coarse(monkeypatch):
    monkeypatch.setattr(charts, "CELLS", (60, 120, 240))
    monkeypatch.setattr(charts, "FINEST", 480)
    monkeypatch.setattr(charts, "LONGEST_RUN", np.inf)  # the machine may be slow
    monkeypatch.setattr(charts, "FRONTS", (50, 100))
    monkeypatch.setattr(charts, "TOLERANCES", (1e-7, 1e-10))
    monkeypatch.setattr(charts, "REPEATS", 1)  # more make the seconds better, and nothing else


@cache
def smooth_chart():
    return chart_of("smooth", SMOOTH, hj.Grid(-4.0, 200))


def test_every_method_is_on_it():
    found = smooth_chart()
    points, reference = found.points, found.reference
    assert {p.method for p in points} == set(METHODS) - {"auto"}
    assert reference.name == "characteristics" and 0.0 < reference.error <= 1e-9
    for method in {p.method for p in points}:
        mine = [p for p in points if p.method == method]
        assert len(mine) == {"fronts": 2, "characteristics": 2}.get(method, 3)
        assert all(p.case == "smooth" and p.seconds > 0.0 and p.steps > 0 for p in mine)
        if method != "characteristics":
            assert mine[-1].error_q_l1 < 0.75 * mine[0].error_q_l1 and mine[-1].error_u_sup < mine[0].error_u_sup


def test_errors_are_what_they_are_called():
    """On the travelling kink, against its closed form; fronts and characteristics are exact there."""
    found = chart_of("kink", KINK, hj.Grid(-3.0, 150))
    points, reference = found.points, found.reference
    assert (reference.name, reference.error) == ("the closed form", 0.0)
    exact = charts.closed_form(KINK)
    (godunov,) = [p for p in points if (p.method, p.cells) == ("godunov", 120)]
    grid = hj.Grid(-3.0, 120)
    times = KINK.times
    run = hj.solve_hj(hj.Problem(KINK.law, KINK.profile, end=0.5, snapshots=times.tolist()), grid, "godunov")
    u = np.array([exact.u(t, grid.nodes) for t in times])
    assert godunov.error_u_sup == pytest.approx(np.abs(run.u - u).max(), rel=1e-12)
    q = np.array([exact.q_means(t, grid) for t in times])
    assert godunov.error_q_l1 == pytest.approx(grid.dx * np.abs(run.q - q).sum(axis=1).max(), rel=1e-12)
    assert max(p.error_u_sup for p in points if p.method in ("fronts", "characteristics")) <= 1e-8


def test_errors_are_those_of_all_saved_times(monkeypatch):
    """At the end of these the kink has left, the slope is critical, and every method is exact."""
    monkeypatch.setattr(charts, "CELLS", (60,))
    monkeypatch.setattr(charts, "FRONTS", (50,))
    left = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=8.0)  # at t = 1 + (1 - 1/e)/2 = 1.316
    grid = hj.Grid(-2.0, 60)
    found = chart_of("left", left, grid)
    points = found.points
    assert min(p.error_q_l1 for p in points if p.method in ("godunov", "lax-friedrichs", "conservative")) > 1e-4
    exact, run = charts.closed_form(left), hj.solve_hj(left, grid, "godunov")
    (godunov,) = [p for p in points if p.method == "godunov"]
    apart = [np.abs(run.u[i] - exact.u(t, grid.nodes)).max() for i, t in enumerate(left.times)]
    assert max(apart) > apart[-1] and godunov.error_u_sup == pytest.approx(max(apart), rel=1e-12)
    times = (replace(left, snapshots=1), replace(left, snapshots=[0.0, 2.0, 8.0]))
    for still in (*times, replace(left, profile=hj.steps([-2.0, -1.0], [0.0]))):
        with pytest.raises(
            hj.InputError, match=r"left: the slope is neutral from the first measurement on, at t = \S+, so every"
        ):
            chart_of("left", still, grid)
    with pytest.raises(hj.InputError, match="left: no time after 0 is saved"):
        chart_of("left", replace(left, snapshots=[0.0]), grid)


def test_no_error_is_less_than_the_reference_may_be_off():
    """Characteristics against characteristics: their distance says nothing below what either is known to."""
    found = smooth_chart()
    points, reference = found.points, found.reference
    assert 0.0 < reference.error <= reference.error_q <= 1e-10
    exact = [p for p in points if p.method == "characteristics"]
    assert min(p.error_u_sup for p in exact) == reference.error
    assert min(p.error_q_l1 for p in exact) == reference.error_q
    log_kink = hj.Problem(hj.log(), KINK.profile, end=0.5)  # whose closed form is an integration itself
    steep = hj.expression("q + q/(1+q)", growth="linear")  # fronts of kinks are the same whatever their number
    for problem in (log_kink, hj.Problem(steep, KINK.profile, end=0.1, snapshots=3)):
        assert charts._reference(problem, hj.Grid(-3.0, 50)).error == charts.INTEGRATED


def test_a_flux_that_enters_leaves_fronts_out():
    found = chart_of("steady", hj.Problem(hj.rational(), hj.steady(0.4), end=0.2), hj.Grid(-2.0, 100))
    points, reference = found.points, found.reference
    assert reference.name == "the closed form"
    assert {p.method for p in points} == set(METHODS) - {"auto", "fronts", "inverse", "characteristics"}


def test_fronts_stand_in_for_characteristics(monkeypatch):
    def refuses(*_):
        raise hj.RunError("stopped")

    monkeypatch.setattr(charts, "solve_characteristics", refuses)
    monkeypatch.setattr(charts, "REFERENCE_FRONTS", 800)
    found = chart_of("smooth", SMOOTH, hj.Grid(-4.0, 200))
    points, reference = found.points, found.reference
    assert reference.name == "800 fronts" and 0.0 < reference.error < 1e-4
    assert "characteristics" not in {p.method for p in points}


def test_a_chart_needs_time_to_pass():
    with pytest.raises(hj.InputError, match=r"still: end = 0; a chart needs an end above 0"):
        chart_of("still", hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.0), hj.Grid(-3.0, 100))


def point(seconds, error, cells=100):
    return Point("c", "m", cells, error, error, seconds, 1)


@given(st.lists(st.tuples(st.floats(1e-3, 1.0), st.floats(1e-6, 1.0)), min_size=1, max_size=30))
def test_nothing_beats_the_pareto_front(pairs):
    points = [point(*pair) for pair in pairs]
    front = pareto(points)
    for p in points:
        beaten = any(f.seconds <= p.seconds and f.error_q_l1 <= p.error_q_l1 for f in front)
        assert beaten
    assert all(a.seconds <= b.seconds and a.error_q_l1 > b.error_q_l1 for a, b in itertools.pairwise(front))


def test_seconds_to_an_error_follow_the_trend():
    points = [point(1e-6 * n**1.5, 50.0 / n, n) for n in (100, 200, 400, 800, 1600, 3200)]
    assert seconds_to(points, 0.1) == pytest.approx(1e-6 * 500**1.5)
    assert seconds_to(points[::-1], 1e-2) == pytest.approx(1e-6 * 3200**1.5 * (5000 / 3200) ** 2)
    assert seconds_to(points, 10.0) == pytest.approx(points[0].seconds)
    assert np.isnan(seconds_to(points[:1], 1e-2))


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        cli.main(["chart", "travelling_kink", "--out", "there"])
    out, err = capsys.readouterr()
    assert ended.value.code == 0 and err == ""
    with open("there/chart.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["case", "method", "cells", "error_u_sup", "error_q_l1", "seconds", "steps"]
    assert {row["method"] for row in rows} == set(METHODS) - {"auto"}
    assert all(float(row["error_q_l1"]) >= 0.0 and int(row["cells"]) > 0 for row in rows)
    assert Path("there/chart.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert "reference: the closed form" in out and "  fronts " in out
    with pytest.raises(SystemExit) as ended:
        cli.main(["chart"])
    assert ended.value.code == 2 and "chart needs at least one CASE" in capsys.readouterr().err


@pytest.mark.parametrize("problem", [KINK, SMOOTH, replace(KINK, profile=hj.steady(0.4))])
def test_the_reference_on_coarser_grids_is_that_of_the_finest(problem):
    """Every kth node, and means of k cells, are those of a grid with k times fewer cells."""
    reference = charts._reference(problem, hj.Grid(-4.0, 60))
    exact = charts.closed_form(problem)
    for cells in (60, 120, 240, 480):
        grid = hj.Grid(-4.0, cells)
        if exact:
            own_u = np.array([exact.u(t, grid.nodes) for t in problem.times])
            own_q = np.array([exact.q_means(t, grid) for t in problem.times])
        else:
            run = hj.solve_characteristics(problem, grid)
            own_u, own_q = run.u, run.q
        u, q = reference.on(cells)
        assert np.abs(u - own_u).max() <= 1e-10 and np.abs(q - own_q).max() <= 1e-8  # rounding of differences


def test_seconds_of_a_run_that_was_disturbed(monkeypatch):
    """It is repeated, and the others count; a long run that took what its size suggests is not."""

    def timed(expected, *seconds):
        left = list(seconds)
        run = type("Run", (), {})

        def once():
            made = run()
            made.wall_seconds = left.pop(0)
            return made

        _, found = charts._timed(once, expected)
        return found, len(seconds) - len(left)

    monkeypatch.setattr(charts, "REPEATS", 3)
    assert timed(0.1, 0.12, 9.0, 9.0) == (0.12, 1)
    assert timed(0.1, 0.4, 0.11, 9.0) == (0.11, 2)
    assert timed(0.1, 0.4, 0.3, 0.2) == (0.2, 3)
    assert timed(0.0, 2.0, 0.3, 0.2) == (0.2, 3)  # the first run, which loads compiled loops
    assert timed(0.01, 0.01, 0.03, 0.02) == (0.02, 3)


def test_the_methods_of_a_picture_look_different():
    """Only a flux that another form takes over has the look of that flux."""
    axes = draw_chart([smooth_chart()]).axes[0]
    looks = {line.get_label(): (line.get_color(), line.get_marker()) for line in axes.lines}
    shown = {m.name for m in METHODS.values() if not m.carries and not m.needs_tolerance} & looks.keys()
    assert len(shown) >= 9 and len({looks[name] for name in shown}) == len(shown)
