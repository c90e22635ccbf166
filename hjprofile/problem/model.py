"""The five models, of which a problem has exactly one."""

from __future__ import annotations

from dataclasses import dataclass

from hjprofile.problem.coefficient import Coefficient
from hjprofile.problem.supply import SupplyFlux


@dataclass(frozen=True)
class SlowErosion:
    """Slow erosion u_t + K f(u_x - 1) = 0 on the half line x <= 0, under a law of sublinear growth."""


@dataclass(frozen=True)
class Prescribed:
    """Slow erosion with a coefficient k(t, x) in the place of K (§7)."""

    coefficient: Coefficient


@dataclass(frozen=True)
class RollingLayer:
    """The 2x2 model with a rolling layer, of this flux at the crest, constant or a function of t (§2)."""

    supply_flux: float | SupplyFlux


@dataclass(frozen=True)
class WholeLine:
    """Slow erosion on the whole line, of which the grid is a window (§10)."""


@dataclass(frozen=True)
class LinearGrowth:
    """Slow erosion under a law of linear growth, where kinks become vertical steps (§11)."""


Model = SlowErosion | Prescribed | RollingLayer | WholeLine | LinearGrowth
