"""Front tracking for laws of linear growth, where slopes become infinite and the profile jumps (theory, §14).

As in `kernels.fronts` I = W + R(q) is constant between fronts. A front is a kink, at which W is continuous, or a
vertical step, at which W jumps by m. The piece on the right of a step is no longer told by W on its left, so each step
carries the place of that piece: y = 1 - exp(-rate d), d being the distance to the right of the point where the piece,
continued to the left, is vertical. y is 0 where q is infinite, 1 where q = 0 and above 1 where q < 0.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.fronts import note
from hjprofile.solvers.kernels.law import polynomial

CROWDED = 0.25  # part of a time step that is taken where a slope is about to become vertical
LANDINGS = 20  # trials of a time step that ends as a step arrives at x = 0, ...
LANDED = 1e-10  # ... to within this part of the spacing
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
def meeting(xa, va, xb, vb, jump, law):
    """Where R right of b exceeds R left of a by `jump`: two kinks become one. And whether there is such a place."""
    x, ya, yb = 0.5 * (xa + xb), y_of(va, law), y_of(vb, law)
    for _ in range(8):
        v1, v2 = v_of(moved(ya, x - xa, law), law), v_of(moved(yb, x - xb, law), law)
        dq = math.expm1(v2) - math.expm1(v1)
        if v2 >= law.end or dq == 0.0:
            break
        dx = (r_of(v2, law) - r_of(v1, law) - jump) / dq
        x += dx
        if abs(dx) < 1e-14:
            break
    middle, most = 0.5 * (xa + xb), 20.0 * abs(xa - xb)
    x = min(max(x, middle - most), middle + most) if x == x else middle
    v1, v2 = v_of(moved(ya, x - xa, law), law), v_of(moved(yb, x - xb, law), law)
    return x, r_of(v1, law) + jump <= r_of(v2, law) + 1e-9 * max(1.0, abs(jump))


@compiled
def merge(x, jump, is_step, y, label, since, met, n, t, law, work, log, logged):
    """Merges fronts that are out of order, also several at once; returns how many are left and the rows logged.

    Two kinks merge where W stays continuous; with a step among them the heights keep their centre of mass. The piece on
    the right of all is untouched, and with it the mass.
    """
    v_left, v_right, m, speed = work[0], work[1], work[4], work[6]
    k = -1
    for j in range(n):
        k += 1
        if k < j:
            x[k], jump[k], is_step[k], y[k], label[k] = x[j], jump[j], is_step[j], y[j], label[j]
            since[k], met[k] = since[j], met[j]
            v_left[k], v_right[k], m[k], speed[k] = v_left[j], v_right[j], m[j], speed[j]
        while k > 0 and x[k - 1] > x[k]:
            i = k - 1
            total = jump[i] + jump[k]
            height = (m[i] if is_step[i] else 0.0) + (m[k] if is_step[k] else 0.0)
            if is_step[i] or is_step[k]:
                share = m[k] / height if is_step[k] and height > 0.0 else (0.0 if is_step[i] else 1.0)
                place, as_step = x[i] + min(max(share, 0.0), 1.0) * (x[k] - x[i]), True
            else:
                place, fits = meeting(x[i], v_left[i], x[k], v_right[k], total, law)
                as_step = not fits
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
            y[i] = moved(y_of(v_right[k], law), place - x[k], law)
            v_left[i] = v_of(moved(y_of(v_left[i], law), place - x[i], law), law)
            v_right[i] = v_of(y[i], law)
            m[i] = r_of(v_left[i], law) + total - r_of(v_right[i], law) if as_step else 0.0
            x[i], jump[i], is_step[i] = place, total, as_step
            since[i], met[i] = min(since[i], since[k]), min(met[i], met[k], t)
            speed[i] = speed[i] if is_step[i] else speed[k]
            k = i
    return k + 1, logged


@compiled
def transitions(x, jump, is_step, y, label, since, met, n, t, quantum, strong, law, work, log, logged, totals):
    """Kinks that have become steps and the reverse, slopes that steps leave behind, births and exits.

    Returns how many fronts there are and the rows logged. A kink becomes a step where W on its right has no room under
    an infinite slope. A step slower than the steep slopes just above it lets them go: a front of strength `quantum`
    leaves it to the right. `met` is when a front first merged: with a jump above `strong` it is a kink, born then.
    `since` is when q becomes infinite midway through a front, by dR/dt = K (f - q f') from the moment at which it does
    so on its right.
    """
    v_left, v_right, r_left, r_right, m, K, speed = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    j = 0
    while j < n:
        if not is_step[j] and m[j] > 0.0:
            is_step[j], y[j] = True, 0.0
            if label[j] > 0:
                logged = note(log, logged, t, label[j], -2.0, x[j])
        elif is_step[j] and m[j] <= 0.0:
            is_step[j] = False
        elif label[j] == 0 and not is_step[j] and met[j] <= t and jump[j] > strong:
            totals[3] += 1.0
            label[j] = int(totals[3])
            logged = note(log, logged, met[j], totals[3], 0.0, x[j] - (t - met[j]) * speed[j])
        if is_step[j] and since[j] == np.inf:
            over, v = r_left[j] + 0.5 * jump[j] - law.r_most, v_of_r(r_left[j] + 0.5 * jump[j], law)
            since[j] = t - over / (K[j] * (f_of(v, law) - math.expm1(v) * at(law.df, law, v)))
        if is_step[j] and r_right[j] + quantum < law.r_most and n < x.size:
            v = v_of_r(r_right[j] + quantum, law)
            if speed[j] < K[j] * at(law.df, law, v):
                for i in range(n, j + 1, -1):
                    x[i], jump[i], is_step[i], y[i] = x[i - 1], jump[i - 1], is_step[i - 1], y[i - 1]
                    label[i], since[i], met[i] = label[i - 1], since[i - 1], met[i - 1]
                    for row in range(7):
                        work[row, i] = work[row, i - 1]
                x[j + 1], jump[j + 1], is_step[j + 1], y[j + 1], label[j + 1] = x[j], -quantum, False, 0.0, 0
                since[j + 1], met[j + 1] = np.inf, np.inf
                v_left[j + 1], r_left[j + 1], m[j + 1] = v, r_right[j] + quantum, 0.0
                jump[j] += quantum
                v_right[j], r_right[j], y[j] = v, r_right[j] + quantum, y_of(v, law)
                n += 1
                j += 1
        j += 1
    logged = number_steps(x, is_step, label, since, n, t, strong, m, speed, log, logged, totals)
    while n > 0 and x[n - 1] >= 0.0:
        n -= 1
        if is_step[n]:
            totals[1] += m[n]  # what is above a step falls over the edge with it
        if label[n] > 0:
            logged = note(log, logged, t - x[n] / speed[n], label[n], -1.0, 0.0)
    return n, logged


@compiled
def number_steps(x, is_step, label, since, n, t, strong, m, speed, log, logged, totals):
    """Numbers steps that open in a smooth slope: of neighbours that do so together, one that outweighs the rest."""
    j = 0
    while j < n:
        first, tallest, height, born = j, j, 0.0, np.inf
        numbered = False
        while j < n and is_step[j]:
            numbered |= label[j] > 0
            height += m[j]
            born = min(born, since[j])
            if m[j] > m[tallest]:
                tallest = j
            j += 1
        if j > first and not numbered and m[tallest] > 0.5 * height and height > strong and t >= born:
            totals[3] += 1.0
            label[tallest] = int(totals[3])
            born = min(born, t)
            logged = note(log, logged, born, totals[3], -2.0, x[tallest] - (t - born) * speed[tallest])
        j = max(j, first + 1)
    return logged


@compiled
def rows(work):
    """Return the rows of the workspace that `sweep` fills."""
    return work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7]


@compiled
def top_front_or_step(x, is_step, n):
    """Return the front whose piece on the right holds x = 0; a step counts as below the crest until it has arrived."""
    top = n - 1
    while top > 0 and x[top] > 0.0 and not is_step[top]:
        top -= 1
    return top


@compiled
def runge_kutta(x, jump, is_step, y, n, dt, law, work):
    """Set `work[10:12]` to the changes of x and y in a classical Runge-Kutta step; return the changes of two integrals.

    These are ∫(K_left - 1) dt and ∫F(0) dt. `work` holds the sweep of x and y on entry, and that of the last stage on
    return.
    """
    v_right, r_right, m, K = work[1], work[3], work[4], work[5]
    k, d, xs, ys, dx, dy = work[6], work[7], work[8], work[9], work[10], work[11]
    growth = outflow = 0.0
    for j in range(n):
        dx[j] = dy[j] = 0.0
    top = top_front_or_step(x, is_step, n)
    for stage in range(4):
        if stage > 0:
            part = 1.0 if stage == 3 else 0.5
            for j in range(n):
                xs[j], ys[j] = x[j] + part * dt * k[j], y[j] + part * dt * d[j]
            top = top_front_or_step(xs, is_step, n)
            sweep(xs, jump, is_step, ys, n, top, law, work[0], v_right, work[2], r_right, m, K, k, d)
        weight = dt / 3.0 if stage in (1, 2) else dt / 6.0
        at_left, at_top = flows(xs if stage else x, top, v_right, m, K, law)
        growth += weight * at_left
        outflow += weight * at_top
        for j in range(n):
            dx[j] += weight * k[j]
            dy[j] += weight * d[j]
    return growth, outflow


@compiled
def advance(x, jump, is_step, y, label, since, met, n, t, end, reach, spacing, quantum, strong, law, work, log, totals):
    """Classical Runge-Kutta steps to `end`, merging after each; otherwise as `kernels.fronts.advance`.

    K falls by e^{-η0 m} at the moment at which a vertical step leaves, so a time step ends there. `log` takes rows
    (t, kink, into, x), into = 0 a birth, -1 an exit, -2 a blow-up. `totals` holds ∫(K_left - 1) dt, ∫F(0) dt with the
    steps that left, the number of time steps and the highest label. Returns n and the rows logged.
    """
    logged = 0
    r_right, k, dx, dy = work[3], work[6], work[10], work[11]
    while t < end and n > 0:
        top = top_front_or_step(x, is_step, n)
        sweep(x, jump, is_step, y, n, top, law, *rows(work))
        fastest, opening, first = 0.0, False, -1
        for j in range(n):
            fastest = max(fastest, k[j])
            opening |= label[j] == 0 and r_right[j] + 8.0 * abs(jump[j]) > law.r_most
            first = j if is_step[j] else first
        # where a smooth slope breaks fronts are crowded
        dt = (CROWDED if opening else 1.0) * reach * spacing / fastest
        if not dt > 1e-9 * end:
            return n, -1
        if dt >= end - t:
            dt = end - t
        elif 2.0 * dt > end - t:
            dt = 0.5 * (end - t)
        longest = dt
        if first >= 0:
            dt = min(dt, -x[first] / k[first])
        growth, outflow = runge_kutta(x, jump, is_step, y, n, dt, law, work)
        for trial in range(LANDINGS):
            beyond = x[first] + dx[first] if first >= 0 else -1.0
            if dt == longest and beyond <= 0.0:
                break
            if abs(beyond) <= LANDED * spacing or trial == LANDINGS - 1:
                dx[first] = -x[first]
                break
            dt = min(max(dt - beyond / k[first], 0.5 * dt), longest)
            sweep(x, jump, is_step, y, n, top, law, *rows(work))
            growth, outflow = runge_kutta(x, jump, is_step, y, n, dt, law, work)
        for j in range(n):
            x[j] += dx[j]
            y[j] = max(y[j] + dy[j], 0.0)
        totals[0] += growth
        totals[1] += outflow
        totals[2] += 1.0
        t = end if dt == end - t else t + dt
        sweep(x, jump, is_step, y, n, top_front_or_step(x, is_step, n), law, *rows(work))
        before = n
        n, logged = merge(x, jump, is_step, y, label, since, met, n, t, law, work, log, logged)
        if n < before:
            sweep(x, jump, is_step, y, n, top_front_or_step(x, is_step, n), law, *rows(work))
        n, logged = transitions(
            x, jump, is_step, y, label, since, met, n, t, quantum, strong, law, work, log, logged, totals
        )
    return n, logged
