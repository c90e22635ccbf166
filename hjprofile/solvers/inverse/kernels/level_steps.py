"""Time steps of x(t, u) at evenly spaced heights u, the levels: x_t = K g(x_u) with x_u >= 0.

Level i is at the height u_0 + i Δu and the position x_i. Cell i lies between the levels i and i + 1, with the inverse
slope z_i = (x_{i+1} - x_i)/Δu. Level n is the first one beyond the crest x = 0.
"""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled

NEUTRAL = 1e-11  # largest |z - 1| of cells on the left that are left out, because nothing happens there
MOST_ITERATIONS = 60  # of Newton's method; measured: 4 in the mean, 7 at most
LAST_MOVE = 1e-7  # size of the last Newton step, in Δu: convergence is quadratic, so its error is below rounding
REACH = 1.0  # largest distance by which the graph of u moves in a time step, in Δu


class LevelLaw(NamedTuple):
    """g(z) = z f(1/z - 1) by cubics in v = -ln z = ln(1 + q) at even distances.

    Attributes:
        g, dg: g and dg/dv at the joints.
        zero: the index of the joint at v = 0.
        width: the distance of joints.
        z_top, g_top: the position of the maximum of g, 0 if g decreases, and this maximum.
        eta0: g(0), which is 0 under laws of sublinear growth.
    """

    g: np.ndarray
    dg: np.ndarray
    zero: int
    width: float
    z_top: float
    g_top: float
    eta0: float


class Levels(NamedTuple):
    """Positions of levels, and the workspace of a time step; all arrays have the same length.

    Attributes:
        x: positions of the levels.
        old: positions before the time step.
        pace: velocities in the last time step, before the projection: the first guess of Newton's method.
        ln_K: at the levels.
        g, dg: g and g' in the cells.
        lower, diagonal, upper, rest: the linear system of a Newton step.
        mean: means of the pools of the projection.
        pooled: numbers of levels in these pools.
    """

    x: np.ndarray
    old: np.ndarray
    pace: np.ndarray
    ln_K: np.ndarray
    g: np.ndarray
    dg: np.ndarray
    lower: np.ndarray
    diagonal: np.ndarray
    upper: np.ndarray
    rest: np.ndarray
    mean: np.ndarray
    pooled: np.ndarray


@compiled
def g_and_slope(z, law):
    """Return g and g' at z; beyond the table, and for the z < 0 of Newton's method, g continues as a line."""
    last = law.g.size - 1
    least, most = np.exp(law.width * (law.zero - last)), np.exp(law.width * law.zero)
    if z < least:
        slope = (law.g[last] - law.eta0) / least
        return law.eta0 + slope * z, slope
    if z > most:
        slope = -law.dg[0] / most
        return law.g[0] + slope * (z - most), slope
    at = law.zero - np.log(z) / law.width
    k = min(max(int(at), 0), last - 1)
    s = at - k
    r = 1.0 - s
    change = law.g[k + 1] - law.g[k]
    left, right = law.dg[k] * law.width - change, change - law.dg[k + 1] * law.width
    g = r * law.g[k] + s * law.g[k + 1] + s * r * (r * left + s * right)
    dg = (change + (r - s) * (r * left + s * right) + s * r * (right - left)) / law.width
    return g, -dg / z


@compiled
def cells(levels, first, n, spacing, law):
    """Fill g and g' in the cells first..n-1."""
    x, g, dg = levels.x, levels.g, levels.dg
    for i in range(first, n):
        g[i], dg[i] = g_and_slope((x[i + 1] - x[i]) / spacing, law)


@compiled
def fill_ln_K(levels, n, spacing):
    """Fill ln K at the levels 0..n from g in the cells. Return the distance of the crest from level n - 1, in Δu.

    ln K is linear in u within a cell, and 0 at x = 0.
    """
    x, g, ln_K = levels.x, levels.g, levels.ln_K
    width = x[n] - x[n - 1]
    part = min(max(-x[n - 1] / width, 0.0), 1.0) if width > 0.0 else 1.0
    ln_K[n] = -g[n - 1] * (1.0 - part) * spacing
    ln_K[n - 1] = g[n - 1] * part * spacing
    for i in range(n - 2, -1, -1):
        ln_K[i] = ln_K[i + 1] + g[i] * spacing
    return part


@compiled
def _first_and_rate(levels, n, spacing):
    """Return the first level that can move, and the largest speed of the graph of u, across or along the heights."""
    x, g, ln_K = levels.x, levels.g, levels.ln_K
    first, rate = n, 0.0
    for i in range(n - 1, -1, -1):
        z = (x[i + 1] - x[i]) / spacing
        if abs(z - 1.0) > NEUTRAL:
            first = i + 1
        steep = 1.0 if z < 1.0 else 1.0 / z
        rate = max(rate, np.exp(max(ln_K[i], ln_K[i + 1])) * abs(g[i]) * steep)
    return first, rate


@compiled
def _linearise(levels, first, n, spacing, dt, at_crest, law):
    """Fill the system of a Newton step for x_i = old_i + Δt K_i min(g(max(z_{i-1}, z*)), g(min(z_i, z*))).

    g increases up to z* and decreases from there: this is Godunov's flux. Within a vertical step of the old x it is
    g(0), because levels that change their order there must not hold each other. `at_crest` is z beyond level n.
    """
    x, old, g, dg = levels.x, levels.old, levels.g, levels.dg
    beyond = g_and_slope(min(at_crest, law.z_top), law)[0]
    for i in range(first, n + 1):
        below, above = law.g_top, law.g_top  # from the cells below and above the level
        slope_below, slope_above = 0.0, 0.0
        if x[i] - x[i - 1] > law.z_top * spacing:
            below, slope_below = g[i - 1], min(dg[i - 1], 0.0)
        if i == n:
            above = beyond
        elif old[i + 1] <= old[i]:  # inside a vertical step, whose mean velocity follows from the projection
            above = law.eta0
        elif x[i + 1] - x[i] < law.z_top * spacing:
            above, slope_above = g[i], max(dg[i], 0.0)
        K = np.exp(levels.ln_K[i])
        change = dt * K / spacing
        if below <= above:
            levels.rest[i] = x[i] - old[i] - dt * K * below
            levels.lower[i], levels.upper[i] = change * slope_below, 0.0
            levels.diagonal[i] = 1.0 - change * slope_below
        else:
            levels.rest[i] = x[i] - old[i] - dt * K * above
            levels.lower[i], levels.upper[i] = 0.0, -change * slope_above
            levels.diagonal[i] = 1.0 + change * slope_above


@compiled
def _newton_step(levels, first, n):
    """Solve the linear system, change x, and return the largest change. No pivots: the matrix is an M-matrix."""
    lower, diagonal, upper, rest = levels.lower, levels.diagonal, levels.upper, levels.rest
    for i in range(first + 1, n + 1):
        share = lower[i] / diagonal[i - 1]
        diagonal[i] -= share * upper[i - 1]
        rest[i] -= share * rest[i - 1]
    change, largest = 0.0, 0.0
    for i in range(n, first - 1, -1):
        change = (rest[i] - upper[i] * change) / diagonal[i]
        levels.x[i] -= change
        largest = max(largest, abs(change)) if change == change else np.inf
    return largest


@compiled
def project(levels, first, n):
    """Replace x at the levels first..n by its L2 projection onto the non-decreasing sequences.

    Adjacent levels in the wrong order are pooled: each pool moves to its mean.
    """
    x, mean, pooled = levels.x, levels.mean, levels.pooled
    pools = 0
    for i in range(first, n + 1):
        mean[pools], pooled[pools] = x[i], 1.0
        pools += 1
        while pools > 1 and mean[pools - 2] >= mean[pools - 1]:
            a, b = pooled[pools - 2], pooled[pools - 1]
            mean[pools - 2] = (mean[pools - 2] * a + mean[pools - 1] * b) / (a + b)
            pooled[pools - 2] = a + b
            pools -= 1
    i = first
    for k in range(pools):
        for _ in range(int(pooled[k])):
            x[i] = mean[k]
            i += 1


@compiled
def _end_at_the_crest(levels, n):
    """Return the new n: drop the levels that have passed the crest, and add levels along the last cell if it rose."""
    x, pace = levels.x, levels.pace
    while n > 1 and x[n - 1] > 0.0:
        n -= 1
    while x[n] <= 0.0 and n < x.size - 1 and x[n] > x[n - 1]:
        x[n + 1] = x[n] + (x[n] - x[n - 1])
        pace[n + 1] = pace[n]
        n += 1
    return n


@compiled
def advance(levels, n, spacing, remaining, scale, law):
    """Advance by one time step of backward Euler with the present K; the cells must be filled, and are filled after it.

    The graph of u moves by at most REACH Δu `scale`, and `remaining` is a multiple of the time step. Return n, the time
    step, and the number of Newton steps. This is -1 if Newton's method fails, or if x = 0 lies above all levels.
    """
    fill_ln_K(levels, n, spacing)
    first, rate = _first_and_rate(levels, n, spacing)
    if not rate < np.inf:
        return n, 0.0, -1
    dt = remaining / max(np.ceil(remaining * rate / (REACH * spacing * scale)), 1.0)
    x, old, pace = levels.x, levels.old, levels.pace
    at_crest = (x[n] - x[n - 1]) / spacing
    for i in range(first, n + 1):
        old[i] = x[i]
        x[i] += dt * pace[i]
    done, iterations = False, 0
    while not done and iterations < MOST_ITERATIONS:
        cells(levels, first - 1, n, spacing, law)
        _linearise(levels, first, n, spacing, dt, at_crest, law)
        done = _newton_step(levels, first, n) <= LAST_MOVE * spacing
        iterations += 1
    for i in range(first, n + 1):
        pace[i] = (x[i] - old[i]) / dt
    if law.eta0 > 0.0:
        project(levels, first, n)
    n = _end_at_the_crest(levels, n)
    cells(levels, max(first - 1, 0), n, spacing, law)
    return n, dt, iterations if done and x[n] > 0.0 else -1
