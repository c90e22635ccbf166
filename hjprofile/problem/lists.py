"""Checks of lists of numbers that a user gives."""

from __future__ import annotations

from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import RANGES, as_number, read_only, shown

Array = np.ndarray


def numbers(name: str, values: Any, least: int = 1, key: str = "") -> Array:
    """Return a read-only copy, shape (n,), n >= least. Raise InputError for fewer numbers, or any out of the range of
    `key` or `name`.
    """
    array = as_numbers(values)
    if array is None:
        raise InputError(f"{name} = {shown(values)} must be a list of numbers")
    if array.ndim != 1 or array.size < least:
        raise InputError(f"{name} = {shown(values)} must be a list of at least {least} numbers")
    allowed = RANGES[key or name]
    if not np.all(inside := allowed.holds(array)):
        i = int(np.argmin(inside))
        raise InputError(f"{name}[{i}] = {array[i]:g} must be {allowed.words}")
    return read_only(array)


def as_numbers(values: Any) -> Array | None:
    """Return a copy as an array of floats; None for other types and for lists of several lengths."""
    if isinstance(values, (list, tuple)) and any(isinstance(v, (bool, np.bool_)) for v in values):
        return None
    try:
        array = np.array(values)
    except ValueError:
        return None
    if array.dtype == object and isinstance(values, (list, tuple)):  # integers too large for those of numpy
        array = np.array([as_number(v) for v in values])
        return None if np.isnan(array).any() else array
    return array.astype(float) if array.dtype.kind in "iuf" else None


def same_length(**named: Array) -> None:
    """Raise InputError unless all of these lists have as many entries as the first."""
    (first, a), *others = named.items()
    for name, b in others:
        if a.size != b.size:
            raise InputError(f"{name} has {b.size} entries and {first} has {a.size}; both must have the same number")


def within(grid: Grid, name: str, places: Array) -> None:
    """Raise InputError if the last of these positions lies right of the grid."""
    if places[-1] > grid.right:
        end = f"right = {grid.right:g}, where the window ends" if grid.right else "the crest; the domain ends at x = 0"
        raise InputError(f"{name}[{places.size - 1}] = {places[-1]:g} lies past {end}")


def above_minus_one(name: str, values: Array) -> None:
    """Raise InputError if one of these slopes q is not above -1."""
    if np.any(values <= -1.0):
        i = int(np.argmax(values <= -1.0))
        raise InputError(f"{name}[{i}] = {values[i]:g} must be above -1: the slope u_x = 1 + q is positive")
