"""Front tracking to rounding: adaptive steps of order 8, each merge and exit found in its own time.

The conventions are those of `front_state`.
"""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.fronts.kernels.front_merging import merge, note_events
from hjprofile.solvers.fronts.kernels.front_state import crest_flux, speeds, sweep
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.dormand_prince import STAGES, Tableau, state_at, step_error
from hjprofile.solvers.kernels.journal import CREST_LOWERING, GROWTH, STEPS

TOGETHER = 1e-13  # fronts no further apart are at one place
AT_END = 1e-11  # ... and at the end of an integration, where rounding can put an event just behind it
ALIKE = 1e-10  # relative difference of speeds below which fronts at one place stay there
IDLE = 1000  # steps in a row that bring nothing before the integration gives up


class ExactControl(NamedTuple):
    """Control of the integration.

    Attributes:
        strong: jump above which a front that has merged is a kink.
        tolerance: largest error of one step.
        tableau: the coefficients of a step.
    """

    strong: float
    tolerance: float
    tableau: Tableau


@compiled
def rates_of(y, jump, n, medium, sides, rate):
    """Speeds of n fronts, then K_left - 1 and F(0): the state y is their places and the integrals of these two.

    The last piece is continued to x = 0 even where a trial step takes the last front beyond: so the rate is smooth.
    """
    speeds(y, jump, n, n - 1, medium, sides, rate)
    rate[n] = sides.K[0] - 1.0
    rate[n + 1] = crest_flux(y, n - 1, sides.r_right, medium.law)


@compiled
def step(y, rates, dt, jump, n, medium, sides, tableau, new):
    """Fills `new` by one step from y, of which rates[0] is the rate."""
    for stage in range(1, STAGES):
        state_at(stage, y, dt, rates, tableau, new)
        rates_of(new, jump, n, medium, sides, rates[stage])
    state_at(STAGES, y, dt, rates, tableau, new)


@compiled
def least_gap(y, before, n):
    """The least distance of two neighbours or of the last front from x = 0, and where (n - 1: at x = 0).

    Negative where an event has passed. Neighbours that were together `before` are fans that open: no event.
    """
    least, at = -y[n - 1], n - 1
    for j in range(n - 1):
        if before[j + 1] - before[j] > TOGETHER and y[j + 1] - y[j] < least:
            least, at = y[j + 1] - y[j], j
    return least, at


@compiled
def fan_fails_to_open(y, before, n):
    """Whether neighbours that were together have changed places."""
    return np.any((np.diff(before[:n]) <= TOGETHER) & (np.diff(y[:n]) < -0.1 * TOGETHER))


@compiled
def first_crossing(y, new, rates, dt, n):
    """The fraction of a step at which, by cubic interpolation, the first event falls; `rates` are those at its ends."""
    first = 1.0
    for j in range(n):
        if j < n - 1:
            a, b = y[j + 1] - y[j], new[j + 1] - new[j]
            da, db = dt * (rates[0, j + 1] - rates[0, j]), dt * (rates[12, j + 1] - rates[12, j])
            if a <= TOGETHER:
                continue
        else:
            a, b, da, db = -y[j], -new[j], -dt * rates[0, j], -dt * rates[12, j]
        if b < 0.0:
            low, high = 0.0, first
            for _ in range(30):
                s = 0.5 * (low + high)
                gap = a + s * (da + s * (3.0 * (b - a) - 2.0 * da - db + s * (2.0 * (a - b) + da + db)))
                if gap > 0.0:
                    low = s
                else:
                    high = s
            first = high
    return first


@compiled
def narrowed(low, g_low, high, g_high, side, theta, gap):
    """Replace the end of a bracket on whose side `gap`, the value at theta, lies; `side` is the end replaced last.

    The value at the other end is halved where that end stays for a second time (Illinois' rule).
    """
    if gap > 0.0:
        return theta, gap, high, 0.5 * g_high if side == 1 else g_high, 1
    return low, 0.5 * g_low if side == -1 else g_low, theta, gap, -1


@compiled
def first_event(y, rates, dt, jump, n, medium, sides, tableau, new):
    """From `new`, a step beyond an event, back to the first one: how long a step that takes, and which pair has met.

    By Illinois' rule of false position on the fraction of the step.
    """
    low, high, side = 0.0, 1.0, 0
    g_low, g_high = least_gap(y, y, n)[0], least_gap(new, y, n)[0]
    theta, used, met = first_crossing(y, new, rates, dt, n), dt, -1
    for _ in range(60):
        used = theta * dt
        step(y, rates, used, jump, n, medium, sides, tableau, new)
        gap, met = least_gap(new, y, n)
        if abs(gap) <= 2e-15 * max(1.0, abs(new[met])) or high - low <= 2e-16:
            break
        low, g_low, high, g_high, side = narrowed(low, g_low, high, g_high, side, theta, gap)
        theta = low + (high - low) * g_low / (g_low - g_high)
    if met == n - 1:
        new[n - 1] = 0.0
    return used, met


@compiled
def advance_exactly(fronts, n, t, end, control, medium, work, journal):
    """As `moving_fronts.advance`, by adaptive steps of order 8, and each merge and exit found in its own time.

    The root of an event is found on the fraction of the step; every evaluation is a step, so an event has full order.
    Return n and whether `end` is reached: not where many steps in a row bring nothing.
    """
    x, jump, sides, rates, totals = fronts.x, fronts.jump, work.sides, work.rate, journal.totals
    tableau, stalled = control.tableau, 0
    dt = 0.01 * (end - t)
    met = -1  # the pair (met, met + 1) of an event
    while n > 0:
        # fronts at one place that do not part are one front: after an event, and in the data
        rates_of(x, jump, n, medium, sides, rates[0])
        if put_together(x, rates[0], n, met, TOGETHER if t < end else AT_END, t >= end):
            sweep(x, jump, n, n - 1, medium, sides)
            n = merge(fronts, n, t, medium.law, sides, rates[0], work.stack, journal)
            n = note_events(fronts, n, t, control.strong, rates[0], journal)
            met = -1
            continue
        if t >= end:
            break

        y, new = work.trial[: n + 2], work.new[: n + 2]
        y[:n] = x[:n]
        y[n], y[n + 1] = totals[GROWTH], totals[CREST_LOWERING]
        dt = min(dt, end - t)
        while True:
            step(y, rates, dt, jump, n, medium, sides, tableau, new)
            rates_of(new, jump, n, medium, sides, rates[STAGES])
            error = step_error(dt, rates, tableau, new, n) / control.tolerance
            if dt < 1e-14 * end:
                break
            if not error <= 1.0:
                dt *= max(0.2, 0.9 * error**-0.125) if error == error else 0.1
            elif fan_fails_to_open(new, y, n):
                dt *= 0.5
            else:
                break
        used = dt
        if least_gap(new, y, n)[0] < 0.0:
            used, met = first_event(y, rates, dt, jump, n, medium, sides, tableau, new)
        stalled = stalled + 1 if used < 1e-13 * end else 0
        if stalled > IDLE:
            return n, False
        t = end if used == end - t else t + used
        x[:n] = new[:n]
        totals[GROWTH], totals[CREST_LOWERING] = new[n], new[n + 1]
        journal.counts[STEPS] += 1
        dt *= min(2.0, 0.9 * error**-0.125) if error > 0.0 else 2.0
    return n, True


@compiled
def put_together(x, speed, n, met, near, at_end):
    """Put fronts that are one out of order, to be merged; return whether there are any, or one that leaves.

    They are the pair (met, met + 1), and neighbours no further apart than `near` that do not part.
    """
    together = False
    if at_end and x[n - 1] >= -near:
        x[n - 1] = 0.0
    for j in range(n - 2, -1, -1):
        if j == met or (x[j + 1] - x[j] <= near and speed[j] > (1.0 - ALIKE) * speed[j + 1]):
            x[j] = x[j + 1] + 4e-15 * max(1.0, abs(x[j + 1]))
            together = True
    return together or x[n - 1] >= 0.0
