"""Long runs beside the bounds that hold for all times: draws docs/figures/global_bounds.png (§6)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj

FIGURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "global_bounds.png"
SPREADS = np.geomspace(0.02, 4.0, 25)  # δ
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "0.35"


def crest(axes):
    """q at the crest of each kink, and the one bound for all times."""
    law, positions, amplitudes = hj.rational(), [-9.0, -7.0, -5.0], [0.3, 0.8, 1.6]
    problem = hj.Problem(law, hj.kinks(positions, amplitudes), end=8.5, snapshots=171)
    run = hj.track_fronts(problem, hj.Grid(-10.0, 2000))
    bound = float(np.max(law.R(np.array(amplitudes)) + problem.profile.W(np.array(positions), law))) - 1.0
    axes.axhline(bound, color=GREY, ls="--", lw=1.2, label="bound for all times")
    for number, colour in zip((3, 2, 1), (GREEN, ORANGE, BLUE), strict=True):
        t, q = np.array([(k.time, k.q_right) for k in run.kinks if k.kink == number]).T
        axes.plot(t, q, color=colour, lw=1.6, label=f"crest of kink {number}")
    axes.set(
        xlabel="supplied mass t", ylabel="q right of the kink", title="three kinks become one", ylim=(0, 1.1 * bound)
    )
    axes.legend(fontsize=8, frameon=False, loc="center right")


def decay(axes):
    """The hillslope until it is flat."""
    case = hj.load_case("hillslope")
    run = hj.track_fronts(replace(case.problem, end=32.0, snapshots=641), hj.Grid(case.grid.left, 4000))
    q = run.q
    rows = (
        ("‖q‖₁", run.x_cell[1] - run.x_cell[0], np.abs(q).sum(axis=1), BLUE),
        ("sup q", 1.0, q.max(axis=1), ORANGE),
        ("|inf q|", 1.0, -q.min(axis=1), GREEN),
        ("TV(q)", 1.0, np.abs(np.diff(q, axis=1, prepend=0.0)).sum(axis=1), GREY),
    )
    for name, factor, values, colour in rows:
        shown = np.where(values > 1e-6, factor * values, np.nan)
        axes.semilogy(run.time, shown, color=colour, lw=1.6, label=name)
    flat = float(run.time[np.argmax(np.abs(q).max(axis=1) < 1e-6)])
    axes.axvline(flat, color="0.6", lw=0.8, ls=":")
    axes.set(xlabel="supplied mass t", title=f"the hillslope, neutral at t = {flat:.2f}", ylim=(1e-3, 40))
    axes.legend(fontsize=8, frameon=False, loc="lower left")
    return flat


def factor(axes):
    """ln K(left) of one mass as it is spread, as a part of its bound."""
    shares = []
    for delta in SPREADS:
        length = 2.0 / delta
        problem = hj.Problem(hj.rational(), hj.steps([-length - 1.0, -1.0], [delta]), end=0.2, snapshots=2)
        run = hj.track_fronts(problem, hj.Grid(-length - 2.0, 1000))
        shares.append(np.log(run.K[:, 0]).max() / 2.0)
    axes.semilogx(SPREADS, shares, color=BLUE, lw=1.6, label="run")
    axes.semilogx(SPREADS, 1.0 / (1.0 + SPREADS), ".", color=ORANGE, ms=5, label="1/(1+δ)")
    axes.axhline(1.0, color=GREY, ls="--", lw=1.2, label="bound for all times")
    axes.set(xlabel="slope δ over which a mass of 2 is spread", title="ln K / (f'(0) ‖q‖₁)", ylim=(0, 1.08))
    axes.legend(fontsize=8, frameon=False, loc="lower left")


def main():
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    first, second, third = figure.subplots(1, 3)
    crest(first)
    print(f"the hillslope is flat at t = {decay(second):.2f}")
    factor(third)
    for axes in (first, second, third):
        axes.grid(alpha=0.25, lw=0.5)
    figure.savefig(FIGURE, dpi=150)


if __name__ == "__main__":
    main()
