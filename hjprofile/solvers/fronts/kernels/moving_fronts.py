"""Loops of front tracking.

I = W + R(q) is constant between fronts; there r = R(q) decays as in `kernels.law` and K/r is constant (theory, §5).
Stretches over which a tabulated law hardly changes, h (1 + |f|) <= `near`, are crossed by a Taylor series.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.law import law_decay, law_derivatives, law_f, law_flow, law_q_f

STEP_FLOOR = 1e-7  # of the way to a saved time: more steps than it allows, of 0.3 ms each, would take an hour, ...
REJECTED = 1.2  # times the allowed error, from which on a step is repeated: 4 let a narrow feature's exit pass
LONGER = 2.0  # times the step before, at most
CROSSED = 0.35  # times the estimate by fronts that have crossed: measured, it is too large
WIDE = 64.0  # times the area of a piece, up to which W between two fronts is read by a cubic
MOST_FOLDS = 2.0  # lengths 1/|f|, over which K changes by a factor e, that a front crosses in a step
PATIENCE = 10_000  # ... but the first ones can be much shorter than those after them
STILL = 4e-16  # relative change of r over a part of a piece, where q has decayed to nothing


@compiled
def top_front(x, n):
    """The front whose piece on the right holds x = 0."""
    top = n - 1
    while top > 0 and x[top] > 0.0:
        top -= 1
    return top


@compiled
def sweep(x, jump, n, top, r0, near, law, r_left, r_right, slope, K):
    """One-sided r, slope = [f]/[q] and K at the first n fronts: a sweep right for r, one left for K with K(0) = 1.

    `jump` holds the jumps of I, r0 = R(0) is r on the far left, x = 0 lies right of front `top`. Positions may be out
    of order: pieces of negative length continue the same formula.
    """
    if law.f.shape[0] == 0:
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
                if abs(h) * (1.0 + abs(f)) <= near:
                    rho = rho_right - h * f * (1.0 - 0.5 * h * (f1 - h / 3.0 * (f1 * f1 + f * f2)))
                else:
                    rho = law_flow(rho_right, h, law)
                r = math.exp(rho)
    if n > 0:
        K[top] = r_right[top] / law_decay(r_right[top], -x[top], law)
    for j in range(top - 1, -1, -1):
        K[j] = K[j + 1] * r_right[j] / r_left[j + 1]
    for j in range(top + 1, n):
        K[j] = K[j - 1] * r_left[j] / r_right[j - 1]


@compiled
def speeds(x, jump, n, top, r0, near, law, r_left, r_right, K, speed):
    """x' = K [f]/[q] of the first n fronts."""
    sweep(x, jump, n, top, r0, near, law, r_left, r_right, speed, K)
    for j in range(n):
        speed[j] *= K[j]


@compiled
def meeting(xa, ra, xb, rb, jump, span, law):
    """Where the piece left of front a and the piece right of front b have the same W; `jump` is I_b - I_a between them.

    There a merged front keeps W continuous and the mass to its right unchanged. `span` is the extent of all that merge.
    """
    if law.f.shape[0] == 0:
        # 1 + (rb-1) e^{-(x-xb)} - 1 - (ra-1) e^{-(x-xa)} = jump; distances from the middle
        m = 0.5 * (xa + xb)
        ratio = ((rb - 1.0) * math.exp(xb - m) - (ra - 1.0) * math.exp(xa - m)) / jump
        x = m + math.log(ratio) if ratio > 0.0 else m
    else:
        x = 0.5 * (xa + xb)
        for _ in range(4):
            r1 = law_decay(ra, x - xa, law)
            r2 = law_decay(rb, x - xb, law)
            dq = law_q_f(r2, law)[0] - law_q_f(r1, law)[0]
            if dq == 0.0:
                break
            dx = (r2 - r1 - jump) / dq
            x += dx
            if abs(dx) < 1e-15:
                break
    # Between xa and xb if both fronts jump the same way, outside if they do not; a front whose net jump vanishes has no
    # place of its own.
    m, most = 0.5 * (xa + xb), 20.0 * span
    return min(max(x, m - most), m + most) if x == x else m


@compiled
def note(log, logged, t, kink, into, x):
    """Adds a row to the log if there is room."""
    if logged < log.shape[0]:
        log[logged, 0], log[logged, 1], log[logged, 2], log[logged, 3] = t, kink, into, x
        return logged + 1
    return logged


@compiled
def merge(x, jump, label, since, smooth, speed, n, t, r_left, r_right, law, merged, head, log, logged):
    """Merges fronts that are out of order, also several at once; returns how many are left and the events logged.

    `since` is when a front first merged, `label` its number if it is a kink. `merged` (rows x, jump, label, since,
    speed) and `head` are workspace; `log` takes rows (t, kink, into, x), t being when two kinks met within the step.
    """
    m = 0
    for j in range(n):
        xj, dj, lj, sj, vj, first = x[j], jump[j], label[j], since[j], speed[j], j
        while m > 0 and merged[0, m - 1] > xj:
            m -= 1
            first = head[m]
            other, closing, overlap = int(merged[2, m]), merged[4, m] - vj, merged[0, m] - xj
            dj += merged[1, m]
            sj = min(sj, merged[3, m], t)
            left = right = x[j]
            for i in range(first, j):
                left, right = min(left, x[i]), max(right, x[i])
            xj = meeting(x[first], r_left[first], x[j], r_right[j], dj, right - left, law)
            if other > 0 and lj > 0:
                ago = overlap / closing if closing > 0.0 else 0.0
                logged = note(log, logged, t - ago, max(lj, other), min(lj, other), xj - ago * vj)
                lj = min(lj, other)
            elif other > 0:
                lj, vj = other, merged[4, m]
        merged[0, m], merged[1, m], merged[2, m], merged[3, m], merged[4, m] = xj, dj, lj, sj, vj
        head[m] = first
        m += 1
    if m < n:
        for j in range(m):
            last = head[j + 1] - 1 if j + 1 < m else n - 1
            x[j], jump[j], label[j], since[j] = merged[0, j], merged[1, j], int(merged[2, j]), merged[3, j]
            speed[j], smooth[j], r_left[j], r_right[j] = merged[4, j], smooth[last], r_left[head[j]], r_right[last]
    return m, logged


@compiled
def note_events(x, jump, label, since, strong, speed, n, t, log, logged, totals):
    """Numbers the kinks that were born, drops the fronts that left; returns how many fronts and events there are.

    A front that has merged is a kink once its jump is above `strong`; it was born when it first merged.
    """
    for j in range(n):
        if label[j] == 0 and since[j] <= t and jump[j] > strong:
            totals[3] += 1.0
            label[j] = int(totals[3])
            logged = note(log, logged, since[j], totals[3], 0.0, x[j] - (t - since[j]) * speed[j])
    while n > 0 and x[n - 1] >= 0.0:
        n -= 1
        if label[n] > 0:
            logged = note(log, logged, t - x[n] / speed[n], label[n], -1.0, 0.0)
    return n, logged


class Control(NamedTuple):
    """Control of the time step.

    Attributes:
        allowed: error of W that a unit of time may add, by the motion between events and by fronts that merge late.
        longest: longest step.
        saved: longest time for which unused error is kept for later steps.
        step: the next step and the time for which error is kept, shape (2,).
    """

    allowed: float
    longest: float
    saved: float
    step: np.ndarray


@compiled
def advance(x, jump, label, since, smooth, n, t, end, control, r0, near, law, strong, work, head, log, totals):
    """Classical Runge-Kutta steps to `end` for the first n fronts, merging after each step and dropping those at x > 0.

    Steps are as long as `control` allows: their error is `motion_error` and, of fronts that have crossed,
    `crossing_error`. `totals` holds ∫(K_left - 1) dt, ∫F(0) dt, the number of steps and the highest label. Returns n
    and the number of rows in `log`: (t, kink, into, x), into = 0 a birth, -1 an exit; -1 rows where PATIENCE steps fall
    below STEP_FLOOR of the way to `end`.
    """
    logged = 0
    floor, short = STEP_FLOOR * (end - t), 0
    k, y, new, r_left, r_right, K, eroded = work[:5], work[5], work[6], work[7], work[8], work[9], work[15]
    fresh = False  # k[0] and the sweep are those of x
    while t < end and n > 0:
        if not fresh:
            speeds(x, jump, n, top_front(x, n), r0, near, law, r_left, r_right, K, k[0])
        growth0, outflow0 = K[0] - 1.0, outflow_at(x, top_front(x, n), r_right, law)
        folds = most_eroded = 0.0
        for j in range(n):
            f = abs(law_q_f(r_right[j], law)[1])
            eroded[j] = most_eroded
            folds, most_eroded = max(folds, k[0, j] * f), max(most_eroded, K[j] * f)
        control.step[0] = min(control.step[0], MOST_FOLDS / folds) if folds > 0.0 else control.step[0]
        while True:
            dt = control.step[0]
            if not dt > floor:  # K is without bound below a slope with q near -1
                short += 1
                if short > PATIENCE or not dt > 0.0:
                    return n, -1
            if dt >= end - t:
                dt = end - t
            elif 2.0 * dt > end - t:
                dt = 0.5 * (end - t)
            growth, outflow = growth0, outflow0
            for stage in range(1, 4):
                part = dt if stage == 3 else 0.5 * dt
                for j in range(n):
                    y[j] = x[j] + part * k[stage - 1, j]
                speeds(y, jump, n, top_front(y, n), r0, near, law, r_left, r_right, K, k[stage])
                weight = 1.0 if stage == 3 else 2.0
                growth += weight * (K[0] - 1.0)
                outflow += weight * outflow_at(y, top_front(y, n), r_right, law)
            for j in range(n):
                new[j] = x[j] + dt / 6.0 * (k[0, j] + 2.0 * (k[1, j] + k[2, j]) + k[3, j])
            speeds(new, jump, n, top_front(new, n), r0, near, law, r_left, r_right, K, k[4])
            error = motion_error(jump, n, k[3], k[4]) * dt / 6.0
            error += crossing_error(new, jump, n, r_left, r_right, K, eroded, law) * CROSSED / r0**2 * dt
            error += exit_error(x, new, k[0], n, r_left, r_right, law) * most_eroded * r0 * dt * dt
            ratio = error / (control.allowed * (dt + control.step[1]))
            if ratio <= REJECTED:
                saved = control.step[1] + dt - error / control.allowed
                control.step[1] = min(max(saved, 0.0), control.saved)
                factor = min(LONGER, 0.9 / math.sqrt(ratio)) if ratio > 0.0 else LONGER
                if dt == control.step[0] or factor < 1.0:
                    control.step[0] = min(max(factor, 0.2) * dt, control.longest)
                break
            control.step[0] = dt * max(0.2, 0.9 / math.sqrt(ratio)) if ratio == ratio else 0.1 * dt
        for j in range(n):
            x[j], k[0, j] = new[j], k[4, j]
        totals[0] += dt / 6.0 * growth
        totals[1] += dt / 6.0 * outflow
        totals[2] += 1.0
        t = end if dt == end - t else t + dt
        before = n
        n, logged = merge(
            x, jump, label, since, smooth, k[0], n, t, r_left, r_right, law, work[10:15], head, log, logged
        )
        fresh = n == before
        n, logged = note_events(x, jump, label, since, strong, k[0], n, t, log, logged, totals)
    return n, logged


@compiled
def motion_error(jump, n, last, after):
    """Six times the error of W, per unit of time, of a Runge-Kutta step: the largest sum of jump times displacement.

    With the speeds after the step in the place of those of its last stage it is of third order.
    """
    total = largest = 0.0
    for j in range(n):
        total += jump[j] * (last[j] - after[j])
        if not abs(total) <= largest:
            largest = abs(total)
    return largest


@compiled
def exit_error(x, new, speed, n, r_left, r_right, law):
    """The error of ln K, by the largest of the fronts that leave within a step, divided by the square of the step.

    ∂_t ln K jumps by the front's speed times its jump of f, at a time that the stages of the step do not see.
    """
    largest = 0.0
    j = n - 1
    while j >= 0 and new[j] > 0.0:
        change = abs(law_q_f(r_right[j], law)[1] - law_q_f(r_left[j], law)[1])
        largest = max(largest, change * speed[j] / 12.0)
        j -= 1
    return largest


@compiled
def crossing_error(x, jump, n, r_left, r_right, K, eroded, law):
    """The error of W, per unit of time, by fronts that have crossed and are not merged yet.

    Two that overlap by a length d change ln K on their left by their jumps' product times d, and are displaced by as
    much times K f between them. `eroded` holds the largest K |f| left of each front.
    """
    total = 0.0
    far, strength, beyond = x[0], abs(jump[0]), eroded[0]
    for j in range(1, n):
        if x[j] < far:
            flux = max(beyond, K[j] * abs(law_q_f(r_left[j], law)[1]))
            total += strength * abs(jump[j]) * (far - x[j]) * flux
            strength += abs(jump[j])
        else:
            far, strength, beyond = x[j], abs(jump[j]), eroded[j]
    far, strength = x[n - 1], abs(jump[n - 1])
    for j in range(n - 2, -1, -1):
        if x[j] > far:
            flux = max(eroded[j], K[j] * abs(law_q_f(r_right[j], law)[1]))
            total += strength * abs(jump[j]) * (x[j] - far) * flux
            strength += abs(jump[j])
        else:
            far, strength = x[j], abs(jump[j])
    return total


@compiled
def outflow_at(x, top, r_right, law):
    """F = f(q) at x = 0, right of front `top`."""
    return law_q_f(law_decay(r_right[top], -x[top], law), law)[1]


@compiled
def read(x, jump, label, smooth, n, area, r0, near, law, r_left, r_right, slope, K, nodes, W_out, K_out):
    """W and K at `nodes` (increasing). Sweeps first.

    Between two fronts of a `smooth` stretch: cubic Hermite of W and ln K with the means of the one-sided q and f as
    slopes (second order; the pieces themselves would make q first order). Beside a kink its own one-sided values;
    elsewhere the piece, which is exact, and so where the fronts are too far apart for the cubic: where it would leave
    the range of q, or where a jump times the distance is more than WIDE times `area`.
    """
    sweep(x, jump, n, n - 1, r0, near, law, r_left, r_right, slope, K)
    W = 0.0  # at front j
    I = r0  # right of front j
    j = -1
    at, r = 0.0, r0
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


@compiled
def cubic_turn(a, mean, b):
    """The extreme slope inside a cubic with slopes a and b at its ends and the given mean slope; a if there is none."""
    linear, square = 2.0 * (3.0 * mean - 2.0 * a - b), 3.0 * (a + b - 2.0 * mean)
    if square == 0.0 or not 0.0 < -linear / (2.0 * square) < 1.0:
        return a
    return a - linear * linear / (4.0 * square)


@compiled
def volume(x, jump, n, law, r0, r_right):
    """∫W dx, by five-point Gauss-Legendre on parts of every piece over which W hardly changes, as far as it changes."""
    if n == 0:
        return 0.0
    z = (-0.906179845938664, -0.5384693101056831, 0.0, 0.5384693101056831, 0.906179845938664)
    w = (0.23692688505618908, 0.47862867049936647, 0.5688888888888889, 0.47862867049936647, 0.23692688505618908)
    total, I = 0.0, r0
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
