"""Case files: TOML that states a problem, its grid and how to solve it. Every key is known or refused."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from hjprofile.errors import InputError, did_you_mean
from hjprofile.problem import LONGEST_TITLE, Problem, coefficient, erosion, profiles
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import as_number, as_path, number, plain, shown
from hjprofile.problem.survey import survey

DEFAULT_METHOD = "local-lax-friedrichs"
DEFAULT_CFL = 0.9
DEFAULT_CHECKPOINT = 60.0  # seconds
ABOUT = {  # section -> heading of the page on errors
    "erosion": "an-erosion-law",
    "layer": "a-layer",
    "profile": "a-profile",
    "coefficient": "a-prescribed-coefficient",
    "domain": "the-domain-and-the-grid",
    "time": "time-and-snapshots",
    "solver": "method-and-tolerance",
}


@dataclass(frozen=True)
class Case:
    """A case file, read and checked.

    Attributes:
        name: of the file, without `.toml`.
        source: where it came from, for messages.
        method, cfl, tolerance: how to solve it.
        refresh: how long the factor is kept before it is taken anew (theory, §10); None for anew in every step.
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
    refresh: float | None = None


class _Section:
    """A table of a case file from which every key is taken once, and whatever is left over is refused."""

    def __init__(self, source: str, name: str, values: Any):
        self.source, self.name = source, name
        if not isinstance(values, dict):
            raise InputError(f"{source}: {name} must be a table, written [{name}]", "a-value-of-the-wrong-kind")
        self.values: dict[str, Any] = dict(values)
        self.known: list[str] = []

    def error(self, message: str, about: str = "") -> InputError:
        where = f"[{self.name}] " if self.name else ""
        return InputError(f"{self.source}: {where}{message}", about or ABOUT.get(self.name, "a-case-file"))

    def missing(self, key: str, allowed: str) -> InputError:
        near = difflib.get_close_matches(key, filter(str.isprintable, self.values), 1)  # of those not yet taken
        hint = f" (is {near[0]!r} meant for it?)" if near else ""
        return self.error(f"{key} is missing{hint}; it must be {allowed}", "a-key-that-is-missing")

    def take(self, key: str, kind: _Kind, default: Any = ...) -> Any:
        self.known.append(key)
        if key not in self.values:
            if default is ...:
                raise self.missing(key, kind.words)
            return default
        value = self.values.pop(key)
        try:
            return kind.read(value)
        except (TypeError, ValueError):
            hint = " (without quotes)" if isinstance(value, str) and _is_number(value) else ""
            message = f"{key} = {shown(value)} must be {kind.words}{hint}"
            raise self.error(message, "a-value-of-the-wrong-kind") from None

    def finish(self) -> None:
        for key in self.values:
            written = key if key.isprintable() else repr(key)  # a line break, an escape sequence of the terminal
            hint = did_you_mean(key, self.known)
            message = f"{written} is not a known key{hint} (allowed: {', '.join(self.known)})"
            raise self.error(message, "a-misspelt-key")


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        return bool(np.isfinite(float(text)))
    return False


class _Kind(NamedTuple):
    """The words for allowed values, and the function that reads them; it raises TypeError or ValueError for others."""

    words: str
    read: Callable[[Any], Any]


def _of_type(kind: type) -> Callable[[Any], Any]:
    def read(value: Any) -> Any:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise TypeError
        return value

    return read


def _read_number(value: Any) -> float:
    if not np.isfinite(found := as_number(value)):
        raise TypeError
    return found


def _read_positive(value: Any) -> float:
    if not (found := _read_number(value)) > 0:
        raise ValueError
    return found


def _read_whole(value: Any) -> int:
    str(_of_type(int)(value))  # Python writes no number of more than 4300 digits
    return int(value)


def _read_list(value: Any) -> list[float]:
    return [_read_number(v) for v in _of_type(list)(value)]


_number = _Kind("a finite number", _read_number)
_positive = _Kind("a positive number", _read_positive)
_whole = _Kind("a whole number", _read_whole)
_text = _Kind("a string", _of_type(str))
_switch = _Kind("true or false", _of_type(bool))
_list = _Kind("a list of finite numbers", _read_list)
_count_or_times = _Kind(
    "a whole number or a list of times", lambda v: _read_list(v) if isinstance(v, list) else _read_whole(v)
)
_table = _Kind("a table", _of_type(dict))


def _profile_from_file(path: Path, function: str, file: str) -> profiles.Profile:
    loaded = erosion.load_function(path, function)
    return profiles.Given(
        loaded.function, {"kind": "python", "file": file, "function": function}, content=loaded.content
    )


# kind or law -> constructor and its keys; a constructor takes the base folder where it reads a file
_LAWS: dict[str, tuple[Callable, dict[str, tuple]]] = {
    "rational": (erosion.rational, {}),
    "log": (erosion.log, {}),
    "power": (erosion.power, {"m": (_positive,)}),
    "expression": (
        lambda expression, growth: erosion.expression(expression, growth),
        {"expression": (_text,), "growth": (_text, None)},
    ),
    "python": (
        lambda file, function, growth, base: erosion.from_file(erosion.located(base, file), function, file, growth),
        {"file": (_text,), "function": (_text,), "growth": (_text, None)},
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
        lambda file, function, base: _profile_from_file(erosion.located(base, file), function, file),
        {"file": (_text,), "function": (_text,)},
    ),
}

_COEFFICIENTS: dict[str, tuple[Callable, dict[str, tuple]]] = {
    "expression": (lambda expression: coefficient.coefficient(expression), {"expression": (_text,)}),
    "python": (
        lambda file, function, base: coefficient.from_file(erosion.located(base, file), function, file),
        {"file": (_text,), "function": (_text,)},
    ),
    "run": (coefficient.stored_coefficient, {"result": (_text,)}),
}


def _build(section: _Section, chooser: str, choices: Mapping[str, tuple[Callable, dict]], base: Path) -> Any:
    """The law, profile or coefficient that a section describes: `chooser` names one of `choices`."""
    allowed = ", ".join(map(repr, choices))
    if chooser not in section.values:
        raise section.missing(chooser, f"a string, one of {allowed}")
    name = section.take(chooser, _text)
    if name not in choices:
        hint = did_you_mean(name, list(choices))
        raise section.error(f"{chooser} = {name!r} is not known{hint or ';'} allowed are {allowed}", "a-misspelt-name")
    make, keys = choices[name]
    arguments = {key: section.take(key, *how) for key, how in keys.items()}
    section.finish()
    if keys.keys() & {"file", "result"}:
        arguments["base"] = base
    try:
        return make(**arguments)
    except InputError as error:
        raise section.error(str(error), error.about) from None


def load_case(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Case:
    """Read a case file; `overrides` replaces values by dotted key, as in {"domain.cells": 500}.

    Values may be numpy's numbers and arrays, or tuples. `path` may be the name of a case that comes with the package.
    Raises InputError, one sentence that names file, key, value and the allowed values.
    """
    path = find_case(path)
    content = read_case(path)
    for key, value in _overriding(overrides).items():
        section, dot, name = key.partition(".")
        if not dot:
            content[key] = value
        elif isinstance(content.setdefault(section, {}), dict):
            content[section][name] = value
    return parse_case(content, name=path.stem, source=str(path), base=path.parent)


def _overriding(overrides: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return key -> value as TOML could hold it. Raises InputError if a key is not one of a case."""
    if not isinstance(overrides, (Mapping, type(None))):
        raise InputError(f"overrides = {shown(overrides)} must be a table of keys and values", "a-case-file")
    for key in overrides or {}:
        if not isinstance(key, str) or key.count(".") > 1 or not all(key.split(".")):
            raise InputError(f"{shown(key)} is not a key of a case; it is written section.key, or title", "a-case-file")
    return {key: plain(value) for key, value in (overrides or {}).items()}


def read_case(path: Path) -> dict[str, Any]:
    """The tables of a case file, unchecked. Raises InputError if it cannot be read or is not TOML."""
    text = ""
    try:
        text = path.read_text(encoding="utf-8-sig")
        return tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}", "a-file-that-cannot-be-read") from None
    except UnicodeDecodeError as error:
        message = f"{path}: cannot be read: it is not text in UTF-8 ({error}); save it as UTF-8"
        raise InputError(message, "a-file-that-cannot-be-read") from None
    except (ValueError, RecursionError) as error:  # beside bad syntax: integers of thousands of digits, deep nesting
        found = re.search(r"\(at line (\d+), column \d+\)$", str(error))
        line = text.split("\n")[int(found[1]) - 1].strip()[:60] if found else ""
        shown = f", which reads {line!r}" if line else ""
        hint = "; write paths with / or in single quotes" if "\\" in line else ""
        raise InputError(f"{path}: not valid TOML: {error}{shown}{hint}", "a-file-that-is-no-toml") from None


def read_choices(arguments: Sequence[str]) -> dict[str, list[Any]]:
    """Dotted key -> values, from texts as `erosion.m=0.5,1,2`: values as TOML writes them, or plain words for strings.

    Raises InputError.
    """
    choices: dict[str, list[Any]] = {}
    for argument in arguments:
        key, equals, text = argument.partition("=")
        if not equals:
            raise InputError(f"{argument!r} must be written section.key=value,value,...", "a-sweep")
        if key in choices:
            raise InputError(f"{key} is there twice; name all its values at once", "a-sweep")
        word = r"(?<=,)\s*(?!(?:true|false|inf|nan)\s*,)([A-Za-z][\w./-]*)\s*(?=,)"
        for array in (text, re.sub(word, r'"\1"', f",{text},")[1:-1]):
            with suppress(ValueError, RecursionError):
                content = tomllib.loads(f"values = [{array}]")
                if len(content) == 1 and content["values"]:
                    choices[key] = content["values"]
                    break
        else:
            message = f"{argument!r} must have values as TOML writes them, or plain words, with commas between"
            raise InputError(message, "a-sweep")
    return choices


@np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks refuse
def parse_case(content: Mapping[str, Any], name: str, source: str, base: Path) -> Case:
    """A case from parsed TOML; paths in it are relative to `base`."""
    top = _Section(source, "", content)
    title = top.take("title", _text, name)
    if len(title) > LONGEST_TITLE:
        raise top.error(f"title has {len(title)} characters; at most {LONGEST_TITLE} are allowed")
    sections = {
        key: _Section(source, key, top.take(key, _table, {}))
        for key in ("erosion", "layer", "profile", "coefficient", "domain", "time", "solver", "output")
    }
    expect = top.take("expect", _table, {})
    top.finish()

    law = _build(sections["erosion"], "law", _LAWS, base)
    profile = _build(sections["profile"], "kind", _PROFILES, base)
    given = _build(sections["coefficient"], "kind", _COEFFICIENTS, base) if "coefficient" in content else None
    layer, domain, time, solver, output = (sections[k] for k in ("layer", "domain", "time", "solver", "output"))
    thickness = layer.take("thickness", _number, 0.0)
    line = domain.take("line", _text, "half")
    left = domain.take("left", _number, ... if line == "whole" else None)
    cells = domain.take("cells", _whole)
    right = domain.take("right", _number, ... if line == "whole" else 0.0)
    time_values = {"end": time.take("end", _number), "snapshots": time.take("snapshots", _count_or_times, 31)}
    method, cfl = solver.take("method", _text, DEFAULT_METHOD), solver.take("cfl", _positive, DEFAULT_CFL)
    tolerance, refresh = solver.take("tolerance", _positive, None), solver.take("refresh", _positive, None)
    vtk, plots = output.take("vtk", _switch, True), output.take("plots", _switch, True)
    checkpoint = output.take("checkpoint", _positive, DEFAULT_CHECKPOINT)
    for section in (layer, domain, time, solver, output):
        section.finish()
    section = solver
    try:
        cfl = number("cfl", cfl)
        section = output
        checkpoint = number("checkpoint", checkpoint)
        section = domain
        tail = min(profiles.TAIL, 0.01 * tolerance) if tolerance else profiles.TAIL
        grid = profile.grid(cells, tail) if left is None else Grid(left, cells, right)
        section = time
        problem = Problem(law, profile, title=title, **time_values)
        if given is not None:
            section = sections["coefficient"]
            problem = replace(problem, coefficient=given)
        section = layer
        problem = replace(problem, thickness=thickness)
        section = domain
        problem = replace(problem, line=line)
        grid.check_memory(problem.kept)
        problem.check_line(grid)
        section = sections["profile"]
        problem.check_profile(grid)
        if given is not None:
            section = sections["coefficient"]
            given.check(grid.nodes, problem.end)
    except InputError as error:
        raise section.error(str(error), error.about) from None
    return Case(name, source, problem, grid, method, cfl, tolerance, vtk, plots, checkpoint, expect, refresh)


def law_from(table: Mapping[str, Any]) -> erosion.ErosionLaw:
    """The law of an `[erosion]` table of a stored case, without the case. Raises InputError as `load_case` does."""
    return _build(_Section("the stored case", "erosion", table), "law", _LAWS, Path())


def resolved_case(
    problem: Problem,
    grid: Grid,
    method: str,
    cfl: float = DEFAULT_CFL,
    tolerance: float | None = None,
    refresh: float | None = None,
) -> dict[str, Any]:
    """The case, with every default filled in, as a table ready for TOML."""
    snapshots = problem.snapshots
    return {
        "title": problem.title,
        "erosion": plain(problem.law.table),
        **({"layer": {"thickness": problem.thickness}} if problem.thickness else {}),
        "profile": plain(problem.profile.table),
        **({} if problem.coefficient is None else {"coefficient": plain(problem.coefficient.table)}),
        "domain": {"left": grid.left, "cells": grid.cells}
        | ({"line": "whole", "right": grid.right} if problem.line == "whole" else {}),
        "time": {
            "end": problem.end,
            "snapshots": snapshots if isinstance(snapshots, int) else list(snapshots),
        },
        "solver": {"method": method, "cfl": float(cfl)}
        | ({} if tolerance is None else {"tolerance": float(tolerance)})
        | ({} if refresh is None else {"refresh": float(refresh)}),
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
    path = erosion.located(Path(), as_path("case", case))
    try:
        if path.is_file():
            return path
    except OSError as error:  # a name too long, a folder that may not be entered
        raise InputError(f"{case}: cannot be read: {error.strerror}", "a-file-that-cannot-be-read") from None
    shipped = shipped_cases()
    if str(case) in shipped:
        return shipped[str(case)]
    names = {name: name for name in shipped}
    with suppress(OSError, ValueError):  # a folder that may not be entered, a NUL
        names |= {beside.stem: str(beside) for beside in path.parent.glob("*.toml")}
    hint = did_you_mean(path.stem, names)
    folder = " (it is a folder)" if case and path.is_dir() else ""
    raise InputError(
        f"{case}: no such file{folder}, nor a case that comes with the package{hint} (they are: {', '.join(shipped)})",
        "a-case-that-is-not-there",
    )


def to_toml(content: Mapping[str, Any]) -> str:
    """TOML text of a resolved case."""
    return tomli_w.dumps(dict(content))
