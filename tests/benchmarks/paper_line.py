"""docs/figures/whole_line.png, wave_stability.png, and numbers of §10: `python tests/benchmarks/paper_line.py`."""

import sys
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.solvers.closed_forms import closed_form

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from travelling_waves import distances, excess, excess_by_invariant, kinks, smooth, wave_with_bump

FIGURES = Path(__file__).parents[2] / "docs" / "figures"
GRID = hj.Grid(-8.0, 2000, right=6.0)
BLUE, RED = "#0072B2", "#D55E00"
MASS = 1.5  # of every perturbed wave
PERTURBED = {  # name -> profile, colour
    "three kinks": (kinks(hj.rational(), [-3.0, -1.6, 0.0], [0.2, 0.4], MASS), BLUE),
    "bump ahead of the kink": (wave_with_bump(hj.rational(), MASS, 1.2, 0.3), RED),
    "hollow ahead of the kink": (wave_with_bump(hj.rational(), MASS, 1.2, -0.3), "#009E73"),
    "bump behind the kink": (wave_with_bump(hj.rational(), MASS, -1.5, 0.5), "#CC79A7"),
    "hollow behind the kink": (wave_with_bump(hj.rational(), MASS, -1.5, -0.5), "#E69F00"),
}
SMOOTH = {  # name -> law, decay b, colour
    "rational, b = 20": (hj.rational(), 20.0, BLUE),
    "rational, b = 0.6": (hj.rational(), 0.6, RED),
    "log, b = 20": (hj.log(), 20.0, "#009E73"),
    "log, b = 2, as the wave": (hj.log(), 2.0, "k"),
    "power 3, b = 2": (hj.power(3.0), 2.0, "#CC79A7"),
}
LATE = (2.5, 5.0, 10.0, 20.0, 40.0, 80.0)


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


def by_both(law, profile, times, grid):
    """Yield the runs by fronts and by `conservative`."""
    problem = hj.Problem(law, profile, end=times[-1], snapshots=list(times), line="whole")
    for method in ("fronts", "conservative"):
        run = hj.track_fronts(problem, grid, 3000) if method == "fronts" else hj.solve_conservative(problem, grid)
        assert run.done
        yield method, run


def wave_stability():
    """Draw the distance from the wave for perturbations of bounded extent, and the rate for smooth data."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    times = np.linspace(0.0, 8.0, 81)
    for name, (profile, colour) in PERTURBED.items():
        for method, run in by_both(hj.rational(), profile, times, hj.Grid(-4.0, 4000, right=29.0)):
            in_q, in_u = distances(hj.rational(), MASS, run)
            fronts = method == "fronts"
            left.semilogy(times, in_q, color=colour, lw=1.4 if fronts else 0.8, ls="-" if fronts else ":",
                          label=name if fronts else None)  # fmt: skip
            gone = times[np.flatnonzero(in_q > 0.01)[-1] + 1]
            print(f"{name}, {method}: at t = 0 {in_q[0]:.3f}, {in_u[0]:.3f}; below 0.01 from t = {gone:.1f} on; "
                  f"at the end {in_q[-1]:.1e}, {in_u[-1]:.1e}")  # fmt: skip
    left.set(xlabel="t: supplied mass of grains", ylabel="‖q - q_wave‖₁, minimum over shifts", ylim=(1e-7, 2.0))
    left.set_title("rational law: gone in finite time (dotted: conservative)", fontsize=9, loc="left")
    for name, (law, b, colour) in SMOOTH.items():
        grid = hj.Grid(-2.0, 8000, right=80.0 * float(law.derivative(np.array(0.0))) + 30.0 / min(b, 1.0))
        for method, run in by_both(law, smooth(MASS, b), LATE, grid):
            found = np.abs(excess(law, MASS, run))
            in_q, in_u = distances(law, MASS, run)
            fill = colour if method == "fronts" else "none"
            right.loglog(LATE, found, "o", color=colour, mfc=fill, ms=4 if method == "fronts" else 8)
            print(f"{name}, {method}: t |R - R(A)| {found * LATE}")
            print(f"    t ‖q - q_wave‖₁ {in_q * LATE}, t ‖u - u_wave‖_∞ {in_u * LATE}")
        arrive, predicted = excess_by_invariant(
            law, MASS, lambda x, b=b: 2 * b * MASS * np.exp(-b * x) * -np.expm1(-b * x),
            lambda x, b=b: MASS * np.expm1(-b * x) ** 2, np.linspace(np.log(3.0), 14.0, 80) / b,
        )  # fmt: skip
        right.loglog(arrive, np.abs(predicted), color=colour, lw=1.0, label=name)
        print(f"{name}, by the invariant: {np.interp(np.log(LATE), np.log(arrive), np.abs(predicted)) * LATE}")
    right.set(
        xlabel="t: supplied mass of grains", ylabel="|R(q⁺) - R(A)| of the kink", xlim=(2.0, 100.0), ylim=(1e-5, 3.0)
    )
    right.set_title("smooth data: lines from I, dots fronts, circles conservative", fontsize=9, loc="left")
    for axes in (left, right):
        axes.legend(fontsize=7.5, frameon=False, loc="lower left" if axes is right else "upper right")
        axes.grid(alpha=0.25, lw=0.5)
    figure.savefig(FIGURES / "wave_stability.png", dpi=130)


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
    figure.savefig(FIGURES / "whole_line.png", dpi=130)
    wave_stability()
    table()


if __name__ == "__main__":
    main()
