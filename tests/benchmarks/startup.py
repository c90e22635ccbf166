"""Measures the seconds from the start to the end of a process: of a first run, of a later one, and of the help.

    python tests/benchmarks/startup.py                       of this checkout
    python tests/benchmarks/startup.py --before CHECKOUT     also of another one, in turns, with the ratios
    python tests/benchmarks/startup.py --rounds 3            instead of ten rounds

Processor seconds contain those of the drawing process. A first run has an empty cache of compiled loops.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

HERE = Path(__file__).parents[2]
RUN = ("-m", "hjprofile", "run", "travelling_kink", "--quiet", "--out", "result")
COMMANDS = {
    "first run": RUN,
    "later run": RUN,
    "--help": ("-m", "hjprofile", "--help"),
    "import hjprofile": ("-c", "import hjprofile"),
}
COLD = "first run"


class Seconds(NamedTuple):
    """The seconds of a process and of the processes that it waited for."""

    wall: float
    processor: float


def taken(checkout: Path, command: Sequence[str], cache: Path) -> Seconds:
    """Return the seconds of a command of a checkout, with compiled loops in the folder `cache`."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(cache)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has bytecode
    with tempfile.TemporaryDirectory() as folder:
        before, started = os.times(), time.perf_counter()
        subprocess.run([sys.executable, *command], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
        wall, after = time.perf_counter() - started, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return Seconds(wall, used)


def in_turns(checkouts: Sequence[Path], rounds: int) -> dict[tuple[str, Path], list[Seconds]]:
    """Return the seconds of each command of each checkout: one round of all to fill the caches, then the `rounds`."""
    found: dict[tuple[str, Path], list[Seconds]] = {(name, c): [] for name in COMMANDS for c in checkouts}
    with tempfile.TemporaryDirectory() as folder:
        warm = {checkout: Path(folder) / str(i) for i, checkout in enumerate(checkouts)}
        for n in range(rounds + 1):
            for name, command in COMMANDS.items():
                if n == 0 and name == COLD:
                    continue
                for checkout in checkouts if n % 2 else reversed(checkouts):
                    with tempfile.TemporaryDirectory() as empty:
                        cache = Path(empty) if name == COLD else warm[checkout]
                        seconds = taken(checkout, command, cache)
                    if n:
                        found[name, checkout].append(seconds)
                        print(f"{checkout} {name}: {seconds}", file=sys.stderr, flush=True)
    return found


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    checkouts = [HERE, *([options.before.resolve()] if options.before else [])]
    found = in_turns(checkouts, options.rounds)
    for name in COMMANDS:
        for kind in Seconds._fields:
            rows = [[getattr(s, kind) for s in found[name, checkout]] for checkout in checkouts]
            text = f"{name:18} {kind:10} {median(rows[0]):7.2f} s"
            if options.before:
                ratio = median(now / then for now, then in zip(*rows, strict=True))
                text += f"   before {median(rows[1]):7.2f} s   ratio {ratio:.2f}"
            print(text, flush=True)


if __name__ == "__main__":
    main()
