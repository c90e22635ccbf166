"""Pictures of runs and charts; the only module that knows matplotlib. Drawn off screen, without pyplot."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, NullFormatter

from hjprofile.evidence.calibration import Calibration
from hjprofile.evidence.chart import Point, Reference, pareto
from hjprofile.evidence.dependence import Distance, largest_distances, observed_constant
from hjprofile.evidence.stability import FAILS, HOLDS, LOSES, OSCILLATES, Trial
from hjprofile.solvers.run import Array, Run

LINES = 9  # profiles that are drawn; more hide each other
ERODED, DEPOSITED = "#c8553d", "#3d7ea6"


# method -> colour and marker; a form's carried-over fluxes share its colour and are drawn lightly. Okabe and Ito's
# colours can be told apart without green and red.
_LOOKS = {
    "local-lax-friedrichs": ("#E69F00", "o"),
    "lax-friedrichs": ("#999999", "o"),
    "godunov": ("#56B4E9", "o"),
    "telescoping": ("#CC79A7", "o"),
    "eno2": ("#009E73", "s"),
    "weno5": ("#000000", "D"),
    "conservative": ("#0072B2", "s"),
    "fronts": ("#D55E00", "^"),
    "characteristics": ("#B8A800", "*"),
}


def chart_picture(charts: Mapping[str, tuple[Sequence[Point], Reference]]) -> bytes:
    """PNG of `draw_chart`."""
    return _png(draw_chart(charts))


def draw_chart(charts: Mapping[str, tuple[Sequence[Point], Reference]]) -> Figure:
    """Error against seconds, a row for each case: sup|u| on the left, ∫|q| on the right with its Pareto front."""
    figure = _figure(10.0, 4.6 * len(charts))
    rows = figure.subplots(len(charts), 2, squeeze=False)
    for (case, (points, reference)), row in zip(charts.items(), rows, strict=True):
        for axes, error, label in zip(
            row, ("error_u_sup", "error_q_l1"), ("sup |u - exact u|", "∫ |q - exact q| dx at the end"), strict=True
        ):
            for method in dict.fromkeys(p.method for p in points):
                mine = [(p.seconds, max(getattr(p, error), 1e-16)) for p in points if p.method == method]
                carried = method not in _LOOKS
                colour, marker = _LOOKS[method.removeprefix("conservative-") if carried else method]
                light = {"alpha": 0.35, "mfc": "none", "ls": ":"} if carried else {}
                name = "the same, conservative-..." if carried else method
                known = name in axes.get_legend_handles_labels()[1]
                (line,) = axes.loglog(*np.array(mine).T, color=colour, marker=marker, ms=4, lw=1.0, **light)
                line.set_label("_" if known else name)
            axes.set_xlabel("seconds of time stepping")
            axes.set_ylabel(label)
            axes.grid(alpha=0.25, lw=0.5)
            if reference.error > 0.0 and error == "error_u_sup":
                axes.axhline(reference.error, color="0.5", lw=0.8, ls="--")
        front = pareto(points)
        row[1].step(
            [p.seconds for p in front], [max(p.error_q_l1, 1e-16) for p in front],
            where="post", color="0.25", lw=4.0, alpha=0.25, marker="o", ms=9, label="Pareto front",
        )  # fmt: skip
        row[0].set_title(case, loc="left", fontweight="bold")
        against = f"against {reference.name}"
        if reference.error > 0.0:
            against += f", u to {reference.error:.0e} (dashed)"
        row[1].set_title(against, loc="right", fontsize=8, color="0.35")
    handles, labels = rows[0][1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    return figure


_OUTCOMES = {HOLDS: ("#0072B2", "o"), LOSES: ("#E69F00", "s"), OSCILLATES: ("#CC79A7", "D"), FAILS: ("#000000", "X")}
_AXES = {  # parameter -> title, logarithmic
    "cfl": ("CFL number Δt max(K f')/Δx", False),
    "viscosity": ("viscosity α / max(K f') at CFL number ...", False),
    "refresh": ("steps that share a K", True),
    "reconstruction": ("edge values (K and fluxes upwind)", False),
    "least 1 + q": ("least 1 + q, in a hollow", True),
    "largest |ln K|": ("largest |ln K| = |∫ f dx|", True),
    "left end": ("left end of the grid", False),
}


def stability_picture(trials: Sequence[Trial]) -> bytes:
    """PNG of `draw_stability`."""
    return _png(draw_stability(trials))


def draw_stability(trials: Sequence[Trial]) -> Figure:
    """A panel for each parameter, a row for each method, a mark for each outcome; theory's limit as a line."""
    panels: dict[str, list[Trial]] = {}
    for trial in trials:
        panels.setdefault(trial.parameter.split(" at cfl ")[0], []).append(trial)

    def row_of(trial: Trial) -> str:
        return trial.parameter.split(" at cfl ")[-1] if " at cfl " in trial.parameter else trial.method

    figure = _figure(11.0, 10.5)
    places = figure.subplot_mosaic(
        [["cfl", "viscosity"], ["least 1 + q", "largest |ln K|"], ["refresh", "reconstruction"], ["left end", "key"]],
        height_ratios=[7, 7, 2.2, 2.2],
    )
    for parameter, mine in panels.items():
        axes, rows = places[parameter], list(dict.fromkeys(map(row_of, mine)))
        title, logarithmic = _AXES[parameter]
        words = [t.value for t in mine if isinstance(t.value, str)]
        for outcome, (colour, marker) in _OUTCOMES.items():
            at = [
                (words.index(str(t.value)) if words else t.value, rows.index(row_of(t)))
                for t in mine
                if t.outcome == outcome
            ]
            if at:
                axes.plot(*np.array(at, dtype=float).T, marker, color=colour, ms=5.5, mew=0, clip_on=False)
        for trial in mine:
            y = rows.index(row_of(trial))
            if parameter == "viscosity":  # monotone between max(K f') and Δx/Δt
                axes.plot([1.0, 1.0], [y - 0.4, y + 0.4], color="0.3", lw=1.2)
                axes.plot([1.0 / float(row_of(trial))] * 2, [y - 0.4, y + 0.4], color="0.3", lw=1.2, ls=":")
            elif np.isfinite(trial.theory):
                axes.plot([trial.theory] * 2, [y - 0.4, y + 0.4], color="0.3", lw=1.2)
        if logarithmic:
            axes.set_xscale("log")
        if words:
            axes.set_xticks(range(len(words)), words)
            axes.set_xlim(-0.5, len(words) - 0.5)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_title(title, fontsize=10, loc="left")
        axes.grid(axis="x", alpha=0.25, lw=0.5)
    key = places["key"]
    key.axis("off")
    names = {
        HOLDS: "holds",
        LOSES: "loses a bound",
        OSCILLATES: "oscillates",
        FAILS: "fails: q reaches -1, or no progress",
    }
    for outcome, (colour, marker) in _OUTCOMES.items():
        key.plot([], [], marker, color=colour, ms=6, mew=0, label=names[outcome])
    key.plot([], [], color="0.3", lw=1.2, label="limit by theory (for any data; lax-friedrichs: 2/3 on rough ones)")
    key.plot([], [], color="0.3", lw=1.2, ls=":", label="α = Δx/Δt")
    key.legend(loc="center", fontsize=9, frameon=False)
    figure.suptitle(f"Where methods hold and where they fail: {trials[0].case}", fontsize=12, x=0.01, ha="left")
    return figure


def dependence_picture(distances: Sequence[Distance]) -> bytes:
    """PNG of `draw_dependence`."""
    return _png(draw_dependence(distances))


_SHADES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")  # of sizes


def draw_dependence(distances: Sequence[Distance]) -> Figure:
    """A panel for each study: distances over time, and for what converges the last ones over size."""
    studies: dict[str, list[Distance]] = {}
    for d in distances:
        studies.setdefault(d.study, []).append(d)
    figure = _figure(10.0, 7.6)
    axes = dict(zip(("data", "zero", "coefficient", "refresh"), figure.subplots(2, 2).flat, strict=True))
    for study in ("data", "zero"):
        mine, panel = studies[study], axes[study]
        sizes = np.array([[d.member, d.size] for d in studies["data"]])
        rank = {m: int(np.log10(sizes[sizes[:, 0] == m, 1][0])) for m in np.unique(sizes[:, 0])}
        shades = dict(zip(sorted(set(rank.values())), _SHADES, strict=False))
        for member in dict.fromkeys(d.member for d in mine):
            t, y = np.array([(d.time, d.distance / d.size) for d in mine if d.member == member]).T
            panel.plot(t, np.where(y > 1e-3, y, np.nan), color=shades[rank[member]], lw=0.9, alpha=0.7)
        panel.set_xlabel("t")
        panel.grid(alpha=0.25, lw=0.5)
    L = observed_constant(studies["data"])
    t = np.linspace(0.0, max(d.time for d in distances), 200)
    axes["data"].set_yscale("log")
    axes["data"].yaxis.set_major_formatter(LogFormatter(minor_thresholds=(2.0, 0.5)))
    axes["data"].yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2.0, 0.5)))
    low, high = axes["data"].get_ylim()
    axes["data"].plot(t, np.exp(L * t), color="0.3", lw=1.2, ls="--", label=f"$e^{{Lt}}$, L = {L:.3g}")
    axes["data"].set_ylim(low, 1.5 * high)
    axes["data"].set_title("two slopes: ‖q - q̃‖₁ / ‖q - q̃‖₁(0)", loc="left", fontsize=10)
    for rank_, shade in shades.items():
        axes["data"].plot([], [], color=shade, label=f"‖q - q̃‖₁(0) about {10.0**rank_:g}")
    axes["zero"].axhline(1.0, color="0.3", lw=1.2, ls="--", label="L = 0")
    axes["zero"].set_title("a slope and the critical one: ‖q‖₁ / ‖q‖₁(0)", loc="left", fontsize=10)
    names = {
        "coefficient": ("coefficients k and k(1 + δ ...): largest ‖q - q̃‖₁", "δ"),
        "refresh": ("K frozen over fractional steps: mean ‖q - q̃‖₁, kinks", "fractional step Δt"),
    }
    for study, (title, label) in names.items():
        panel = axes[study]
        size, largest = np.array(list(largest_distances(distances, study).values())).T
        least = size == size.min()
        for each in largest.reshape(-1, least.sum()).T:
            panel.loglog(np.unique(size)[::-1], each, ".-", color=_SHADES[0], ms=5, lw=0.8, alpha=0.8)
        if study == "refresh":
            kinks = np.array(list(largest_distances(distances, "refresh kinks").values()))
            panel.loglog(*kinks.T, ".-", color=_SHADES[1], ms=5, lw=0.8, label="distance of kinks")
        panel.loglog(size, largest[least].mean() * size / size.min(), color="0.3", lw=1.2, ls="--", label="first order")
        panel.set_xticks(np.unique(size), [f"{value:.3g}" for value in np.unique(size)])
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_title(title, loc="left", fontsize=10)
        panel.set_xlabel(label)
        panel.grid(alpha=0.25, lw=0.5)
    for panel in axes.values():
        panel.legend(fontsize=8, frameon=False)
    figure.suptitle(f"Continuous dependence: {distances[0].case}", fontsize=12, x=0.01, ha="left")
    return figure


def fit_picture(found: Calibration) -> bytes:
    """PNG of `draw_fit`."""
    return _png(draw_fit(found))


def draw_fit(found: Calibration) -> Figure:
    """Both surveys with the fitted profile; below it how far the slope has moved; below that what the fit leaves."""
    figure = _figure(8.0, 7.6)
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 1.4])
    x, before, after = found.curve
    start = np.interp(found.x, x, before)
    points = {"ls": "none", "marker": "o", "ms": 3.5, "mfc": "white", "mec": ERODED, "label": "measured after"}
    top.plot(x, before, color="0.45", lw=1.1, ls="--", label="before")
    top.plot(x, after, color=DEPOSITED, lw=1.4, label="fitted after")
    top.plot(found.x, found.measured, **points)
    middle.plot(x, after - before, color=DEPOSITED, lw=1.4)
    middle.plot(found.x, found.measured - start, **points)
    bottom.axhspan(-1.96 * found.sigma, 1.96 * found.sigma, color="0.9", lw=0, label="±1.96 sigma")
    bottom.plot(found.x, found.measured - found.modelled, **(points | {"label": "_"}))
    for axes in (middle, bottom):
        axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    of_survey = " (units of the survey)" if found.case["profile"]["kind"] == "survey" else ""
    top.set_title(found.title, loc="left", fontweight="bold")
    lines = [
        f"{p.name} = {p.value:.4g}" + (f"  [{p.low:.4g}, {p.high:.4g}]" if np.isfinite(p.low) else "  undetermined")
        for p in (*found.parameters, *([found.volume] if found.volume else []))
    ]
    top.text(0.985, 0.04, "\n".join(lines), transform=top.transAxes, ha="right", va="bottom", fontsize=8)
    top.legend(loc="upper left", fontsize=8, frameon=False)
    bottom.legend(loc="best", fontsize=8, frameon=False)
    top.set_ylabel("height" + of_survey)
    middle.set_ylabel("change of height")
    bottom.set_ylabel("measured - fitted")
    bottom.set_xlabel("x" + of_survey)
    bottom.set_xlim(x[0], x[-1])
    return figure


def pictures(run: Run) -> dict[str, bytes | str]:
    """Name -> PNG."""
    return {"profile.png": _png(draw_profiles(run)), "diagram.png": _png(draw_diagram(run))}


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return buffer.getvalue()


def _figure(width: float, height: float, run: Run | None = None) -> Figure:
    """With margins that suit the axes of a run: to find them out would cost as much as the drawing."""
    figure = Figure(figsize=(width, height), layout=None if run else "constrained")
    FigureCanvasAgg(figure)
    if run:
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
