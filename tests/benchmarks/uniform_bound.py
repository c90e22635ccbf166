"""Measure on 1000 random profiles which methods never raise TV(I) (§4), and print the table of docs/theory.md.

Run `python tests/benchmarks/uniform_bound.py`; it takes about ten minutes.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from random_steps import ROUNDING, increases

METHODS = "godunov", "telescoping", "local-lax-friedrichs", "lax-friedrichs", "eno2", "conservative", "weno5"
RUNS = 1000

if __name__ == "__main__":
    print("| method | runs | above TV(I(0)) | by at most | rises between saved times | by at most |")
    print("|---|---|---|---|---|---|")
    for method in METHODS:
        above, between, _ = increases(method, range(RUNS)).T
        cells = []
        for rise in (above, between):
            count = np.count_nonzero(rise > ROUNDING)
            cells += [f"{count}", f"{rise.max():.1e}" if count else "-"]
        print(f"| `{method}` | {above.size} | {' | '.join(cells)} |", flush=True)
