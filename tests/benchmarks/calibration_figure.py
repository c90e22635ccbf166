"""How often a fit's intervals hold the truth, on 100 synthetic surveys: docs/figures/fit.png (docs/calibration.md)."""

import tempfile
import tomllib
from pathlib import Path

import numpy as np
import tomli_w
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj

ROOT = Path(__file__).resolve().parents[2]
TRUTH = {"time.end": 3.0, "profile.critical_slope": 0.257, "erosion.m": 1.5}
START = {"time.end": 2.0, "profile.critical_slope": 0.3, "erosion.m": 1.0}
SIGMA, POINTS, TRIALS = 0.5, 60, 100  # metres
LENGTH = 200.0
BLUE, ORANGE = "#0072B2", "#D55E00"


def hillslope(folder, values, survey=None):
    """A case file of the hillslope with the power law and those values; its survey may be replaced."""
    content = tomllib.loads((ROOT / "cases" / "hillslope.toml").read_text(encoding="utf-8"))
    del content["expect"]
    content["erosion"] = {"law": "power", "m": 1.0}
    content["profile"] |= {"file": str(survey or ROOT / "cases" / "hillslope.csv"), "repair": "isotonic"}
    for dotted, value in values.items():
        section, key = dotted.split(".")
        content[section][key] = value
    path = Path(folder) / "hillslope.toml"
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    return path


def survey_after(path, x):
    """What a survey without noise would find, from twice as many fronts as a run takes."""
    case = hj.load_case(path, {"time.snapshots": 1})
    run = hj.track_fronts(case.problem, hj.Grid(case.grid.left, 40000), 3200)
    return np.interp(x, run.units.x(run.x), run.units.height(run.u[-1]))


def trials(folder, number, sigma=None, before=0.0, seed=0):
    """(value - truth)/half the interval, in logarithms, of each parameter and of the volume: shape (number, 4)."""
    random = np.random.default_rng(seed)
    x = np.linspace(0.0, 2536.09, POINTS)
    exact = survey_after(hillslope(folder, TRUTH), x)
    bx, bh, _ = hj.read_survey(ROOT / "cases" / "hillslope.csv")
    volume = TRUTH["time.end"] * TRUTH["profile.critical_slope"] * LENGTH**2
    rows = []
    for _ in range(number):
        survey = Path(folder) / "before.csv"
        heights = bh + before * random.standard_normal(bh.size)
        survey.write_text(
            "x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in zip(bx.tolist(), heights.tolist(), strict=True))
        )
        measured = exact + SIGMA * random.standard_normal(x.size)
        found = hj.fit(hillslope(folder, START, survey), x, measured, list(TRUTH), sigma)
        rows.append(
            [
                np.log(p.value / true) / (0.5 * np.log(p.high / p.low))
                for p, true in zip((*found.parameters, found.volume), (*TRUTH.values(), volume), strict=True)
            ]
        )
        print(len(rows), np.round(rows[-1], 2), f"rms {found.rms:.3f}", found.evaluations, flush=True)
    return np.array(rows)


def say(name, rows):
    """Coverage of each, and the spread in standard errors, which should be 1."""
    print(f"{name}: {len(rows)} trials")
    for label, column in zip((*TRUTH, "poured_volume"), rows.T, strict=True):
        inside = np.count_nonzero(np.abs(column) <= 1.0)
        mean, spread = 1.96 * column.mean(), 1.96 * column.std()
        print(f"  {label:23} in {inside:3} of {len(rows)}; mean {mean:+.2f}, spread {spread:.2f} standard errors")


def main():
    with tempfile.TemporaryDirectory() as folder:
        rows = trials(folder, TRIALS)
        say("noise after, sigma from the residuals", rows)
        say("noise in both surveys", trials(folder, 20, before=SIGMA, seed=1))
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.axhspan(-1.0, 1.0, color="0.92", lw=0)
    for place, column in enumerate(rows.T):
        inside = np.abs(column) <= 1.0
        at = place + np.linspace(-0.36, 0.36, len(column))
        axes.plot(at[inside], column[inside], "o", ms=3, color=BLUE, mew=0)
        axes.plot(at[~inside], column[~inside], "D", ms=4.5, color=ORANGE, mew=0)
        axes.text(place, 1.72, f"{np.count_nonzero(inside)} of {len(column)}", ha="center", fontsize=9)
    axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    axes.set_xticks(range(4), [*TRUTH, "poured volume"])
    axes.set(ylim=(-2.0, 2.0), ylabel="(fitted - true)\nin halves of the 95 % interval")
    axes.set_title("the truth inside the 95 % interval (circles) and outside (diamonds)", loc="left", fontsize=10)
    figure.savefig(ROOT / "docs" / "figures" / "fit.png", dpi=150)


if __name__ == "__main__":
    main()
