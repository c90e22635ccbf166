"""What the sweeps are measured against: the obvious compiled loops, and the same sweeps for a local equation."""

from __future__ import annotations

import inspect
import math

import numba
import numpy as np

compiled = numba.njit(cache=True, error_model="numpy")


@compiled
def godunov(W, dx, dt, steps):
    """First order, upwind, K by exp: a pass for fluxes and one for the update."""
    n = W.size - 1
    F = np.zeros(n + 1)
    for _ in range(steps):
        exponent = 0.0
        for i in range(n, 0, -1):
            q = (W[i] - W[i - 1]) / dx
            f = q / (1.0 + q)
            F[i] = math.exp(exponent) * f
            exponent += f * dx
        for i in range(1, n + 1):
            W[i] -= dt * F[i]


@compiled
def local_lax_friedrichs(W, dx, dt, steps):
    n = W.size - 1
    F = np.zeros(n + 1)
    for _ in range(steps):
        exponent = 0.0
        right = (W[n] - W[n - 1]) / dx
        for i in range(n, 0, -1):
            q = (W[i] - W[i - 1]) / dx
            mean = 0.5 * (q + right)
            slope = max(1.0 / (1.0 + q) ** 2, 1.0 / (1.0 + right) ** 2)
            F[i] = math.exp(exponent) * (mean / (1.0 + mean) - 0.5 * slope * (right - q))
            exponent += q / (1.0 + q) * dx
            right = q
        for i in range(1, n + 1):
            W[i] -= dt * F[i]


@compiled
def muscl_hancock(q, dx, dt, steps):
    """Second order, K at the half step by exp."""
    n = q.size
    F = np.zeros(n + 1)
    for _ in range(steps):
        exponent = 0.0
        for i in range(n - 1, -1, -1):
            ahead = q[i + 1] - q[i] if i < n - 1 else q[i] - q[i - 1]
            back = q[i] - q[i - 1] if i > 0 else q[i + 1] - q[i]
            half = 0.0
            if ahead * back > 0.0:
                half = math.copysign(min(abs(ahead), abs(back), 0.25 * abs(ahead + back)), ahead)
            half = max(-0.5 * (1.0 + q[i]), min(0.5 * (1.0 + q[i]), half))
            K = math.exp(exponent)
            f, slope = q[i] / (1.0 + q[i]), 1.0 / (1.0 + q[i]) ** 2
            rise = 0.5 * dt * K * (1.0 + 0.5 * f * dx) * (f * f - slope * 2.0 * half / dx)
            edge = q[i] + half + rise
            F[i + 1] = K * edge / (1.0 + edge)
            exponent += (f + slope * rise) * dx
        for i in range(n):
            q[i] -= dt / dx * (F[i + 1] - F[i])


def with_K_one(kernel):
    """A sweep compiled from its source without the lines that carry K along."""
    lines = inspect.getsource(kernel.py_func).splitlines()
    kept = [line for line in lines if not line.strip().startswith("K[l] ") and line != "@vectorised"]
    assert len(lines) - len(kept) in (2, 3)  # the decorator, and one line or two
    names = dict(kernel.py_func.__globals__)
    exec("\n".join(kept), names)
    return numba.njit(error_model="numpy", fastmath={"contract"})(names[kernel.py_func.__name__])
