"""docs/figures/whole_line.png, and numbers of §10: `python tests/benchmarks/paper_line.py`."""

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.solvers.closed_forms import closed_form

FIGURE = Path(__file__).parents[2] / "docs" / "figures" / "whole_line.png"
GRID = hj.Grid(-8.0, 2000, right=6.0)
BLUE, RED = "#0072B2", "#D55E00"


def problem_of(profile, end, snapshots, line="whole"):
    return hj.Problem(hj.rational(), profile, end=end, snapshots=snapshots, line=line)


def table():
    """Errors of the travelling wave by method and grid: L1(u), mean over the saved times."""
    problem = problem_of(hj.kinks([-3.0], [1.2]), 6.0, 7)
    exact, cells = closed_form(problem), (500, 1000, 2000, 4000)
    for name in ("local-lax-friedrichs", "godunov", "conservative", "fronts", "characteristics"):
        errors = []
        for n in cells:
            grid = hj.Grid(-6.0, n, right=4.0)
            if name in ("fronts", "characteristics"):
                run = (hj.track_fronts if name == "fronts" else hj.solve_characteristics)(problem, grid)
            else:
                run = (hj.solve_conservative if name == "conservative" else hj.solve_hj)(problem, grid, name)
            off = [grid.dx * np.abs(run.u[i] - exact.u(t, run.x)).sum() for i, t in enumerate(run.time)]
            errors.append(np.mean(off))
        print(f"{name}: {errors[2]:.2g} on 2000 cells, order {hj.observed_order(cells, errors):.2f}")


def main():
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    run = hj.track_fronts(problem_of(hj.kinks([-7.0, -4.5], [0.8, 2.0]), 10.0, 6), GRID)
    for i, t in enumerate(run.time):
        left.plot(run.x_cell, run.q[i], color=colormaps["viridis"](0.9 * i / 5), lw=1.3, label=f"t = {t:g}")
    left.set(xlabel="x", ylabel="excess slope q", xlim=(-8.0, 6.0))
    left.set_title("two kinks on the whole line become one wave", fontsize=9, loc="left")
    left.legend(fontsize=8, frameon=False)
    for amplitude, style in ((0.5, "-"), (2.0, "--")):
        kink = hj.kinks([-7.0], [amplitude])
        whole = hj.track_fronts(problem_of(kink, 13.0, 53), GRID)
        half = hj.track_fronts(problem_of(hj.kinks([-13.0], [amplitude]), 26.0, 105, "half"), hj.Grid(-14.0, 2000))
        for one, colour, moved, name in ((whole, BLUE, 0.0, "whole line"), (half, RED, 6.0, "half line x <= 6")):
            t, x = np.array([(k.time, k.x + moved) for k in one.kinks]).T
            if one is whole and style == "--":
                colour = "k"
            right.plot(t, x, color=colour, ls=style, lw=1.4, label=f"{name}, amplitude {amplitude:g}")
    right.axhline(6.0, color="0.7", lw=0.8)
    right.set(xlabel="t: supplied mass of grains", ylabel="position of the kink", xlim=(0.0, 16.0))
    right.set_title("one kink: the same speed f'(0) for each amplitude", fontsize=9, loc="left")
    right.legend(fontsize=8, frameon=False, loc="lower right")
    right.grid(alpha=0.25, lw=0.5)
    figure.savefig(FIGURE, dpi=130)
    table()


if __name__ == "__main__":
    main()
