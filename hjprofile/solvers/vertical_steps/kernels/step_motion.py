"""Time steps of fronts under linear growth, and the transitions between kinks and vertical steps (theory, §14)."""

import math

import numpy as np

from hjprofile.solvers.fronts.kernels.moving_fronts import note
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.vertical_steps.kernels.steps import (
    at,
    f_of,
    flows,
    merge,
    moved,
    r_of,
    sweep,
    v_of,
    v_of_r,
    y_of,
)

CROWDED = 0.25  # part of a time step that is taken where a slope is about to become vertical
STEEP = 0.02  # change of R at x = 0 in a time step beyond which its integral is not left to the stages
NEAR_VERTICAL = 4.0  # time steps within which a step can move by its distance from where its right piece is vertical
CONTACT = 0.9  # part of the speed of a step beyond which slopes on its right, which move so fast, soon leave it
LANDINGS = 20  # trials of a time step that ends as a step arrives at x = 0, ...
LANDED = 1e-10  # ... to within this part of the spacing


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
    return. `work[12]` is set to y on the right of the fronts afterwards, as the pieces move with K/R: where a front has
    passed another, the pieces between them may end at a vertical slope before that, and W does not tell it.
    """
    v_right, r_right, m, K = work[1], work[3], work[4], work[5]
    k, d, xs, ys, dx, dy, y_right, shift = work[6], work[7], work[8], work[9], work[10], work[11], work[12], work[13]
    growth = outflow = steepest = 0.0
    for j in range(n):
        dx[j] = dy[j] = shift[j] = 0.0
        y_right[j] = y_of(v_right[j], law)
    top = first_top = top_front_or_step(x, is_step, n)
    r_top = r_of(v_of(moved(y_right[top], -x[top], law), law), law)
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
        steepest = max(steepest, at_top)
        for j in range(n):
            dx[j] += weight * k[j]
            dy[j] += weight * d[j]
            shift[j] += weight * K[j] / r_right[j]
    for j in range(n):
        y_right[j] = moved(y_right[j], dx[j] - shift[j], law)
        xs[j] = x[j] + dx[j]
    if dt * steepest > STEEP:  # F is without bound, but dR/dt = F at x = 0, and W is continuous at the fronts that left
        top = top_front_or_step(xs, is_step, n)
        outflow = r_of(v_of(moved(y_right[top], -xs[top], law), law), law) - r_top
        for j in range(top + 1, first_top + 1):
            outflow += jump[j]
    return growth, outflow


@compiled
def advance(x, jump, is_step, y, label, since, met, n, t, end, reach, spacing, quantum, strong, law, work, log, totals):
    """Classical Runge-Kutta steps to `end`, merging after each; otherwise as `moving_fronts.advance`.

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
            opening |= r_right[j] + 8.0 * (abs(jump[j]) if label[j] == 0 else quantum) > law.r_most
            first = j if is_step[j] else first
        dt = reach * spacing / fastest
        for j in range(n):
            if is_step[j] and label[j] > 0:
                opening |= y[j] < NEAR_VERTICAL * abs(work[7, j]) * dt
                opening |= work[5, j] * at(law.df, law, work[1, j]) > CONTACT * k[j]
        # where a smooth slope breaks fronts are crowded, and q on the right of a step changes fast where it is large
        dt *= CROWDED if opening else 1.0
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
