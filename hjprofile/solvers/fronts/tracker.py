"""Moving fronts as a solution: the common part under laws of sublinear and of linear growth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hjprofile.problem.grid import Grid
from hjprofile.solvers.fronts.front_data import FrontData
from hjprofile.solvers.kernels.journal import EVENTS, HIGHEST_LABEL, LOGGED, MERGE, STEPS, Journal
from hjprofile.solvers.run import Array, Event, KinkRecord
from hjprofile.solvers.snapshots import Lost, Solution
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Time

KINK = 4.0  # strength of a kink or vertical step, relative to an ordinary small front
MOMENT = 1e-9  # accuracy of the times of events, as a fraction of the end; measured: 1e-12 on kinks


class Tracker(Solution):
    """Moving fronts, the first `n` of the arrays that kernels update.

    Attributes:
        x, jump, label: positions, jumps of I and labels.
        exact: True if fronts are moved to rounding.
        strong: smallest jump of a kink or step: KINK times `quantum`, the jump of an ordinary small front.
        arrived: True if the last `advance` reached its target.
        journal: the records of the kernels.
    """

    x: Array
    jump: Array
    label: Array
    totals: Array

    def __init__(self, data: FrontData, exact: bool, end: float, capacity: int):
        self.data, self.exact, self.moment = data, exact, MOMENT * end
        self.n, self.t, self.arrived = data.jump.size, 0.0, True
        small = np.abs(data.jump[data.label == 0])
        self.quantum = float(np.median(small)) if small.size else np.inf
        self.strong = KINK * self.quantum
        self.journal = Journal(np.zeros((2 * capacity + 2, 5)), np.zeros(2), np.zeros(3, dtype=np.int64))
        self.journal.counts[HIGHEST_LABEL] = data.label.max(initial=0)
        self.totals = self.journal.totals
        self.events: list[Event] = []

    @property
    def steps(self) -> int:  # type: ignore[override]
        """The number of time steps so far."""
        return int(self.journal.counts[STEPS])

    def _note(self, n: int, arrived: bool = True) -> None:
        """Store the results of a kernel. Events of an unfinished stretch are dropped."""
        self.n, self.arrived = n, arrived
        for t, kind, kink, into, x in self.journal.log[: self.journal.counts[LOGGED] if arrived else 0].tolist():
            self.events.append(Event(t, EVENTS[int(kind)], int(kink), int(into) if kind == MERGE else None, x))
        self.journal.counts[LOGGED] = 0

    def check(self, grid: Grid, W: Array, K: Array) -> None:
        """Raise Lost if the state is not admissible, or if the target was not reached."""
        fault = _first_fault(W, K, grid)
        if fault is None and not self.arrived:
            fault = int(np.argmax(K))
        if fault is not None:
            raise Lost(
                Stop(
                    Reason.NOT_RESOLVED,
                    "stopped before t = {t:.6g}: front tracking fails near x = {x:.6g}, where q is too near "
                    "-1 for this number of fronts, or K is too large to separate events",
                    f"use the method auto with a tolerance, or the method {ROBUST_METHOD}",
                    {"t": Time(self.t), "x": Place(grid.nodes[fault])},
                )
            )

    def least(self) -> float:
        """Return the smallest q on the right of a front, which a grid may miss between two nodes."""
        raise NotImplementedError

    def _kink_sides(self) -> Iterator[tuple[int, float, float, float]]:
        """Yield index, q on the left and right, and speed of each labelled front that is not a vertical step."""
        raise NotImplementedError

    def kinks(self) -> list[KinkRecord]:
        """Return the current kinks, from left to right: both speeds are that of the front."""
        return [
            KinkRecord(self.t, int(self.label[j]), float(self.x[j]), before, after, after - before, speed, speed)
            for j, before, after, speed in self._kink_sides()
            if after > before
        ]


def _first_fault(W: Array, K: Array, grid: Grid) -> int | None:
    """Return the rightmost node at which the state is not admissible, or None."""
    q = np.diff(W) / grid.dx
    bad = ~(np.isfinite(K) & (K > 0.0))
    bad[1:] |= ~(np.isfinite(q) & (q > -1.0))
    return int(np.flatnonzero(bad)[-1]) if bad.any() else None
