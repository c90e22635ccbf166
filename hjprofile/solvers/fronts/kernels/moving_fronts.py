"""Time stepping of fronts, in the conventions of `front_state`."""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.fronts.kernels.front_merging import Stack, merge, note_events
from hjprofile.solvers.fronts.kernels.front_state import Fronts, Medium, Sides, crest_flux, crest_front, speeds
from hjprofile.solvers.kernels import compiled, inner
from hjprofile.solvers.kernels.journal import CREST_LOWERING, STEPS, TOE_GAIN
from hjprofile.solvers.kernels.law import law_q_f

STEP_FLOOR = 1e-7  # of the time to the next saved time; shorter steps, of 0.3 ms each, would take an hour
REPEAT_ABOVE = 1.2  # relative to the allowed error; above it a step is repeated; 4 missed the exit of a narrow feature
MAX_STEP_RATIO = 2.0  # largest ratio of a step to the previous one
CROSSING_FACTOR = 0.35  # factor of the estimate by fronts that have crossed; measured: the estimate is too large
MOST_FOLDS = 2.0  # lengths 1/|f|, over which K changes by a factor e, that a front may cross in a step
STILL_AT_FIRST = 1e-3  # of `still`, for fronts that are left at rest: they remain there until K is 1000 times larger
MAX_SHORT_STEPS = 10_000  # steps below STEP_FLOOR before a run fails; the first ones can be shorter than later ones


class Control(NamedTuple):
    """Control of the time step.

    Attributes:
        strong: jump above which a merged front is a kink.
        allowed: error of W per unit of time that the motion between events and late merges may add.
        longest: longest step.
        saved: longest time for which unused error is saved for later steps.
        still: fronts that would move less than this until the next saved time are left at rest.
        step: the next step and the time for which error is saved, shape (2,).
    """

    strong: float
    allowed: float
    longest: float
    saved: float
    still: float
    step: np.ndarray


class Workspace(NamedTuple):
    """Work arrays of a time step.

    Attributes:
        sides, stack: the values at the fronts, and the stack of merges.
        rate: speeds at the stages of a step and at its end, shape (stages + 1, fronts); more columns for exact fronts.
        trial, new: positions at a stage and at the end of a step.
        max_K_f: the largest K |f| on the left of each front.
    """

    sides: Sides
    stack: Stack
    rate: np.ndarray
    trial: np.ndarray
    new: np.ndarray
    max_K_f: np.ndarray


class Active(NamedTuple):
    """The active part of the slope: the fronts that move until the next saved time.

    Attributes:
        first: index of its first front.
        r_left: r on the left of that front, which is constant because the front does not move.
        toe: K at the toe, relative to K at that front.
        most_K: value of K at that front above which fronts on its left move.
    """

    first: int
    r_left: float
    toe: float
    most_K: float


@compiled
def advance(fronts, n, t, end, control, medium, work, journal):
    """Advance the first n fronts to `end` by classical Runge-Kutta steps; merge after each and remove fronts at x > 0.

    Only the active part of the slope is advanced, until K on its left has increased so much that more fronts move.
    Return n, and True if `end` is reached: False after MAX_SHORT_STEPS steps below STEP_FLOOR of the time.
    """
    x, jump = fronts.x, fronts.jump
    floor, short = STEP_FLOOR * (end - t), 0
    while t < end and n > 0 and short <= MAX_SHORT_STEPS:
        active = active_part(x, jump, n, control.still / (end - t), medium, work)
        first = active.first
        part = Fronts(x[first:], jump[first:], fronts.label[first:], fronts.first_merge[first:], fronts.smooth[first:])
        m, t, short = advance_part(part, n - first, (t, end, floor), short, control, active, medium, work, journal)
        n = first + m
    return n, t >= end or n == 0


@inner
def active_part(x, jump, n, slowest, medium, work):
    """Return the active part of n fronts, and fill their sides, and rate[0] with their speeds. Others move below
    `slowest`.

    K falls by many orders of magnitude along a slope with hollows, and grains do not reach its lower part until the
    hollows above are full. The values of r left of the first moving front are constant, and K changes in proportion.
    """
    sides, speed = work.sides, work.rate[0]
    speeds(x, jump, n, crest_front(x, n), medium, sides, speed)
    first, largest = 0, 0.0
    for j in range(n - 1):
        rate = max(speed[j], sides.K[j] * abs(law_q_f(sides.r_right[j], medium.law)[1]))
        if not max(rate, largest) <= STILL_AT_FIRST * slowest:
            break
        first, largest = j, max(rate, largest)
    if first == 0:
        return Active(0, medium.r0, 1.0, np.inf)
    K = sides.K[first]
    if largest > 0.0:
        return Active(first, sides.r_left[first], sides.K[0] / K, K * slowest / largest)
    return Active(first, sides.r_left[first], 0.0, STILL_AT_FIRST * slowest)


@inner
def advance_part(fronts, n, times, short, control, active, medium, work, journal):
    """Advance the first n fronts of the active part to `end`, or until fronts on its left move.

    `times` holds the present time, `end`, and the length below which a step counts as short; `short` is their number.
    `control` determines the length of a step from its error, which is the sum of `motion_error`, `crossing_error` of
    fronts that have crossed, and `exit_error`. Return n, the time and the number of short steps.
    """
    x, jump, sides, rate, new = fronts.x, fronts.jump, work.sides, work.rate, work.new
    law, r0 = medium.law, medium.r0
    inside = Medium(active.r_left, medium.near, law)
    t, end, floor = times
    fresh = False  # rate[0] and the sweep are those of x
    while t < end and n > 0:
        if not fresh:
            speeds(x, jump, n, crest_front(x, n), inside, sides, rate[0])
        if sides.K[0] > active.most_K:
            break
        start = active.toe * sides.K[0] - 1.0, crest_flux(x, crest_front(x, n), sides.r_right, law)
        largest_K_f = fit_folds(n, control, law, work)
        while True:
            dt = control.step[0]
            if not dt > floor:  # K is unbounded below a slope with q near -1
                short += 1
                if short > MAX_SHORT_STEPS or not dt > 0.0:
                    return n, t, MAX_SHORT_STEPS + 1
            if dt >= end - t:
                dt = end - t
            elif 2.0 * dt > end - t:
                dt = 0.5 * (end - t)
            toe_gain, crest_lowering = runge_kutta(x, jump, n, dt, start, active.toe, inside, work)
            error = motion_error(jump, n, rate[3], rate[4]) * dt / 6.0
            error += crossing_error(new, jump, n, sides, work.max_K_f, law) * CROSSING_FACTOR / r0**2 * dt
            error += exit_error(new, rate[0], n, sides, law) * largest_K_f * r0 * dt * dt
            if accepted(control, dt, error):
                break
        for j in range(n):
            x[j], rate[0, j] = new[j], rate[4, j]
        journal.totals[TOE_GAIN] += dt / 6.0 * toe_gain
        journal.totals[CREST_LOWERING] += dt / 6.0 * crest_lowering
        journal.counts[STEPS] += 1
        t = end if dt == end - t else t + dt
        before = n
        n = merge(fronts, n, t, law, sides, rate[0], work.stack, journal)
        fresh = n == before
        n = note_events(fronts, n, t, control.strong, rate[0], journal)
    return n, t, short


@inner
def fit_folds(n, control, law, work):
    """Shorten the next step until no front crosses more than MOST_FOLDS; fill `max_K_f`; return its maximum."""
    r_right, K, speed, max_K_f = work.sides.r_right, work.sides.K, work.rate[0], work.max_K_f
    folds = largest_K_f = 0.0
    for j in range(n):
        f = abs(law_q_f(r_right[j], law)[1])
        max_K_f[j] = largest_K_f
        folds, largest_K_f = max(folds, speed[j] * f), max(largest_K_f, K[j] * f)
    control.step[0] = min(control.step[0], MOST_FOLDS / folds) if folds > 0.0 else control.step[0]
    return largest_K_f


@inner
def runge_kutta(x, jump, n, dt, start, toe, medium, work):
    """Fill the positions after a step and the rates of its stages; return six times the means of K_left - 1 and F(0).

    `start` holds these two at x, and rate[0] the speeds there. K_left is `toe` times K at the first front.
    On return the sides are those at the end of the step.
    """
    sides, rate, trial, new = work.sides, work.rate, work.trial, work.new
    toe_gain, crest_lowering = start
    for stage in range(1, 4):
        part = dt if stage == 3 else 0.5 * dt
        for j in range(n):
            trial[j] = x[j] + part * rate[stage - 1, j]
        speeds(trial, jump, n, crest_front(trial, n), medium, sides, rate[stage])
        weight = 1.0 if stage == 3 else 2.0
        toe_gain += weight * (toe * sides.K[0] - 1.0)
        crest_lowering += weight * crest_flux(trial, crest_front(trial, n), sides.r_right, medium.law)
    for j in range(n):
        new[j] = x[j] + dt / 6.0 * (rate[0, j] + 2.0 * (rate[1, j] + rate[2, j]) + rate[3, j])
    speeds(new, jump, n, crest_front(new, n), medium, sides, rate[4])
    return toe_gain, crest_lowering


@inner
def accepted(control, dt, error):
    """Return True if the error of a step is allowed; set the length of the next step, or of the repetition of this one.

    Unused error is saved for later steps.
    """
    ratio = error / (control.allowed * (dt + control.step[1]))
    if ratio <= REPEAT_ABOVE:
        saved = control.step[1] + dt - error / control.allowed
        control.step[1] = min(max(saved, 0.0), control.saved)
        factor = min(MAX_STEP_RATIO, 0.9 / math.sqrt(ratio)) if ratio > 0.0 else MAX_STEP_RATIO
        if dt == control.step[0] or factor < 1.0:
            control.step[0] = min(max(factor, 0.2) * dt, control.longest)
        return True
    control.step[0] = dt * max(0.2, 0.9 / math.sqrt(ratio)) if ratio == ratio else 0.1 * dt
    return False


@inner
def motion_error(jump, n, last, after):
    """Return six times the error of W per unit of time of a step: the largest sum of jump times displacement.

    With the speeds after the step instead of those of the last Runge-Kutta stage it is of third order.
    """
    total = largest = 0.0
    for j in range(n):
        total += jump[j] * (last[j] - after[j])
        if not abs(total) <= largest:
            largest = abs(total)
    return largest


@inner
def exit_error(new, speed, n, sides, law):
    """Return the error of ln K, divided by the square of the step, of the worst front that leaves within a step.

    ∂_t ln K jumps by the front's speed times its jump of f, at a time between the stages of the step.
    """
    r_left, r_right = sides.r_left, sides.r_right
    largest = 0.0
    j = n - 1
    while j >= 0 and new[j] > 0.0:
        change = abs(law_q_f(r_right[j], law)[1] - law_q_f(r_left[j], law)[1])
        largest = max(largest, change * speed[j] / 12.0)
        j -= 1
    return largest


@inner
def crossing_error(x, jump, n, sides, max_K_f, law):
    """Return the error of W per unit of time by fronts that have crossed and are not merged yet.

    Two fronts that overlap by a length d change ln K on their left by the product of their jumps times d. They are
    displaced by the same amount times K f between them. `max_K_f` holds the largest K |f| left of each front.
    """
    r_left, r_right, K = sides.r_left, sides.r_right, sides.K
    total = 0.0
    far, strength, beyond = x[0], abs(jump[0]), max_K_f[0]
    for j in range(1, n):
        if x[j] < far:
            flux = max(beyond, K[j] * abs(law_q_f(r_left[j], law)[1]))
            total += strength * abs(jump[j]) * (far - x[j]) * flux
            strength += abs(jump[j])
        else:
            far, strength, beyond = x[j], abs(jump[j]), max_K_f[j]
    far, strength = x[n - 1], abs(jump[n - 1])
    for j in range(n - 2, -1, -1):
        if x[j] > far:
            flux = max(max_K_f[j], K[j] * abs(law_q_f(r_right[j], law)[1]))
            total += strength * abs(jump[j]) * (x[j] - far) * flux
            strength += abs(jump[j])
        else:
            far, strength = x[j], abs(jump[j])
    return total
