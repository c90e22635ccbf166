"""Nanoseconds per cell and step of every sweep, of the obvious loop and of a local equation, side by side.

python -m pytest tests/benchmarks/bench_kernels.py --benchmark-group-by=param:cells
"""

import loops
import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.grids.grid_law import grid_law
from hjprofile.solvers.grids.kernels.hancock import hancock_pass
from hjprofile.solvers.grids.kernels.wavefront import (
    LANES,
    Godunov,
    LaxFriedrichs,
    LocalLaxFriedrichs,
    Nonlocal,
    Telescoping,
    hj_pass,
)

LEVELS = LANES
RATIONAL = grid_law(hj.rational(), np.zeros(1)).kernel
TABLE = grid_law(hj.log(), np.array([0.0, 1.0])).kernel


def kink(cells):
    """W and q of one kink on [-10, 0], with dx and a stable step."""
    dx = 10.0 / cells
    W = -np.expm1(-np.maximum(np.linspace(-10.0, 0.0, cells + 1) + 6.0, 0.0))
    return W, np.diff(W) / dx, dx, 0.4 * dx


def sweep(kernel, flux, law):
    def steps(cells):
        W, _, dx, dt = kink(cells)
        return lambda: kernel(W.copy(), dx, dt, LEVELS, 0.0, law, flux(2.5), Nonlocal())

    return steps


def second_order_sweep(kernel, law):
    def steps(cells):
        _, q, dx, dt = kink(cells)
        return lambda: kernel(q.copy(), dx, dt, LEVELS, 0.0, law, Nonlocal())

    return steps


def obvious(loop, form):
    def steps(cells):
        W, q, dx, dt = kink(cells)
        return lambda: loop((W if form == "W" else q).copy(), dx, dt, LEVELS)

    return steps


KERNELS = {
    "obvious godunov": obvious(loops.godunov, "W"),
    "godunov": sweep(hj_pass, Godunov, RATIONAL),
    "godunov, K = 1": sweep(loops.with_K_one(hj_pass), Godunov, RATIONAL),
    "godunov, log law": sweep(hj_pass, Godunov, TABLE),
    "telescoping": sweep(hj_pass, Telescoping, RATIONAL),
    "obvious local-lax-friedrichs": obvious(loops.local_lax_friedrichs, "W"),
    "local-lax-friedrichs": sweep(hj_pass, LocalLaxFriedrichs, RATIONAL),
    "local-lax-friedrichs, K = 1": sweep(loops.with_K_one(hj_pass), LocalLaxFriedrichs, RATIONAL),
    "local-lax-friedrichs, log law": sweep(hj_pass, LocalLaxFriedrichs, TABLE),
    "lax-friedrichs": sweep(hj_pass, LaxFriedrichs, RATIONAL),
    "obvious conservative": obvious(loops.muscl_hancock, "q"),
    "conservative": second_order_sweep(hancock_pass, RATIONAL),
    "conservative, K = 1": second_order_sweep(loops.with_K_one(hancock_pass), RATIONAL),
    "conservative, log law": second_order_sweep(hancock_pass, TABLE),
}


@pytest.mark.parametrize("cells", [1_000, 10_000, 100_000, 1_000_000])
@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel(benchmark, kernel, cells):
    steps = KERNELS[kernel](cells)
    benchmark.pedantic(steps, rounds=5, warmup_rounds=1)
    benchmark.extra_info["ns per cell and step"] = 1e9 * benchmark.stats.stats.median / (cells * LEVELS)
