"""The base class of initial profiles, each given by W(x) = u - x, the height above the neutral slope.

Cell means of the excess slope q = u_x - 1 are differences of W, so an exact W gives exact cell means. W may tend to
any constant on the left, because only its slope enters the equation.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid, grid_from
from hjprofile.problem.own_profile import check_parts
from hjprofile.problem.ranges import Array
from hjprofile.problem.schema import Choice, as_call, choice
from hjprofile.problem.units import SurveyLine, Units

TAIL = 1e-6  # largest mass and slope that a grid may truncate on the left; the error of a method on a grid is larger
kind = partial(choice, into="source")  # a decorator that declares the maker of a profile


class Profile:
    """An initial profile; a subclass defines `W` and the left end of the support.

    `check` runs before a solver starts, and raises InputError if the slope does not rise or does not fit the grid.

    >>> import numpy as np
    >>> import hjprofile as hj
    >>> class Ramp(hj.Profile):
    ...     def W(self, x, law):
    ...         return np.clip(x, -3.0, -2.0)  # q = 1 on (-3, -2)
    ...     def start(self, tail=1e-6):
    ...         return -3.0
    ...     def breaks(self, law):
    ...         return np.array([[-3.0, 0.0, 1.0], [-2.0, 1.0, 0.0]])
    >>> hj.track_fronts(hj.Problem(hj.rational(), Ramp(), end=0.5)).status
    'done'

    Attributes:
        source: the `[profile]` table of a function that made this profile; empty if the class computes the table.
        inflow: the flux F that enters at the left end of a grid; 0 if q = 0 there.
        units: the units of a survey, else None.
        account: sentences on changes of the data in one line, or "".
        surveyed: the points of a survey, else None.
        rounding: jumps of q that the rounding of measured heights may cause; kinks with smaller ones are not reported.
    """

    choice: ClassVar[Choice]
    source: Mapping[str, Any] = MappingProxyType({})
    units: Units | None = None
    account: str = ""
    surveyed: SurveyLine | None = None
    rounding: float = 0.0

    @property
    def table(self) -> Mapping[str, Any]:
        """The `[profile]` table of a case file that makes this profile again."""
        if self.source:
            return self.source
        own = getattr(self, "choice", None)
        if own is None:  # a class of a user, which is in no case file
            return {"kind": "python", "file": type(self).__module__, "function": type(self).__qualname__}
        found: Mapping[str, Any] = own.table(vars(self))
        return found

    def __repr__(self) -> str:
        known = self.source or hasattr(self, "choice")
        return as_call(self.table, "kind", "profile") if known else f"{type(self).__qualname__}()"

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the state from another process, where arrays are writable."""
        self.__dict__.update(state)
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def inflow(self) -> float:
        return 0.0

    def W(self, x: Array, law: ErosionLaw) -> Array:
        """Return u - x at x (any shape), in exchange lengths."""
        raise NotImplementedError

    def excess(self, x: Array, law: ErosionLaw) -> Array | None:
        """Return q at x, on either side of a jump there; None if only W is known."""
        return None

    def start(self, tail: float = TAIL) -> float:
        """Return the leftmost point at which q may differ from 0 by more than `tail`."""
        raise NotImplementedError

    def grid(self, cells: int = 2000, tail: float = TAIL) -> Grid:
        """Return a grid over the profile that begins a little left of `start(tail)`."""
        return grid_from(self.start(tail), cells)

    def breaks(self, law: ErosionLaw) -> Array:
        """Return the jumps and corners of q as rows (x, q on the left, q on the right), from left to right."""
        return np.empty((0, 3))

    def marks(self) -> Array | None:
        """Return positions whose distances resolve all scales of q between them; None if unknown."""

    def q_means(self, grid: Grid, law: ErosionLaw) -> Array:
        """Return the exact cell means of q, shape (cells,)."""
        return np.diff(self.W(grid.nodes, law)) / grid.dx

    def check(self, grid: Grid, law: ErosionLaw) -> None:
        """Raise InputError if the profile does not fit the grid or its slope is not positive."""
        start = self.start()
        if self.inflow == 0.0 and start < grid.left:
            raise InputError(
                f"the profile reaches left to x = {start:.6g} but the domain begins at left = {grid.left:g}; "
                f"left must be at most {start:.6g}"
            )
        self._check_rising(self.q_means(grid, law), grid)
        if not self.source and getattr(self, "choice", None) is None:  # a class of a user
            check_parts(self, grid.left, law)

    @staticmethod
    def _check_rising(q: Array, grid: Grid) -> None:
        if not np.all((q > -1.0) & (q < np.inf)):
            i = int(np.argmin(np.where(np.isfinite(q), q, -np.inf)))
            raise InputError(
                f"the profile does not rise near x = {grid.centres[i]:.6g}, where q = {q[i]:.6g}; "
                "q must be finite and above -1 everywhere (u_x = 1 + q > 0, uphill to the right)"
            )
