"""docs/figures/vertical_step.png and the numbers of §11: `python tests/benchmarks/paper_growth.py`."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.solvers.grids import hamilton_jacobi as hj_form
from hjprofile.solvers.grids.kernels.sweep_law import Tabulated
from hjprofile.solvers.grids.march import march
from hjprofile.solvers.methods import FLUXES, METHODS

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from oracles import SteepPair, bump_blow_up, isotonic_profile, longest_step

FIGURE = Path(__file__).parents[2] / "docs" / "figures" / "vertical_step.png"
LAW = hj.expression("q + q/(1+q)", growth="linear")
POSITIONS, AMPLITUDES, LEFT = [-3.0, -2.5], [3.0, 5.0], -4.0
BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"


def pair(end, snapshots=2):
    return hj.Problem(LAW, hj.kinks(POSITIONS, AMPLITUDES), end=end, snapshots=snapshots)


def picture(exact):
    times = [0.0, 0.2, exact.blow_up, 0.45, 0.7, 1.0]
    fine = hj.track_fronts(pair(1.0, times), hj.Grid(LEFT, 8000))
    path = hj.track_fronts(pair(1.25, 126), hj.Grid(LEFT, 400)).vertical_steps
    first = hj.solve_hj(pair(1.25, 26), hj.Grid(LEFT, 2000), "telescoping").vertical_steps
    second = hj.solve_conservative(pair(1.25, 26), hj.Grid(LEFT, 2000)).vertical_steps
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.7, 1, 1])
    for i, t in enumerate(times):
        shade = 0.4 + 0.5 * t / exact.blow_up
        before = t <= exact.blow_up
        left.plot(
            fine.x, fine.u[i], color=(BLUE if before else ORANGE), alpha=shade if before else 0.4 + 0.6 * t, lw=1.4
        )
    for label, colour in (("before the blow-up, and at it", BLUE), ("after it", ORANGE)):
        left.plot([], [], color=colour, label=label)
    left.set(xlim=(-3.2, 0.0), ylim=(-3.2, 0.8), xlabel="x", ylabel="height u")
    left.legend(fontsize=8, frameon=False, loc="upper left")
    left.set_title("a slope breaks into a step", fontsize=9, loc="left")
    t = np.linspace(exact.blow_up, 1.25, 60)[1:]
    known = np.array([exact.step(one) for one in t])
    for axes, k, name in ((middle, 0, "place of the step"), (right, 1, "its height")):
        axes.plot([s.time for s in path], [s[2 + k] for s in path], color=ORANGE, lw=2.2, label="fronts")
        axes.plot(t, known[:, k], color="k", lw=1.2, ls=(0, (2, 3)), label="x as a function of u")
        for marker, colour, label, steps in (
            ("s", GREEN, "telescoping, 2000 cells", first),
            ("o", BLUE, "conservative, 2000 cells", second),
        ):
            axes.plot(
                [s.time for s in steps],
                [s[2 + k] for s in steps],
                marker,
                ms=3.5,
                mfc="white",
                color=colour,
                label=label,
            )
        axes.set_xlabel("t")
        axes.set_title(name, fontsize=9, loc="left")
    middle.legend(fontsize=7, frameon=False)
    figure.savefig(FIGURE, dpi=130)


def wrong_speeds():
    """How far from its place a step ends under fluxes that are refused, by the W of its middle."""
    end = 0.8
    problem = hj.Problem(LAW, hj.bumps([2.0], [-2.5], [0.4]), end=end, snapshots=2)
    step = hj.track_fronts(problem, hj.Grid(-5.0, 400), 3200).vertical_steps[-1]
    print(f"a bump at t = {end}: a step {step.height:.5f} high at x = {step.x:.5f}")
    for name in ("telescoping", "telescoping, second-order growth of K", "godunov", "local-lax-friedrichs"):
        off = []
        for cells in (500, 1000, 2000, 4000):
            grid = hj.Grid(-5.0, cells)
            scheme = METHODS["telescoping"].setup.scheme(problem, grid, None)
            if name in FLUXES:
                scheme = hj_form.HamiltonJacobi(scheme.law, grid, scheme.W, FLUXES[name])
            elif "second" in name:
                scheme.law = replace(scheme.law, kernel=Tabulated(*scheme.law.kernel))
            W = march(scheme, problem, grid, 0.9).W[-1]
            off.append(float(np.interp(0.5 * step.height, W, grid.nodes)) - step.x)
        print(f"| {name} | " + " | ".join(f"{o:.4f}" for o in off) + " |")


def numbers(exact):
    run = hj.track_fronts(pair(3.0, 61), hj.Grid(LEFT, 400))
    times = (exact.blow_up, exact.merge, exact.leave)
    print("two kinks: blow-up, merge, exit", times, [e.time - t for e, t in zip(run.events, times, strict=True)])
    apart = np.array([np.subtract(s[2:4], exact.step(s.time)) for s in run.vertical_steps])
    print("largest errors of place and height by fronts", np.abs(apart).max(axis=0))
    t, cells = 0.9, [int(600 * 8 ** (i / 11)) for i in range(12)]
    for method in ("conservative-telescoping", "conservative"):
        places, heights = [], []
        for n in cells:
            (step,) = hj.solve_conservative(pair(t), hj.Grid(LEFT, n), method).steps_at(-1)
            places.append(abs(step.x - exact.step(t)[0]))
            heights.append(abs(step.height - exact.step(t)[1]))
        log = np.log(4.0 / np.array(cells) * np.log(np.array(cells) / 4.0))
        print(
            f"{method}, t = {t}, {cells[0]} to {cells[-1]} cells: orders in dx of place "
            f"{hj.observed_order(cells, places):.2f}, "
            f"height {hj.observed_order(cells, heights):.2f}; of the place in dx ln(1/dx) "
            f"{np.polyfit(log, np.log(places), 1)[0]:.2f}; finest errors {places[-1]:.2g} {heights[-1]:.2g}"
        )
    problem = hj.Problem(LAW, hj.bumps([2.0], [-2.5], [0.4]), end=0.8, snapshots=2)
    step = hj.track_fronts(problem, hj.Grid(-5.0, 400), 3200).vertical_steps[-1]
    runs = [hj.solve_conservative(problem, hj.Grid(-5.0, n)).steps_at(-1)[-1] for n in (500, 1000, 2000, 4000)]
    print("bump, conservative: errors of", [(round(s.x - step.x, 4), round(s.height - step.height, 4)) for s in runs])
    breaks = bump_blow_up(4.0, 0.25)[0]
    bump, end = hj.bumps([4.0], [-2.0], [0.25]), breaks + 0.15
    for n in (200, 400, 800, 1600):
        run = hj.track_fronts(hj.Problem(LAW, bump, end=end, snapshots=2), hj.Grid(-4.0, 400), n)
        time = next(e.time for e in run.events if e.event == "blow-up")
        s = run.vertical_steps[-1]
        print(f"bump, {n} fronts: blow-up off by {time - breaks:.2g} of {breaks:.10f}; {run.wall_seconds:.2g} s")
        print(f"    the step at x = {s.x:.6f}, {s.height:.6f} high")
    steps = [longest_step(*isotonic_profile(lambda x: bump.W(x, LAW), -4.0, end, n)) for n in (2000, 4000, 8000)]
    print(
        "scheme in u, 2000 to 8000 cells:",
        steps,
        "extrapolated",
        2 * steps[2][0] - steps[1][0],
        2 * steps[2][1] - steps[1][1],
    )


def main():
    exact = SteepPair(POSITIONS, AMPLITUDES, 3.0)
    picture(exact)
    numbers(exact)
    wrong_speeds()


if __name__ == "__main__":
    main()
