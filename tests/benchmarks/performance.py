"""Measures all that docs/performance.md says, and writes it with its figures.

    python tests/benchmarks/performance.py            # some ten minutes on two cores; wants the extra "bench"

Ratios are of medians of runs that took turns.
"""

from __future__ import annotations

import os
import tempfile
import textwrap
import time
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import bench_kernels
import llvmlite.binding as llvm
import numpy as np
import peers
import startup
from rich.console import Console

import hjprofile as hj
from hjprofile.output.plots.study_pictures import chart_picture
from hjprofile.solvers.grids.kernels import grid_loops as grid_kernels
from hjprofile.solvers.grids.kernels.wavefront import LANES
from hjprofile.solvers.method import Form
from hjprofile.solvers.methods import named
from hjprofile.studies.chart import Point, chart_of, seconds_to

DOCS = Path(__file__).parents[2] / "docs"
SIZES = 1_000, 10_000, 100_000, 1_000_000
MOST = 1e4  # seconds that are told where they are extrapolated
WIDTH = 120  # characters of a line of the page
PEER_CELLS = 250, 350, 500, 700, 1000, 1400, 2000, 2800, 4000, 5600, 8000
say = Console(stderr=True).print

BUMPS = hj.bumps([0.8, -0.3], [-5.0, -3.0], [1.0, 0.5])
SCENES = {
    "T1": (hj.Problem(hj.rational(), hj.kinks([-6.0], [1.0]), end=3.0), hj.Grid(-10.0, 2000)),
    "T2": (hj.Problem(hj.rational(), BUMPS, end=2.0), hj.Grid(-10.0, 2000)),
    "T2s": (hj.Problem(hj.rational(), BUMPS, end=0.5), hj.Grid(-10.0, 2000)),
    "hillslope": (hj.load_case("hillslope").problem, hj.load_case("hillslope").grid),
}


def in_turns(runs: Mapping[str, Callable[[], object]], rounds: int = 9) -> dict[str, float]:
    """Median seconds of each, after one run to warm up."""
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for n in range(rounds + 1):
        for name, run in runs.items():
            started = time.perf_counter()
            run()
            if n:
                seconds[name].append(time.perf_counter() - started)
    return {name: float(np.median(taken)) for name, taken in seconds.items()}


def kernels() -> tuple[dict[str, dict[int, float]], str]:
    """Nanoseconds per cell and step, by kernel and size; as a table."""
    found: dict[str, dict[int, float]] = {name: {} for name in bench_kernels.KERNELS}
    for cells in SIZES:
        say(f"kernels on {cells} cells")
        runs = {name: make(cells) for name, make in bench_kernels.KERNELS.items()}
        for name, seconds in in_turns(runs, 9 if cells < 1e6 else 3).items():
            found[name][cells] = 1e9 * seconds / (cells * LANES)
    rows = [f"| {name} | " + " | ".join(f"{found[name][n]:.2f}" for n in SIZES) + " |" for name in found]
    head = "| kernel | " + " | ".join(f"{n:,} cells" for n in SIZES) + " |\n|---|" + "---|" * len(SIZES)
    return found, "\n".join([head, *rows])


def ratios(found: dict[str, dict[int, float]]) -> str:
    """What the table of kernels amounts to."""
    rows = [
        "| on 10,000 cells | speed-up over the obvious loop | cost with K, relative to K = 1 "
        "| cost of the log law, relative to the rational law |"
    ]
    rows.append("|---|---|---|---|")
    for name in ("godunov", "local-lax-friedrichs", "conservative"):
        mine, others = found[name][10_000], [found[f"{name}{k}"][10_000] for k in (", K = 1", ", log law")]
        obvious = found[f"obvious {name}"][10_000]
        rows.append(f"| {name} | {obvious / mine:.1f} | {mine / others[0]:.2f} | {others[1] / mine:.1f} |")
    worst = max(max(f.values()) / min(f.values()) for n, f in found.items() if not n.startswith("obvious"))
    rows.append(
        "\nFrom 1,000 to 1,000,000 cells the cost of a sweep per cell and step varies by a factor of at most "
        f"{worst:.2f}."
    )
    return "\n".join(rows)


def window() -> str:
    """A scene whose waves fill a twentieth of the slope, with and without the window."""
    narrow = hj.bumps([0.8, -0.3], [-6.0, -5.8], [0.03, 0.02])
    problem = hj.Problem(hj.rational(), narrow, end=0.15, snapshots=2)
    grid, sound = hj.Grid(-10.0, 20_000), grid_kernels.flat_ends

    def everywhere(y, first, last, left, right):
        sound(y, 0, y.size - 1, left, right)
        return 0, y.size - 1

    seconds: dict[str, list[float]] = {"part": [], "whole": []}
    same = filled = 0.0
    for _ in range(5):
        part = hj.solve_hj(problem, grid)
        grid_kernels.flat_ends = everywhere
        whole = hj.solve_hj(problem, grid)
        grid_kernels.flat_ends = sound
        same = np.array_equal(part.u, whole.u)
        filled = float(np.mean(np.abs(whole.q[-1]) > 1e-12))
        seconds["part"].append(part.wall_seconds)
        seconds["whole"].append(whole.wall_seconds)
    share = np.median(seconds["part"]) / np.median(seconds["whole"])
    verdict = "identical to the last bit" if same else "NOT IDENTICAL"
    return (
        f"If waves occupy {filled:.1%} of {grid.cells:,} cells, the run takes {share:.1%} of the time that it takes "
        f"without the active window. The results are {verdict}."
    )


def memory() -> str:
    """Peak memory of a run in arrays of its size, what is kept at the end included."""
    cells, peaks = 1_000_000, {}
    for method in ("godunov", "conservative", "eno2", "weno5"):
        solve = hj.solve_conservative if method == "conservative" else hj.solve_hj
        problem = hj.Problem(hj.rational(), hj.kinks([-6.0], [1.0]), end=3e-4, snapshots=[3e-4])
        solve(problem, hj.Grid(-10.0, 1000), method)  # imports and compiles
        tracemalloc.start()
        solve(problem, hj.Grid(-10.0, cells), method)
        peaks[method] = tracemalloc.get_traced_memory()[1] / (8 * cells)
        tracemalloc.stop()
    shown = ", ".join(f"{peak:.1f} ({name})" for name, peak in peaks.items())
    return (
        f"A run on {cells:,} cells with one saved time uses at most the memory of this number of arrays of that size: "
        f"{shown}."
    )


def start_up() -> str:
    """Whole processes: `hjprofile run travelling_kink` for the first time ever, and later."""
    rounds = 5
    found = startup.in_turns([startup.HERE], rounds)

    def shown(name: str) -> str:
        wall, processor = np.median(found[name, startup.HERE], axis=0)
        return f"{wall:.1f} s ({processor:.1f} s of processor time)"

    return (
        "`hjprofile run travelling_kink`, the whole process with its pictures and VTK files, takes "
        f"{shown('first run')} if nothing has been compiled yet, and {shown('later run')} afterwards. These are "
        f"medians of {rounds} runs; `python tests/benchmarks/startup.py` measures them, and compares two checkouts."
    )


def charts() -> tuple[dict[str, list[Point]], str]:
    """The charts as figures; the fastest methods to given errors as a table."""
    all_points, text = {}, []
    for name, (problem, grid) in SCENES.items():
        say(f"chart of {name}")
        found = chart_of(name, replace(problem, snapshots=5), grid)
        points, reference = found.points, found.reference
        all_points[name] = points
        (DOCS / "figures" / f"performance_{name}.png").write_bytes(chart_picture([found]))
        text.append(f"### {name}\n\n![accuracy against seconds](figures/performance_{name}.png)\n")
        known = f", accurate to {reference.error:.0e} in u and {reference.error_q:.0e} in q" if reference.error else ""
        text.append(f"Reference: {reference.name}{known}. Seconds to reach ‖q - q_exact‖₁ (maximum over five times):\n")
        methods = dict.fromkeys(p.method for p in points)
        text.append("| method | order in ‖q‖₁ | 1e-2 | 1e-3 | 1e-4 |\n|---|---|---|---|---|")
        for method in methods:
            if method == "characteristics":
                continue
            mine = [p for p in points if p.method == method]
            order = hj.observed_order([p.cells for p in mine], [p.error_q_l1 for p in mine])
            if max(p.error_q_l1 for p in mine) < 1e-10:
                text.append(f"| {method} | exact | " + " | ".join(f"{mine[0].seconds:.2g}" for _ in range(3)) + " |")
                continue
            cells = [_seconds(mine, error) for error in (1e-2, 1e-3, 1e-4)]
            text.append(f"| {method} | {order:.2f} | " + " | ".join(cells) + " |")
        best = min((p for p in points if p.method == "characteristics"), key=lambda p: p.error_q_l1, default=None)
        if best:
            least = "< " if best.error_q_l1 <= reference.error_q else ""
            text.append(f"\nCharacteristics: error {least}{best.error_q_l1:.0e} in {best.seconds:.2g} s.")
        text.append("")
    return all_points, "\n".join(text)


def _shown(seconds: float, reached: bool) -> str:
    """With a star where no run came so far; an order that is carried on over many decades says no more than that."""
    return f"{seconds:.2g}" if reached else f"{seconds:.2g}*" if seconds <= MOST else f">{MOST:.0e}".replace("+0", "")


def _seconds(points: list[Point], error: float) -> str:
    return _shown(seconds_to(points, error), min(p.error_q_l1 for p in points) <= error)


def _times(ratio: float) -> str:
    """Two digits: a busy machine gives no more."""
    return f"{float(f'{ratio:.2g}'):,.0f}"


def against_peers() -> str:
    """Seconds to an error on T1 and T2: three general packages, hjprofile's best grid method, and fronts, in turns."""
    rows = ["| | T1: 1e-3 | T1: 1e-4 | T2: 1e-3 | T2: 1e-4 |", "|---|---|---|---|---|"]
    times: dict[str, list[str]] = {}
    best: dict[tuple[str, float], dict[str, float]] = {}
    for scene in ("T1", "T2"):
        problem, grid = SCENES[scene]
        problem = replace(problem, snapshots=[problem.end])
        data = peers.Scene(scene, grid.left, problem.end, lambda x, p=problem: p.profile.W(x, p.law))
        points: dict[str, list[Point]] = {}
        for cells in PEER_CELLS:
            say(f"peers on {scene}, {cells} cells")
            fine = hj.Grid(grid.left, cells)
            exact = hj.solve_characteristics(problem, fine).q[-1]
            runs: dict[str, Callable[[], tuple[np.ndarray, float]]] = {}
            for name, peer in peers.PEERS.items():
                run = peer.prepare(data, cells)
                runs[name] = partial(_timed, run)
            for method in (*named(Form.HEIGHT), *named(Form.SLOPE)):
                if method.startswith("conservative-"):
                    continue
                solve = hj.solve_hj if method in named(Form.HEIGHT) else hj.solve_conservative
                runs[f"hjprofile {method}"] = partial(_own, solve, problem, fine, method)
            fronts = cells // 4  # a front's piece is an arc, not a constant: as many as a quarter of the cells
            runs["hjprofile fronts"] = partial(_own, hj.track_fronts, problem, fine, fronts)
            taken: dict[str, list[float]] = {name: [] for name in runs}
            for _ in range(3):
                for name, run in runs.items():
                    q, seconds = run()
                    taken[name].append(seconds)
                    error = fine.dx * float(np.abs(q - exact).sum())
                    if len(taken[name]) == 3:
                        median = float(np.median(taken[name]))
                        points.setdefault(name, []).append(Point(scene, name, cells, np.nan, error, median, 0))
        for name, mine in points.items():
            for error in (1e-3, 1e-4):
                exact_there = max(p.error_q_l1 for p in mine) < 1e-10
                seconds = mine[0].seconds if exact_there else seconds_to(mine, error)
                best.setdefault((scene, error), {})[name] = seconds
                reached = exact_there or min(p.error_q_l1 for p in mine) <= error
                times.setdefault(name, []).append(_shown(seconds, reached))
    rows += [f"| {name} | " + " | ".join(cells) + " |" for name, cells in times.items()]
    lines = []
    for (scene, error), seconds in best.items():
        peer, ours, fronts = (
            min((s, n) for n, s in seconds.items() if choose(n))
            for choose in (
                lambda n: not n.startswith("hjprofile"),
                lambda n: n.startswith("hjprofile") and n != "hjprofile fronts",
                lambda n: n == "hjprofile fronts",
            )
        )
        lines.append(
            f"- {scene} to {error:g}: `{ours[1].removeprefix('hjprofile ')}` is {_times(peer[0] / ours[0])} times and "
            f"`fronts` {_times(peer[0] / fronts[0])} times faster than the fastest general package "
            f"({peer[1]}, {peer[0]:.2g} s)."
        )
    lines.append(
        "\nOn T1 the method `fronts` integrates the equation of motion of the single kink and is exact with any "
        "number of fronts."
    )
    return "\n".join([*rows, "", *lines])


def _timed(run: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    started = time.perf_counter()
    q = run()
    return q, time.perf_counter() - started


def _own(solve: Callable[..., hj.Run], *arguments) -> tuple[np.ndarray, float]:
    run = solve(*arguments)
    return run.q[-1], run.wall_seconds


PAGE = """# Speed and accuracy, measured

All numbers and charts on this page were measured with version {version} on {machine}. One command measures them and
writes this page:

<!-- not run: ten minutes -->
```sh
pip install -e '.[bench]' && python tests/benchmarks/performance.py
```

Run times depend on the machine, and those of the sweeps on the width of its vectors. Ratios depend on it less, because
the runs to be compared took turns on one machine.
Seconds are those of the time stepping alone, without compilation and output. A star marks an extrapolated time; `>1e4`
is an extrapolated time above 1e4 s. The error is ‖q - q_exact‖₁, where q is the excess slope. The algorithm is
described on the page [How the sweeps work](kernels.md).

## Kernels

The table gives nanoseconds per cell and time step. The "obvious" loops are the straightforward implementations, also
compiled: one pass for the fluxes with `exp` for K, and one pass for the update.

{kernels}

{ratios}

{window}

{memory}

## Accuracy against seconds

The test problems are

- T1, one travelling kink to t = 3 (the case `travelling_kink`);
- T2, two bumps to t = 2 (`breaking_bump`), when two shocks have formed;
- T2s, the same to t = 0.5, when the solution is still smooth;
- the shipped hillslope.

The first-order methods `conservative-...`, which use a flux in the other form of the equation, are written in plain
numpy. They exist for comparison, not for speed.

{charts}

## Against general packages

The packages PyClaw, hj_reachability and py-pde were set up as an expert would (`tests/benchmarks/peers.py`) and run on
{peer_cells} cells. The table gives the seconds to reach an error ‖q - q_exact‖₁ at the end. The required number of
cells follows from a line fitted to all errors of a method, and the run time from the runs on either side. Beyond the
finest run (a star) the run time is assumed to grow like the square of the number of cells:

{peers}

## Start-up

{start_up}
"""


def machine() -> str:
    """The number of cores, and the processor as the compiler knows it."""
    features, cores = llvm.get_host_cpu_features(), len(os.sched_getaffinity(0))
    bits = 512 if features.get("avx512f") else 256 if features.get("avx2") else 128
    return f"{cores} cores of a processor with vectors of {bits} bits (`{llvm.get_host_cpu_name()}`)"


def wrapped(page: str) -> str:
    """The page with the lines of its paragraphs and lists filled."""
    blocks = page.strip().split("\n\n")
    for i, block in enumerate(blocks):
        if block.startswith("- "):
            items = [" ".join(item.split()) for item in block[2:].split("\n- ")]
            blocks[i] = "\n".join(textwrap.fill(f"- {item}", WIDTH, subsequent_indent="  ") for item in items)
        elif not block.startswith(("#", "|", "<", "![")):
            blocks[i] = textwrap.fill(" ".join(block.split()), WIDTH, break_on_hyphens=False)
    return "\n\n".join(block for block in blocks if block.strip()) + "\n"


def main() -> None:
    os.chdir(tempfile.gettempdir())  # PyClaw leaves a log where it is imported
    found, table = kernels()
    content = {
        "version": hj.__version__,
        "machine": machine(),
        "kernels": table,
        "ratios": ratios(found),
        "window": window(),
        "memory": memory(),
        "start_up": start_up(),
    }
    content["peers"] = against_peers()
    content["charts"] = charts()[1]
    content["peer_cells"] = f"{PEER_CELLS[0]} to {PEER_CELLS[-1]}"
    (DOCS / "performance.md").write_text(wrapped(PAGE.format(**content)), encoding="utf-8")
    say(f"written to {DOCS / 'performance.md'}")


if __name__ == "__main__":
    main()
