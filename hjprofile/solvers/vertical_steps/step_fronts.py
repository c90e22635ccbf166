"""Fronts under a law of linear growth: kinks that become vertical steps (§16).

If the data are kinks only, an adaptive method of order 8 integrates them to rounding and locates each blow-up, merge
and exit in time. Fronts of smooth data move by classical Runge-Kutta steps, with second order in the number of fronts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.polynomial import polynomial as P

from hjprofile.problem.erosion import Array, ErosionLaw
from hjprofile.solvers.fronts.front_data import FrontData, Pieces
from hjprofile.solvers.fronts.tracker import Tracker
from hjprofile.solvers.kernels.journal import BLOW_UP, CREST_LOWERING, EXIT, MERGE, STEPS, note
from hjprofile.solvers.run import VerticalStep
from hjprofile.solvers.vertical_steps.kernels import steps as kernels
from hjprofile.solvers.vertical_steps.kernels.step_motion import StepControl, StepWorkspace, advance
from hjprofile.solvers.vertical_steps.kernels.step_transitions import transitions
from hjprofile.solvers.vertical_steps.kernels.steps import StepFronts, StepLaw, StepSides

V_PIECE = 0.1  # width of the pieces in ln(1+q): degree 7 leaves (PIECE/4)^8 = 2e-13
END = np.log(1e12)  # ln(1+q) of an infinite slope: the remainder of R is then 1e-12
REACH = 4.0  # spacings that the fastest front may cross in a step: the error in time is then below that in space
TOLERANCE = 1e-12  # of the exact integration
FINER = 1 / 8  # spacing of the time step control, as a fraction of the mean: fronts are crowded at a vertical step
_Z = np.cos(np.pi * (np.arange(8) + 0.5) / 8)
_FIT = np.linalg.inv(np.vander(_Z, 8, increasing=True)).T
AT_ONCE = 1e-11  # distance within which an event at the end of an exact integration counts as past


def step_law(law: ErosionLaw, q_least: float = -0.5) -> StepLaw:
    """Return the tables over v = ln(1+q) of a law of linear growth, for slopes from `q_least` on.

    In a piece of constant I, R' q_x = -q: dx/dv = -R' e^v/q. The distance from q = ∞ is summed from there. Around q =
    0, where it is infinite, y = 1 - σ with σ = exp(-rate d) from d ln|σ|/dv = rate R' e^v/q.
    """
    below, above = int(np.ceil(-np.log1p(q_least) / V_PIECE + 0.5)), int(np.ceil(END / V_PIECE))
    start, pieces = -(below + 0.5) * V_PIECE, below + above + 1
    left = start + V_PIECE * np.arange(pieces)
    v = left[:, None] + 0.5 * V_PIECE * (_Z + 1.0)
    q = np.expm1(v)
    r, slope = law.R(q), law.R_derivative(q)
    r0, rate = float(law.R(0.0)), 1.0 / float(law.R_derivative(0.0))

    def primitive(values: Array) -> Array:
        """Return the coefficients of ∫ over each piece from its left end."""
        return P.polyint((values @ _FIT).T, lbnd=-1.0, axis=0) * (0.5 * V_PIECE)

    gap = slope * np.exp(v) / q  # -dx/dv
    joint = below + 1 + int(np.ceil(np.log(2.0) / V_PIECE))  # the first piece in which distances are summed
    distance = primitive(gap)
    to_the_end = np.append(np.cumsum(P.polyval(1.0, distance[:, joint:])[::-1])[::-1], 0.0)
    d = to_the_end[:-1, None] - P.polyval(_Z, distance[:, joint:])
    # beyond the table the distance decreases like (1+q)^-2
    d += 0.5 * float(gap[-1, 0])
    age = np.empty_like(v)
    age[joint:] = -np.log(-np.expm1(-rate * d))
    excess = primitive(rate * gap - np.exp(v) / q)  # of d ln σ/dv over d ln q/dv
    before = np.concatenate([[0.0], np.cumsum(P.polyval(1.0, excess))])
    exponent = before[:-1, None] + P.polyval(_Z, excess)
    exponent -= before[below] + P.polyval(0.0, excess[:, below])
    sigma = q * np.exp(exponent)
    q_joint = np.expm1(left[joint])
    e_joint = before[joint] - before[below] - P.polyval(0.0, excess[:, below])
    sigma *= np.exp(-rate * (to_the_end[0] + 0.5 * float(gap[-1, 0]))) / (q_joint * np.exp(e_joint))
    age[:joint] = -np.log1p(-sigma[:joint])
    area = primitive((r - r0) * gap)
    summed = np.concatenate([[0.0], np.cumsum(P.polyval(1.0, area))[:-1]])
    areas = summed[:, None] + P.polyval(_Z, area)
    areas -= summed[below] + P.polyval(0.0, area[:, below])

    r_table, age_table, df_table, area_table = (
        np.ascontiguousarray(values @ _FIT) for values in (r, age, law.derivative(q), areas)
    )
    r_at, age_at = (np.append(P.polyval(-1.0, t.T), P.polyval(1.0, t[-1])) for t in (r_table, age_table))
    return StepLaw(
        r_table, age_table, df_table, area_table, r_at, age_at, start, 1.0 / V_PIECE, float(left[-1] + V_PIECE),
        r0, float(r_at[-1]), law.eta0, rate,
    )  # fmt: skip


def _wait(event: Callable, rates: Callable, t: float, state: Array, h: float = 1e-7) -> float:
    """Return the time since an event of this state, by its rate of change."""
    rate = rates(t, state)
    now = event(t, state)
    return float(h * now / (event(t, state + h * rate) - now)) if now else 0.0


def _start_of_pieces(law: ErosionLaw, table: StepLaw, mass: Array, h: Array) -> Array:
    """Return r at the left ends of pieces."""
    v = np.empty_like(mass)
    kernels.start_pieces(mass, h, table, v)
    return law.R(np.expm1(v))


LINEAR = Pieces(lambda law, least, ceiling: step_law(law, least), _start_of_pieces)


class StepTracker(Tracker):
    """Moving kinks and vertical steps."""

    def __init__(self, data: FrontData, law: StepLaw, exact: bool, end: float = 1.0):
        capacity = max(data.x.size, 1) + (0 if exact else data.x.size + 64)
        super().__init__(data, exact, end, capacity)
        self.law = law
        self.x, self.jump, self.y, blow_up, first_merge = (np.zeros(capacity) for _ in range(5))
        self.label, self.is_step = np.zeros(capacity, dtype=np.int64), np.zeros(capacity, dtype=bool)
        self.x[: self.n], self.jump[: self.n], self.label[: self.n] = data.x, data.jump, data.label
        blow_up[:] = first_merge[:] = np.inf
        self.fronts = StepFronts(self.x, self.jump, self.is_step, self.y, self.label, blow_up, first_merge)
        self.sides, self.work = StepSides(*np.zeros((8, capacity))), StepWorkspace(*np.zeros((6, capacity)))
        self.control = StepControl(FINER * data.spacing, REACH, self.quantum, self.strong)
        if not exact:
            self._sweep()
            quantum, strong = self.quantum, self.strong
            self._note(transitions(self.fronts, self.n, 0.0, quantum, strong, law, self.sides, self.journal))

    def advance(self, target: float) -> None:
        """Advance to the time `target` unless steps become too small; record events."""
        if self.exact:
            self.arrived = self._advance_exactly(target)
        else:
            state, rest = (self.fronts, self.n, self.t, target), (self.law, self.sides, self.work, self.journal)
            self._note(*advance(*state, self.control, *rest))
        self.t = target

    def _sweep(self, x: Array | None = None, y: Array | None = None) -> StepSides:
        """Fill the sides of the current fronts, and return the arrays."""
        x, y = self.x if x is None else x, self.y if y is None else y
        kernels.sweep(x, y, self.fronts, self.n, self.n - 1, self.law, self.sides)
        return self.sides

    def _advance_exactly(self, end: float) -> bool:
        """Advance kinks and vertical steps to rounding; return True if the end is reached."""
        from scipy.integrate import solve_ivp

        law = self.law
        while self.n and self.t < end:
            n, is_step = self.n, self.is_step[: self.n].copy()

            def rates(_: float, state: Array, n: int = n) -> Array:
                sides = self._sweep(state[:n], state[n : 2 * n])
                return np.concatenate([sides.speed[:n], sides.drift[:n], kernels.flows(state[:n], n - 1, sides, law)])

            def meet(_: float, state: Array, n: int = n) -> float:
                return float(np.min(np.diff(state[:n]))) if n > 1 else 1.0

            def leave(_: float, state: Array, n: int = n) -> float:
                return -float(state[n - 1])

            def blow_up(_: float, state: Array, n: int = n, is_step: Array = is_step) -> float:
                """Return the smallest difference between R of an infinite slope and R on the right of a kink."""
                left = law.r_most - self._sweep(state[:n], state[n : 2 * n]).r_left[:n] - self.jump[:n]
                return float(np.min(left[~is_step], initial=1.0))

            for event in (meet, leave, blow_up):
                event.terminal = True  # type: ignore[attr-defined]
                event.direction = -1.0  # type: ignore[attr-defined]
            start = np.concatenate([self.x[:n], self.y[:n], self.totals])
            if blow_up(0.0, start) > 0.0:
                how = {"method": "DOP853", "rtol": TOLERANCE, "atol": TOLERANCE}
                part = solve_ivp(rates, (self.t, end), start, events=[meet, leave, blow_up], **how)
                if part.status < 0:
                    return False
                self.journal.counts[STEPS] += part.t.size - 1
                state, t = part.y[:, -1], float(part.t[-1])
                occurred = [times.size > 0 for times in part.t_events]
                if any(occurred):  # located on an interpolant, which is less accurate than the steps
                    event = (meet, leave, blow_up)[occurred.index(True)]
                    for _ in range(2):
                        t = float(np.clip(t - _wait(event, rates, t, state), self.t, end))
                        state = solve_ivp(rates, (self.t, t), start, **how).y[:, -1]
                self.t = t
            else:
                state, occurred = start, [False, False, True]
            self.x[:n], self.y[:n], self.totals[:] = state[:n], np.maximum(state[n : 2 * n], 0.0), state[2 * n :]
            self._meet_or_leave(occurred)
        self.t = end
        while any(due := self._due()):
            self._meet_or_leave(due)
        return True

    def _due(self) -> list[bool]:
        """Return the events that have occurred to rounding; the integration misses those just ahead of it."""
        n = self.n
        if not n:
            return [False, False, False]
        left = (self.law.r_most - self._sweep().r_left[:n] - self.jump[:n])[~self.is_step[:n]]
        gaps = np.min(np.diff(self.x[:n]), initial=1.0), -self.x[n - 1], np.min(left, initial=1.0)
        return [bool(gap <= AT_ONCE) for gap in gaps]

    def _meet_or_leave(self, occurred: list[bool]) -> None:
        """Update the fronts after events; events of other kinds at the same time follow in the next round."""
        n, sides = self.n, self._sweep()
        if occurred[1]:
            self.n -= 1
            if self.is_step[n - 1]:
                self.totals[CREST_LOWERING] += sides.height[n - 1]
            note(self.journal, self.t, EXIT, self.label[n - 1], 0, 0.0)
        elif occurred[0]:
            j = int(np.argmin(np.diff(self.x[:n])))
            if self.is_step[j] or self.is_step[j + 1]:
                self.y[j + 1] = self.y[j + 1] if self.is_step[j + 1] else kernels.y_of(sides.v_right[j + 1], self.law)
                self.is_step[j + 1] = True
            first, second = self.label[j], self.label[j + 1]
            note(self.journal, self.t, MERGE, max(first, second), min(first, second), self.x[j])
            self.jump[j + 1] += self.jump[j]
            self.label[j + 1] = min(first, second)
            for array in self.fronts:
                array[j : n - 1] = array[j + 1 : n]
            self.n -= 1
        elif occurred[2]:
            left = self.law.r_most - sides.r_left[:n] - self.jump[:n]
            j = int(np.argmin(np.where(self.is_step[:n], np.inf, left)))
            self.is_step[j], self.y[j] = True, 0.0
            note(self.journal, self.t, BLOW_UP, self.label[j], 0, self.x[j])
        self._note(self.n)

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """Return W and K at the nodes; at a vertical step the values on its right."""
        W, K = np.empty_like(nodes), np.empty_like(nodes)
        kernels.read(self.fronts, self.n, self.law, self.sides, nodes, W, K)
        return W, K

    def volume(self) -> float:
        """Return ∫W dx."""
        return float(kernels.volume(self.fronts, self.n, self._sweep(), self.law))

    def least(self) -> float:
        """Return the smallest q on the right of a front."""
        return float(np.expm1(self._sweep().v_right[: self.n].min(initial=0.0)))

    def _kink_sides(self) -> Iterator[tuple[int, float, float, float]]:
        """Yield index, q on both sides and speed of each kink."""
        sides = self._sweep()
        left, right = np.expm1(sides.v_left[: self.n]), np.expm1(sides.v_right[: self.n])
        for j in np.flatnonzero((self.label > 0)[: self.n] & ~self.is_step[: self.n]).tolist():
            yield j, float(left[j]), float(right[j]), float(sides.speed[j])

    def vertical_steps(self) -> list[VerticalStep]:
        """Return the current vertical steps, from left to right."""
        sides = self._sweep()
        return [
            VerticalStep(self.t, int(self.label[j]), float(self.x[j]), float(sides.height[j]), float(sides.speed[j]))
            for j in range(self.n)
            if self.label[j] > 0 and self.is_step[j]
        ]
