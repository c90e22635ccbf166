"""Fronts under a law of linear growth: kinks that become vertical steps (theory, §14).

Kinks alone are integrated to rounding by an adaptive method of order 8, each blow-up, meeting and exit found in its own
time; what is made of smooth data moves by classical Runge-Kutta steps, second order in the number of fronts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.polynomial import polynomial as P

from hjprofile.problem.erosion import Array, ErosionLaw
from hjprofile.solvers.run import Event, KinkRecord, VerticalStep
from hjprofile.solvers.vertical_steps.kernels import step_motion
from hjprofile.solvers.vertical_steps.kernels import steps as kernels
from hjprofile.solvers.vertical_steps.kernels.steps import StepLaw

PIECE = 0.1  # width of the pieces in ln(1+q): degree 7 leaves (PIECE/4)^8 = 2e-13
END = np.log(1e12)  # ln(1+q) that stands for an infinite slope: the rest of R is then 1e-12
REACH = 4.0  # spacings that the fastest front may cross in a step: then time adds little to the error of space
TOLERANCE = 1e-12  # of the exact integration
KINK = 4.0  # times the strength of an ordinary small front: one that has swallowed so much is a kink, or a step
_Z = np.cos(np.pi * (np.arange(8) + 0.5) / 8)
_FIT = np.linalg.inv(np.vander(_Z, 8, increasing=True)).T
BLOW_UP = -2.0  # a log's mark of a blow-up
MOMENT = 1e-9  # accuracy of the times of events, as a part of the end: measured 1e-12 on kinks
AT_ONCE = 1e-11  # distance within which an event at the end of an exact integration has taken place


def step_law(law: ErosionLaw, q_least: float = -0.5) -> StepLaw:
    """Tables over v = ln(1+q) of a law of linear growth, for slopes from `q_least` on.

    In a piece of constant I, R' q_x = -q: dx/dv = -R' e^v/q. The distance from q = ∞ is summed from there; around
    q = 0, where it is infinite, y = 1 - σ with σ = exp(-rate d) from d ln|σ|/dv = rate R' e^v/q.
    """
    below, above = int(np.ceil(-np.log1p(q_least) / PIECE + 0.5)), int(np.ceil(END / PIECE))
    start, pieces = -(below + 0.5) * PIECE, below + above + 1
    left = start + PIECE * np.arange(pieces)
    v = left[:, None] + 0.5 * PIECE * (_Z + 1.0)
    q = np.expm1(v)
    r, slope = law.R(q), law.R_derivative(q)
    r0, rate = float(law.R(0.0)), 1.0 / float(law.R_derivative(0.0))

    def primitive(values: Array) -> Array:
        """Coefficients of ∫ over each piece from its left end."""
        return P.polyint((values @ _FIT).T, lbnd=-1.0, axis=0) * (0.5 * PIECE)

    gap = slope * np.exp(v) / q  # -dx/dv
    joint = below + 1 + int(np.ceil(np.log(2.0) / PIECE))  # the piece from which on distances are summed
    distance = primitive(gap)
    to_the_end = np.append(np.cumsum(P.polyval(1.0, distance[:, joint:])[::-1])[::-1], 0.0)
    d = to_the_end[:-1, None] - P.polyval(_Z, distance[:, joint:])
    # beyond the table the distance falls like (1+q)^-2
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
        r_table, age_table, df_table, area_table, r_at, age_at, start, 1.0 / PIECE, float(left[-1] + PIECE),
        r0, float(r_at[-1]), law.eta0, rate,
    )  # fmt: skip


def _wait(event: Callable, rates: Callable, t: float, state: Array, h: float = 1e-7) -> float:
    """How long ago an event of this state was, by its rate of change."""
    rate = rates(t, state)
    now = event(t, state)
    return float(h * now / (event(t, state + h * rate) - now)) if now else 0.0


class Tracker:
    """Fronts on their way, the first `n` of the arrays that kernels move; and what they have logged.

    Attributes:
        strong: jump from which on a front is a kink or a step, KINK times `quantum`, that of an ordinary small front.
        log: rows (t, kink, into, x), into = 0 a birth, -1 an exit, BLOW_UP a blow-up.
        totals: ∫(K_left - 1) dt, ∫F(0) dt, the number of steps and the highest label.
    """

    x: Array
    label: Array
    moment = MOMENT

    def __init__(self, jump: Array, label: Array, room: int):
        self.n, self.t = jump.size, 0.0
        small = np.abs(jump[label == 0])
        self.quantum = float(np.median(small)) if small.size else np.inf
        self.strong = KINK * self.quantum
        self.log, self.totals = np.zeros((2 * room + 2, 4)), np.zeros(4)
        self.totals[3] = label.max(initial=0)
        self.events: list[Event] = []

    def _note(self, n: int, logged: int) -> None:
        self.n = n
        for t, kink, into, x in self.log[: max(logged, 0)].tolist():
            name = {0.0: "birth", -1.0: "exit", BLOW_UP: "blow-up"}.get(into, "merge")
            self.events.append(Event(t, name, int(kink), int(into) if into > 0 else None, x))

    def least(self) -> float:
        """The smallest q on the right of a front, which a grid may miss between two nodes."""
        raise NotImplementedError

    def _sides(self) -> Iterator[tuple[int, float, float, float]]:
        """Of each front with a label that is no step: its place in the arrays, q on its sides, and its speed."""
        raise NotImplementedError

    def kinks(self) -> list[KinkRecord]:
        """The kinks now, from left to right: both speeds are that of the front."""
        return [
            KinkRecord(self.t, int(self.label[j]), float(self.x[j]), before, after, after - before, speed, speed)
            for j, before, after, speed in self._sides()
            if after > before
        ]


class StepTracker(Tracker):
    """Kinks and steps on their way.

    `x`, `jump` (of I), `label` are those of the fronts that data are cut into, and `spacing` of smooth ones.
    """

    def __init__(self, x: Array, jump: Array, label: Array, spacing: float, exact: bool, law: StepLaw):
        room = max(x.size, 1) + (0 if exact else x.size + 64)
        super().__init__(jump, label, room)
        self.law, self.exact, self.spacing = law, exact, spacing
        self.x, self.jump, self.y, self.since, self.met = (np.zeros(room) for _ in range(5))
        self.label, self.is_step = np.zeros(room, dtype=np.int64), np.zeros(room, dtype=bool)
        self.x[: self.n], self.jump[: self.n], self.label[: self.n] = x, jump, label
        self.since[:] = self.met[:] = np.inf
        self.work = np.zeros((14, room))
        if not exact:
            self._sweep()
            q, strong, *rest = self._rest
            self._note(*step_motion.transitions(*self._arrays, self.n, 0.0, q, strong, *rest[:-1], 0, self.totals))

    @property
    def _arrays(self) -> tuple[Array, ...]:
        return self.x, self.jump, self.is_step, self.y, self.label, self.since, self.met

    @property
    def _rest(self) -> tuple:
        return self.quantum, self.strong, self.law, self.work, self.log, self.totals

    def advance(self, end: float) -> bool:
        """To the time `end`, if steps are not too small for that; events are noted."""
        if self.exact:
            return self._advance_exactly(end)
        n, logged = step_motion.advance(*self._arrays, self.n, self.t, end, REACH, self.spacing, *self._rest)
        self._note(n, logged)
        self.t = end
        return bool(logged >= 0)

    def _sweep(self, x: Array | None = None, y: Array | None = None) -> None:
        """Fills `work` with v left and right, R left and right, heights, K on the right, speeds and drifts."""
        x, y = self.x if x is None else x, self.y if y is None else y
        kernels.sweep(x, self.jump, self.is_step, y, self.n, self.n - 1, self.law, *self.work[:8])

    def _advance_exactly(self, end: float) -> bool:
        from scipy.integrate import solve_ivp

        law = self.law
        while self.n and self.t < end:
            n, is_step = self.n, self.is_step[: self.n].copy()

            def swept(state: Array, n: int = n) -> Array:
                self._sweep(state[:n], state[n : 2 * n])
                return self.work[:, :n]

            def rates(_: float, state: Array, n: int = n) -> Array:
                _, v_right, _, _, m, K, speed, drift = swept(state)[:8]
                return np.concatenate([speed, drift, kernels.flows(state[:n], n - 1, v_right, m, K, law)])

            def meet(_: float, state: Array, n: int = n) -> float:
                return float(np.min(np.diff(state[:n]))) if n > 1 else 1.0

            def leave(_: float, state: Array, n: int = n) -> float:
                return -float(state[n - 1])

            def room(_: float, state: Array, n: int = n, is_step: Array = is_step) -> float:
                """The least that is left of R at a kink under an infinite slope."""
                left = law.r_most - swept(state)[2] - self.jump[:n]
                return float(np.min(left[~is_step], initial=1.0))

            for event in (meet, leave, room):
                event.terminal = True  # type: ignore[attr-defined]
                event.direction = -1.0  # type: ignore[attr-defined]
            start = np.concatenate([self.x[:n], self.y[:n], self.totals[:2]])
            if room(0.0, start) > 0.0:
                how = {"method": "DOP853", "rtol": TOLERANCE, "atol": TOLERANCE}
                part = solve_ivp(rates, (self.t, end), start, events=[meet, leave, room], **how)
                if part.status < 0:
                    return False
                self.totals[2] += part.t.size - 1
                state, t = part.y[:, -1], float(part.t[-1])
                happened = [times.size > 0 for times in part.t_events]
                if any(happened):  # found on an interpolant, which is not as good as the steps
                    event = (meet, leave, room)[happened.index(True)]
                    for _ in range(2):
                        t = float(np.clip(t - _wait(event, rates, t, state), self.t, end))
                        state = solve_ivp(rates, (self.t, t), start, **how).y[:, -1]
                self.t = t
            else:
                state, happened = start, [False, False, True]
            self.x[:n], self.y[:n], self.totals[:2] = state[:n], np.maximum(state[n : 2 * n], 0.0), state[2 * n :]
            self._meet_or_leave(happened)
        self.t = end
        while any(due := self._due()):
            self._meet_or_leave(due)
        return True

    def _due(self) -> list[bool]:
        """Return the events that have taken place to rounding; the integration misses those just ahead of it."""
        n = self.n
        if not n:
            return [False, False, False]
        self._sweep()
        left = (self.law.r_most - self.work[2, :n] - self.jump[:n])[~self.is_step[:n]]
        gaps = np.min(np.diff(self.x[:n]), initial=1.0), -self.x[n - 1], np.min(left, initial=1.0)
        return [bool(gap <= AT_ONCE) for gap in gaps]

    def _meet_or_leave(self, happened: list[bool]) -> None:
        """What the events make of the fronts; those of other kinds at the same moment follow in the next round."""
        logged, n = 0, self.n
        self._sweep()
        v_right, m = self.work[1].copy(), self.work[4].copy()
        if happened[1]:
            self.n -= 1
            if self.is_step[n - 1]:
                self.totals[1] += m[n - 1]
            logged = kernels.note(self.log, logged, self.t, self.label[n - 1], -1.0, 0.0)
        elif happened[0]:
            j = int(np.argmin(np.diff(self.x[:n])))
            if self.is_step[j] or self.is_step[j + 1]:
                self.y[j + 1] = self.y[j + 1] if self.is_step[j + 1] else kernels.y_of(v_right[j + 1], self.law)
                self.is_step[j + 1] = True
            first, second = self.label[j], self.label[j + 1]
            logged = kernels.note(self.log, logged, self.t, max(first, second), min(first, second), self.x[j])
            self.jump[j + 1] += self.jump[j]
            self.label[j + 1] = min(first, second)
            for array in self._arrays:
                array[j : n - 1] = array[j + 1 : n]
            self.n -= 1
        elif happened[2]:
            left = self.law.r_most - self.work[2, :n] - self.jump[:n]
            j = int(np.argmin(np.where(self.is_step[:n], np.inf, left)))
            self.is_step[j], self.y[j] = True, 0.0
            logged = kernels.note(self.log, logged, self.t, self.label[j], BLOW_UP, self.x[j])
        self._note(self.n, logged)

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """W and K at the nodes; at a step those on its right."""
        W, K = np.empty_like(nodes), np.empty_like(nodes)
        kernels.read(self.x, self.jump, self.is_step, self.y, self.n, self.law, self.work, nodes, W, K)
        return W, K

    def volume(self) -> float:
        """∫W dx."""
        self._sweep()
        return float(kernels.volume(self.x, self.jump, self.n, self.work[0], self.work[1], self.law))

    def least(self) -> float:
        self._sweep()
        return float(np.expm1(self.work[1, : self.n].min(initial=0.0)))

    def _sides(self) -> Iterator[tuple[int, float, float, float]]:
        self._sweep()
        left, right = np.expm1(self.work[:2, : self.n])
        for j in np.flatnonzero((self.label > 0)[: self.n] & ~self.is_step[: self.n]).tolist():
            yield j, float(left[j]), float(right[j]), float(self.work[6, j])

    def vertical_steps(self) -> list[VerticalStep]:
        """The steps now, from left to right."""
        self._sweep()
        return [
            VerticalStep(self.t, int(self.label[j]), float(self.x[j]), float(self.work[4, j]), float(self.work[6, j]))
            for j in range(self.n)
            if self.label[j] > 0 and self.is_step[j]
        ]
