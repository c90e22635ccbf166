"""Fingerprints of some 200 short runs: whether a change of the code has changed a result, and which.

    python tests/benchmarks/fingerprints.py before.json             write them
    python tests/benchmarks/fingerprints.py after.json before.json  write them, and list what differs

A fingerprint is a hash of all that a run returns but the seconds that it took. It belongs to one machine.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import hjprofile as hj
from hjprofile.problem.case import parse_case

GRID_METHODS = [
    f"{form}{name}"
    for form in ("", "conservative-")
    for name in ("local-lax-friedrichs", "lax-friedrichs", "godunov", "telescoping", "eno2", "weno5")
] + ["conservative"]
EXACT_METHODS = ["fronts", "characteristics"]
LINEAR_GROWTH = ["telescoping", "conservative-telescoping", "conservative", "fronts"]
ENDLESS = {"law": "expression", "expression": "2 + q/2 - 2/(1+q)**0.25", "growth": "linear"}
KINKS = {"kind": "kinks", "positions": [-7.0, -5.0], "amplitudes": [0.4, 1.2]}
BUMP = {"kind": "bumps", "amplitudes": [0.8, -0.3], "centres": [-6.0, -3.0], "widths": [0.7, 0.4]}
STEPS = {"kind": "steps", "edges": [-7.0, -6.0, -4.0, -3.0], "values": [0.8, -0.4, 1.5]}
STEEP = {"kind": "kinks", "positions": [-4.0, -2.5], "amplitudes": [1.0, 2.0]}
BASE = {
    "erosion": {"law": "rational"},
    "profile": KINKS,
    "domain": {"left": -12.0, "cells": 240},
    "time": {"end": 3.0, "snapshots": 5},
}


def scene(**sections: dict) -> dict:
    return {**BASE, **sections}


SCENES = {
    "two_kinks": (scene(), [*GRID_METHODS, *EXACT_METHODS]),
    "bumps": (scene(profile=BUMP), [*GRID_METHODS, *EXACT_METHODS]),
    "steps": (scene(profile=STEPS), [*GRID_METHODS, *EXACT_METHODS]),
    "log_law": (scene(erosion={"law": "log"}, profile=BUMP), [*GRID_METHODS, *EXACT_METHODS]),
    "expression": (
        scene(erosion={"law": "expression", "expression": "q/(1+q)"}, profile=STEPS),
        ["godunov", "conservative", "weno5", *EXACT_METHODS],
    ),
    "coefficient_t_x": (
        scene(coefficient={"kind": "expression", "expression": "exp(-0.2*x)*(1 + 0.1*t)"}, profile=BUMP),
        GRID_METHODS,
    ),
    "coefficient_x": (scene(coefficient={"kind": "expression", "expression": "1.5 + exp(-(x + 5)**2)"}), GRID_METHODS),
    "refresh": (scene(profile=BUMP, solver={"refresh": 0.7}), GRID_METHODS),
    "layer": (scene(layer={"supply_flux": 0.05}, profile=BUMP), ["conservative-telescoping"]),
    "whole_line": (
        scene(domain={"left": -12.0, "right": 2.0, "cells": 280, "line": "whole"}),
        [*GRID_METHODS, *EXACT_METHODS],
    ),
    "whole_line_bump": (
        scene(profile=BUMP, domain={"left": -12.0, "right": 2.0, "cells": 280, "line": "whole"}),
        ["godunov", *EXACT_METHODS],
    ),
    "steady": (
        scene(profile={"kind": "steady", "flux": 0.3}, domain={"left": -2.0, "cells": 100}),
        ["godunov", "conservative", "conservative-godunov", "weno5", "conservative-weno5", "lax-friedrichs"],
    ),
    "steady_kink": (
        scene(profile={"kind": "steady", "flux": 0.3, "kink": -0.8}, domain={"left": -2.0, "cells": 100}),
        ["godunov", "conservative", "conservative-godunov", "eno2", "conservative-eno2", "local-lax-friedrichs"],
    ),
    "vertical_step": (scene(erosion=ENDLESS, profile=STEEP, domain={"left": -8.0, "cells": 160}), LINEAR_GROWTH),
    "steps_of_a_bump": (
        scene(
            erosion=ENDLESS,
            profile={"kind": "bumps", "amplitudes": [1.5], "centres": [-3.0], "widths": [0.6]},
            domain={"left": -8.0, "cells": 160},
        ),
        LINEAR_GROWTH,
    ),
    "too_steep_a_hollow": (
        scene(profile={"kind": "steps", "edges": [-4.0, -2.0], "values": [-0.995]}, time={"end": 30.0}),
        ["godunov", "weno5", "conservative", *EXACT_METHODS],
    ),
    "far": (
        scene(
            profile={"kind": "kinks", "positions": [-900.0, -1.0], "amplitudes": [0.5, 0.5]},
            domain={"left": -950.0, "cells": 300},
        ),
        ["godunov", "conservative", *EXACT_METHODS],
    ),
}
TOO_LONG_STEPS = ["godunov", "lax-friedrichs", "conservative", "conservative-godunov", "eno2", "weno5"]
TOLERANCES = [1e-2, 1e-4, 1e-7]


def runs() -> Iterator[tuple[str, object]]:
    def case(content: dict, **solver: object) -> object:
        content = {**content, "solver": {**content.get("solver", {}), **solver}}
        return parse_case(content, "scene", "scene.toml", Path())

    for name, (content, methods) in SCENES.items():
        for method in methods:
            yield f"{name} {method}", lambda c=content, m=method: hj.solve_case(case(c, method=m))
    for method in TOO_LONG_STEPS:
        yield (
            f"cfl_2 {method}",
            lambda m=method: hj.solve_case(case(SCENES["bumps"][0], method=m, cfl=2.0), strict=False),
        )
        yield f"strict {method}", lambda m=method: hj.solve_case(case(SCENES["steps"][0], method=m), strict=True)
    for name in ("two_kinks", "bumps", "steps", "log_law", "whole_line_bump", "steady"):
        for tolerance in TOLERANCES:
            content = SCENES[name][0]
            yield (
                f"{name} auto {tolerance:g}",
                lambda c=content, e=tolerance: hj.solve_case(case(c, method="auto", tolerance=e)),
            )
    for name in ("two_kinks", "bumps", "steps", "log_law"):
        problem = case(SCENES[name][0]).problem
        yield f"{name} exact fronts", lambda p=problem: hj.track_fronts(p, fronts=120, exact=True)
    for name in sorted(hj.shipped_cases()):
        yield f"shipped {name}", lambda n=name: hj.solve_case(hj.load_case(n, {"domain.cells": 200}))


def fingerprint(run: hj.Run) -> str:
    digest = hashlib.sha256()
    for name in ("time", "u", "q", "K"):
        digest.update(np.ascontiguousarray(getattr(run, name)).tobytes())
    told = [
        run.method, run.case, run.kinks, run.events, run.vertical_steps, dict(run.bounds), run.status, run.steps,
        run.step_range, run.eroded_volume, run.crest_lowering, run.volume_budget_error,
        run.error_estimate, run.cautions,
        re.sub(r"[0-9.e-]+ s$", "", run.account),
    ]  # fmt: skip
    digest.update(repr(told).encode())
    return digest.hexdigest()[:16]


def attempt(solve: object) -> str:
    try:
        with np.errstate(all="ignore"):
            return fingerprint(solve())
    except (hj.InputError, hj.RunError) as error:
        return f"{type(error).__name__}: {error}"


def main(out: str, before: str = "") -> int:
    found = {name: attempt(solve) for name, solve in runs()}
    Path(out).write_text(json.dumps(found, indent=0) + "\n")
    known = json.loads(Path(before).read_text()) if before else found
    differ = [name for name in {**known, **found} if known.get(name) != found.get(name)]
    print(f"{len(found)} runs, {len(differ)} differ from {before or 'nothing'}", *differ, sep="\n  ")
    return int(bool(differ))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
