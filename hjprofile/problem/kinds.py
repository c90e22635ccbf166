"""The kinds of values in case files: the admitted TOML values, and the TOML form of a value."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem.ranges import as_number, plain


class Kind(NamedTuple):
    """A kind of values of a key.

    Attributes:
        words: the description of the values in a message.
        read: TOML -> value; raises TypeError or ValueError for other values.
        write: value, or an equivalent value of Python -> TOML.
    """

    words: str
    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = plain


def _of_type(kind: type) -> Callable[[Any], Any]:
    """Return a reader of values of one type."""

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
    str(_of_type(int)(value))  # Python prints no number of more than 4300 digits
    return int(value)


def _read_list(value: Any) -> list[float]:
    return [_read_number(v) for v in _of_type(list)(value)]


def _read_numbers(value: Any) -> list[float]:
    return _read_list(value) if isinstance(value, list) else [_read_number(value)]


def _read_columns(value: Any) -> list[str | int]:
    columns = _of_type(list)(value)
    if len(columns) not in (2, 3) or not all(type(c) in (str, int) for c in columns):
        raise TypeError
    return columns


def _read_count_or_times(value: Any) -> int | list[float]:
    return _read_list(value) if isinstance(value, list) else _read_whole(value)


def _write_number(value: Any) -> float:
    return float(value) + 0.0  # no -0


NUMBER = Kind("a finite number", _read_number, _write_number)
POSITIVE = Kind("a positive number", _read_positive, _write_number)
WHOLE = Kind("a whole number", _read_whole)
TEXT = Kind("a string", _of_type(str), str)
STRIPPED = Kind("a string", _of_type(str), str.strip)
SWITCH = Kind("true or false", _of_type(bool))
LIST = Kind("a list of finite numbers", _read_list, lambda values: np.asarray(values, dtype=float).tolist())
NUMBERS = Kind("a finite number or a list of them", _read_numbers)
COLUMNS = Kind("a list of two names or numbers of columns (x, height), or of three (x, y, height)", _read_columns)
COUNT_OR_TIMES = Kind("a whole number or a list of times", _read_count_or_times)
TABLE = Kind("a table", _of_type(dict))


def is_number(text: str) -> bool:
    """Return True if a text is a finite number."""
    with suppress(ValueError):
        return bool(np.isfinite(float(text)))
    return False
