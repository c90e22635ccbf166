"""MUSCL-Hancock sweep: second-order steps for q and K, many time levels at once (`kernels.wavefront`)."""

import math

import numpy as np

from hjprofile.solvers.grids.kernels.grid_loops import FLOOR_SHARE
from hjprofile.solvers.grids.kernels.sweep_law import LANES, cell_law, is_table, read
from hjprofile.solvers.grids.kernels.wavefront import Nonlocal, factor_at, read_factor
from hjprofile.solvers.kernels import by_type, vectorised


@vectorised
def exp_quartic(z):
    """Return e^z to fourth order, for the second-order scheme: z³ is not small where deposition is fast."""
    z = max(z, -1.0)
    return 1.0 + z * (1.0 + z * (0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0))))


@by_type
def factor_at_midpoint(K, z, factor, k):
    """Return K at the midpoint of a cell and its relative increase to the left.

    K is given on the right of the cell, with z = f dx and with k, the prescribed K on the left of the cell.
    """
    if factor.instance_class is Nonlocal:
        return lambda K, z, factor, k: (K * (1.0 + 0.5 * z), z)

    def given(K, z, factor, k):
        middle = 0.5 * (k + K)
        return middle, (k - K) / middle

    return given


@vectorised
def limited(behind, ahead):
    """Return half the rise over a cell by the MC limiter: the central rise, bounded by the neighbours' rises."""
    half = min(min(abs(behind), abs(ahead)), 0.25 * abs(behind + ahead))
    return math.copysign(half, ahead) if behind * ahead > 0.0 else 0.0


@vectorised
def hancock_pass(q, dx, dt, levels, inflow, law, factor):
    """Advance cell means q (from left to right) by `levels` <= LANES MUSCL-Hancock steps, in place.

    A step advances q and K by half a time step by q_t = -K_x f - K f' q_x, and evaluates the flux there. K follows from
    the midpoint rule, or is prescribed for that half step. At either end of the grid slopes are one-sided; the flux is
    `inflow` at the left end. No edge value differs from its mean by more than FLOOR_SHARE of 1 + q, which guarantees q
    > -1. Return the largest K f' of all steps, ∫(K(left) - 1) dt and ∫F(right) dt.
    """
    n = q.size
    ratio = dt / dx
    last = LANES - levels
    row, here, ahead, K = np.zeros(LANES + 1), np.zeros(LANES), np.zeros(LANES), np.ones(LANES)
    edge, z, flux, fastest = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    f, df, f_edge, df_edge, p = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    k_left = np.ones(LANES)
    here[LANES - 1] = q[n - 1]
    toe_gain = crest_lowering = largest_speed = 0.0
    for step in range(n + 3 * levels - 2):
        row[LANES] = q[max(n - step - 2, 0)]
        start = LANES - 1 - step // 3
        starts = step % 3 == 0 and start >= last
        if starts:
            K[start], fastest[start] = 1.0, 0.0
            read_factor(factor, n - step, 3, k_left)
            K[start] = factor_at(K[start], factor, k_left[start])
            ahead[start] = 2.0 * here[start] - row[start + 1]
        first, beyond = LANES - 1 - (step - n + 1) // 3, LANES - 1 - (step - n) // 3
        if step >= n - 1 and (step - n + 1) % 3 == 0:  # the sweep has reached the first cell
            row[first + 1] = 2.0 * here[first] - ahead[first]
        finishes = step >= n and (step - n) % 3 == 0
        if finishes:  # one cell further, the new value of the first cell is complete
            value = ahead[beyond] - ratio * (flux[beyond] - inflow)
            toe_gain += dt * (K[beyond] - 1.0)
            largest_speed = max(largest_speed, fastest[beyond])
        read_factor(factor, n - 1 - step, 3, k_left)
        if is_table(law):
            for l in range(LANES):
                p[l] = 1.0 + here[l]
            read(p, law, f, df)
        for l in range(LANES):
            f_here, df_here = cell_law(l, here[l], 1.0, law, f, df)
            half = limited(here[l] - row[l + 1], ahead[l] - here[l])
            most = FLOOR_SHARE * (1.0 + here[l])
            half = max(min(half, most), -most)
            z_here = f_here * dx
            middle, drop = factor_at_midpoint(K[l], z_here, factor, k_left[l])
            rise = middle * (0.5 * ratio * f_here * drop - ratio * df_here * half)
            edge[l] = here[l] + half + rise
            z[l] = z_here + df_here * rise * dx
            df[l] = df_here
        if is_table(law):
            for l in range(LANES):
                p[l] = 1.0 + edge[l]
            read(p, law, f_edge, df_edge)
        for l in range(LANES):
            left = row[l + 1]  # before it is overwritten
            f_out, df_out = cell_law(l, edge[l], 1.0, law, f_edge, df_edge)
            F = K[l] * f_out
            row[l] = ahead[l] - ratio * (flux[l] - F)
            flux[l] = F
            fastest[l] = max(fastest[l], K[l] * max(df[l], df_out))
            K[l] *= exp_quartic(z[l])
            K[l] = factor_at(K[l], factor, k_left[l])
            ahead[l], here[l] = here[l], left
        if starts:
            crest_lowering += dt * flux[start]
        if finishes:
            row[beyond] = value
        done = n - step + 3 * (levels - 1)
        if done < n:
            q[done] = row[last]
    return largest_speed, toe_gain, crest_lowering
