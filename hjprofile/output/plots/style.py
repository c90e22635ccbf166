"""What all pictures share: paper, letters, colours, axes in their units, and files made of them.

Pictures of runs are WIDTH wide in letters of FONT points: in a journal's column (85 mm) no letter is below 6 points.
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
from matplotlib.ticker import MaxNLocator, NullFormatter

from hjprofile.problem.units import Units
from hjprofile.solvers.run import Array, Run

WIDTH, FONT, DPI = 5.0, 9.0, 216  # inches, points, dots per inch: 323 of these in a column of 85 mm
TITLE, LINE = 10.5, 0.17  # points; inches from one line of text to the next
TOO_LONG = 46, 66  # characters of a title and of a line below it that a sheet has no room for
LEFT = 0.8  # inches left of the axes
LINES = 7  # profiles that are drawn; more hide each other
DOTS = 7  # kinks that have a dot on each of them, the strongest: every point of a noisy survey can be one

# Okabe and Ito's colours, which can be told apart without red and green
ERODED, DEPOSITED = "#D55E00", "#0072B2"
TWO_RUNS = "#0072B2", "#E69F00"
INK, PALE = "#1a1a1a", "0.45"
DOT: dict[str, Any] = {"marker": "o", "ms": 2.6, "mfc": "white", "mec": INK, "mew": 0.6}  # a kink
EXCESS = "RdBu_r"  # of q: red erodes, blue settles
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
    "svg.fonttype": "none",  # text remains text, to be found and edited
    "svg.hashsalt": "hjprofile",  # else names inside the file change from run to run
    "text.parse_math": False,  # a title with two $ is no formula
}
_DEFAULTS: Any = {name: value for name, value in rcParamsDefault.items() if name != "backend"}
_DRAWING = threading.RLock()  # matplotlib has one set of parameters for the whole process


@contextmanager
def _settings(own: Any) -> Iterator[None]:
    """Draw with matplotlib's defaults and these settings, and leave the user's parameters exactly as they were."""
    logger = logging.getLogger("matplotlib")
    with _DRAWING, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)  # the letter is drawn as a box
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


styled = _settings(_LETTERS)  # decorates functions that draw pictures of runs
defaults = _settings({})  # ... and of studies


def png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


@styled
def encode(figure: Figure, form: str) -> bytes:
    """The figure as a "png" that is sharp in print, or an "svg"; the same bytes each time."""
    if form == "png":
        return png(figure, DPI)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=DPI, metadata={"Date": None})
    return buffer.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches, that finds its own margins."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def sheet(title: str, lines: Sequence[str], keys: int, height: float, right: float = 0.92) -> Figure:
    """A figure for axes of `height` inches, below a title, lines of text and rows of keys of a legend.

    Margins are given: to find them out would cost as much as the drawing.
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
    """A legend between the text and the axes, where it hides nothing."""
    if handles:
        place = 0.08 / WIDTH, figure.subplotpars.top + 0.03 / figure.get_figheight()
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=place,
            ncols=-(-len(handles) // rows), frameon=False, borderaxespad=0.3, borderpad=0.0, columnspacing=1.1,
            handlelength=1.5, handletextpad=0.5, labelspacing=0.3,
        )  # fmt: skip


def plain_numbers(axis: Axis) -> None:
    """Numbers on a logarithmic axis written out: the exponents of powers of ten would be too small to read."""

    def written(v: float, _: float) -> str:
        return f"{v:g}" if v <= 0.0 or 1e-3 <= v <= 1e4 else f"{v:.0e}".replace("e-0", "e-").replace("e+0", "e")

    axis.set_major_formatter(written)
    axis.set_minor_formatter(NullFormatter())


def about(run: Run) -> list[str]:
    """What stands below the title: the method, and why a run stopped early."""
    return [f"{run.method}, {run.cells} cells", *([] if run.done else [run.status])]


def axes_units(run: Run, units: Units | None) -> tuple[Array, Array, str, str]:
    """x, u in the survey's units if there is one, with labels of the axes."""
    if units:
        return units.x(run.x), units.height(run.u), "x (units of the survey)", "height (survey)"
    top = "" if run.x[-1] else "; the top is at 0"
    return run.x, run.u, f"x (in exchange lengths{top})", "height u"


def axis_of_x(axes: Axes, x: Array, label: str) -> None:
    """The axis along the slope."""
    axes.set_xlabel(label)
    axes.set_xlim(x[0], x[-1])
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def axis_of_q(axes: Axes, run: Run) -> None:
    """The axis of q; logarithmic where the profile breaks into vertical steps."""
    axes.set_ylabel("excess slope q")
    axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    if run.vertical_steps:  # where the profile jumps q has no bound, and what is beside it should be seen
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_ylim(bottom=min(float(run.q.min()), 0.0) - 0.1)
        plain_numbers(axes.yaxis)


def span(time: Array) -> tuple[float, float]:
    """First and last time on an axis; a single time gets some room."""
    first, last = float(time[0]), float(time[-1])
    return (first, last) if last > first else (first - 0.5, first + 0.5)


def axis_of_time(time: Array, units: Units | None) -> tuple[float, str, Callable[[float, float], str]]:
    """What one unit of t is on an axis, the label of that axis and the formatter of its numbers.

    Of a survey it is the volume per unit width that was poured in, in the survey's units.
    """
    unit = units.volume if units else 1.0
    many = unit * float(time[-1]) >= 1e5  # their digits would have no room
    label = "poured in: volume per width" if units else "t: mass of grains poured in"
    return unit, label, lambda v, _: f"{v:.3g}".replace("e+0", "e") if many else f"{v:,g}"


def shown_times(run: Run) -> tuple[Array, Callable[[int], Any]]:
    """The saved times that are drawn, and the colour of each."""
    norm = Normalize(*span(run.time))
    return spread(run.time.size, LINES), lambda i: TIMES(norm(run.time[i]))


def spread(size: int, most: int) -> Array:
    """At most so many numbers from 0 to size - 1, evenly spread, both ends among them."""
    return np.unique(np.linspace(0, size - 1, most).round().astype(int))


def bar_of(figure: Figure, mappable: ScalarMappable, label: str, bottom: float | None = None) -> Axes:
    """A colour bar beside the axes, as high as they are or down to `bottom`, a part of the figure's height."""
    edges, width = figure.subplotpars, 0.12 / WIDTH
    foot = edges.bottom if bottom is None else bottom
    place = (edges.right + 0.6 * width, foot, width, edges.top - foot)
    axes = figure.add_axes(place, label="<colorbar>")
    figure.colorbar(mappable, cax=axes, ticks=MaxNLocator(9, steps=[1, 2, 5, 10])).set_label(label)  # of few digits
    return axes


def round_numbers(low: float, high: float, most: int) -> list[float]:
    """At most so many numbers of few digits, evenly spaced, from `low` to `high`."""
    return [float(v) for v in MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high) if low <= v <= high]


def bar_of_times(figure: Figure, run: Run) -> None:
    """The colour bar of `shown_times`."""
    unit, label, numbers = axis_of_time(run.time, run.units)
    axes = bar_of(figure, ScalarMappable(Normalize(*span(unit * run.time)), TIMES), label)
    axes.yaxis.set_major_formatter(numbers)
    if run.time.size == 1:
        axes.set_yticks([unit * float(run.time[0])])


def kinks_on(run: Run, x: Array, heights: Array) -> list[tuple[Array, Array, Array]]:
    """Places, heights and numbers of the saved times of each kink on curves `heights`, shape (times, x.size)."""
    scale = run.units.x if run.units else np.asarray
    found = []
    for number in sorted({k.kink for k in run.kinks}):
        mine = [k for k in run.kinks if k.kink == number]
        index = np.searchsorted(run.time, [k.time for k in mine])
        at = scale(np.array([k.x for k in mine]))
        found.append((at, np.array([np.interp(a, x, heights[i]) for a, i in zip(at, index, strict=True)]), index))
    return found


def dots_on(run: Run, i: int, x: Array, heights: Array) -> tuple[Array, Array]:
    """Places and heights of the DOTS strongest kinks at a saved time, on a curve `heights`, shape (x.size,)."""
    strongest = sorted(run.kinks_at(i), key=lambda kink: kink.jump)[-DOTS:]
    at = np.array([kink.x for kink in strongest])
    at = run.units.x(at) if run.units else at
    return at, np.interp(at, x, heights)


def change_of(u: Array, first: Array, x: Array) -> tuple[float, float]:
    """Areas between two profiles where the later one lies below the first, and where above: eroded, deposited."""
    eroded, deposited = np.maximum(first - u, 0.0), np.maximum(u - first, 0.0)
    return tuple(float(0.5 * np.diff(x) @ (h[1:] + h[:-1])) for h in (eroded, deposited))  # type: ignore[return-value]


def amount(value: float) -> str:
    """A positive number in few digits, without an exponent where one can do without."""
    return f"{value:,.0f}" if 1000.0 <= value < 1e7 else f"{value:.3g}"
