"""Erosion law of the grid solvers: the rational law by its formula, any other as a table made once per run.

A table costs the same for every law, needs no compilation, and is computed from the values of f, so it cannot outlive
an edited law. Its error is about 1e-12 of the scale of f if f is four times differentiable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hjprofile.problem.erosion import Array, ErosionLaw, Function
from hjprofile.solvers.grids.kernels.grid_loops import exponent, fastest
from hjprofile.solvers.grids.kernels.sweep_law import LANES, PIECES, SHIFT, Linear, Rational, Tabulated, values

HEADROOM = 5  # binades of 1 + q in a table above the data, because q grows along characteristics
BLOCK = 1 << 14  # cells for which temporary arrays are made at once, 128 kB each
STEEPEST = 32  # binades of 1 + q in the table of a law of linear growth: a jump of u in one cell is q = m/Δx


@dataclass(frozen=True)
class GridLaw:
    """f and f' for arrays, and `kernel`, the form for compiled loops; valid for slopes up to `q_most`."""

    law: ErosionLaw
    f: Function
    derivative: Function
    kernel: Rational | Tabulated
    q_most: float

    def covering(self, q: Array) -> GridLaw:
        """Return the law for slopes that have reached q: itself, or a wider table with the same values."""
        return self if 4.0 * q.max() < self.q_most else grid_law(self.law, q)

    def fill_K(self, q: Array, dx: float, K: Array) -> None:
        """Fill K at the nodes from q on the cells by the midpoint rule; it may overflow to infinity."""
        K[-1] = 0.0
        for a, b in blocks(q.size):
            exponent(self.f(q[a:b]), dx, K[a : b + 1])
        with np.errstate(over="ignore"):
            np.exp(K, out=K)

    def fastest(self, q: Array, K: Array) -> float:
        """Return the largest K f', with each cell's f' and the larger K of its two nodes."""
        speeds = [fastest(K[a : b + 1], self.derivative(q[a:b])) for a, b in blocks(q.size)]
        return float(np.max(speeds) if len(speeds) > 1 else speeds[0])  # NaN if one of them is


def blocks(cells: int) -> Iterator[tuple[int, int]]:
    """Yield the ends of blocks of cells, from right to left, so that temporary arrays are small on any grid."""
    for b in range(cells, 0, -BLOCK):
        yield max(b - BLOCK, 0), b


def grid_law(law: ErosionLaw, q: Array) -> GridLaw:
    """Return the law for runs from data q, for slopes from the smallest q up to 2^HEADROOM times the largest 1 + q."""
    if law.name == "rational":
        return GridLaw(law, law.f, law.derivative, Rational(), np.inf)
    least, most = min(float(np.min(q)), 0.0), max(float(np.max(q)), 0.0)
    low, high = (int(np.floor(np.log2(1.0 + bound))) for bound in (least, most))
    first = (1023 + low - 1) << PIECES
    high = max(high + HEADROOM, STEEPEST if law.grows_linearly else 0)
    pieces = (high - low + 2) << PIECES
    ends = ((first + np.arange(pieces + 1)) << SHIFT).view(np.float64)
    h = np.diff(ends)
    with np.errstate(all="ignore"):
        at_ends, slopes = np.array(law.f(ends - 1.0)), law.derivative(ends - 1.0)
    at_ends[np.searchsorted(ends, 1.0)] = 0.0  # f(0) = 0: the neutral slope must not change
    left, right = slopes[:-1], slopes[1:]  # the cubic has the values and the slopes of f at both ends
    mean = np.diff(at_ends) / h
    c = np.column_stack([at_ends[:-1], left, (3.0 * mean - 2.0 * left - right) / h, (left + right - 2.0 * mean) / h**2])
    work = np.zeros(LANES, np.uint64), np.zeros(4 * LANES)
    kernel = (Linear if law.grows_linearly else Tabulated)(c.ravel(), first, *work)

    def f(q):
        return _values(q, kernel)[0]

    def derivative(q):
        return _values(q, kernel)[1]

    return GridLaw(law, f, derivative, kernel, float(ends[-1]) - 1.0)


def _values(q: Array, kernel: Tabulated) -> tuple[Array, Array]:
    """Return f and f' at q from the table."""
    f, df = np.empty(q.shape), np.empty(q.shape)
    values(q.ravel(), kernel, f.ravel(), df.ravel())
    return f, df
