"""Norms of differences between runs, and observed orders of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.solvers.run import Array, Run

STRONG = 0.25  # jump above which every method here sees a kink on a few hundred cells


class Comparison(NamedTuple):
    """How far two runs are apart; each norm is a mean over the saved times, `_max` the largest of them.

    Attributes:
        slope_l1, slope_max: ∫|(D u₁ - 1) - q₂| dx, where D u is the difference quotient on the cells, and its supremum.
        height_l1, height_sup: ∫|u₁ - u₂| dx and sup|u₁ - u₂|.
        kinks: |x₁ - x₂| over kinks stronger than STRONG, at times after the start when both runs see as many; NaN if
            there are none.
    """

    slope_l1: float
    slope_max: float
    height_l1: float
    height_sup: float
    kinks: float


def compare(first: Run, second: Run) -> Comparison:
    """Differentiates the first run's u and compares it with the second's q; compares u and the kinks.

    The grids must be the same, or one a refinement of the other by a whole number. Raises InputError otherwise, or if
    the runs share no saved time.
    """
    times, i, j = np.intersect1d(first.time, second.time, return_indices=True)
    if times.size == 0:
        raise InputError("the runs share no saved time, so they cannot be compared")
    cells = min(first.cells, second.cells)
    if first.cells % cells or second.cells % cells or first.x[0] != second.x[0]:
        raise InputError(f"grids of {first.cells} and {second.cells} cells do not nest, so they cannot be compared")
    a, b = first.u[i][:, :: first.cells // cells], second.u[j][:, :: second.cells // cells]
    dx = float(np.ptp(first.x)) / cells
    slope = np.diff(a, axis=1) / dx - 1.0 - second.q[j].reshape(times.size, cells, -1).mean(axis=2)
    apart = [_kink_distances(first, second, t) for t in times if t > 0]
    pairs = np.concatenate(apart) if apart else np.empty(0)
    return Comparison(
        slope_l1=float(np.mean(dx * np.abs(slope).sum(axis=1))),
        slope_max=float(np.max(np.abs(slope))),
        height_l1=float(np.mean(dx * np.abs(a - b).sum(axis=1))),
        height_sup=float(np.mean(np.abs(a - b).max(axis=1))),
        kinks=float(np.mean(pairs)) if pairs.size else float("nan"),
    )


def _kink_distances(first: Run, second: Run, time: float) -> Array:
    places = [np.sort([k.x for k in run.kinks if k.time == time and k.jump > STRONG]) for run in (first, second)]
    return np.abs(places[0] - places[1]) if places[0].size == places[1].size else np.empty(0)


def observed_order(cells: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of -ln(error) over ln(cells) by least squares; NaN if an error is zero or not finite."""
    e = np.asarray(errors, dtype=float)
    if not np.all(np.isfinite(e) & (e > 0)):
        return float("nan")
    return float(-np.polyfit(np.log(np.asarray(cells, dtype=float)), np.log(e), 1)[0])
