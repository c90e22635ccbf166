"""The loops of the second-order scheme for laws of linear growth (theory, §14)."""

import math

from hjprofile.solvers.grids.kernels.sweep_law import values
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.vertical_steps.kernels.steps import v_of

WIDEST = 200  # cells on the left that the layer of a step may have
NEAR = 1.0  # cells from a vertical slope: what is steeper on a grid is a step


@compiled
def steepest_slope(dx, law):
    """The slope NEAR cells to the right of a vertical one, in a piece of constant I."""
    return math.expm1(v_of(-math.expm1(-law.rate * NEAR * dx), law))


@compiled
def limited(a, b):
    """The harmonic mean (van Leer), at most twice the lesser; none unless both are positive."""
    return 2.0 * a * b / (a + b) if a > 0.0 and b > 0.0 else 0.0


@compiled
def thin_layers(q, f, eta0, steep):
    """Takes f in the layer of a step as that of a sharp one, f - η0 q being what it is beside the layer.

    A layer is where q falls to either side of a peak above `steep`: to the left until it hardly falls, to the right
    twice as far at most. There f - η0 q is continued up to the peak by its last difference.
    """
    n, p = q.size, 1
    while p < n - 1:
        if not (q[p] > steep and q[p] >= q[p - 1] and q[p] > q[p + 1]):
            p += 1
            continue
        a, rise = p - 1, q[p] - q[p - 1]
        while a > max(p - WIDEST, 0) and q[a] - q[a - 1] > 1e-3 * rise:
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
    """Fills dq/dt = -(F_{i+1} - F_i)/Δx with F_i = (K_{i-1/2} - K_{i+1/2})/Δx.

    K_{i+1/2} = K_i exp(-Δx f/2), f at the node being limited between the cells beside it; half a cell beyond the top it
    is such that the mean of both sides is 1. f and df are room for the cells. Returns the K f' that bounds the step,
    K(left), to half a cell's inflow, and F at the top.
    """
    n = q.size
    values(q, law, f, df)
    K, speed = 1.0, 0.0
    for c in range(n - 1, -1, -1):
        z = f[c] * dx
        steepness = math.exp(max(z, 0.0))
        fastest = df[c] * steepness
        if q[c] > 1e-9:  # f/q >= f': what a cell lets go is no more than it has
            fastest = max(fastest, math.expm1(z) / (q[c] * dx))
        speed = max(speed, K * fastest)
        K *= math.exp(z)
        speed = max(speed, K * df[c])
    thin_layers(q, f, eta0, steep)
    K, right, F_right, top = 1.0, 1.0, 0.0, 0.0
    for c in range(n - 1, -1, -1):  # F at the cell's right end needs K in the cell and in the next one
        K *= math.exp(f[c] * dx)
        beside = limited(f[c - 1], f[c]) if c > 0 else (f[0] if inflow != 0.0 else 0.0)
        here = K * math.exp(-0.5 * dx * beside)
        if c == n - 1:
            right = 2.0 - here
        F = (here - right) / dx
        if c == n - 1:
            top = F
        else:
            dq[c + 1] = (F - F_right) / dx
        F_right, right = F, here
    dq[0] = (inflow - F_right) / dx
    return speed, right + 0.5 * dx * inflow, top
