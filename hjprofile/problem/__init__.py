"""Problems: an erosion law, an initial profile, the supplied mass, and the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.line import moved, tail
from hjprofile.problem.lists import as_numbers
from hjprofile.problem.model import LinearGrowth, Model, Prescribed, RollingLayer, SlowErosion, WholeLine
from hjprofile.problem.profiles import TAIL, Profile
from hjprofile.problem.ranges import SAME_TIME, brief, instance, number, plain, shown
from hjprofile.problem.supply import SupplyFlux, in_words, supply_flux

LINES = "half", "whole"
LONGEST_TITLE = 500  # characters; a picture wraps them into a dozen lines
FAR_LEFT = 4.0  # ratio of domain to survey above which `left` is probably in metres


@dataclass(frozen=True, repr=False)
class Problem:
    """A slope and the mass of grains supplied at its crest.

    Attributes:
        law: the erosion law f.
        profile: the profile at t = 0.
        end: the supplied mass at the end, dimensionless, 0 or more; it serves as time.
        snapshots: the number of saved times (evenly spaced, both ends), or the increasing saved times in [0, end].
        title: a title for pictures and files, at most 500 characters.
        coefficient: k(t, x) that replaces the grain flux K (§7); None for K itself.
        supply_flux: the flux ε that is supplied at the crest of a rolling layer (§2): a number, or, if it changes, an
            expression in the supplied mass t, or a Python function of t; 0 is the limit of slow erosion.
        line: "half", the slope x <= 0 below its crest, or "whole", of which the grid is a window (§10).

    The combination of profile, law, grid and method is checked when a run begins, before anything is computed.

    Raises:
        InputError: if an attribute is out of range, or two of them do not go together.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-7.0, -5.0], [0.4, 1.2]), end=3.0, snapshots=4)
    >>> print(problem.times)
    [0. 1. 2. 3.]
    """

    law: ErosionLaw
    profile: Profile
    end: float
    snapshots: int | Sequence[float] = 31
    title: str = ""
    coefficient: Coefficient | None = None
    supply_flux: float | str | Callable[[Any], Any] | SupplyFlux = 0.0
    line: str = "half"

    def __post_init__(self) -> None:
        instance("law", self.law, ErosionLaw)
        instance("profile", self.profile, Profile)
        instance("title", self.title, str)
        if len(self.title) > LONGEST_TITLE:
            raise InputError(f"title has {len(self.title)} characters; at most {LONGEST_TITLE} are allowed")
        if self.coefficient is not None:
            instance("coefficient", self.coefficient, Coefficient)
        object.__setattr__(self, "end", number("end", self.end))
        object.__setattr__(self, "supply_flux", supply_flux("supply_flux", self.supply_flux))
        object.__setattr__(self, "snapshots", _count_or_times(self.snapshots, self.end))
        if self.supply and self.law.name != "rational":
            raise InputError(
                f"supply_flux = {in_words(self.supply)} needs the law 'rational', not {self.law.name!r}, because a "
                "rolling layer is modelled for that law only"
            )
        if self.line not in LINES:
            raise InputError(f"line = {shown(self.line)} is not known; allowed are {', '.join(map(repr, LINES))}")
        if self.supply and self.line == "whole":
            raise InputError(
                f"supply_flux = {in_words(self.supply)} needs line = 'half', because the grains start at the crest"
            )
        models = self._models()
        if len(models) > 1:
            raise InputError(f"{' and '.join(models)} cannot be combined")
        self._check_units()

    def __repr__(self) -> str:
        stated = {field.name: getattr(self, field.name) for field in fields(self)}
        further = {f.name: stated.pop(f.name) for f in fields(self) if f.default is not MISSING}
        changed = {f.name: further[f.name] for f in fields(self) if f.name in further and further[f.name] != f.default}
        return f"Problem({', '.join(f'{name}={brief(value)}' for name, value in (stated | changed).items())})"

    def _check_units(self) -> None:
        """Raise InputError if the coefficient has other units than the profile: its x is another position."""
        units = self.profile.units
        known = self.coefficient.units if self.coefficient is not None else None
        if units and known and not units.same(known):
            raise InputError(
                f"the coefficient was found for a survey with {known}, but the profile has {units}; "
                "use the same units for both"
            )

    def _models(self) -> dict[str, Model]:
        """Return the models that this problem requests beyond slow erosion, by their names in messages."""
        models: dict[str, Model] = {}
        if self.coefficient is not None:
            models["a coefficient"] = Prescribed(self.coefficient)
        if self.supply:
            models["a rolling layer"] = RollingLayer(self.supply)
        if self.line == "whole":
            models["line = 'whole'"] = WholeLine()
        if self.law.grows_linearly:
            models["a law with growth = 'linear'"] = LinearGrowth()
        return models

    @property
    def supply(self) -> float | SupplyFlux:
        """The supply flux: 0, a positive number, or a function of t."""
        assert isinstance(self.supply_flux, float | SupplyFlux)
        return self.supply_flux

    @property
    def model(self) -> Model:
        """The model, one of five that exclude each other (`problem/model.py`)."""
        return next(iter(self._models().values()), SlowErosion())

    @property
    def kept(self) -> int:
        """The number of saved times."""
        if not isinstance(self.snapshots, int):
            return len(self.snapshots)
        return self.snapshots if self.end else 1

    @property
    def times(self) -> np.ndarray:
        """The saved times, increasing, shape (kept,)."""
        if not isinstance(self.snapshots, int):
            return np.array(self.snapshots)
        if self.end == 0:
            return np.zeros(1)
        return np.linspace(0.0, self.end, self.snapshots) if self.snapshots > 1 else np.array([self.end])

    def caution(self, left: float) -> str | None:
        """Return a warning if a domain that begins at `left` is far longer than the survey, else None."""
        start, units = self.profile.start(), self.profile.units
        if units is None or left >= FAR_LEFT * start:
            return None
        return (
            f"the survey covers only {start / left:.2g} of the domain, which begins at left = {left:g}: left is in "
            f"exchange lengths, of {units.length:g} in the survey's unit; set it to {1.05 * start - 0.05:.4g}, or "
            "leave it out"
        )

    def grid(self, tail: float = TAIL) -> Grid:
        """Return a grid over the profile, for methods whose accuracy does not depend on it.

        Raise InputError if its left end cannot be determined.
        """
        if self.line == "whole":
            raise InputError("line = 'whole' needs a grid with the right end of the window")
        return self.profile.grid(tail=tail)

    @np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks reject
    def check(self, grid: Grid) -> None:
        """Raise InputError if no method can solve the problem on this grid."""
        instance("grid", grid, Grid)
        grid.check_memory(self.kept)
        self.check_line(grid)
        self.check_profile(grid)
        if self.coefficient is not None:
            self.coefficient.check(grid.nodes, self.end)
        self.check_supply()

    def check_supply(self) -> None:
        """Raise InputError unless the supply flux is positive at the start and at the end, or 0."""
        if isinstance(self.supply, SupplyFlux):
            self.supply.check(self.end)

    def check_line(self, grid: Grid) -> None:
        """Raise InputError if the right end of the grid does not fit the line."""
        if self.line == "half" and grid.right:
            raise InputError(f"right = {grid.right:g} needs line = 'whole'; on the half line the crest is at x = 0")

    def check_profile(self, grid: Grid) -> None:
        """Raise InputError if the profile does not fit the grid, or continues beyond a window."""
        if self.line == "whole":
            moved(self.profile, 0.0)
        self.profile.check(grid, self.law)
        if self.line == "whole":
            tail(self.profile, grid.right, self.law)


def _count_or_times(given: Any, end: float) -> int | tuple[float, ...]:
    """Return a number of saved times, or the times. Set a time within rounding of 0 or of `end` to it.

    Raise InputError for other values.
    """
    given = plain(given)
    if isinstance(given, int):
        if given < 1 or isinstance(given, bool):
            raise InputError(f"snapshots = {shown(given)} must be 1 or more, or a list of times")
        return given
    times = as_numbers(given)
    if times is None or times.ndim != 1 or times.size == 0 or not np.all(np.isfinite(times)):
        raise InputError(f"snapshots = {shown(given)} must be a count or a list of times")
    times[np.abs(times - end) <= SAME_TIME * end] = end
    times[(times < 0.0) & (times >= -SAME_TIME * end)] = 0.0
    if np.any(times[1:] <= times[:-1]):
        raise InputError(f"snapshots = {shown(times)} must increase")
    outside = times[(times < 0) | (times > end)]
    if outside.size:
        raise InputError(f"snapshots holds {outside[0]:g}; times must lie between 0 and end = {end:g}")
    return tuple((times + 0.0).tolist())
