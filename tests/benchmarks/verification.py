"""Tables of docs/verification.md and docs/kinks.md: errors, orders and speeds against exact solutions.

    python tests/benchmarks/verification.py      writes the tables between their marks, in some two minutes

Each table stands between a comment with its name and `<!-- end -->`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import hjprofile as hj
from hjprofile.solvers.closed_forms import kink_into_steady_slope, travelling_kink

DOCS = Path(__file__).resolve().parents[2] / "docs"
RATIONAL = hj.rational()
METHODS = ("local-lax-friedrichs", "lax-friedrichs", "godunov", "telescoping", "conservative", "eno2", "weno5")
CELLS = [500, 1000, 2000, 4000]
SHOWN = 2  # index in CELLS of the grid whose errors are shown
CASES = ("travelling_kink", "log_law", "user_law", "steady_slope", "breaking_bump", "hillslope", "deposit")


def solve(problem: hj.Problem, grid: hj.Grid, method: str) -> hj.Run:
    """Return the run by a method on a grid, in the form that it has."""
    by = hj.solve_conservative if method.startswith("conservative") else hj.solve_hj
    return by(problem, grid, method)


def write(page: str, name: str, rows: list[str]) -> None:
    """Replace the table of that name on a page."""
    path = DOCS / page
    text = path.read_text(encoding="utf-8")
    start = text.index(f"<!-- {name} -->\n") + len(f"<!-- {name} -->\n")
    path.write_text(text[:start] + "\n".join(rows) + "\n" + text[text.index("<!-- end -->", start) :], encoding="utf-8")
    print(f"{page}: {name}\n" + "\n".join(rows), flush=True)


def short(number: float) -> str:
    """Return a number with two digits, as 1.6e-3."""
    return re.sub(r"e-0", "e-", f"{number:.1e}")


def errors(run: hj.Run, exact, grid: hj.Grid) -> tuple[float, float, float]:
    """Return the largest ‖u - u_exact‖_∞ and the means of ‖u - u_exact‖₁ and ‖q - q_exact‖₁ over the saved times."""
    u = [run.u[i] - exact.u(t, run.x) for i, t in enumerate(run.time)]
    q = [run.q[i] - exact.q_means(t, grid) for i, t in enumerate(run.time)]
    l1 = np.mean([grid.dx * np.abs(np.append(e[:1] + e[-1:], 2 * e[1:-1]) / 2).sum() for e in u])
    return float(np.abs(u).max()), float(l1), float(np.mean(grid.dx * np.abs(q).sum(axis=1)))


def errors_on_a_grid() -> None:
    """Write the errors and orders of all methods on two exact solutions."""
    tests = {
        "errors on a travelling kink": (
            hj.kinks([-6.0], [1.0]), 3.0, -10.0, travelling_kink(RATIONAL, 1.0, -6.0),
        ),
        "errors on the steady slope": (
            hj.steady(0.5, -1.0), 0.5, -2.0, kink_into_steady_slope(RATIONAL, 0.5, -1.0),
        ),
    }  # fmt: skip
    for name, (profile, end, left, exact) in tests.items():
        problem = hj.Problem(RATIONAL, profile, end=end, snapshots=11)
        rows = [
            "| method | ‖u - u_exact‖_∞ | ‖u - u_exact‖₁ | ‖q - q_exact‖₁ | orders of ‖u‖₁, ‖q‖₁ |",
            "|---|---|---|---|---|",
        ]
        for method in METHODS:
            grids = [hj.Grid(left, n) for n in CELLS]
            found = [errors(solve(problem, grid, method), exact, grid) for grid in grids]
            orders = [hj.observed_order(CELLS, [e[i] for e in found]) for i in (1, 2)]
            shown = " | ".join(map(short, found[SHOWN]))
            rows.append(f"| `{method}` | {shown} | {orders[0]:.2f}, {orders[1]:.2f} |")
        write("verification.md", name, rows)


def grids_against_fronts() -> None:
    """Write the orders of two grid methods at the end of shipped cases, against 6400 fronts on the same nodes."""
    rows = ["| case | `godunov` | `conservative` |", "|---|---|---|"]
    cells = [round(500 * 8 ** (i / 13)) for i in range(14)]
    for name in CASES:
        case = hj.load_case(name)
        found: dict[str, list[tuple[float, float]]] = {"godunov": [], "conservative": []}
        for n in cells:
            grid = hj.Grid(case.grid.left, n)
            exact = hj.track_fronts(case.problem, grid, 6400)
            for method, distances in found.items():
                run = solve(case.problem, grid, method)
                u, q = np.abs(run.u[-1] - exact.u[-1]), np.abs(run.q[-1] - exact.q[-1])
                distances.append((float(grid.dx * u.sum()), float(grid.dx * q.sum())))
        orders = (
            ", ".join(f"{hj.observed_order(cells, [d[i] for d in distances]):.2f}" for i in (0, 1))
            for distances in found.values()
        )
        rows.append(f"| `{name}` | {' | '.join(orders)} |")
    write("verification.md", "grids against fronts", rows)


def by_characteristics() -> None:
    """Write the errors of `characteristics` to several tolerances against its finest run."""
    case = hj.load_case("breaking_bump")
    times = (0.5, 2.0)
    problems = [hj.Problem(RATIONAL, case.problem.profile, end=t, snapshots=2) for t in times]
    finest = [hj.solve_characteristics(p, case.grid, 1e-13) for p in problems]
    rows = ["| tolerance | t = 0.5, smooth | t = 2, after two births | seconds |", "|---|---|---|---|"]
    for tolerance in (1e-6, 1e-8, 1e-10, 1e-12):
        cells, seconds = [], []
        for problem, reference in zip(problems, finest, strict=True):
            runs = [hj.solve_characteristics(problem, case.grid, tolerance) for _ in range(3)]
            error = float(np.abs(runs[0].u - reference.u).max())
            known = float(f"{reference.error_estimate:.0e}")
            cells.append(f"< {known:.0e}".replace("e-0", "e-") if error < known else short(error)[0] + short(error)[3:])
            seconds.append(f"{min(run.wall_seconds for run in runs):.1g}")
        power = f"1e-{round(-np.log10(tolerance))}"
        rows.append(f"| {power} | {' | '.join(cells)} | {', '.join(seconds)} |")
    write("verification.md", "characteristics", rows)


def speeds_of_kinks() -> None:
    """Write the largest relative errors of both speeds of a travelling kink, up to 16 cells before the crest."""
    methods = ("local-lax-friedrichs", "godunov", "conservative", "lax-friedrichs", "telescoping")
    rows = ["| cells | " + " | ".join(f"`{m}`" for m in methods) + " |", "|---" * (len(methods) + 1) + "|"]
    exact = travelling_kink(RATIONAL, 1.0, -6.0)
    problem = hj.Problem(RATIONAL, hj.kinks([-6.0], [1.0]), end=6.9, snapshots=70)
    for cells in (500, 2000):
        grid, cell = hj.Grid(-10.0, cells), []
        for method in methods:
            run = solve(problem, grid, method)
            kinks = [k for k in run.kinks if exact.kink(k.time) < -16 * grid.dx]
            speed = {k.time: 1.0 / (1.0 + np.exp(exact.kink(k.time))) for k in kinks}  # s' = 1/(1 + A e^s)
            measured = max(abs(k.speed / speed[k.time] - 1.0) for k in kinks if np.isfinite(k.speed))
            jump = max(abs(k.rankine_hugoniot_speed / speed[k.time] - 1.0) for k in kinks)
            cell.append(f"{100 * measured:.2g} %, {100 * jump:.2g} %")
        rows.append(f"| {cells} | {' | '.join(cell)} |")
    write("kinks.md", "speeds of kinks", rows)


if __name__ == "__main__":
    errors_on_a_grid()
    by_characteristics()
    speeds_of_kinks()
    grids_against_fronts()
