"""Where a problem is solved: equal cells from the left end to the top of the slope, or of a window on the line."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hjprofile.errors import InputError


@dataclass(frozen=True)
class Grid:
    """`cells` equal cells on [left, right]; u and K live on the cells + 1 nodes, q on the cells.

    On the half line `right` is 0, the top of the slope; on the whole line it is where the window ends.
    """

    left: float
    cells: int
    right: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.right):
            raise InputError(f"right = {self.right} must be a finite number")
        if not (np.isfinite(self.left) and self.left < self.right):
            top = "a negative number: the top of the slope is at x = 0"
            raise InputError(f"left = {self.left} must be {f'less than right = {self.right:g}' if self.right else top}")
        if isinstance(self.cells, bool) or not isinstance(self.cells, (int, np.integer)) or self.cells < 4:
            raise InputError(f"cells = {self.cells} must be a whole number, 4 or more")

    @property
    def dx(self) -> float:
        return (self.right - self.left) / self.cells

    @cached_property
    def nodes(self) -> np.ndarray:
        """x_i, shape (cells + 1,); the last is exactly `right`."""
        return self._at(np.arange(self.cells, -1, -1))

    @cached_property
    def centres(self) -> np.ndarray:
        """Midpoints of the cells, shape (cells,)."""
        return self._at(np.arange(self.cells - 0.5, 0, -1))

    def _at(self, cells_from_right: np.ndarray) -> np.ndarray:
        x = (self.left - self.right) * (cells_from_right / self.cells)
        return x + self.right if self.right else x

    def check_memory(self, snapshots: int) -> None:
        """Raises InputError if a run on this grid would need more than the machine's memory."""
        try:
            memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        except (AttributeError, ValueError, OSError):  # not a POSIX system: let the allocation itself fail
            return
        # u, q, K of every snapshot, twice (the file is put together in memory), and the solver's arrays
        cell = 8 * (6 * snapshots + 30)
        needed = int(self.cells) * cell
        if needed > memory:
            most = memory // cell
            remedy = f"at most {most} cells fit" if most >= 4 else "keep fewer snapshots"
            raise InputError(
                f"cells = {self.cells} with {snapshots} snapshots needs {min(needed, 2**99) / 2**30:.3g} GiB of "
                f"memory and this machine has {memory / 2**30:.3g}; {remedy}"
            )
