"""Front tracking to rounding: adaptive steps of order 8, each merge and exit found in its own time.

The conventions are those of `kernels.fronts`.
"""

import math

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.fronts import merge, note_events, outflow_at, speeds, sweep


@compiled
def rates_of(y, jump, n, r0, table, start, width, work, rate):
    """Speeds of n fronts, then K_left - 1 and F(0): the state y is their places and the integrals of these two.

    The last piece is continued to x = 0 even where a trial step takes the last front beyond: so the rate is smooth.
    """
    speeds(y, jump, n, n - 1, r0, 0.0, table, start, width, work[0], work[1], work[2], rate)
    rate[n] = work[2, 0] - 1.0
    rate[n + 1] = outflow_at(y, n - 1, work[1], 0.0, table, start, width)


@compiled
def least_gap(y, n):
    """The least distance of two neighbours or of the last front from x = 0; negative where an event has passed."""
    gap = -y[n - 1]
    for j in range(n - 1):
        gap = min(gap, y[j + 1] - y[j])
    return gap


@compiled
def dop853_step(y, rates, dt, jump, n, r0, table, start, width, A, B, work, stage, out):
    """One step of Dormand and Prince's method of order 8; rates[0] is the rate at y."""
    m = n + 2
    for s in range(1, 12):
        for i in range(m):
            slope = 0.0
            for k in range(s):
                slope += A[s, k] * rates[k, i]
            stage[i] = y[i] + dt * slope
        rates_of(stage, jump, n, r0, table, start, width, work, rates[s])
    for i in range(m):
        slope = 0.0
        for k in range(12):
            slope += B[k] * rates[k, i]
        out[i] = y[i] + dt * slope


@compiled
def advance_exactly(
    x, jump, label, since, smooth, n, t, end, r0, table, start, width,
    A, B, E3, E5, tolerance, strong, work, head, log, totals,
):  # fmt: skip
    """As `advance`, but to `tolerance`: adaptive steps of order 8, and each merge and exit found in its own time.

    The root of an event is found on the fraction of the step; every evaluation is a step, so an event has full order.
    Where a thousand steps in a row bring nothing, the first jump is set to NaN, which the reader of the fronts sees.
    """
    logged = stalled = 0
    rates, y, stage, new = np.empty((13, n + 2)), np.empty(n + 2), np.empty(n + 2), np.empty(n + 2)
    dt = 0.01 * (end - t)
    while t < end and n > 0:
        m = n + 2
        for j in range(n):
            y[j] = x[j]
        y[n], y[n + 1] = totals[0], totals[1]
        rates_of(y, jump, n, r0, table, start, width, work, rates[0])
        dt = min(dt, end - t)
        while True:
            dop853_step(y, rates, dt, jump, n, r0, table, start, width, A, B, work, stage, new)
            rates_of(new, jump, n, r0, table, start, width, work, rates[12])
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
            elif least_gap(new, n) < 0.0 and least_gap(y, n) <= 0.0:
                dt *= 0.1  # a fan has yet to open: no bracket for the event
            else:
                break
        used = dt
        passed = least_gap(new, n) < 0.0
        if passed:  # Illinois' rule of false position between the fractions `low` and `high` of the step
            low, high, side = 0.0, 1.0, 0
            g_low, g_high = max(least_gap(y, n), 0.0), least_gap(new, n)
            for _ in range(100):
                if high - low <= 1e-15 or g_low <= 0.0:
                    break
                theta = low + (high - low) * g_low / (g_low - g_high)
                dop853_step(y, rates, theta * dt, jump, n, r0, table, start, width, A, B, work, stage, new)
                g = least_gap(new, n)
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
            dop853_step(y, rates, used, jump, n, r0, table, start, width, A, B, work, stage, new)
        stalled = stalled + 1 if used < 1e-13 * end else 0
        if stalled > 1000:
            jump[0] = math.nan
            break
        t = end if used == end - t else t + used
        for j in range(n):
            x[j] = new[j]
        totals[0], totals[1], totals[2] = new[n], new[n + 1], totals[2] + 1.0
        if passed:
            rates_of(new, jump, n, r0, table, start, width, work, rates[12])
            met, least = n - 1, -new[n - 1]  # the event itself: the last front leaves, or two meet
            for j in range(n - 1):
                if new[j + 1] - new[j] < least:
                    met, least = j, new[j + 1] - new[j]
            for j in range(n - 1):  # with it, whoever meets at the same moment; a fan that has yet to open does not
                if j == met or (x[j + 1] - x[j] < 1e-13 and rates[12, j] > rates[12, j + 1]):
                    x[j] = x[j + 1] + 4e-15 * max(1.0, abs(x[j + 1]))
            if met == n - 1:
                x[n - 1] = 0.0
            sweep(x, jump, n, n - 1, r0, 0.0, table, start, width, work[0], work[1], work[3], work[2])
            n, logged = merge(
                x, jump, label, since, smooth, rates[12], n, t, work[0], work[1], 0.0, table, start, width,
                work[3:], head, log, logged,
            )  # fmt: skip
            n, logged = note_events(x, jump, label, since, strong, rates[12], n, t, log, logged, totals)
        if error > 0.0:
            dt *= min(2.0, 0.9 * error**-0.125)
        else:
            dt *= 2.0
    return n, logged
