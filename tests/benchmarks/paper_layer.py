"""docs/figures/slow_erosion.png, supply_histories.png, and numbers of §15: `python tests/benchmarks/paper_layer.py`."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

import hjprofile as hj

LAYER_METHOD = "conservative-telescoping"

FIGURES = Path(__file__).parents[2] / "docs" / "figures"
GRID = hj.Grid(-10.0, 2000)
BUMPS = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5])
SCENES = {  # name -> profile, end, colour and marker (Okabe and Ito)
    "smooth: bump and hollow, t = 0.5": (BUMPS, 0.5, "#0072B2", "o"),
    "travelling kink, t = 3": (hj.kinks([-6.0], [1.0]), 3.0, "#D55E00", "s"),
    "bump and hollow after births, t = 2": (BUMPS, 2.0, "#009E73", "^"),
}
SHOWN = 0.4, 0.2, 0.1, 0.05
THICKNESSES = 0.4, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002
HISTORIES = {  # name -> supply flux of size e as a function of the supplied mass, colour and marker
    "constant": ("{e}", "#0072B2", "o"),
    "pulses": ("{e}*(1 + 0.9*sin(6*t))", "#D55E00", "s"),
    "most of it early": ("{e}*2*exp(-t)", "#009E73", "^"),
}
SIZES = 0.08, 0.04, 0.02, 0.01, 0.005, 0.0025


def problem_of(profile, end, supply_flux=0.0):
    return hj.Problem(hj.rational(), profile, end=end, snapshots=1, supply_flux=supply_flux)


def thick_layers():
    """When the kink of amplitude 1 that starts at -6 leaves, below layers with any supply flux."""
    for supply_flux in (0.0, 0.05, 0.2, 0.5, 1.0, 2.0):
        problem = replace(problem_of(hj.kinks([-6.0], [1.0]), 25.0, supply_flux), snapshots=201)
        run = hj.solve_conservative(problem, GRID, LAYER_METHOD)
        (exit_time,) = [e.time for e in run.events if e.event == "exit"]
        starts = next((k.time for k in run.kinks if k.x > -5.95), np.nan)
        jumps = [k.jump for k in run.kinks if k.x > -0.5]
        print(
            f"supply_flux {supply_flux:g}: leaves at t = {exit_time:.3f}, jump {np.mean(jumps):.3f}, has moved by "
            f"0.05 at t = {starts:.3f}; steps {run.steps}"
        )


def histories():
    """Slopes below layers with several histories of the supply: their distances from the limit and from each other."""
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=[0.8, 1.1, 1.0])
    for title in ("bump and hollow after births, t = 2", "travelling kink, t = 3"):
        profile, end, *_ = SCENES[title]
        problem, slopes = problem_of(profile, end), {}
        for name, (text, colour, marker) in HISTORIES.items():
            fluxes = [text.format(e=e) for e in SIZES]
            _, *thin = hj.slow_erosion(problem, GRID, fluxes)
            distances = [d.slope_l1 for d in thin]
            slopes[name] = [
                hj.solve_conservative(problem_of(profile, end, flux), GRID, LAYER_METHOD).q for flux in fluxes
            ]
            report(f"{title}: {name}", distances)
            if end == 2.0:
                right.loglog(
                    SIZES, distances, marker, color=colour, ms=5, lw=1.0, ls="-", label=f"{name}: from the limit"
                )
        for one, other in combinations(HISTORIES, 2):
            pairs = zip(slopes[one], slopes[other], strict=True)
            apart = [GRID.dx * np.abs(a[-1] - b[-1]).sum() for a, b in pairs]
            report(f"{title}: {one} to {other}", apart)
            if end == 2.0:
                right.loglog(
                    SIZES,
                    apart,
                    ".",
                    color="0.45",
                    lw=0.8,
                    ls="--",
                    label="between two" if one == "constant" and other == "pulses" else None,
                )
    t, (profile, end, *_) = np.linspace(0.0, 2.0, 401), SCENES["bump and hollow after births, t = 2"]
    for name, (text, colour, _) in HISTORIES.items():
        flux = problem_of(profile, end, text.format(e=1.0)).supply
        left.plot(t, flux.values(t), color=colour, lw=1.3, label=name)
        run = hj.solve_conservative(problem_of(profile, end, text.format(e=SIZES[0])), GRID, LAYER_METHOD)
        middle.plot(GRID.centres, 1 + run.q[-1], color=colour, lw=1.2, label=name)
    limit = hj.solve_conservative(problem_of(profile, end), GRID, LAYER_METHOD)
    middle.plot(GRID.centres, 1 + limit.q[-1], color="k", lw=1.2, ls="--", label="limit: slow erosion")
    left.set(xlabel="t: supplied mass of grains", ylabel="supply flux ε(t) over its size", ylim=(0.0, 2.6))
    left.set_title("histories of the supply", fontsize=9, loc="left")
    middle.set(xlim=(-8.0, 0.0), xlabel="x", ylabel="slope p = $u_x$")
    middle.set_title(f"slopes at t = {end:g} for the size {SIZES[0]:g}", fontsize=9, loc="left")
    right.loglog([0.0025, 0.08], [0.003, 0.096], color="0.5", lw=1.0, ls=":", label="order 1")
    right.set(xlabel="size of the supply flux", ylabel="∫ |p - p of the other| dx", xlim=(0.0019, 0.13))
    right.xaxis.set_minor_formatter(NullFormatter())
    right.grid(alpha=0.25, lw=0.5)
    for axes in (left, middle, right):
        axes.legend(fontsize=7.5, frameon=False)
    figure.savefig(FIGURES / "supply_histories.png", dpi=130)


def report(what, distances):
    """Print distances for SIZES, and their order over the last four."""
    order = hj.observed_order([1 / e for e in SIZES[-4:]], distances[-4:])
    print(f"{what}: order {order:.2f}; {', '.join(f'{d:.3g}' for d in distances)}")


def main():
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    profile, end, *_ = SCENES["bump and hollow after births, t = 2"]
    left.plot(GRID.centres, 1 + profile.q_means(GRID, hj.rational()), color="0.7", lw=1.0, ls="--", label="at first")
    for supply_flux, shade in zip(SHOWN, np.linspace(0.12, 0.82, len(SHOWN)), strict=True):
        run = hj.solve_conservative(problem_of(profile, end, supply_flux), GRID, LAYER_METHOD)
        left.plot(
            GRID.centres, 1 + run.q[-1], color=colormaps["viridis"](1.0 - shade), lw=1.2, label=f"{supply_flux:g}"
        )
    limit = hj.solve_conservative(problem_of(profile, end), GRID, LAYER_METHOD)
    left.plot(GRID.centres, 1 + limit.q[-1], color="k", lw=1.4, label="limit: slow erosion")
    left.set(xlim=(-8.0, 0.0), xlabel="x", ylabel="slope p = $u_x$")
    left.set_title(f"slopes at t = {end:g} below layers with supply flux ...", fontsize=9, loc="left")
    left.legend(fontsize=8, frameon=False)
    for name, (profile, end, colour, marker) in SCENES.items():
        _, *thin = hj.slow_erosion(problem_of(profile, end), GRID, THICKNESSES)
        d = np.array([row[:3] for row in thin])
        right.loglog(d[:, 0], d[:, 1], marker, color=colour, ms=5, lw=1.0, ls="-", label=name)
        few = d[:, 0] <= 0.05
        order = [np.polyfit(np.log(d[few, 0]), np.log(d[few, i]), 1)[0] for i in (1, 2)]
        print(f"{name}: orders {order[0]:.3f} in L1(q), {order[1]:.3f} in sup|u|; steps {[row.steps for row in thin]}")
        print("   ", ", ".join(f"{t:g}: {a:.4g}, {b:.4g}" for t, a, b in d))
    right.loglog([0.002, 0.1], [0.008, 0.4], color="0.5", lw=1.0, ls=":", label="order 1")
    right.set(xlabel="supply flux ε", ylabel="∫ |p - p of the limit| dx")
    right.legend(fontsize=8, frameon=False)
    right.grid(alpha=0.25, lw=0.5)
    figure.savefig(FIGURES / "slow_erosion.png", dpi=130)
    histories()
    thick_layers()


if __name__ == "__main__":
    main()
