"""What a run was between its saved times: where its kinks were, what q was there, which way characteristics came.

Characteristics are followed backwards, dx/dt = K f'(q). Shocks swallow them forwards only: each point of the (x, t)
plane has one that reaches it, and that one has met no kink on its way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hjprofile.problem.case import law_from
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.solvers.run import Array, Run

HALVINGS = 40  # of the stretch on which a characteristic was one saved time ago: to rounding


class KinkPath(NamedTuple):
    """A kink's way, and that of the vertical step that it may become.

    time, x: at the saved times and the events, increasing in time, both of shape (points,).
    into: the kink that it merged into, or None.
    leaves: whether it went out at the top, where it then stays.
    """

    time: Array
    x: Array
    into: int | None
    leaves: bool


def kink_paths(run: Run) -> dict[int, KinkPath]:
    """Number -> path of every kink and vertical step that was there at a saved time."""
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
    """Where a kink is at time t, or the one that it has merged into; NaN before it was seen and when it was lost."""
    for _ in paths:  # links of a chain of mergers at most
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
    """The law of a run whose K and q say how its characteristics move, else None.

    Below a rolling layer they do not: waves of the layer move too. Nor is a law read that is a Python file, which is
    not with the result, and running which would run its author's code.
    """
    table = run.case.get("erosion", {})
    return None if "layer" in run.case or table.get("law") == "python" else law_from(table)


def trace_back(run: Run, law: ErosionLaw, ends: Sequence[tuple[int, float]]) -> Array:
    """Characteristics that are at x at the saved time number i, for each (i, x) of `ends`, followed back to the first.

    Returns their places at the saved times, shape (times, ends), NaN after time i and, of those that came from left of
    the grid, before the first place there. A step from one saved time to the one before is the trapezoidal rule,
    x(t₁) - x(t₀) = ½ (t₁ - t₀) (λ₀(x(t₀)) + λ₁(x(t₁))) with λ = K f'(q), solved between the kinks that surround it:
    second order in the time between saved times, and exact where λ does not change along it, as in a fan at a constant
    K; first order in Δx within a few cells of a kink.
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
    """Where those at x at the saved time number i were one saved time before."""
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
    """The places of every kink that is there at the first of two times, or what it is part of at the second."""
    both = [(place(paths, n, before), place(paths, n, after)) for n in paths]
    return sorted(pair for pair in both if not np.isnan(pair).any())


def slope_between(run: Run, times: Array, x: Array) -> Array:
    """q at `times` (increasing; before and after the saved ones as at these) and `x` (increasing), shape (times, x).

    Linear between saved times and cells, along lines that move with the kinks, so that these stay sharp; what lies
    between kinks that merge or leave keeps the q that it had, and a kink that is born is blurred until the next time.
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
        kept = np.diff(at_second) > np.minimum(narrow, 0.5 * np.diff(at_first))
        for row in np.flatnonzero(index == i):
            part = (times[row] - first) / (second - first) if j > i else 0.0
            knots = _knots(paths, numbers, float(times[row]), ends)
            before = np.interp(np.interp(x, knots, at_first), run.x_cell, run.q[i])
            after = np.interp(np.interp(x, knots, at_second), run.x_cell, run.q[j])
            weight = kept * part
            weight = weight[np.clip(np.searchsorted(knots, x) - 1, 0, weight.size - 1)]
            q[row] = (1.0 - weight) * before + weight * after
    return q


def _knots(paths: Mapping[int, KinkPath], numbers: Sequence[int], t: float, ends: tuple[float, float]) -> Array:
    """The places of these kinks at time t between the ends of the grid, strictly increasing."""
    knots = np.maximum.accumulate([ends[0], *(min(place(paths, n, t), ends[1]) for n in numbers), ends[1]])
    return knots + 1e-12 * (ends[1] - ends[0]) * np.arange(knots.size)
