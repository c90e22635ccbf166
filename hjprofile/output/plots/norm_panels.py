"""Picture of the norms of a run over its saved times, with the bounds that the theory gives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from hjprofile.output.plots import style
from hjprofile.output.plots.style import DEPOSITED, ERODED, INK, styled
from hjprofile.solvers.norms import Limit
from hjprofile.solvers.run import Array, Run

LABELS = {  # column of `Norms` -> label of its panel
    "l1": "‖q‖₁",
    "tv": "TV(q)",
    "inf_q": "inf q",
    "sup_q": "sup q",
    "sup_F": "sup|F|",
    "tv_F": "TV(F)",
    "tv_I": "TV(I)",
    "K_left": "K at the left end",
}
WIDE = 3.0  # a bound that exceeds the measured range by this factor is written instead of drawn
SMALL = 1e-9  # a norm below it is zero to rounding
DECADES = 1.5  # decades of K from which its axis is logarithmic
_MEASURED: dict[str, Any] = {"color": INK, "lw": 1.2}
_BOUNDS: tuple[dict[str, Any], ...] = (
    {"color": ERODED, "lw": 1.0, "ls": "--"},
    {"color": DEPOSITED, "lw": 1.0, "ls": ":"},
)


@styled
def draw_norms(run: Run) -> Figure:
    """Draw each norm of `Run.norms` over the supplied mass, with its bounds if the theory gives one."""
    figure = style.sheet(run.title, style.about(run), 1, 5.6, right=0.22)
    figure.subplots_adjust(wspace=0.42, hspace=0.14, left=0.18)
    panels = figure.subplots(4, 2, sharex=True).ravel()
    keys = norms_on(panels, run)
    style.legend_above(figure, keys)
    figure.align_ylabels(panels[::2])
    figure.align_ylabels(panels[1::2])
    return figure


def norms_on(panels: Sequence[Axes], run: Run) -> list[Line2D]:
    """Draw each norm into its panel, two in a row; return the keys of a legend."""
    bounds = {column: run.norm_limits.get(column, ()) for column in LABELS}
    unit, t_label, numbers = style.axis_of_time(run.time, run.units)
    time = unit * run.time
    for axes, (column, label) in zip(panels, LABELS.items(), strict=True):
        _panel(axes, time, getattr(run.norms, column), bounds[column], column == "K_left")
        axes.set_ylabel(label)
        axes.set_xlim(*style.span(time))
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.xaxis.set_major_formatter(numbers)
    for axes in panels[-2:]:
        axes.set_xlabel(t_label)
    keys = [Line2D([], [], label="measured", **_MEASURED)]
    keys += [Line2D([], [], label="bound", **_BOUNDS[0])] * any(bounds.values())
    return keys + [Line2D([], [], label="second bound", **_BOUNDS[1])] * any(len(b) > 1 for b in bounds.values())


def _panel(axes: Axes, time: Array, values: Array, bounds: Sequence[Limit], positive: bool) -> None:
    """Draw one norm and its bounds; a bound far from it is written into the panel."""
    mark = "o" if time.size == 1 else None
    axes.plot(time, values, marker=mark, **_MEASURED)
    axes.margins(y=0.12)
    if not np.isfinite(values).any():
        axes.text(
            0.5, 0.5, "the law is not part\nof the stored run", ha="center", va="center", transform=axes.transAxes
        )
        return
    low, high = float(values.min()), float(values.max())
    logarithmic = positive and np.log10(high / low) > DECADES
    below, above = _reach(low, high, logarithmic)
    far = 0
    for limit, look in zip(bounds, _BOUNDS, strict=False):
        if below <= limit.values.min() and limit.values.max() <= above:
            axes.plot(time, limit.values, marker=mark, **look)
            continue
        axes.annotate(
            f"bound {limit.values[-1]:.3g}".replace("e-0", "e-").replace("e+0", "e"), (0.96, 0.8 - 0.17 * far),
            xycoords="axes fraction", ha="right", va="top", color=look["color"],
            bbox={"fc": "white", "ec": "none", "pad": 1.0},
        )  # fmt: skip
        far += 1
    if logarithmic:
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis)


def _reach(low: float, high: float, logarithmic: bool) -> tuple[float, float]:
    """Return the range of values that are drawn in the panel of a norm between `low` and `high`."""
    if logarithmic:
        ratio = (high / low) ** WIDE
        return low / ratio, high * ratio
    reach = WIDE * max(high - low, 0.2 * max(abs(low), abs(high)), SMALL)
    return low - reach, high + reach
