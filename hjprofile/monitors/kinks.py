"""Kinks of the profile: where q jumps up. Found on any grid solution, numbered for life.

A shock spreads over a few cells. It is told from a smooth rise by its width: a rise of q by J whose steepest part is d
per cell has width J/d cells, and a grid cannot resolve what is narrower than WIDEST cells. The kink lies where two
straight lines, continuing q from either side, hold the mass that the cells between them hold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.run import Array, Event, KinkRecord, State

Speed = Callable[["Sighting"], float]

LEAST_JUMP = 0.05  # a weaker jump cannot be told from a steep smooth rise on grids of a thousand cells
WIDEST = 16  # cells over which a shock may spread; Lax-Friedrichs spreads a jump of 0.4 over this many
FOOT = 0.08  # a rise ends where it falls below this part of its steepest rise per cell
GAP, FIT = 1, 4  # cells left out beside the rise, and cells to which a line is fitted
MEMORY = 10  # sightings at most from which a kink's speed is measured, ...
NEARBY = 40  # ... and the cells within which they lie, or else the nearest two
LEAST_LIFE = 3  # sightings that make a kink; fewer are a flicker of the threshold


class Sighting(NamedTuple):
    """A kink found at one moment."""

    x: float
    q_left: float
    q_right: float
    K: float  # at the kink

    @property
    def jump(self) -> float:
        return self.q_right - self.q_left


def detect_kinks(grid: Grid, q: Array, K: Array) -> list[Sighting]:
    """The kinks of cell means q (shape (cells,)) with K on the nodes, from left to right."""
    found = []
    d = np.diff(q)
    for a, b in _rises(q, d):
        sighting = _locate(grid, q, d, K, a, b)
        if sighting is not None and sighting.jump >= LEAST_JUMP:
            found.append(sighting)
    return found


def _rises(q: Array, d: Array) -> list[tuple[int, int]]:
    """Cells (a, b) between which q rises too steeply for the grid: a is the foot, b the crest; d = diff(q)."""
    steep = d >= LEAST_JUMP / WIDEST
    peaks = np.flatnonzero(steep & (d >= np.append(d[1:], -np.inf)) & (d > np.append(-np.inf, d[:-1])))
    rises: list[tuple[int, int]] = []
    for p in peaks.tolist():
        floor, a, b = FOOT * d[p], p, p + 1
        while a > 0 and p - a < 2 * WIDEST and d[a - 1] > floor:
            a -= 1
        while b < q.size - 1 and b - p < 2 * WIDEST and d[b] > floor:
            b += 1
        if q[b] - q[a] > WIDEST * d[p]:
            continue
        if rises and a < rises[-1][1]:  # two peaks in one rise
            a0, b0 = rises.pop()
            a, b = a0, max(b, b0)
        rises.append((a, b))
    return rises


def _line(grid: Grid, q: Array, first: int, last: int, near: float) -> tuple[float, float]:
    """Value and slope at x = `near` of the line through cells first..last; flat where they are fewer than three."""
    n = last - first + 1
    x = grid.centres[first : last + 1] - near
    values = q[first : last + 1]
    if n < 3:
        return float(values[-1] if x[-1] < 0 else values[0]), 0.0
    mean_x, mean = float(x.sum()) / n, float(values.sum()) / n
    centred = x - mean_x
    slope = float(centred @ values / (centred @ centred))
    return mean - slope * mean_x, slope


def _locate(grid: Grid, q: Array, d: Array, K: Array, a: int, b: int) -> Sighting | None:
    """Place of the kink between foot a and crest b by conservation, with one-sided values there."""
    x, dx = grid.nodes, grid.dx
    middle = 0.5 * (x[a] + x[b + 1])
    left_end, right_end = a - GAP, b + GAP  # the cells nearest to the rise that the lines are fitted to
    left_start = left_end - FIT + 1
    right_stop = right_end + FIT - 1
    # never fit across a neighbouring rise or the end of the grid
    steep = LEAST_JUMP / WIDEST
    while left_start < max(left_end, 0) and (left_start < 0 or d[left_start] > steep):
        left_start += 1
    while right_stop > min(right_end, q.size - 1) and (right_stop >= q.size or d[right_stop - 1] > steep):
        right_stop -= 1
    left_end, right_end = max(left_end, 0), min(right_end, q.size - 1)
    ql, sl = _line(grid, q, min(max(left_start, 0), left_end), left_end, middle)
    qr, sr = _line(grid, q, right_end, max(min(right_stop, q.size - 1), right_end), middle)
    if left_end > a:
        ql, sl = float(q[a]), 0.0
    if right_end < b:
        qr, sr = float(q[b]), 0.0
    if not qr > ql:
        return None
    start, stop = x[min(a, left_end)], x[max(b, right_end) + 1]
    mass = dx * float(np.sum(q[min(a, left_end) : max(b, right_end) + 1]))
    s = middle
    for _ in range(8):  # ∫ left line up to s + ∫ right line from s on = mass; Newton
        held = (
            ql * (s - start) + 0.5 * sl * ((s - middle) ** 2 - (start - middle) ** 2)
            + qr * (stop - s) + 0.5 * sr * ((stop - middle) ** 2 - (s - middle) ** 2)
        )  # fmt: skip
        jump = (qr + sr * (s - middle)) - (ql + sl * (s - middle))
        if not jump > 0:
            return None
        s = min(max(s + (held - mass) / jump, start), stop)
    left, right = ql + sl * (s - middle), qr + sr * (s - middle)
    if not (right > left > -1.0):
        return None
    return Sighting(float(s), float(left), float(right), float(np.interp(s, x[a : b + 2], K[a : b + 2])))


@dataclass(eq=False)
class _Path:
    """One kink through time."""

    number: int
    born: bool = False
    times: list[float] = field(default_factory=list)
    sightings: list[Sighting] = field(default_factory=list)
    end: Event | None = None
    into: _Path | None = None

    def add(self, t: float, sighting: Sighting) -> None:
        self.times.append(t)
        self.sightings.append(sighting)

    def recent(self, dx: float) -> tuple[Array, Array]:
        """Times and places of the last MEMORY sightings that are near the last."""
        x = np.array([s.x for s in self.sightings[-MEMORY:]])
        near = np.abs(x - x[-1]) <= NEARBY * dx
        return np.array(self.times[-MEMORY:])[near], x[near]

    def velocity(self, dx: float, speed: Speed) -> float:
        """Measured over the last sightings where there are enough, else by Rankine-Hugoniot."""
        t, x = self.recent(dx)
        return _slope(t, x) if t.size > 3 else speed(self.sightings[-1])


class KinkTracker:
    """A monitor that detects kinks in every state it sees and links the sightings into paths."""

    def __init__(self, law: ErosionLaw, grid: Grid):
        self.law, self.grid = law, grid
        self.frames: list[tuple[float, list[Sighting]]] = []
        self.latest: tuple[float, list[Sighting]] = (-np.inf, [])

    def happened(self, state: State) -> bool:
        """Whether there are more or fewer kinks than when they were last observed."""
        self.latest = state.t, detect_kinks(self.grid, state.q, state.K)
        return len(self.latest[1]) != len(self.frames[-1][1])

    def observe(self, state: State) -> None:
        if self.latest[0] != state.t:
            self.latest = state.t, detect_kinks(self.grid, state.q, state.K)
        self.frames.append(self.latest)

    def result(self, kept: Array) -> tuple[list[KinkRecord], list[Event]]:
        """Kinks at the kept times, and the events of the whole run."""
        paths = link(self.frames, self.grid.dx, self._speed)
        records = []
        for t in kept:
            rows = [(path, path.times.index(t)) for path in paths if t in path.times]
            for path, i in sorted(rows, key=lambda row: row[0].sightings[row[1]].x):
                s = path.sightings[i]
                records.append(
                    KinkRecord(
                        float(t), path.number, s.x, s.q_left, s.q_right, s.jump,
                        _measured_speed(path, i, self.grid.dx), self._speed(s),
                    )
                )  # fmt: skip
        return records, events_of(paths, self.frames[-1][0])

    def _speed(self, s: Sighting) -> float:
        """Rankine-Hugoniot: K [f]/[q]."""
        return s.K * float(self.law.f(s.q_right) - self.law.f(s.q_left)) / s.jump


def link(frames: Sequence[tuple[float, list[Sighting]]], dx: float, speed: Speed) -> list[_Path]:
    """Links sightings at successive times into paths; `speed` maps a sighting to its Rankine-Hugoniot speed.

    Kinks in the first frame are numbered from the left, later ones in the order of their births. A kink may be out of
    sight for a while: where two shocks touch, their common rise can be too wide to be seen as one.
    """
    paths: list[_Path] = []
    living: list[_Path] = []  # with those that are out of sight
    for n, (t, sightings) in enumerate(frames):
        claims: dict[int, list[_Path]] = {}
        for path in living:
            ahead, reach = _expected(path, t, dx, speed)
            near = [i for i, new in enumerate(sightings) if abs(new.x - ahead) <= reach]
            if near:
                claims.setdefault(min(near, key=lambda i: abs(sightings[i].x - ahead)), []).append(path)
        _untangle(claims, sightings)
        for i, new in enumerate(sightings):
            claimants = claims.get(i, [])
            path = min(claimants, key=lambda p: p.number) if claimants else _Path(len(paths) + 1, born=n > 0)
            if not claimants:
                paths.append(path)
                living.append(path)
            for other in claimants:
                if other is not path:
                    _merge(other, path, dx, speed)
                    living.remove(other)
            path.add(t, new)
        for path in [p for p in living if p.times[-1] < t]:
            if _leaves(path, t, dx, speed) or _is_lost(path, t, dx, speed):
                living.remove(path)
    _merge_lost(paths, frames[-1][0] if frames else 0.0, dx, speed)
    return _without_flicker(paths)


def _expected(path: _Path, t: float, dx: float, speed: Speed) -> tuple[float, float]:
    """Where the kink should be at t, and how far from there it may be found."""
    travel = path.velocity(dx, speed) * (t - path.times[-1])
    return path.sightings[-1].x + travel, 4 * dx + 0.5 * abs(travel)


def _is_lost(path: _Path, t: float, dx: float, speed: Speed) -> bool:
    """Out of sight for longer than two shocks need to become one."""
    return abs(path.velocity(dx, speed)) * (t - path.times[-1]) > 2 * WIDEST * dx


def _untangle(claims: dict[int, list[_Path]], sightings: list[Sighting]) -> None:
    """Where two paths claim one sighting and its neighbour is unclaimed, kinks keep their order instead of merging."""
    for i in list(claims):
        claimants = sorted(claims[i], key=lambda p: p.sightings[-1].x)
        if len(claimants) < 2:
            continue
        for j, mover in ((i - 1, claimants[0]), (i + 1, claimants[-1])):
            if 0 <= j < len(sightings) and j not in claims:
                here, there = (abs(sightings[k].x - mover.sightings[-1].x) for k in (i, j))
                if there <= 2 * here:
                    claims[i].remove(mover)
                    claims[j] = [mover]
                    break


def _leaves(path: _Path, t: float, dx: float, speed: Speed) -> bool:
    """Ends a path that went out of sight when it was about to reach x = 0."""
    times, x = path.recent(dx)
    velocity = path.velocity(dx, speed)
    if velocity <= 0 or x[-1] < -3 * WIDEST * dx:
        return False
    arrival = float(times[-1] - x[-1] / velocity)
    if arrival > t + 2 * WIDEST * dx / velocity:
        return False
    path.end = Event(arrival, "exit", path.number, None, 0.0)
    return True


def _merge(loser: _Path, winner: _Path, dx: float, speed: Speed) -> None:
    """Ends `loser` where it meets `winner`: extrapolated, for shocks that touch are seen as one too early."""
    common = sorted(set(loser.times) & set(winner.times))[-MEMORY:]
    if common:
        xs = [np.array([p.sightings[p.times.index(t)].x for t in common]) for p in (loser, winner)]
        near = np.abs(xs[0] - xs[0][-1]) <= NEARBY * dx
        xs = [x[near] for x in xs]
        t, gap = np.array(common)[near], xs[1] - xs[0]
        if t.size > 3:
            closing, velocity, now, apart, here = -_slope(t, gap), _slope(t, xs[1]), t.mean(), gap.mean(), xs[1].mean()
        else:
            speeds = [speed(p.sightings[p.times.index(t[-1])]) for p in (loser, winner)]
            closing, velocity, now, apart, here = speeds[0] - speeds[1], speeds[1], t[-1], gap[-1], xs[1][-1]
        wait = apart / closing if closing * apart > 0 else t[-1] - now
    else:  # never seen side by side
        now, here, velocity, wait = loser.times[-1], loser.sightings[-1].x, 0.0, 0.0
    loser.into = winner
    loser.end = Event(float(now + wait), "merge", loser.number, winner.number, float(here + velocity * wait))


def _merge_lost(paths: list[_Path], end: float, dx: float, speed: Speed) -> None:
    """A path that was lost from sight beside another that lived on, and was closing in on it, has merged with it."""
    for lost in sorted((p for p in paths if p.end is None and p.times[-1] < end), key=lambda p: p.times[-1]):
        t, x = lost.times[-1], lost.sightings[-1].x
        beside = [p for p in paths if p is not lost and p.times[0] <= t < p.times[-1] and t in p.times]
        beside.sort(key=lambda p: abs(p.sightings[p.times.index(t)].x - x))
        if not beside:
            continue
        other = beside[0]
        gap = other.sightings[other.times.index(t)].x - x
        closing = (lost.velocity(dx, speed) - speed(other.sightings[other.times.index(t)])) * np.sign(gap)
        if abs(gap) > 3 * WIDEST * dx or closing <= 0:
            continue
        if lost.number < other.number:  # the lower number lives on: it takes over the rest of the other's path
            k = other.times.index(t) + 1
            lost.times += other.times[k:]
            lost.sightings += other.sightings[k:]
            other.times, other.sightings = other.times[:k], other.sightings[:k]
            lost.end, lost.into, other.end = other.end, other.into, None
            if lost.end:
                lost.end = lost.end._replace(kink=lost.number)
            for p in paths:
                if p.into is other and p.end and p.end.time > t:
                    p.into = lost
            lost, other = other, lost
        _merge(lost, other, dx, speed)


def _without_flicker(paths: list[_Path]) -> list[_Path]:
    """Drops paths too short to be kinks, and numbers the others anew in the order of their births."""
    hosts = {id(p.into) for p in paths if p.into}
    lasting = [p for p in paths if len(p.times) >= LEAST_LIFE or not p.born or id(p) in hosts]
    for number, p in enumerate(lasting, start=1):
        p.number = number
    for p in lasting:
        if p.end:
            p.end = p.end._replace(kink=p.number, into=p.into.number if p.into else None)
    return lasting


def _slope(t: Array, x: Array) -> float:
    """Of the line through the points by least squares."""
    centred = (t - t[0]) - (t - t[0]).mean()
    spread = float(centred @ centred)
    return float(centred @ x) / spread if spread > 0 else 0.0


def _measured_speed(path: _Path, i: int, dx: float) -> float:
    """Slope of a line through the sightings around the i-th; NaN if there is only one."""
    x = [s.x for s in path.sightings]
    first, last = max(i - 1, 0), min(i + 1, len(x) - 1)
    while last - first < MEMORY:
        more = [k for k in (first - 1, last + 1) if 0 <= k < len(x) and abs(x[k] - x[i]) <= NEARBY * dx]
        if not more:
            break
        first, last = min(first, *more), max(last, *more)
    if last == first:
        return float("nan")
    return _slope(np.array(path.times[first : last + 1]), np.array(x[first : last + 1]))


def events_of(paths: Sequence[_Path], end: float) -> list[Event]:
    """Births, merges and exits up to the time `end`, in their order."""
    births = [Event(p.times[0], "birth", p.number, None, p.sightings[0].x) for p in paths if p.born]
    ends = [p.end for p in paths if p.end and p.end.time <= end]
    return sorted(births + ends, key=lambda e: (e.time, e.kink))
