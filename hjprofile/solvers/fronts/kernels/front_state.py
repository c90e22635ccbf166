"""Fronts and the pieces between them: one-sided values and speeds.

I = W + R(q) is constant between fronts. There r = R(q) decays as in `kernels.law`, and K/r is constant (§13).
Distances over which a tabulated law varies little, h (1 + |f|) <= `near`, are bridged by a Taylor series.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import by_type, compiled, inner
from hjprofile.solvers.kernels.law import (
    LawTable,
    Rational,
    law_decay,
    law_derivatives,
    law_f,
    law_flow,
    law_q_f,
)


class Fronts(NamedTuple):
    """Fronts from left to right, the first n of each array.

    Attributes:
        x, jump: positions and jumps of I.
        label: the number of the kink that a front is, or 0.
        first_merge: the time of its first merge; infinite before.
        smooth: True if the piece on its right represents a stretch in which I varies.
    """

    x: np.ndarray
    jump: np.ndarray
    label: np.ndarray
    first_merge: np.ndarray
    smooth: np.ndarray


class Medium(NamedTuple):
    """Constants of a run: r0 = R(0), which is r on the far left; the reach `near` of the Taylor series; the law."""

    r0: float
    near: float
    law: Rational | LawTable


class Sides(NamedTuple):
    """The values at each front: r on its left and right, slope = [f]/[q], and K."""

    r_left: np.ndarray
    r_right: np.ndarray
    slope: np.ndarray
    K: np.ndarray


@inner
def crest_front(x, n):
    """Return the index of the front whose piece on the right contains x = 0."""
    crest = n - 1
    while crest > 0 and x[crest] > 0.0:
        crest -= 1
    return crest


@compiled
def sweep(x, jump, n, crest, medium, sides):
    """Fill the sides of the first n fronts: a sweep to the right for r, and one to the left for K with K(0) = 1.

    `jump` holds the jumps of I; x = 0 lies right of front `crest`. Positions may be out of order: pieces of negative
    length continue the same formula.
    """
    law, r_left, r_right, K = medium.law, sides.r_left, sides.r_right, sides.K
    sweep_r(x, jump, n, medium, law, sides)
    if n > 0:
        K[crest] = r_right[crest] / law_decay(r_right[crest], -x[crest], law)
    for j in range(crest - 1, -1, -1):
        K[j] = K[j + 1] * r_right[j] / r_left[j + 1]
    for j in range(crest + 1, n):
        K[j] = K[j - 1] * r_left[j] / r_right[j - 1]


@by_type
def sweep_r(x, jump, n, medium, law, sides):
    """Fill r on the left and right of the first n fronts and the slope, from left to right."""
    if law.instance_class is Rational:

        def rational(x, jump, n, medium, law, sides):
            r_left, r_right, slope = sides.r_left, sides.r_right, sides.slope
            q = medium.r0 - 1.0
            for j in range(n):
                r_left[j] = 1.0 + q
                q += jump[j]
                r_right[j] = 1.0 + q
                slope[j] = 1.0 / (r_left[j] * r_right[j])
                if j < n - 1:
                    q *= math.exp(x[j] - x[j + 1])

        return rational

    def tabulated(x, jump, n, medium, law, sides):
        r_left, r_right, slope = sides.r_left, sides.r_right, sides.slope
        rho, r = math.log(medium.r0), medium.r0
        for j in range(n):
            f_left = law_f(rho, law)
            r_left[j] = r
            r_right[j] = r + jump[j]
            rho_right = math.log(r_right[j])
            f, f1, f2 = law_derivatives(rho_right, law)
            if abs(rho_right - rho) > 1e-5:
                slope[j] = (f - f_left) / (f * r_right[j] - f_left * r)
            else:  # df/dq, in the middle to first order: error 1e-10
                middle = 0.5 * (rho_right - rho)
                slope[j] = (f1 - middle * f2) / ((f1 + f - middle * (f1 + f2)) * r_right[j] * (1.0 - middle))
            if j < n - 1:
                h = x[j + 1] - x[j]
                if abs(h) * (1.0 + abs(f)) <= medium.near:
                    rho = rho_right - h * f * (1.0 - 0.5 * h * (f1 - h / 3.0 * (f1 * f1 + f * f2)))
                else:
                    rho = law_flow(rho_right, h, law)
                r = math.exp(rho)

    return tabulated


@inner
def speeds(x, jump, n, crest, medium, sides, speed):
    """Fill x' = K [f]/[q] of the first n fronts, and their sides except the slope; `speed` is the work array for it."""
    K = sides.K
    sweep(x, jump, n, crest, medium, Sides(sides.r_left, sides.r_right, speed, K))
    for j in range(n):
        speed[j] *= K[j]


@inner
def crest_flux(x, crest, r_right, law):
    """Return F = f(q) at x = 0, right of front `crest`."""
    return law_q_f(law_decay(r_right[crest], -x[crest], law), law)[1]
