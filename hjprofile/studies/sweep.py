"""Sweeps: runs of one case for a product of values, each independent, on any executor."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError, by_last_part, did_you_mean
from hjprofile.problem.case import AnyCase, Case, Source, parse_case, source_of
from hjprofile.problem.case_keys import with_values
from hjprofile.problem.grid import Grid
from hjprofile.problem.identity import digest_of
from hjprofile.problem.ranges import as_number
from hjprofile.problem.units import Units
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.solve import check_case, solve_case

MOST_MEMBERS = 100_000  # largest number of members; each is built before the first is run
LENGTH = "profile.length"
ENDS = "left", "right"  # keys of [domain], in exchange lengths
_UNREAD = ("title", "output", "expect")  # sections of a case that do not change its run

QUANTITIES = {  # name -> description
    "end": "last saved time, supplied mass of grains",
    "cells": "cells of the grid",
    "steps": "time steps",
    "eroded_volume": "integral of u(0,x) - u(end,x)",
    "volume_budget_error": "largest difference between the eroded volume and toe outflow less supply",
    "toe_outflow": "grains that left at the toe, integral of K(left) over the supply",
    "crest_lowering": "u(0,0) - u(end,0)",
    "largest_lowering": "largest u(0,x) - u(end,x)",
    "largest_rise": "largest u(end,x) - u(0,x)",
    "q_min": "smallest excess slope at the end, mean over a cell",
    "q_max": "largest excess slope at the end, mean over a cell",
    "K_toe": "grain flux at the left end at the end, relative to the supply",
    "kinks_at_end": "kinks at the end",
    "births": "births of kinks",
    "merges": "merges of kinks",
    "exits": "exits of kinks at the crest",
    "kink_x": "position of the strongest kink at the end",
    "kink_jump": "jump of q over the strongest kink at the end",
    "error_estimate": "estimated error of u over all saved times",
    "toe_outflow_error": "estimated error of toe_outflow",
}


class Member(NamedTuple):
    """One run of a sweep, as it is sent to a worker: plain values only.

    Attributes:
        values: one for each varied key.
        content: the tables of the case, with these values in them.
        name, source, base: of the case file: its name, its path, the folder to which paths in it are relative.
        grid: of the case; None if it was rejected.
        identity: a hash that distinguishes it from every other run.
        refused: the reason for a rejection, or "".
        units: of a survey; None if the profile has none, or if the case was rejected.
        moved: the ends of the grid that move with the varied length, as keys of [domain].
    """

    values: tuple[Any, ...]
    content: Mapping[str, Any]
    name: str
    source: str
    base: Path
    grid: Grid | None = None
    identity: str = ""
    refused: str = ""
    units: Units | None = None
    moved: tuple[str, ...] = ()


class Outcome(NamedTuple):
    """The result of a member.

    Attributes:
        status: "done", or a sentence with the reason of a failure, without quantities.
        method: the method that solved it.
        quantities: by the names of their columns in sweep.csv; NaN if there is none.
        broken_bounds: names of the violated bounds, separated by spaces.
        wall_seconds: of the time stepping alone.
        u: height at the last saved time, shape (cells + 1,).
    """

    status: str
    method: str = ""
    quantities: Mapping[str, float] = {}
    broken_bounds: str = ""
    wall_seconds: float = np.nan
    u: Array | None = None

    @property
    def done(self) -> bool:
        return self.status == "done"


def members(case: AnyCase, vary: Mapping[str, list[Any]]) -> list[Member]:
    """Return a member for each choice of values, the last key varying fastest; each is built and checked.

    Raise InputError for a key that cannot be varied, and for a value that no member can use. A member with incompatible
    values is returned with the reason in `refused`.
    """
    found = source_of(case)
    content = found.content
    if not vary:
        raise InputError("a sweep varies at least one key of the case, as in erosion.m=0.5,1,2")
    for key, values in vary.items():
        section, dot, name = key.partition(".")
        if not (section and dot and name) or "." in name:
            there = [f"{s}.{k}" for s, table in content.items() if isinstance(table, dict) for k in table]
            hint = did_you_mean(key, by_last_part(there)) or ";"
            raise InputError(f"{key!r} is not a key of a case{hint} it is written section.key, as in erosion.m")
        if section in _UNREAD or not isinstance(content.get(section, {}), dict):
            raise InputError(f"{key} cannot be varied: it does not change a run")
        if not values:
            raise InputError(f"{key} needs one value or more")
    count = math.prod(map(len, vary.values()))
    if count > MOST_MEMBERS:
        raise InputError(f"the values make {count} members; a sweep has at most {MOST_MEMBERS}")
    made: list[Member] = []
    usable, refused = [set[int]() for _ in vary], [dict[int, str]() for _ in vary]
    for places in product(*(range(len(values)) for values in vary.values())):
        chosen = [values[i] for values, i in zip(vary.values(), places, strict=True)]
        made.append(_member(found, dict(zip(vary, chosen, strict=True))))
        for used, why, i in zip(usable, refused, places, strict=True):
            if made[-1].refused:
                why.setdefault(i, made[-1].refused)
            else:
                used.add(i)
    for (key, values), used, why in zip(vary.items(), usable, refused, strict=True):
        for i in range(len(values)):
            if i not in used:
                raise InputError(why[i])
        if len({text_of(value) for value in values}) < len(values):
            raise InputError(f"{key} has a value twice: {', '.join(map(text_of, values))}")
    return made


def text_of(value: Any) -> str:
    """Return a value as shown in a table: a string unchanged, a list as in TOML, a number in its shortest form."""
    if isinstance(value, str):
        return value
    number = isinstance(value, float) and value.is_integer() and abs(value) < 1e15
    return json.dumps(int(value) if number else value)


def _member(source: Source, values: Mapping[str, Any]) -> Member:
    """Return the member with these values, with the reason if it is rejected."""
    moved = _same_ground(source.content, values)
    tables = with_values(source.content, dict(values) | {f"domain.{name}": end for name, end in moved.items()})
    base = source.base.resolve()
    member = Member(tuple(values.values()), tables, source.name, source.source, base, moved=tuple(moved))
    try:
        case = parse_case(tables, member.name, member.source, base)
        check_case(case)
    except InputError as error:
        return member._replace(refused="; ".join(map(str, error.faults)))
    return member._replace(grid=case.grid, identity=digest_of(case), units=case.problem.profile.units)


def _same_ground(content: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, float]:
    """Return the ends of the grid that the case states, for the exchange length of a member.

    Ends are in exchange lengths, so they change as 1/length to hold their positions in the survey. Return {} if the
    length is not varied.
    """
    domain, profile = content.get("domain", {}), content.get("profile", {})
    if LENGTH not in values or not isinstance(domain, dict) or not isinstance(profile, dict):
        return {}
    stated, wanted = as_number(profile.get("length")), as_number(values[LENGTH])
    if not (0.0 < stated < np.inf and 0.0 < wanted < np.inf):  # the checks of the member reject it
        return {}
    ends = {name: as_number(domain.get(name)) for name in ENDS if f"domain.{name}" not in values}
    return {name: stated / wanted * end for name, end in ends.items() if np.isfinite(end)}


def held(vary: Mapping[str, Any], made: Sequence[Member]) -> str:
    """Return a sentence on what all members share although a unit varies: the ground and the supplied volume; or ""."""
    sentences = []
    if moved := made[0].moved:
        ends = " and ".join(f"domain.{name}" for name in moved)
        sentences.append(f"in each member {ends} times {LENGTH} is constant: all grids cover the same ground")
    supplied = made[0].content.get("time", {}).get("supplied")
    if supplied is not None and "time.supplied" not in vary and {LENGTH, "profile.critical_slope"} & set(vary):
        named = next((m.units.unit for m in made if m.units and m.units.unit), "")
        unit = f" {named}²" if named else ""
        sentences.append(f"every member is supplied with the same volume per unit width, {supplied:g}{unit}")
    return "; ".join(sentences)


def run_member(member: Member) -> Outcome:
    """Solve one member by its case's own method. Any failure becomes its status, so that others continue."""
    try:
        case = parse_case(member.content, member.name, member.source, member.base)
        if digest_of(case) != member.identity:  # its results would be attributed to another run
            return Outcome(
                f"{case.source}: a file that the case names, or the package itself, has changed since the sweep "
                "began; sweep again"
            )
        run = solve_case(case)
    except MemoryError:
        return Outcome("the memory of this machine is not sufficient; use fewer workers, cells or snapshots")
    except (InputError, RunError) as error:
        return Outcome(str(error))
    except Exception as error:  # a user's law may raise any exception
        return Outcome(f"{type(error).__name__}: {error}")
    if not run.done:
        return Outcome(run.status, run.method)
    broken = " ".join(name for name, bound in run.bounds.items() if not bound.holds)
    return Outcome("done", run.method, _quantities(case, run), broken, run.wall_seconds, run.u[-1].copy())


def _quantities(case: Case, run: Run) -> dict[str, float]:
    """Return the quantities of a run."""
    with np.errstate(all="ignore"):  # far from a narrow bump
        lowered = run.x + case.problem.profile.W(run.x, case.problem.law) - run.u[-1]
    left = run.kinks_at(-1)
    strongest = max(left, key=lambda kink: kink.jump, default=None)
    events = [event.event for event in run.events]
    numbers: dict[str, Any] = {
        "end": run.time[-1],
        "cells": run.cells,
        "steps": run.steps,
        "eroded_volume": run.eroded_volume,
        "volume_budget_error": run.volume_budget_error,
        "toe_outflow": run.toe_outflow,
        "crest_lowering": run.crest_lowering,
        "largest_lowering": max(lowered.max(), 0.0),
        "largest_rise": max(-lowered.min(), 0.0),
        "q_min": run.q[-1].min(),
        "q_max": run.q[-1].max(),
        "K_toe": run.K[-1, 0],
        "kinks_at_end": len(left),
        "births": events.count("birth"),
        "merges": events.count("merge"),
        "exits": events.count("exit"),
        "kink_x": strongest.x if strongest else np.nan,
        "kink_jump": strongest.jump if strongest else np.nan,
        "error_estimate": np.nan if run.error_estimate is None else run.error_estimate,
        "toe_outflow_error": np.nan if run.toe_outflow_error is None else run.toe_outflow_error,
    }
    return {name: float(numbers[name]) for name in QUANTITIES}


def run_members(todo: Mapping[int, Member], executor: Executor | None = None) -> Iterator[tuple[int, Outcome]]:
    """Run members on an executor, or sequentially without one; yield each with its number when it is done.

    Any executor of the standard protocol is allowed, with workers on this machine or on others. Raise RunError if its
    workers are lost. Members that have not begun are cancelled if the iteration ends early.
    """
    if executor is None:
        for number, member in todo.items():
            yield number, run_member(member)
        return
    futures: dict[Any, int] = {}
    try:
        for number, member in todo.items():
            futures[executor.submit(run_member, member)] = number
        for future in as_completed(futures):
            try:
                outcome = future.result()
            except BrokenExecutor:
                raise
            except Exception as error:  # the member or its result was lost in transfer
                outcome = Outcome(f"{type(error).__name__}: {error}")
            yield futures.pop(future), outcome
    except BrokenExecutor:
        futures.clear()  # none of them will begin
        raise RunError(
            "a worker was lost, perhaps because the memory was not sufficient; use fewer workers, cells or snapshots"
        ) from None
    finally:
        for future in futures:
            future.cancel()
