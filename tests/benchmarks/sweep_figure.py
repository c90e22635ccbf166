"""docs/figures/sweep.png, and what a second worker gains: `python tests/benchmarks/sweep_figure.py` in some minutes."""

import os
import tempfile
import time
from pathlib import Path

import numpy as np

import hjprofile as hj
from hjprofile.output.workers import processes
from hjprofile.studies.sweep import members, run_member

FIGURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "sweep.png"
EXPONENTS = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0]
ENDS = [0.5 * i for i in range(1, 9)]
VARY = {"erosion.law": ["power"], "domain.cells": [4800], "erosion.m": EXPONENTS, "time.end": ENDS}
PAIRS = 3  # of one worker and two, in turn: a machine on which other programs run is not the same a minute later
TINY = {"domain.cells": [100], "time.end": [0.01], "solver.cfl": list(np.linspace(0.1, 0.9, 200))}


def timed(workers, vary, case="hillslope", folder=None):
    """Seconds of a whole sweep as the command makes it: workers are begun, members kept, files written.

    Then those of processors, of this process and of the workers: what other programs do on the machine does not count.
    """
    before = os.times()
    with tempfile.TemporaryDirectory() as somewhere:
        started = time.perf_counter()
        with processes(workers) as executor:
            result = hj.sweep(case, vary, executor, folder or somewhere)
        seconds = time.perf_counter() - started
    assert all(outcome.done for outcome in result.outcomes)
    after = os.times()
    own, theirs = (sum(after[i : i + 2]) - sum(before[i : i + 2]) for i in (0, 2))
    return seconds, own, theirs, result


def speed():
    """Prints what two workers gain, and what a member costs beside its run; returns the sweep."""
    seconds = {1: [], 2: []}
    for _ in range(PAIRS):
        for workers, times in seconds.items():
            taken, own, theirs, result = timed(workers, VARY)
            times.append(taken)
            print(
                f"{workers} workers: {taken:.1f} s; of processors {own:.1f} s here and {theirs:.1f} s in workers",
                flush=True,
            )
    ratios = [one / two for one, two in zip(*seconds.values(), strict=True)]
    print(
        f"two workers are faster by {max(ratios):.2f} (best of {PAIRS} pairs: {', '.join(f'{r:.2f}' for r in ratios)})"
    )
    made = members("two_kinks", TINY)
    alone, swept = [], []
    for _ in range(2):
        started = time.perf_counter()
        for member in made:
            run_member(member)
        alone.append(time.perf_counter() - started)
        swept.append(timed(1, TINY, "two_kinks")[0] - timed(1, {**TINY, "solver.cfl": [0.5]}, "two_kinks")[0])
    print(
        f"{len(made)} small members: {1e3 * min(alone) / len(made):.1f} ms each as calls, "
        f"{1e3 * min(swept) / len(made):.1f} ms each in a sweep of one worker"
    )
    return result


def draw(result):
    """Relief lost over exponent and volume poured in; change of height for three exponents."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    units = hj.load_case("hillslope").problem.profile.units
    lost = result.quantity("crest_lowering")[0, 0].T * units.length * units.critical_slope
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    poured = np.array(ENDS) * units.volume / 1e3
    levels = left.contourf(EXPONENTS, poured, lost, 12, cmap="cividis")
    lines = left.contour(EXPONENTS, poured, lost, levels.levels[1::2], colors="white", linewidths=0.6)
    left.clabel(lines, fontsize=7, fmt="%g")
    left.plot(*(a.ravel() for a in np.meshgrid(EXPONENTS, poured)), ".", color="white", ms=2.5, clip_on=False)
    left.set(xlabel="exponent m of the law", ylabel="poured in (1000 m³/m)", title="relief lost (m)")
    figure.colorbar(levels, ax=left)
    before = result.x + hj.load_case("hillslope").problem.profile.W(result.x, hj.rational())
    for m, colour in zip((0.25, 1.0, 4.0), ("#0072B2", "#E69F00", "#D55E00"), strict=True):
        outcome = result.outcomes[result.values.index(("power", 4800, m, 3.0))]
        height = (outcome.u - before) * units.length * units.critical_slope
        right.plot(units.x_top + units.length * result.x, height, color=colour, lw=1.4, label=f"m = {m:g}")
    right.axhline(0.0, color="0.6", lw=0.8)
    right.set(xlabel="distance (m)", ylabel="change of height (m)", title=f"after {3 * units.volume:.0f} m³/m")
    right.legend(fontsize=8, frameon=False)
    right.grid(alpha=0.25, lw=0.5)
    figure.savefig(FIGURE, dpi=130)


def main():
    draw(speed())


if __name__ == "__main__":
    main()
