"""Loops of the second-order scheme for laws of linear growth (§16)."""

import math

from hjprofile.solvers.grids.kernels.sweep_law import values
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.vertical_steps.kernels.steps import v_of

WIDEST_LAYER = 200  # largest width, in cells, of the left part of the numerical layer of a vertical step
STEEPEST_DISTANCE = 1.0  # distance from a vertical slope, in cells; steeper slopes on a grid count as vertical steps


@compiled
def steepest_slope(dx, law):
    """Return the slope STEEPEST_DISTANCE cells to the right of a vertical one, in a piece of constant I."""
    return math.expm1(v_of(-math.expm1(-law.rate * STEEPEST_DISTANCE * dx), law))


@compiled
def limited(a, b):
    """Return the harmonic mean (van Leer), at most twice the smaller value; 0 unless both are positive."""
    return 2.0 * a * b / (a + b) if a > 0.0 and b > 0.0 else 0.0


@compiled
def thin_layers(q, f, eta0, steep):
    """Replace f in the numerical layer of a vertical step by that of a sharp step.

    There f - η0 q has the value outside the layer. A layer is the interval in which q decreases to either side of a
    peak above `steep`: to the left until the decrease is small, to the right over at most twice that width. f - η0 q is
    extrapolated up to the peak by its last difference.
    """
    n, p = q.size, 1
    while p < n - 1:
        if not (q[p] > steep and q[p] >= q[p - 1] and q[p] > q[p + 1]):
            p += 1
            continue
        a, rise = p - 1, q[p] - q[p - 1]
        while a > max(p - WIDEST_LAYER, 0) and q[a] - q[a - 1] > 1e-3 * rise:
            rise = max(rise, q[a] - q[a - 1])
            a -= 1
        last = min(p + 2 * (p - a), n - 1)
        b = p + 1
        while b < last and q[b + 1] < q[b]:
            b += 1
        own = max(f[b] - eta0 * q[b], 0.0)
        fall = max(own - (f[b + 1] - eta0 * q[b + 1]), 0.0) if b < n - 1 else 0.0
        for j in range(p + 1, b):
            f[j] = eta0 * q[j] + min(f[j] - eta0 * q[j], own + (b - j) * fall)
        own = max(f[a] - eta0 * q[a], 0.0)
        for j in range(a + 1, p):
            f[j] = eta0 * q[j] + min(f[j] - eta0 * q[j], own)
        p = b


@compiled
def rates(q, law, dx, inflow, eta0, steep, f, df, dq):
    """Fill dq/dt = -(F_{i+1} - F_i)/Δx with F_i = (K_{i-1/2} - K_{i+1/2})/Δx.

    K_{i+1/2} = K_i exp(-Δx f/2), with f at the node limited between the adjacent cells. Half a cell above the crest K
    is such that the mean of both sides is 1. f and df are work arrays for the cells. Return the K f' that bounds the
    time step, K(left), up to half a cell's inflow, and F at the crest.
    """
    n = q.size
    values(q, law, f, df)
    K, speed = 1.0, 0.0
    for c in range(n - 1, -1, -1):
        z = f[c] * dx
        steepness = math.exp(max(z, 0.0))
        fastest = df[c] * steepness
        if q[c] > 1e-9:  # f/q >= f': the outflow of a cell does not exceed its content
            fastest = max(fastest, math.expm1(z) / (q[c] * dx))
        speed = max(speed, K * fastest)
        K *= math.exp(z)
        speed = max(speed, K * df[c])
    thin_layers(q, f, eta0, steep)
    K, right, F_right, crest = 1.0, 1.0, 0.0, 0.0
    for c in range(n - 1, -1, -1):  # F at the right end of a cell depends on K in the cell and in the next one
        K *= math.exp(f[c] * dx)
        f_node = limited(f[c - 1], f[c]) if c > 0 else (f[0] if inflow != 0.0 else 0.0)
        here = K * math.exp(-0.5 * dx * f_node)
        if c == n - 1:
            right = 2.0 - here
        F = (here - right) / dx
        if c == n - 1:
            crest = F
        else:
            dq[c + 1] = (F - F_right) / dx
        F_right, right = F, here
    dq[0] = (inflow - F_right) / dx
    return speed, right + 0.5 * dx * inflow, crest
