"""Labels of characteristics in time: steps of order 8, adaptive panels, and events (§14)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hjprofile.problem import Problem
from hjprofile.solvers.characteristics import label_events as events
from hjprofile.solvers.characteristics.kernels import label_motion as kernels
from hjprofile.solvers.characteristics.kernels.labels import Medium, Stages, after_start, before_end
from hjprofile.solvers.characteristics.panels import POINTS, RULE, TAIL, Panels, interpolation, tails
from hjprofile.solvers.kernels.dormand_prince import STAGES, state_within, tableau
from hjprofile.solvers.kernels.law import LawTable, Rational, law_q_f
from hjprofile.solvers.run import Array, Event, KinkRecord
from hjprofile.solvers.snapshots import Lost, Solution
from hjprofile.solvers.stop import Place, Reason, Stop, Time

# Measured seconds of a step, of a label in it, and of a saved time
TRY, LABEL, READ = 5e-4, 1.2e-6, 1.5e-3
CORNER = 1e-3  # fraction of a panel within which a birth is assigned to a corner; a sliver would halve every step
FLOOR = 1e-13  # smallest step, as a fraction of the end
SMALLEST_STEP_ERROR = 1e-15  # error of a step below which it is rounding
MOMENT, TOLERANCES, BIRTH_DELAY = 1e-11, 10.0, 100.0  # of events: part of the end; of tolerances; of `threshold`
MOST_PANELS, MOST_EVENTS = 4000, 200  # MOST_EVENTS: at one time; each removes a kink, a panel or a label
LARGEST_DELAY = 1e-4  # largest interval after the end that is searched for events, as a fraction of the end
NARROWEST_PANEL = 1e-9
SQUARE_ROOT = 0.7  # first step of sqrt(t - birth), relative to the square root of the last time step
MUCH_BETTER = 1 / 30  # largest error of a step whose interpolant is used for the state at an event
AT_EVENT = 1e-14  # largest sign of an event after a step to it, as a fraction of its change


@dataclass
class _Stretch:
    """The start of a step: the panels, and the origin of its clock."""

    panels: Panels
    t: float
    origin: float  # NaN, or the last birth: the clock is then sqrt(t - origin)

    def clock(self, t: float) -> float:
        """Return the clock at time t."""
        return t if np.isnan(self.origin) else float(np.sqrt(max(t - self.origin, 0.0)))

    def time(self, clock: float) -> float:
        """Return the time of a value of the clock."""
        return clock if np.isnan(self.origin) else self.origin + clock * clock


class MovingLabels(Solution):
    """Moving characteristics, to a tolerance of W; `patience` is the remaining work in seconds."""

    def __init__(self, problem: Problem, panels: Panels, table: Rational | LawTable, tolerance: float, patience: float):
        self.table, self.requested, self.end, self.patience = table, tolerance, float(problem.end), patience
        # births depend on X_ξ and q, so errors must be small relative to the narrowest panel and the largest q
        narrowest, largest = float(panels.mesh.half.min()), float(np.abs(panels.r - problem.law.R(0.0)).max())
        self.tolerance = max(tolerance * min(1.0, narrowest) * min(1.0, largest), SMALLEST_STEP_ERROR)
        self.now = _Stretch(panels, 0.0, np.nan)
        self.r0 = float(problem.law.R(0.0))
        self.h = self.dt = 0.01 * max(problem.end, 1e-300)
        self.events: list[Event] = []
        self.count, self.steps = panels.shocks, 0
        # the smallest negative slope of X in the label that exceeds the errors of panels and steps
        self.threshold = max(1e-7, 30.0 * POINTS**2 * tolerance)
        self.moment = problem.end * max(MOMENT, TOLERANCES * tolerance)
        self._allocate()

    @property
    def totals(self) -> list[float]:  # type: ignore[override]
        """The integrals ∫(K_left - 1) dt and ∫F(0) dt so far."""
        return self.now.panels.totals.tolist()

    def volume(self) -> float:
        """Return ∫W dx."""
        return self.now.panels.volume()

    def stop(self, target: float, lost: Lost) -> Stop:
        """Return the reason of a stop before `target`."""
        return Stop(
            lost.stop.reason,
            "stopped at t = {t:.6g}, before t = {before:.6g}: {why}",
            "use the method fronts",
            {"t": Time(self.now.t), "before": Time(target), "why": lost.stop},
        )

    @property
    def flat(self) -> bool:
        """True if every label has left at x = 0."""
        return len(self.now.panels.r) == 0

    def _allocate(self) -> None:
        """Allocate the work arrays for the current panels."""
        panels = self.now.panels
        self.medium = Medium(panels.mesh, RULE, self.table)
        rates = np.zeros((STAGES + 4, 2 * panels.r.size + 2))
        self.stages = Stages(np.zeros(panels.r.shape), np.zeros(panels.shocks + 1), rates)

    def advance(self, target: float) -> None:
        """Advance to the time `target`. Raise Lost if that fails."""
        stalled = 0
        while self.now.t < target and not self.flat:
            before = self.now.t
            self._step(target)
            stalled = stalled + 1 if self.now.t == before else 0
            if stalled > MOST_EVENTS:
                raise Lost(Stop(Reason.LABELS_LOST, f"more than {MOST_EVENTS} events occur at one time"))
        if self.flat:
            self.now.t = target

    def _try(self, h: float) -> tuple[Panels, float]:
        """Return the panels after a step h of the clock, and the error of the step relative to the tolerance."""
        now, panels = self.now, self.now.panels
        self.patience -= TRY + LABEL * panels.r.size
        if self.patience < 0.0:
            raise Lost(Stop(Reason.TOO_LONG, "the run would take too long"))
        shocks, new = panels.labels(), np.empty(2 * panels.r.size + 2)
        error, self.found = kernels.step(
            panels.y, now.clock(now.t), h, now.origin, tableau(), self.medium, shocks, self.stages, new
        )
        return panels.at(new, shocks), error / self.tolerance

    def _step(self, target: float) -> None:
        """Make one step towards `target`, up to the first event."""
        now = self.now
        left = now.clock(target) - now.clock(now.t)
        h = min(self.h, left)
        if left < 1.5 * h:
            h = left if left <= h else 0.5 * left
        while True:
            if now.time(now.clock(now.t) + h) - now.t < FLOOR * self.end and h < left:
                raise Lost(self._why())
            panels, error = self._try(h)
            if not error <= 1.0:
                self.h = 0.0
                h *= 0.3 if not np.isfinite(error) else max(0.2, 0.9 * error**-0.125)
                continue
            rough = self._rough(panels)
            if rough:
                self.now = now = replace(now, panels=now.panels.split(dict.fromkeys(rough, 0.0)))
                self._allocate()
                if len(now.panels.r) > MOST_PANELS:
                    raise Lost(Stop(Reason.NOT_RESOLVED, f"the profile needs more than {MOST_PANELS} panels"))
                continue
            before, reached = h, h == left
            crossed = events.crossed(events.signs(panels), self.threshold)
            if crossed:
                h, panels, event, error = self._first_event(crossed, h, panels, error)
                if not error <= 1.0:  # the error estimate of the longer step was too small
                    self.h, h = 0.0, 0.5 * h
                    continue
                reached = False
            break
        self.steps += 1
        t = target if reached else now.time(now.clock(now.t) + h)
        self.dt = now.time(now.clock(now.t) + before) - now.t
        if crossed and self.h == 0.0:
            self.h = before
        self.now = _Stretch(panels, t, now.origin)
        if crossed:
            self._apply(event)
        if not self.flat:
            trimmed = self.now.panels.trimmed()
            if trimmed is not self.now.panels or crossed:
                self.now = replace(self.now, panels=trimmed)
                self._allocate()
        if not crossed:  # a step that was shortened to a saved time does not limit the next one
            self.h = max(self.h, before * (min(2.0, 0.9 * error**-0.125) if error > 0.0 else 2.0))

    def _why(self) -> Stop:
        """Return the reason of a failure."""
        if self.found > 0:
            kink = self.now.panels.number[self.found - 1]
            return Stop(
                Reason.LABELS_LOST, f"the characteristics on either side of kink {kink} cannot be distinguished"
            )
        if self.found < 0:
            return Stop(Reason.LABELS_LOST, "characteristics cross where no kink is known")
        return Stop(Reason.TOO_SMALL_STEPS, "the time steps become too small")

    def _rough(self, panels: Panels) -> list[int]:
        """Return the panels whose last Chebyshev coefficients exceed rounding."""
        most = max(0.1 * self.tolerance, TAIL)
        low, high = panels.living()
        return np.flatnonzero(
            (np.maximum(tails(panels.r), tails(panels.X)) > most) & (high > low) & (panels.mesh.half > NARROWEST_PANEL)
        ).tolist()

    def finish(self) -> list[KinkRecord]:
        """Return the kinks at the end. Record events that rounding delays beyond the end, and end their kinks."""
        kinks, ahead = self.kinks(), copy(self)  # the next lines overwrite K
        ahead.events = []
        with suppress(Lost):
            ahead.advance(self.end * (1.0 + min(BIRTH_DELAY * self.threshold, LARGEST_DELAY)))
        self.events += (late := [e._replace(time=self.end) for e in ahead.events if e.time <= self.end + self.moment])
        return [k for k in kinks if k.kink not in {e.kink for e in late if e.event != "birth"}]

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """Return W and K at the nodes."""
        self.patience -= READ
        W, K = np.zeros_like(nodes), np.ones_like(nodes)
        if not self.flat:
            panels = self.now.panels
            self._rates(panels)
            kernels.read(panels.y, panels.mesh, RULE, *panels.living(), self.stages, nodes, W, K)
        return W, K

    def _rates(self, panels: Panels) -> Array:
        """Return dy/dt at the current time, and update the flux."""
        out = np.empty(2 * panels.r.size + 2)
        shocks = panels.labels()
        self.found = kernels.rates(panels.y, self.now.t, self.medium, shocks, self.stages, np.nan, out)
        if self.found:
            raise Lost(self._why())
        panels.off[:], panels.tau[:], panels.off_crest[:] = shocks.off, shocks.tau, shocks.crest
        return out

    def kinks(self) -> list[KinkRecord]:
        """Return the current kinks, from left to right."""
        if self.flat:
            return []
        panels, records = self.now.panels, []
        for k in range(panels.shocks):
            x = events.place(panels, k)
            sides = [self.r0]
            if panels.mesh.first[k] < panels.mesh.first[k + 1]:
                p, s = before_end(panels.off[k, 0], k, panels.mesh)
                sides = [float((interpolation(np.array([s])) @ panels.r[p])[0])]
            p, s = after_start(panels.off[k, 1], k + 1, panels.mesh)
            row = interpolation(np.array([s]))[0]
            sides.append(float(row @ panels.r[p]))
            with np.errstate(over="ignore"):  # the status reports such a K
                K = sides[1] * np.exp(row @ self.stages.S[p] + self.stages.c[k + 1])
            (q0, f0), (q1, f1) = (map(float, law_q_f(r, self.table)) for r in sides)
            if q1 > q0:
                speed = float(K * (f1 - f0) / (q1 - q0))
                records.append(KinkRecord(self.now.t, panels.number[k], x, q0, q1, q1 - q0, speed, speed))
        return records

    def _apply(self, event: events.Event) -> None:
        """Update the panels after an event."""
        kind, i = event
        panels, t = self.now.panels, self.now.t
        if kind == "birth":
            self._birth(i)
            return
        if kind == "merge":
            a, b = panels.number[i - 1], panels.number[i]
            self.events.append(Event(t, "merge", max(a, b), min(a, b), events.place(panels, i)))
            panels = events.merged(panels, i)
        elif kind == "exit":
            self.events.append(Event(t, "exit", panels.number[i], None, 0.0))
            panels = events.exited(panels)
        else:
            panels = events.passed(panels, kind, i)
            if np.any(np.diff(panels.mesh.first)[1:] == 0):  # only the first segment may be empty: q = 0
                raise Lost(Stop(Reason.LABELS_LOST, "no characteristics are left between two kinks"))
        self.now = replace(self.now, panels=panels)

    def _birth(self, p: int) -> None:
        """Insert a shock where X first folds: a joint of segments, and the separation of its labels."""
        panels, t = self.now.panels, self.now.t
        found = events.signs(panels)
        values, places = found.fold, found.place
        mesh = panels.mesh
        k = panels.segment(p)
        if p + 1 < mesh.first[k + 1] and mesh.joined[p + 1] and values[p + 1] < values[p]:
            p += 1  # the fold lies just across a joint
        elif p > mesh.first[k] and mesh.joined[p] and values[p - 1] < values[p]:
            p -= 1
        s = float(places[p])
        left_end = p == mesh.first[k] or not mesh.joined[p]
        right_end = p == mesh.first[k + 1] - 1 or not mesh.joined[p + 1]
        at_left, at_right = left_end and s < -1.0 + CORNER, right_end and s > 1.0 - CORNER
        if at_left or at_right:
            cut = p + at_right  # the first panel of the new segment
        else:
            panels, cut = events.with_joint_at(panels, p, s)
            mesh = panels.mesh
        x = float(mesh.base[cut - 1] + panels.X[cut - 1, -1] if cut > 0 else mesh.base[cut] + panels.X[cut, 0])
        self.now = replace(self.now, panels=panels)
        self._allocate()
        rate = self._rates(panels)[panels.r.size : 2 * panels.r.size].reshape(panels.r.shape)

        def derivative(values: Array, q: int, order: int, end: int) -> float:
            return float((np.linalg.matrix_power(RULE.D, order) @ values[q])[end] / panels.mesh.half[q] ** order)

        if at_left or at_right:
            q, end, other = (cut, 0, cut - 1) if at_left else (cut - 1, -1, cut)
            a, bend = -derivative(rate, q, 1, end), abs(derivative(panels.X, q, 2, end))
            far = derivative(panels.X, other, 1, -1 if at_left else 0) if 0 <= other < len(panels.r) else 1.0
        else:
            a, bend, far = -derivative(rate, cut, 1, 0), derivative(panels.X, cut, 3, 0) / 6.0, 1.0
        if not (a > 0.0 and bend > 0.0 and far > 0.0):
            born = "a kink would be born at x = {x:.6g} where the theory of its birth does not apply"
            raise Lost(Stop(Reason.LABELS_LOST, born, values={"x": Place(x)}))
        if at_left or at_right:  # X = -a τ δ + bend δ²/2 on the side that folds, X_ξ = far on the other (§14)
            near = [1.5 * a / bend, 1.0], [0.375 * a * a / (bend * far), 2.0]
            sides = near[::-1] if at_left else near
        else:  # X = -a τ δ + bend δ³
            sides = ([np.sqrt(a / bend), 0.5],) * 2
        self.count += 1
        tau = 1e-14 * self.end  # at this age the labels coincide with the joint
        self.now = _Stretch(events.parted(panels, cut, t, tau, sides, self.count), t, t)
        self.h = SQUARE_ROOT * float(np.sqrt(self.dt))
        self.events.append(Event(t, "birth", self.count, None, x))

    def _first_event(
        self, crossed: list[events.Event], h: float, panels: Panels, error: float
    ) -> tuple[float, Panels, events.Event, float]:
        """Return the step up to the first of these events, the panels there, the event, and the error of the step.

        The events were detected at the end of a step h, with these panels and this error.
        """
        now, end = events.signs(self.now.panels), events.signs(panels)
        start = {e: events.value(now, e) for e in crossed}
        for e in crossed:
            if start[e] <= 0.0 and e[0] != "birth":
                return 0.0, self.now.panels, e, 0.0
        # the sign of an event that rounding has begun before the step is shifted by its value there
        shift = {e: min(start[e], 0.0) - (1e-300 if start[e] <= 0.0 else 0.0) for e in crossed}

        def least(panels: Panels) -> float:
            found = events.signs(panels)
            return min(events.value(found, e) - shift[e] for e in crossed)

        first, last = min(start[e] - shift[e] for e in crossed), min(events.value(end, e) - shift[e] for e in crossed)
        part = 1.0
        if last < 0.0:
            part, panels, error = self._root(h, panels, least, (first, last), error)
        found = events.signs(panels)
        return part * h, panels, min(crossed, key=lambda e: abs(events.value(found, e) - shift[e])), error

    def _root(
        self, h: float, end: Panels, least: Callable[[Panels], float], ends: tuple[float, float], error: float
    ) -> tuple[float, Panels, float]:
        """Return the fraction of the last step, to `end`, at which `least` is 0, the panels there, and their error.

        The root is found on the interpolant of the step. If the interpolant is not much more accurate than the
        tolerance, a step that ends there improves the root. If a state of the interpolant has no labels, each
        evaluation is a step.
        """
        from scipy.optimize import brentq

        known = dict(zip((0.0, 1.0), ends, strict=True))  # values of `least`
        now, panels, new = self.now, self.now.panels, end.y
        F, state = np.empty((7, new.size)), np.empty(new.size)
        lost = kernels.within(
            panels.y, now.clock(now.t), h, now.origin, tableau(), self.medium, end.labels(), self.stages, new, F
        )

        def stepped(part: float) -> float:
            if part not in known:
                tried, error = self._try(part * h)
                if not np.isfinite(error):
                    raise Lost(self._why())
                known[part] = least(tried)
            return known[part]

        def within(part: float) -> Panels:
            labels = panels.labels()
            state_within(panels.y, F, part, state)
            t = now.time(now.clock(now.t) + part * h)
            if kernels.find_labels(state, t, self.medium, labels, np.nan):
                raise Lost(self._why())
            return panels.at(state.copy(), labels)

        def interpolated(part: float) -> float:
            return known[part] if part in known else least(within(part))

        part = np.nan
        if not lost:
            with suppress(Lost):
                part = brentq(interpolated, 0.0, 1.0, xtol=1e-15, rtol=1e-14)
                ahead = part + 1e-3 * (1.0 if part < 0.5 else -1.0)
                slope = interpolated(ahead) / (ahead - part)
                if error <= MUCH_BETTER:
                    return part, within(part), error
        if part == part:
            tried, error = self._try(part * h)
            value = least(tried)
            if np.isfinite(error) and abs(value) > AT_EVENT * (ends[0] - ends[1]) and slope < 0.0:
                part = min(max(part - value / slope, 0.0), 1.0)
                tried, error = self._try(part * h)
            if np.isfinite(error):
                return part, tried, error
        part = brentq(stepped, 0.0, 1.0, xtol=1e-15, rtol=1e-14)
        tried, error = self._try(part * h)
        return part, tried, error
