"""Loops of the grid solvers.

A law enters as arrays of its values, so a user's own law runs through the same kernels as the built-in ones.
Nodes carry index 0..N, cells 0..N-1; cell i lies between nodes i and i+1.
"""

import math

from hjprofile.solvers.kernels import compiled


@compiled
def hj_slopes(W, dx, q):
    """q = W_x on the cells; returns the least, or NaN if any is not a number."""
    least = math.inf
    bad = 0
    for i in range(q.size):
        value = (W[i + 1] - W[i]) / dx
        q[i] = value
        least = min(least, value)
        bad += value != value
    return math.nan if bad else least


@compiled
def hj_exponent(f, dx, exponent):
    """∫_x^0 f dξ at the nodes, one suffix sum."""
    total = 0.0
    exponent[f.size] = 0.0
    for i in range(f.size - 1, -1, -1):
        total += f[i] * dx
        exponent[i] = total


@compiled
def hj_speed(df, K):
    """The largest K f', with each cell's f' and the larger K of its two nodes."""
    speed = 0.0
    for i in range(df.size):
        speed = max(speed, max(K[i], K[i + 1]) * df[i])
    return speed


@compiled
def hj_local_lax_friedrichs(q, f_mean, df, K, F):
    """F = K f(½(q⁻+q⁺)) - ½ α (q⁺-q⁻) at the inner nodes, α = K max(f'(q⁻), f'(q⁺)): f' is decreasing."""
    for i in range(1, q.size):
        alpha = K[i] * max(df[i - 1], df[i])
        F[i] = K[i] * f_mean[i - 1] - 0.5 * alpha * (q[i] - q[i - 1])


@compiled
def hj_lax_friedrichs(q, f_mean, alpha, K, F):
    """F = K f(½(q⁻+q⁺)) - ½ α (q⁺-q⁻) at the inner nodes, one α."""
    for i in range(1, q.size):
        F[i] = K[i] * f_mean[i - 1] - 0.5 * alpha * (q[i] - q[i - 1])


@compiled
def hj_update(W, F, dt):
    """W_i -= dt F_i."""
    for i in range(W.size):
        W[i] -= dt * F[i]


@compiled
def limited_edges(q, floor_share, left, right):
    """Values at both edges of each cell from the monotonised central slope.

    The first and last cell take the one-sided slope. No edge lies further than `floor_share` of 1 + q from its mean
    on the lower side, which keeps q > -1.
    """
    n = q.size
    for i in range(n):
        back = q[i] - q[i - 1] if i > 0 else q[1] - q[0]
        ahead = q[i + 1] - q[i] if i < n - 1 else q[n - 1] - q[n - 2]
        half = 0.0
        if back * ahead > 0.0:
            half = math.copysign(min(abs(back), abs(ahead), 0.25 * abs(back + ahead)), back)
        most = floor_share * (1.0 + q[i])
        half = max(-most, min(most, half))
        left[i] = q[i] - half
        right[i] = q[i] + half


@compiled
def edge_exponent(f_left, f_right, dx, exponent):
    """∫_x^0 f dξ at the nodes by the trapezoidal rule in each cell."""
    n = f_left.size
    exponent[n] = 0.0
    for i in range(n - 1, -1, -1):
        exponent[i] = exponent[i + 1] + 0.5 * dx * (f_left[i] + f_right[i])
