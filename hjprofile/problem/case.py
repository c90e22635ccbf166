"""Cases: the problem of a case file with its grid and its options, built from the tables of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from hjprofile.errors import InputError, nearest
from hjprofile.problem import LONGEST_TITLE, Problem, erosion, profiles
from hjprofile.problem import case_keys as keys
from hjprofile.problem.case_files import find_case, read_case
from hjprofile.problem.case_keys import overriding, with_values
from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import TAIL, Profile
from hjprofile.problem.ranges import RANGES, plain, shown
from hjprofile.problem.schema import SECTIONS, Faults, Table, to_table
from hjprofile.problem.supply import from_layer, layer_table

IN_MEMORY = "case"  # name and source of a case that is in no file


@dataclass(frozen=True, eq=False, repr=False)
class Case:
    """A case file, read and checked.

    Attributes:
        name: the name of the file, without `.toml`.
        source: the path of the file, for messages.
        problem: the law, the profile and the supplied mass.
        grid: the cells and nodes, in exchange lengths.
        method: the name of the method.
        cfl: the CFL number.
        tolerance: the largest allowed error of u at the saved times, dimensionless; None if none is requested.
        refresh: the refresh interval of a frozen coefficient, a supplied mass (§8); None for every time step.
        vtk, plots: True if VTK files and pictures are written in addition to `profile.nc` and the tables.
        checkpoint: seconds between two checkpoints of a run on a grid.
        expect: the values that the test of the case asserts.
        supplied: the supplied volume per unit width, in the survey's unit squared, if the case states it in place of
            the end; else None.

    >>> import hjprofile as hj
    >>> case = hj.load_case("two_kinks")
    >>> case.name, case.grid.cells
    ('two_kinks', 2000)
    """

    name: str
    source: str
    problem: Problem
    grid: Grid
    method: str = keys.DEFAULT_METHOD
    cfl: float = keys.DEFAULT_CFL
    tolerance: float | None = None
    vtk: bool = True
    plots: bool = True
    checkpoint: float = keys.DEFAULT_CHECKPOINT
    expect: Mapping[str, Any] | None = None
    refresh: float | None = None
    supplied: float | None = None

    def __repr__(self) -> str:
        options = {"cfl": self.cfl, "tolerance": self.tolerance, "refresh": self.refresh}
        stated = "".join(f", {name}={value:g}" for name, value in options.items() if value is not None)
        return f"Case({self.name!r}, method={self.method!r}{stated})\n  {self.problem!r}\n  {self.grid!r}"


# a case, its tables, the path of its file, or the name of a shipped one
AnyCase = Case | Mapping[str, Any] | str | Path


class Source(NamedTuple):
    """The tables of a case, unchecked, with its name and source for messages, and the folder of paths in it."""

    content: dict[str, Any]
    name: str
    source: str
    base: Path


def source_of(case: Any) -> Source:
    """Return the source of a case: a path, a name of a shipped case, the tables of a case, or a `Case`."""
    if isinstance(case, Case):
        content = resolved_case(case.problem, case.grid, case.method, case.cfl, case.tolerance, case.refresh)
        if case.supplied is not None:
            content = with_values(content, {"time.supplied": case.supplied})
        return Source(content, case.name, case.source, Path(case.source).parent)
    if isinstance(case, Mapping):
        for key in [*case, *(name for table in case.values() if isinstance(table, Mapping) for name in table)]:
            if not isinstance(key, str):
                raise InputError(f"{shown(key)} is not a key of a case; keys are text", "a-case-file")
        return Source(plain(case), IN_MEMORY, IN_MEMORY, Path())
    path = find_case(case)
    return Source(read_case(path), path.stem, str(path), path.parent)


def as_case(case: Any) -> Case:
    """Return a `Case` itself, or the case that `load_case` returns for a path, a name or the tables of a case file."""
    return case if isinstance(case, Case) else load_case(case)


def load_case(path: AnyCase, overrides: Mapping[str, Any] | None = None) -> Case:
    """Read a case file and check it.

    Args:
        path: the path of a TOML file, the name of a case that comes with the package, the tables of a case file as
            `tomllib` returns them, in which paths are relative to the current folder, or a `Case` to be changed.
        overrides: values that replace those of the file, by dotted key; numbers and arrays of numpy and tuples are
            accepted. Of `time.end` and `time.supplied` each replaces the other.

    Returns:
        The case.

    Raises:
        InputError: for each fault a message with file, key, value and the allowed values.

    >>> import hjprofile as hj
    >>> hj.load_case("two_kinks", {"domain.cells": 500}).grid.cells
    500
    """
    found = source_of(path)
    content = with_values(found.content, overriding(overrides))
    return parse_case(content, found.name, found.source, found.base)


@np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks reject
def parse_case(content: Mapping[str, Any], name: str, source: str, base: Path) -> Case:
    """Return a case from parsed TOML; paths in it are relative to `base`.

    Check each section alone first, then the sections without fault together. Raise one InputError with all faults.
    """
    faults = Faults(source)
    top, sections = _sections(faults, content, name)
    law = keys.LAWS.build(sections["erosion"], base)
    profile = keys.PROFILES.build(sections["profile"], base)
    given = keys.COEFFICIENTS.build(sections["coefficient"], base) if "coefficient" in content else None
    supply, domain = from_layer(sections["layer"], base), keys.LINES.read(sections["domain"])
    time, solver = _time(sections["time"]), sections["solver"].take(keys.SOLVER)
    output = sections["output"].take(keys.OUTPUT)
    grid = _grid(sections["domain"], domain, profile, solver["tolerance"])
    problem = _timed(sections["time"], time, top["title"], profile)
    if grid and problem:
        with sections["domain"].noting():
            grid.check_memory(problem.kept)
    if law and profile and problem:
        problem = replace(problem, law=law, profile=profile)
        problem = _together(sections, problem, grid, given, {"supply_flux": supply} | domain)
    faults.stop()
    assert grid and problem  # `stop` has raised otherwise
    return Case(name, source, problem, grid, **solver, **output, expect=dict(top["expect"]), supplied=time["supplied"])


def _sections(faults: Faults, content: Mapping[str, Any], name: str) -> tuple[dict[str, Any], dict[str, Table]]:
    """Return the values above all sections, and the sections. Do not check a section whose name is misspelt."""
    table = Table(faults, "", content)
    top = table.take(keys.TOP)
    title = name if top["title"] is None else top["title"]
    if len(title) > LONGEST_TITLE:
        table.error(f"title has {len(title)} characters; at most {LONGEST_TITLE} are allowed")
    absent = [section for section in SECTIONS if section not in content]
    misspelt = {nearest(key, absent) for key in content if key not in top}
    sections = {key: Table(faults, key, None if key in misspelt else top[key]) for key in SECTIONS}
    return top | {"title": title[:LONGEST_TITLE]}, sections


def _grid(table: Table, domain: Mapping[str, Any], profile: Profile | None, tolerance: float | None) -> Grid | None:
    """Return the grid of a [domain]; None if the section, or the profile that determines its left end, is at fault."""
    with table.noting():
        if table.sound and domain["left"] is not None:
            return Grid(domain["left"], domain["cells"], domain["right"])
        if table.sound and profile:
            return profile.grid(domain["cells"], min(TAIL, 0.01 * tolerance) if tolerance else TAIL)
    return None


def _time(table: Table) -> dict[str, Any]:
    """Return the values of a [time], which has either `end` or `supplied`."""
    time = table.take(keys.OF_VOLUME if "supplied" in table.values else keys.TIME)
    if "end" in table.values and "supplied" in table.values:
        table.error("end and supplied are both given; a case has one of them, so remove the other")
    return time


def _timed(table: Table, time: Mapping[str, Any], title: str, profile: Profile | None) -> Problem | None:
    """Return a problem with the times of a [time]; its law and profile are placeholders.

    A supplied volume is divided by the unit of volume of the profile. Return None if either is at fault.
    """
    end, supplied = time["end"], time["supplied"]
    if table.sound and supplied is not None:
        if profile is None:
            return None
        if profile.units is None:
            table.error(
                f"supplied = {supplied:g} needs a profile with units, as a survey has them; state end, which is "
                "dimensionless, for this profile"
            )
            return None
        end = supplied / profile.units.volume
    with table.noting():
        if table.sound:
            if supplied is not None and not RANGES["end"].holds(end):
                raise InputError(
                    f"supplied = {supplied:g} is end = {end:g} in units of length² critical_slope; end must be "
                    f"{RANGES['end'].words}"
                )
            return Problem(erosion.rational(), profiles.kinks([-1.0], [1.0]), end, time["snapshots"], title)
    return None


def _together(
    sections: Mapping[str, Table], problem: Problem, grid: Grid | None, given: Coefficient | None, rest: dict[str, Any]
) -> Problem:
    """Return the whole problem. Note parts that do not go together or do not fit the grid; None is an absent part."""
    domain, medium = sections["domain"], sections["coefficient"]
    with medium.noting():
        problem = replace(problem, coefficient=given)
    with sections["layer"].noting():
        problem = replace(problem, supply_flux=rest["supply_flux"])
        problem.check_supply()
    if grid is None or not domain.sound:
        return problem
    with domain.noting():
        problem = replace(problem, line=rest["line"])
        problem.check_line(grid)
    if domain.sound:
        with sections["profile"].noting():
            problem.check_profile(grid)
    if domain.sound and medium.sound and given:
        with medium.noting():
            given.check(grid.nodes, problem.end)
    return problem


def law_from(table: Mapping[str, Any]) -> ErosionLaw:
    """Return the law of the `[erosion]` table of a stored case. Raise InputError as `load_case` does."""
    faults = Faults("the stored case")
    law: ErosionLaw = keys.LAWS.build(Table(faults, "erosion", table), Path())
    faults.stop()
    return law


def resolved_case(
    problem: Problem, grid: Grid, method: str, cfl: float = keys.DEFAULT_CFL, tolerance: float | None = None,
    refresh: float | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the case as a table ready for TOML, with every default filled in."""
    domain = {"left": grid.left, "cells": grid.cells, "line": problem.line, "right": grid.right}
    solver = {"method": method, "cfl": cfl, "tolerance": tolerance, "refresh": refresh}
    sections = {
        "erosion": plain(problem.law.table),
        "layer": layer_table(problem.supply),
        "profile": plain(problem.profile.table),
        "coefficient": plain(problem.coefficient.table) if problem.coefficient else {},
        "domain": keys.LINES.table(domain),
        "time": to_table(keys.TIME, {"end": problem.end, "snapshots": problem.snapshots}),
        "solver": to_table(keys.SOLVER, solver),
    }
    return {"title": problem.title} | {name: table for name, table in sections.items() if table}


def to_toml(content: Mapping[str, Any]) -> str:
    """Return the TOML text of a resolved case."""
    return tomli_w.dumps(dict(content))
