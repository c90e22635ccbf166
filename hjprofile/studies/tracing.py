"""Reconstruction of a run between its saved times: positions of kinks, q, and backward characteristics.

Characteristics are traced backwards, dx/dt = K f'(q). Shocks absorb them only forwards in time: exactly one
characteristic reaches each point of the (x, t) plane, and it has met no kink before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hjprofile.problem.case import law_from
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.solvers.run import Array, Run

HALVINGS = 40  # bisections of the interval that contains a characteristic at the previous saved time: to rounding


class KinkPath(NamedTuple):
    """The path of a kink, and of the vertical step that it may become.

    Attributes:
        time, x: at the saved times and the events, increasing in time, both of shape (points,).
        into: the kink that it merged into, or None.
        leaves: True if it left at the crest, where it then stays.
    """

    time: Array
    x: Array
    into: int | None
    leaves: bool


def kink_paths(run: Run) -> dict[int, KinkPath]:
    """Return number -> path of every kink and vertical step that exists at a saved time."""
    points: dict[int, list[tuple[float, float]]] = {}
    for k in run.kinks:
        points.setdefault(k.kink, []).append((k.time, k.x))
    for s in run.vertical_steps or ():
        points.setdefault(s.step, []).append((s.time, s.x))
    into: dict[int, int | None] = {}
    leaving = set()
    for e in run.events:
        if e.kink in points:
            points[e.kink].append((e.time, e.x))
            into |= {e.kink: e.into} if e.event == "merge" else {}
            leaving |= {e.kink} if e.event == "exit" else set()
    paths = {}
    for number in sorted(points):
        time, x = np.array(sorted(set(points[number]))).T
        paths[number] = KinkPath(time, x, into.get(number), number in leaving)
    return paths


def place(paths: Mapping[int, KinkPath], number: int | None, t: float) -> float:
    """Return the position at time t of a kink, or of the one that it has merged into; NaN before and after its path."""
    for _ in paths:  # at most as many links as paths
        if number is None or number not in paths or t < paths[number].time[0]:
            break
        path = paths[number]
        if t <= path.time[-1]:
            return float(np.interp(t, path.time, path.x))
        if path.leaves:
            return float(path.x[-1])
        number = path.into
    return np.nan


def traceable_law(run: Run) -> ErosionLaw | None:
    """Return the law of a run whose K and q determine its characteristics, else None.

    Below a rolling layer they do not, because waves of the layer move too. A law in a Python file is not read either:
    the file is not part of the result, and reading it would run the code of its author.
    """
    table = run.case.get("erosion", {})
    return None if "layer" in run.case or table.get("law") == "python" else law_from(table)


def trace_back(run: Run, law: ErosionLaw, ends: Sequence[tuple[int, float]]) -> Array:
    """Trace the characteristics at (i, x) of `ends`, with i the index of a saved time, back to the first saved time.

    Return their positions at the saved times, shape (times, ends). They are NaN after time i and, for those from the
    left of the grid, before the first position on it. A step from one saved time to the one before is the trapezoidal
    rule, x(t₁) - x(t₀) = ½ (t₁ - t₀) (λ₀(x(t₀)) + λ₁(x(t₁))) with λ = K f'(q), solved between the adjacent kinks. It is
    second order in the time between saved times, and exact if λ is constant along it, as in a fan at a constant K. It
    is first order in Δx within a few cells of a kink.
    """
    K = 0.5 * (run.K[:, 1:] + run.K[:, :-1])
    speed = K * law.derivative(run.q)
    paths = kink_paths(run)
    index, x = np.array([i for i, _ in ends], dtype=int), np.array([at for _, at in ends], dtype=float)
    found = np.full((run.time.size, x.size), np.nan)
    found[index, np.arange(x.size)] = x
    for i in range(run.time.size - 1, 0, -1):
        mine = index >= i
        found[i - 1, mine] = _one_back(run, paths, speed, i, np.where(found[i] < run.x[0], np.nan, found[i])[mine])
    return found


def _one_back(run: Run, paths: Mapping[int, KinkPath], speed: Array, i: int, x: Array) -> Array:
    """Return the positions, one saved time before, of the characteristics at x at the saved time with index i."""
    half = 0.5 * float(run.time[i] - run.time[i - 1])
    to = x - half * np.interp(x, run.x_cell, speed[i])
    low, high = to - half * float(speed[i - 1].max()), to.copy()
    for before, after in _barriers(paths, float(run.time[i - 1]), float(run.time[i])):
        right = x > after
        low = np.where(right, np.maximum(low, before), low)
        high = np.where(right, high, np.minimum(high, before))
    low = np.minimum(low, high)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        short = middle + half * np.interp(middle, run.x_cell, speed[i - 1]) < to
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return 0.5 * (low + high)


def _barriers(paths: Mapping[int, KinkPath], before: float, after: float) -> list[tuple[float, float]]:
    """Return the positions of every kink that exists at the first of two times, and at the second, after merges."""
    both = [(place(paths, n, before), place(paths, n, after)) for n in paths]
    return sorted(pair for pair in both if not np.isnan(pair).any())


def slope_between(run: Run, times: Array, x: Array) -> Array:
    """Return q at `times` (increasing; constant beyond the saved ones) and `x` (increasing), shape (times, x).

    The interpolation is linear between saved times and cells, along lines that move with the kinks, which stay sharp.
    In intervals between kinks that merge or leave q is that of the earlier time. A new kink is blurred until the next
    time.
    """
    paths, narrow = kink_paths(run), 8.0 * float(run.x[1] - run.x[0])
    times, q = np.clip(times, run.time[0], run.time[-1]), np.empty((times.size, x.size))
    ends = float(run.x[0]), float(run.x[-1])
    last = max(run.time.size - 2, 0)
    index = np.clip(np.searchsorted(run.time, times, "right") - 1, 0, last)
    for i in np.unique(index):
        j = min(i + 1, run.time.size - 1)
        first, second = float(run.time[i]), float(run.time[j])
        numbers = [n for n in paths if not np.isnan(place(paths, n, first) + place(paths, n, second))]
        numbers.sort(key=lambda n: place(paths, n, first))
        at_first, at_second = (_knots(paths, numbers, t, ends) for t in (first, second))
        survives = np.diff(at_second) > np.minimum(narrow, 0.5 * np.diff(at_first))
        for row in np.flatnonzero(index == i):
            part = (times[row] - first) / (second - first) if j > i else 0.0
            knots = _knots(paths, numbers, float(times[row]), ends)
            before = np.interp(np.interp(x, knots, at_first), run.x_cell, run.q[i])
            after = np.interp(np.interp(x, knots, at_second), run.x_cell, run.q[j])
            weight = survives * part
            weight = weight[np.clip(np.searchsorted(knots, x) - 1, 0, weight.size - 1)]
            q[row] = (1.0 - weight) * before + weight * after
    return q


def _knots(paths: Mapping[int, KinkPath], numbers: Sequence[int], t: float, ends: tuple[float, float]) -> Array:
    """Return the positions of these kinks at time t between the ends of the grid, strictly increasing."""
    knots = np.maximum.accumulate([ends[0], *(min(place(paths, n, t), ends[1]) for n in numbers), ends[1]])
    return knots + 1e-12 * (ends[1] - ends[0]) * np.arange(knots.size)
