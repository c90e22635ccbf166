"""The method `auto` on slopes of unusual scales: missed tolerances, estimates, and the cost against the best choice.

    python tests/benchmarks/unusual_scenes.py [--seeds 0:300] [--tolerance 1e-3] [--truths FOLDER] [--out FILE.jsonl]
    python tests/benchmarks/unusual_scenes.py --hindsight [--seeds 0:60] [--tolerance 1e-3]

The first prints a row for each scene and tolerance and then counts. Errors are distances to the u on which independent
methods agree (`tests/support/truths.py`), and `known` is the distance of these methods. The second divides the
processor seconds of `auto` by those of the fastest choice that meets the tolerance. The choices are fronts, whose
number doubles until it does and of which the last two runs count, and characteristics at the coarsest tolerance that
does.
"""

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
from truths import AGREE, TOLERANCES, VERDICTS, Worker, known_truth, scene, study

import hjprofile as hj
from hjprofile.solvers.methods import by_characteristics

CHARACTERISTICS = 1e-4, 1e-6, 1e-8, 1e-10, 1e-12
FIRST_FRONTS, MOST_FRONTS = 32, 25600
SLOW = 5.0  # seconds of a run that is listed
LIMIT = 60.0


def main():
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--seeds", default="0:300", help="first:last+1, or one")
    asked.add_argument("--tolerance", type=float, action="append", help=f"by default {TOLERANCES}")
    asked.add_argument("--truths", help="folder in which truths are kept")
    asked.add_argument("--truth-seconds", type=float, default=10.0)
    asked.add_argument("--limit", type=float, default=LIMIT, help="seconds of one solve")
    asked.add_argument("--timeouts", type=int, default=2, help="after so many a scene is left")
    asked.add_argument("--out", help="file to which rows are appended, as JSON")
    asked.add_argument("--hindsight", action="store_true")
    options = asked.parse_args()
    first, _, last = options.seeds.partition(":")
    seeds = range(int(first), int(last) if last else int(first) + 1)
    tolerances = tuple(options.tolerance or TOLERANCES)
    if options.hindsight:
        hindsight(seeds, tolerances, options)
    else:
        table(seeds, tolerances, options)


def table(seeds, tolerances, options):
    rows = []
    print("seed kind tolerance method error estimate estimate/error seconds verdict known")
    for row in study(seeds, tolerances, options.truths, options.limit, options.truth_seconds, options.timeouts):
        rows.append(row)
        print(
            f"{row.seed:4d} {row.kind:11s} {row.tolerance:.0e} {row.method:15s} {row.error:8.1e} {row.estimate:8.1e} "
            f"{row.estimate / row.error if row.error else np.inf:7.2g} {row.seconds:6.2f} {row.verdict:11s} "
            f"{row.known:.0e}" + ("" if row.verdict in ("met", "not known") else f"  {row.status.splitlines()[0]}"),
            flush=True,
        )
        if options.out:
            with Path(options.out).open("a") as out:
                out.write(json.dumps(row._asdict()) + "\n")
    print("\ntolerance scenes known " + " ".join(VERDICTS))
    for tolerance in tolerances:
        here = [row for row in rows if row.tolerance == tolerance]
        count = Counter(row.verdict for row in here)
        known = sum(row.known <= AGREE * tolerance for row in here)
        print(f"{tolerance:.0e} {len(here)} {known} " + " ".join(str(count[v]) for v in VERDICTS))
    ratios = [r.estimate / r.error for r in rows if r.error > max(1e-2 * r.tolerance, 10.0 * r.known)]
    if ratios:
        print("estimate/error of errors above a hundredth of the tolerance, quantiles 0 2 50 98 100 %:", end=" ")
        print(np.percentile(ratios, [0, 2, 50, 98, 100]).round(2))
    slow = sum(row.seconds > SLOW for row in rows)
    print(f"processor seconds {sum(row.seconds for row in rows):.0f}, above {SLOW:g} s {slow}")


def cost_of_choices(seed, tolerances, exact):
    """Return {tolerance: (seconds of auto, of the best choice, the choice)}."""
    problem, grid = scene(seed)

    def tried(solve):
        started = time.process_time()
        try:
            run = solve()
        except (hj.RunError, ArithmeticError, ValueError):
            return np.inf, np.inf
        error = float(np.abs(run.u - exact.u).max()) if run.done else np.inf
        return time.process_time() - started, error

    tried(lambda: hj.solve(problem, max(tolerances), grid))  # tables of the law are made once
    auto = {t: tried(lambda t=t: hj.solve(problem, t, grid))[0] for t in tolerances}
    longest = max(1.0, 2.0 * max(auto.values()))  # a choice that takes longer is not the best
    fronts, n = [], FIRST_FRONTS
    while n <= MOST_FRONTS:
        fronts.append((n, *tried(lambda: hj.track_fronts(problem, grid, n))))  # noqa: B023
        if np.isfinite(fronts[-1][1]) and (fronts[-1][1] > longest or fronts[-1][2] <= min(tolerances)):
            break
        n *= 2
    lines = [(e, *tried(lambda: by_characteristics(problem, grid, e, patience=longest))) for e in CHARACTERISTICS]  # noqa: B023
    found = {}
    for tolerance in tolerances:
        choices = []
        for i, (n, seconds, error) in enumerate(fronts):
            if error <= tolerance:
                half = fronts[i - 1][1] if i and np.isfinite(fronts[i - 1][1]) else 0.0
                choices.append((seconds + half, f"{n} fronts"))
                break
        choices += [(s, f"characteristics {e:g}") for e, s, error in lines if error <= tolerance][:1]
        found[tolerance] = auto[tolerance], *min(choices, default=(np.nan, "none"))
    return found


def hindsight(seeds, tolerances, options):
    ratios = {t: [] for t in tolerances}
    worker = Worker()
    print("seed kind tolerance auto best ratio choice")
    for seed in seeds:
        exact = known_truth(seed, options.truths, options.truth_seconds, worker)
        asked = [t for t in tolerances if exact.u is not None and exact.best <= AGREE * t]
        if not asked:
            continue
        kind = scene(seed)[0].title.partition(",")[0]
        try:
            costs = worker.call(cost_of_choices, seed, asked, exact, seconds=3.0 * options.limit)
        except (TimeoutError, RuntimeError) as failure:
            print(f"{seed:4d} {kind:11s} {failure}", flush=True)
            continue
        for t, (auto, best, choice) in costs.items():
            ratios[t].append(auto / best)
            print(f"{seed:4d} {kind:11s} {t:.0e} {auto:7.3f} {best:7.3f} {auto / best:6.2f} {choice}", flush=True)
    worker.close()
    print("\nratio of processor seconds, quantiles 5 25 50 75 95 100 %")
    for t, values in ratios.items():
        finite = np.array(values)[np.isfinite(values)]
        if finite.size:
            print(f"{t:.0e} {finite.size} scenes", np.percentile(finite, [5, 25, 50, 75, 95, 100]).round(2))


if __name__ == "__main__":
    main()
