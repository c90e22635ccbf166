"""The style of all pictures: paper, letters, colours, axes with their units, and image files.

Pictures of runs are WIDTH inches wide with letters of FONT points; in a journal's column (85 mm) no letter is below
6 points.
"""

from __future__ import annotations

import io
import logging
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib import colormaps, rcParams, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullFormatter

from hjprofile.problem.units import UNNAMED, Units
from hjprofile.solvers.run import Array, Run

WIDTH, FONT, DPI = 5.0, 9.0, 216  # inches, points, dots per inch: 323 of these in a column of 85 mm
TITLE, LINE = 10.5, 0.17  # points; inches from one line of text to the next
TOO_LONG = 46, 66  # largest number of characters of a title and of a line below it
LEFT = 0.92  # left margin in inches
LINES = 7  # number of profiles that are drawn; more would hide each other
PARTS = 4096  # of a line through many points: pictures are at most 3000 pixels wide
DOTS = 7  # number of kinks with a dot, the strongest: every point of a noisy survey can be a kink

# Okabe and Ito's colours, distinguishable without red and green
ERODED, DEPOSITED = "#D55E00", "#0072B2"
TWO_RUNS = "#0072B2", "#E69F00"
INK, PALE = "#1a1a1a", "0.45"
CORNERS = (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.0, 0.0)  # of a panel, in the order of preference
DOT: dict[str, Any] = {"marker": "o", "ms": 2.6, "mfc": "white", "mec": INK, "mew": 0.6}  # a kink
EXCESS = "RdBu_r"  # of q: red for erosion, blue for deposition
TIMES: Colormap = LinearSegmentedColormap.from_list("times", colormaps["viridis"](np.linspace(0.0, 0.88, 256)))

_LETTERS: Any = {
    "font.family": "DejaVu Sans",
    "font.size": FONT,
    "axes.titlesize": FONT,
    "axes.labelsize": FONT,
    "xtick.labelsize": FONT,
    "ytick.labelsize": FONT,
    "legend.fontsize": FONT,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "svg.fonttype": "none",  # text stays text, which can be searched and edited
    "svg.hashsalt": "hjprofile",  # a fixed salt, so that names inside the file do not change
    "text.parse_math": False,  # a title with two $ is not a formula
}
_DEFAULTS: Any = {name: value for name, value in rcParamsDefault.items() if name != "backend"}
_DRAWING = threading.RLock()  # matplotlib has one set of parameters for the whole process


@contextmanager
def _settings(own: Any) -> Iterator[None]:
    """Draw with matplotlib's defaults and these settings, and leave the parameters of the user exactly as they were."""
    logger = logging.getLogger("matplotlib")
    with _DRAWING, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)  # the character is drawn as a box
        users: Any = {name: value for name, value in rcParams.copy().items() if name != "backend"}
        level = logger.level
        try:
            logger.setLevel(logging.ERROR)
            dict.update(rcParams, _DEFAULTS)
            rcParams.update(own)
            yield
        finally:
            dict.update(rcParams, users)
            logger.setLevel(level)


styled = _settings(_LETTERS)  # decorator of functions that draw pictures of runs
defaults = _settings({})  # decorator of functions that draw pictures of studies


def png(figure: Figure, dpi: int = 150) -> bytes:
    """Return the figure as a PNG."""
    buffer = io.BytesIO()
    # 1 % larger files than by default, in two thirds of the time
    figure.savefig(buffer, format="png", dpi=dpi, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def visible(*rows: Array) -> Array:
    """Return the indices of the points that draw the same lines as all points: all of them, or a few of each part.

    These are the ends of each of PARTS parts, and the largest and the smallest value of each row there.
    """
    n = rows[0].size
    if n <= 4 * PARTS:
        return np.arange(n)
    part = -(-n // PARTS)
    first = np.arange(0, n, part)
    found = [first, first + part - 1]
    for row in rows:
        parts = np.pad(row, (0, -n % part), mode="edge").reshape(-1, part)
        found += [first + parts.argmin(axis=1), first + parts.argmax(axis=1)]
    return np.unique(np.minimum(np.concatenate(found), n - 1))


def draw_line(axes: Axes, x: Array, y: Array, **look: Any) -> list[Line2D]:
    """Draw the line through the points (x, y)."""
    at = visible(y)
    return axes.plot(x[at], y[at], **look)


@styled
def encode(figure: Figure, form: str) -> bytes:
    """Return the figure as a "png" with the resolution of print, or as an "svg"; the same bytes each time."""
    if form == "png":
        return png(figure, DPI)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=DPI, metadata={"Date": None})
    return buffer.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, in inches, with automatic margins."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def sheet(title: str, lines: Sequence[str], keys: int, height: float, right: float = 0.92) -> Figure:
    """Return a figure for axes of `height` inches, below a title, lines of text and rows of keys of a legend.

    The margins are fixed, because a computation of them would cost as much as the drawing.
    """
    titles = textwrap.wrap(title, TOO_LONG[0])
    lines = [part for line in lines for part in textwrap.wrap(line, TOO_LONG[1])]
    head = 0.08 + 1.1 * LINE * len(titles) + LINE * len(lines) + 1.15 * LINE * keys + 0.09
    total = head + height + 0.46
    figure = Figure(figsize=(WIDTH, total))
    FigureCanvasAgg(figure)
    figure.subplots_adjust(LEFT / WIDTH, 0.46 / total, 1.0 - right / WIDTH, 1.0 - head / total, 0.08, 0.1)
    y = total - 0.08
    for text in titles:
        figure.text(0.08 / WIDTH, y / total, text, fontsize=TITLE, fontweight="bold", va="top")
        y -= 1.1 * LINE
    for text in lines:
        figure.text(0.08 / WIDTH, y / total, text, color=PALE, va="top")
        y -= LINE
    return figure


def legend_above(figure: Figure, handles: Sequence[Any], rows: int = 1) -> None:
    """Add a legend between the text and the axes."""
    if handles:
        place = 0.08 / WIDTH, figure.subplotpars.top + 0.03 / figure.get_figheight()
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=place,
            ncols=-(-len(handles) // rows), frameon=False, borderaxespad=0.3, borderpad=0.0, columnspacing=1.1,
            handlelength=1.5, handletextpad=0.5, labelspacing=0.3,
        )  # fmt: skip


def plain_numbers(axis: Axis) -> None:
    """Write the numbers of a logarithmic axis in full, because the exponents of powers of ten would be too small to
    read.
    """

    def written(v: float, _: float) -> str:
        return f"{v:g}" if v <= 0.0 or 1e-3 <= v <= 1e4 else f"{v:.0e}".replace("e-0", "e-").replace("e+0", "e")

    axis.set_major_formatter(written)
    axis.set_minor_formatter(NullFormatter())


def letter_panels(panels: Sequence[Axes]) -> None:
    """Write (a), (b), ... into the emptiest corners of panels, whose lines are drawn and whose limits are set."""
    for letter, axes in zip("abcdefgh", panels, strict=False):
        curves = [np.column_stack(np.broadcast_arrays(*line.get_data())).astype(float) for line in axes.lines]
        at = axes.transAxes.inverted().transform(axes.transData.transform(np.concatenate([np.empty((0, 2)), *curves])))

        def crowd(corner: tuple[float, float], at: Array = at) -> int:
            return int(np.count_nonzero(np.all(np.abs(at - corner) < (0.1, 0.25), axis=1)))

        x, y = min(CORNERS, key=crowd)
        axes.annotate(
            f"({letter})", (x, y), xycoords="axes fraction", xytext=(4.0 - 8.0 * x, 4.0 - 8.0 * y),
            textcoords="offset points", ha="right" if x else "left", va="top" if y else "bottom", fontweight="bold",
        )  # fmt: skip


def of_height(words: str, units: Units | None) -> str:
    """Return the label of an axis of heights or their differences, in two lines if it has a unit."""
    return f"{words}\n({units.label})" if units else words


def about(run: Run) -> list[str]:
    """Return the lines below the title: the method, and the reason if a run stopped early."""
    return [f"{run.method}, {run.cells} cells", *([] if run.done else [run.status])]


def axes_units(run: Run, units: Units | None) -> tuple[Array, Array, str, str]:
    """Return x and u in the survey's units if there is one, and the labels of the axes."""
    if units:
        return units.x(run.x), units.height(run.u), *labels_of(units)
    crest = "" if run.x[-1] else "; crest at 0"
    return run.x, run.u, f"x (exchange lengths{crest})", "height u"


def labels_of(units: Units) -> tuple[str, str]:
    """Return the labels of the axes of position and height of a survey."""
    return f"x ({units.label})", f"height ({units.label})"


def axis_of_x(axes: Axes, x: Array, label: str) -> None:
    """Format the axis along the slope."""
    axes.set_xlabel(label)
    axes.set_xlim(min(x[0], x[-1]), max(x[0], x[-1]))  # a survey may rise to the left
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def axis_of_q(axes: Axes, run: Run) -> None:
    """Format the axis of q; logarithmic if the profile breaks into vertical steps."""
    axes.set_ylabel("excess slope q")
    axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    if run.vertical_steps:  # q is unbounded at a jump of the profile, and smaller values should stay visible
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_ylim(bottom=min(float(run.q.min()), 0.0) - 0.1)
        plain_numbers(axes.yaxis)


def span(time: Array) -> tuple[float, float]:
    """Return the first and the last time of an axis; widen a single time."""
    first, last = float(time[0]), float(time[-1])
    return (first, last) if last > first else (first - 0.5, first + 0.5)


def axis_of_time(time: Array, units: Units | None) -> tuple[float, str, Callable[[float, float], str]]:
    """Return the size of one unit of t on an axis, the label of that axis and the formatter of its numbers.

    For a survey it is the supplied volume per unit width, in the survey's units.
    """
    unit = units.volume if units else 1.0
    many = unit * float(time[-1]) >= 1e5  # so many digits do not fit
    label = "supplied mass t"
    if units:
        label = f"supplied volume per width ({units.unit}²)" if units.unit else f"supplied, per width ({UNNAMED}²)"
    return unit, label, lambda v, _: (f"{v:.3g}" if many else f"{v:,g}").replace("e+0", "e").replace("e-0", "e-")


def shown_times(run: Run) -> tuple[Array, Callable[[int], Any]]:
    """Return the saved times that are drawn, and the colour of each."""
    norm = Normalize(*span(run.time))
    return spread(run.time.size, LINES), lambda i: TIMES(norm(run.time[i]))


def spread(size: int, most: int) -> Array:
    """Return at most so many numbers from 0 to size - 1, evenly spread, both ends included."""
    return np.unique(np.linspace(0, size - 1, most).round().astype(int))


def bar_of(figure: Figure, mappable: ScalarMappable, label: str, bottom: float | None = None) -> Axes:
    """Add a colour bar to the right of the axes, as high as they are or down to `bottom`, a fraction of the figure's
    height.
    """
    edges, width = figure.subplotpars, 0.12 / WIDTH
    foot = edges.bottom if bottom is None else bottom
    place = (edges.right + 0.6 * width, foot, width, edges.top - foot)
    axes = figure.add_axes(place, label="<colorbar>")
    figure.colorbar(mappable, cax=axes, ticks=MaxNLocator(9, steps=[1, 2, 5, 10])).set_label(label)  # few digits
    return axes


def round_numbers(low: float, high: float, most: int) -> list[float]:
    """Return at most so many numbers of few digits, evenly spaced, from `low` to `high`."""
    return [float(v) for v in MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high) if low <= v <= high]


def bar_of_times(figure: Figure, run: Run) -> None:
    """Add the colour bar of `shown_times`."""
    unit, label, numbers = axis_of_time(run.time, run.units)
    axes = bar_of(figure, ScalarMappable(Normalize(*span(unit * run.time)), TIMES), label)
    axes.yaxis.set_major_formatter(numbers)
    if run.time.size == 1:
        axes.set_yticks([unit * float(run.time[0])])


def kinks_on(run: Run, x: Array, heights: Array) -> list[tuple[Array, Array, Array]]:
    """Return positions, heights and indices of the saved times of each kink on curves, shape (times, x.size)."""
    scale = run.units.x if run.units else np.asarray
    found = []
    for number in sorted({k.kink for k in run.kinks}):
        mine = [k for k in run.kinks if k.kink == number]
        index = np.searchsorted(run.time, [k.time for k in mine])
        at = np.array([k.x for k in mine])
        on = np.array([np.interp(a, run.x, heights[i]) for a, i in zip(at, index, strict=True)])
        found.append((scale(at), on, index))
    return found


def dots_on(run: Run, i: int, x: Array, heights: Array) -> tuple[Array, Array]:
    """Return positions and heights of the DOTS strongest kinks at a saved time, on a curve, shape (x.size,)."""
    strongest = sorted(run.kinks_at(i), key=lambda kink: kink.jump)[-DOTS:]
    at = np.array([kink.x for kink in strongest])
    return run.units.x(at) if run.units else at, np.interp(at, run.x, heights)


def change_of(u: Array, first: Array, x: Array) -> tuple[float, float]:
    """Return the areas between two profiles: where the later one lies below the first (eroded) and above it
    (deposited).
    """
    eroded, deposited = np.maximum(first - u, 0.0), np.maximum(u - first, 0.0)
    return tuple(float(0.5 * np.abs(np.diff(x)) @ (h[1:] + h[:-1])) for h in (eroded, deposited))  # type: ignore[return-value]


def amount(value: float) -> str:
    """Format a positive number with few digits, without an exponent if possible."""
    return f"{value:,.0f}" if 1000.0 <= value < 1e7 else f"{value:.3g}"
