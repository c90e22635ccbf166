"""Norms of differences between runs, and observed orders of convergence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.lists import as_numbers, same_length
from hjprofile.problem.ranges import SAME_TIME, instance, shown
from hjprofile.problem.units import Units
from hjprofile.solvers.run import Array, KinkRecord, Run

SAME_SLOPE = "compare runs of the same slope, with the same origin of x"
ABOUT = "a-check-or-a-study"
NEUTRAL = 1e-6  # |q| up to which a slope is neutral; rounding of the data is smaller
DETECTED_JUMP = 0.25  # jump above which every method detects a kink on a few hundred cells


class Comparison(NamedTuple):
    """Distances of two runs over all shared saved times, including t = 0 if it is shared.

    Times that differ by rounding only count as equal. All values are dimensionless if `unit` is "". Otherwise the runs
    are of surveys with different exchange lengths, critical slopes or crests, and positions, heights and slopes (height
    over length) are those of the surveys.

    Attributes:
        slope_l1: ∫|(D u₁ - 1) - q₂| dx, where D u is the difference quotient on the cells; the mean over the times.
        slope_max: sup|(D u₁ - 1) - q₂|, the largest of all times.
        height_l1: ∫|u₁ - u₂| dx, the mean over the times.
        height_sup: sup|u₁ - u₂|, the largest of all times.
        kinks: |x₁ - x₂| of the kinks whose jump exceeds 0.25, the mean over those times after the start at which both
            runs have the same number of them; NaN if there are none.
        shared_times: number of these times, or of equal supplied volumes.
        interpolated: number of those at which the second run is linear between two of its saved times.
        unit: the unit of lengths: "" for exchange lengths, else the name of the surveys' unit, or "survey units".
    """

    slope_l1: float
    slope_max: float
    height_l1: float
    height_sup: float
    kinks: float
    shared_times: int
    interpolated: int = 0
    unit: str = ""


class Shared(NamedTuple):
    """Two runs on their common grid and at their shared times.

    Attributes:
        first, second: indices of the shared times in each run, shape (times,). In `second` -1 stands for a time at
            which that run is interpolated.
        time: these times, shape (times,); supplied volumes per unit width if `metric`.
        x, x_cell: nodes and midpoints of the coarser grid.
        height: u of both runs there, shape (2, times, cells + 1).
        slope: q of both runs, means over the cells of the coarser grid, shape (2, times, cells). For the first run it
            is D u - 1, with D the difference quotient, so that a comparison with the conservation law compares two
            equations.
        kinks: at each time the distances of the kinks of both runs, as `kink_distances` returns them.
        units: of the survey of both runs; None if one of them has none.
        metric: True if the arrays are in the surveys' unit, because the units of the runs differ. Slopes are then
            height over length, and the nodes are those of the run with the wider cells on the common ground.
    """

    first: Array
    second: Array
    x: Array
    x_cell: Array
    height: Array
    slope: Array
    units: Units | None
    time: Array
    kinks: Sequence[Array]
    metric: bool = False


def shared(first: Run, second: Run) -> Shared:
    """Return both runs on their common grid and at their shared times.

    Two runs with different units are compared on their common ground at equal supplied volumes. For others the grids
    must be the same, or one a refinement of the other by an integer factor. Raise InputError otherwise, or if the runs
    share no saved time or no ground, or if the unit of length has different names.
    """
    if first.units and second.units:
        names = {first.units.unit, second.units.unit} - {""}
        if len(names) > 1:
            raise InputError(
                f"the runs are of surveys in {first.units.unit} and in {second.units.unit}; convert one of the surveys "
                "to the unit of the other, and run it again",
                ABOUT,
            )
        if not first.units.same(second.units):
            return _on_common_ground(first, second, first.units, second.units)
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
    units = _named(first.units, second.units) if first.units and second.units else None
    kinks = [kink_distances(first.kinks_at(a), second.kinks_at(b)) for a, b in zip(i.tolist(), j.tolist(), strict=True)]
    return Shared(i, j, coarse.x, coarse.x_cell, height, slope, units, first.time[i], kinks)


def _named(first: Units, second: Units) -> Units:
    """Return the units of the first run, with the name of the second if the first has none."""
    return replace(first, unit=first.unit or second.unit)


def _on_common_ground(first: Run, second: Run, units: Units, others: Units) -> Shared:
    """Return both runs of surveys with different units, in the surveys' unit.

    Heights are linear between nodes, and slopes are exact means of the piecewise constant ones. Raise InputError if the
    runs share no ground or no supplied volume.
    """
    if units.direction != others.direction:
        raise InputError(
            f"the runs share no ground: one slope rises to the {units.uphill}, the other to the {others.uphill}; "
            f"{SAME_SLOPE}",
            ABOUT,
        )
    places = units.direction * units.x(first.x), others.direction * others.x(second.x)  # both increase uphill
    x = _common_nodes(places, (first.q[0], second.q[0]))
    i, j, volumes = _shared_volumes(units.volume * first.time, others.volume * second.time)
    if i.size == 0:
        raise InputError("the runs share no supplied volume, so they cannot be compared", ABOUT)
    t = volumes / others.volume
    height = np.stack([
        _rows(lambda u: units.height(np.interp(x, places[0], u)), first.u[i]),
        _rows(lambda u: others.height(np.interp(x, places[1], u)), _at_times(second.time, second.u, t, j)),
    ])  # fmt: skip
    dx = float(x[-1] - x[0]) / (x.size - 1)
    sums = np.cumsum(np.diff(places[1]) * others.slope(_at_times(second.time, second.q, t, j)), axis=1)
    rises = np.concatenate([np.zeros((t.size, 1)), sums], axis=1)
    means = np.diff(_rows(lambda rise: np.interp(x, places[1], rise), rises), axis=1) / dx
    slope = np.stack([np.diff(height[0], axis=1) / dx, means])
    kinks = [
        kink_distances(first.kinks_at(a), second.kinks_at(b), units, others) if b >= 0 else np.empty(0)
        for a, b in zip(i.tolist(), j.tolist(), strict=True)
    ]
    x = units.direction * x
    return Shared(i, j, x, 0.5 * (x[1:] + x[:-1]), height, slope, _named(units, others), volumes, kinks, metric=True)


def _common_nodes(places: tuple[Array, Array], q: tuple[Array, Array]) -> Array:
    """Return the nodes of the coarser grid on the ground that both runs cover, two or more.

    Left of its data, at which q = 0 ends, each run continues with its own neutral slope. That part never changes and is
    not ground. Raise InputError if there is no common ground.
    """
    away = [np.flatnonzero(np.abs(means) > NEUTRAL) for means in q]
    starts = [x[min(cells[0] + 1, x.size - 2)] if cells.size else x[0] for x, cells in zip(places, away, strict=True)]
    ends = [x[-1] for x in places]
    dx = [float(np.ptp(x)) / (x.size - 1) for x in places]
    coarse, hair = places[int(dx[1] > dx[0])], 1e-6 * min(dx)
    x = coarse[(coarse >= max(starts) - hair) & (coarse <= min(ends) + hair)]
    if x.size < 2:
        raise InputError(
            f"the runs share no ground: the data of one cover x = {starts[0]:g} to {ends[0]:g}, those of the other "
            f"x = {starts[1]:g} to {ends[1]:g}; {SAME_SLOPE}",
            ABOUT,
        )
    return x


def _rows(change: Callable[[Array], Array], rows: Array) -> Array:
    return np.array([change(row) for row in rows])


def _shared_volumes(first: Array, second: Array) -> tuple[Array, Array, Array]:
    """Return indices of supplied volumes in both lists, and the volumes.

    They are the volumes that both lists hold to rounding. If they share none after the start, they are those of the
    first list in the range of the second, with the index -1 in the second where it does not hold the volume.
    """
    i, j = _shared_times(first, second)
    if np.any(first[i] > 0.0):
        return i, j, first[i]
    hair = SAME_TIME * max(first[-1], second[-1])
    inside = np.flatnonzero((first >= second[0] - hair) & (first <= second[-1] + hair))
    known = dict(zip(i.tolist(), j.tolist(), strict=True))
    return inside, np.array([known.get(k, -1) for k in inside.tolist()], dtype=int), first[inside]


def _at_times(time: Array, values: Array, at: Array, known: Array) -> Array:
    """Return rows of values at times, linear between the saved ones; row k of `known` is exact unless -1."""
    after = np.clip(np.searchsorted(time, at), 1, max(time.size - 1, 1))
    before = after - 1
    after = np.minimum(after, time.size - 1)
    width = np.where(after > before, time[after] - time[before], 1.0)
    part = np.clip((at - time[before]) / width, 0.0, 1.0)[:, None]
    between = (1.0 - part) * values[before] + part * values[after]
    return np.where((known >= 0)[:, None], values[known], between)


def _shared_times(first: Array, second: Array) -> tuple[Array, Array]:
    """Return the indices, in each of the lists, of the times that are in both to rounding; each is used once."""
    nearest = np.searchsorted(0.5 * (second[1:] + second[:-1]), first)
    near = np.flatnonzero(np.abs(first - second[nearest]) <= SAME_TIME * max(first[-1], second[-1]))
    j, once = np.unique(nearest[near], return_index=True)
    return near[once], j


def compare(first: Run, second: Run) -> Comparison:
    """Return the distances of two runs on the coarser of their grids and at their shared saved times.

    - `first`, `second`: runs over the same interval; the number of cells of one is a multiple of that of the other.

    Runs of surveys with different exchange lengths, critical slopes or crests are compared in the surveys' unit. They
    are compared on the ground that both cover, at supplied volumes that both have saved. If these are none after the
    start, they are the volumes of the first run, and the second is linear between its saved times.

    Return a `Comparison`. Raise InputError if the grids differ in their ends or do not nest. Raise it also if the runs
    share no saved time or no ground, or if the units of two surveys have different names.

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
    apart = [distances for distances, t in zip(both.kinks, both.time, strict=True) if t > 0]
    pairs = np.concatenate(apart) if apart else np.empty(0)
    return Comparison(
        slope_l1=float(np.mean(dx * np.abs(slope).sum(axis=1))),
        slope_max=float(np.max(np.abs(slope))),
        height_l1=float(np.mean(dx * np.abs(height).sum(axis=1))),
        height_sup=float(np.max(np.abs(height))),
        kinks=float(np.mean(pairs)) if pairs.size else float("nan"),
        shared_times=both.first.size,
        interpolated=int(np.count_nonzero(both.second < 0)),
        unit=both.units.label if both.units and both.metric else "",
    )


def in_survey_units(norms: Comparison, first: Run, second: Run) -> dict[str, float | str] | None:
    """Return ∫|Δ height| dx, sup|Δ height| and the distance of kinks in the surveys' unit, which is named.

    Return None unless both runs have units.
    """
    if not (first.units and second.units):
        return None
    units = _named(first.units, second.units)
    area, rise, length = (1.0, 1.0, 1.0) if norms.unit else (units.volume, units.rise, units.length)
    found = {"height_l1": area * norms.height_l1, "height_sup": rise * norms.height_sup, "kinks": length * norms.kinks}
    return {**found, "unit": units.label}


def kink_distances(
    first: Sequence[KinkRecord], second: Sequence[KinkRecord], units: Units | None = None, others: Units | None = None
) -> Array:
    """Return |x₁ - x₂| of the kinks stronger than DETECTED_JUMP at one time, from the left.

    With the units of both runs the distances are in the surveys' unit. Return none if the numbers of kinks differ.
    """
    places = [
        np.sort([float(known.x(k.x)) if known else k.x for k in kinks if k.jump > DETECTED_JUMP])
        for kinks, known in ((first, units), (second, others))
    ]
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
