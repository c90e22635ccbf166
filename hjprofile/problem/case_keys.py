"""The keys of case files, section by section, and values that replace those of a file."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from hjprofile.errors import InputError, by_last_part, did_you_mean
from hjprofile.problem import coefficient, erosion, profiles
from hjprofile.problem.given import from_file
from hjprofile.problem.grid import FEWEST_CELLS
from hjprofile.problem.kinds import COUNT_OR_TIMES, NUMBER, POSITIVE, SWITCH, TABLE, TEXT, WHOLE
from hjprofile.problem.ranges import number, plain, shown, whole
from hjprofile.problem.schema import SECTIONS, Choice, Choices, Key
from hjprofile.problem.supply import LAYER
from hjprofile.problem.survey import survey

DEFAULT_METHOD = "local-lax-friedrichs"
DEFAULT_CFL = 0.9
DEFAULT_CHECKPOINT = 60.0  # seconds

TOP = Key("title", TEXT, None), *(Key(name, TABLE, {}) for name in (*SECTIONS, "expect"))
LAWS = Choices(Key("law", TEXT), erosion.rational, erosion.log, erosion.power, erosion.expression, erosion.from_file)
PROFILES = Choices(
    Key("kind", TEXT), profiles.Kinks, profiles.Bumps, profiles.steps, profiles.Points, profiles.Steady, survey,
    from_file,
)  # fmt: skip
COEFFICIENTS = Choices(
    Key("kind", TEXT), coefficient.from_expression, coefficient.from_file, coefficient.stored_coefficient
)
CELLS = Key("cells", WHOLE, check=partial(whole, least=FEWEST_CELLS))
LINES = Choices(
    Key("line", TEXT, "half"),
    Choice("half", (Key("left", NUMBER, None), CELLS, Key("right", NUMBER, 0.0))),
    Choice("whole", (Key("left", NUMBER), CELLS, Key("right", NUMBER))),
)
SNAPSHOTS = Key("snapshots", COUNT_OR_TIMES, 31, filled=True)
TIME = Key("end", NUMBER, check=number), Key("supplied", NUMBER, None, check=number), SNAPSHOTS
OF_VOLUME = Key("end", NUMBER, None), Key("supplied", NUMBER, check=number), SNAPSHOTS  # a [time] that states a volume
ALTERNATIVES = {"time.end": "time.supplied", "time.supplied": "time.end"}  # each replaces the other
SOLVER = (
    Key("method", TEXT, DEFAULT_METHOD, filled=True),
    Key("cfl", POSITIVE, DEFAULT_CFL, filled=True, check=number),
    Key("tolerance", POSITIVE, None),
    Key("refresh", POSITIVE, None),
)
OUTPUT = (
    Key("vtk", SWITCH, True),
    Key("plots", SWITCH, True),
    Key("checkpoint", POSITIVE, DEFAULT_CHECKPOINT, check=number),
)


def with_values(content: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of the tables of a case with these values by dotted key.

    A value of `time.end` replaces `time.supplied`, and the reverse, unless both are among the values.
    """
    tables = {name: dict(table) if isinstance(table, dict) else table for name, table in content.items()}
    for key, value in values.items():
        section, dot, name = key.partition(".")
        if not dot:
            tables[key] = value
        elif isinstance(tables.setdefault(section, {}), dict):
            tables[section][name] = value
            other = ALTERNATIVES.get(key)
            if other and other not in values:
                tables[section].pop(other.partition(".")[2], None)
    return tables


def overriding(overrides: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return key -> value as TOML could hold it. Raise InputError if a key is not one of a case."""
    if not isinstance(overrides, (Mapping, type(None))):
        raise InputError(f"overrides = {shown(overrides)} must be a table of keys and values", "a-case-file")
    for key in overrides or {}:
        if not isinstance(key, str) or key.count(".") > 1 or not all(key.split(".")):
            raise InputError(f"{shown(key)} is not a key of a case; it is written section.key, or title", "a-case-file")
        _check_section(key)
    return {key: plain(value) for key, value in (overrides or {}).items()}


def _check_section(key: str) -> None:
    """Raise InputError for a key without its section, or with that of another key."""
    known = {f"{section}.{key.name}" for section, keys in _keys().items() for key in keys}
    section, dot, name = key.rpartition(".")
    misplaced = section in SECTIONS and any(name == each.rpartition(".")[2] for each in known)
    if key not in known and (misplaced or (not dot and key not in (each.name for each in TOP))):
        hint = did_you_mean(name, by_last_part(known))
        raise InputError(f"{shown(key)} is not a key of a case{hint}", "a-misspelt-key")


def _keys() -> dict[str, list[Key]]:
    """Return section -> its keys, with those of every law and kind."""
    choices = {"erosion": LAWS, "profile": PROFILES, "coefficient": COEFFICIENTS, "domain": LINES}
    keys = {
        section: [each.chooser, *(k for c in each.choices.values() for k in c.keys)]
        for section, each in choices.items()
    }
    return keys | {"layer": [*LAYER], "time": [*TIME], "solver": [*SOLVER], "output": [*OUTPUT]}
