"""Pictures of a run: true files with something in them, for every kind of run; legible; kinks where they are."""

import dataclasses
import io
import xml.etree.ElementTree as ET
from functools import lru_cache
from operator import attrgetter

import numpy as np
import pytest
from legible import COLUMN, assert_legible
from matplotlib import image

import hjprofile as hj
from hjprofile.output.plots import style
from hjprofile.output.plots.runs import draw_diagram, draw_factor, draw_profiles, pictures, unresolved
from hjprofile.output.plots.study_pictures import draw_fit
from hjprofile.studies.tracing import traceable_law


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
        "steps": (hj.kinks([-3.0, -2.5], [3.0, 5.0]), 0.5, 11),
    }[name]
    if name == "survey":
        case = hj.load_case("hillslope", {"domain.cells": 520, "time.end": end, "time.snapshots": snapshots})
        return hj.solve_case(case)
    if name == "steps":
        law = hj.expression("q + q/(1+q)", growth="linear")
        return hj.track_fronts(hj.Problem(law, profile, end=end, snapshots=snapshots, title="Scene: steps"), grid)
    cfl = {"failed": 3.0, "failed at once": 6.0}.get(name, cfl)
    return hj.solve_hj(hj.Problem(law, profile, end=end, snapshots=snapshots, title=f"Scene: {name}"), grid, cfl=cfl)


SCENES = (
    "kinks", "no kinks", "one snapshot", "no time", "failed", "failed at once", "flat", "survey", "many kinks", "steps"
)  # fmt: skip
scene = pytest.mark.parametrize("name", SCENES)
draw = pytest.mark.parametrize("draw", [draw_profiles, draw_diagram, draw_factor])
drawings = pytest.mark.parametrize(
    ("name", "draw"),
    [(name, draw) for name in SCENES for draw in (draw_profiles, draw_diagram)]
    + [(name, draw_factor) for name in ("kinks", "one snapshot", "failed", "survey", "steps")],
)


def test_the_scenes_are_what_they_are_called():
    assert {name for name in SCENES if not solved(name).done} == {"failed", "failed at once"}
    assert {name for name in SCENES if not solved(name).kinks} == {"no kinks", "flat"}
    assert {name for name in SCENES if solved(name).time.size == 1} == {"one snapshot", "no time", "failed at once"}
    assert not solved("flat").q.any() and solved("survey").units
    assert len(solved("many kinks").kinks_at(0)) == 12 > style.DOTS
    assert {e.event for e in solved("steps").events} >= {"blow-up"} and solved("steps").vertical_steps


@lru_cache
def drawn(name, draw):
    figure = draw(solved(name))
    figure.canvas.draw()  # places everything
    return figure


def plain(figure):
    """The axes of a figure that are no colour bars."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def keys_of(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_files():
    files = pictures(solved("kinks"), ("png", "svg"))
    assert files.keys() == {f"{p}.{form}" for p in ("profile", "diagram", "factor", "norms") for form in ("png", "svg")}
    for file, content in files.items():
        if file.endswith(".svg"):
            texts = ["".join(element.itertext()) for element in ET.fromstring(content).iter() if "text" in element.tag]
            assert "Scene: kinks" in texts  # as text, not as outlines
            assert len(content) < 4e5
            continue
        rgb = image.imread(io.BytesIO(content))[..., :3]
        assert rgb.shape[1] == style.WIDTH * style.DPI >= 300 * COLUMN  # sharp where it is printed
        assert np.mean(rgb.min(axis=-1) == 1) > 0.1  # on white paper
        # a colour bar has some 200 colours, text and frames alone are grey
        coloured = rgb[np.ptp(rgb, axis=-1) > 0.1]
        assert np.unique((coloured * 255).astype(int) @ [65536, 256, 1]).size > 100


def test_the_same_run_gives_the_same_bytes():
    run = solved("no kinks")
    for form in ("png", "svg"):
        assert style.encode(draw_factor(run), form) == style.encode(draw_factor(run), form)


@drawings
def test_legible(name, draw):
    assert_legible(drawn(name, draw))


@drawings
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


@drawings
def test_every_axis_has_a_label(name, draw):
    figure = drawn(name, draw)
    assert len(plain(figure)) < len(figure.axes)  # there is a colour bar
    for axes in figure.axes:
        assert axes.get_ylabel()
    for axes in plain(figure):
        beside = axes.get_shared_x_axes().get_siblings(axes)
        labels = {other.get_xlabel() for other in beside} - {""}
        assert labels == {"x (m)" if name == "survey" else "x (exchange lengths; crest at 0)"}
        assert any(tick.get_text() for tick in axes.get_yticklabels())


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
        assert top.get_ylabel() == "height (m)"
        assert top.lines[0].get_ydata()[-1] == pytest.approx(run.units.height_top, rel=1e-12)  # sums over the cells


@draw
def test_what_is_poured_on_a_survey_is_a_volume_in_its_units(draw):
    """L² c end, with as many digits as there is room for; where nothing has units it is t."""
    for name in ("survey", "kinks"):
        run, figure = solved(name), drawn(name, draw)
        (axes,) = plain(figure) if draw is draw_diagram else set(figure.axes) - set(plain(figure))
        volume = 200.0**2 * 0.257 if name == "survey" else 1.0
        assert axes.get_ylim() == pytest.approx((0.0, volume * run.time[-1]), rel=1e-15)
        label = "supplied volume per width (m²)" if name == "survey" else "supplied mass t"
        assert axes.get_ylabel() == label


@draw
def test_a_unit_with_a_name_is_in_every_label(draw):
    run = solved("survey")
    figure = draw(dataclasses.replace(run, units=dataclasses.replace(run.units, unit="ft")))
    figure.canvas.draw()
    assert_legible(figure)
    labels = {text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())} - {""}
    expected = {
        draw_profiles: {
            "x (ft)", "height (ft)", "change of height\n(ft)", "excess slope q", "supplied volume per width (ft²)"
        },
        draw_diagram: {"x (ft)", "supplied volume per width (ft²)", "excess slope q"},
        draw_factor: {"x (ft)", "supplied volume per width (ft²)", "grain flux K\nrelative to the supply"},
    }[draw]  # fmt: skip
    assert labels == expected
    assert all(" ft²)" in key for key in keys_of(figure) if "area" in key)


@pytest.mark.parametrize(("length", "last"), [(0.2, "0.005"), (200.0, "5,000"), (40000.0, "2e8")])
def test_numbers_of_a_volume_have_room(length, last):
    """Kilometres, metres, and a survey in feet of a slope far larger than any."""
    run = solved("survey")
    figure = draw_diagram(dataclasses.replace(run, units=dataclasses.replace(run.units, length=length)))
    figure.canvas.draw()
    assert_legible(figure)
    assert [t.get_text() for t in plain(figure)[0].get_yticklabels()][-2:].count(last)


@drawings
def test_titles(name, draw):
    """The title stands there in full, with the method and the reason why a run stopped."""
    run = solved(name)
    title, *lines = [text.get_text() for text in drawn(name, draw).texts]
    expected = f"{run.method}, {run.cells} cells" + ("" if run.done else f" {run.status}")
    assert title == run.title and " ".join(lines) == expected


def test_long_titles_are_wrapped():
    long = " ".join(["A slope with a title that nobody will read to its end"] * 3)
    figure = draw_factor(dataclasses.replace(solved("no kinks"), title=long))
    figure.canvas.draw()
    assert_legible(figure)
    assert " ".join(t.get_text() for t in figure.texts[:-1]) == long


def points(axes, marker):
    """x and y of every marker of that kind."""
    lines = [line for line in axes.lines if line.get_marker() == marker and len(line.get_xdata())]
    return {(float(x), float(y)) for line in lines for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)}


@scene
def test_kinks_and_their_paths_are_on_the_profiles(name):
    run = solved(name)
    top, middle, bottom = plain(drawn(name, draw_profiles))
    x, u = (run.units.x(run.x), run.units.height(run.u)) if run.units else (run.x, run.u)
    scale = run.units.x if run.units else float
    profiles = [line.get_ydata() for line in top.lines if len(line.get_xdata()) == x.size]
    shown = [i for i in range(run.time.size) if any(np.array_equal(y, u[i]) for y in profiles)]
    assert {0, run.time.size - 1} <= set(shown) and len(profiles) == min(run.time.size, style.LINES)
    for axes, heights in ((top, u), (middle, u - u[0])):

        def places(index, most=None, heights=heights):
            strongest = {i: sorted(run.kinks_at(i), key=attrgetter("jump"), reverse=True)[:most] for i in index}
            seen = [(k.x, i) for i in index for k in strongest[i]]
            return {(float(scale(at)), float(np.interp(at, run.x, heights[i]))) for at, i in seen}

        assert points(axes, "o") == places(shown, most=style.DOTS)
        paths = [line for line in axes.lines if line.get_marker() == "None" and len(line.get_xdata()) != x.size]
        trail = {(float(a), float(b)) for line in paths for a, b in zip(*line.get_data(), strict=True)}
        assert trail == places(range(run.time.size)) and len(paths) == len({k.kink for k in run.kinks})
    assert not points(bottom, "o")
    assert ("kink" in keys_of(drawn(name, draw_profiles))) == bool(run.kinks)


@scene
def test_kinks_and_events_are_on_the_diagram(name):
    run = solved(name)
    (axes,) = plain(drawn(name, draw_diagram))
    scale, unit = (run.units.x, run.units.volume) if run.units else (float, 1.0)
    paths = [line for line in axes.lines if line.get_linewidth() == 1.3]
    found = {(float(x), float(t)) for line in paths for x, t in zip(line.get_xdata(), line.get_ydata(), strict=True)}
    numbers = {k.kink for k in run.kinks} | {s.step for s in run.vertical_steps or ()}
    there = [*run.kinks, *(run.vertical_steps or ()), *(e for e in run.events if e.kink in numbers)]
    assert found == {(float(scale(r.x)), unit * r.time) for r in there} and len(paths) == len(numbers)
    for line in paths:  # a line through one point is invisible
        assert len(line.get_xdata()) > 1 or line.get_marker() == "."
    for event, marker in (("birth", "o"), ("merge", "^"), ("exit", "s"), ("blow-up", "*")):
        expected = {(float(scale(e.x)), unit * e.time) for e in run.events if e.event == event}
        assert points(axes, marker) == expected
        assert (event in keys_of(drawn(name, draw_diagram))) == bool(expected)
    traced = [line for line in axes.lines if line.get_linewidth() < 0.5]
    assert bool(traced) == ("characteristic" in keys_of(drawn(name, draw_diagram))) == (run.time.size > 1)


def test_characteristics_run_into_the_kinks():
    """From both sides: one ends within six cells left of the path of each, and one right of it."""
    run = solved("kinks")
    (axes,) = plain(drawn("kinks", draw_diagram))
    ends = []
    for line in (line for line in axes.lines if line.get_linewidth() < 0.5):
        x, t = np.array(line.get_data())
        ends.append((x[np.isfinite(x)][-1], t[np.isfinite(x)][-1]))
    for number in (1, 2):
        path = np.array([(k.time, k.x) for k in run.kinks if k.kink == number]).T
        apart = np.array([x - np.interp(t, *path) for x, t in ends if path[0, 0] <= t <= path[0, -1]])
        near = 6.0 * (run.x[1] - run.x[0])
        assert np.any((-near < apart) & (apart < 0)) and np.any((apart > 0) & (apart < near))


def test_what_cannot_be_traced_is_left_out():
    case = dict(solved("kinks").case) | {"layer": {"supply_flux": 0.1}}
    run = dataclasses.replace(solved("kinks"), case=case)
    assert traceable_law(run) is None
    assert "characteristic" not in keys_of(draw_diagram(run))
    assert plain(draw_factor(run))[0].get_ylabel() == "grain flux K\nrelative to the supply"


def test_erosion_and_deposition_are_told_apart():
    """The filled pieces lie between the first and the last profile where it sank and rose; with their areas."""
    run = solved("survey")
    x, u = run.units.x(run.x), run.units.height(run.u)
    change = u[-1] - u[0]
    top, middle, _ = plain(drawn("survey", draw_profiles))
    eroded, deposited = (fill.get_paths() for fill in middle.collections)
    assert min(p.vertices[:, 1].min() for p in eroded) == pytest.approx(change.min(), rel=1e-12)
    assert max(p.vertices[:, 1].max() for p in deposited) == pytest.approx(change.max(), rel=1e-12)
    assert max(p.vertices[:, 1].max() for p in eroded) == min(p.vertices[:, 1].min() for p in deposited) == 0
    for fill, sign in zip(top.collections, (-1.0, 1.0), strict=True):
        corners = np.concatenate([p.vertices for p in fill.get_paths()])
        edges = np.array([np.interp(corners[:, 0], x, h) for h in (u[0], u[-1])])
        tolerance = 1e-6 * np.ptp(u)
        assert np.all(np.abs(edges - corners[:, 1]).min(axis=0) < tolerance)  # on one of the profiles
        assert np.all(sign * (edges[1] - edges[0]) > -tolerance)
    areas = [0.5 * np.diff(x) @ (h[1:] + h[:-1]) for h in (np.maximum(-change, 0.0), np.maximum(change, 0.0))]
    keys = [f"{word} (area {area:,.0f} m²)" for word, area in zip(("eroded", "deposited"), areas, strict=True)]
    assert keys_of(drawn("survey", draw_profiles)) == [*keys, "kink"]
    assert keys_of(drawn("flat", draw_profiles)) == []


@scene
def test_the_colour_bar_shows_the_sides_of_the_critical_slope_that_are_there(name):
    run = solved(name)
    (bar,) = set(drawn(name, draw_diagram).axes) - set(plain(drawn(name, draw_diagram)))
    low, high = bar.get_ylim()
    slight = 1e-3 * np.abs(run.q).max()
    if name != "flat":
        assert (low < 0.0, high > 0.0) == (run.q.min() < -slight, run.q.max() > slight)
    ticks = bar.get_yticks()
    assert 0.0 in ticks and (low == 0.0 or ticks.min() < 0.0) and (high == 0.0 or ticks.max() > 0.0)


def test_the_factor_is_logarithmic_where_it_spans_a_decade():
    (axes,) = plain(drawn("survey", draw_factor))
    assert np.ptp(np.log10(solved("survey").K)) > 1.0 and axes.get_yscale() == "log"
    assert plain(drawn("kinks", draw_factor))[0].get_yscale() == "linear"


def test_rounding_is_not_drawn_as_relief():
    """q of 1e-15 is a critical slope, and a colour scale of 1e-15 would show noise."""
    flat = solved("flat")
    noise = dataclasses.replace(flat, q=1e-15 * np.random.default_rng(1).standard_normal(flat.q.shape))
    norm = plain(draw_diagram(noise))[0].images[0].norm
    assert -norm.vmin == norm.vmax > 0.01
    norm = plain(drawn("kinks", draw_diagram))[0].images[0].norm
    assert norm.vmax == solved("kinks").q.max() and norm.vcenter == 0


def test_a_fit_is_legible_and_says_what_it_found():
    run = solved("survey")
    x = np.linspace(run.units.x(-12.0), run.units.x_top, 20)
    truth = np.interp(x, run.units.x(run.x), run.units.height(run.u[-1]))
    found = hj.fit("hillslope", x, truth + 0.1 * (-1.0) ** np.arange(20), ["time.end"])
    figure = draw_fit(found)
    figure.canvas.draw()
    assert_legible(figure)
    title, *lines = [text.get_text() for text in figure.texts]
    assert title == found.title and [line.split(" = ")[0] for line in lines] == ["time.end", "supplied_volume"]
    value, low, high = (float(word.strip(",").replace(",", "")) for word in np.array(lines[1].split())[[2, 3, 5]])
    assert low < found.volume.value < high and value == pytest.approx(found.volume.value, abs=0.5)
    assert len(keys_of(figure)) == 4 and all(axes.get_ylabel() for axes in figure.axes)
    assert figure.axes[-1].get_xlabel() == "x (m)"
    named = dataclasses.replace(found, case=found.case | {"profile": found.case["profile"] | {"unit": "m"}})
    labels = [axes.get_ylabel() for axes in draw_fit(named).axes]
    assert labels == ["height (m)", "change of height\n(m)", "measured - fitted\n(m)"]


def test_a_kink_that_the_grid_loses_is_marked():
    """At its last saved time; one that merges, leaves or lasts is not."""
    run = hj.solve_case(hj.load_case("hillslope", {"domain.cells": 300}))
    lost = unresolved(run)
    ended = {e.kink for e in run.events if e.event in ("merge", "exit")}
    last = {k.kink for k in run.kinks_at(-1)}
    assert lost and not lost & (ended | last)
    figure = draw_diagram(run)
    marks = [line for line in plain(figure)[0].lines if line.get_marker() == "x"]
    assert [len(line.get_xdata()) for line in marks] == [len(lost)] and "unresolved" in keys_of(figure)
    assert unresolved(solved("kinks")) == set() and "unresolved" not in keys_of(drawn("kinks", draw_diagram))


@pytest.mark.parametrize("name", ["kinks", "survey", "flat"])
def test_panels_have_letters(name):
    """Each in the corner with the fewest points of curves."""
    panels = plain(drawn(name, draw_profiles))
    assert [[text.get_text() for text in axes.texts] for axes in panels] == [["(a)"], ["(b)"], ["(c)"]]


@pytest.mark.parametrize("end", [2.5e-5, 0.0042])
def test_small_times_have_room(end):
    """On the colour bar: 2.5e-5 instead of 2.5e-05."""
    problem = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-3.0, -1.5], [0.3, 0.2]), end=end, snapshots=3)
    figure = draw_profiles(hj.solve_hj(problem, hj.Grid(-5.0, 200)))
    figure.canvas.draw()
    (bar,) = (axes for axes in figure.axes if axes.get_label() == "<colorbar>")
    assert bar.yaxis.get_label().get_window_extent().x1 <= figure.bbox.x1 + 1
    assert not any("e-0" in tick.get_text() for tick in bar.get_yticklabels())


def test_a_line_through_many_points_keeps_its_extremes():
    n = 300_003
    y = np.cumsum(np.random.default_rng(5).standard_normal(n))
    y[[1234, 77_777]] = 1e4, -1e4
    at = style.visible(y)
    assert np.all(np.diff(at) > 0) and (at[0], at[-1]) == (0, n - 1)
    assert at.size <= 4 * style.PARTS
    part = -(-n // style.PARTS)
    for first in range(0, n, part):
        whole, drawn = y[first : first + part], y[at[(at >= first) & (at < first + part)]]
        assert (drawn[0], drawn[-1]) == (whole[0], whole[-1])
        assert (drawn.min(), drawn.max()) == (whole.min(), whole.max())
    assert np.array_equal(style.visible(y[: 4 * style.PARTS]), np.arange(4 * style.PARTS))


@pytest.mark.parametrize("draw", [draw_profiles, draw_factor])
def test_the_lines_of_a_fine_grid_have_few_points(draw, monkeypatch):
    """With the extremes of the lines through all points."""
    problem = hj.Problem(hj.rational(), hj.bumps([0.8, -0.3], [-3.0, -1.5], [0.3, 0.2]), end=0.5, snapshots=3)
    run = hj.solve_hj(problem, hj.Grid(-5.0, 3000))

    def lines():
        return [line.get_ydata() for axes in draw(run).axes for line in axes.lines if len(line.get_ydata()) > 100]

    whole = lines()
    monkeypatch.setattr(style, "PARTS", 100)
    few = lines()
    assert len(few) == len(whole) >= 3
    for y, of_all in zip(few, whole, strict=True):
        assert len(of_all) >= 3000 and len(y) <= 400
        assert (y[0], y[-1], y.min(), y.max()) == (of_all[0], of_all[-1], of_all.min(), of_all.max())
