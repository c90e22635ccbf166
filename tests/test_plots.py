"""Pictures: true PNGs with something in them, for every kind of run; labelled axes; kinks where they are."""

import dataclasses
import io
from functools import lru_cache

import numpy as np
import pytest
from matplotlib import image

import hjprofile as hj
from hjprofile.output.plots.runs import draw_diagram, draw_profiles, pictures

SIZES = {"profile.png": (1260, 1200), "diagram.png": (780, 1200)}  # rows, columns


@lru_cache
def solved(name):
    law, grid, cfl = hj.rational(), hj.Grid(left=-5.0, cells=200), 0.9
    many = -5.0 + np.arange(1, 13) * 0.4
    profile, end, snapshots = {
        "kinks": (hj.kinks([-3.0, -2.0], [0.4, 1.2]), 5.0, 21),
        "no kinks": (hj.bumps([-0.2], [-2.0], [0.7]), 0.2, 3),
        "one snapshot": (hj.kinks([-3.0, -2.0], [0.4, 1.2]), 0.3, 1),
        "no time": (hj.kinks([-3.0, -2.0], [0.4, 1.2]), 0.0, 5),
        "failed": (hj.kinks([-3.0, -2.0], [0.4, 1.2]), 5.0, 21),
        "failed at once": (hj.kinks([-3.0, -2.0], [0.4, 1.2]), 5.0, 21),
        "flat": (hj.steps([-2.0, -1.0], [0.0]), 0.5, 3),
        "survey": (None, 0.5, 6),
        "many kinks": (hj.kinks(many, 0.3 + 0.5 * np.arange(12)), 0.3, 31),
    }[name]
    if name == "survey":
        case = hj.load_case("hillslope", {"domain.cells": 520, "time.end": end, "time.snapshots": snapshots})
        return hj.solve_case(case)
    cfl = {"failed": 3.0, "failed at once": 6.0}.get(name, cfl)
    return hj.solve_hj(hj.Problem(law, profile, end=end, snapshots=snapshots, title=f"Scene: {name}"), grid, cfl=cfl)


SCENES = ("kinks", "no kinks", "one snapshot", "no time", "failed", "failed at once", "flat", "survey", "many kinks")
scene = pytest.mark.parametrize("name", SCENES)
draw = pytest.mark.parametrize("draw", [draw_profiles, draw_diagram])


def test_the_scenes_are_what_they_are_called():
    assert {name for name in SCENES if not solved(name).done} == {"failed", "failed at once"}
    assert {name for name in SCENES if not solved(name).kinks} == {"no kinks", "flat"}
    assert {name for name in SCENES if solved(name).time.size == 1} == {"one snapshot", "no time", "failed at once"}
    assert not solved("flat").q.any() and len(solved("many kinks").kinks_at(0)) == 12 and solved("survey").units


@lru_cache
def drawn(name, draw):
    figure = draw(solved(name))
    figure.canvas.draw()  # places everything
    return figure


def plain(figure):
    """The axes of a figure that are no colour bars."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


@pytest.mark.parametrize("name", ["kinks", "failed", "flat"])
def test_pngs(name):
    files = pictures(solved(name))
    assert files.keys() == SIZES.keys()
    for file, content in files.items():
        assert content[:8] == b"\x89PNG\r\n\x1a\n"
        rgb = image.imread(io.BytesIO(content))[..., :3]
        assert rgb.shape == (*SIZES[file], 3)
        assert np.mean(rgb.min(axis=-1) == 1) > 0.1  # on white paper
        # a colour bar has some 200 colours, text and frames alone are grey
        coloured = rgb[np.ptp(rgb, axis=-1) > 0.1]
        assert np.unique((coloured * 255).astype(int) @ [65536, 256, 1]).size > 100


@scene
@draw
def test_no_axes_is_empty(name, draw):
    """As many coloured pixels inside each frame as a line across it takes (the flat slope's diagram is white)."""
    figure = drawn(name, draw)
    rgb = np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)
    for axes in plain(figure):
        box = axes.get_window_extent().padded(-3)
        inside = rgb[int(rgb.shape[0] - box.y1) : int(rgb.shape[0] - box.y0), int(box.x0) : int(box.x1)]
        coloured = np.count_nonzero(np.ptp(inside, axis=-1) > 25)
        if (name, draw) == ("flat", draw_diagram):
            assert coloured == 0
        else:
            assert coloured > 0.9 * inside.shape[1]


@scene
@draw
def test_every_axis_has_a_label(name, draw):
    figure = drawn(name, draw)
    assert len(plain(figure)) < len(figure.axes)  # there is a colour bar
    for axes in figure.axes:
        assert axes.get_ylabel()
    for axes in plain(figure):
        beside = axes.get_shared_x_axes().get_siblings(axes)
        labels = {other.get_xlabel() for other in beside} - {""}
        assert labels == {"x (units of the survey)" if name == "survey" else "x (in exchange lengths; the top is at 0)"}
        assert all(tick.get_text() for tick in axes.get_yticklabels())


@pytest.mark.parametrize(("name", "time"), [("one snapshot", 0.3), ("no time", 0.0), ("failed at once", 0.0)])
def test_a_single_time_is_the_only_one_on_its_axis(name, time):
    (bar,) = set(drawn(name, draw_profiles).axes) - set(plain(drawn(name, draw_profiles)))
    assert list(bar.get_yticks()) == list(plain(drawn(name, draw_diagram))[0].get_yticks()) == [time]


@draw
def test_a_survey_is_drawn_in_its_own_units(draw):
    run = solved("survey")
    left, right = plain(drawn("survey", draw))[0].get_xlim()
    assert (left, right) == pytest.approx((run.units.x(run.x[0]), run.units.x_top), rel=1e-15)
    if draw is draw_profiles:
        top = plain(drawn("survey", draw))[0]
        assert top.get_ylabel() == "height (units of the survey)"
        assert top.lines[0].get_ydata()[-1] == pytest.approx(run.units.height_top, rel=1e-12)  # sums over the cells


@scene
@draw
def test_titles(name, draw):
    """The title stands there in full, with the method, the reason why a run stopped, and nothing on top of another."""
    run, figure = solved(name), drawn(name, draw)
    axes = plain(figure)[0]
    left, right = axes.get_title(loc="left"), axes.get_title(loc="right")
    assert left.rstrip("\n") == run.title
    expected = f"{run.method}, {run.cells} cells" + ("" if run.done else f" {run.status}")
    assert " ".join(right.split()) == expected
    boxes = {text.get_text(): text.get_window_extent() for text in axes.get_children() if hasattr(text, "get_text")}
    a, b = boxes[left], boxes[right]
    assert a.x0 >= 0 and b.x0 >= 0 and max(a.y1, b.y1) <= figure.bbox.y1 + 1  # a pixel of rounding
    lines_left, lines_right = left.count("\n") + 1, right.count("\n") + 1
    foot_of_title = a.y1 - a.height / lines_left
    top_of_reason = b.y0 + b.height * (lines_right - 1) / lines_right
    assert a.x1 < b.x0 or foot_of_title >= top_of_reason - 1


def markers(axes, marker):
    """x and y of every marker of that kind."""
    lines = [line for line in axes.lines if line.get_marker() == marker and len(line.get_xdata())]
    return [(float(x), float(y)) for line in lines for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)]


@scene
def test_kinks_are_marked_on_the_profiles(name):
    run = solved(name)
    top, middle, bottom = plain(drawn(name, draw_profiles))
    x, u = (run.units.x(run.x), run.units.height(run.u)) if run.units else (run.x, run.u)
    profiles = [line.get_ydata() for line in top.lines if len(line.get_xdata()) == x.size]
    shown = [i for i in range(run.time.size) if any(np.array_equal(y, u[i]) for y in profiles)]
    assert {0, run.time.size - 1} <= set(shown) and len(profiles) == min(run.time.size, 9)
    kinks = [(run.units.x(k.x) if run.units else k.x, i) for i in shown for k in run.kinks_at(i)]
    for axes, heights in ((top, u), (middle, u - u[0])):
        expected = [(float(at), float(np.interp(at, x, heights[i]))) for at, i in kinks]
        assert markers(axes, "o") == expected
    assert not markers(bottom, "o")
    legend = top.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["kink"] if run.kinks else legend is None


@scene
def test_kinks_and_events_are_on_the_diagram(name):
    run = solved(name)
    (axes,) = plain(drawn(name, draw_diagram))
    scale = run.units.x if run.units else float
    paths = [line for line in axes.lines if line.get_marker() in ("None", ".") and len(line.get_xdata())]
    points = {(float(x), float(t)) for line in paths for x, t in zip(line.get_xdata(), line.get_ydata(), strict=True)}
    assert points == {(float(scale(r.x)), r.time) for r in (*run.kinks, *run.events)}
    assert len(paths) == len({r.kink for r in (*run.kinks, *run.events)} & {k.kink for k in run.kinks})
    for line in paths:  # a line through one point is invisible
        assert len(line.get_xdata()) > 1 or line.get_marker() == "."
    for event, marker in (("birth", "o"), ("merge", "^"), ("exit", "s")):
        assert markers(axes, marker) == [(float(scale(e.x)), e.time) for e in run.events if e.event == event]


def test_events_are_named():
    legend = plain(drawn("kinks", draw_diagram))[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["merge", "exit", "kink"]


def test_erosion_and_deposition_are_told_apart():
    """The filled pieces lie where the profile sank and where it rose."""
    run = solved("survey")
    change = run.units.height(run.u[-1]) - run.units.height(run.u[0])
    middle = plain(drawn("survey", draw_profiles))[1]
    eroded, deposited = (fill.get_paths() for fill in middle.collections)
    assert min(p.vertices[:, 1].min() for p in eroded) == pytest.approx(change.min(), rel=1e-12)
    assert max(p.vertices[:, 1].max() for p in deposited) == pytest.approx(change.max(), rel=1e-12)
    assert max(p.vertices[:, 1].max() for p in eroded) == min(p.vertices[:, 1].min() for p in deposited) == 0


def test_rounding_is_not_drawn_as_relief():
    """q of 1e-15 is a critical slope, and a colour scale of 1e-15 would show noise."""
    flat = solved("flat")
    noise = dataclasses.replace(flat, q=1e-15 * np.random.default_rng(1).standard_normal(flat.q.shape))
    norm = plain(draw_diagram(noise))[0].collections[0].norm
    assert -norm.vmin == norm.vmax > 0.01
    norm = plain(drawn("kinks", draw_diagram))[0].collections[0].norm
    assert norm.vmax == solved("kinks").q.max() and norm.vcenter == 0
