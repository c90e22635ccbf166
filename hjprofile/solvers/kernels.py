"""Every compiled loop: arrays and floats in, arrays and floats out.

A law enters as arrays of its values, so a user's own law runs through the same kernels as the built-in ones.
Nodes carry index 0..N, cells 0..N-1; cell i lies between nodes i and i+1.
"""

from __future__ import annotations

import math

import numba
import numpy as np


def compiled(function):
    """numba.njit with a cache on disk where there is a writable place for it."""
    # error_model="numpy": without the check for division by zero loops vectorise
    try:
        return numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # no place for the cache
        return numba.njit(error_model="numpy")(function)


@compiled
def hj_slopes(W, dx, q):
    """q = W_x on the cells; returns the least, or NaN if any is not a number."""
    least = math.inf
    bad = 0
    for i in range(q.size):
        value = (W[i + 1] - W[i]) / dx
        q[i] = value
        least = min(least, value)
        bad += value != value
    return math.nan if bad else least


@compiled
def hj_exponent(f, dx, exponent):
    """∫_x^0 f dξ at the nodes, one suffix sum."""
    total = 0.0
    exponent[f.size] = 0.0
    for i in range(f.size - 1, -1, -1):
        total += f[i] * dx
        exponent[i] = total


@compiled
def hj_speed(df, K):
    """The largest K f', with each cell's f' and the larger K of its two nodes."""
    speed = 0.0
    for i in range(df.size):
        speed = max(speed, max(K[i], K[i + 1]) * df[i])
    return speed


@compiled
def hj_local_lax_friedrichs(q, f_mean, df, K, F):
    """F = K f(½(q⁻+q⁺)) - ½ α (q⁺-q⁻) at the inner nodes, α = K max(f'(q⁻), f'(q⁺)): f' is decreasing."""
    for i in range(1, q.size):
        alpha = K[i] * max(df[i - 1], df[i])
        F[i] = K[i] * f_mean[i - 1] - 0.5 * alpha * (q[i] - q[i - 1])


@compiled
def hj_lax_friedrichs(q, f_mean, alpha, K, F):
    """F = K f(½(q⁻+q⁺)) - ½ α (q⁺-q⁻) at the inner nodes, one α."""
    for i in range(1, q.size):
        F[i] = K[i] * f_mean[i - 1] - 0.5 * alpha * (q[i] - q[i - 1])


@compiled
def hj_update(W, F, dt):
    """W_i -= dt F_i."""
    for i in range(W.size):
        W[i] -= dt * F[i]


@compiled
def limited_edges(q, floor_share, left, right):
    """Values at both edges of each cell from the monotonised central slope.

    The first and last cell take the one-sided slope. No edge lies further than `floor_share` of 1 + q from its mean
    on the lower side, which keeps q > -1.
    """
    n = q.size
    for i in range(n):
        back = q[i] - q[i - 1] if i > 0 else q[1] - q[0]
        ahead = q[i + 1] - q[i] if i < n - 1 else q[n - 1] - q[n - 2]
        half = 0.0
        if back * ahead > 0.0:
            half = math.copysign(min(abs(back), abs(ahead), 0.25 * abs(back + ahead)), back)
        most = floor_share * (1.0 + q[i])
        half = max(-most, min(most, half))
        left[i] = q[i] - half
        right[i] = q[i] + half


@compiled
def edge_exponent(f_left, f_right, dx, exponent):
    """∫_x^0 f dξ at the nodes by the trapezoidal rule in each cell."""
    n = f_left.size
    exponent[n] = 0.0
    for i in range(n - 1, -1, -1):
        exponent[i] = exponent[i + 1] + 0.5 * dx * (f_left[i] + f_right[i])


# Front tracking. I = W + R(q) is constant between fronts; there r = R(q) obeys (ln r)_x = -f and K/r is constant
# (theory, §5). A law enters as f over rho = ln r: a piecewise polynomial `table` (pieces, 8) on pieces of equal `width`
# from `start`, in the local variable of [-1, 1]. An empty table stands for the rational law, r = 1 + q.


@compiled
def front_f(rho, table, start, width):
    """f at rho."""
    s = (rho - start) / width
    piece = min(max(int(s), 0), table.shape[0] - 1)
    z = 2.0 * (s - piece) - 1.0
    value = table[piece, 7]
    for k in range(6, -1, -1):
        value = value * z + table[piece, k]
    return value


@compiled
def front_f_derivatives(rho, table, start, width):
    """f, df/drho and d²f/drho² at rho."""
    s = (rho - start) / width
    piece = min(max(int(s), 0), table.shape[0] - 1)
    z = 2.0 * (s - piece) - 1.0
    value, first, second = table[piece, 7], 0.0, 0.0
    for k in range(6, -1, -1):
        second = second * z + first
        first = first * z + value
        value = value * z + table[piece, k]
    return value, first * (2.0 / width), 2.0 * second * (2.0 / width) ** 2


@compiled
def front_flow(rho, h, near, table, start, width):
    """rho at a distance h (of either sign) to the right, where I is constant.

    Third-order Taylor for |h| <= near, else classical Runge-Kutta in steps of 1/200: 1e-11 a unit of length.
    """
    if abs(h) <= near:
        f, f1, f2 = front_f_derivatives(rho, table, start, width)
        return rho - h * f * (1.0 - 0.5 * h * (f1 - h / 3.0 * (f1 * f1 + f * f2)))
    steps = 1 + int(200.0 * abs(h))
    d = h / steps
    for _ in range(steps):
        k1 = front_f(rho, table, start, width)
        k2 = front_f(rho - 0.5 * d * k1, table, start, width)
        k3 = front_f(rho - 0.5 * d * k2, table, start, width)
        k4 = front_f(rho - d * k3, table, start, width)
        rho -= d / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return rho


@compiled
def front_decay(r, h, near, table, start, width):
    """r at a distance h (of either sign) to the right, where I is constant."""
    if table.shape[0] == 0:
        return 1.0 + (r - 1.0) * math.exp(-h)
    return math.exp(front_flow(math.log(r), h, near, table, start, width))


@compiled
def front_slope(r, table, start, width):
    """q and f at r."""
    if table.shape[0] == 0:
        return r - 1.0, 1.0 - 1.0 / r
    f = front_f(math.log(r), table, start, width)
    return f * r, f


@compiled
def front_top(x, n):
    """The front whose piece on the right holds x = 0."""
    top = n - 1
    while top > 0 and x[top] > 0.0:
        top -= 1
    return top


@compiled
def front_sweep(x, jump, n, top, r0, near, table, start, width, r_left, r_right, slope, K):
    """One-sided r, slope = [f]/[q] and K at the first n fronts: a sweep right for r, one left for K with K(0) = 1.

    `jump` holds the jumps of I, r0 = R(0) is r on the far left, x = 0 lies right of front `top`. Positions may be out
    of order: pieces of negative length continue the same formula.
    """
    if table.shape[0] == 0:
        q = r0 - 1.0
        for j in range(n):
            r_left[j] = 1.0 + q
            q += jump[j]
            r_right[j] = 1.0 + q
            slope[j] = 1.0 / (r_left[j] * r_right[j])
            if j < n - 1:
                q *= math.exp(x[j] - x[j + 1])
    else:
        rho, r = math.log(r0), r0
        for j in range(n):
            f_left = front_f(rho, table, start, width)
            r_left[j] = r
            r_right[j] = r + jump[j]
            rho_right = math.log(r_right[j])
            f, f1, f2 = front_f_derivatives(rho_right, table, start, width)
            if abs(rho_right - rho) > 1e-5:
                slope[j] = (f - f_left) / (f * r_right[j] - f_left * r)
            else:  # df/dq, in the middle to first order: error 1e-10
                middle = 0.5 * (rho_right - rho)
                slope[j] = (f1 - middle * f2) / ((f1 + f - middle * (f1 + f2)) * r_right[j] * (1.0 - middle))
            if j < n - 1:
                h = x[j + 1] - x[j]
                if abs(h) <= near:  # as in `front_flow`, whose derivatives of f are at hand
                    rho = rho_right - h * f * (1.0 - 0.5 * h * (f1 - h / 3.0 * (f1 * f1 + f * f2)))
                else:
                    rho = front_flow(rho_right, h, near, table, start, width)
                r = math.exp(rho)
    if n > 0:
        K[top] = r_right[top] / front_decay(r_right[top], -x[top], near, table, start, width)
    for j in range(top - 1, -1, -1):
        K[j] = K[j + 1] * r_right[j] / r_left[j + 1]
    for j in range(top + 1, n):
        K[j] = K[j - 1] * r_left[j] / r_right[j - 1]


@compiled
def front_speeds(x, jump, n, top, r0, near, table, start, width, r_left, r_right, K, speed):
    """x' = K [f]/[q] of the first n fronts."""
    front_sweep(x, jump, n, top, r0, near, table, start, width, r_left, r_right, speed, K)
    for j in range(n):
        speed[j] *= K[j]


@compiled
def front_meeting(xa, ra, xb, rb, jump, near, table, start, width):
    """Where the piece left of front a and the piece right of front b have the same W; `jump` is I_b - I_a between them.

    There a merged front keeps W continuous and the mass to its right unchanged.
    """
    if table.shape[0] == 0:
        # 1 + (rb-1) e^{-(x-xb)} - 1 - (ra-1) e^{-(x-xa)} = jump; distances from the middle
        m = 0.5 * (xa + xb)
        ratio = ((rb - 1.0) * math.exp(xb - m) - (ra - 1.0) * math.exp(xa - m)) / jump
        x = m + math.log(ratio) if ratio > 0.0 else m
    else:
        x = 0.5 * (xa + xb)
        for _ in range(4):
            r1 = front_decay(ra, x - xa, near, table, start, width)
            r2 = front_decay(rb, x - xb, near, table, start, width)
            dq = front_slope(r2, table, start, width)[0] - front_slope(r1, table, start, width)[0]
            if dq == 0.0:
                break
            x += (r2 - r1 - jump) / dq
    low, high = min(xa, xb), max(xa, xb)
    # a front whose net jump vanishes has no place of its own
    return min(max(x, low), high) if x == x else 0.5 * (low + high)


@compiled
def front_merge(
    x, jump, count, label, since, n, t, r_left, r_right, near, table, start, width, merged, head, log, logged
):
    """Merges fronts that are out of order, also several at once; returns how many are left and the events logged so far.

    `count` is how many fronts a front is made of, `since` when it first merged, `label` its number if it is a kink.
    `merged` (rows x, jump, count, label, since) and `head` are workspace; `log` takes rows (t, kink, into, x).
    """
    m = 0
    for j in range(n):
        xj, dj, cj, lj, sj, first = x[j], jump[j], count[j], label[j], since[j], j
        while m > 0 and merged[0, m - 1] > xj:
            m -= 1
            first = head[m]
            dj += merged[1, m]
            cj += merged[2, m]
            sj = min(sj, merged[4, m], t)
            xj = front_meeting(x[first], r_left[first], x[j], r_right[j], dj, near, table, start, width)
            other = int(merged[3, m])
            if other > 0 and lj > 0:
                if logged < log.shape[0]:
                    log[logged, 0], log[logged, 1], log[logged, 2], log[logged, 3] = (
                        t,
                        max(lj, other),
                        min(lj, other),
                        xj,
                    )
                    logged += 1
                lj = min(lj, other)
            else:
                lj = max(lj, other)
        merged[0, m], merged[1, m], merged[2, m], merged[3, m], merged[4, m] = xj, dj, cj, lj, sj
        head[m] = first
        m += 1
    if m < n:
        for j in range(m):
            x[j], jump[j], count[j] = merged[0, j], merged[1, j], int(merged[2, j])
            label[j], since[j] = int(merged[3, j]), merged[4, j]
            last = head[j + 1] - 1 if j + 1 < m else n - 1
            r_left[j], r_right[j] = r_left[head[j]], r_right[last]
    return m, logged


@compiled
def front_steps(x, jump, count, label, since, n, t, end, reach, r0, near, table, start, width, work, head, log, totals):
    """Classical Runge-Kutta steps to `end` for the first n fronts, merging after each step and dropping those at x > 0.

    A step takes the fastest front no further than `reach`. `totals` holds ∫(K_left - 1) dt, ∫F(0) dt, the number of
    steps and the highest label. Returns n and the number of rows in `log`: (t, kink, into, x), into = 0 a birth, -1 an
    exit.
    """
    logged = 0
    k1, k2, k3, k4, y, r_left, r_right, K = work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7]
    while t < end:
        if n == 0:
            break
        front_speeds(x, jump, n, front_top(x, n), r0, near, table, start, width, r_left, r_right, K, k1)
        fastest = 0.0
        for j in range(n):
            fastest = max(fastest, k1[j])
        dt = reach / fastest
        if dt >= end - t:
            dt = end - t
        elif 2.0 * dt > end - t:
            dt = 0.5 * (end - t)
        growth, outflow = K[0] - 1.0, front_outflow(x, front_top(x, n), r_right, near, table, start, width)
        for j in range(n):
            y[j] = x[j] + 0.5 * dt * k1[j]
        front_speeds(y, jump, n, front_top(y, n), r0, near, table, start, width, r_left, r_right, K, k2)
        growth += 2.0 * (K[0] - 1.0)
        outflow += 2.0 * front_outflow(y, front_top(y, n), r_right, near, table, start, width)
        for j in range(n):
            y[j] = x[j] + 0.5 * dt * k2[j]
        front_speeds(y, jump, n, front_top(y, n), r0, near, table, start, width, r_left, r_right, K, k3)
        growth += 2.0 * (K[0] - 1.0)
        outflow += 2.0 * front_outflow(y, front_top(y, n), r_right, near, table, start, width)
        for j in range(n):
            y[j] = x[j] + dt * k3[j]
        front_speeds(y, jump, n, front_top(y, n), r0, near, table, start, width, r_left, r_right, K, k4)
        growth += K[0] - 1.0
        outflow += front_outflow(y, front_top(y, n), r_right, near, table, start, width)
        for j in range(n):
            x[j] += dt / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j])
        totals[0] += dt / 6.0 * growth
        totals[1] += dt / 6.0 * outflow
        totals[2] += 1.0
        t = end if dt == end - t else t + dt
        front_sweep(x, jump, n, front_top(x, n), r0, near, table, start, width, r_left, r_right, k1, K)
        n, logged = front_merge(
            x, jump, count, label, since, n, t, r_left, r_right, near, table, start, width, work, head, log, logged
        )
        n, logged = front_events(x, jump, count, label, since, n, t, log, logged, totals)
    return n, logged


@compiled
def front_outflow(x, top, r_right, near, table, start, width):
    """F = f(q) at x = 0, right of front `top`."""
    return front_slope(front_decay(r_right[top], -x[top], near, table, start, width), table, start, width)[1]


BIRTH = 4  # small fronts that a kink is made of: a smooth slope's fronts do not meet


@compiled
def front_events(x, jump, count, label, since, n, t, log, logged, totals):
    """Numbers the kinks that were born, drops the fronts that left; returns how many fronts and events there are."""
    for j in range(n):
        if label[j] == 0 and count[j] >= BIRTH and jump[j] > 0.0:
            totals[3] += 1.0
            label[j] = int(totals[3])
            if logged < log.shape[0]:
                log[logged, 0], log[logged, 1], log[logged, 2], log[logged, 3] = since[j], label[j], 0.0, x[j]
                logged += 1
    while n > 0 and x[n - 1] >= 0.0:
        n -= 1
        if label[n] > 0 and logged < log.shape[0]:
            log[logged, 0], log[logged, 1], log[logged, 2], log[logged, 3] = t, label[n], -1.0, 0.0
            logged += 1
    return n, logged


@compiled
def front_read(
    x, jump, label, smooth, n, r0, near, table, start, width, r_left, r_right, slope, K, nodes, W_out, K_out
):
    """W and K at `nodes` (increasing). Sweeps first.

    Between two fronts of a `smooth` stretch: cubic Hermite of W and ln K with the means of the one-sided q and f as
    slopes (second order; the pieces themselves would make q first order). Beside a kink its own one-sided values;
    elsewhere the piece, which is exact.
    """
    front_sweep(x, jump, n, n - 1, r0, near, table, start, width, r_left, r_right, slope, K)
    W = 0.0  # at front j
    I = r0  # right of front j
    j = -1
    for i in range(nodes.size):
        while j + 1 < n and x[j + 1] <= nodes[i]:
            j += 1
            W = I - r_left[j]
            I += jump[j]
        if j < 0:
            W_out[i], K_out[i] = 0.0, K[0] if n > 0 else 1.0
            continue
        if j + 1 < n and smooth[j] and x[j + 1] > x[j]:
            h = x[j + 1] - x[j]
            qa, fa = front_slope(r_right[j], table, start, width)
            qb, fb = front_slope(r_left[j + 1], table, start, width)
            W1 = I - r_left[j + 1]
            if label[j] == 0:
                q, f = front_slope(r_left[j], table, start, width)
                qa, fa = 0.5 * (qa + q), 0.5 * (fa + f)
            if label[j + 1] == 0:
                q, f = front_slope(r_right[j + 1], table, start, width)
                qb, fb = 0.5 * (qb + q), 0.5 * (fb + f)
            s = (nodes[i] - x[j]) / h
            value, slope_a, slope_b = s * s * (3.0 - 2.0 * s), h * s * (1.0 - s) ** 2, h * s * s * (s - 1.0)
            W_out[i] = W + (W1 - W) * value + slope_a * qa + slope_b * qb
            exponent = math.log(K[j + 1] / K[j]) * value - slope_a * fa - slope_b * fb
            K_out[i] = K[j] * math.exp(exponent)
        else:
            r = front_decay(r_right[j], nodes[i] - x[j], near, table, start, width)
            W_out[i], K_out[i] = I - r, K[j] * r / r_right[j]


@compiled
def front_volume(x, jump, n, left, r0, near, table, start, width, r_right):
    """∫W dx from `left` to 0, by five-point Gauss-Legendre on every piece (in parts of at most 1/4)."""
    if n == 0:
        return 0.0
    z = (-0.906179845938664, -0.5384693101056831, 0.0, 0.5384693101056831, 0.906179845938664)
    w = (0.23692688505618908, 0.47862867049936647, 0.5688888888888889, 0.47862867049936647, 0.23692688505618908)
    total, I = 0.0, r0
    for j in range(n):
        I += jump[j]
        h = (x[j + 1] if j + 1 < n else 0.0) - x[j]
        parts = 1 + int(4.0 * abs(h))
        d, r = h / parts, r_right[j]
        for _ in range(parts):
            for k in range(5):
                s = 0.5 * d * (1.0 + z[k])
                total += 0.5 * d * w[k] * (I - front_decay(r, s, near, table, start, width))
            r = front_decay(r, d, near, table, start, width)
    return total


@compiled
def front_rate(y, jump, n, r0, table, start, width, work, rate):
    """Speeds of n fronts, then K_left - 1 and F(0): the state y is their places and the integrals of these two.

    The last piece is continued to x = 0 even where a trial step takes the last front beyond: so the rate is smooth.
    """
    front_speeds(y, jump, n, n - 1, r0, 0.0, table, start, width, work[0], work[1], work[2], rate)
    rate[n] = work[2, 0] - 1.0
    rate[n + 1] = front_outflow(y, n - 1, work[1], 0.0, table, start, width)


@compiled
def front_gap(y, n):
    """The least distance of two neighbours or of the last front from x = 0; negative where an event has passed."""
    gap = -y[n - 1]
    for j in range(n - 1):
        gap = min(gap, y[j + 1] - y[j])
    return gap


@compiled
def front_dop853(y, rates, dt, jump, n, r0, table, start, width, A, B, work, stage, out):
    """One step of Dormand and Prince's method of order 8; rates[0] is the rate at y."""
    m = n + 2
    for s in range(1, 12):
        for i in range(m):
            slope = 0.0
            for k in range(s):
                slope += A[s, k] * rates[k, i]
            stage[i] = y[i] + dt * slope
        front_rate(stage, jump, n, r0, table, start, width, work, rates[s])
    for i in range(m):
        slope = 0.0
        for k in range(12):
            slope += B[k] * rates[k, i]
        out[i] = y[i] + dt * slope


@compiled
def front_exact(
    x, jump, count, label, since, n, t, end, r0, table, start, width, A, B, E3, E5, tolerance, work, head, log, totals
):
    """As `front_steps`, but to `tolerance`: adaptive steps of order 8, and each merge and exit found in its own time.

    The root of an event is found on the fraction of the step; every evaluation is a step, so an event has full order.
    """
    logged = 0
    rates, y, stage, new = np.empty((13, n + 2)), np.empty(n + 2), np.empty(n + 2), np.empty(n + 2)
    dt = 0.01 * (end - t)
    while t < end and n > 0:
        m = n + 2
        for j in range(n):
            y[j] = x[j]
        y[n], y[n + 1] = totals[0], totals[1]
        front_rate(y, jump, n, r0, table, start, width, work, rates[0])
        dt = min(dt, end - t)
        while True:
            front_dop853(y, rates, dt, jump, n, r0, table, start, width, A, B, work, stage, new)
            front_rate(new, jump, n, r0, table, start, width, work, rates[12])
            fifth = third = 0.0
            for i in range(m):
                e5 = e3 = 0.0
                for k in range(13):
                    e5 += E5[k] * rates[k, i]
                    e3 += E3[k] * rates[k, i]
                fifth, third = max(fifth, abs(e5)), max(third, abs(e3))
            error = dt * fifth * fifth / math.sqrt(fifth * fifth + 0.01 * third * third + 1e-300) / tolerance
            if dt < 1e-14 * end:
                break
            if error > 1.0:
                dt *= max(0.2, 0.9 * error**-0.125)
            elif front_gap(new, n) < 0.0 and front_gap(y, n) <= 0.0:
                dt *= 0.1  # a fan has yet to open: no bracket for the event
            else:
                break
        used = dt
        passed = front_gap(new, n) < 0.0
        if passed:  # Illinois' rule of false position between the fractions `low` and `high` of the step
            low, high, side = 0.0, 1.0, 0
            g_low, g_high = max(front_gap(y, n), 0.0), front_gap(new, n)
            for _ in range(100):
                if high - low <= 1e-15 or g_low <= 0.0:
                    break
                theta = low + (high - low) * g_low / (g_low - g_high)
                front_dop853(y, rates, theta * dt, jump, n, r0, table, start, width, A, B, work, stage, new)
                g = front_gap(new, n)
                if abs(g) < 1e-15:
                    high = theta
                    break
                if g > 0.0:
                    low, g_low = theta, g
                    if side == 1:
                        g_high *= 0.5
                    side = 1
                else:
                    high, g_high = theta, g
                    if side == -1:
                        g_low *= 0.5
                    side = -1
            used = high * dt
            front_dop853(y, rates, used, jump, n, r0, table, start, width, A, B, work, stage, new)
        t = end if used == end - t else t + used
        for j in range(n):
            x[j] = new[j]
        totals[0], totals[1], totals[2] = new[n], new[n + 1], totals[2] + 1.0
        if passed:
            front_rate(new, jump, n, r0, table, start, width, work, rates[12])
            for j in range(n - 1):  # those that met, to the accuracy of the root; a fan that has yet to open has not
                if x[j + 1] - x[j] < 1e-13 and rates[12, j] > rates[12, j + 1]:
                    x[j] = x[j + 1] + 1e-15
            if x[n - 1] > -1e-14:
                x[n - 1] = 0.0
            front_sweep(x, jump, n, n - 1, r0, 0.0, table, start, width, work[0], work[1], work[3], work[2])
            n, logged = front_merge(
                x,
                jump,
                count,
                label,
                since,
                n,
                t,
                work[0],
                work[1],
                0.0,
                table,
                start,
                width,
                work[3:],
                head,
                log,
                logged,
            )
            n, logged = front_events(x, jump, count, label, since, n, t, log, logged, totals)
        if error > 0.0:
            dt *= min(2.0, 0.9 * error**-0.125)
        else:
            dt *= 2.0
    return n, logged
