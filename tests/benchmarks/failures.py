"""The pictures and the tables of docs/stability.md: `python tests/benchmarks/failures.py` writes them anew."""

import time
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import hjprofile as hj
from hjprofile.output.plots.study_pictures import stability_picture
from hjprofile.solvers.grids import hamilton_jacobi as hj_form
from hjprofile.solvers.methods import FLUXES
from hjprofile.solvers.run import Breakdown
from hjprofile.studies import stability as study

DOCS = Path(__file__).parents[2] / "docs"
GOOD, BAD, WORSE = "#0072B2", "#D55E00", "#CC79A7"
KINK = hj.Problem(hj.rational(), hj.kinks([-6.0], [1.0]), end=3.0)


def data_of(problem, left, cells=400):
    grid = hj.Grid(left, cells)
    q = np.diff(problem.profile.W(grid.nodes, problem.law)) / grid.dx
    return study._Data(problem, grid, q, problem.end)


def march(scheme, data, number, end):
    """Steps of one CFL number; returns x, q and the steps that were taken."""
    t, steps = 0.0, []
    with np.errstate(all="ignore"):
        try:
            while t < end:
                fastest = scheme.evaluate()
                steps.append((t, number * data.grid.dx / fastest))
                before = scheme.q.copy()
                scheme.advance(min(steps[-1][1], end - t), 1, fastest)
                t += steps[-1][1]
        except Breakdown:
            return data.grid.centres, before, steps
    return data.grid.centres, scheme.q.copy(), steps


def picture(name, curves, title, x=None, y="q", x_label="x"):
    figure = Figure(figsize=(7.0, 2.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for (a, b), colour, label in curves:
        axes.plot(a, b, color=colour, lw=1.2, label=label)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y)
    if x:
        axes.set_xlim(*x)
    else:
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.set_title(title, loc="left", fontsize=9)
    axes.legend(fontsize=8, frameon=False)
    figure.savefig(DOCS / "figures" / f"failure_{name}.png", dpi=120)


def pictures():
    data = data_of(KINK, -10.0)

    def run(number, end, **options):
        return march(study._Laboratory(data, **options), data, number, end)[:2]

    def noisy(number, end):
        scheme = hj_form.HamiltonJacobi(data.law, data.grid, data.W, FLUXES["godunov"])
        study._roughen(scheme, study.SAWTOOTH)
        return march(scheme, data, number, end)[:2]

    picture("cfl", [(noisy(0.9, 1.2), GOOD, "CFL number 0.9"), (noisy(1.1, 1.2), BAD, "1.1")],
            "godunov, t = 1.2", (-8.0, -3.5))  # fmt: skip
    lf = {"flux": "lax-friedrichs"}
    picture("viscosity", [(run(0.45, 0.5, **lf, viscosity=1.0), GOOD, "α = max K f'"),
                          (run(0.45, 0.5, **lf, viscosity=0.5), BAD, "half of it"),
                          (run(0.45, 0.5, **lf, viscosity=0.1), WORSE, "a tenth")],
            "lax-friedrichs, t = 0.5", (-7.0, -3.0))  # fmt: skip
    picture("refresh", [(run(0.6, 2.0), GOOD, "K anew each step"), (run(0.6, 2.0, refresh=64), WORSE, "each 64 steps"),
                        (run(0.6, 2.0, refresh=256), BAD, "each 256 steps")],
            "godunov, t = 2", (-6.5, 0.0))  # fmt: skip
    picture("reconstruction", [(run(0.3, 0.5, edges="limited"), GOOD, "limited"),
                               (run(0.3, 0.5, edges="unlimited"), WORSE, "unlimited"),
                               (run(0.3, 0.5, edges="central"), BAD, "central")],
            "second order in space, upwind, t = 0.5", (-7.0, -3.0))  # fmt: skip
    curves = []
    for p, colour in ((0.1, GOOD), (1e-2, WORSE), (1e-3, BAD)):
        hollow = data_of(hj.Problem(hj.rational(), hj.steps([-3.0, -2.0], [p - 1.0]), end=1.0), -4.0)
        scheme = hj_form.HamiltonJacobi(hollow.law, hollow.grid, hollow.W, FLUXES["godunov"])
        steps = np.array(march(scheme, hollow, 0.9, 1.0)[2][1:])
        curves.append((steps.T, colour, f"1 + q = {p:g}: {len(steps)} steps"))
    picture("hollow", curves, "godunov: time steps in a hollow with q near -1, 400 cells", y="Δt", x_label="t")
    curves = []
    for most, colour in ((1e2, GOOD), (1e6, WORSE), (1e12, BAD)):
        width = np.log(most) / (5.0 / 6.0)
        block = data_of(hj.Problem(hj.rational(), hj.steps([-1.0 - width, -1.0], [5.0]), end=1.0), -2.0 - width)
        scheme = hj_form.HamiltonJacobi(block.law, block.grid, block.W, FLUXES["godunov"])
        steps = np.array(march(scheme, block, 0.9, 1.0)[2][1:])
        curves.append((steps.T, colour, f"K up to {most:.0e}: {len(steps)} steps"))
    picture("factor", curves, "godunov: time steps where K is large, 400 cells", y="Δt", x_label="t")
    whole, cut = data_of(KINK, -10.0), None
    first = 200
    part = study._Data(KINK, hj.Grid(-5.0, 200), whole.q[first:], 3.0)
    cut = march(study._Laboratory(part), part, 0.6, 1.0)[:2]
    picture("left", [(run(0.6, 1.0), GOOD, "whole"), (cut, BAD, "grid from x = -5 on")], "godunov, t = 1", (-7.0, 0.0))


def extremes():
    """A table: scenes with K up to 1e6 and q down to -0.999, by an explicit method and by fronts."""
    width = np.log(1e6) / (5.0 / 6.0)
    scenes = {
        "K up to 1e6: q = 5 on an interval of length 16.6": (hj.steps([-1.0 - width, -1.0], [5.0]), -2.0 - width),
        "K up to 4e8: a smooth bump": (hj.bumps([5.0], [-8.6 * 1.5 - 1.0], [6.0]), -45.0),
        "q = -0.999 in a hollow of length 1": (hj.steps([-3.0, -2.0], [-0.999]), -4.0),
        "q down to -0.999, smooth": (hj.bumps([-0.999], [-3.0], [0.5]), -6.0),
    }
    rows = [
        "| test problem | method | cells or fronts | seconds | steps | ‖u - u_exact‖_∞ | relative to ‖u - x‖_∞ |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (profile, left) in scenes.items():
        problem = hj.Problem(hj.rational(), profile, end=1.0, snapshots=[0.0, 0.01, 0.1, 0.5, 1.0])
        for method, n in (
            ("godunov", 500),
            ("godunov", 1000),
            ("godunov", 2000),
            ("conservative", 2000),
            ("fronts", 400),
            ("fronts", 1600),
        ):
            grid = hj.Grid(left, n if method != "fronts" else 2000)
            exact = hj.track_fronts(problem, grid, 3200 if "hollow" in name else 6400).u
            if method == "fronts":
                runs = [hj.track_fronts(problem, grid, n) for _ in range(3)]
            else:
                solve = hj.solve_conservative if method == "conservative" else hj.solve_hj
                runs = [solve(problem, grid, method) for _ in range(3)]
            run = min(runs, key=lambda r: r.wall_seconds)
            if not run.done:
                rows.append(f"| {name} | `{method}` | {n} | | | stops: {run.status.split(';')[0][:60]} | |")
                continue
            error = float(np.abs(run.u - exact).max())
            size = float(np.abs(exact - run.x).max())
            rows.append(
                f"| {name} | `{method}` | {n} | {run.wall_seconds:.2g} | {run.steps} | {error:.2g} "
                f"| {error / size:.1g} |"
            )
    return "\n".join(rows)


def limits(trials):
    rows = ["| method | bounds hold up to ν = | violated from ν = | limit by theory |", "|---|---|---|---|"]
    for method, theory in {t.method: t.theory for t in trials if t.parameter == "cfl"}.items():
        low, high = study.measured_limit(trials, method)
        rows.append(
            f"| `{method}` | {low:.4g} | {f'{high:.4g}' if high < np.inf else '-'} | {theory:.3g} |".replace("nan", "-")
        )
    return "\n".join(rows)


def replaced(text, name, content):
    """The text with what stands between the marks of that name replaced."""
    start, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
    before, rest = text.split(start)
    return before + start + content + end + rest.split(end)[1]


def main():
    started = time.time()
    pictures()
    trials = study.scan("travelling_kink", KINK, hj.Grid(-10.0, 1000))
    (DOCS / "figures" / "stability.png").write_bytes(stability_picture(trials))
    page = DOCS / "stability.md"
    text = replaced(page.read_text(encoding="utf-8"), "limits", limits(trials))
    page.write_text(replaced(text, "extremes", extremes()), encoding="utf-8")
    print(f"written in {time.time() - started:.0f} s")


if __name__ == "__main__":
    main()
