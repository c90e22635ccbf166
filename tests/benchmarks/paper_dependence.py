"""docs/figures/dependence.png, lipschitz.png, and numbers of §9: `python tests/benchmarks/paper_dependence.py`."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.output.plots.study_pictures import dependence_picture
from hjprofile.studies.dependence import distances_of, solve_together, summary
from hjprofile.studies.proved_constant import proof

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from random_profiles import from_means, random_pair

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"
SHOWN = "breaking_bump"
GRID = hj.Grid(-10.0, 400)
LAWS = {  # name -> law, colour and marker (Okabe and Ito)
    "rational": (hj.rational(), "#0072B2", "o"),
    "log": (hj.log(), "#D55E00", "s"),
    "power, m = 2": (hj.power(2.0), "#009E73", "^"),
    "0.3 (√(1+q) - 1/√(1+q))": (hj.expression("0.3*(sqrt(1+q) - 1/sqrt(1+q))"), "#CC79A7", "D"),
}
PAIRS = 50  # of each law
END = 2.0


def random_pairs(law, seed):
    """Return, for random pairs, the smallest L over the saved times, that of the proof, and the attained shares."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(PAIRS):
        q, p = random_pair(rng, law, GRID)
        one, two = solve_together(from_means(law, GRID, q, END), from_means(law, GRID, p, END), GRID)
        bounds = proof(law, one.q[0], two.q[0], GRID.dx)
        distance, apart = GRID.dx * np.abs(one.q - two.q).sum(axis=1), one.K - two.K
        observed = (np.log(distance[1:] / distance[0]) / one.time[1:]).max()
        f = [law.f(path.q) for path in (one, two)]
        shares = [
            (np.abs(apart).max(axis=1) / distance).max() / bounds.coefficient,
            (np.abs(np.diff(apart, axis=1)).sum(axis=1) / distance).max() / bounds.coefficient / (1.0 + bounds.norm),
            min(np.abs(values).max() for values in f) / bounds.size,
            min(np.abs(np.diff(values, axis=1)).sum(axis=1).max() for values in f) / bounds.variation,
        ]
        found.append((observed, bounds.constant, *shares))
    return np.array(found)


def lipschitz():
    """Draw the measured constants of random pairs against those of the proof."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes, everything = figure.subplots(), []
    for seed, (name, (law, colour, marker)) in enumerate(LAWS.items()):
        found = random_pairs(law, seed)
        everything.append(found)
        expands = found[:, 0] > 1e-4
        axes.loglog(found[expands, 1], found[expands, 0], marker, color=colour, ms=4, alpha=0.8, label=name)
        contracts = found[~expands, 1]
        axes.plot(contracts, np.full(contracts.size, 1.3e-4), marker, color=colour, ms=4, mfc="none", alpha=0.6)
        share = (found[:, 0] / found[:, 1]).max()
        print(f"{name}: {expands.sum()} of {PAIRS} pairs move apart; measured L / proved L at most {share:.2g}")
    found = np.concatenate(everything)
    names = ("sup|k - l|", "TV(k - l)", "sup|f(p)|", "TV(f(p))")
    shares = ", ".join(f"{n} {s:.2f}" for n, s in zip(names, found[:, 2:].max(axis=0), strict=True))
    print(f"largest share of each bound of the proof: {shares}")
    (low, proved_low), (high, proved_high) = found[:, :2].min(axis=0), found[:, :2].max(axis=0)
    print(f"L from {low:.2g} to {high:.2g}, proved from {proved_low:.2g} to {proved_high:.2g}")
    axes.loglog([1e-2, 10.0], [1e-2, 10.0], color="0.3", lw=1.2, ls="--", label="equal")
    axes.set(xlabel="L of the proof, from the data alone", ylabel="smallest L of the pair, measured", ylim=(1e-4, 20.0))
    axes.set_title("random pairs of slopes; open: pairs that do not move apart", fontsize=9, loc="left")
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.25, lw=0.5)
    figure.savefig(FIGURES / "lipschitz.png", dpi=130)


def main():
    for name in ("breaking_bump", "two_kinks", "deposit", "log_law", "hillslope"):
        case = hj.load_case(name)
        distances = distances_of(name, case.problem, case.grid)
        print(name, *summary(distances)[0], sep="\n  ")
        if name == SHOWN:
            (FIGURES / "dependence.png").write_bytes(dependence_picture(distances))
    lipschitz()


if __name__ == "__main__":
    main()
