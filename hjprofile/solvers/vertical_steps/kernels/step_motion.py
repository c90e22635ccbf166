"""Time stepping of fronts under linear growth, in the conventions of `steps` (§16)."""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.journal import CREST_LOWERING, STEPS, TOE_GAIN
from hjprofile.solvers.vertical_steps.kernels.step_merging import merge
from hjprofile.solvers.vertical_steps.kernels.step_transitions import transitions
from hjprofile.solvers.vertical_steps.kernels.steps import at, flows, moved, r_of, sweep, v_of, y_of

CROWDED_FACTOR = 0.25  # factor of the time step if a slope is about to become vertical
LARGE_CREST_CHANGE = 0.02  # change of R at x = 0 in a time step above which it replaces the quadrature over the stages
NEAR_VERTICAL = 4.0  # time steps in which a vertical step can reach the point where its right piece is vertical
CONTACT = 0.9  # relative speed above which the slopes on the right of a vertical step soon leave it
ARRIVAL_TRIALS = 20  # trials of a time step that ends when a vertical step arrives at x = 0
ARRIVAL_TOLERANCE = 1e-10  # tolerance of the arrival, as a fraction of the spacing


class StepControl(NamedTuple):
    """Control of the time step.

    Attributes:
        spacing: mean length of the pieces of smooth data.
        reach: spacings that the fastest front may cross in a step.
        quantum: jump of an ordinary small front.
        strong: jump above which a merged front is a kink, and height above which a front is a vertical step.
    """

    spacing: float
    reach: float
    quantum: float
    strong: float


class StepWorkspace(NamedTuple):
    """Work arrays of a time step.

    Attributes:
        x, y: at a stage.
        dx, dy: their changes in the step.
        y_right: y on the right of each front after the step.
        shift: the displacements of the pieces.
    """

    x: np.ndarray
    y: np.ndarray
    dx: np.ndarray
    dy: np.ndarray
    y_right: np.ndarray
    shift: np.ndarray


@compiled
def crest_front_or_step(x, is_step, n):
    """Return the front whose piece on the right contains x = 0.

    A vertical step counts as below the crest until it has arrived.
    """
    crest = n - 1
    while crest > 0 and x[crest] > 0.0 and not is_step[crest]:
        crest -= 1
    return crest


@compiled
def runge_kutta(fronts, n, dt, law, sides, work):
    """Set dx and dy to the changes in a classical Runge-Kutta step; return the changes of two integrals.

    These are ∫(K_left - 1) dt and ∫F(0) dt. `sides` holds the sweep of x and y on entry, and that of the last stage on
    return. `y_right` is set to y on the right of the fronts after the step, from the motion of the pieces with K/R. If
    a front has passed another, the pieces between them may end at a vertical slope before that, and W does not
    determine y.
    """
    x, y, jump, is_step, k, d = fronts.x, fronts.y, fronts.jump, fronts.is_step, sides.speed, sides.drift
    v_right, r_right, K = sides.v_right, sides.r_right, sides.K
    xs, ys, dx, dy, y_right, shift = work.x, work.y, work.dx, work.dy, work.y_right, work.shift
    toe_gain = crest_lowering = steepest = 0.0
    for j in range(n):
        dx[j] = dy[j] = shift[j] = 0.0
        y_right[j] = y_of(v_right[j], law)
    crest = first_crest = crest_front_or_step(x, is_step, n)
    r_crest = r_of(v_of(moved(y_right[crest], -x[crest], law), law), law)
    for stage in range(4):
        if stage > 0:
            part = 1.0 if stage == 3 else 0.5
            for j in range(n):
                xs[j], ys[j] = x[j] + part * dt * k[j], y[j] + part * dt * d[j]
            crest = crest_front_or_step(xs, is_step, n)
            sweep(xs, ys, fronts, n, crest, law, sides)
        weight = dt / 3.0 if stage in (1, 2) else dt / 6.0
        at_left, at_crest = flows(xs if stage else x, crest, sides, law)
        toe_gain += weight * at_left
        crest_lowering += weight * at_crest
        steepest = max(steepest, at_crest)
        for j in range(n):
            dx[j] += weight * k[j]
            dy[j] += weight * d[j]
            shift[j] += weight * K[j] / r_right[j]
    for j in range(n):
        y_right[j] = moved(y_right[j], dx[j] - shift[j], law)
        xs[j] = x[j] + dx[j]
    if dt * steepest > LARGE_CREST_CHANGE:  # F is unbounded, but dR/dt = F at x = 0, and W is continuous there
        crest = crest_front_or_step(xs, is_step, n)
        crest_lowering = r_of(v_of(moved(y_right[crest], -xs[crest], law), law), law) - r_crest
        for j in range(crest + 1, first_crest + 1):
            crest_lowering += jump[j]
    return toe_gain, crest_lowering


@compiled
def advance(fronts, n, t, end, control, law, sides, work, journal):
    """Advance fronts to `end` by classical Runge-Kutta steps with a merge after each, as `moving_fronts.advance` does.

    K falls by e^{-η0 m} when a vertical step of height m leaves, so a time step ends there. The lowering of the crest
    includes the steps that left. Return n, and True if `end` is reached: False if a time step is below 1e-9 of it.
    """
    x, y, is_step, k, dx, dy = fronts.x, fronts.y, fronts.is_step, sides.speed, work.dx, work.dy
    while t < end and n > 0:
        crest = crest_front_or_step(x, is_step, n)
        sweep(x, y, fronts, n, crest, law, sides)
        dt, first = step_length(fronts, n, control, law, sides)
        if not dt > 1e-9 * end:
            return n, False
        if dt >= end - t:
            dt = end - t
        elif 2.0 * dt > end - t:
            dt = 0.5 * (end - t)
        longest = dt
        if first >= 0:
            dt = min(dt, -x[first] / k[first])
        toe_gain, crest_lowering = runge_kutta(fronts, n, dt, law, sides, work)
        for trial in range(ARRIVAL_TRIALS):
            beyond = x[first] + dx[first] if first >= 0 else -1.0
            if dt == longest and beyond <= 0.0:
                break
            if abs(beyond) <= ARRIVAL_TOLERANCE * control.spacing or trial == ARRIVAL_TRIALS - 1:
                dx[first] = -x[first]
                break
            dt = min(max(dt - beyond / k[first], 0.5 * dt), longest)
            sweep(x, y, fronts, n, crest, law, sides)
            toe_gain, crest_lowering = runge_kutta(fronts, n, dt, law, sides, work)
        for j in range(n):
            x[j] += dx[j]
            y[j] = max(y[j] + dy[j], 0.0)
        journal.totals[TOE_GAIN] += toe_gain
        journal.totals[CREST_LOWERING] += crest_lowering
        journal.counts[STEPS] += 1
        t = end if dt == end - t else t + dt
        sweep(x, y, fronts, n, crest_front_or_step(x, is_step, n), law, sides)
        before = n
        n = merge(fronts, n, t, law, sides, work.y_right, journal)
        if n < before:
            sweep(x, y, fronts, n, crest_front_or_step(x, is_step, n), law, sides)
        n = transitions(fronts, n, t, control.quantum, control.strong, law, sides, journal)
    return n, True


@compiled
def step_length(fronts, n, control, law, sides):
    """Return the length of the next time step, and the vertical step nearest to x = 0, or -1.

    The length is reduced where a smooth slope breaks, where fronts are crowded, and where q on the right of a vertical
    step is large and changes fast.
    """
    jump, is_step, y, label, k = fronts.jump, fronts.is_step, fronts.y, fronts.label, sides.speed
    v_right, r_right, K, drift = sides.v_right, sides.r_right, sides.K, sides.drift
    fastest, opening, first = 0.0, False, -1
    for j in range(n):
        fastest = max(fastest, k[j])
        ahead = 8.0 * (abs(jump[j]) if label[j] == 0 else control.quantum)
        opening |= r_right[j] + ahead > law.r_most
        first = j if is_step[j] else first
    dt = control.reach * control.spacing / fastest
    for j in range(n):
        if is_step[j] and label[j] > 0:
            opening |= y[j] < NEAR_VERTICAL * abs(drift[j]) * dt
            opening |= K[j] * at(law.df, law, v_right[j]) > CONTACT * k[j]
    return dt * (CROWDED_FACTOR if opening else 1.0), first
