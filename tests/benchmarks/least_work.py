"""Seconds of `auto` against the best fixed choice by hindsight: prints the table of docs/theory.md, draws its picture.

    python tests/benchmarks/least_work.py

Every fixed choice (fronts, characteristics, the second-order grid) is run at a ladder of resolutions, and `auto` at
each tolerance, in turns; seconds are processor seconds of the whole call, import and compilation apart, medians of
three. The best fixed choice is the fastest whose true error is within the tolerance: it knows what `auto` has to find.
"""

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
from known_heights import truth
from random_scenes import grid_of, random_scene

import hjprofile as hj

FIGURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "least_work.png"
TOLERANCES = [10.0**-k for k in range(2, 10)]
FRONTS = 32, 64, 100, 200, 300, 400, 600, 800, 1200, 1600, 2400, 3200, 4800
CHARACTERISTICS = 1e-6, 1e-8, 1e-10, 1e-12
CELLS = 250, 1000
SHIPPED = "breaking_bump", "deposit", "hillslope", "steady_slope", "two_kinks", "user_law"
RANDOM = 4, 7  # seeds of random scenes
REPEATS, PATIENCE = 3, 0.7  # seconds after which a ladder is not climbed further
BLUE, ORANGE = "#0072B2", "#D55E00"


def measured(solve):
    """u and the processor seconds of a call, or None where it fails."""
    started = time.process_time()
    try:
        run = solve()
    except hj.RunError:
        return None
    return (run, time.process_time() - started) if run.done else None


def ladders(problem, grid):
    """The fixed choices: each a list of calls from coarse to fine."""
    if not problem.profile.inflow:
        yield [partial(hj.track_fronts, problem, grid, n) for n in FRONTS]
        yield [partial(hj.solve_characteristics, problem, grid, e) for e in CHARACTERISTICS]
    yield [partial(hj.solve_conservative, problem, hj.Grid(grid.left, n)) for n in CELLS]


def compare(problem, grid):
    """(tolerance, seconds of auto, seconds of the best fixed choice, method) for each tolerance."""
    exact, known = truth(problem, grid)
    calls = {
        tolerance: partial(hj.solve, problem, tolerance, grid) for tolerance in TOLERANCES if tolerance > 10 * known
    }
    fixed = []
    for ladder in ladders(problem, grid):
        for call in ladder:
            found = measured(call)
            if found is None:
                continue
            run, seconds = found
            at = [np.interp(grid.nodes, run.x, row) for row in run.u]
            fixed.append((call, float(np.abs(np.array(at) - exact).max()), [seconds]))
            if seconds > PATIENCE:
                break
    auto = {tolerance: [] for tolerance in calls}
    methods = {}
    for _ in range(REPEATS):
        for tolerance, call in calls.items():
            run, seconds = measured(call)
            auto[tolerance].append(seconds)
            methods[tolerance] = run.method
        for call, _, seconds in fixed:
            if min(seconds) < PATIENCE and len(seconds) < REPEATS:
                seconds.append(measured(call)[1])
    rows = []
    for tolerance in calls:
        best = min((float(np.median(s)) for _, error, s in fixed if error <= tolerance), default=np.nan)
        rows.append((tolerance, float(np.median(auto[tolerance])), best, methods[tolerance]))
    return rows


def scenes():
    """Name -> problem and grid."""
    for name in SHIPPED:
        case = hj.load_case(name)
        yield name, case.problem, case.grid
    for seed in RANDOM:
        problem = random_scene(np.random.default_rng([1, seed]))
        yield f"random {seed}: {type(problem.profile).__name__.lower()}, {problem.law.name}", problem, grid_of(problem)


def draw(found):
    figure = Figure(figsize=(11.0, 1.9 * -(-len(found) // 4)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(-(-len(found) // 4), 4, sharex=True, squeeze=False).ravel()
    for ax, (name, rows) in zip(axes, found.items(), strict=False):
        tolerance, auto, best, _ = zip(*rows, strict=True)
        ax.loglog(tolerance, best, color=ORANGE, marker="s", ms=4, lw=1.2, label="best fixed choice")
        ax.loglog(tolerance, auto, color=BLUE, marker="o", ms=4, lw=1.6, label="auto")
        ax.set_title(name, fontsize=9)
        ax.set(xlim=(2e-2, 5e-10), ylim=(2e-3, 2e1), xticks=[1e-2, 1e-4, 1e-6, 1e-8])
        ax.grid(color="0.9", lw=0.6)
        ax.minorticks_off()
    for ax in axes[len(found) :]:
        ax.set_visible(False)
    axes[0].legend(fontsize=8, frameon=False, loc="upper left")
    figure.supxlabel("tolerance on u", fontsize=10)
    figure.supylabel("seconds", fontsize=10)
    figure.savefig(FIGURE, dpi=110)


def main():
    warm = hj.Problem(hj.log(), hj.bumps([1.0, -0.4], [-4.0, -2.0], [0.5, 0.5]), end=1.0)
    for problem in (warm, hj.Problem(hj.rational(), warm.profile, end=1.0)):
        hj.solve_characteristics(problem), hj.solve(problem, 1e-3), hj.solve_conservative(problem, hj.Grid(-8.0, 200))
        hj.track_fronts(hj.Problem(problem.law, hj.kinks([-3.0, -2.0], [0.5, 1.0]), end=1.0))
    found = {}
    chosen = {"fronts": "f", "characteristics": "c", "closed form": "e"}
    print("| scene | " + " | ".join(f"{t:.0e}" for t in TOLERANCES).replace("e-0", "e-") + " |")
    print("|---" * (len(TOLERANCES) + 1) + "|")
    for name, problem, grid in scenes():
        rows = found[name] = compare(problem, grid)
        cells = [f"{a:.2g} ({a / b:.1f}) {chosen.get(m, m)}" for _, a, b, m in rows]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
    ratios = np.array([a / b for rows in found.values() for _, a, b, _ in rows])
    print(
        f"ratio: median {np.nanmedian(ratios):.2f}, largest {np.nanmax(ratios):.2f}, {np.mean(ratios <= 3):.1%} up to 3"
    )
    draw(found)


if __name__ == "__main__":
    main()
