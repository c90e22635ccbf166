"""Exact front tracking: adaptive steps of order 8, with each merge and exit located in time.

The conventions are those of `front_state`.
"""

from typing import NamedTuple

from hjprofile.solvers.fronts.kernels.front_merging import merge, note_events
from hjprofile.solvers.fronts.kernels.front_state import crest_flux, speeds, sweep
from hjprofile.solvers.kernels import compiled, inner
from hjprofile.solvers.kernels.dormand_prince import STAGES, Tableau, state_at, step_error
from hjprofile.solvers.kernels.journal import CREST_LOWERING, STEPS, TOE_GAIN

COINCIDENT = 1e-13  # fronts no further apart count as coincident
COINCIDENT_AT_END = 1e-11  # the same at the end of an integration, where rounding can delay an event beyond it
EQUAL_SPEEDS = 1e-10  # relative difference of speeds below which coincident fronts stay together
MAX_STALLED_STEPS = 1000  # consecutive steps without progress in time after which the integration fails


class ExactControl(NamedTuple):
    """Control of the integration.

    Attributes:
        strong: jump above which a merged front is a kink.
        tolerance: largest error of one step.
        tableau: the coefficients of a step.
    """

    strong: float
    tolerance: float
    tableau: Tableau


@inner
def rates_of(y, jump, n, medium, sides, rate):
    """Fill the speeds of n fronts, then K_left - 1 and F(0): the state y holds positions and the two integrals.

    The last piece is continued to x = 0 even if a trial step moves the last front beyond x = 0, so the rate is smooth.
    """
    speeds(y, jump, n, n - 1, medium, sides, rate)
    rate[n] = sides.K[0] - 1.0
    rate[n + 1] = crest_flux(y, n - 1, sides.r_right, medium.law)


@inner
def step(y, rates, dt, jump, n, medium, sides, tableau, new):
    """Fill `new` by one step from y, whose rate is rates[0], and rates[STAGES] by the rate there."""
    for stage in range(1, STAGES + 1):
        state_at(stage, y, dt, rates, tableau, new)
        rates_of(new, jump, n, medium, sides, rates[stage])


@inner
def least_gap(y, before, n):
    """Return the smallest distance of two neighbours, or of the last front from x = 0, and its index (n - 1: at x = 0).

    It is negative after an event. Neighbours that coincided `before` are opening fans and not counted.
    """
    least, at = -y[n - 1], n - 1
    for j in range(n - 1):
        if before[j + 1] - before[j] > COINCIDENT and y[j + 1] - y[j] < least:
            least, at = y[j + 1] - y[j], j
    return least, at


@inner
def fan_fails_to_open(y, before, n):
    """Return True if neighbours that coincided have changed their order."""
    for j in range(n - 1):  # noqa: SIM110  numba compiles no generators
        if before[j + 1] - before[j] <= COINCIDENT and y[j + 1] - y[j] < -0.1 * COINCIDENT:
            return True
    return False


@inner
def first_crossing(y, new, rates, dt, n):
    """Return the fraction of a step at the first event, by cubic interpolation from the `rates` at both ends."""
    first = 1.0
    for j in range(n):
        if j < n - 1:
            a, b = y[j + 1] - y[j], new[j + 1] - new[j]
            da, db = dt * (rates[0, j + 1] - rates[0, j]), dt * (rates[12, j + 1] - rates[12, j])
            if a <= COINCIDENT:
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


@inner
def narrowed(low, g_low, high, g_high, side, theta, gap):
    """Replace the end of a bracket on the side of the value `gap` at theta; `side` is the end that was replaced last.

    The value at the other end is halved if that end stays for a second time (Illinois rule).
    """
    if gap > 0.0:
        return theta, gap, high, 0.5 * g_high if side == 1 else g_high, 1
    return low, 0.5 * g_low if side == -1 else g_low, theta, gap, -1


@inner
def first_event(y, rates, dt, jump, n, medium, sides, tableau, new):
    """Set `new`, a step beyond an event, to the state at the first event; return the length of that step and the pair.

    The fraction of the step is found by the Illinois variant of false position.
    """
    low, high, side = 0.0, 1.0, 0
    g_low, g_high = least_gap(y, y, n)[0], least_gap(new, y, n)[0]
    theta, used, pair = first_crossing(y, new, rates, dt, n), dt, -1
    for _ in range(60):
        used = theta * dt
        step(y, rates, used, jump, n, medium, sides, tableau, new)
        gap, pair = least_gap(new, y, n)
        if abs(gap) <= 2e-15 * max(1.0, abs(new[pair])) or high - low <= 2e-16:
            break
        low, g_low, high, g_high, side = narrowed(low, g_low, high, g_high, side, theta, gap)
        theta = low + (high - low) * g_low / (g_low - g_high)
    if pair == n - 1:
        new[n - 1] = 0.0
    return used, pair


@compiled
def advance_exactly(fronts, n, t, end, control, medium, work, journal):
    """Advance fronts as `moving_fronts.advance` does, by adaptive steps of order 8 that locate each merge and exit.

    The root of an event is found in the fraction of the step. Each evaluation is a step, so an event has full order.
    Return n, and True if `end` is reached: False after many consecutive steps without progress.
    """
    x, jump, sides, rates, totals = fronts.x, fronts.jump, work.sides, work.rate, journal.totals
    stalled = 0
    dt = 0.01 * (end - t)
    pair = -1  # the pair (pair, pair + 1) of an event
    while n > 0:
        # coincident fronts that do not separate are one front: after an event, and in the data
        near = COINCIDENT if t < end else COINCIDENT_AT_END
        if put_together(x, jump, n, pair, near, t >= end, medium, sides, rates[0]):
            sweep(x, jump, n, n - 1, medium, sides)
            n = merge(fronts, n, t, medium.law, sides, rates[0], work.stack, journal)
            n = note_events(fronts, n, t, control.strong, rates[0], journal)
            pair = -1
            continue
        if t >= end:
            break

        y, new = work.trial[: n + 2], work.new[: n + 2]
        for j in range(n):
            y[j] = x[j]
        y[n], y[n + 1] = totals[TOE_GAIN], totals[CREST_LOWERING]
        dt, error = accepted_step(y, rates, min(dt, end - t), 1e-14 * end, jump, n, control, medium, sides, new)
        used = dt
        if least_gap(new, y, n)[0] < 0.0:
            used, pair = first_event(y, rates, dt, jump, n, medium, sides, control.tableau, new)
        stalled = stalled + 1 if used < 1e-13 * end else 0
        if stalled > MAX_STALLED_STEPS:
            return n, False
        t = end if used == end - t else t + used
        for j in range(n):
            x[j] = new[j]
        totals[TOE_GAIN], totals[CREST_LOWERING] = new[n], new[n + 1]
        journal.counts[STEPS] += 1
        dt *= min(2.0, 0.9 * error**-0.125) if error > 0.0 else 2.0
    return n, True


@inner
def accepted_step(y, rates, dt, shortest, jump, n, control, medium, sides, new):
    """Fill `new` by a step from y, shorter than dt if necessary; return its length, and its error by the tolerance.

    A step shorter than `shortest` is accepted with any error.
    """
    while True:
        step(y, rates, dt, jump, n, medium, sides, control.tableau, new)
        error = step_error(dt, rates, control.tableau, new, n) / control.tolerance
        if dt < shortest:
            return dt, error
        if not error <= 1.0:
            dt *= max(0.2, 0.9 * error**-0.125) if error == error else 0.1
        elif fan_fails_to_open(new, y, n):
            dt *= 0.5
        else:
            return dt, error


@inner
def put_together(x, jump, n, pair, near, at_end, medium, sides, speed):
    """Put fronts that have become one out of order, to be merged; return True if there are any, or if one leaves.

    These are the pair (pair, pair + 1), and neighbours that are no further apart than `near` and do not separate.
    Their rates are filled into `speed`, as `rates_of` does.
    """
    rates_of(x, jump, n, medium, sides, speed)
    together = False
    if at_end and x[n - 1] >= -near:
        x[n - 1] = 0.0
    for j in range(n - 2, -1, -1):
        if j == pair or (x[j + 1] - x[j] <= near and speed[j] > (1.0 - EQUAL_SPEEDS) * speed[j + 1]):
            x[j] = x[j + 1] + 4e-15 * max(1.0, abs(x[j + 1]))
            together = True
    return together or x[n - 1] >= 0.0
