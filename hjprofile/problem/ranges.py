"""The range of each number that a user gives, and conversions of values of Python and numpy."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError

Array = np.ndarray

SAME_TIME = 1e-9  # relative to the span of a run: times that are closer differ by rounding only
LONGEST_SHOWN = 400  # characters of a value in a message
MOST_LISTED, LONGEST_BRIEF = 6, 60  # numbers of a list, and characters of a value, in a repr


class Range(NamedTuple):
    """An interval of numbers from `least` to `most`, with 0 as well if `zero`; `words` describe it in a message."""

    least: float
    most: float
    words: str
    zero: bool = False

    def holds(self, value: Any) -> Any:
        """Return True if a number is allowed, or a mask for an array; NaN is not allowed."""
        return ((value >= self.least) & (value <= self.most)) | (self.zero & (value == 0.0))


def _positive(least: float, most: float) -> Range:
    return Range(least, most, f"a positive number from {least:g} to {most:g}")


_PLACE = Range(-1e9, 1e9, "a finite number, at most 1e9 in size")
_DOWNHILL = Range(-1e9, -1e-9, "a negative number, because the crest is at x = 0 (from -1e9 to -1e-9)")
_SLOPE = Range(-1e8, 1e8, "a finite number, at most 1e8 in size")
RANGES = {  # docs/cases.md has the same table
    "end": Range(1e-300, 1e12, "a number, 0 or more, from 1e-300 to 1e12 if not 0", zero=True),
    "supplied": Range(1e-300, 1e36, "a number, 0 or more, from 1e-300 to 1e36 if not 0", zero=True),
    "supply_flux": Range(1e-300, 1e6, "a number, 0 or more, from 1e-300 to 1e6 if not 0", zero=True),
    "supply_flux(t)": _positive(1e-100, 1e6),
    "left": _DOWNHILL,
    "left of a window": _PLACE,
    "right": _PLACE,
    "cfl": _positive(1e-4, 100.0),
    "refresh": _positive(1e-300, 1e12),
    "checkpoint": _positive(1e-9, 1e9),
    "positions": _PLACE,
    "centres": _PLACE,
    "edges": _PLACE,
    "x": _PLACE,
    "widths": _positive(1e-9, 1e9),
    "amplitudes": _SLOPE,
    "values": _SLOPE,
    "q": _SLOPE,
    "flux": _positive(1e-12, 1e12),
    "kink": _DOWNHILL,
    "critical_slope": _positive(1e-6, 1e6),
    "length": _positive(1e-9, 1e12),
    "sigma": _positive(1e-12, 1e12),
    "f'(0)": _positive(1e-9, 1e9),  # of a law; with lengths in units of 1/f'(0) laws are of order 1
    "k": _positive(1e-100, 1e100),
    # other laws underflow or overflow at ordinary slopes
    "m": Range(1e-100, 100.0, "a positive number, at most 100 (and not below 1e-100: use the law 'log')"),
}


def as_number(value: Any) -> float:
    """Return a number of Python or numpy as a float, infinite if too large; NaN if the value is no number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        return np.nan
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


def number(name: str, value: Any, about: str = "", key: str = "") -> float:
    """Return the number of that name. Raise InputError unless it is in the range of `key` or `name`."""
    allowed = RANGES[key or name]
    if not allowed.holds(found := as_number(value)):
        raise InputError(f"{name} = {shown(value)} must be {allowed.words}", about)
    return found + 0.0  # no -0


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return the whole number of that name. Raise InputError for other types and outside of `least` to `most`."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    fits = isinstance(value, (int, np.integer)) and value >= least and (most is None or value <= most)
    if isinstance(value, bool) or not fits:
        up_to = f"{least} or more" if most is None else f"from {least} to {most}"
        raise InputError(f"{name} = {shown(value)} must be a whole number, {up_to}")
    return int(value)


def as_index(name: str, value: Any, count: int) -> int:
    """Return the index from 0 on of one of `count` items, of which -1 is the last. Raise InputError for others."""
    found = whole(name, value, -count, count - 1)
    return found % count


def instance(name: str, value: Any, kind: type) -> None:
    """Raise InputError if the value of that name is of another type."""
    if not isinstance(value, kind):
        raise InputError(f"{name} = {shown(value)} must be of the type {kind.__name__}")


def as_path(name: str, value: Any) -> Path:
    """Return the path of that name. Raise InputError for other types."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"{name} = {shown(value)} must be a path")
    return Path(value)


def shown(value: Any) -> str:
    """Return the text of a value for a message."""
    with suppress(Exception):  # an integer of thousands of digits, a key of as many parts, an error in repr
        if len(text := repr(plain(value))) <= LONGEST_SHOWN and "\n" not in text:
            return text
    return "(too long to be shown)"


def brief(value: Any) -> str:
    """Return the text of a value for `repr`; a long list by its ends and its length."""
    value = plain(value)
    if isinstance(value, list) and len(value) > MOST_LISTED:
        return f"[{brief(value[0])}, ..., {brief(value[-1])} ({len(value)} numbers)]"
    if isinstance(value, list):
        return f"[{', '.join(map(brief, value))}]"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str) and len(value) > LONGEST_BRIEF:
        return repr(value[:LONGEST_BRIEF] + "...")
    return repr(value)


def plain(value: Any) -> Any:
    """Return a value as types of TOML: numbers, arrays, tuples and paths become plain numbers, lists and text."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, Mapping):
        return {key: plain(v) for key, v in value.items()}
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def read_only(array: Array) -> Array:
    """Return a read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view
