"""docs/figures/inverse.png and the numbers of §19: `python tests/benchmarks/paper_inverse.py`."""

import sys
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.solvers.closed_forms import closed_form
from hjprofile.solvers.inverse.inverse_levels import InverseSolution

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from oracles import SteepPair

FIGURE = Path(__file__).parents[2] / "docs" / "figures" / "inverse.png"
LAW = hj.expression("q + q/(1+q)", growth="linear")
POSITIONS, AMPLITUDES = [-3.0, -2.5], [3.0, 5.0]
CELLS = 250, 500, 1000, 2000, 4000
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"
STYLES = {
    "inverse": (ORANGE, "o"), "godunov": (GREEN, "s"), "telescoping": (GREEN, "s"), "conservative": (BLUE, "^"),
    "fronts": (GREY, "d"),
}  # fmt: skip


def solved(method, problem, left, n):
    """The run of a method with n cells, levels or fronts."""
    grid = hj.Grid(left, n)
    if method == "inverse":
        return hj.solve_inverse(problem, grid)
    if method == "fronts":
        return hj.track_fronts(problem, hj.Grid(left, 2000), n)
    return (hj.solve_conservative if method == "conservative" else hj.solve_hj)(problem, grid, method)


def measured(name, problem, left, methods, exact, cells=CELLS):
    """Errors ‖u - u_exact‖₁ at the end and seconds of each method; `exact` maps positions to u."""
    found = {}
    for method in methods:
        numbers = cells if method != "fronts" else (50, 100, 200)
        runs = [
            min((solved(method, problem, left, n) for _ in range(2)), key=lambda r: r.wall_seconds) for n in numbers
        ]
        away = [float(np.abs(r.u[-1] - exact(r.x)).sum()) * float(np.ptp(r.x)) / r.cells for r in runs]
        found[method] = numbers, away, [r.wall_seconds for r in runs]
        print(
            f"{name}, {method}: order {hj.observed_order(numbers, away):.2f};",
            "; ".join(f"{n}: {e:.2g} in {r.wall_seconds:.2g} s, {r.steps} steps"
                      for n, e, r in zip(numbers, away, runs, strict=True)),
        )  # fmt: skip
    return found


def steps_of_two_kinks():
    """Position and height of the vertical step, and the events."""
    exact = SteepPair(POSITIONS, AMPLITUDES, 3.0)
    problem = hj.Problem(LAW, hj.kinks(POSITIONS, AMPLITUDES), end=1.5, snapshots=[0.0, 0.5, 0.9, 1.2, 1.5])
    runs = [hj.solve_inverse(problem, hj.Grid(-4.0, n)) for n in CELLS]
    for i, t in ((1, 0.5), (2, 0.9), (3, 1.2)):
        x, height = exact.step(t)
        off = [[s.x - x, s.height - height] for s in (r.steps_at(i)[0] for r in runs)]
        orders = [hj.observed_order(CELLS, np.abs(column)) for column in np.transpose(off)]
        print(f"step at t = {t}: orders {orders[0]:.2f} {orders[1]:.2f}, finest {off[-1][0]:.2g} {off[-1][1]:.2g}")
    for n, run in zip(CELLS, runs, strict=True):
        print(n, [(e.event, e.kink, round(e.time - t, 5)) for e, t in
                  zip(run.events, (exact.blow_up, exact.merge, exact.leave), strict=False)])  # fmt: skip


def statements():
    """Bressan and Shen: x is Lipschitz continuous in u, x_u has bounded variation, the solution depends on the data."""
    for name, profile, left in (
        ("two kinks", hj.kinks(POSITIONS, AMPLITUDES), -4.0),
        ("bump and hollow", hj.bumps([4.0, -0.8], [-2.0, -3.5], [0.25, 0.4]), -6.0),
    ):
        problem = hj.Problem(LAW, profile, end=1.2, snapshots=25)
        solution = InverseSolution(problem, hj.Grid(left, 2000), 2000)
        steepest, variation = [], []
        for t in problem.times:
            solution.advance(t)
            z = np.diff(solution.levels.x[: solution.n + 1]) / solution.spacing
            steepest.append(z.max())
            variation.append(np.abs(np.diff(z)).sum())
        print(f"{name}: max x_u {steepest[0]:.5f} -> at most {max(steepest):.5f};"
              f" TV(x_u) {variation[0]:.4f} -> at most {max(variation):.4f}")  # fmt: skip
    one = hj.solve_inverse(hj.Problem(LAW, hj.kinks(POSITIONS, AMPLITUDES), 0.9, 19), hj.Grid(-4.0, 2000), 4000)
    for change in (0.1, 0.01, 0.001):
        near = hj.kinks(POSITIONS, [AMPLITUDES[0], AMPLITUDES[1] * (1.0 + change)])
        other = hj.solve_inverse(hj.Problem(LAW, near, 0.9, 19), hj.Grid(-4.0, 2000), 4000)
        apart = np.abs(one.u - other.u).mean(axis=1) * 4.0
        print(
            f"amplitude {change} larger: distance of u in L1 {apart[0]:.2g}, at most {apart.max() / apart[0]:.2f} times"
        )


def draw(axes, found, title, label, seconds=False):
    for method, (numbers, away, time) in found.items():
        colour, marker = STYLES[method]
        axes.loglog(time if seconds else numbers, away, marker=marker, color=colour, ms=4, lw=1.2, label=method)
    axes.set_title(title, fontsize=9, loc="left")
    axes.set_xlabel(label)
    if not seconds:
        axes.set_xticks(CELLS, [str(n) for n in CELLS])
        axes.minorticks_off()
    axes.legend(fontsize=7, frameon=False)


def main():
    kink = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.2]), end=1.5, snapshots=2)
    form = closed_form(kink)
    three = hj.Problem(hj.log(), hj.kinks([-6.0, -5.0, -3.0], [0.5, 1.2, 3.0]), end=1.5, snapshots=2)
    pair = hj.Problem(LAW, hj.kinks(POSITIONS, AMPLITUDES), end=0.9, snapshots=2)
    bump = hj.Problem(LAW, hj.bumps([4.0], [-2.0], [0.25]), end=0.2, snapshots=2)

    def by_fronts(problem, left):
        """The solution by 1600 fronts, which is exact for kinks, at the nodes of all grids."""
        run = hj.track_fronts(problem, hj.Grid(left, CELLS[-1]))
        return lambda x: run.u[-1, :: CELLS[-1] // (x.size - 1)]

    grids = ("inverse", "godunov", "conservative")
    steep = ("inverse", "telescoping", "conservative")
    measured("travelling kink", kink, -5.0, grids, partial(form.u, 1.5))
    first = measured("three kinks, log law", three, -8.0, grids, by_fronts(three, -8.0))
    second = measured("vertical step of two kinks", pair, -4.0, steep, by_fronts(pair, -4.0))
    third = measured("vertical step of a bump", bump, -4.0, (*steep, "fronts"), by_fronts(bump, -4.0))
    steps_of_two_kinks()
    statements()
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    draw(axes[0], first, "three kinks, law ln(1+q)", "cells")
    draw(axes[1], second, "vertical step of two kinks", "cells")
    draw(axes[2], third, "vertical step of a bump", "seconds", seconds=True)
    axes[0].set_ylabel("‖u - u_exact‖₁ at the end")
    figure.savefig(FIGURE, dpi=130)


if __name__ == "__main__":
    main()
