"""The units and the points of a survey."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem.ranges import Array

SAME = 1e-9  # relative difference up to which units are equal


class SurveyLine(NamedTuple):
    """The points of a survey, in its unit, shape (n,) each.

    Attributes:
        x, height: as they were measured, the crest last.
        used: heights of the profile at x, which differ where the survey was resampled or repaired.
    """

    x: Array
    height: Array
    used: Array


@dataclass(frozen=True)
class Units:
    """The units of a survey, for the way back from a dimensionless solution.

    Attributes:
        length: the exchange length, in the unit of the survey.
        critical_slope: the neutral slope, height over length.
        x_top, height_top: position and height of the crest, the last point of the survey.
        unit: name of the unit of length of the survey, for labels, or empty.
        direction: 1 if the survey rises to the right, -1 if it rises to the left.
    """

    length: float
    critical_slope: float
    x_top: float
    height_top: float
    unit: str = ""
    direction: float = 1.0

    def x(self, x) -> Array:
        """Return positions in the unit of the survey."""
        return self.x_top + self.direction * self.length * np.asarray(x)

    def place(self, x) -> Array:
        """Return dimensionless positions."""
        return self.direction * (np.asarray(x) - self.x_top) / self.length

    def height(self, u) -> Array:
        """Return heights in the unit of the survey."""
        return self.height_top + self.length * self.critical_slope * np.asarray(u)

    @classmethod
    def stored(cls, attributes: Mapping[str, Any]) -> Units | None:
        """Return the units of the attributes of a stored run; None if it has none. Raise LookupError or ValueError."""
        if "length" not in attributes:
            return None
        length, slope, x, height = (float(attributes[n]) for n in ("length", "critical_slope", "x_top", "height_top"))
        unit = attributes.get("unit", b"").decode().strip()
        return cls(length, slope, x, height, unit, -1.0 if attributes.get("uphill", b"").decode() == "left" else 1.0)

    @property
    def table(self) -> dict[str, str | float]:
        """The attributes of a stored run."""
        found: dict[str, str | float] = {
            "length": self.length, "critical_slope": self.critical_slope, "x_top": self.x_top,
            "height_top": self.height_top, "uphill": "right" if self.direction > 0.0 else "left",
        }  # fmt: skip
        return found | ({"unit": self.unit} if self.unit else {})

    def __str__(self) -> str:
        return (
            f"length = {self.length:g}, critical_slope = {self.critical_slope:g}, crest at x = {self.x_top:g}, "
            f"height {self.height_top:g}"
        )

    def same(self, other: Units) -> bool:
        """Return True if the units agree to rounding, so that equal numbers are equal positions and heights."""
        near = SAME * self.length, SAME * self.length * self.critical_slope
        return bool(
            self.direction == other.direction
            and abs(self.length - other.length) <= near[0]
            and abs(self.critical_slope - other.critical_slope) <= SAME * self.critical_slope
            and abs(self.x_top - other.x_top) <= near[0]
            and abs(self.height_top - other.height_top) <= near[1]
        )

    @property
    def volume(self) -> float:
        """The volume per unit width of the slope of one unit of supplied mass, in the unit of the survey squared."""
        return self.length**2 * self.critical_slope
