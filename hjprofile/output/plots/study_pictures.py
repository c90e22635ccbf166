"""Pictures of studies: error against run time, stability, dependence, a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, NullFormatter

from hjprofile.output.plots import style
from hjprofile.output.plots.style import DEPOSITED, ERODED, new_figure, png
from hjprofile.problem.units import UNNAMED
from hjprofile.solvers.methods import METHODS
from hjprofile.studies.calibration import Calibration
from hjprofile.studies.chart import Chart
from hjprofile.studies.dependence import Distance, largest_distances, observed_constant
from hjprofile.studies.stability import FAILS, HOLDS, LOSES, OSCILLATES, Trial

# Okabe and Ito's colours, distinguishable without green and red. The fluxes that a form takes over share its colour and
# are drawn lightly. The order is that of the table of methods.
_PALETTE = (
    ("#999999", "o"), ("#E69F00", "o"), ("#56B4E9", "o"), ("#CC79A7", "o"), ("#009E73", "s"), ("#000000", "D"),
    ("#0072B2", "s"), ("#D55E00", "^"), ("#B8A800", "*"), ("#882255", "v"),
)  # fmt: skip
_DRAWN = [method.name for method in METHODS.values() if not method.carries and not method.needs_tolerance]
_LOOKS = dict(zip(_DRAWN, _PALETTE, strict=True))


@style.defaults
def chart_picture(charts: Sequence[Chart]) -> bytes:
    """Return the PNG of `draw_chart`."""
    return png(draw_chart(charts))


@style.defaults
def draw_chart(charts: Sequence[Chart]) -> Figure:
    """Draw error against run time, a row for each case: sup|u| on the left, ∫|q| on the right with its Pareto front."""
    figure = new_figure(10.0, 4.6 * len(charts))
    rows = figure.subplots(len(charts), 2, squeeze=False)
    letters = iter("abcdefghijklmnopqrstuvwxyz" * len(charts))
    for chart, row in zip(charts, rows, strict=True):
        points, reference = chart.points, chart.reference
        for axes, error, label in zip(
            row,
            ("error_u_sup", "error_q_l1"),
            (
                "$\\Vert u - u_{exact}\\Vert_\\infty$, largest of all saved times",
                "$\\Vert q - q_{exact}\\Vert_1$, largest of all saved times",
            ),
            strict=True,
        ):
            for method in dict.fromkeys(p.method for p in points):
                mine = [(p.seconds, max(getattr(p, error), 1e-16)) for p in points if p.method == method]
                carried = METHODS[method].carries
                colour, marker = _LOOKS[carried or method]
                light = {"alpha": 0.35, "mfc": "none", "ls": ":"} if carried else {}
                name = "the same flux, conservative-..." if carried else method
                known = name in axes.get_legend_handles_labels()[1]
                (line,) = axes.loglog(*np.array(mine).T, color=colour, marker=marker, ms=4, lw=1.0, **light)
                line.set_label("_" if known else name)
            axes.set_xlabel("run time of the time stepping (s)")
            axes.set_ylabel(label)
            axes.grid(alpha=0.25, lw=0.5)
            least = reference.error if error == "error_u_sup" else reference.error_q
            if least > 0.0:
                axes.axhline(least, color="0.5", lw=0.8, ls="--", label="error of the reference")
        front = chart.pareto
        row[1].step(
            [p.seconds for p in front], [max(p.error_q_l1, 1e-16) for p in front],
            where="post", color="0.25", lw=4.0, alpha=0.25, marker="o", ms=9, label="Pareto front",
        )  # fmt: skip
        row[0].set_title(f"({next(letters)}) {chart.case}", loc="left", fontweight="bold", parse_math=False)
        row[1].set_title(f"({next(letters)})", loc="left", fontweight="bold")
        against = f"reference: {reference.name}"
        if reference.error > 0.0:
            against += f",\nerror of u {reference.error:.0e}, of q {reference.error_q:.0e}"
        row[1].set_title(against, loc="right", fontsize=8, color="0.35")
    handles, labels = rows[0][1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    return figure


_OUTCOMES = {HOLDS: ("#0072B2", "o"), LOSES: ("#E69F00", "s"), OSCILLATES: ("#CC79A7", "D"), FAILS: ("#000000", "X")}
_AXES = {  # parameter -> title, logarithmic
    "cfl": ("CFL number Δt max(K f')/Δx", False),
    "viscosity": ("viscosity α / max(K f') at CFL number ...", False),
    "refresh": ("time steps with one K", True),
    "reconstruction": ("edge values (K and fluxes upwind)", False),
    "least 1 + q": ("inf (1 + q), in a hollow", True),
    "largest |ln K|": ("largest |ln K| = |∫ f dx|", True),
    "left end": ("left end of the grid (exchange lengths)", False),
}


@style.defaults
def stability_picture(trials: Sequence[Trial]) -> bytes:
    """Return the PNG of `draw_stability`."""
    return png(draw_stability(trials))


@style.defaults
def draw_stability(trials: Sequence[Trial]) -> Figure:
    """Draw a panel for each parameter, a row for each method, a symbol for each outcome, and the theoretical limit as a
    line.
    """
    panels: dict[str, list[Trial]] = {}
    for trial in trials:
        panels.setdefault("viscosity" if np.isfinite(trial.cfl) else trial.parameter, []).append(trial)

    def row_of(trial: Trial) -> str:
        return f"{trial.cfl:g}" if np.isfinite(trial.cfl) else trial.method

    figure = new_figure(11.0, 10.5)
    places = figure.subplot_mosaic(
        [["cfl", "viscosity"], ["least 1 + q", "largest |ln K|"], ["refresh", "reconstruction"], ["left end", "key"]],
        height_ratios=[7, 7, 2.2, 2.2],
    )
    letters = dict(zip((name for name in places if name in panels), "abcdefg", strict=False))
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
                axes.plot([1.0 / trial.cfl] * 2, [y - 0.4, y + 0.4], color="0.3", lw=1.2, ls=":")
            elif np.isfinite(trial.theory):
                axes.plot([trial.theory] * 2, [y - 0.4, y + 0.4], color="0.3", lw=1.2)
        if logarithmic:
            axes.set_xscale("log")
        if words:
            axes.set_xticks(range(len(words)), words)
            axes.set_xlim(-0.5, len(words) - 0.5)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_title(f"({letters[parameter]}) {title}", fontsize=10, loc="left")
        axes.grid(axis="x", alpha=0.25, lw=0.5)
    key = places["key"]
    key.axis("off")
    names = {
        HOLDS: "holds",
        LOSES: "violates a bound",
        OSCILLATES: "oscillates",
        FAILS: "fails: q reaches -1, or no progress",
    }
    for outcome, (colour, marker) in _OUTCOMES.items():
        key.plot([], [], marker, color=colour, ms=6, mew=0, label=names[outcome])
    key.plot([], [], color="0.3", lw=1.2, label="proved limit, for any data")
    key.plot([], [], color="0.3", lw=1.2, ls=":", label="α = Δx/Δt")
    key.legend(loc="center", fontsize=9, frameon=False)
    figure.suptitle(f"Limits of stability: {trials[0].case}", fontsize=12, x=0.01, ha="left", parse_math=False)
    return figure


@style.defaults
def dependence_picture(distances: Sequence[Distance]) -> bytes:
    """Return the PNG of `draw_dependence`."""
    return png(draw_dependence(distances))


_SHADES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")  # of the sizes of a disturbance


@style.defaults
def draw_dependence(distances: Sequence[Distance]) -> Figure:
    """Draw a panel for each study: distances over time, or the largest distances against the size of a disturbance."""
    studies: dict[str, list[Distance]] = {}
    for d in distances:
        studies.setdefault(d.study, []).append(d)
    figure = new_figure(10.0, 7.6)
    axes = dict(zip(("data", "zero", "coefficient", "refresh"), figure.subplots(2, 2).flat, strict=True))
    _draw_growth(axes, studies, max(d.time for d in distances))
    names = {
        "coefficient": ("(c) coefficients k and k(1 + δ ...)", "relative disturbance δ", "largest ‖q - q̃‖₁"),
        "refresh": ("(d) K frozen over fractional steps", "fractional step Δt (supplied mass)", "mean ‖q - q̃‖₁"),
    }
    for study, (title, label, distance) in names.items():
        panel = axes[study]
        panel.set_title(title, loc="left", fontsize=10)
        if study not in studies:
            panel.text(
                0.5, 0.5, "not applicable: the coefficient is constant in time", ha="center", transform=panel.transAxes
            )
            panel.set_axis_off()
            continue
        size, largest = np.array(list(largest_distances(distances, study).values())).T
        least = size == size.min()
        for each in largest.reshape(-1, least.sum()).T:
            panel.loglog(np.unique(size)[::-1], each, ".-", color=_SHADES[0], ms=5, lw=0.8, alpha=0.8)
        if study == "refresh":
            kinks = np.array(list(largest_distances(distances, "refresh kinks").values()))
            if kinks.size:
                other = panel.twinx()
                other.loglog(*kinks.T, ".-", color=_SHADES[1], ms=5, lw=0.8)
                other.set_ylabel("mean distance of kinks (exchange lengths)", color=_SHADES[1])
        panel.loglog(size, largest[least].mean() * size / size.min(), color="0.3", lw=1.2, ls="--", label="first order")
        panel.set_xticks(np.unique(size), [f"{value:.3g}" for value in np.unique(size)])
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_xlabel(label)
        panel.set_ylabel(distance, color=_SHADES[0])
        panel.grid(alpha=0.25, lw=0.5)
    for panel in axes.values():
        if panel.lines:
            panel.legend(fontsize=8, frameon=False)
    figure.suptitle(f"Continuous dependence: {distances[0].case}", fontsize=12, x=0.01, ha="left", parse_math=False)
    return figure


def _draw_growth(axes: Mapping[str, Axes], studies: Mapping[str, Sequence[Distance]], end: float) -> None:
    """Draw the distances of pairs of slopes, and of slopes and the neutral slope, over time."""
    for study in ("data", "zero"):
        mine, panel = studies[study], axes[study]
        sizes = np.array([[d.member, d.size] for d in studies["data"]])
        rank = {m: int(np.log10(sizes[sizes[:, 0] == m, 1][0])) for m in np.unique(sizes[:, 0])}
        shades = dict(zip(sorted(set(rank.values())), _SHADES, strict=False))
        for member in dict.fromkeys(d.member for d in mine):
            t, y = np.array([(d.time, d.distance / d.size) for d in mine if d.member == member]).T
            panel.plot(t, np.where(y > 1e-3, y, np.nan), color=shades[rank[member]], lw=0.9, alpha=0.7)
        panel.set_xlabel("supplied mass t")
        panel.grid(alpha=0.25, lw=0.5)
    L = observed_constant(studies["data"])
    t = np.linspace(0.0, end, 200)
    axes["data"].set_yscale("log")
    axes["data"].yaxis.set_major_formatter(LogFormatter(minor_thresholds=(2.0, 0.5)))
    axes["data"].yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2.0, 0.5)))
    low, high = axes["data"].get_ylim()
    axes["data"].plot(t, np.exp(L * t), color="0.3", lw=1.2, ls="--", label=f"$e^{{Lt}}$, L = {L:.3g}")
    axes["data"].set_ylim(low, 1.5 * high)
    axes["data"].set_title("(a) two slopes", loc="left", fontsize=10)
    for rank_, shade in shades.items():
        axes["data"].plot([], [], color=shade, label=f"‖q - q̃‖₁(0) about {10.0**rank_:g}")
    axes["data"].set_ylabel("‖q - q̃‖₁(t) / ‖q - q̃‖₁(0)")
    axes["zero"].set_ylabel("‖q‖₁(t) / ‖q‖₁(0)")
    axes["zero"].axhline(1.0, color="0.3", lw=1.2, ls="--", label="L = 0")
    axes["zero"].set_title("(b) a slope and the neutral slope (colours as in a)", loc="left", fontsize=10)


def fit_picture(found: Calibration) -> bytes | str:
    """Return the PNG of `draw_fit`."""
    return style.encode(draw_fit(found), "png")


@style.styled
def draw_fit(found: Calibration) -> Figure:
    """Draw both surveys with the fitted profile, the change of height, and the residuals."""

    def written(value: float) -> str:
        return style.amount(value) if value >= 1000.0 else f"{value:.4g}"

    lines = [
        f"{p.name} = {written(p.value)}, "
        + (f"{written(p.low)} to {written(p.high)} (95 %)" if np.isfinite(p.low) else "undetermined")
        for p in (*found.parameters, *([found.volume] if found.volume else []))
    ]
    figure = style.sheet(found.title, lines, 1, 4.9, right=0.16)
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    x, before, after = found.curve
    order = np.argsort(x)  # a survey may rise to the left
    start = np.interp(found.x, x[order], before[order])
    points = style.DOT | {"ls": "none", "mec": ERODED, "label": "measured after"}
    keys = top.plot(x, before, color=style.PALE, lw=0.8, ls=(0, (4, 2)), label="before")
    keys += top.plot(x, after, color=DEPOSITED, lw=1.1, label="fitted after")
    keys += top.plot(found.x, found.measured, **points)
    middle.plot(x, after - before, color=DEPOSITED, lw=1.1)
    middle.plot(found.x, found.measured - start, **points)
    wide = 1.96 * found.sigma
    keys.append(bottom.axhspan(-wide, wide, color="0.9", lw=0, label="±1.96 σ"))
    bottom.plot(found.x, found.measured - found.modelled, **points)
    for axes in (middle, bottom):
        axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    style.legend_above(figure, keys)
    profile = found.case["profile"]
    unit = f" ({profile.get('unit') or UNNAMED})" if profile["kind"] == "survey" else ""
    top.set_ylabel(f"height{unit or ' u'}")
    for axes, words in ((middle, "change of height"), (bottom, "measured - fitted")):
        axes.set_ylabel(words + unit.replace(" (", "\n("))
    style.axis_of_x(bottom, x, f"x{unit or ' (exchange lengths)'}")
    style.letter_panels([top, middle, bottom])
    figure.align_ylabels([top, middle, bottom])
    return figure
