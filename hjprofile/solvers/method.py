"""Description of a method: its unknown, the bounds that it satisfies, and the problems that it supports."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem import Problem
from hjprofile.problem.model import LinearGrowth, Prescribed, RollingLayer, SlowErosion, WholeLine
from hjprofile.problem.ranges import number
from hjprofile.solvers.run import Run

if TYPE_CHECKING:
    from hjprofile.solvers.grids.flux import Flux
    from hjprofile.solvers.grids.setup import Setup

MOST_REFRESHES = 1_000_000  # largest number of refreshes of a frozen K in a run


class Form(Enum):
    """The unknown of a method."""

    HEIGHT = "u on the nodes of a grid"
    SLOPE = "q on the cells of a grid"
    OFF_GRID = "fronts, characteristics or levels of u"


class Feature(Enum):
    """Features of problems beyond slow erosion of a slope that is neutral at its left end."""

    INFLOW = "a profile with a flux that enters at the left end", "use a profile with q = 0 there"
    COEFFICIENT = "a prescribed coefficient", "leave [coefficient] out"
    REFRESH = "a refresh interval", "leave refresh out"
    LAYER = "a rolling layer", "leave [layer] out"
    WHOLE_LINE = "line = 'whole'", "set line = 'half'"
    LINEAR_GROWTH = "a law with growth = 'linear'", "use a law of sublinear growth"

    @property
    def words(self) -> str:
        """The feature in the words of a sentence."""
        return self.value[0]

    @property
    def remedy(self) -> str:
        """The advice for a problem without the feature."""
        return self.value[1]


_OF_MODEL = {
    Prescribed: Feature.COEFFICIENT,
    RollingLayer: Feature.LAYER,
    WholeLine: Feature.WHOLE_LINE,
    LinearGrowth: Feature.LINEAR_GROWTH,
}


@dataclass(frozen=True)
class Method:
    """A solution method.

    Attributes:
        name: in case files and in Python.
        form: of its unknown.
        supports: features of problems that it supports.
        setup: of a method on a grid: scheme, bounds and monitors for a problem on a grid.
        variants: setups that replace `setup` for problems with that feature.
        solve: of the other methods: problem, grid, tolerance or None, progress -> Run.
        flux: the numerical flux of a first-order method.
        carries: of a method for q, the method for u whose flux it uses; "" for none.
        midpoint: True if ln K is the integral of f of the cell means.
        cfl_proved: largest Δt max(K f')/Δx with bounds proved for any data; NaN for none.
        order: of the error on smooth data, in the cells, fronts or levels; NaN if a tolerance replaces them.
        tolerance: the smallest and the largest tolerance that it accepts, if any.
        needs_tolerance: True if it requires a tolerance.
    """

    name: str
    form: Form
    supports: frozenset[Feature]
    setup: Setup | None = None
    variants: Mapping[Feature, Setup] = field(default_factory=lambda: MappingProxyType({}))
    solve: Callable[..., Run] | None = None
    flux: Flux | None = None
    carries: str = ""
    midpoint: bool = False
    cfl_proved: float = np.nan
    order: float = np.nan
    tolerance: tuple[float, float] | None = None
    needs_tolerance: bool = False

    @property
    def on_grid(self) -> bool:
        """True for a scheme on a grid."""
        return self.form is not Form.OFF_GRID

    def setup_for(self, problem: Problem) -> Setup:
        """Return the set-up for a problem on a grid."""
        found = self.variants.get(_OF_MODEL.get(type(problem.model)), self.setup)  # type: ignore[arg-type]
        assert found is not None
        return found


def requirements(problem: Problem, refresh: float | None = None) -> frozenset[Feature]:
    """Return the features of a problem, with those of a frozen K if `refresh` is given.

    Raise InputError if no method supports the refresh interval for this problem.
    """
    found = {_OF_MODEL[type(problem.model)]} if type(problem.model) in _OF_MODEL else set()
    if problem.profile.inflow:
        found.add(Feature.INFLOW)
    if refresh is not None:
        refresh = number("refresh", refresh)
        if not problem.end <= MOST_REFRESHES * refresh:
            raise InputError(
                f"refresh = {refresh:g} must be at least end / {MOST_REFRESHES:,} = "
                f"{problem.end / MOST_REFRESHES:g}; leave it out to refresh K in every time step"
            )
        if not isinstance(problem.model, SlowErosion | Prescribed):
            (other,) = found & set(_OF_MODEL.values())
            raise InputError(f"refresh = {refresh:g} cannot be combined with {other.words}; leave it out")
        found.add(Feature.REFRESH)
    return frozenset(found)


def require(who: str, supports: Collection[Feature], asked: Collection[Feature], others: Iterable[Method] = ()) -> None:
    """Raise InputError if a method or a study does not support the requested features.

    `who` begins the sentence, as "the method fronts"; `others` are methods that may support them.
    """
    missing = [feature for feature in Feature if feature in asked and feature not in supports]
    if not missing:
        return
    able = [method.name for method in others if method.supports >= set(asked)]
    hint = f"methods that do: {', '.join(able)}" if able else " and ".join(feature.remedy for feature in missing)
    raise InputError(f"{who} does not take {' and '.join(feature.words for feature in missing)}; {hint}")
