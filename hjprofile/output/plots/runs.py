"""Pictures of a run."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure

from hjprofile.output.plots.style import DEPOSITED, ERODED, png
from hjprofile.solvers.run import Array, Run

LINES = 9  # profiles that are drawn; more hide each other


def pictures(run: Run) -> dict[str, bytes | str]:
    """Name -> PNG."""
    return {"profile.png": png(draw_profiles(run)), "diagram.png": png(draw_diagram(run))}


def _figure(width: float, height: float, run: Run) -> Figure:
    """With margins that suit the axes of a run: to find them out would cost as much as the drawing."""
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    lines = 1 if run.done else 1 + len(_reason(run))
    figure.subplots_adjust(
        0.7 / width, 0.5 / height, 1.0 - 0.95 / width, 1.0 - (0.15 + 0.2 * lines) / height, 0.08, 0.08
    )
    return figure


def _bar_axes(figure: Figure) -> Axes:
    """A place for a colour bar, as high as the axes."""
    edges = figure.subplotpars
    width = 0.16 / figure.get_figwidth()
    return figure.add_axes(
        (edges.right + 0.5 * width, edges.bottom, width, edges.top - edges.bottom), label="<colorbar>"
    )


def _axes_units(run: Run) -> tuple[Array, Array, str, str]:
    """x, u in the survey's units if there is one, with labels of the axes."""
    if run.units:
        return run.units.x(run.x), run.units.height(run.u), "x (units of the survey)", "height (units of the survey)"
    top = "" if run.x[-1] else "; the top is at 0"
    return run.x, run.u, f"x (in exchange lengths{top})", "height u"


def _reason(run: Run) -> list[str]:
    return [] if run.done else textwrap.wrap(run.status, 110)


def _titles(axes: Axes, run: Run) -> None:
    """The title and the method; below them, where a run stopped early, why."""
    reason = _reason(run)
    axes.set_title(run.title + "\n" * len(reason), loc="left", fontweight="bold")
    axes.set_title("\n".join([f"{run.method}, {run.cells} cells", *reason]), loc="right", fontsize=8, color="0.35")


def _span(run: Run) -> tuple[float, float]:
    """First and last time on an axis; a single time gets some room."""
    first, last = float(run.time[0]), float(run.time[-1])
    return (first, last) if last > first else (first - 0.5, first + 0.5)


def draw_profiles(run: Run) -> Figure:
    """The profile through time with its kinks; below it how far it has moved; below that the excess slope."""
    x, u, x_label, u_label = _axes_units(run)
    figure = _figure(8.0, 8.4, run)
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    shown = np.unique(np.linspace(0, run.time.size - 1, LINES).round().astype(int))
    norm = Normalize(*_span(run))
    colours = colormaps["viridis"].resampled(256)
    centres = 0.5 * (x[1:] + x[:-1])
    for i in shown:
        colour = colours(0.92 * norm(run.time[i]))
        top.plot(x, u[i], color=colour, lw=1.1)
        middle.plot(x, u[i] - u[0], color=colour, lw=1.1)
        bottom.plot(centres, run.q[i], color=colour, lw=1.0)
        kinks = np.array([k.x for k in run.kinks_at(i)])
        if kinks.size:
            at = run.units.x(kinks) if run.units else kinks
            top.plot(at, np.interp(at, x, u[i]), "o", ms=4, mfc="white", mec=colour, zorder=3)
            middle.plot(at, np.interp(at, x, u[i] - u[0]), "o", ms=4, mfc="white", mec=colour, zorder=3)
    change = u[-1] - u[0]
    middle.fill_between(x, change, 0, where=change < 0, color=ERODED, alpha=0.3, lw=0, label="eroded")
    middle.fill_between(x, change, 0, where=change > 0, color=DEPOSITED, alpha=0.3, lw=0, label="deposited")
    if np.any(np.abs(change) > 1e-9 * np.ptp(u)):
        middle.legend(loc="best", fontsize=8, frameon=False)
    top.plot([], [], "o", ms=4, mfc="white", mec="k", label="kink")
    if run.kinks:
        top.legend(loc="upper left", fontsize=8, frameon=False)
    _titles(top, run)
    top.set_ylabel(u_label)
    middle.set_ylabel("change of height")
    bottom.set_ylabel("excess slope q = $u_x$ - 1")
    bottom.axhline(0, color="0.6", lw=0.6, zorder=0)
    if run.vertical_steps:  # where the profile jumps q has no bound, and what is beside it should be seen
        bottom.set_yscale("symlog", linthresh=1.0)
        bottom.set_ylim(bottom=min(float(run.q.min()), 0.0) - 0.1)
    bottom.set_xlabel(x_label)
    bottom.set_xlim(x[0], x[-1])
    bar = figure.colorbar(ScalarMappable(norm, colours.resampled(256)), cax=_bar_axes(figure))
    bar.set_label("t: mass of grains poured in")
    if run.time.size == 1:
        bar.set_ticks([float(run.time[0])])
    return figure


def draw_diagram(run: Run) -> Figure:
    """The excess slope over the (x, t) plane with the paths of the kinks and their births, merges and exits."""
    x, _, x_label, _ = _axes_units(run)
    figure = _figure(8.0, 5.2, run)
    axes = figure.subplots()
    low, high = float(run.q.min()), float(run.q.max())
    if run.vertical_steps:  # where the profile jumps q has no bound
        high = max(float(np.quantile(run.q, 0.98)), 0.0)
    span = max(-low, high)
    if span < 1e-9:  # a critical slope: rounding must not be drawn as if it were relief
        span = 1.0
    # one colour scale about q = 0 in which neither side drowns the other
    norm = TwoSlopeNorm(0.0, min(low, -0.05 * span), max(high, 0.05 * span))
    first, last = _span(run)
    edges = np.concatenate([[first], 0.5 * (run.time[1:] + run.time[:-1]), [last]])
    sheet = axes.pcolormesh(x, edges, run.q, cmap="RdBu_r", norm=norm, rasterized=True)
    bar = figure.colorbar(sheet, cax=_bar_axes(figure), label="excess slope q  (below 0: grains settle)")
    if low >= 0 or high <= 0:  # only the half of the scale that is there
        bar.ax.set_ylim(0.0 if low >= 0 else norm.vmin, norm.vmax if low >= 0 else 0.0)
    if run.time.size == 1:
        axes.set_yticks([float(run.time[0])])
    scale = run.units.x if run.units else np.asarray
    for number in sorted({k.kink for k in run.kinks}):
        path = [(k.time, k.x) for k in run.kinks if k.kink == number]
        path += [(e.time, e.x) for e in run.events if e.kink == number]
        t, at = np.array(sorted(path)).T
        axes.plot(scale(at), t, color="k", lw=1.0, marker="." if at.size == 1 else None)
    for number in sorted({s.step for s in run.vertical_steps or ()}):
        t, at = np.array([(s.time, s.x) for s in run.vertical_steps or () if s.step == number]).T
        axes.plot(scale(at), t, color="k", lw=2.6, marker="." if at.size == 1 else None)
    for kind, marker in (("birth", "o"), ("blow-up", "*"), ("merge", "^"), ("exit", "s")):
        marks = [e for e in run.events if e.event == kind]
        if marks:
            axes.plot(
                scale(np.array([e.x for e in marks])), [e.time for e in marks],
                marker, ms=6, mfc="white", mec="k", ls="none", label=kind, clip_on=False,
            )  # fmt: skip
    if run.kinks:
        axes.plot([], [], color="k", lw=1.0, label="kink")
    if run.vertical_steps:
        axes.plot([], [], color="k", lw=2.6, label="vertical step")
    if run.kinks or run.vertical_steps:
        axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    _titles(axes, run)
    axes.set_xlabel(x_label)
    axes.set_ylabel("t: mass of grains poured in")
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(first, last)
    return figure
