"""The picture that compares two runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from hjprofile.errors import InputError
from hjprofile.output.plots import style
from hjprofile.output.plots.style import INK, TIMES, TWO_RUNS, styled
from hjprofile.problem.ranges import instance, shown
from hjprofile.solvers.run import Array, Run
from hjprofile.studies.accuracy import Shared, shared

SHOWN = 4  # shared times at which profiles are drawn
ROUNDING = 1e-12  # largest distance that counts as 0
LONGEST = 26  # characters of a name that fit into a legend

_LOOKS: tuple[dict[str, Any], ...] = (
    {"color": TWO_RUNS[0], "lw": 1.5},
    {"color": TWO_RUNS[1], "lw": 1.0, "ls": (0, (3, 2))},
)
_LARGEST: dict[str, Any] = {"color": INK, "lw": 0.9}
_KINKS: dict[str, Any] = {"color": INK, "ls": "none", "marker": ".", "ms": 4.0}


def comparison_pictures(first: Run, second: Run, names: tuple[str, str]) -> dict[str, bytes | str]:
    """Return name -> content of `draw_comparison`, as PNG and as SVG."""
    figure = draw_comparison(first, second, names)
    return {f"comparison.{form}": style.encode(figure, form) for form in ("png", "svg")}


def plot_comparison(first: Run, second: Run, names: tuple[str, str] = ("first", "second")) -> Figure:
    """Plot two runs and their differences, as the command `compare` does.

    The panels are the profiles at up to four shared times, the differences of heights and of slopes there, and the
    largest differences over time, in the unit of the surveys if both runs have units.

    Args:
        first, second: the runs, comparable as for `compare`.
        names: their names in the legend.

    Returns:
        The figure; `savefig` writes it.

    Raises:
        InputError: for an argument of another type, or for runs that cannot be compared.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1, snapshots=3)
    >>> runs = [hj.solve_hj(problem, hj.Grid(-4.0, 40), method) for method in ("godunov", "eno2")]
    >>> len(hj.plot_comparison(*runs, names=("godunov", "eno2")).axes)
    6
    """
    instance("first", first, Run)
    instance("second", second, Run)
    if not (isinstance(names, Sequence) and len(names) == 2 and all(isinstance(name, str) for name in names)):
        raise InputError(f"names = {shown(names)} must be two texts")
    figure: Figure = draw_comparison(first, second, (names[0], names[1]))
    return figure


@styled
def draw_comparison(first: Run, second: Run, names: tuple[str, str]) -> Figure:
    """Draw both profiles at up to four shared times, their differences in u and q, and the largest differences over
    time.

    Use the survey's units if both runs have units, else exchange lengths. Raise InputError if the runs cannot be
    compared.
    """
    both = shared(first, second)
    units = both.units
    length, rise = (units.length, units.rise) if units else (1.0, 1.0)
    x, x_cell, heights, kinks = _in_units(both)
    label_of_x, label_of_height = style.labels_of(units) if units else style.axes_units(first, None)[2:]
    of_slope = "difference of slope" if both.metric else "difference of q"
    of_height = style.of_height("difference of height", units) if units else "difference of u"
    saved = both.time / units.volume if units and both.metric else both.time
    unit, label_of_time, numbers = style.axis_of_time(saved, units)
    times = unit * saved
    names = tuple(n if len(n) <= LONGEST else f"{n[: LONGEST - 1]}…" for n in names)  # type: ignore[assignment]
    lines = [f"{name}: {run.method}, {run.cells} cells" for name, run in zip(names, (first, second), strict=True)]
    lines += ["on their common ground, at equal supplied volumes"] if both.metric else []
    figure = style.sheet(" and ".join(dict.fromkeys((first.title, second.title))), lines, 1, 7.0)
    frame = figure.subplotpars
    parts = figure.add_gridspec(
        2, 1, height_ratios=[5.0, 2.0], hspace=0.18,
        left=frame.left, right=frame.right, bottom=frame.bottom, top=frame.top,
    )  # fmt: skip
    panels: Any = parts[0].subgridspec(3, 1, height_ratios=[3, 2, 2], hspace=0.1).subplots(sharex=True)
    top, middle, bottom = panels
    over_time: Any = parts[1].subgridspec(2, 1, hspace=0.14).subplots(sharex=True)
    norm = Normalize(*style.span(times))
    for i in style.spread(times.size, SHOWN):
        for height, look in zip(heights, _LOOKS, strict=True):
            style.draw_line(top, x, height[i], **look)
        colour = TIMES(norm(times[i]))
        style.draw_line(middle, x, heights[0, i] - heights[1, i], color=colour, lw=0.9)
        style.draw_line(bottom, x_cell, both.slope[0, i] - both.slope[1, i], color=colour, lw=0.9)
    largest = np.abs(heights[0] - heights[1]).max(axis=1)
    apart = largest > ROUNDING * rise
    moments = zip(times.tolist(), kinks, strict=True)
    distances = [(t, d) for t, found in moments for d in found if d > ROUNDING * length]
    over_time[0].plot(times, np.where(apart, largest, np.nan), **_LARGEST)
    over_time[1].plot(*np.array(distances).reshape(-1, 2).T, **_KINKS)
    runs = [Line2D([], [], **look, label=name) for name, look in zip(names, _LOOKS, strict=True)]
    style.legend_above(figure, runs)
    for axes, label in zip((top, middle, bottom), (label_of_height, of_height, of_slope), strict=True):
        axes.set_ylabel(label)
        if axes is not top:
            axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    style.axis_of_x(bottom, x, label_of_x)
    over_time[0].set_ylabel(style.of_height("sup|Δ height|", units) if units else "sup|u₁ - u₂|")
    over_time[1].set_ylabel(f"kinks apart\n({units.label if units else 'exch. lengths'})")
    over_time[1].set_xlabel(label_of_time)
    over_time[1].xaxis.set_major_formatter(numbers)
    if units:  # volumes have many digits
        over_time[1].xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    over_time[1].set_xlim(*style.span(times))
    _scale(over_time[0], [*largest[apart]] or [1.0])
    _scale(over_time[1], [d for _, d in distances] or [1.0])
    style.letter_panels([*panels, *over_time])
    figure.align_ylabels([*panels, *over_time])
    bar = style.bar_of(figure, ScalarMappable(norm, TIMES), label_of_time, bottom=bottom.get_position().y0)
    bar.yaxis.set_major_formatter(numbers)
    return figure


def _in_units(both: Shared) -> tuple[Array, Array, Array, Sequence[Array]]:
    """Return nodes, midpoints, heights and distances of kinks, in the survey's unit if both runs have units."""
    units = both.units
    if units is None or both.metric:
        return both.x, both.x_cell, both.height, both.kinks
    distances = [units.length * distance for distance in both.kinks]
    return units.x(both.x), units.x(both.x_cell), units.height(both.height), distances


def _scale(axes: Axes, found: list[float]) -> None:
    """Set a logarithmic axis if distances differ by a factor of ten, else one from 0."""
    if max(found) > 10.0 * min(found):
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis)
    else:
        axes.set_ylim(0.0, 1.1 * max(found))
