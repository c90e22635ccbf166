"""Pictures of a run: its profiles, q over the (x, t) plane, its grain flux."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hjprofile.output.plots import style
from hjprofile.output.plots.norm_panels import draw_norms
from hjprofile.output.plots.style import (
    DEPOSITED,
    DOT,
    ERODED,
    EXCESS,
    INK,
    amount,
    axes_units,
    change_of,
    span,
    styled,
)
from hjprofile.solvers.run import Array, Run
from hjprofile.studies.tracing import kink_paths, slope_between, trace_back, traceable_law

RASTER = 420, 640  # numbers of times and positions at which the (x, t) plane is coloured
TRACED = 14, 8  # numbers of characteristics that end at the last time and at the crest
LEAST_CHANGE = 1e-9  # relative to the relief; smaller changes are rounding


def pictures(
    run: Run, forms: Iterable[str] = ("png",), names: Iterable[str] = ("profile", "diagram", "factor", "norms")
) -> dict[str, bytes | str]:
    """Return name -> file of these pictures of a run, in each form: "png" or "svg"."""
    draw = {"profile": draw_profiles, "diagram": draw_diagram, "factor": draw_factor, "norms": draw_norms}
    drawings = {name: draw[name](run) for name in names}
    return {f"{name}.{form}": style.encode(figure, form) for name, figure in drawings.items() for form in forms}


@styled
def draw_profiles(run: Run) -> Figure:
    """Draw the profiles with erosion, deposition and kinks; the change of height; q."""
    x, u, x_label, u_label = axes_units(run, run.units)
    keys = _keys_of_change(u[-1], u[0], x, f" {run.units.label}²" if run.units else "") + [_KINK] * bool(run.kinks)
    changed = run.surveyed is not None and not np.array_equal(run.surveyed.height, run.surveyed.used)
    keys += [_MEASURED] * changed
    rows = -(-len(keys) // (2 if run.units else 3))
    figure = style.sheet(run.title, style.about(run), rows, 4.9)
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    shown, colour = style.shown_times(run)
    cells = run.units.x(run.x_cell) if run.units else run.x_cell
    drawn = style.visible(u[0], u[-1], u[-1] - u[0])
    _shade(top, x[drawn], u[0, drawn], u[-1, drawn])
    _shade(middle, x[drawn], 0.0, u[-1, drawn] - u[0, drawn])
    for i in shown:
        style.draw_line(top, x, u[i], color=colour(i), lw=0.9)
        style.draw_line(middle, x, u[i] - u[0], color=colour(i), lw=0.9)
        style.draw_line(bottom, cells, run.q[i], color=colour(i), lw=0.9)
    for axes, heights in ((top, u), (middle, u - u[0])):
        for at, height, _ in style.kinks_on(run, x, heights):
            axes.plot(at, height, color=INK, lw=0.6, zorder=2.5)
        for i in shown:
            axes.plot(*style.dots_on(run, i, x, heights[i]), **DOT, ls="none", zorder=3)
    if run.surveyed is not None and changed:
        top.plot(run.surveyed.x, run.surveyed.height, **_POINT, zorder=3.5)
    style.legend_above(figure, keys, max(rows, 1))
    top.set_ylabel(u_label)
    middle.set_ylabel(style.of_height("change of height", run.units))
    style.axis_of_q(bottom, run)
    style.axis_of_x(bottom, x, x_label)
    style.letter_panels([top, middle, bottom])
    figure.align_ylabels([top, middle, bottom])
    style.bar_of_times(figure, run)
    return figure


_POINT: dict[str, Any] = {"ls": "none", "marker": ".", "ms": 2.0, "mec": "none", "color": "0.35"}
_MEASURED = Line2D([], [], label="survey as measured", **_POINT | {"ms": 5.0})
_KINK = Line2D([], [], color=INK, lw=0.6, label="kink", **DOT)


def _keys_of_change(u: Array, first: Array, x: Array, unit: str) -> list[Any]:
    """Return the keys of a legend for erosion and deposition."""
    eroded, deposited = change_of(u, first, x)
    least = LEAST_CHANGE * float(np.ptp(first) * np.ptp(x))
    parts = ((ERODED, "eroded", eroded), (DEPOSITED, "deposited", deposited))
    return [Patch(fc=c, alpha=0.4, label=f"{name} (area {amount(a)}{unit})") for c, name, a in parts if a > least]


def _shade(axes: Axes, x: Array, before: Array | float, after: Array) -> list[Any]:
    """Fill the area between two profiles by erosion and deposition."""
    return [
        axes.fill_between(x, before, after, where=where, interpolate=True, color=colour, alpha=0.4, lw=0, zorder=1)
        for where, colour in ((after < before, ERODED), (after > before, DEPOSITED))
    ]


@styled
def draw_diagram(run: Run) -> Figure:
    """Draw q over the (x, t) plane with the paths of the kinks, their births, merges and exits, and characteristics."""
    traced = characteristics(run)
    keys = keys_of_diagram(run, traced is not None)
    rows = -(-len(keys) // 5)
    figure = style.sheet(run.title, style.about(run), rows, 3.1)
    sheet = diagram_on(figure.subplots(), run, traced)
    ticks_of_q(style.bar_of(figure, sheet, "excess slope q"), run)
    style.legend_above(figure, keys, rows)
    return figure


def diagram_on(axes: Axes, run: Run, traced: Array | None) -> AxesImage:
    """Draw q over the (x, t) plane, kinks, events and the characteristics `traced`; return the image of q.

    `slope_between` gives q between saved times.
    """
    x, _, x_label, _ = axes_units(run, run.units)
    scale = run.units.x if run.units else np.asarray
    unit, t_label, numbers = style.axis_of_time(run.time, run.units)
    (first, last), norm = span(run.time), _norm_of_q(run)
    times, places = (a + (b - a) * (np.arange(n) + 0.5) / n for (a, b), n in zip(
        ((first, last), (run.x[0], run.x[-1])), RASTER, strict=True
    ))  # fmt: skip
    sheet = axes.imshow(
        slope_between(run, times, places), cmap=EXCESS, norm=norm, origin="lower", aspect="auto",
        extent=(x[0], x[-1], unit * first, unit * last), interpolation="nearest",
    )  # fmt: skip
    if run.time.size == 1:
        axes.set_yticks([unit * float(run.time[0])])
    if traced is not None:
        axes.plot(scale(traced), unit * run.time, color=INK, lw=0.45, alpha=0.55)
    steps = {s.step for s in run.vertical_steps or ()}
    for number, path in kink_paths(run).items():
        dot = "." if path.x.size == 1 else None  # a line through one point is invisible
        axes.plot(scale(path.x), unit * path.time, color=INK, lw=1.3, marker=dot, solid_capstyle="round")
        if number in steps:
            after = np.isin(path.time, [s.time for s in run.vertical_steps or () if s.step == number])
            axes.plot(scale(path.x[after]), unit * path.time[after], color=INK, lw=2.6, marker=dot)
    for kind, marker in _EVENTS.items():
        marks = [e for e in run.events if e.event == kind]
        if marks:
            at = scale(np.array([e.x for e in marks]))
            axes.plot(at, [unit * e.time for e in marks], **marker, clip_on=False, zorder=3)
    lost = [path for number, path in kink_paths(run).items() if number in unresolved(run)]
    if lost:
        ends = scale(np.array([path.x[-1] for path in lost])), [unit * path.time[-1] for path in lost]
        axes.plot(*ends, **_UNRESOLVED, clip_on=False, zorder=3)
    axes.set_ylabel(t_label)
    axes.yaxis.set_major_formatter(numbers)
    style.axis_of_x(axes, x, x_label)
    axes.set_ylim(unit * first, unit * last)
    return sheet


def ticks_of_q(bar: Axes, run: Run) -> None:
    """Format the axis of a colour bar of q, over the range that the run needs."""
    least, most = _ends_of_q(run, _norm_of_q(run))
    many = 4 if least < 0.0 < most else 8
    bar.set_yticks(np.unique([*style.round_numbers(least, 0.0, many), *style.round_numbers(0.0, most, many)]))
    bar.yaxis.set_major_formatter(lambda q, _: f"{q:g}".replace("-", "−"))
    bar.set_ylim(least, most)


_MARK: dict[str, Any] = {"ls": "none", "ms": 4.5, "mfc": "white", "mec": INK, "mew": 0.8}
_EVENTS: dict[str, dict[str, Any]] = {
    "birth": _MARK | {"marker": "o"},
    "blow-up": _MARK | {"marker": "*", "ms": 8.0},
    "merge": _MARK | {"marker": "^"},
    "exit": _MARK | {"marker": "s"},
}
_UNRESOLVED: dict[str, Any] = {"ls": "none", "marker": "x", "ms": 4.5, "mec": INK, "mew": 1.0}


def keys_of_diagram(run: Run, traced: bool) -> list[Any]:
    """Return the keys of a legend for the diagram."""
    lines = ((run.kinks, 1.3, "kink"), (run.vertical_steps, 2.6, "vertical step"), (traced, 0.45, "characteristic"))
    keys = [Line2D([], [], color=INK, lw=width, label=label) for there, width, label in lines if there]
    there = {e.event for e in run.events}
    keys += [Line2D([], [], label=k, **m) for k, m in _EVENTS.items() if k in there]
    return keys + [Line2D([], [], label="unresolved", **_UNRESOLVED)] * bool(unresolved(run))


def unresolved(run: Run) -> set[int]:
    """Return the numbers of the kinks that end before the last time without an event."""
    ended = {e.kink for e in run.events if e.event != "birth"}
    last = {number: path.time[-1] for number, path in kink_paths(run).items()}
    return {number for number, time in last.items() if time < run.time[-1] and number not in ended}


def _norm_of_q(run: Run) -> TwoSlopeNorm:
    """Return a colour scale about q = 0 that resolves both signs."""
    low, high = float(run.q.min()), float(run.q.max())
    if run.vertical_steps:  # q is unbounded at a jump of the profile
        high = max(float(np.quantile(run.q, 0.98)), 0.0)
    wide = max(-low, high)
    if wide < 1e-9:  # a neutral slope: rounding must not look like relief
        wide = 1.0
    return TwoSlopeNorm(0.0, min(low, -0.05 * wide), max(high, 0.05 * wide))


def _ends_of_q(run: Run, norm: TwoSlopeNorm) -> tuple[float, float]:
    """Return the range of the colour scale that a run needs: both signs of q, or one."""
    slight = 1e-3 * float(np.abs(run.q).max())
    steep, gentle = run.q.max() > slight, run.q.min() < -slight
    return (
        float(norm.vmin or 0.0) if gentle or not steep else 0.0,
        float(norm.vmax or 0.0) if steep or not gentle else 0.0,
    )


def characteristics(run: Run) -> Array | None:
    """Return positions at the saved times, shape (times, lines), of the characteristics that are drawn; None for none.

    There are none if K and q do not determine them (`traceable_law`).

    Choose those that end evenly spread at the last time and at the crest, and those that run into kinks from both
    sides.
    """
    law = traceable_law(run) if run.time.size > 1 else None
    if law is None:
        return None
    last, width = run.time.size - 1, float(np.ptp(run.x))
    ends = [(last, float(run.x[0] + width * (j + 0.5) / TRACED[0])) for j in range(TRACED[0])]
    ends += [(int(i), float(run.x[-1])) for i in style.spread(last + 1, TRACED[1])[1:]]
    aside = 4.0 * width / run.cells  # a method on a grid spreads a kink over some cells
    for path in kink_paths(run).values():
        lasts = (path.time[-1] - path.time[0]) / (run.time[-1] - run.time[0])
        index = np.flatnonzero(np.isin(run.time, path.time))
        for i in index[style.spread(index.size, max(round(4.0 * lasts), 1) + 1)[1:]]:
            at = float(np.interp(run.time[i], path.time, path.x))
            ends += [(int(i), at - aside), (int(i), min(at + aside, float(run.x[-1])))]
    return trace_back(run, law, ends)


@styled
def draw_factor(run: Run) -> Figure:
    """Draw the grain flux K along the slope over time; logarithmic if it spans a decade."""
    figure = style.sheet(run.title, style.about(run), bool(run.kinks), 2.3)
    axes = figure.subplots()
    flux_on(axes, run)
    style.legend_above(figure, [kinks_key()] * bool(run.kinks))
    style.bar_of_times(figure, run)
    return figure


def kinks_key() -> Line2D:
    """Return the key of a legend for the dots of kinks."""
    return Line2D([], [], ls="none", label="kink", **DOT)


def curves_on(axes: Axes, run: Run, values: Array) -> None:
    """Draw curves over x at the shown times, shape (times, cells + 1), with the kinks; the curves are labelled."""
    x, _, x_label, _ = axes_units(run, run.units)
    shown, colour = style.shown_times(run)
    unit, _, numbers = style.axis_of_time(run.time, run.units)
    for i in shown:
        style.draw_line(axes, x, values[i], color=colour(i), lw=0.9, label=numbers(unit * float(run.time[i]), 0.0))
        axes.plot(*style.dots_on(run, i, x, values[i]), **DOT, ls="none", zorder=3)
    style.axis_of_x(axes, x, x_label)


def flux_on(axes: Axes, run: Run) -> None:
    """Draw K at the shown times; logarithmic if it spans a decade."""
    curves_on(axes, run, run.K)
    if run.K.max() > 10.0 * run.K.min():
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis)
    axes.axhline(1.0, color="0.6", lw=0.6, zorder=0)
    axes.set_ylabel(_FLUXES["coefficient" if "coefficient" in run.case else ""])


_FLUX = "grain flux K\nrelative to the supply"
_FLUXES: dict[str, str] = {"coefficient": "coefficient k", "": _FLUX}
