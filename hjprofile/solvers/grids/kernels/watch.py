"""Loops for the monitors: sums and extremes of a state, ln K, and one step with frozen K."""

import numpy as np

from hjprofile.solvers.grids.kernels.sweep_law import (
    LANES,
    cell_law,
    curvature_at_zero,
    is_table,
    largest,
    read,
    read_f,
    slope_at_zero,
    smallest,
    summed,
    values,
)
from hjprofile.solvers.grids.kernels.wavefront import exp_quadratic, looks_ahead, node_flux
from hjprofile.solvers.kernels import vectorised

SMALL_SLOPE = 1e-3  # |q| below which R(q) is a straight line: q/f(q) would magnify the error of a table of f


@vectorised
def survey(q, dx, law, ln_K):
    """Fill ln K at the nodes by the midpoint rule; return the quantities from which the bounds are computed.

    These are dx Σq, dx Σ|q|, min q, max q, Σ|differences of q|, min and max ln K, dx Σ K f² and Σ|differences of K f²|.
    The extremes of q include 0. If some q is not above -1, dx Σ K f² is infinite or NaN.
    """
    n = q.size
    value, row, f, df, K_z2 = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    total, size, least, most = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    sum_K_z2, variation_q, variation_K_z2 = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    exponents, factors, ln_K_min, ln_K_max = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    ln_K[n] = exponent = 0.0
    K = 1.0
    q_neighbour, K_z2_neighbour, first = q[n - 1], 0.0, True
    for stop in range(n, 0, -LANES):  # blocks of cells, and the cells within a block, run from right to left
        width = min(LANES, stop)
        if width == LANES:
            for l in range(LANES):
                value[l] = q[stop - 1 - l]
        else:
            for l in range(LANES):
                value[l] = q[stop - 1 - l] if l < width else 0.0
        if is_table(law):
            for l in range(LANES):
                row[l] = 1.0 + value[l]
            read(row, law, f, df)
        for l in range(LANES):
            z, _ = cell_law(l, value[l] * dx, dx, law, f, df)
            row[l] = z
            factors[l] = exp_quadratic(z)
            total[l] += value[l]
            size[l] += abs(value[l])
            least[l] = min(least[l], value[l])
            most[l] = max(most[l], value[l])
        for l in range(LANES):
            exponent += row[l]
            exponents[l] = exponent
            K_z2[l] = K
            K *= factors[l]
        for l in range(width):
            ln_K[stop - 1 - l] = exponents[l]
        for l in range(LANES):
            K_z2[l] *= row[l] * row[l]
            sum_K_z2[l] += K_z2[l]
            ln_K_min[l] = min(ln_K_min[l], exponents[l])
            ln_K_max[l] = max(ln_K_max[l], exponents[l])
        if first:
            first, K_z2_neighbour = False, K_z2[0]
        variation_q[0] += abs(value[0] - q_neighbour)
        variation_K_z2[0] += abs(K_z2[0] - K_z2_neighbour)
        for l in range(1, LANES):
            variation_q[l] += abs(value[l] - value[l - 1])
            variation_K_z2[l] += abs(K_z2[l] - K_z2[l - 1])
        if width < LANES:  # subtract the difference to the padding
            variation_q[width] -= abs(value[width - 1])
            variation_K_z2[width] -= K_z2[width - 1]
        q_neighbour, K_z2_neighbour = value[width - 1], K_z2[width - 1]
    return (
        dx * summed(total), dx * summed(size), smallest(least), largest(most), summed(variation_q), smallest(ln_K_min),
        largest(ln_K_max), summed(sum_K_z2) / dx, summed(variation_K_z2) / (dx * dx),
    )  # fmt: skip


@vectorised
def invariant_variation(q, dx, law):
    """Return TV(I) of I = W + R(q) at the midpoints of cells, with a neutral cell on the left.

    I_{i+1} - I_i = R(q_{i+1}) - R(q_i) + dx (q_i + q_{i+1})/2 ,   R(q) = q/f(q) ≈ 1/f' - q f''/(2 f'²) at 0
    """
    f, df = np.empty(q.size), np.empty(q.size)
    values(q, law, f, df)
    R_0 = 1.0 / slope_at_zero(law)
    R_slope = -0.5 * curvature_at_zero(law) * R_0 * R_0
    variation, q_before, R_before = 0.0, 0.0, R_0
    for i in range(q.size):
        R = q[i] / f[i] if abs(q[i]) > SMALL_SLOPE else R_0 + R_slope * q[i]
        variation += abs(R - R_before + 0.5 * dx * (q_before + q[i]))
        q_before, R_before = q[i], R
    return variation


@vectorised
def frozen_step(q, K, dx, dt, law, flux):
    """Return the cell means after one first-order step from q, and F at the nodes, with K given and no inflow.

    K is given at the nodes. The flux must not have a local viscosity at each node.
    """
    n = q.size
    after, F = np.empty(n), np.zeros(n + 1)
    d, d_right, K_here = np.zeros(LANES), np.zeros(LANES), np.ones(LANES)
    rows, p = (np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)), np.zeros(LANES)
    for start in range(0, n, LANES):
        width = min(LANES, n - start)
        for l in range(width):
            d[l] = q[start + l] * dx
            d_right[l] = q[min(start + l + 1, n - 1)] * dx
            K_here[l] = K[start + l + 1]
        if is_table(law):
            for l in range(LANES):
                p[l] = 1.0 + d[l] / dx
            read(p, law, rows[0], rows[1])
            if looks_ahead(flux):
                for l in range(LANES):
                    p[l] = 1.0 + 0.5 * (d[l] + d_right[l]) / dx
                read_f(p, law, rows[2])
        for l in range(width):
            F[start + l + 1] = node_flux(flux, law, l, K_here[l], d[l], d_right[l], 0.0, dx, rows)[2] / dx
    for i in range(n):
        after[i] = q[i] - dt / dx * (F[i + 1] - F[i])
    return after, F


@vectorised
def fastest_nearby(q, K, law):
    """Return the largest K f', with K of a node and f' of the two cells on either side of it."""
    n = q.size
    f, df = np.empty(n), np.empty(n)
    values(q, law, f, df)
    speed = 0.0
    for i in range(n + 1):
        steepest = 0.0
        for k in range(max(i - 2, 0), min(i + 2, n)):
            steepest = max(steepest, df[k])
        speed = max(speed, K[i] * steepest)
    return speed
