"""The test that the parts of a user's profile belong together: q as given is the slope of W."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.ranges import Array

POINTS = 400  # positions at which q is compared
STEP = 1e-5  # of a difference quotient, relative to the extent of the profile; a second one is 10 times shorter
AGREE = 1e-3  # difference of the two quotients, relative to 1 + |q|, up to which they are the slope of W
APART = 1e-2  # difference of q from them, relative to 1 + |q|, that is a contradiction


class Given(Protocol):
    """The parts of a profile that are compared."""

    def W(self, x: Array, law: ErosionLaw) -> Array: ...

    def excess(self, x: Array, law: ErosionLaw) -> Array | None: ...

    def breaks(self, law: ErosionLaw) -> Array: ...


def check_parts(profile: Given, left: float, law: ErosionLaw) -> None:
    """Raise InputError if `excess` or `breaks` contradict W between `left` and the crest.

    Difference quotients of W with two steps are compared with q. Positions where they differ from each other, or next
    to a jump from the next one, are omitted: W is not resolved there.
    """
    h = STEP * -left
    breaks = np.asarray(profile.breaks(law), dtype=float)
    inner = left + (np.arange(POINTS) + 0.5) * (-left / POINTS)
    if breaks.size:
        inner = inner[np.abs(inner[:, None] - breaks[:, 0]).min(axis=1) > 2.0 * h]
    given = profile.excess(inner, law)
    if given is not None:
        _compare(profile, law, inner, h, np.asarray(given, dtype=float), "excess")
    if breaks.size:
        x = breaks[:POINTS, 0]
        between = np.diff(x, prepend=left, append=0.0)
        apart = np.minimum(between[:-1], between[1:]) > 5.0 * h
        for side, q in ((-1.0, breaks[:POINTS, 1]), (1.0, breaks[:POINTS, 2])):
            inside = apart & (x + 4.0 * side * h < 0.0)
            _compare(profile, law, x[inside] + 1.5 * side * h, h, q[inside], "breaks", side * h)


def _compare(profile: Given, law: ErosionLaw, x: Array, h: float, q: Array, name: str, shift: float = 0.0) -> None:
    """Raise InputError if q at x is not W'. W' must be the same at the distance `shift`."""

    def slope(at: Array, step: float) -> Array:
        return (np.asarray(profile.W(at + step, law)) - np.asarray(profile.W(at - step, law))) / (2.0 * step)

    with np.errstate(all="ignore"):
        coarse, fine, other = slope(x, h), slope(x, 0.1 * h), slope(x + shift, h)
        resolved = np.maximum(np.abs(coarse - fine), np.abs(coarse - other)) <= AGREE * (1.0 + np.abs(fine))
        wrong = resolved & ~(np.abs(q - coarse) <= APART * (1.0 + np.abs(coarse)))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(
            f"the parts of the profile contradict each other near x = {x[i]:.6g}: {name} gives q = {q[i]:.6g}, but the "
            f"slope of W is {coarse[i]:.6g}; correct one of them",
            "a-profile",
        )
