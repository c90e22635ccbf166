"""Plots of a run on the axes of a user, with the user's settings of matplotlib; the only module that uses pyplot."""

from __future__ import annotations

from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hjprofile.errors import InputError, did_you_mean
from hjprofile.output.plots import style
from hjprofile.output.plots.norm_panels import norms_on
from hjprofile.output.plots.runs import (
    characteristics,
    curves_on,
    diagram_on,
    flux_on,
    keys_of_diagram,
    kinks_key,
    ticks_of_q,
)
from hjprofile.problem.ranges import instance, shown
from hjprofile.solvers.run import Run

KINDS = "profile", "diagram", "flux", "norms"
SHEET = 7.0, 8.5  # of the norms, in inches


def plot(run: Run, kind: str = "profile", ax: Axes | None = None) -> Axes | Figure:
    """Plot a run with matplotlib, for a notebook or for a figure of your own.

    The plot of a survey is in its units. Without `ax` a new figure of pyplot is made; `pyplot.show()` displays it and
    `ax.figure.savefig(...)` writes it. No setting of matplotlib is changed.

    Args:
        run: the run.
        kind: "profile" for the height at up to seven saved times with the kinks; "diagram" for q over x and supplied
            mass, with the paths of kinks and characteristics, and a colour bar; "flux" for the grain flux K over x;
            "norms" for the norms over the supplied mass in eight panels.
        ax: the axes that receive the plot; None for a new figure. "norms" has no axes of its own.

    Returns:
        The axes; for "norms" the figure.

    Raises:
        InputError: for an argument of another type, an unknown kind, or axes for "norms".

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1, snapshots=3)
    >>> run = hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40))
    >>> from matplotlib.figure import Figure
    >>> hj.plot(run, "flux", ax=Figure().subplots()).get_xlabel()
    'x (exchange lengths; crest at 0)'
    """
    instance("run", run, Run)
    if kind not in KINDS:
        hint = did_you_mean(str(kind), KINDS)
        raise InputError(f"kind = {shown(kind)} is not known{hint} (allowed: {', '.join(KINDS)})")
    if ax is not None:
        instance("ax", ax, Axes)
    if kind == "norms":
        if ax is not None:
            raise InputError("kind = 'norms' has eight panels and makes its own figure; leave ax out")
        return _norms(run)
    own = ax is None
    if ax is None:
        _, ax = pyplot.subplots(layout="constrained")
    {"profile": _profile, "diagram": _diagram, "flux": _flux}[kind](ax, run)
    if own:
        ax.set_title(run.title, parse_math=False, wrap=True)
    return ax


def _profile(axes: Axes, run: Run) -> None:
    _, u, _, u_label = style.axes_units(run, run.units)
    curves_on(axes, run, u)
    axes.set_ylabel(u_label)
    _legend(axes, run)


def _flux(axes: Axes, run: Run) -> None:
    flux_on(axes, run)
    _legend(axes, run)


def _legend(axes: Axes, run: Run) -> None:
    """Add a legend of the times, and of the kinks if there are any."""
    handles, _ = axes.get_legend_handles_labels()
    _, label, _ = style.axis_of_time(run.time, run.units)
    axes.legend(handles=[*handles, *[kinks_key()] * bool(run.kinks)], title=label)


def _diagram(axes: Axes, run: Run) -> None:
    traced = characteristics(run)
    sheet = diagram_on(axes, run, traced)
    bar = axes.get_figure(root=False).colorbar(sheet, ax=axes, label="excess slope q")  # type: ignore[union-attr]
    ticks_of_q(bar.ax, run)
    if keys := keys_of_diagram(run, traced is not None):
        axes.legend(handles=keys)


def _norms(run: Run) -> Figure:
    figure = pyplot.figure(figsize=SHEET, layout="constrained")
    keys = norms_on(figure.subplots(4, 2, sharex=True).ravel(), run)
    figure.legend(handles=keys, loc="outside upper left", ncols=len(keys))
    figure.suptitle(run.title, parse_math=False, wrap=True)
    return figure
