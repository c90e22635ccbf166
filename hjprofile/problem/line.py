"""Profiles shifted and stretched along the line, and their right-hand decay at the end of a window (§10)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.given import Given
from hjprofile.problem.profiles import TAIL, Bumps, Kinks, Points, Profile, Steady
from hjprofile.problem.ranges import Array

ABOUT = "the-whole-line"  # heading of the page on errors


class Transformed(Profile):
    """A profile of a class of the user, stretched by `factor`, then shifted by `distance`."""

    def __init__(self, profile: Profile, factor: float = 1.0, distance: float = 0.0):
        self.profile, self.factor, self.distance = profile, factor, distance
        self.units, self.account, self.surveyed = profile.units, profile.account, profile.surveyed
        self.rounding = profile.rounding

    @property
    def table(self) -> Mapping[str, Any]:
        return self.profile.table

    @property
    def inflow(self) -> float:
        return self.profile.inflow / self.factor

    def _own(self, law: ErosionLaw) -> ErosionLaw:
        """Return the law in the units of the profile: a stretched problem has the law f / factor (§13)."""
        if self.factor == 1.0 or law is None:
            return law
        inverse, factor = law.closed_inverse, self.factor
        return replace(
            law,
            f=lambda q: factor * law.f(q),
            derivative=lambda q: factor * law.derivative(q),
            closed_inverse=None if inverse is None else lambda y: inverse(np.asarray(y) / factor),
            eta0=factor * law.eta0,
        )

    def _place(self, x: Array) -> Array:
        return (x - self.distance) / self.factor

    def W(self, x: Array, law: ErosionLaw) -> Array:
        return self.profile.W(self._place(x), self._own(law)) * self.factor

    def excess(self, x: Array, law: ErosionLaw) -> Array | None:
        return self.profile.excess(self._place(x), self._own(law))

    def start(self, tail: float = TAIL) -> float:
        return self.profile.start(tail) * self.factor + self.distance

    def breaks(self, law: ErosionLaw) -> Array:
        found = np.array(self.profile.breaks(self._own(law)))
        found[:, 0] = found[:, 0] * self.factor + self.distance
        return found

    def marks(self) -> Array | None:
        marks = self.profile.marks()
        return None if marks is None else marks * self.factor + self.distance


def moved(profile: Profile, distance: float) -> Profile:
    """Return the profile shifted by `distance` to the right. Raise InputError for a profile of the half line."""
    match profile:
        case Kinks():
            return replace(profile, positions=profile.positions + distance)
        case Bumps():
            return replace(profile, centres=profile.centres + distance)
        case Points():
            return replace(profile, x=profile.x + distance)
        case Given():
            return replace(profile, u=lambda x: profile.u(x - distance) + distance)
        case Profile() if not isinstance(profile, Steady):
            return Transformed(profile, distance=distance)
    raise InputError(f"kind = {profile.table['kind']!r} is for the half line only; leave line = 'whole' out", ABOUT)


def stretched(profile: Profile, factor: float) -> Profile:
    """Return the profile with all lengths and heights multiplied by a factor, the flux divided by it."""
    match profile:
        case Kinks():
            return replace(profile, positions=profile.positions * factor)
        case Bumps():
            return replace(profile, centres=profile.centres * factor, widths=profile.widths * factor)
        case Points():
            return replace(profile, x=profile.x * factor, height=profile.height * factor)
        case Steady():
            kink = None if profile.kink is None else profile.kink * factor
            return replace(profile, flux=profile.flux / factor, kink=kink)
        case Given():
            return replace(profile, u=lambda x: profile.u(x / factor) * factor)
    return Transformed(profile, factor=factor)


def tail(profile: Profile, right: float, law: ErosionLaw) -> float:
    """Return q at the right end of a window, from which on I = W + R(q) is constant (§4) and q decays.

    Raise InputError if I is not constant there: K at the right end would depend on the profile beyond it.
    """
    if isinstance(profile, Kinks):
        return float(law.decay(profile.amplitudes[-1], right - profile.positions[-1]))
    if isinstance(profile, Bumps):
        high = replace(profile, amplitudes=np.abs(profile.amplitudes))
        beyond = float(max(np.diff(high.W(np.array([right, np.inf]), law))[0], high.excess(np.array(right))))
    elif not isinstance(profile, Points):
        near = right + 1e-6 * np.array([-1.0, 0.0])
        beyond = float(np.abs(np.diff(profile.W(near, law))[0])) / 1e-6
    else:
        beyond = 0.0  # `Profile.check` guarantees it
    if beyond > TAIL:
        raise InputError(
            f"the slope is not neutral from right = {right:g} on (q or its mass is {beyond:.3g} there); increase right",
            ABOUT,
        )
    return 0.0
