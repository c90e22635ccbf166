"""Lists of numbers that a user gives, checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.grid import Grid

Array = np.ndarray


def numbers(name: str, values: Any, least: int = 1) -> Array:
    """As an array, shape (n,) with n >= least. Raises InputError if they are not that many finite numbers."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} = {values!r} must be a list of numbers") from None
    if array.ndim != 1 or array.size < least:
        raise InputError(f"{name} = {values!r} must be a list of at least {least} numbers")
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name}[{np.argmin(np.isfinite(array))}] must be a finite number")
    return array


def same_length(**named: Array) -> None:
    """Raises InputError if these lists, by name, have not as many entries as the first."""
    (first, a), *others = named.items()
    for name, b in others:
        if a.size != b.size:
            raise InputError(f"{name} has {b.size} entries and {first} has {a.size}; they must be as many")


def within(grid: Grid, name: str, places: Array) -> None:
    """Raises InputError if the last of these places lies right of the grid."""
    if places[-1] > grid.right:
        end = f"right = {grid.right:g}, where the window ends" if grid.right else "the top; the domain ends at x = 0"
        raise InputError(f"{name}[{places.size - 1}] = {places[-1]:g} lies past {end}")


def above_minus_one(name: str, values: Array) -> None:
    """Raises InputError if one of these slopes q is not above -1."""
    if np.any(values <= -1.0):
        i = int(np.argmax(values <= -1.0))
        raise InputError(f"{name}[{i}] = {values[i]:g} must be above -1: the slope u_x = 1 + q is positive")
