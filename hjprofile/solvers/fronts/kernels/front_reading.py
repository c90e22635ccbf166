"""Evaluation of W, K and the volume of fronts, in the conventions of `front_state`."""

import math

from hjprofile.solvers.fronts.kernels.front_state import sweep
from hjprofile.solvers.kernels import compiled, inner
from hjprofile.solvers.kernels.law import law_decay, law_q_f

WIDE = 64.0  # jump times length of a piece, relative to its area, up to which a cubic interpolates W
STILL = 4e-16  # relative change of r over a part of a piece below which q has decayed to 0


@compiled
def read(fronts, n, area, medium, sides, nodes, W_out, K_out):
    """Fill W and K at `nodes` (increasing), after a sweep.

    Between two fronts of a `smooth` stretch W and ln K are interpolated by cubic Hermite polynomials, with the means of
    the one-sided q and f as slopes. This is second order; the pieces themselves would make q first order. At a kink the
    slope is its own one-sided value. Elsewhere the piece itself is evaluated, which is exact. It also replaces a cubic
    that would leave the range of q, and one whose jump times length exceeds WIDE times `area`.
    """
    x, jump, label, smooth, law = fronts.x, fronts.jump, fronts.label, fronts.smooth, medium.law
    r_left, r_right, K = sides.r_left, sides.r_right, sides.K
    sweep(x, jump, n, n - 1, medium, sides)
    W = 0.0  # at front j
    I = medium.r0  # right of front j
    j = -1
    at, r = 0.0, medium.r0
    for i in range(nodes.size):
        while j + 1 < n and x[j + 1] <= nodes[i]:
            j += 1
            W = I - r_left[j]
            I += jump[j]
            at, r = x[j], r_right[j]
        if j < 0:
            W_out[i], K_out[i] = 0.0, K[0] if n > 0 else 1.0
            continue
        cubic = j + 1 < n and smooth[j] and x[j + 1] > x[j]
        if cubic:
            h = x[j + 1] - x[j]
            jumps = 0.0 if label[j] > 0 else abs(jump[j])
            jumps = jumps if label[j + 1] > 0 else max(jumps, abs(jump[j + 1]))
            cubic = h * jumps <= WIDE * area
        if cubic:
            qa, fa = law_q_f(r_right[j], law)
            qb, fb = law_q_f(r_left[j + 1], law)
            W1 = I - r_left[j + 1]
            least, most = min(qa, qb), max(qa, qb)
            if label[j] == 0:
                q, f = law_q_f(r_left[j], law)
                qa, fa = 0.5 * (qa + q), 0.5 * (fa + f)
                least, most = min(least, q), max(most, q)
            if label[j + 1] == 0:
                q, f = law_q_f(r_right[j + 1], law)
                qb, fb = 0.5 * (qb + q), 0.5 * (fb + f)
                least, most = min(least, q), max(most, q)
            mean = (W1 - W) / h
            turn = cubic_turn(qa, mean, qb)
            cubic = least <= turn <= most
        if cubic:
            s = (nodes[i] - x[j]) / h
            value, slope_a, slope_b = s * s * (3.0 - 2.0 * s), h * s * (1.0 - s) ** 2, h * s * s * (s - 1.0)
            W_out[i] = W + (W1 - W) * value + slope_a * qa + slope_b * qb
            exponent = math.log(K[j + 1] / K[j]) * value - slope_a * fa - slope_b * fb
            K_out[i] = K[j] * math.exp(exponent)
        else:
            r = law_decay(r, nodes[i] - at, law)  # from node to node along the piece
            at = nodes[i]
            W_out[i], K_out[i] = I - r, K[j] * r / r_right[j]


@inner
def cubic_turn(a, mean, b):
    """Return the extreme slope inside a cubic with end slopes a and b and the given mean slope; a if there is none."""
    linear, square = 2.0 * (3.0 * mean - 2.0 * a - b), 3.0 * (a + b - 2.0 * mean)
    if square == 0.0 or not 0.0 < -linear / (2.0 * square) < 1.0:
        return a
    return a - linear * linear / (4.0 * square)


@compiled
def volume(fronts, n, medium, r_right):
    """Return ∫W dx by five-point Gauss-Legendre quadrature on parts of every piece over which W varies little.

    The sum over the parts of a piece stops where W is constant.
    """
    x, jump, law = fronts.x, fronts.jump, medium.law
    if n == 0:
        return 0.0
    z = (-0.906179845938664, -0.5384693101056831, 0.0, 0.5384693101056831, 0.906179845938664)
    w = (0.23692688505618908, 0.47862867049936647, 0.5688888888888889, 0.47862867049936647, 0.23692688505618908)
    total, I = 0.0, medium.r0
    for j in range(n):
        I += jump[j]
        h = (x[j + 1] if j + 1 < n else 0.0) - x[j]
        r = r_right[j]
        parts = 1 + int(4.0 * abs(h) * (1.0 + abs(law_q_f(r, law)[1])))
        d = h / parts
        for part in range(parts):
            for k in range(5):
                s = 0.5 * d * (1.0 + z[k])
                total += 0.5 * d * w[k] * (I - law_decay(r, s, law))
            before, r = r, law_decay(r, d, law)
            if abs(r - before) <= STILL * r:  # q is 0 from here on
                total += (parts - 1 - part) * d * (I - r)
                break
    return total
