"""Where a problem is solved: equal cells from the left end to the top of the slope at x = 0."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hjprofile.errors import InputError


@dataclass(frozen=True)
class Grid:
    """`cells` equal cells on [left, 0]; u and K live on the cells + 1 nodes, q on the cells."""

    left: float
    cells: int

    def __post_init__(self) -> None:
        if not (np.isfinite(self.left) and self.left < 0):
            raise InputError(f"left = {self.left} must be a negative number: the top of the slope is at x = 0")
        if isinstance(self.cells, bool) or not isinstance(self.cells, (int, np.integer)) or self.cells < 4:
            raise InputError(f"cells = {self.cells} must be a whole number, 4 or more")

    @property
    def dx(self) -> float:
        return -self.left / self.cells

    @cached_property
    def nodes(self) -> np.ndarray:
        """x_i, shape (cells + 1,); the last is exactly 0."""
        return self.left * (np.arange(self.cells, -1, -1) / self.cells)

    @cached_property
    def centres(self) -> np.ndarray:
        """Midpoints of the cells, shape (cells,)."""
        return self.left * (np.arange(self.cells - 0.5, 0, -1) / self.cells)

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
