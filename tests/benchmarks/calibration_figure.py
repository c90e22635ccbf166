"""How often a fit's intervals hold the truth, on 100 synthetic surveys: docs/figures/fit.png (docs/calibration.md)."""

import tempfile
import tomllib
from pathlib import Path

import numpy as np
import tomli_w
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.special import stdtrit

import hjprofile as hj

ROOT = Path(__file__).resolve().parents[2]
TRUTH = {"time.end": 3.0, "profile.critical_slope": 0.257, "erosion.m": 1.5}
START = {"time.end": 2.0, "profile.critical_slope": 0.3, "erosion.m": 1.0}
SIGMA, POINTS, TRIALS, BOTH = 0.5, 60, 100, 20  # metres; trials with noise after, and in both surveys
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
    """What a survey without noise would find, from four times as many fronts as a fit takes."""
    case = hj.load_case(path, {"time.snapshots": 1})
    run = hj.track_fronts(case.problem, hj.Grid(case.grid.left, 40000), 3200)
    return np.interp(x, run.units.x(run.x), run.units.height(run.u[-1]))


def trials(folder, number, before=0.0, seed=0):
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
        found = hj.fit(hillslope(folder, START, survey), x, measured, list(TRUTH))
        rows.append(
            [
                np.log(p.value / true) / (0.5 * np.log(p.high / p.low))
                for p, true in zip((*found.parameters, found.volume), (*TRUTH.values(), volume), strict=True)
            ]
        )
    return np.array(rows)


def say(name, rows):
    """Coverage of each, and the spread in standard errors, which should be 1."""
    print(f"{name}: {len(rows)} trials")
    reach = stdtrit(POINTS - len(TRUTH), 0.975)
    for label, column in zip((*TRUTH, "supplied_volume"), rows.T, strict=True):
        inside = np.count_nonzero(np.abs(column) <= 1.0)
        mean, spread = reach * column.mean(), reach * column.std()
        print(f"  {label:23} in {inside:3} of {len(rows)}; mean {mean:+.2f}, spread {spread:.2f} standard errors")


def one_fit(axes, folder):
    """How far the slope has moved: surveyed, and by the fit."""
    x = np.linspace(0.0, 2536.09, POINTS)
    measured = survey_after(hillslope(folder, TRUTH), x) + SIGMA * np.random.default_rng(2).standard_normal(x.size)
    found = hj.fit(hillslope(folder, START), x, measured, list(TRUTH))
    fine, before, after = found.curve
    axes.plot(fine, after - before, color=BLUE, lw=1.4, label="fitted")
    axes.plot(
        found.x, found.measured - np.interp(x, fine, before), "o", ms=3.5, mfc="white", mec=ORANGE, label="measured"
    )
    axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    axes.set(xlabel="x (m)", ylabel="change of height (m)", xlim=(0.0, x[-1]))
    axes.set_title("one of the fits", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False, loc="lower left")


def coverage(axes, rows):
    """Every trial's error beside its interval."""
    axes.axhspan(-1.0, 1.0, color="0.92", lw=0)
    for place, column in enumerate(rows.T):
        inside = np.abs(column) <= 1.0
        at = place + np.linspace(-0.36, 0.36, len(column))
        axes.plot(at[inside], column[inside], "o", ms=3, color=BLUE, mew=0)
        axes.plot(at[~inside], column[~inside], "D", ms=4.5, color=ORANGE, mew=0)
        axes.text(place, 2.2, f"{np.count_nonzero(inside)} of {len(column)}", ha="center", fontsize=9)
    axes.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    axes.set_xticks(range(4), ["poured mass", "critical slope", "m", "poured volume"])
    axes.set(ylim=(-2.5, 2.5), ylabel="(fitted - true) in halves of the interval")
    axes.set_title("95 % intervals: truth inside (circles), outside (diamonds)", loc="left", fontsize=10)


def main():
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[2, 3])
    with tempfile.TemporaryDirectory() as folder:
        one_fit(left, folder)
        rows = trials(folder, TRIALS)
        coverage(right, rows)
        figure.savefig(ROOT / "docs" / "figures" / "fit.png", dpi=150)
        say("noise after, sigma from the residuals", rows)
        say("noise in both surveys", trials(folder, BOTH, before=SIGMA, seed=1))


if __name__ == "__main__":
    main()
