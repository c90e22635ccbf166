"""Profiles from the heights of a user: a Python function, or values at points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid, grid_from, start_of
from hjprofile.problem.kinds import TEXT
from hjprofile.problem.lists import numbers, same_length
from hjprofile.problem.paths import folder_of, located
from hjprofile.problem.profile_base import TAIL, Profile, kind
from hjprofile.problem.profiles import Points, steps
from hjprofile.problem.ranges import Array, shown
from hjprofile.problem.schema import table_of
from hjprofile.problem.user_code import evaluating, load_function, sendable, values_at


@dataclass(frozen=True, eq=False, repr=False)
class Given(Profile):
    """A profile u(x) from a Python function; u_x = 1 (q = 0) left of the grid."""

    u: Callable[[Any], Any]
    source: Mapping[str, Any] = field(default_factory=dict)
    content: str | None = None  # a hash of the file that holds u

    def __getstate__(self) -> dict[str, Any]:
        sendable(self.u)
        return dict(vars(self))

    def start(self, tail: float = TAIL) -> float:
        return np.nan  # unknown; `check` tests the first cell

    def grid(self, cells: int = 2000, tail: float = TAIL) -> Grid:
        return grid_from(start_of(lambda x: self.W(x, None), tail), cells)  # type: ignore[arg-type]

    def check(self, grid: Grid, law: ErosionLaw) -> None:
        with evaluating("the profile"):
            q = self.q_means(grid, law)
        if not np.all(np.isfinite(q)):
            i = int(np.argmin(np.isfinite(q)))
            raise InputError(f"the profile is not finite near x = {grid.centres[i]:.6g}")
        self._check_rising(q, grid)
        if abs(q[0]) > TAIL:
            raise InputError(
                f"the profile has q = {q[0]:.3g} at the left end x = {grid.left:g}; the slope must be neutral "
                f"(u_x = 1, q = 0 to {TAIL:g}) there and further left"
            )

    @np.errstate(all="ignore")  # in unused branches of the function; `check` tests the values
    def W(self, x: Array, law: ErosionLaw) -> Array:
        return values_at(self.u, x) - x


def profile(u: Callable[[Any], Any] | Sequence[float], x: Sequence[float] | None = None) -> Profile:
    """Return a profile from a Python function, or from heights at points.

    Args:
        u: the height, in exchange lengths times the neutral slope. Either a function of x <= 0 in exchange lengths, of
            arrays or of single numbers (slower), that has the neutral slope (u_x = 1) at and below the left end of the
            grid; or heights, shape (n,), n >= 2, between which the profile is linear, with the neutral slope outside.
            u must rise.
        x: the positions of the heights, shape (n,), in exchange lengths, increasing, at most 0 on the half line; None
            for a function.

    Returns:
        The profile. The heights of a function are checked when a run begins, which raises InputError if u does not
        rise.

    Raises:
        InputError: if u is not a function, or if heights and positions are not two lists of numbers that increase.

    >>> import numpy as np
    >>> import hjprofile as hj
    >>> slope = hj.profile(lambda x: x + np.exp(-((x + 3.0) ** 2)) / 4.0)
    >>> slope.grid(cells=400).cells
    400
    >>> hj.profile(x=[-4.0, -2.0, 0.0], u=[-4.0, -1.5, 0.0]).start()
    -4.0
    """
    if x is not None:
        return _polyline(x, u)
    if not callable(u):
        raise InputError(f"u = {shown(u)} must be a function of x, or a list of heights with their x")
    return Given(u, table_of(from_file, {"file": "", "function": getattr(u, "__name__", "u")}))


def _polyline(x: Any, u: Any) -> Profile:
    """Return the profile with heights u at x, linear in between. Raises InputError."""
    at, height = numbers("x", x, 2), numbers("u", u, 2, "x")
    same_length(x=at, u=height)
    if np.any(np.diff(at) <= 0.0) or np.any(np.diff(height) <= 0.0):
        raise InputError("x and u must increase from left to right (u_x = 1 + q > 0, uphill to the right)")
    edges: Any = at
    values: Any = np.diff(height) / np.diff(at) - 1.0
    found = steps(edges, values)
    assert isinstance(found, Points)
    return replace(found, height=float(height[0] - at[0]))


@kind("python", file=TEXT, function=TEXT)
def from_file(file: str | Path, function: str) -> Profile:
    """Return a profile from the function of that name in a Python file, which is run."""
    loaded = load_function(located(folder_of(file), file), function)
    return Given(loaded.function, content=loaded.content)
