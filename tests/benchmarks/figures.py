"""Draws every picture of the docs anew, and the tables that are written with them.

    python tests/benchmarks/figures.py               # all of them, in some 40 minutes
    python tests/benchmarks/figures.py failures fit.png   # those of a script, or one picture and what comes with it

Each script runs in a process of its own, one after the other, for some measure seconds; performance.py wants the extra
"bench". What is printed on the way goes into the docs by hand where its script says so.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent

# script -> the seconds it took on two cores, and what it draws in docs/figures
MAKES: dict[str, tuple[int, tuple[str, ...]]] = {
    "pictures.py": (18, (
        "hillslope.png", "hillslope_diagram.png", "hillslope.gif", "two_kinks.png", "comparison.png", "factor.png",
        "norms.png", "raw_export.png",
    )),
    "failures.py": (127, ("stability.png", *(f"failure_{name}.png" for name in (
        "cfl", "viscosity", "refresh", "reconstruction", "hollow", "factor", "left"
    )))),
    "performance.py": (600, tuple(f"performance_{name}.png" for name in ("T1", "T2", "T2s", "hillslope"))),
    "least_work.py": (305, ("least_work.png",)),
    "paper_layer.py": (14, ("slow_erosion.png", "supply_histories.png")),
    "paper_coefficient.py": (6, ("coefficient.png", "fractional.png")),
    "paper_dependence.py": (26, ("dependence.png", "lipschitz.png")),
    "paper_statements.py": (50, ("invariant.png",)),
    "paper_bounds.py": (6, ("global_bounds.png",)),
    "paper_line.py": (160, ("whole_line.png", "wave_stability.png")),
    "paper_growth.py": (84, ("vertical_step.png",)),
    "paper_inverse.py": (70, ("inverse.png",)),
    "sweep_figure.py": (354, ("sweep.png",)),
    "calibration_figure.py": (787, ("fit.png",)),
}  # fmt: skip
# drawn by ParaView itself, which is none of ours to start
ELSEWHERE = {"paraview.png": "pvpython docs/open_in_paraview.py results/hillslope docs/figures/paraview.png"}


def chosen(names: list[str]) -> list[str]:
    """The scripts of these names, with or without `.py`, and those that draw the pictures of these names."""
    if not names:
        return list(MAKES)
    known = {alias: script for script in MAKES for alias in (script, script[:-3], *MAKES[script][1])}
    unknown = [name for name in names if name not in known]
    if unknown:
        sys.exit(f"{', '.join(unknown)}: not known; scripts are {', '.join(MAKES)}; see docs/figures for pictures")
    return list(dict.fromkeys(known[name] for name in names))


def main() -> None:
    """Runs the scripts; ends with exit code 1 if one of them failed."""
    failed = []
    for script in chosen(sys.argv[1:]):
        seconds, pictures = MAKES[script]
        print(f"{script}: {', '.join(pictures)}; some {seconds} s", flush=True)
        started = time.perf_counter()
        code = subprocess.run([sys.executable, HERE / script]).returncode
        failed += [script] if code else []
        print(f"{script}: {'FAILED' if code else 'done'} after {time.perf_counter() - started:.0f} s\n", flush=True)
    for picture, command in ELSEWHERE.items() if len(sys.argv) == 1 else ():
        print(f"{picture} is not drawn here, but by: {command}")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
