"""The units and the points of a survey."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem.ranges import Array

SAME = 1e-9  # relative difference up to which units are equal
IN_SURVEY = "in the survey's units"  # after a number
UNNAMED = "survey units"  # label of a length of a survey whose unit has no name
NUMBERS = "length", "critical_slope", "x_top", "height_top"  # attributes of `profile.nc`


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
        return self.height_top + self.rise * np.asarray(u)

    def slope(self, q) -> Array:
        """Return slopes, height over length, for excess slopes q."""
        return self.critical_slope * (1.0 + np.asarray(q))

    @property
    def rise(self) -> float:
        """The difference of height of one unit of u, in the unit of the survey."""
        return self.length * self.critical_slope

    @property
    def volume(self) -> float:
        """The volume per unit width of the slope of one unit of supplied mass, in the unit of the survey squared."""
        return self.length**2 * self.critical_slope

    @property
    def label(self) -> str:
        """The unit of lengths, for the labels of axes."""
        return self.unit or UNNAMED

    @property
    def of_length(self) -> str:
        """The words after a length."""
        return self.unit or IN_SURVEY

    @property
    def of_volume(self) -> str:
        """The words after a volume per unit width."""
        return f"{self.unit}² per unit width" if self.unit else f"{IN_SURVEY}, per unit width"

    def volume_text(self, value: float) -> str:
        """Return the text of a volume per unit width in the unit of the survey."""
        amount = f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.4g}"
        return f"{amount} {self.of_volume}"

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"length = {self.length:g}{unit}, critical_slope = {self.critical_slope:g}, crest at x = {self.x_top:g}, "
            f"height {self.height_top:g}"
        )

    def same(self, other: Units) -> bool:
        """Return True if the numbers agree to rounding, so that equal numbers are equal positions and heights."""
        near = SAME * self.length, SAME * self.rise
        return bool(
            self.direction == other.direction
            and abs(self.length - other.length) <= near[0]
            and abs(self.critical_slope - other.critical_slope) <= SAME * self.critical_slope
            and abs(self.x_top - other.x_top) <= near[0]
            and abs(self.height_top - other.height_top) <= near[1]
        )

    def fields(self, time: Array, x: Array, x_cell: Array, u: Array) -> dict[str, tuple[tuple[str, ...], Array, dict]]:
        """Return the variables of a run in the unit of the survey: name -> dimensions, values, CF attributes."""
        lengths = {"units": self.unit} if self.unit else {}  # CF: no `units` if they are not known
        areas = {"units": f"{self.unit}2"} if self.unit else {}
        volume = "supplied volume of grains per unit width"
        distance = f"distance along the survey, which rises to the {self.uphill}"
        return {
            "supplied_volume": (("time",), self.volume * time, {"long_name": volume} | areas),
            "distance": (("node",), self.x(x), {"long_name": distance} | lengths),
            "distance_cell": (("cell",), self.x(x_cell), {"long_name": "midpoints of the cells"} | lengths),
            "height": (("time", "node"), self.height(u), {"long_name": "height of the profile, as surveyed"} | lengths),
        }

    @property
    def attributes(self) -> dict[str, Any]:
        """The units as attributes of a file; `unit` only if it has a name."""
        found = {name: getattr(self, name) for name in (*NUMBERS, "uphill", "unit")}
        return {name: value for name, value in found.items() if value != ""}

    @property
    def uphill(self) -> str:
        """The side to which the survey rises: "right" or "left"."""
        return "right" if self.direction > 0.0 else "left"

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> Units | None:
        """Return the units in the attributes of a netCDF file, whose texts are bytes; None if it has none.

        Raise ValueError if they are incomplete or no numbers.
        """
        if NUMBERS[0] not in attributes:
            return None
        try:
            length, critical_slope, x_top, height_top = (float(attributes[name]) for name in NUMBERS)
            direction = -1.0 if attributes.get("uphill", b"").decode() == "left" else 1.0
            return cls(length, critical_slope, x_top, height_top, attributes.get("unit", b"").decode(), direction)
        except (LookupError, TypeError, ValueError, AttributeError):
            raise ValueError(f"the units of a survey need the numbers {', '.join(NUMBERS)}") from None
