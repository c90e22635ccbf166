"""Fronts under a law of sublinear growth."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.solvers.fronts.front_data import FrontData, Pieces
from hjprofile.solvers.fronts.kernels import front_reading
from hjprofile.solvers.fronts.kernels.exact_fronts import ExactControl, advance_exactly
from hjprofile.solvers.fronts.kernels.front_merging import Stack
from hjprofile.solvers.fronts.kernels.front_state import Fronts, Medium, Sides, sweep
from hjprofile.solvers.fronts.kernels.moving_fronts import Control, Workspace, advance
from hjprofile.solvers.fronts.tracker import KINK, Tracker
from hjprofile.solvers.invariant import law_table
from hjprofile.solvers.kernels.dormand_prince import STAGES, tableau
from hjprofile.solvers.kernels.law import LawTable, Rational, law_q_f, start_pieces
from hjprofile.solvers.run import Array

TIME = 1.0  # largest error of the time steps, in areas of a piece; measured: a tenth of the error in space
# Of many jumps: the number for which these errors may be as large again, and the largest factor. Crossings
# on the whole slope are added, but each displaces W near it only. Measured: less than a third of the error in space
JUMPS_PER_TIME, MOST_TIME = 1000.0, 20.0
STILL = 1e-4  # error of u by fronts that are left at rest, in areas of a piece
SAVED = 0.1  # largest time for which unused error is saved for later steps, as a fraction of the end
TAYLOR_REACH = 0.05  # largest distance of a Taylor series
TAYLOR_AREA = 0.1  # its fourth power, in areas of a piece: the error of the series is then a 24th of the area
SMALL_FRONT_QUANTILE = 0.95  # quantile of the jumps of small fronts; a new kink is KINK times stronger
TOLERANCE = 1e-13  # of one step of the exact integration


class FrontTracker(Tracker):
    """Fronts under a law of sublinear growth."""

    def __init__(self, data: FrontData, table: Rational | LawTable, exact: bool, end: float = 1.0):
        capacity = max(data.x.size, 1)
        super().__init__(data, exact, end, capacity)
        self.x, self.jump, self.label = data.x.copy(), data.jump.copy(), data.label.copy()
        self.fronts = Fronts(self.x, self.jump, self.label, np.full(capacity, np.inf), data.smooth.copy())
        small = np.abs(self.jump[self.label == 0])
        if small.size and not exact:  # jumps differ if lengths do
            self.strong = KINK * float(np.quantile(small, SMALL_FRONT_QUANTILE))
        self.medium = Medium(data.r0, 0.0 if exact else min(TAYLOR_REACH, (TAYLOR_AREA * data.area) ** 0.25), table)
        label, first = np.zeros(capacity, dtype=np.int64), np.zeros(capacity, dtype=np.int64)
        x, jump, first_merge, speed = np.zeros((4, capacity))
        states, more = (STAGES + 1, 2) if exact else (5, 0)  # more: the integrals in the state
        rate, (trial, new) = np.zeros((states, capacity + more)), np.zeros((2, capacity + more))
        self.sides = Sides(*np.zeros((4, capacity)))
        self.work = Workspace(
            self.sides, Stack(x, jump, label, first_merge, speed, first), rate, trial, new, np.zeros(capacity)
        )
        # longest step^4 scales with the inverse square of the number of fronts, as the error in space does
        longest = max(end, 1e-300) / math.sqrt(capacity)
        first_step = np.array([min(math.sqrt(data.area), longest), SAVED * end])
        share = min(max(data.dense / JUMPS_PER_TIME, 1.0), MOST_TIME)
        allowed = TIME * share * data.area / max(end, 1e-300)
        self.control = Control(self.strong, allowed, longest, SAVED * end, STILL * data.area, first_step)

    def advance(self, target: float) -> None:
        """Advance to the time `target` unless steps become too small; record merges, births and exits."""
        state, rest = (self.fronts, self.n, self.t, target), (self.medium, self.work, self.journal)
        if self.exact:
            self._note(*advance_exactly(*state, ExactControl(self.strong, TOLERANCE, tableau()), *rest))
        else:
            self._note(*advance(*state, self.control, *rest))
        self.t = target

    def _sweep(self) -> Sides:
        """Return the sides of the current fronts."""
        sweep(self.x, self.jump, self.n, self.n - 1, self.medium, self.sides)
        return Sides(*(side[: self.n] for side in self.sides))

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """Return W and K at the nodes."""
        W, K = np.empty_like(nodes), np.empty_like(nodes)
        front_reading.read(self.fronts, self.n, self.data.area, self.medium, self.sides, nodes, W, K)
        return W, K

    def volume(self) -> float:
        """Return ∫W dx."""
        return front_reading.volume(self.fronts, self.n, self.medium, self._sweep().r_right)

    def least(self) -> float:
        """Return the smallest q on the right of a front."""
        right = self._sweep().r_right
        return float(law_q_f(right.min(), self.medium.law)[0]) if self.n else 0.0

    def _kink_sides(self) -> Iterator[tuple[int, float, float, float]]:
        """Yield index, q on both sides and speed of each kink."""
        left, right, slope, K = self._sweep()
        law = self.medium.law
        for j in np.flatnonzero(self.label[: self.n] > 0).tolist():
            q_left, q_right = (float(law_q_f(r[j], law)[0]) for r in (left, right))
            yield j, q_left, q_right, float(K[j] * slope[j])


def _table(law: ErosionLaw, least: float, ceiling: float) -> Rational | LawTable:
    """Return the tables of a law for q >= least and R(q) <= 1.1 ceiling."""
    q = 1.0
    while law.R(q) < 1.1 * ceiling:
        q *= 2.0
    return law_table(law, least, q)


def _start_of_pieces(law: ErosionLaw, table: Rational | LawTable, mass: Array, h: Array) -> Array:
    """Return r at the left ends of pieces."""
    if law.name == "rational":
        return 1.0 + mass / -np.expm1(-h)
    r = np.empty_like(mass)
    start_pieces(mass, h, table, r)
    return r


SUBLINEAR = Pieces(_table, _start_of_pieces)
