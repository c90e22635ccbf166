"""Pictures of the study of statements: values under their bounds, and the invariant along characteristics."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from hjprofile.output.plots import style
from hjprofile.output.plots.style import new_figure, png
from hjprofile.solvers.run import Array
from hjprofile.studies.characteristic_statements import Characteristics
from hjprofile.studies.statements import Statements

COLUMNS = 4  # panels in a row
VALUE, BOUND, VIOLATED = "#0072B2", "0.45", "#D55E00"
TITLE = 44  # largest number of characters in a line of the title of a panel
TOO_LARGE = 1e6  # ratio to the largest value above which a bound is not drawn
LOGARITHMIC = 50.0  # ratio of the largest to the smallest positive number above which an axis is logarithmic
LOWEST = 1e-6  # fraction of the largest number at which a logarithmic axis begins; q that has left is smaller still


@style.defaults
def statements_picture(case: str, found: Statements) -> bytes:
    """Return the PNG of `draw_statements`."""
    return png(draw_statements(case, found))


@style.defaults
def draw_statements(case: str, found: Statements) -> Figure:
    """Draw a panel for each statement that applies: the value and its bound over time."""
    shown = [result for result in found.results if result.applies]
    rows = -(-len(shown) // COLUMNS)
    height = 2.2 * rows + 0.9
    figure = Figure(figsize=(12.0, height))  # fixed margins, because a computation of them takes seconds
    FigureCanvasAgg(figure)
    figure.subplots_adjust(0.045, 0.45 / height, 0.985, 1.0 - 0.85 / height, 0.22, 0.6)
    panels = figure.subplots(rows, COLUMNS, squeeze=False).flat
    for result, axes in zip(shown, panels, strict=False):
        mine = [row for row in found.rows if row.statement == result.statement]
        t, value, bound = np.array([(row.time, row.value, row.bound) for row in mine]).T
        bound[bound > TOO_LARGE * np.abs(value).max()] = np.nan
        marker = "." if t.size == 1 else ""
        axes.plot(t, bound, color=BOUND, lw=1.2, ls="--", marker=marker, label="bound")
        axes.plot(t, value, color=VALUE, lw=1.2, marker=marker, label="value")
        bad = np.array([not row.holds for row in mine])
        axes.plot(t[bad], value[bad], "x", color=VIOLATED, ms=4)
        positive = np.concatenate([value, bound])
        positive = positive[positive > 0.0]  # excludes NaN
        if positive.size and positive.max() > LOGARITHMIC * positive.min():
            axes.set_yscale("log")
            axes.set_ylim(max(0.5 * positive.min(), LOWEST * positive.max()), 2.0 * positive.max())
            axes.yaxis.set_minor_locator(NullLocator())
        title = textwrap.fill(f"{result.equation}  {result.words}", TITLE)
        axes.set_title(title, loc="left", fontsize=7, linespacing=1.0)
        if not result.holds:
            axes.title.set_color(VIOLATED)
        axes.tick_params(labelsize=7)
        axes.xaxis.get_offset_text().set_fontsize(7)
        axes.grid(alpha=0.25, lw=0.5)
    for axes in list(panels):
        axes.set_axis_off()
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", fontsize=8, frameon=False, ncols=2)
    figure.supxlabel("supplied mass t", fontsize=9, y=0.1 / height)
    title = f"Statements of the source paper: {case}"
    figure.suptitle(title, fontsize=12, x=0.01, y=1.0 - 0.1 / height, ha="left", va="top", parse_math=False)
    return figure


@style.defaults
def invariant_picture(case: str, found: Characteristics) -> bytes:
    """Return the PNG of `draw_invariant`."""
    return png(draw_invariant(case, found))


@style.defaults
def draw_invariant(case: str, found: Characteristics) -> Figure:
    """Draw characteristics in the (x, t) plane, coloured by I, with the kinks; and I along each of them over time."""
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    I, x = found.values.I, found.values.x
    known = I[np.isfinite(I)]
    norm, colours = Normalize(float(known.min()), float(known.max())), colormaps["viridis"]
    for c in range(x.shape[1]):
        mine = np.isfinite(x[:, c])
        at, t, value = x[mine, c], found.time[mine], I[mine, c]
        if at.size < 2:
            continue
        left.add_collection(_coloured(at, t, value, norm))
        right.plot(t, value, color=colours(norm(float(value[-1]))), lw=1.2)
    for number, path in found.kinks.items():
        left.plot(path.x, path.time, color="0.15", lw=0.9, label="_" if number != min(found.kinks) else "kinks")
    left.set(xlabel="x (exchange lengths; crest at 0)", ylabel="supplied mass t")
    left.margins(x=0.02, y=0.0)
    left.set_ylim(0.0, float(found.time[-1]))
    left.set_title("(a) characteristics, coloured by I = W + R(q)", loc="left", fontsize=10)
    if found.kinks:
        left.legend(fontsize=8, frameon=False, loc="upper left")
    right.set(xlabel="supplied mass t", ylabel="I = W + R(q)")
    right.set_title("(b) I along each characteristic", loc="left", fontsize=10)
    right.grid(alpha=0.25, lw=0.5)
    figure.colorbar(ScalarMappable(norm, "viridis"), ax=right, label="I")
    figure.suptitle(f"The invariant: {case}", fontsize=12, x=0.01, ha="left", parse_math=False)
    return figure


def _coloured(x: Array, t: Array, value: Array, norm: Normalize) -> LineCollection:
    """Return a curve in the (x, t) plane whose colour follows a value."""
    points = np.column_stack([x, t])
    pieces = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", norm=norm, lw=1.2)
    pieces.set_array(0.5 * (value[1:] + value[:-1]))
    return pieces
