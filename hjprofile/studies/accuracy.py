"""Norms of differences between runs, and observed orders of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.lists import as_numbers, same_length
from hjprofile.problem.ranges import SAME_TIME, instance, shown
from hjprofile.problem.units import Units
from hjprofile.solvers.run import Array, KinkRecord, Run

ABOUT = "a-check-or-a-study"
DETECTED_JUMP = 0.25  # jump above which every method detects a kink on a few hundred cells


class Comparison(NamedTuple):
    """Distances of two runs over all shared saved times, including t = 0 if it is shared.

    Times that differ by rounding only count as equal. All values are dimensionless.

    Attributes:
        slope_l1: ∫|(D u₁ - 1) - q₂| dx, where D u is the difference quotient on the cells; the mean over the times.
        slope_max: sup|(D u₁ - 1) - q₂|, the largest of all times.
        height_l1: ∫|u₁ - u₂| dx, the mean over the times.
        height_sup: sup|u₁ - u₂|, the largest of all times.
        kinks: |x₁ - x₂| of the kinks whose jump exceeds 0.25, the mean over those times after the start at which both
            runs have the same number of them; NaN if there are none.
        shared_times: number of these times.
    """

    slope_l1: float
    slope_max: float
    height_l1: float
    height_sup: float
    kinks: float
    shared_times: int


class Shared(NamedTuple):
    """Two runs on their common grid and at their shared times.

    Attributes:
        first, second: indices of the shared times in each run, shape (times,).
        x, x_cell: nodes and midpoints of the coarser grid.
        height: u of both runs there, shape (2, times, cells + 1).
        slope: q of both runs, means over the cells of the coarser grid, shape (2, times, cells). For the first run it
            is D u - 1, with D the difference quotient, so that a comparison with the conservation law compares two
                equations.
        units: of the survey of both runs; None if one of them has none.
    """

    first: Array
    second: Array
    x: Array
    x_cell: Array
    height: Array
    slope: Array
    units: Units | None


def shared(first: Run, second: Run) -> Shared:
    """Return both runs on their common grid and at their shared times.

    The grids must be the same, or one a refinement of the other by an integer factor. Raise InputError otherwise, or if
    the runs share no saved time, or are of surveys in different units.
    """
    if first.units and second.units and not first.units.same(second.units):
        raise InputError(
            f"the runs are of surveys in different units ({first.units}; and {second.units}), so equal numbers are "
            "not equal lengths; compare runs with the same length, critical_slope and crest",
            ABOUT,
        )
    i, j = _shared_times(first.time, second.time)
    if i.size == 0:
        raise InputError("the runs share no saved time, so they cannot be compared", ABOUT)
    cells = min(first.cells, second.cells)
    ends = [(float(run.x[0]), float(run.x[-1]) + 0.0) for run in (first, second)]
    if ends[0] != ends[1]:
        (a, b), (c, d) = ends
        raise InputError(
            f"grids over [{a:g}, {b:g}] and [{c:g}, {d:g}] differ, so the runs cannot be compared; set left (on the "
            "whole line also right) to the same value in both cases",
            ABOUT,
        )
    if first.cells % cells or second.cells % cells:
        raise InputError(
            f"grids of {first.cells} and {second.cells} cells do not nest, so they cannot be compared", ABOUT
        )
    coarse = first if first.cells == cells else second
    height = np.stack([run.u[at][:, :: run.cells // cells] for run, at in ((first, i), (second, j))])
    dx = float(np.ptp(first.x)) / cells
    means = second.q[j].reshape(j.size, cells, -1).mean(axis=2)
    slope = np.stack([np.diff(height[0], axis=1) / dx - 1.0, means])
    return Shared(i, j, coarse.x, coarse.x_cell, height, slope, first.units if second.units else None)


def _shared_times(first: Array, second: Array) -> tuple[Array, Array]:
    """Return the indices, in each of the lists, of the times that are in both to rounding; each is used once."""
    nearest = np.searchsorted(0.5 * (second[1:] + second[:-1]), first)
    near = np.flatnonzero(np.abs(first - second[nearest]) <= SAME_TIME * max(first[-1], second[-1]))
    j, once = np.unique(nearest[near], return_index=True)
    return near[once], j


def compare(first: Run, second: Run) -> Comparison:
    """Return the distances of two runs on the coarser of their grids and at their shared saved times.

    - `first`, `second`: runs over the same interval; the number of cells of one is a multiple of that of the other.

    Return a `Comparison`. Raise InputError if the grids differ in their ends or do not nest. Raise it also if the runs
    share no saved time, or are of surveys in different units.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> coarse, fine = (hj.track_fronts(problem, hj.Grid(left=-5.0, cells=n)) for n in (100, 200))
    >>> hj.compare(coarse, fine).height_sup < 1e-12
    True
    """
    for run in (first, second):
        instance("run", run, Run)
    both = shared(first, second)
    dx = float(np.ptp(both.x)) / both.x_cell.size
    height, slope = both.height[0] - both.height[1], both.slope[0] - both.slope[1]
    moments = zip(both.first.tolist(), both.second.tolist(), strict=True)
    apart = [kink_distances(first.kinks_at(i), second.kinks_at(j)) for i, j in moments if first.time[i] > 0]
    pairs = np.concatenate(apart) if apart else np.empty(0)
    return Comparison(
        slope_l1=float(np.mean(dx * np.abs(slope).sum(axis=1))),
        slope_max=float(np.max(np.abs(slope))),
        height_l1=float(np.mean(dx * np.abs(height).sum(axis=1))),
        height_sup=float(np.max(np.abs(height))),
        kinks=float(np.mean(pairs)) if pairs.size else float("nan"),
        shared_times=both.first.size,
    )


def kink_distances(first: Sequence[KinkRecord], second: Sequence[KinkRecord]) -> Array:
    """Return |x₁ - x₂| of the kinks stronger than STRONG at one time, from the left; empty if their numbers differ."""
    places = [np.sort([k.x for k in kinks if k.jump > DETECTED_JUMP]) for kinks in (first, second)]
    return np.abs(places[0] - places[1]) if places[0].size == places[1].size else np.empty(0)


def observed_order(cells: Sequence[float], errors: Sequence[float]) -> float:
    """Return the observed order of convergence: the slope of -ln(error) over ln(cells) by least squares.

    - `cells`: numbers of cells, or of fronts, of each run.
    - `errors`: the error of each run.

    Return NaN if an error or a number of cells is not positive and finite, or if there are fewer than two different
    numbers of cells. Raise InputError if the two lists differ in length.

    >>> import hjprofile as hj
    >>> round(hj.observed_order([100, 200, 400], [4e-2, 2e-2, 1e-2]), 6)
    1.0
    """
    n, e = as_numbers(cells), as_numbers(errors)
    if n is None or e is None:
        raise InputError(f"cells = {shown(cells)} and errors = {shown(errors)} must be lists of numbers", ABOUT)
    same_length(cells=n, errors=e)
    if np.unique(n).size < 2 or not np.all((n > 0) & np.isfinite(e) & (e > 0)):
        return float("nan")
    return float(-np.polyfit(np.log(n), np.log(e), 1)[0])
