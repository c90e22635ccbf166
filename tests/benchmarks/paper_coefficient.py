"""Pictures and tables of §7 and §8: `python tests/benchmarks/paper_coefficient.py` writes and prints them."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

import oracles

import hjprofile as hj
from hjprofile.solvers.method import Form
from hjprofile.solvers.methods import named
from hjprofile.studies.fractional import Fractional, fractional_steps

FIGURES = Path(__file__).parents[2] / "docs" / "figures"
BLUE, ORANGE, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
K_OF_X = "exp(-0.2*x)*(1 + exp(-4*(x + 3)**2))"  # a stretch where the channel narrows
SLOPE = hj.bumps([1.2, -0.5], [-5.0, -3.2], [0.5, 0.4])


def solve(problem, grid, method, **options):
    return (hj.solve_hj if method in named(Form.HEIGHT) else hj.solve_conservative)(problem, grid, method, **options)


def figure(columns):
    drawing = Figure(figsize=(3.6 * columns, 2.9), layout="constrained")
    FigureCanvasAgg(drawing)
    return drawing, drawing.subplots(1, columns)


def coefficient_picture():
    """q on its way through a narrow stretch, and the decay of sup|F| and TV(F)."""
    problem = hj.Problem(hj.rational(), SLOPE, end=3.0, snapshots=301, coefficient=hj.coefficient(K_OF_X))
    run = hj.solve_hj(problem, hj.Grid(-8.0, 4000), "godunov")
    assert run.done and not run.warnings
    drawing, (left, right) = figure(2)
    for t, colour in zip((0.0, 0.5, 1.5, 3.0), (PINK, GREEN, ORANGE, BLUE), strict=True):
        left.plot(run.x_cell, run.q[round(100 * t)], color=colour, lw=1.2, label=f"t = {t:g}")
    left.plot(run.x, run.K[0] / 4 - 0.5, color="0.6", lw=1.0, ls="--", label="k/4 - ½")
    left.set(xlabel="x", ylabel="q", xlim=(-7.0, 0.0), ylim=(-0.6, 1.85))
    left.legend(fontsize=7, frameon=False, loc="upper right", ncols=3)
    F = run.K[:, 1:] * run.q / (1.0 + run.q)
    F = np.concatenate([np.zeros((F.shape[0], 1)), F], axis=1)
    sup, variation = np.abs(F).max(axis=1), np.abs(np.diff(F, axis=1)).sum(axis=1)
    right.plot(run.time, sup / sup[0], color=BLUE, lw=1.4, label="sup|F|")
    right.plot(run.time, variation / variation[0], color=ORANGE, lw=1.4, label="TV(F)")
    q = np.abs(np.diff(run.q, axis=1)).sum(axis=1)
    right.plot(run.time, q / q[0], color="0.6", lw=1.0, ls="--", label="TV(q), which may grow")
    right.set(xlabel="t", ylabel="part of that at t = 0", ylim=(0.0, None))
    right.legend(fontsize=7, frameon=False)
    drawing.savefig(FIGURES / "coefficient.png", dpi=140)


def fractional_picture() -> dict[str, Fractional]:
    """Errors against Δt."""
    problem = hj.load_case("two_kinks_in_steps").problem
    lengths = [0.4, 0.2, 0.1, 0.05, 0.025, 0.0125]
    studies = {m: fractional_steps(problem, hj.Grid(-10.0, 4000), m, lengths) for m in ("conservative", "godunov")}
    drawing, both = figure(2)
    for axes, (method, study) in zip(both, studies.items(), strict=True):
        for name, colour, label in (
            ("error_q_l1", BLUE, "∫|q - q_ref| dx"), ("error_u_sup", ORANGE, "sup|u - u_ref|"),
            ("error_kink", GREEN, "place of kinks"),
        ):  # fmt: skip
            errors = [getattr(step, name) for step in study.steps]
            axes.loglog(lengths, errors, "o-", color=colour, ms=3.5, lw=1.2, label=label)
        axes.loglog(lengths, 0.25 * np.array(lengths), "--", color="0.6", lw=1.0, label="first order")
        axes.set(xlabel="Δt between refreshes", title=method)
        axes.set_xticks(lengths[::-1], [f"{length:g}" for length in lengths[::-1]], fontsize=8)
        axes.set_xticks([], minor=True)
        axes.title.set_fontsize(9)
    both[0].set_ylabel("error")
    both[0].legend(fontsize=7, frameon=False)
    drawing.savefig(FIGURES / "fractional.png", dpi=140)
    return studies


def orders():
    """L1(q) against characteristics where all is smooth; see tests/grids/test_coefficient.py."""

    def k(t, x):
        return np.exp(-0.3 * x) * (1.0 + 0.5 * t * np.exp(-((x + 1.5) ** 2)))

    law, cells = hj.rational(), (200, 400, 800, 1600)
    x, q = oracles.characteristics_with_coefficient(law, lambda x: 0.5 * np.exp(-(((x + 2) / 0.4) ** 2)), -4.5, 0.3, k)
    problem = hj.Problem(law, hj.bumps([0.5], [-2.0], [0.4]), 0.3, [0.3], coefficient=hj.coefficient(k))
    for method in (*named(Form.HEIGHT), "conservative"):
        errors = []
        for n in cells:
            grid = hj.Grid(-4.0, n)
            run = solve(problem, grid, method)
            errors.append(grid.dx * float(np.abs(run.q[-1] - oracles.means_of_samples(x, q, grid.nodes)).sum()))
        print(f"| `{method}` | {errors[-1]:.1e} | {hj.observed_order(cells, errors):.2f} |")


def main():
    coefficient_picture()
    for method, study in fractional_picture().items():
        print(f"{method}: orders {study.order_q_l1:.2f}, {study.order_u_sup:.2f}, {study.order_kink:.2f}")
        for step in study.steps:
            print(f"| {step.refresh:g} | {step.error_q_l1:.2g} | {step.error_u_sup:.2g} | {step.error_kink:.2g} |")
    orders()


if __name__ == "__main__":
    main()
