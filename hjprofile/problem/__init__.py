"""What is solved: an erosion law, an initial profile, a grid, and the case file that states them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import Profile


@dataclass(frozen=True)
class Problem:
    """A slope and what is poured on it.

    Attributes:
        law: the erosion law f.
        profile: the profile at t = 0.
        end: mass of grains poured in all; it serves as time.
        snapshots: a count (evenly spaced, both ends) or the times that are kept.
        coefficient: k(t, x) in place of the nonlocal factor (theory, §9); None for the factor itself.
    """

    law: ErosionLaw
    profile: Profile
    end: float
    snapshots: int | Sequence[float] = 31
    title: str = ""
    coefficient: Coefficient | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.end) and self.end >= 0):
            raise InputError(f"end = {self.end} must be a number, 0 or more")
        if isinstance(self.snapshots, (int, np.integer)):
            if self.snapshots < 1 or isinstance(self.snapshots, bool):
                raise InputError(f"snapshots = {self.snapshots} must be 1 or more, or a list of times")
            if 0 < self.end < min(self.snapshots, 10**9) * np.finfo(float).tiny:
                raise InputError(f"end = {self.end} is too small for {self.snapshots} snapshots")
            return
        times = np.asarray(self.snapshots, dtype=float)
        if times.ndim != 1 or times.size == 0 or not np.all(np.isfinite(times)):
            raise InputError(f"snapshots = {self.snapshots!r} must be a count or a list of times")
        if np.any(np.diff(times) <= 0):
            raise InputError(f"snapshots = {times.tolist()} must increase")
        outside = times[(times < 0) | (times > self.end)]
        if outside.size:
            raise InputError(f"snapshots holds {outside[0]:g}; times must lie between 0 and end = {self.end:g}")

    @property
    def kept(self) -> int:
        """How many times are kept."""
        if not isinstance(self.snapshots, (int, np.integer)):
            return len(self.snapshots)
        return int(self.snapshots) if self.end else 1

    @property
    def times(self) -> np.ndarray:
        """The times that are kept, increasing."""
        if not isinstance(self.snapshots, (int, np.integer)):
            return np.asarray(self.snapshots, dtype=float)
        if self.end == 0:
            return np.zeros(1)
        return np.linspace(0.0, self.end, self.snapshots) if self.snapshots > 1 else np.array([float(self.end)])

    def check_invariant(self, method: str) -> None:
        """Raises InputError if there is no invariant that the method could follow."""
        if self.coefficient is not None:
            raise InputError(
                f"the method {method} follows the invariant I, which a given coefficient does not have; "
                "use a method on a grid, such as conservative"
            )

    @np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks refuse
    def check(self, grid: Grid) -> None:
        """Raises InputError if the problem cannot be solved on this grid."""
        grid.check_memory(self.kept)
        self.profile.check(grid, self.law)
        if self.coefficient is not None:
            self.coefficient.check(grid.nodes, self.end)
