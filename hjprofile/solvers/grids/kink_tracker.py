"""Tracking of kinks through time: permanent numbers, births, merges and exits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.kernels.find_kinks import WIDEST_SHOCK, find_kinks
from hjprofile.solvers.run import Array, Event, KinkRecord, State, in_order
from hjprofile.solvers.states import Callback, Snapshot, name_of

Speed = Callable[["Sighting"], float]

SIGHTINGS_OF_MERGE = 10  # largest number of sightings from which a merge is dated
NEARBY = 40  # cells, the range of sightings from which a speed is measured or a merge is dated
FEWEST_SIGHTINGS = 6  # smallest number of sightings for a speed; the nearest ones if fewer lie within NEARBY
SCATTER = 0.005  # largest residual of the fit as a fraction of the distance; the error of the speed is then at most 1 %
LEAST_SPAN = 12  # cells, smallest range for a speed: positions scatter by about 0.05 cells
SCATTER_BACK = 2  # cells by which a kink may appear to move downslope: its mean error is 0.3 to 1.9 (theory, Kinks)
LEAST_LIFE = 3  # sightings that define a kink which is still resolved at the end
MOST_ENTRIES = 1 << 18  # of a matrix of saved times and sightings: 2 MB
LEAST_WAY = 6  # cells that any other kink crosses; shorter paths are caused by the detection threshold


class Sighting(NamedTuple):
    """A kink found in one state."""

    x: float
    q_left: float
    q_right: float
    K: float  # at the kink

    @property
    def jump(self) -> float:
        """The jump of q."""
        return self.q_right - self.q_left


@dataclass(eq=False)
class _Path:
    """One kink through time; numbers are assigned when all paths are known."""

    born: bool = False
    number: int = 0
    times: list[float] = field(default_factory=list)
    sightings: list[Sighting] = field(default_factory=list)
    end: Event | None = None
    into: _Path | None = None

    def add(self, t: float, sighting: Sighting) -> None:
        """Append a sighting."""
        self.times.append(t)
        self.sightings.append(sighting)

    def join(self, other: _Path, paths: list[_Path]) -> None:
        """Append the later sightings of the same kink, stored as another path."""
        paths.remove(other)
        rows = sorted(zip(self.times + other.times, self.sightings + other.sightings, strict=True), key=lambda r: r[0])
        self.times, self.sightings = [t for t, _ in rows], [s for _, s in rows]
        for p in paths:
            if p.into is other:
                p.into = self

    def seniority(self, t: float) -> tuple[bool, float]:
        """Return the rank of a kink at t. The lower rank survives a merge: kinks of the data, then from the left."""
        return self.born, float(np.interp(t, self.times, [s.x for s in self.sightings]))

    def place(self, t: float) -> float:
        """Return the position at t, later that of the kink into which this one has merged, and +inf after an exit."""
        if t <= self.times[-1] or self.end is None:
            return float(np.interp(t, self.times, [s.x for s in self.sightings]))
        return self.into.place(t) if self.into else np.inf


class KinkTracker:
    """A monitor that finds the kinks of every observed state and links the sightings into paths.

    `hidden` returns the intervals (left, right) of a state that contain no kinks: the numerical layers of vertical
    steps. Jumps of q below `least` are not seen.
    """

    checkpoint_fields: tuple[str, ...] = ("table",)

    def __init__(
        self, law: ErosionLaw, grid: Grid, hidden: Callable[[State], Sequence[tuple[float, float]]] = lambda state: (),
        least: float = 0.0,
    ):  # fmt: skip
        self.law, self.grid, self.hidden, self.least = law, grid, hidden, least
        self.frames: list[tuple[float, list[Sighting]]] = []
        self.latest: tuple[float, list[Sighting]] = (-np.inf, [])

    def wants(self, state: State) -> bool:
        return True

    def kinks_changed(self, state: State) -> bool:
        """Return True if the number of kinks has changed since the last observation."""
        return len(self._kinks_of(state)) != len(self.frames[-1][1])

    def observe(self, state: State) -> None:
        """Append the kinks of a state."""
        self.frames.append((state.t, self._kinks_of(state)))

    def _kinks_of(self, state: State) -> list[Sighting]:
        """Return the kinks of a state."""
        if self.latest[0] != state.t:
            rows = find_kinks(state.q, float(self.grid.nodes[state.first]), self.grid.dx, state.law)
            if state.K is not None:
                nodes = self.grid.nodes[state.first : state.first + state.K.size]
                rows[:, 3] = np.interp(rows[:, 0], nodes, state.K)
            hidden = self.hidden(state)
            seen = [sighting for row in rows.tolist() if (sighting := Sighting(*row)).jump >= self.least]
            self.latest = state.t, [s for s in seen if not any(a <= s.x <= b for a, b in hidden)]
        return self.latest[1]

    @property
    def table(self) -> Array:
        """The frames as rows: the time, then the fields of a sighting; a frame without kinks is a row of NaN."""
        none = [Sighting(*[np.nan] * 4)]
        return np.array([(t, *seen) for t, sightings in self.frames for seen in sightings or none])

    @table.setter
    def table(self, rows: Array) -> None:
        self.frames = []
        for t, *seen in rows.tolist():
            if not self.frames or self.frames[-1][0] != t:
                self.frames.append((t, []))
            if not np.isnan(seen[0]):
                self.frames[-1][1].append(Sighting(*seen))

    def result(self, saved_times: Array) -> tuple[list[KinkRecord], list[Event]]:
        """Return the kinks at the saved times, and the events of the whole run."""
        paths = link(self.frames, self.grid.dx, self._speed)
        saved, records = set(saved_times.tolist()), []
        for p in paths:
            left = p.end.time if p.end and p.end.event == "exit" else np.inf
            at = [i for i, t in enumerate(p.times) if t in saved and t < left]
            turns = sorted(o.end.time for o in paths if o.into is p and o.end)
            for i, measured in zip(at, measured_speeds(p, at, turns, self.grid.dx), strict=True):
                s = p.sightings[i]
                records.append(
                    KinkRecord(p.times[i], p.number, s.x, s.q_left, s.q_right, s.jump, measured, self._speed(s))
                )
        return sorted(records, key=lambda r: (r.time, r.x)), events_of(paths, self.frames[-1][0])

    def _speed(self, s: Sighting) -> float:
        """Return the Rankine-Hugoniot speed K [f]/[q]."""
        return s.K * float(self.law.f(s.q_right) - self.law.f(s.q_left)) / s.jump


def with_kinks(callback: Callback, tracker: KinkTracker) -> Callback:
    """Return a callback that is shown each state with the kinks that the tracker has just seen."""

    def shown(t: float, state: Snapshot) -> Any:
        _, seen = tracker.frames[-1]
        return callback(t, replace(state, kinks=tuple(sorted(sighting.x for sighting in seen))))

    shown.__name__ = name_of(callback)  # a reason to stop names it
    return shown


def link(frames: Sequence[tuple[float, list[Sighting]]], dx: float, speed: Speed) -> list[_Path]:
    """Link sightings at successive times into paths; `speed` maps a sighting to its Rankine-Hugoniot speed.

    Kinks in the first frame are numbered from the left, then those born later, again from the left. Kinks do not pass
    each other, so that this order is certain, but the date of a birth depends on the time steps. A kink may be
    unresolved for a while: where two shocks touch, their common rise can be too wide to count as one.
    """
    paths: list[_Path] = []
    living: list[_Path] = []  # including unresolved ones
    for n, (t, sightings) in enumerate(frames):
        claims = _claims(living, t, sightings, dx, speed)
        _untangle(claims, sightings)
        for i, new in enumerate(sightings):
            claimants = _rightful(claims.get(i, []), dx)
            if not claimants:
                claimants = [_Path(born=n > 0)]
                claimants[0].add(t, new)
                paths += claimants
                living += claimants
            path = min(claimants, key=lambda p: p.seniority(t))
            for other in claimants:
                if other is not path:
                    living.remove(other)
                    _meet(other, path, paths, dx, speed)
            if path.times[-1] < t:
                path.add(t, new)
        for path in [p for p in living if p.times[-1] < t]:
            if _leaves(path, t, dx, speed) or _is_lost(path, t, dx, speed):
                living.remove(path)
    end = frames[-1][0] if frames else 0.0
    for path in paths:
        _leaves_at(end, path, dx, speed)
    _merge_lost(paths, end, dx, speed)
    for path in paths:
        if path.into:
            _assign_merge(path, end, dx)
    return _without_flicker(paths, end, dx)


def _meet(other: _Path, path: _Path, paths: list[_Path], dx: float, speed: Speed) -> None:
    """Join two paths that continue as one: by a merge, or as one kink that was unresolved for a while."""
    if set(other.times) & set(path.times):
        _merge(other, path, dx, speed)
    else:  # never observed at the same time
        path.join(other, paths)


def _claims(
    living: Sequence[_Path], t: float, sightings: Sequence[Sighting], dx: float, speed: Speed
) -> dict[int, list[_Path]]:
    """Return, for each sighting, the paths that continue with it.

    A path claims the sighting nearest to its expected position, and none below its last position. An unresolved path
    has no claim beyond its resolved neighbours, because kinks do not pass each other.
    """
    claimed: list[tuple[_Path, int]] = []
    latest = max((p.times[-1] for p in living), default=t)
    for path in sorted(living, key=lambda p: p.times[-1] < latest):  # resolved ones first
        ahead, reach = _expected(path, t, dx, speed)
        here = path.sightings[-1].x
        near = [
            i for i, new in enumerate(sightings) if abs(new.x - ahead) <= reach and new.x >= here - SCATTER_BACK * dx
        ]
        if not near:
            continue
        i = min(near, key=lambda i: abs(sightings[i].x - ahead))
        hidden = path.times[-1] < latest
        if not (hidden and any((other.sightings[-1].x - here) * (j - i) < 0 for other, j in claimed)):
            claimed.append((path, i))
    claims: dict[int, list[_Path]] = {}
    for path, i in claimed:
        claims.setdefault(i, []).append(path)
    return claims


def _expected(path: _Path, t: float, dx: float, speed: Speed) -> tuple[float, float]:
    """Return the expected position of the kink at t, and the largest distance from there."""
    travel = speed(path.sightings[-1]) * (t - path.times[-1])
    return path.sightings[-1].x + travel, 4 * dx + 0.5 * abs(travel)


def _is_lost(path: _Path, t: float, dx: float, speed: Speed) -> bool:
    """Return True if a path has been unresolved for longer than two shocks need to become one."""
    return abs(speed(path.sightings[-1])) * (t - path.times[-1]) > 2 * WIDEST_SHOCK * dx


def _rightful(claimants: list[_Path], dx: float) -> list[_Path]:
    """Return the claimants without unresolved ones that cannot be related to a resolved one.

    Two paths are related if both were observed at the same time, or if one can be the past of the other.
    """
    latest = max((p.times[-1] for p in claimants), default=0.0)
    resolved = [p for p in claimants if p.times[-1] == latest]

    def related(lost: _Path, seen: _Path) -> bool:
        uphill = seen.sightings[0].x >= lost.sightings[-1].x - SCATTER_BACK * dx
        return bool(set(lost.times) & set(seen.times)) or (lost.times[-1] < seen.times[0] and uphill)

    return [p for p in claimants if p in resolved or all(related(p, seen) for seen in resolved)]


def _untangle(claims: dict[int, list[_Path]], sightings: list[Sighting]) -> None:
    """Reassign sightings that two paths claim if a neighbour is unclaimed, so that kinks retain their order."""
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
    """End a path that became unresolved shortly before x = 0; return True in that case."""
    x, velocity = path.sightings[-1].x, speed(path.sightings[-1])
    if velocity <= 0 or x < -3 * WIDEST_SHOCK * dx:
        return False
    arrival = path.times[-1] - x / velocity
    if arrival > t + 2 * WIDEST_SHOCK * dx / velocity:
        return False
    path.end = Event(arrival, "exit", 0, None, 0.0)
    return True


def _leaves_at(end: float, path: _Path, dx: float, speed: Speed) -> None:
    """Date an exit that is due within BACK cells to the end of the run, because no position is more accurate.

    A kink that has not moved further than that is still where it began.
    """
    last, velocity = path.sightings[-1], speed(path.sightings[-1])
    here = last.x + velocity * (end - path.times[-1])
    if here - path.sightings[0].x <= SCATTER_BACK * dx:
        return
    if (path.end.event == "exit" if path.end else path.times[-1] == end) and -SCATTER_BACK * dx <= here < 0.0:
        path.end = Event(end, "exit", 0, None, 0.0)


def _merge(loser: _Path, winner: _Path, dx: float, speed: Speed) -> None:
    """End `loser` where it meets `winner`, by extrapolation, because touching shocks are joined too early."""
    common = sorted(set(loser.times) & set(winner.times))[-SIGHTINGS_OF_MERGE:]
    xs = [np.array([p.sightings[p.times.index(t)].x for t in common]) for p in (loser, winner)]
    if abs(xs[1][-1] - xs[0][-1]) > WIDEST_SHOCK * dx:  # they did not touch: one was too weak or too wide
        return
    near = np.abs(xs[0] - xs[0][-1]) <= NEARBY * dx
    xs = [x[near] for x in xs]
    t, gap = np.array(common)[near], xs[1] - xs[0]
    if t.size > 3:
        closing, velocity, now, apart, here = -_slope(t, gap), _slope(t, xs[1]), t.mean(), gap.mean(), xs[1].mean()
    else:
        speeds = [speed(p.sightings[p.times.index(t[-1])]) for p in (loser, winner)]
        closing, velocity, now, apart, here = speeds[0] - speeds[1], speeds[1], t[-1], gap[-1], xs[1][-1]
    wait = max(apart / closing if closing * apart > 0 else 0.0, loser.times[-1] - now)  # at the last sightings or later
    loser.into = winner
    # the extrapolation of two kinks at the crest may lie beyond it
    loser.end = Event(float(now + wait), "merge", 0, None, min(float(here + velocity * wait), 0.0))


def _merge_lost(paths: list[_Path], end: float, dx: float, speed: Speed) -> None:
    """Merge each lost path into a surviving neighbour that it approached."""
    for lost in sorted((p for p in paths if p.end is None and p.times[-1] < end), key=lambda p: p.times[-1]):
        t, x = lost.times[-1], lost.sightings[-1].x
        neighbours = [p for p in paths if p is not lost and p.times[0] <= t < p.times[-1] and t in p.times]
        neighbours.sort(key=lambda p: abs(p.sightings[p.times.index(t)].x - x))
        if not neighbours:
            continue
        other = neighbours[0]
        gap = other.sightings[other.times.index(t)].x - x
        closing = (speed(lost.sightings[-1]) - speed(other.sightings[other.times.index(t)])) * np.sign(gap)
        if abs(gap) > WIDEST_SHOCK * dx or closing <= 0:
            continue
        if lost.seniority(t) < other.seniority(t):  # the lost path receives the rest of the other path
            k = other.times.index(t) + 1
            lost.times += other.times[k:]
            lost.sightings += other.sightings[k:]
            other.times, other.sightings = other.times[:k], other.sightings[:k]
            lost.end, lost.into, other.end = other.end, other.into, None
            for p in paths:
                if p.into is other and p.end and p.end.time > t:
                    p.into = lost
            lost, other = other, lost
        _merge(lost, other, dx, speed)


def _assign_merge(path: _Path, end: float, dx: float) -> None:
    """Assign a merge to the surviving kink, or discard it if that kink has merged before or is unresolved there."""
    event, other = path.end, path.into
    assert event and other
    # kinks that meet at one point within the resolution of the grid all merge into the surviving one
    while other.end and other.into and (other.end.time < event.time or abs(other.end.x - event.x) <= WIDEST_SHOCK * dx):
        other = other.into
    seen = np.interp(event.time, other.times, [s.x for s in other.sightings])
    gone = other.end.time if other.end else other.times[-1]
    if gone < min(event.time, end) or abs(seen - event.x) > WIDEST_SHOCK * dx:
        path.end = path.into = None
    else:
        path.into = other


def _without_flicker(paths: list[_Path], end: float, dx: float) -> list[_Path]:
    """Drop paths too short to be kinks, and number the others: those of the start, then later ones, from the left."""
    hosts = {id(p.into) for p in paths if p.into}

    def lasts(p: _Path) -> bool:
        far = p.sightings[-1].x - p.sightings[0].x >= LEAST_WAY * dx
        return not p.born or id(p) in hosts or far or (p.times[-1] == end and len(p.times) >= LEAST_LIFE)

    lasting = [p for p in paths if lasts(p)]
    order: list[_Path] = []
    for p in sorted(lasting, key=lambda p: (p.times[0], p.sightings[0].x)):
        t, x = p.times[0], p.sightings[0].x
        order.insert(next((i for i, other in enumerate(order) if other.place(t) > x), len(order)), p)
    order.sort(key=lambda p: p.born)
    for number, p in enumerate(order, start=1):
        p.number = number
    for p in order:
        if p.end:
            p.end = p.end._replace(kink=p.number, into=p.into.number if p.into else None)
    return order


def _slope(t: Array, x: Array) -> float:
    """Return the slope of the least-squares line through the points."""
    centred = (t - t[0]) - (t - t[0]).mean()
    spread = float(centred @ centred)
    return float(centred @ x) / spread if spread > 0 else 0.0


def measured_speeds(path: _Path, at: Sequence[int], turns: Sequence[float], dx: float) -> list[float]:
    """Return dx/dt of the cubics through the sightings around those with the indices `at`.

    The speed jumps at the times `turns`, so a fit is one-sided close to a merge, as it is close to a birth and an exit.
    It is NaN if the sightings are too few, too near each other for their accuracy, or not on one smooth curve, and at
    x = 0, where kinks are located less well.
    """
    t, x = np.array(path.times), np.array([s.x for s in path.sightings])
    side, whole = np.searchsorted(turns, t, side="right"), x <= -WIDEST_SHOCK * dx
    speeds = np.full(len(at), np.nan)
    rows = max(1, MOST_ENTRIES // t.size)
    for first in range(0, len(at), rows):
        i = np.array(at[first : first + rows])[:, None]
        speeds[first : first + rows] = _speeds_at(i, t, x, whole & whole[i] & (side == side[i]), dx)
    return speeds.tolist()


def _speeds_at(i: Array, t: Array, x: Array, usable: Array, dx: float) -> Array:
    """Return the speeds at the sightings i, shape (rows, 1), from the usable ones, shape (rows, sightings)."""
    far = np.where(usable, np.abs(x - x[i]), np.inf)
    fewest = min(FEWEST_SIGHTINGS, x.size) - 1
    near = usable & (far <= np.maximum(NEARBY * dx, np.partition(far, fewest, axis=1)[:, fewest, None]))
    first, last = np.argmax(near, axis=1)[:, None], x.size - 1 - np.argmax(near[:, ::-1], axis=1)[:, None]
    within = first + np.arange(np.max(last - first) + 1)
    at = np.minimum(within, last)
    near = np.take_along_axis(near, at, axis=1) & (within <= last)
    x, s = np.where(near, x[at] - x[first], 0.0), t[at] - t[i]
    reach, scale = np.ptp(x, axis=1), s[:, -1] - s[:, 0]
    enough = (near.sum(axis=1) >= FEWEST_SIGHTINGS - 1) & (reach >= LEAST_SPAN * dx)
    near, x, s = near[enough], x[enough], s[enough] / scale[enough, None]
    powers = np.stack([near, near * s, near * (s * s), near * (s * s * s)], axis=1)
    # s is of order 1, so the condition of these matrices is 1e5 at most
    cubics = np.linalg.solve(powers @ powers.transpose(0, 2, 1), powers @ x[:, :, None])
    residual = np.abs((powers * cubics).sum(axis=1) - x).max(axis=1, initial=0.0)
    speeds = np.full(len(i), np.nan)
    speeds[enough] = np.where(residual <= SCATTER * reach[enough], cubics[:, 1, 0] / scale[enough], np.nan)
    return speeds


def events_of(paths: Sequence[_Path], end: float) -> list[Event]:
    """Return births, merges and exits up to the time `end`, in their order."""
    births = [Event(p.times[0], "birth", p.number, None, p.sightings[0].x) for p in paths if p.born]
    ends = [p.end for p in paths if p.end and p.end.time <= end]
    return in_order(births + ends)
