"""Sweeps that advance many time levels at once (docs/kernels.md).

K in a cell depends on the cells on its right at the same level, and a flux on its left neighbour at the same level. A
sweep from x = 0 to the left can therefore advance LANES levels at once if each level lags a few cells behind the
previous one. A lane holds one level. Lanes do not depend on each other within a step of the sweep, so the loop over
lanes vectorises.

Lanes are numbered from the last level to the first: lane l reads in `row[l + 1]` the value that the previous level
wrote one step earlier, and writes `row[l]`. Lanes that have not started, or have passed the left end, compute values
that are not used: a lane is initialised when it starts.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.grids.kernels.sweep_law import (
    LANES,
    Linear,
    cell_law,
    cell_law_with_mean,
    is_table,
    read,
    read_f,
    slope_at_zero,
)
from hjprofile.solvers.kernels import by_type, vectorised


class LocalLaxFriedrichs(NamedTuple):
    """F = K f(½(q⁻+q⁺)) - ½ α (q⁺-q⁻), α = K max(f'(q⁻), f'(q⁺)): f' is decreasing.

    No new mean lies outside the range of its old neighbours (up to K f² Δt), and total variation does not grow, if Δt K
    (max f' + ½ (f'(q⁺) - f'(q⁻))⁺) <= Δx with the largest K of the node and its neighbours (§12).
    """

    bound: float


class LaxFriedrichs(NamedTuple):
    """The Lax-Friedrichs flux with one α = `bound`, at least the largest K f' of all steps.

    A new mean depends on the old one by 1 - Δt/Δx (α + ½ K_{i+1} f'(mean right) - ½ K_i f'(mean left)), and the last
    two terms can amount to ½ α.
    """

    bound: float


class Godunov(NamedTuple):
    """F = K f(q⁻): all speeds are positive."""

    bound: float


class Telescoping(NamedTuple):
    """F_i = (K_{i-1} - K_i)/Δx."""

    bound: float


class Nonlocal(NamedTuple):
    """K of the state itself, accumulated from the right."""


class Given(NamedTuple):
    """K prescribed at the nodes.

    Attributes:
        k: shape (levels, nodes), or (1, nodes) if it is the same at every level.
    """

    k: np.ndarray


@vectorised
def exp_quadratic(z):
    """Return K_{i-1}/K_i for z = f Δx in schemes of first order: e^z to second order, positive and bounded below."""
    z = max(z, -1.0)
    return 1.0 + z * (1.0 + 0.5 * z)


@by_type
def K_ratio(law, z):
    """Return K_{i-1}/K_i in schemes of first order: `exp_quadratic`, or e^z for a law of linear growth (§11)."""
    return (lambda law, z: math.exp(z)) if law.instance_class is Linear else (lambda law, z: exp_quadratic(z))


@by_type
def K_ratio_derivative(law, z):
    """Return the derivative of `K_ratio` by z, at least 1: the factor of f' in the speed of the telescoping flux."""
    if law.instance_class is Linear:
        return lambda law, z: math.exp(max(z, 0.0))
    return lambda law, z: 1.0 + max(z, 0.0)


@by_type
def read_factor(factor, node, lag, k):
    """Fill k, an array of lanes, if K is prescribed: at `node` in the first level, `lag` further in each next one."""
    if factor.instance_class is Nonlocal:
        return lambda factor, node, lag, k: None

    def given(factor, node, lag, k):
        levels, nodes = factor.k.shape
        for l in range(LANES):  # idle lanes would read nodes outside the grid
            level = LANES - 1 - l
            k[l] = factor.k[min(level, levels - 1), min(max(node + lag * level, 0), nodes - 1)]

    return given


@by_type
def factor_at(own, factor, k):
    """Return K: `own`, computed from the state, or the prescribed value k."""
    return (lambda own, factor, k: own) if factor.instance_class is Nonlocal else (lambda own, factor, k: k)


@by_type
def looks_ahead(flux):
    """Return True if the flux depends on q on the right of its node."""
    central = flux.instance_class in (LocalLaxFriedrichs, LaxFriedrichs)
    return (lambda flux: True) if central else (lambda flux: False)


@by_type
def is_local(flux):
    """Return True if the flux has a local viscosity at each node; `node_flux` then returns its speed without K."""
    return (lambda flux: True) if flux.instance_class is LocalLaxFriedrichs else (lambda flux: False)


@by_type
def node_flux(flux, law, l, K, d, d_right, df_right, dx, rows):
    """Return f dx and f' left of a node, F dx, and the K f' that bounds the time step, for d = q dx on either side."""
    kind = flux.instance_class
    if kind is Godunov:

        def upwind(flux, law, l, K, d, d_right, df_right, dx, rows):
            z, df = cell_law(l, d, dx, law, rows[0], rows[1])
            return z, df, K * z, K * df

        return upwind
    if kind is Telescoping:

        def telescoping(flux, law, l, K, d, d_right, df_right, dx, rows):
            z, df = cell_law(l, d, dx, law, rows[0], rows[1])
            return z, df, K * (K_ratio(law, z) - 1.0), K * df * K_ratio_derivative(law, z)

        return telescoping
    if kind is LaxFriedrichs:

        def lax_friedrichs(flux, law, l, K, d, d_right, df_right, dx, rows):
            z, df, z_mean = cell_law_with_mean(l, d, d + d_right, dx, law, rows[0], rows[1], rows[2])
            return z, df, K * z_mean - 0.5 * flux.bound * (d_right - d), K * max(df, df_right)

        return lax_friedrichs

    def local_lax_friedrichs(flux, law, l, K, d, d_right, df_right, dx, rows):
        z, df, z_mean = cell_law_with_mean(l, d, d + d_right, dx, law, rows[0], rows[1], rows[2])
        fastest = max(df, df_right)
        return z, df, K * (z_mean - 0.5 * fastest * (d_right - d)), fastest + 0.5 * max(df_right - df, 0.0)

    return local_lax_friedrichs


@vectorised
def hj_pass(W, dx, dt, levels, inflow, law, flux, factor):
    """Advance W (nodes from left to right) by `levels` <= LANES forward Euler steps W_i -= dt F_i, in place.

    F is `inflow` at the left end. At the right end q is the same on both sides, and K is 1 unless it is prescribed.
    Return the largest K f' of all steps and ∫(K(left) - 1) dt.
    """
    n = W.size - 1
    ratio, per_dx = dt / dx, 1.0 / dx
    last = LANES - levels  # the lane of the last level
    row, right, K = np.zeros(LANES + 1), np.zeros(LANES), np.ones(LANES)
    d_right, df_right, fastest = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    K_right = np.ones(LANES)
    rows = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)  # f, f' and f at the mean, if the law is a table
    p, k_left = np.zeros(LANES), np.ones(LANES)
    right[LANES - 1] = W[n]
    toe_gain = largest_speed = 0.0
    for step in range(n + 2 * levels - 1):
        row[LANES] = W[max(n - step - 1, 0)]
        start, stop = LANES - 1 - step // 2, LANES - 1 - (step - n) // 2  # lanes at the right end, at the left end
        starts = step % 2 == 0 and start >= last
        if starts:
            K[start], fastest[start] = 1.0, 0.0
            read_factor(factor, n - step, 2, k_left)
            K[start] = factor_at(K[start], factor, k_left[start])
            K_right[start] = K[start]
            d_right[start] = right[start] - row[start + 1]
        at_left = step >= n and (step - n) % 2 == 0
        if at_left:
            height = right[stop] - dt * inflow
            toe_gain += dt * (K[stop] - 1.0)
            largest_speed = max(largest_speed, fastest[stop])
            if looks_ahead(flux):  # viscosity can spread q to the left end, next to the neutral slope
                largest_speed = max(largest_speed, K[stop] * max(slope_at_zero(law), df_right[stop]))
        if is_table(law):
            for l in range(LANES):
                p[l] = 1.0 + (right[l] - row[l + 1]) * per_dx
            read(p, law, rows[0], rows[1])
            if looks_ahead(flux):
                for l in range(LANES):
                    p[l] = 1.0 + (d_right[l] + (right[l] - row[l + 1])) * (0.5 * per_dx)
                read_f(p, law, rows[2])
        read_factor(factor, n - 1 - step, 2, k_left)
        if looks_ahead(flux) and starts:
            _, df_right[start] = cell_law(start, d_right[start], dx, law, rows[0], rows[1])
        for l in range(LANES):
            here, left = right[l], row[l + 1]
            right[l] = left
            d = here - left
            z, df, F, speed = node_flux(flux, law, l, K[l], d, d_right[l], df_right[l], dx, rows)
            row[l] = here - ratio * F
            K_left = K[l] * K_ratio(law, z)
            K_left = factor_at(K_left, factor, k_left[l])
            if is_local(flux):
                speed *= max(max(K_left, K_right[l]), K[l])
                K_right[l] = K[l]
            if looks_ahead(flux):
                d_right[l], df_right[l] = d, df
            fastest[l] = max(fastest[l], speed)
            K[l] = K_left
        if at_left:
            row[stop] = height
        done = n - step + 2 * (levels - 1)
        if done <= n:
            W[done] = row[last]
    return largest_speed, toe_gain
