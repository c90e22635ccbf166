"""docs/figures/slow_erosion.png, and the numbers of §15: `python tests/benchmarks/paper_layer.py`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj

LAYER_METHOD = "conservative-telescoping"

FIGURE = Path(__file__).parents[2] / "docs" / "figures" / "slow_erosion.png"
GRID = hj.Grid(-10.0, 2000)
BUMPS = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5])
SCENES = {  # name -> profile, end, colour and marker (Okabe and Ito)
    "smooth: bump and hollow, t = 0.5": (BUMPS, 0.5, "#0072B2", "o"),
    "travelling kink, t = 3": (hj.kinks([-6.0], [1.0]), 3.0, "#D55E00", "s"),
    "bump and hollow after births, t = 2": (BUMPS, 2.0, "#009E73", "^"),
}
SHOWN = 0.4, 0.2, 0.1, 0.05
THICKNESSES = 0.4, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002


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
    figure.savefig(FIGURE, dpi=130)
    thick_layers()


if __name__ == "__main__":
    main()
