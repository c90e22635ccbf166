"""The units of a survey."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hjprofile.problem.ranges import Array

SAME = 1e-9  # relative difference up to which units are equal


@dataclass(frozen=True)
class Units:
    """The units of a survey, for the way back from a dimensionless solution.

    Attributes:
        length: the exchange length, in the unit of the survey.
        critical_slope: the neutral slope, height over length.
        x_top, height_top: position and height of the last point of the survey.
    """

    length: float
    critical_slope: float
    x_top: float
    height_top: float

    def x(self, x) -> Array:
        """Return positions in the unit of the survey."""
        return self.x_top + self.length * np.asarray(x)

    def height(self, u) -> Array:
        """Return heights in the unit of the survey."""
        return self.height_top + self.length * self.critical_slope * np.asarray(u)

    def __str__(self) -> str:
        return (
            f"length = {self.length:g}, critical_slope = {self.critical_slope:g}, crest at x = {self.x_top:g}, "
            f"height {self.height_top:g}"
        )

    def same(self, other: Units) -> bool:
        """Return True if the units agree to rounding, so that equal numbers are equal positions and heights."""
        near = SAME * self.length, SAME * self.length * self.critical_slope
        return bool(
            abs(self.length - other.length) <= near[0]
            and abs(self.critical_slope - other.critical_slope) <= SAME * self.critical_slope
            and abs(self.x_top - other.x_top) <= near[0]
            and abs(self.height_top - other.height_top) <= near[1]
        )

    @property
    def volume(self) -> float:
        """The volume per unit width of the slope of one unit of supplied mass, in the unit of the survey squared."""
        return self.length**2 * self.critical_slope
