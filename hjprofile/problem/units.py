"""The units of a survey."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hjprofile.problem.erosion import Array


@dataclass(frozen=True)
class Units:
    """The way back from a dimensionless solution to the survey's units.

    Attributes:
        length: exchange length.
        critical_slope: height over length.
        x_top, height_top: where the survey's last point lies.
    """

    length: float
    critical_slope: float
    x_top: float
    height_top: float

    def x(self, x) -> Array:
        return self.x_top + self.length * np.asarray(x)

    def height(self, u) -> Array:
        return self.height_top + self.length * self.critical_slope * np.asarray(u)

    @property
    def volume(self) -> float:
        """One unit of poured mass, as a volume per unit width of the slope."""
        return self.length**2 * self.critical_slope
