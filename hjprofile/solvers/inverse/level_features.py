"""Kinks and vertical steps of x as a function of u, and their paths through time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import FEWEST_CELLS, Grid
from hjprofile.solvers.grids.kink_tracker import KinkTracker, Sighting, link
from hjprofile.solvers.run import Array, Event, KinkRecord, VerticalStep

SMALLEST_JUMP = 0.05  # of q; a weaker jump cannot be distinguished from a steep smooth rise
WIDEST_SHOCK = 32  # cells over which a kink may spread: a jump of 0.4 that crosses a level per time step covers 30
RISE_END = 0.02  # a rise ends where the rise per cell is below this fraction of its maximum
LAYER = 8  # cells below a vertical step over which the scheme spreads its lower end
FEWEST = 2  # smallest number of pooled cells that is a vertical step
STEEPEST = 1e12  # q that stands for an infinite slope


def kinks_of(x: Array, u: Array, ln_K: Array) -> list[Sighting]:
    """Return the kinks of x(u) at levels u, from left to right.

    The scheme spreads a kink over a few cells. The kink is where the straight lines through the cells on either side
    meet, and there x is continuous.
    """
    spacing = float(u[1] - u[0])
    z = np.diff(x) / spacing
    q = 1.0 / np.maximum(z, 1.0 / STEEPEST) - 1.0
    rise = np.diff(q)
    padded = np.concatenate([[-np.inf], rise, [-np.inf]])
    peaks = np.flatnonzero((rise >= SMALLEST_JUMP / WIDEST_SHOCK) & (rise >= padded[2:]) & (rise > padded[:-2]))
    found: list[Sighting] = []
    taken = np.zeros(rise.size, dtype=bool)
    for p in peaks[np.argsort(-rise[peaks], kind="stable")].tolist():
        if taken[p]:  # part of the rise to a steeper peak
            continue
        below = rise[max(p - 2 * WIDEST_SHOCK, 0) : p] > RISE_END * rise[p]
        above = rise[p + 1 : p + 1 + 2 * WIDEST_SHOCK] > RISE_END * rise[p]
        a = p - int(np.argmin(np.append(below[::-1], False)))
        b = p + 1 + int(np.argmin(np.append(above, False)))
        taken[a:b] = True
        a, b = max(a - 1, 0), min(b + 1, z.size - 1)  # the cells next to the rise
        if q[b] - q[a] > WIDEST_SHOCK * rise[p] or q[b] - q[a] < SMALLEST_JUMP or np.any(z[a : b + 1] <= 0.0):
            continue
        width, cells = x[b] - x[a + 1], b - a - 1
        lower = float(np.clip((width / spacing - z[b] * cells) / (z[a] - z[b]), 0.0, cells))  # cells below the kink
        place = min(float(x[a + 1] + z[a] * lower * spacing), 0.0)
        K = float(np.exp(np.interp(np.interp(place, x, u), u, ln_K)))
        found.append(Sighting(place, float(q[a]), float(q[b]), K))
    return sorted(found)


def steps_of(x: Array, u: Array, ln_K: Array, eta0: float) -> list[tuple[Sighting, float]]:
    """Return the vertical steps of x(u), each with its height, from left to right.

    Such a sighting has the mean of K over the step, and q = STEEPEST on its right: K [f]/[q] is then the speed of the
    step. Its lower end is where the straight line through the cells below its layer meets the vertical.
    """
    spacing = float(u[1] - u[0])
    z = np.diff(x) / spacing
    level = np.concatenate([[False], z <= 0.0, [False]])
    starts, ends = np.flatnonzero(level[1:] & ~level[:-1]), np.flatnonzero(level[:-1] & ~level[1:])
    found = []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if end - start < FEWEST or x[start] > 0.0:
            continue
        a = max(start - LAYER, 1)
        slope = float(z[a - 1])
        layer = (start - a) * spacing
        lower = float(np.clip((x[start] - x[a]) / slope, 0.0, layer)) if slope > 0.0 else layer
        height = float(u[end] - u[a]) - lower
        mean = float(np.exp(ln_K[end]) * np.expm1(eta0 * height) / (eta0 * height))
        found.append((Sighting(float(x[start]), 1.0 / max(slope, 1.0 / STEEPEST) - 1.0, STEEPEST, mean), height))
    return found


class Features:
    """The kinks and vertical steps of a run, linked into paths at its end.

    A vertical step has the number of the kink that it comes from.
    """

    def __init__(self, law: ErosionLaw, grid: Grid, least: float):
        self.law, self.least = law, least
        # its distances are in cells for shocks half as wide
        self.tracker = KinkTracker(law, replace(grid, cells=max(grid.cells // 2, FEWEST_CELLS)))
        self.heights: dict[tuple[float, float], float] = {}  # (time, x) of a vertical step -> its height

    def observe(self, t: float, x: Array, u: Array, ln_K: Array) -> None:
        """Append the kinks and vertical steps at the time t."""
        seen = [kink for kink in kinks_of(x, u, ln_K) if kink.jump >= self.least]
        if self.law.grows_linearly:
            for step, height in steps_of(x, u, ln_K, self.law.eta0):
                self.heights[t, step.x] = height
                seen.append(step)
        self.tracker.frames.append((t, sorted(seen)))

    def result(self, times: Array) -> tuple[list[KinkRecord], list[VerticalStep], list[Event]]:
        """Return the kinks and the vertical steps at the times, and the events."""
        records, events = self.tracker.result(times)
        kinks = [r for r in records if r.q_right < STEEPEST]
        steps = [
            VerticalStep(r.time, r.kink, r.x, self.heights[r.time, r.x], r.rankine_hugoniot_speed)
            for r in records if r.q_right >= STEEPEST
        ]  # fmt: skip
        blown = self._blow_ups() if self.law.grows_linearly else []
        at_once = {(e.time, e.kink) for e in blown}
        return kinks, steps, _ordered([e for e in events if (e.time, e.kink) not in at_once], blown)

    def _blow_ups(self) -> list[Event]:
        """Return the blow-ups: the first time at which each kink is a vertical step, unless it meets one then."""
        frames, dx = self.tracker.frames, self.tracker.grid.dx
        paths = link(frames, dx, self.tracker._speed)
        found = []
        for path in paths:
            steep = [i for i, s in enumerate(path.sightings) if s.q_right >= STEEPEST]
            if not steep or path.times[steep[0]] == frames[0][0]:
                continue
            t, x = path.times[steep[0]], path.sightings[steep[0]].x
            met = [p for p in paths if p.into is path and p.sightings[-1].q_right >= STEEPEST and p.times[-1] <= t]
            if not met:
                found.append(Event(t, "blow-up", path.number, None, x))
        return found


def _ordered(events: Sequence[Event], more: Sequence[Event]) -> list[Event]:
    """Return all events by their times."""
    return sorted([*events, *more], key=lambda e: (e.time, e.kink))
