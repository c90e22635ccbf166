"""Erosion law in the variables of the invariant: the rational law by its formula, any other as a table.

Where I = W + R(q) is constant in x, r = R(q) satisfies (ln r)_x = -f, and K/r is constant (§13). The tables are
polynomials over rho = ln r. They contain the coordinate s(rho) = q exp(..) in which the decay is linear: s(x) = s(0)
exp(-rate x), rate = 1/R'(0). For the rational law r = 1 + q and s = q. The type of the law selects the code.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import by_type, compiled, inner


class Rational(NamedTuple):
    """f = q/(1+q)."""


class LawTable(NamedTuple):
    """Polynomials on pieces of equal width, in the local variable of [-1, 1].

    Attributes:
        f, s: over rho, rows of coefficients from the constant upwards.
        rho: over sigma = ln(1 + s/offset).
        start, sigma_start: the left ends of the first pieces.
        density: pieces per unit of rho, and of sigma.
        offset: -s at r = 0.
        rate: 1/R'(0).
    """

    f: np.ndarray
    s: np.ndarray
    rho: np.ndarray
    start: float
    sigma_start: float
    density: float
    offset: float
    rate: float


@inner
def polynomial(table, start, density, x):
    """Evaluate a piecewise polynomial of degree 7; the pieces at both ends are continued.

    Terms are summed in pairs, not by Horner's rule, because in a sweep each front waits for the one before.
    """
    s = (x - start) * density
    piece = min(max(int(s), 0), table.shape[0] - 1)
    z = 2.0 * (s - piece) - 1.0
    z2 = z * z
    c = table[piece]
    low, high = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z), (c[4] + c[5] * z) + z2 * (c[6] + c[7] * z)
    return low + z2 * z2 * high


@inner
def law_f(rho, law):
    """Return f at rho."""
    return polynomial(law.f, law.start, law.density, rho)


@inner
def law_derivatives(rho, law):
    """Return f, df/drho and d²f/drho² at rho."""
    s = (rho - law.start) * law.density
    piece = min(max(int(s), 0), law.f.shape[0] - 1)
    c, z = law.f[piece], 2.0 * (s - piece) - 1.0
    z2 = z * z
    z4 = z2 * z2
    f = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z) + z4 * ((c[4] + c[5] * z) + z2 * (c[6] + c[7] * z))
    f1 = (c[1] + 2.0 * c[2] * z) + z2 * (3.0 * c[3] + 4.0 * c[4] * z)
    f1 += z4 * ((5.0 * c[5] + 6.0 * c[6] * z) + z2 * 7.0 * c[7])
    f2 = (2.0 * c[2] + 6.0 * c[3] * z) + z2 * (12.0 * c[4] + 20.0 * c[5] * z) + z4 * (30.0 * c[6] + 42.0 * c[7] * z)
    return f, f1 * (2.0 * law.density), f2 * (2.0 * law.density) ** 2


@inner
def law_flow(rho, h, law):
    """Return rho at a distance h (of either sign) to the right at constant I, not below the lower end of the table."""
    s = polynomial(law.s, law.start, law.density, rho) * math.exp(-law.rate * h)
    sigma = math.log1p(s / law.offset) if s > -law.offset else law.sigma_start
    return polynomial(law.rho, law.sigma_start, law.density, max(sigma, law.sigma_start))


@by_type
def law_decay(r, h, law):
    """Return r at a distance h (of either sign) to the right at constant I."""
    if law.instance_class is Rational:
        return lambda r, h, law: 1.0 + (r - 1.0) * math.exp(-h)
    return lambda r, h, law: math.exp(law_flow(math.log(r), h, law))


@by_type
def law_q_f(r, law):
    """Return q and f at r."""
    if law.instance_class is Rational:
        return lambda r, law: (r - 1.0, 1.0 - 1.0 / r)

    def tabulated(r, law):
        f = law_f(math.log(r), law)
        return f * r, f

    return tabulated


@compiled
def start_pieces(mass, h, law, r):
    """Fill r at the left ends of pieces of constant I with the given lengths and masses: r - r(h) = mass.

    The left side increases with r. The root ln r is bracketed, then found by alternating bisection and secant steps.
    """
    low0, high0 = law.start, law.start + law.f.shape[0] / law.density
    for i in range(h.size):
        low, high = low0, high0
        f_low = math.exp(low) - law_decay(math.exp(low), h[i], law) - mass[i]
        f_high = math.exp(high) - law_decay(math.exp(high), h[i], law) - mass[i]
        for k in range(200):
            middle = 0.5 * (low + high)
            if k % 2 and f_high > f_low:
                middle = min(max(low - f_low * (high - low) / (f_high - f_low), low), high)
            value = math.exp(middle) - law_decay(math.exp(middle), h[i], law) - mass[i]
            if value > 0.0:
                high, f_high = middle, value
            else:
                low, f_low = middle, value
            if high - low < 1e-15 * max(1.0, abs(low)) or abs(value) < 1e-16:
                break
        r[i] = math.exp(low if -f_low < f_high else high)
