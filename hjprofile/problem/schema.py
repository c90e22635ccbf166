"""The schema of case files: keys with kinds and defaults, each declared once, for reading and for writing TOML."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

from hjprofile.errors import InputError, did_you_mean, nearest
from hjprofile.problem.kinds import Kind, is_number
from hjprofile.problem.paths import InCase
from hjprofile.problem.ranges import brief, shown

Maker = TypeVar("Maker", bound=Callable[..., Any])
REQUIRED: Any = inspect.Parameter.empty  # the default of a key that has none
PATHS = {"file", "result"}  # keys that hold paths, relative to the case file
SECTIONS = "erosion", "layer", "profile", "coefficient", "domain", "time", "solver", "output"
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
class Key:
    """A key of a section.

    Attributes:
        default: the default; REQUIRED if there is none.
        filled: True if a resolved case contains the key even with its default.
        check: a function of name and value that raises InputError for a value out of range; None if the function that
            takes the values checks them.
    """

    name: str
    kind: Kind
    default: Any = REQUIRED
    filled: bool = False
    check: Callable[[str, Any], Any] | None = None

    def left_out(self, value: Any) -> bool:
        """Return True if a resolved case does not contain the key with this value."""
        if self.filled or self.default is REQUIRED:
            return False
        return bool(value is None if self.default is None else value == self.default)


def to_table(keys: Sequence[Key], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a resolved case, in the order of the values; ignore values that have no key."""
    known = {key.name: key for key in keys}
    stated = {n: v for n, v in values.items() if n in known and not known[n].left_out(v)}
    return {name: known[name].kind.write(value) for name, value in stated.items()}


class Faults:
    """The faults of one case file; each message names file and section."""

    def __init__(self, source: str):
        self.source = source
        self.found: list[tuple[str, InputError]] = []

    def error(self, message: str, about: str = "", section: str = "") -> None:
        """Record a fault."""
        where = f"[{section}] " if section else ""
        error = InputError(f"{self.source}: {where}{message}", about or ABOUT.get(section, "a-case-file"))
        self.found.append((section, error))

    def stop(self) -> None:
        """Raise one InputError with all faults, section by section, if there are any."""
        if self.found:
            order = ("", *SECTIONS)
            raise InputError.of([error for _, error in sorted(self.found, key=lambda fault: order.index(fault[0]))])


class Table:
    """A section of a case file, from which keys are taken; after its first fault it is not `sound`.

    A section whose `values` are None is already at fault.
    """

    def __init__(self, faults: Faults, name: str, values: Any):
        self.faults, self.name, self.sound = faults, name, isinstance(values, dict)
        if values is not None and not self.sound:
            faults.error(f"{name} must be a table, written [{name}]", "a-value-of-the-wrong-kind")
        self.values: dict[str, Any] = dict(values) if self.sound else {}

    def error(self, message: str, about: str = "") -> None:
        """Record a fault of this section."""
        self.sound = False
        self.faults.error(message, about, self.name)

    @contextmanager
    def noting(self) -> Iterator[None]:
        """Record errors that are raised inside as faults of this section."""
        try:
            yield
        except InputError as error:
            for fault in error.faults:
                self.error(str(fault), fault.about)

    def take(self, keys: Sequence[Key]) -> dict[str, Any]:
        """Return the values of these keys, the only ones that the section may have; None for a key at fault.

        An unknown key that is spelt like a missing one is reported with the missing key only.
        """
        found: dict[str, Any] = dict.fromkeys(names := [key.name for key in keys])
        if not self.sound:
            return found
        strange = [name for name in self.values if name not in names]
        for key in keys:
            if key.name in self.values:
                found[key.name] = self.read(key)
            elif key.default is REQUIRED:
                self.missing(key, strange)
            else:
                found[key.name] = key.default
        for name in strange:
            written = name if name.isprintable() else repr(name)  # a line break, or an escape sequence of a terminal
            message = f"{written} is not a known key{did_you_mean(name, names)} (allowed: {', '.join(names)})"
            self.error(message, "a-misspelt-key")
        return found

    def read(self, key: Key) -> Any:
        """Return the value of a key that is present; None if it is at fault."""
        value = self.values[key.name]
        try:
            found = key.kind.read(value)
        except (TypeError, ValueError):
            hint = " (without quotes)" if isinstance(value, str) and is_number(value) else ""
            self.error(f"{key.name} = {shown(value)} must be {key.kind.words}{hint}", "a-value-of-the-wrong-kind")
            return None
        with self.noting():
            return key.check(key.name, found) if key.check else found
        return None

    def missing(self, key: Key, strange: list[str], allowed: str = "") -> None:
        """Record a missing key; remove the key of `strange` that is spelt like it."""
        near = nearest(key.name, filter(str.isprintable, strange))
        strange[:] = [name for name in strange if name != near]
        hint = f" ({near!r} is not a known key)" if near else ""
        self.error(f"{key.name} is missing{hint}; it must be {allowed or key.kind.words}", "a-key-that-is-missing")


@dataclass(frozen=True)
class Choice:
    """A law, profile or coefficient by its name in a case file: its keys, and the function that makes it from them."""

    name: str
    keys: tuple[Key, ...]
    chooser: str = "kind"
    make: Callable[..., Any] = dict

    def table(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the section of a resolved case with these values."""
        return {self.chooser: self.name} | to_table(self.keys, values)


def choice(name: str, chooser: str = "kind", into: str = "table", **kinds: Kind) -> Callable[[Maker], Maker]:
    """Declare a function or a class as the maker of a choice, whose keys are its arguments with these kinds.

    A key is optional if the argument has a default, or is one of those that the function takes as `**named`. The table
    of a case file that makes the object again is stored in the field `into` of the object that a function returns; a
    class computes it from its attributes.
    """

    def declared(make: Maker) -> Maker:
        signature = inspect.signature(make)
        arguments = signature.parameters
        further = [name for name, each in arguments.items() if each.kind is inspect.Parameter.VAR_KEYWORD]
        defaults = {name: each.default for name, each in arguments.items()}
        keys = tuple(Key(key, kind, defaults.get(key)) for key, kind in kinds.items())

        @wraps(make)
        def made(*args: Any, **named: Any) -> Any:
            found = make(*args, **named)
            bound = signature.bind(*args, **named).arguments
            for name in further:
                bound |= bound.pop(name, {})
            return with_origin(found, **{into: maker.choice.table(bound)})

        maker: Any = make if isinstance(make, type) else made
        maker.choice = Choice(name, keys, chooser, maker)
        return maker

    return declared


def with_origin(thing: Any, **origin: Any) -> Any:
    """Return a copy of a dataclass with other values of some fields, also of those that its constructor does not take.

    Such a field holds the origin of the object: the table that makes it again, the hash of a file. An object
    that a user constructs has none.
    """
    made = object.__new__(type(thing))
    vars(made).update({each.name: getattr(thing, each.name) for each in fields(thing)} | origin)
    return made


def table_of(make: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section of a resolved case for a maker that `choice` has declared, with these values."""
    return make.choice.table(values)


def as_call(table: Mapping[str, Any], chooser: str, of_function: str) -> str:
    """Return the table of a choice as a call with short arguments, for `repr`.

    `of_function` is the name of the public function that takes a Python function, of which the table has the name.
    """
    if "function" in table:
        return f"{of_function}({table['function']})"
    values = (f"{key}={brief(value)}" for key, value in table.items() if key != chooser)
    return f"{table[chooser]}({', '.join(values)})"


class Choices:
    """A section in which one key selects the choice to which the other keys belong."""

    def __init__(self, chooser: Key, *choices: Any):
        """Accept choices, or makers that `choice` has declared."""
        self.chooser = chooser
        found = (each if isinstance(each, Choice) else each.choice for each in choices)
        self.choices: dict[str, Choice] = {each.name: each for each in found}

    def read(self, table: Table) -> dict[str, Any]:
        """Return the values of the section; that of the chooser is None if there is no such choice."""
        name = self._chosen(table)
        if name is None:
            return {self.chooser.name: None}
        return table.take([self.chooser, *self.choices[name].keys])

    def build(self, table: Table, base: Path) -> Any:
        """Return the law, profile or coefficient that a section describes; None if it is at fault."""
        values = self.read(table)
        if not table.sound:
            return None
        chosen = self.choices[values.pop(self.chooser.name)]
        for key in PATHS & values.keys():
            if isinstance(values[key], str):
                values[key] = InCase.of(values[key], base)
        with table.noting():
            return chosen.make(**values)
        return None

    def table(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the section of a resolved case with these values, among them that of the chooser."""
        return to_table([self.chooser, *self.choices[values[self.chooser.name]].keys], values)

    def _chosen(self, table: Table) -> str | None:
        """Return the name of the choice; None if it is missing or unknown."""
        key, allowed = self.chooser, ", ".join(map(repr, self.choices))
        if not table.sound:
            return None
        if key.name not in table.values and key.default is REQUIRED:
            table.missing(key, list(table.values), f"a string, one of {allowed}")
            return None
        name = table.read(key) if key.name in table.values else key.default
        if name is not None and name not in self.choices:
            hint = did_you_mean(name, list(self.choices))
            table.error(f"{key.name} = {name!r} is not known{hint or ';'} allowed are {allowed}", "a-misspelt-name")
            return None
        return name
