"""Grids: equal cells from the toe to the crest of a slope, or over a window of the whole line."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.ranges import number, read_only, whole

FARTHEST, LOOKS = 4096.0, 2000  # distance down to which a function is sampled, and number of samples between x and 2x
FEWEST_CELLS = 4
NARROWEST = 1e-6  # ratio of a window to its distance from x = 0: rounding must not join its nodes
NOISE = 1e-11  # of the difference quotients there


@dataclass(frozen=True)
class Grid:
    """A grid of equal cells on [left, right]; u and K are given at the cells + 1 nodes, q in the cells.

    Attributes:
        left: the left end, in exchange lengths, less than `right`.
        cells: the number of cells, 4 or more.
        right: the right end, in exchange lengths; 0, the crest, on the half line, the end of the window on the whole
            line.

    Raises:
        InputError: for other ends or numbers of cells.

    >>> import hjprofile as hj
    >>> grid = hj.Grid(left=-10.0, cells=2000)
    >>> grid.dx, grid.nodes.shape
    (0.005, (2001,))
    """

    left: float
    cells: int
    right: float = 0.0

    def __post_init__(self) -> None:
        right = number("right", self.right)
        left = number("left", self.left, key="left of a window" if right else "left")
        cells = whole("cells", self.cells, FEWEST_CELLS)
        if not right - left > NARROWEST * abs(right):
            raise InputError(f"left = {left} must be less than right = {right:g}")
        for name, value in (("left", left), ("cells", cells), ("right", right)):
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[type[Grid], tuple[float, int, float]]:
        return type(self), (self.left, self.cells, self.right)  # a copy in another process computes its own nodes

    @property
    def dx(self) -> float:
        """The width of a cell, in exchange lengths."""
        return (self.right - self.left) / self.cells

    @cached_property
    def nodes(self) -> np.ndarray:
        """The nodes x_i, shape (cells + 1,), read-only; the last is exactly `right`."""
        return self._at(np.arange(self.cells, -1, -1))

    @cached_property
    def centres(self) -> np.ndarray:
        """The midpoints of the cells, shape (cells,), read-only."""
        return self._at(np.arange(self.cells - 0.5, 0, -1))

    def centre(self, cell: int) -> float:
        """Return the midpoint of a cell, as in `centres`."""
        return float(self._at(np.array([self.cells - 0.5 - cell]))[0])

    def _at(self, cells_from_right: np.ndarray) -> np.ndarray:
        x = (self.left - self.right) * (cells_from_right / self.cells)
        return read_only(x + self.right if self.right else x)

    def integral(self, values: np.ndarray) -> float:
        """Return ∫ of a function given at the nodes, shape (cells + 1,), by the trapezoidal rule."""
        return self.dx * float(np.sum(values) - 0.5 * (values[0] + values[-1]))

    def check_memory(self, snapshots: int, each: int = 7, own: int = 27) -> None:
        """Raise InputError if so many arrays of `each` snapshot and `own` others exceed the memory of the machine.

        By default these are u, q and K, those of the reference for the error, and the arrays of a solver.
        """
        try:
            memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        except (AttributeError, ValueError, OSError):  # not a POSIX system: let the allocation itself fail
            return
        cell = 8 * (each * snapshots + own)
        needed = int(self.cells) * cell
        if needed > memory:
            most = memory // cell
            remedy = f"at most {most} cells fit" if most >= FEWEST_CELLS else "use fewer snapshots"
            raise InputError(
                f"cells = {self.cells} with {snapshots} snapshots needs {min(needed, 2**99) / 2**30:.3g} GiB of "
                f"memory, but this machine has {memory / 2**30:.3g}; {remedy}"
            )


def grid_from(start: float, cells: int) -> Grid:
    """Return a grid that begins a little left of `start`. Raise InputError if that is not a finite number."""
    if not np.isfinite(start):
        raise InputError("left must be given: a flux enters at the left end of the grid")
    return Grid(1.05 * min(start, 0.0) - 0.05, cells)


def start_of(W: Callable[[np.ndarray], np.ndarray], tail: float) -> float:
    """Return the first sampled x <= 0 at which the slope W' differs from 0 by more than `tail`.

    Raise InputError if W cannot be evaluated, or if its slope already differs at the leftmost sample.
    """
    x = -np.concatenate([np.arange(LOOKS) / LOOKS, 2.0 ** (np.arange(np.log2(FARTHEST) * LOOKS + 1) / LOOKS)])[::-1]
    try:
        slope = np.diff(W(x)) / np.diff(x)
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"left must be given: the profile has no height down to x = {x[0]:g} ({what})") from error
    away = ~(np.abs(slope) <= max(tail, NOISE))  # NaN counts as different
    if away[0]:
        raise InputError(
            f"left must be given: the slope is not neutral (u_x = 1) at x = {x[0]:g}, where u_x = {1 + slope[0]:.6g}"
        )
    return float(x[np.argmax(away)]) if away.any() else 0.0
