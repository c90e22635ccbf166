"""Case files: TOML that states a problem, its grid and how to solve it. Every key is known or refused."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem, erosion, profiles
from hjprofile.problem.grid import Grid
from hjprofile.problem.survey import survey

DEFAULT_METHOD = "local-lax-friedrichs"
DEFAULT_CFL = 0.9
DEFAULT_CHECKPOINT = 60.0  # seconds


@dataclass(frozen=True)
class Case:
    """A case file, read and checked.

    Attributes:
        name: of the file, without `.toml`.
        source: where it came from, for messages.
        method, cfl, tolerance: how to solve it.
        vtk, plots: what to write beside `profile.nc` and the tables.
        checkpoint: seconds between two checkpoints of a run on a grid.
        expect: what the case's own test asserts.
    """

    name: str
    source: str
    problem: Problem
    grid: Grid
    method: str = DEFAULT_METHOD
    cfl: float = DEFAULT_CFL
    tolerance: float | None = None
    vtk: bool = True
    plots: bool = True
    checkpoint: float = DEFAULT_CHECKPOINT
    expect: Mapping[str, Any] | None = None


class _Section:
    """A table of a case file from which every key is taken once, and whatever is left over is refused."""

    def __init__(self, source: str, name: str, values: Any):
        self.source, self.name = source, name
        if not isinstance(values, dict):
            raise InputError(f"{source}: {name} must be a table, written [{name}]")
        self.values: dict[str, Any] = dict(values)
        self.known: list[str] = []

    def error(self, message: str) -> InputError:
        return InputError(f"{self.source}: {'[' + self.name + '] ' if self.name else ''}{message}")

    def take(self, key: str, kind: Callable[[Any], Any], default: Any = ...) -> Any:
        self.known.append(key)
        if key not in self.values:
            if default is ...:
                raise self.error(f"{key} is missing; it must be {kind.__doc__}")
            return default
        value = self.values.pop(key)
        try:
            return kind(value)
        except (TypeError, ValueError):
            raise self.error(f"{key} = {_shown(value)} must be {kind.__doc__}") from None

    def finish(self) -> None:
        for key in self.values:
            close = difflib.get_close_matches(key, self.known, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            written = key if key.isprintable() else repr(key)  # a line break, an escape sequence of the terminal
            raise self.error(f"{written} is not a known key{hint} (allowed: {', '.join(self.known)})")


def _shown(value: Any) -> str:
    """The value as a message shows it."""
    try:
        return repr(value)
    except (ValueError, RecursionError):  # a hexadecimal number of thousands of digits, a dotted key of as many parts
        return "(too long to be shown)"


def _number(value: Any) -> float:
    """a finite number"""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise TypeError
    return float(value)


def _whole(value: Any) -> int:
    """a whole number"""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError
    str(value)  # Python writes no number of more than 4300 digits, nor could a message
    return value


def _text(value: Any) -> str:
    """a string"""
    if not isinstance(value, str):
        raise TypeError
    return value


def _switch(value: Any) -> bool:
    """true or false"""
    if not isinstance(value, bool):
        raise TypeError
    return value


def _list(value: Any) -> list[float]:
    """a list of finite numbers"""
    if not isinstance(value, list):
        raise TypeError
    return [_number(v) for v in value]


def _count_or_times(value: Any) -> int | list[float]:
    """a whole number or a list of times"""
    return _list(value) if isinstance(value, list) else _whole(value)


def _positive(value: Any) -> float:
    """a positive number"""
    if not _number(value) > 0:
        raise ValueError
    return float(value)


def _table(value: Any) -> dict:
    """a table"""
    if not isinstance(value, dict):
        raise TypeError
    return value


# kind or law -> constructor and its keys; a constructor takes the base folder where it reads a file
_LAWS: dict[str, tuple[Callable, dict[str, tuple]]] = {
    "rational": (erosion.rational, {}),
    "log": (erosion.log, {}),
    "power": (erosion.power, {"m": (_positive,)}),
    "expression": (lambda expression: erosion.expression(expression), {"expression": (_text,)}),
    "python": (
        lambda file, function, base: erosion.from_file(base / file, function, file),
        {"file": (_text,), "function": (_text,)},
    ),
}
_PROFILES: dict[str, tuple[Callable, dict[str, tuple]]] = {
    "kinks": (profiles.kinks, {"positions": (_list,), "amplitudes": (_list,)}),
    "bumps": (profiles.bumps, {"amplitudes": (_list,), "centres": (_list,), "widths": (_list,)}),
    "steps": (profiles.steps, {"edges": (_list,), "values": (_list,)}),
    "points": (profiles.points, {"x": (_list,), "q": (_list,)}),
    "steady": (profiles.steady, {"flux": (_number,), "kink": (_number, None)}),
    "survey": (
        survey,
        {"file": (_text,), "critical_slope": (_positive,), "length": (_positive,), "repair": (_text, None)},
    ),
    "python": (
        lambda file, function, base: profiles.Given(
            erosion.load_function(base / file, function), {"kind": "python", "file": file, "function": function}
        ),
        {"file": (_text,), "function": (_text,)},
    ),
}


def _build(section: _Section, chooser: str, choices: Mapping[str, tuple[Callable, dict]], base: Path) -> Any:
    """The law or profile that a section describes: `chooser` names one of `choices`."""
    name = section.take(chooser, _text)
    if name not in choices:
        raise section.error(f"{chooser} = {name!r} is not known; allowed are {', '.join(map(repr, choices))}")
    make, keys = choices[name]
    arguments = {key: section.take(key, *how) for key, how in keys.items()}
    section.finish()
    if "file" in keys:
        arguments["base"] = base
    try:
        return make(**arguments)
    except InputError as error:
        raise section.error(str(error)) from None


def load_case(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Case:
    """Reads a case file; `overrides` replaces values by dotted key, as in {"domain.cells": 500}.

    `path` may be the name of a case that comes with the package. Raises InputError, one sentence that names file,
    key, value and what is allowed.
    """
    path = find_case(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    except (ValueError, RecursionError) as error:  # beside bad syntax: integers of thousands of digits, deep nesting
        raise InputError(f"{path}: not valid TOML: {error}") from None
    for dotted, value in (overrides or {}).items():
        section, key = dotted.split(".")
        if isinstance(content.setdefault(section, {}), dict):
            content[section][key] = value
    return parse_case(content, name=path.stem, source=str(path), base=path.parent)


@np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks refuse
def parse_case(content: Mapping[str, Any], name: str, source: str, base: Path) -> Case:
    """A case from parsed TOML; paths in it are relative to `base`."""
    top = _Section(source, "", content)
    title = top.take("title", _text, name)
    sections = {
        key: _Section(source, key, top.take(key, _table, {}))
        for key in ("erosion", "profile", "domain", "time", "solver", "output")
    }
    expect = top.take("expect", _table, {})
    top.finish()

    law = _build(sections["erosion"], "law", _LAWS, base)
    profile = _build(sections["profile"], "kind", _PROFILES, base)
    domain, time, solver, output = (sections[k] for k in ("domain", "time", "solver", "output"))
    left, cells = domain.take("left", _number, None), domain.take("cells", _whole)
    time_values = {"end": time.take("end", _number), "snapshots": time.take("snapshots", _count_or_times, 31)}
    method, cfl = solver.take("method", _text, DEFAULT_METHOD), solver.take("cfl", _positive, DEFAULT_CFL)
    tolerance = solver.take("tolerance", _positive, None)
    vtk, plots = output.take("vtk", _switch, True), output.take("plots", _switch, True)
    checkpoint = output.take("checkpoint", _positive, DEFAULT_CHECKPOINT)
    for section in (domain, time, solver, output):
        section.finish()
    section = domain
    try:
        tail = min(profiles.TAIL, 0.01 * tolerance) if tolerance else profiles.TAIL
        grid = profile.grid(cells, tail) if left is None else Grid(left, cells)
        section = time
        problem = Problem(law, profile, title=title, **time_values)
        section = domain
        grid.check_memory(problem.kept)
        section = sections["profile"]
        profile.check(grid, law)
    except InputError as error:
        raise section.error(str(error)) from None
    return Case(name, source, problem, grid, method, cfl, tolerance, vtk, plots, checkpoint, expect)


def resolved_case(
    problem: Problem, grid: Grid, method: str, cfl: float = DEFAULT_CFL, tolerance: float | None = None
) -> dict[str, Any]:
    """The case, with every default filled in, as a table ready for TOML."""
    snapshots = problem.snapshots
    return {
        "title": problem.title,
        "erosion": dict(problem.law.table),
        "profile": dict(problem.profile.table),
        "domain": {"left": float(grid.left), "cells": int(grid.cells)},
        "time": {
            "end": float(problem.end),
            "snapshots": int(snapshots) if isinstance(snapshots, (int, np.integer)) else [float(t) for t in snapshots],
        },
        "solver": {"method": method, "cfl": float(cfl)} | ({} if tolerance is None else {"tolerance": tolerance}),
    }


def shipped_cases() -> dict[str, Path]:
    """Name -> file of the cases that come with the package."""
    here = Path(__file__).resolve().parent.parent
    for folder in (here / "cases", here.parent / "cases"):  # installed; a source checkout
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    return {}


def find_case(case: str | Path) -> Path:
    """The file of a case given by its path or by the name of a shipped one."""
    path = Path(case)
    try:
        if path.is_file():
            return path
    except OSError as error:  # a name too long, a folder that may not be entered
        raise InputError(f"{case}: cannot be read: {error.strerror}") from None
    shipped = shipped_cases()
    if str(case) in shipped:
        return shipped[str(case)]
    close = difflib.get_close_matches(path.stem, shipped, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise InputError(
        f"{case}: no such file, nor a case that comes with the package{hint} (they are: {', '.join(shipped)})"
    )
