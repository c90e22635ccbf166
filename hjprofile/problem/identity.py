"""The identity of a run: its case, the files that the case names, and the package that solves it."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import hjprofile
from hjprofile.errors import InputError
from hjprofile.problem.case import Case, resolved_case
from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.given import Given
from hjprofile.problem.profiles import Bumps, Kinks, Points, Profile, Steady
from hjprofile.problem.supply import SupplyFlux

MOST_PLACES = 1000  # nodes at which a coefficient from a Python file is sampled
TIMES = 9  # ... and times


def identity(case: Case) -> dict[str, Any]:
    """Return the resolved case without its title, a hash `data` of the data that the table lacks, and a hash of the
    package.

    Files count by their bytes. Data that a Python file reads are covered by sampled values only: f over
    1e-8 <= 1 + q <= 1e8, heights at the nodes, k at TIMES times and at MOST_PLACES nodes, ε at MOST_PLACES times.
    Raise InputError for a Python function that is in no file.
    """
    problem = case.problem
    table = resolved_case(problem, case.grid, case.method, case.cfl, case.tolerance, case.refresh)
    del table["title"]
    digest = hashlib.sha256()
    supply = problem.supply if isinstance(problem.supply, SupplyFlux) else None
    parts: dict[str, ErosionLaw | Profile | Coefficient | SupplyFlux | None] = {
        "law": problem.law, "profile": problem.profile, "coefficient": problem.coefficient, "supply flux": supply,
    }  # fmt: skip
    for name, part in parts.items():
        if part is not None:
            content = _content(part)
            if content is None:
                raise InputError(
                    f"{case.source}: the {name} is a Python function that is in no file, so a checkpoint cannot "
                    "identify it; name its file in a case, or save no checkpoints",
                    "a-checkpoint",
                )
            digest.update(f"{name} {content}".encode())
    for values in _samples(case):
        digest.update(values)
    return table | {"data": digest.hexdigest(), "hjprofile": f"{hjprofile.__version__} ({_package()})"}


def digest_of(case: Case) -> str:
    """Return a hash of `identity`."""
    return hashlib.sha256(json.dumps(identity(case), sort_keys=True).encode()).hexdigest()


def _content(part: ErosionLaw | Profile | Coefficient | SupplyFlux) -> str | None:
    """Return a hash of the data that the table of a part of a problem lacks; None if they are not available."""
    match part:
        case Points():
            extra = f"{part.height!r} {part.units!r}".encode()
            return hashlib.sha256(part.x.tobytes() + part.q.tobytes() + extra).hexdigest()
        case Kinks() | Bumps() | Steady():
            return ""
        case ErosionLaw() | Coefficient() | Given() | SupplyFlux():
            return part.content
    return None


def _samples(case: Case) -> list[bytes]:
    """Return values of the functions from Python files; the table determines all other functions."""
    problem, nodes = case.problem, case.grid.nodes
    law, profile, given = problem.law, problem.profile, problem.coefficient
    found = []
    if law.table.get("law") == "python":
        found.append(_values(law.f, np.expm1(np.linspace(np.log(1e-8), np.log(1e8), 4001))))
    if profile.table.get("kind") == "python":
        found.append(_values(lambda x: profile.W(x, law), nodes))
    if given is not None and given.table.get("kind") == "python":
        times = np.linspace(0.0, problem.end, TIMES)[:, None]
        found.append(_values(given.function, times, nodes[:: -(-nodes.size // MOST_PLACES)]))
    if isinstance(problem.supply, SupplyFlux) and "file" in problem.supply.table:
        found.append(_values(problem.supply.function, np.linspace(0.0, problem.end, MOST_PLACES)))
    return found


def _values(function: Any, *at: Any) -> bytes:
    """Return the values of a function as bytes, or the name of the exception that it raises."""
    with np.errstate(all="ignore"):
        try:
            return np.asarray(function(*at), dtype=float).tobytes()
        except Exception as error:  # a user's function may raise any exception
            return type(error).__name__.encode()


@cache
def _package() -> str:
    """Return a hash of the modules of the package, without the folder of cases of an installed package."""
    home = Path(__file__).parent.parent
    found = (path for path in home.rglob("*.py") if path.parent.name != "cases")
    files = sorted((path.relative_to(home).as_posix(), path) for path in found)
    parts = [name.encode() + hashlib.sha256(path.read_bytes()).digest() for name, path in files]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]
