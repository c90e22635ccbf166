"""Front tracking for laws of linear growth, where slopes become infinite and the profile jumps (theory, §14).

As in `kernels.moving_fronts` I = W + R(q) is constant between fronts. A front is a kink, at which W is continuous, or a
vertical step, at which W jumps by m. The piece on the right of a step is no longer told by W on its left, so each step
carries the place of that piece: y = 1 - exp(-rate d), d being the distance to the right of the point where the piece,
continued to the left, is vertical. y is 0 where q is infinite, 1 where q = 0 and above 1 where q < 0.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.fronts.kernels.moving_fronts import note
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.law import polynomial

LEVEL = 1e-14  # height of a step, relative to the jump of I, that is rounding
ALIKE = 1e-5  # difference of ln(1 + q) below which [f]/[q] is f' in the middle


class StepLaw(NamedTuple):
    """A law over v = ln(1 + q): polynomials on pieces of equal width, and their values at the joints.

    Attributes:
        r, age, df, area: R(q); -ln y; f'(q); ∫ (R - R(0)) dx to the right of q in a piece of constant I.
        r_at, age_at: of shape (pieces + 1,), both increasing.
        start, density: where the pieces begin, and how many there are per unit of v.
        end: the v that stands for an infinite slope.
        r0, r_most: R(0), and R where the slope is infinite.
        eta0, rate: f' there, and 1/R'(0).
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


@compiled
def at(table, law, v):
    """The value at v of one of the law's tables."""
    return polynomial(table, law.start, law.density, v)


@compiled
def inverse(table, joints, law, value):
    """The v at which an increasing table has that value; within the range of the table."""
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
    """y at a distance h (of either sign) to the right, in a piece of constant I; not below 0."""
    return max(-math.expm1(-law.rate * h) + math.exp(-law.rate * h) * y, 0.0)


@compiled
def y_of(v, law):
    """y where ln(1 + q) = v."""
    return math.exp(-at(law.age, law, v)) if v < law.end else 0.0


@compiled
def v_of(y, law):
    """ln(1 + q) where y is given."""
    return inverse(law.age, law.age_at, law, -math.log(y)) if y > 0.0 else law.end


@compiled
def r_of(v, law):
    """R where ln(1 + q) = v."""
    return at(law.r, law, v) if v < law.end else law.r_most


@compiled
def v_of_r(r, law):
    """ln(1 + q) where R(q) = r."""
    return inverse(law.r, law.r_at, law, r)


@compiled
def f_of(v, law):
    """f where ln(1 + q) = v."""
    return math.expm1(v) / r_of(v, law)


@compiled
def step_speed(m, law):
    """(e^{η0 m} - 1)/m."""
    z = law.eta0 * m
    return law.eta0 * (math.expm1(z) / z if abs(z) > 1e-12 else 1.0 + 0.5 * z)


@compiled
def sweep(x, jump, is_step, y, n, top, law, v_left, v_right, r_left, r_right, m, K, speed, drift):
    """One-sided v = ln(1 + q) and R, heights m, K right of fronts, x' and dy/dt; x = 0 lies right of front `top`.

    A sweep right for v, one left for K with K(0) = 1. A kink whose W does not fit under an infinite slope has the rest
    as a height already.
    """
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
    K[top] = r_right[top] / r_of(v_of(moved(y_of(v_right[top], law), -x[top], law), law), law)
    for j in range(top - 1, -1, -1):
        K[j] = K[j + 1] * r_right[j] / r_left[j + 1]
        if m[j + 1] != 0.0:
            K[j] *= math.exp(law.eta0 * m[j + 1])
    for j in range(top + 1, n):
        K[j] = K[j - 1] * math.exp(-law.eta0 * m[j]) * r_left[j] / r_right[j - 1]
    for j in range(n):
        if is_step[j] or m[j] > 0.0:
            speed[j] = K[j] * step_speed(m[j], law)
        elif abs(v_right[j] - v_left[j]) < ALIKE:
            speed[j] = K[j] * at(law.df, law, 0.5 * (v_left[j] + v_right[j]))
        else:
            a, b = math.expm1(v_left[j]), math.expm1(v_right[j])
            speed[j] = K[j] * (b / r_right[j] - a / r_left[j]) / (b - a)
        # the piece on the right moves as a whole, with K/R
        drift[j] = law.rate * (speed[j] - K[j] / r_right[j]) * (1.0 - y[j]) if is_step[j] else 0.0


@compiled
def flows(x, top, v_right, m, K, law):
    """K - 1 left of all fronts, and F at x = 0."""
    v = v_of(moved(y_of(v_right[top], law), -x[top], law), law)
    return K[0] * math.exp(law.eta0 * m[0]) - 1.0, f_of(v, law)


@compiled
def read(x, jump, is_step, y, n, law, work, nodes, W_out, K_out):
    """W and K at `nodes` (increasing), K at a step being that on its right."""
    v_right, m, K = work[1], work[4], work[5]
    sweep(x, jump, is_step, y, n, n - 1, law, work[0], v_right, work[2], work[3], m, K, work[6], work[7])
    j, I = -1, law.r0
    for i in range(nodes.size):
        while j + 1 < n and x[j + 1] <= nodes[i]:
            j += 1
            I += jump[j]
        if j < 0:
            W_out[i], K_out[i] = 0.0, K[0] * math.exp(law.eta0 * m[0]) if n > 0 else 1.0
            continue
        r = r_of(v_of(moved(y_of(v_right[j], law), nodes[i] - x[j], law), law), law)
        W_out[i], K_out[i] = I - r, K[j] * r / r_of(v_right[j], law)


@compiled
def volume(x, jump, n, v_left, v_right, law):
    """∫W dx, for v as swept."""
    total, I = 0.0, law.r0
    for j in range(n):
        I += jump[j]
        end = x[j + 1] if j + 1 < n else 0.0
        v = v_left[j + 1] if j + 1 < n else v_of(moved(y_of(v_right[j], law), end - x[j], law), law)
        total += (I - law.r0) * (end - x[j]) - (at(law.area, law, v_right[j]) - at(law.area, law, v))
    return total


@compiled
def start_pieces(mass, h, law, v):
    """Fills v at the left ends of pieces of constant I with the given lengths and masses: r - r(h) = mass."""
    for i in range(h.size):
        low, high = law.start, law.end
        for _ in range(100):
            middle = 0.5 * (low + high)
            over = r_of(middle, law) - r_of(v_of(moved(y_of(middle, law), h[i], law), law), law) > mass[i]
            low, high = (low, middle) if over else (middle, high)
            if high - low < 1e-15 * max(1.0, abs(low)):
                break
        v[i] = 0.5 * (low + high)


@compiled
def held(y, h, law):
    """Return ∫(R - R(0)) dx over a distance h (of either sign) from where y is given, in a piece of constant I."""
    area = at(law.area, law, v_of(y, law)) - at(law.area, law, v_of(moved(y, h, law), law))
    if h < 0.0 and y < 1.0:  # beyond its vertical slope a piece is level
        area += min(h - math.log1p(-y) / law.rate, 0.0) * (law.r_most - law.r0)
    return area


@compiled
def height(x, left, right, jump, law):
    """Return the height of a step at x between two pieces, and how fast it grows with x.

    A piece is a position with y there. I right of the step exceeds I left of it by `jump`.
    """
    v1 = v_of(moved(left[1], x - left[0], law), law)
    v2 = v_of(moved(right[1], x - right[0], law), law)
    return r_of(v1, law) + jump - r_of(v2, law), math.expm1(v2) - math.expm1(v1)


@compiled
def corner(left, right, jump, law):
    """Return where W is continuous between two pieces, by Newton's method, between their positions if it lies there.

    It does for two fronts that jump the same way. The second value is whether W is continuous.
    """
    xa, xb = left[0], right[0]
    x, most = 0.5 * (xa + xb), 20.0 * abs(xa - xb)
    at_a, at_b = height(xa, left, right, jump, law)[0], height(xb, left, right, jump, law)[0]
    for end, m in ((xa, at_a), (xb, at_b)):
        if abs(m) <= LEVEL * max(1.0, abs(jump)):
            return end, True
    between = at_a > 0.0 > at_b or at_a < 0.0 < at_b
    low, high = (min(xa, xb), max(xa, xb)) if between else (x - most, x + most)
    rising = at_b > at_a if xb > xa else at_a > at_b
    for _ in range(60):
        m, slope = height(x, left, right, jump, law)
        if between and (m < 0.0) == rising:
            low = x
        elif between:
            high = x
        nearer = x - m / slope
        if not low <= nearer <= high:
            nearer = 0.5 * (low + high) if between else min(max(nearer, low), high) if nearer == nearer else x
        done = abs(nearer - x) < 1e-15
        x = nearer
        if done:
            break
    m = height(x, left, right, jump, law)[0]
    return x, m <= 1e-9 * max(1.0, abs(jump))


@compiled
def balance(left, middle, right, jump_left, jump_right, law):
    """Return where a step between the pieces `left` and `right` keeps ∫W dx as it is with `middle` between them.

    The front on the left of `middle` lies where `left` and `middle` are given, that on its right where `right` is.
    """
    (xa, ya), (xb, yb), jump = left, right, jump_left + jump_right
    now = jump_left * (xb - xa) - held(middle[1], xb - xa, law)
    x, most = 0.5 * (xa + xb), 20.0 * abs(xa - xb)
    low, high = x - most, x + most
    for _ in range(60):
        m = height(x, left, right, jump, law)[0]
        gain = jump * (xb - x) + held(yb, x - xb, law) - held(ya, x - xa, law) - now
        nearer = min(max(x + gain / m, low), high) if m > 0.0 else x
        done = abs(nearer - x) < 1e-15
        x = nearer
        if done:
            break
    return x


@compiled
def merge(x, jump, is_step, y, label, since, met, n, t, law, work, log, logged):
    """Merges fronts that are out of order, also several at once; returns how many are left and the rows logged.

    Two kinks merge where W stays continuous, and where ∫W dx does not change if a step is among them or comes of them.
    The piece on the right of all is untouched, and with it the mass. `work[12]` holds y on the right of the fronts.
    """
    v_left, v_right, m, speed, y_right = work[0], work[1], work[4], work[6], work[12]
    k = -1
    for j in range(n):
        k += 1
        if k < j:
            x[k], jump[k], is_step[k], y[k], label[k] = x[j], jump[j], is_step[j], y[j], label[j]
            since[k], met[k], y_right[k] = since[j], met[j], y_right[j]
            v_left[k], v_right[k], m[k], speed[k] = v_left[j], v_right[j], m[j], speed[j]
        while k > 0 and x[k - 1] > x[k]:
            i = k - 1
            total = jump[i] + jump[k]
            left, middle, right = (x[i], y_of(v_left[i], law)), (x[i], y_right[i]), (x[k], y_right[k])
            place, fits = corner(left, right, total, law)
            as_step = is_step[i] or is_step[k] or not fits
            if as_step:
                place = balance(left, middle, right, jump[i], jump[k], law)
            known = (is_step[i] and label[i] > 0) or (is_step[k] and label[k] > 0)
            if label[i] > 0 and label[k] > 0:
                closing = speed[i] - speed[k]
                ago = (x[i] - x[k]) / closing if closing > 0.0 else 0.0
                logged = note(log, logged, t - ago, max(label[i], label[k]), min(label[i], label[k]), place)
                label[i] = min(label[i], label[k])
            else:
                label[i] = max(label[i], label[k])
            if as_step and label[i] > 0 and not known:
                logged = note(log, logged, min(t, since[i], since[k]), label[i], -2.0, place)
            y[i] = y_right[i] = moved(right[1], place - right[0], law)
            v_left[i] = v_of(moved(left[1], place - left[0], law), law)
            v_right[i] = v_of(y[i], law)
            m[i] = r_of(v_left[i], law) + total - r_of(v_right[i], law) if as_step else 0.0
            x[i], jump[i], is_step[i] = place, total, as_step
            since[i], met[i] = min(since[i], since[k]), min(met[i], met[k], t)
            speed[i] = speed[i] if is_step[i] else speed[k]
            k = i
    return k + 1, logged
