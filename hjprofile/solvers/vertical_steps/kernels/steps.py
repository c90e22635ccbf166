"""Front tracking for laws of linear growth, with infinite slopes and vertical steps (§16).

As in `fronts.kernels.front_state` I = W + R(q) is constant between fronts. A front is a kink, at which W is continuous,
or a vertical step, at which W jumps by m. W on the left of a vertical step does not determine the piece on its right,
so each step stores the position of that piece: y = 1 - exp(-rate d), with d the distance to the right of the point
where the piece, continued to the left, is vertical. y is 0 where q is infinite, 1 where q = 0 and above 1 where q < 0.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.law import polynomial

EQUAL_LN_SLOPES = 1e-5  # difference of ln(1 + q) below which [f]/[q] is f' in the middle


class StepLaw(NamedTuple):
    """A law over v = ln(1 + q): polynomials on pieces of equal width, and their values at the joints.

    Attributes:
        r, age, df, area: R(q); -ln y; f'(q); ∫ (R - R(0)) dx to the right of q in a piece of constant I.
        r_at, age_at: of shape (pieces + 1,), both increasing.
        start, density: the left end of the pieces, and their number per unit of v.
        end: the v that stands for an infinite slope.
        r0, r_most: R(0), and R of an infinite slope.
        eta0, rate: f' of an infinite slope, and 1/R'(0).
    """

    r: np.ndarray
    age: np.ndarray
    df: np.ndarray
    area: np.ndarray
    r_at: np.ndarray
    age_at: np.ndarray
    start: float
    density: float
    end: float
    r0: float
    r_most: float
    eta0: float
    rate: float


class StepFronts(NamedTuple):
    """Kinks and vertical steps from left to right, the first n of each array.

    Attributes:
        x, jump: positions and jumps of I.
        is_step, y: True for a vertical step, and y on the right of it.
        label: the number of the kink or step that a front is, or 0.
        blow_up: the time at which q becomes infinite midway through a step, infinite for other fronts.
        first_merge: the time of its first merge; infinite before.
    """

    x: np.ndarray
    jump: np.ndarray
    is_step: np.ndarray
    y: np.ndarray
    label: np.ndarray
    blow_up: np.ndarray
    first_merge: np.ndarray


class StepSides(NamedTuple):
    """Results of a sweep at each front.

    Attributes:
        v_left, v_right, r_left, r_right: ln(1 + q) and R(q).
        height: of the vertical step.
        K: K on the right.
        speed, drift: x' and dy/dt.
    """

    v_left: np.ndarray
    v_right: np.ndarray
    r_left: np.ndarray
    r_right: np.ndarray
    height: np.ndarray
    K: np.ndarray
    speed: np.ndarray
    drift: np.ndarray


@compiled
def at(table, law, v):
    """Return the value at v of one of the law's tables."""
    return polynomial(table, law.start, law.density, v)


@compiled
def inverse(table, joints, law, value):
    """Return the v at which an increasing table has the given value, within the range of the table."""
    last = joints.size - 1
    if value >= joints[last]:
        return law.end
    if value <= joints[0]:
        return law.start
    k = np.searchsorted(joints, value, side="right") - 1
    c = table[k]
    z = 2.0 * (value - joints[k]) / (joints[k + 1] - joints[k]) - 1.0
    for _ in range(8):  # Newton in the piece, from the straight line between its ends
        z2 = z * z
        low, high = (c[0] + c[1] * z) + z2 * (c[2] + c[3] * z), (c[4] + c[5] * z) + z2 * (c[6] + c[7] * z)
        slope = (c[1] + 2.0 * c[2] * z) + z2 * (3.0 * c[3] + 4.0 * c[4] * z)
        slope += z2 * z2 * ((5.0 * c[5] + 6.0 * c[6] * z) + z2 * 7.0 * c[7])
        dz = (low + z2 * z2 * high - value) / slope
        z = min(max(z - dz, -1.0), 1.0)
        if abs(dz) < 1e-13:
            break
    return law.start + (k + 0.5 * (z + 1.0)) / law.density


@compiled
def moved(y, h, law):
    """Return y at a distance h (of either sign) to the right, in a piece of constant I; not below 0."""
    return max(-math.expm1(-law.rate * h) + math.exp(-law.rate * h) * y, 0.0)


@compiled
def y_of(v, law):
    """Return y where ln(1 + q) = v."""
    return math.exp(-at(law.age, law, v)) if v < law.end else 0.0


@compiled
def v_of(y, law):
    """Return ln(1 + q) where y is given."""
    return inverse(law.age, law.age_at, law, -math.log(y)) if y > 0.0 else law.end


@compiled
def r_of(v, law):
    """Return R where ln(1 + q) = v."""
    return at(law.r, law, v) if v < law.end else law.r_most


@compiled
def v_of_r(r, law):
    """Return ln(1 + q) where R(q) = r."""
    return inverse(law.r, law.r_at, law, r)


@compiled
def f_of(v, law):
    """Return f where ln(1 + q) = v."""
    return math.expm1(v) / r_of(v, law)


@compiled
def step_speed(m, law):
    """Return (e^{η0 m} - 1)/m."""
    z = law.eta0 * m
    return law.eta0 * (math.expm1(z) / z if abs(z) > 1e-12 else 1.0 + 0.5 * z)


@compiled
def sweep(x, y, fronts, n, crest, law, sides):
    """Fill the sides of the first n fronts, at x and with y on their right; x = 0 lies right of front `crest`.

    A sweep to the right computes v, and one to the left K with K(0) = 1. If the jump of I at a kink exceeds the R of an
    infinite slope, the excess is already the height of a vertical step.
    """
    jump, is_step, m, K = fronts.jump, fronts.is_step, sides.height, sides.K
    speed, drift = sides.speed, sides.drift
    v_left, v_right, r_left, r_right = sides.v_left, sides.v_right, sides.r_left, sides.r_right
    r, v, y_right = law.r0, 0.0, 1.0
    for j in range(n):
        v_left[j], r_left[j] = v, r
        r += jump[j]
        m[j] = 0.0
        if is_step[j]:
            y_right = max(y[j], 0.0)
            v = v_of(y_right, law)
            m[j], r = r - r_of(v, law), r_of(v, law)
        elif r >= law.r_most:
            m[j], v, y_right, r = r - law.r_most, law.end, 0.0, law.r_most
        else:
            v = v_of_r(r, law)
            y_right = y_of(v, law)
        v_right[j], r_right[j] = v, r
        if j < n - 1 and x[j + 1] != x[j]:
            v = v_of(moved(y_right, x[j + 1] - x[j], law), law)
            r = r_of(v, law)
    if n == 0:
        return
    K[crest] = r_right[crest] / r_of(v_of(moved(y_of(v_right[crest], law), -x[crest], law), law), law)
    for j in range(crest - 1, -1, -1):
        K[j] = K[j + 1] * r_right[j] / r_left[j + 1]
        if m[j + 1] != 0.0:
            K[j] *= math.exp(law.eta0 * m[j + 1])
    for j in range(crest + 1, n):
        K[j] = K[j - 1] * math.exp(-law.eta0 * m[j]) * r_left[j] / r_right[j - 1]
    for j in range(n):
        if is_step[j] or m[j] > 0.0:
            speed[j] = K[j] * step_speed(m[j], law)
        elif abs(v_right[j] - v_left[j]) < EQUAL_LN_SLOPES:
            speed[j] = K[j] * at(law.df, law, 0.5 * (v_left[j] + v_right[j]))
        else:
            a, b = math.expm1(v_left[j]), math.expm1(v_right[j])
            speed[j] = K[j] * (b / r_right[j] - a / r_left[j]) / (b - a)
        # the piece on the right moves as a whole, with K/R
        drift[j] = law.rate * (speed[j] - K[j] / r_right[j]) * (1.0 - y[j]) if is_step[j] else 0.0


@compiled
def flows(x, crest, sides, law):
    """Return K - 1 left of all fronts, and F at x = 0."""
    v = v_of(moved(y_of(sides.v_right[crest], law), -x[crest], law), law)
    return sides.K[0] * math.exp(law.eta0 * sides.height[0]) - 1.0, f_of(v, law)


@compiled
def read(fronts, n, law, sides, nodes, W_out, K_out):
    """Fill W and K at `nodes` (increasing), after a sweep; K at a vertical step is the value on its right."""
    x, jump, v_right, K = fronts.x, fronts.jump, sides.v_right, sides.K
    sweep(x, fronts.y, fronts, n, n - 1, law, sides)
    j, I = -1, law.r0
    for i in range(nodes.size):
        while j + 1 < n and x[j + 1] <= nodes[i]:
            j += 1
            I += jump[j]
        if j < 0:
            W_out[i], K_out[i] = 0.0, K[0] * math.exp(law.eta0 * sides.height[0]) if n > 0 else 1.0
            continue
        r = r_of(v_of(moved(y_of(v_right[j], law), nodes[i] - x[j], law), law), law)
        W_out[i], K_out[i] = I - r, K[j] * r / r_of(v_right[j], law)


@compiled
def volume(fronts, n, sides, law):
    """Return ∫W dx, for sides as swept."""
    x, jump, v_left, v_right = fronts.x, fronts.jump, sides.v_left, sides.v_right
    total, I = 0.0, law.r0
    for j in range(n):
        I += jump[j]
        end = x[j + 1] if j + 1 < n else 0.0
        v = v_left[j + 1] if j + 1 < n else v_of(moved(y_of(v_right[j], law), end - x[j], law), law)
        total += (I - law.r0) * (end - x[j]) - (at(law.area, law, v_right[j]) - at(law.area, law, v))
    return total


@compiled
def start_pieces(mass, h, law, v):
    """Fill v at the left ends of pieces of constant I with the given lengths and masses: r - r(h) = mass."""
    for i in range(h.size):
        low, high = law.start, law.end
        for _ in range(100):
            middle = 0.5 * (low + high)
            over = r_of(middle, law) - r_of(v_of(moved(y_of(middle, law), h[i], law), law), law) > mass[i]
            low, high = (low, middle) if over else (middle, high)
            if high - low < 1e-15 * max(1.0, abs(low)):
                break
        v[i] = 0.5 * (low + high)
