"""Time stepping of a scheme: step size, exact saved times, failure, and monitors.

A scheme takes many steps of one length at a time. The length allows a margin over the last measured speed. The speed is
checked afterwards, and the steps are repeated with a shorter length if it exceeded the bound.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.factor import NOTHING
from hjprofile.solvers.grids.recording import Recorder, Recording, recall, remember
from hjprofile.solvers.grids.scheme import MOST_STEPS, Scheme
from hjprofile.solvers.run import Array, Breakdown, Halt, Keeper, Monitor, State
from hjprofile.solvers.states import Callback
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Stopped, Time

STEP_FLOOR = 1e-9  # smallest time step as a fraction of the end of the run: shorter ones would take days
STEPS_BEFORE_FLOOR = 20_000  # steps before STEP_FLOOR applies; the first ones can be shorter, as K falls
SMALL_CFL = 0.3  # below it short time steps are the choice of the user
LARGEST_MOTION = 1 / 32  # largest motion between two observed states, as a fraction of the cells
CLOSE_MOTION = 3e-3  # the same where a monitor dates an event
MARGIN = 0.01  # relative increase of the speed that a batch allows, in addition to 1.5 times the last increase
NOBODY: Mapping[str, Any] = MappingProxyType({})


class _StepTooSmall(Exception):
    """A time step below STEP_FLOOR."""


@dataclass
class _Pace:
    """Progress of the march and the control of its steps."""

    t: float = 0.0
    steps: int = 0
    seconds: float = 0.0
    shortest: float = np.inf
    longest: float = 0.0
    speed: float = 0.0  # last measured K f'
    rise: float = 0.0  # relative increase of the speed from the previous batch of steps to this one
    rejected_speed: float = 0.0  # speed that exceeded the bound of a rejected batch
    most: int = MOST_STEPS  # steps in the next batch
    close_until: float = 0.0  # time up to which batches are short

    checkpoint_fields: ClassVar[tuple[str, ...]] = (
        "t", "steps", "seconds", "shortest", "longest", "speed", "rise", "rejected_speed", "most", "close_until",
    )  # fmt: skip


def _targets(problem: Problem, refresh: float | None) -> tuple[Array, frozenset[float]]:
    """Return the times after 0 that are hit exactly: the saved times, the end, and the refresh times nΔt of a frozen K.

    The refresh times are also returned separately. Times that differ by rounding only are merged.
    """
    end = problem.end
    targets = np.unique(np.append(problem.times[problem.times > 0.0], end if end else []))
    if not refresh or not end:
        return targets, frozenset()
    due = refresh * np.arange(1, math.floor(end / refresh + 1e-9) + 1)
    i = np.clip(np.searchsorted(targets, due), 1, max(targets.size - 1, 1))
    for near in (targets[i - 1], targets[np.minimum(i, targets.size - 1)]):
        due = np.where(np.abs(near - due) <= 1e-9 * refresh, near, due)
    return np.union1d(targets, due), frozenset(due.tolist())


class _Watchers:
    """The monitors of a run, each with its own observation times, and the progress display."""

    def __init__(self, monitors: Mapping[str, Monitor], progress: Callable[[float], None] | None):
        self.monitors, self.progress = monitors, progress
        self.observed_at = dict.fromkeys(monitors, -1.0)  # the last observation time of each

    def show(self, state: State, fraction: float, every: bool) -> None:
        """Show a state to the monitors that request it, or to `every` monitor."""
        for name, monitor in self.monitors.items():
            if every or monitor.wants(state):
                self.observed_at[name] = state.t
                monitor.observe(state)
        if self.progress:
            self.progress(fraction)

    def show_last(self, state: State) -> None:
        """Show a state to the monitors that have not observed it, so that all results refer to the last good state."""
        for name, monitor in self.monitors.items():
            if self.observed_at[name] < state.t:
                monitor.observe(state)


class _Batch(NamedTuple):
    """Steps of one length that are taken at once."""

    dt: float
    steps: int
    bound: float  # of K f'
    target: float  # the next time that is hit exactly
    arrives: bool  # True if these steps reach it


class March:
    """One run of a scheme: choose a step, advance a batch, check it, roll back or accept, notify, store."""

    def __init__(
        self, scheme: Scheme, problem: Problem, grid: Grid, cfl: float, watchers: _Watchers, callback: Callback | None
    ):  # fmt: skip
        self.scheme, self.problem, self.grid, self.cfl, self.watchers = scheme, problem, grid, cfl, watchers
        self.factor = scheme.factor
        self.recorder, self.pace = Recorder(problem.kept, grid, callback), _Pace()
        self.targets, self.refresh_times = _targets(problem, self.factor.refresh)
        self.saved_times = frozenset(problem.times.tolist())
        self.close_leap = max(6, int(grid.cells * CLOSE_MOTION))
        self.longest_leap = min(MOST_STEPS, max(1, int(grid.cells * LARGEST_MOTION)), self.factor.steps)
        self.batch = _Batch(0.0, 0, 0.0, 0.0, False)  # the last batch
        self.frozen_before = self.factor.frozen_K  # frozen K before the last batch
        self.refreshed_speed = 0.0  # largest K f' with the K that was refreshed at the end of the batch

    @property
    def parts(self) -> dict[str, Any]:
        """The parts of the run whose fields a checkpoint stores."""
        own = {"pace": self.pace, "recorder": self.recorder, "scheme": self.scheme, "factor": self.factor}
        return own | dict(self.watchers.monitors)

    def start(self) -> None:
        """Evaluate the data. Raise Stopped if the run cannot start."""
        try:
            self.pace.speed = self._refresh() if self.factor.refresh else self.scheme.evaluate()
        except Breakdown as broken:
            raise Stopped(_no_start(broken, self.grid)) from None
        self.scheme.advance(0.0, 1, self.pace.speed)  # compiles the loops
        self.pace.most = self.longest_leap

    def first_state(self) -> None:
        """Show and store the initial state."""
        self._show(self._state(0.0, 0, self.pace.speed), every=True)
        if self.problem.times[0] == 0.0:
            self._store()

    def recall(self, stored: Mapping[str, Array]) -> None:
        """Continue from a checkpoint."""
        recall(self.parts, stored)
        self.factor.t = self.pace.t
        self.scheme.evaluate()

    def run(self, kinks_changed: Callable[[State], bool], keeper: Keeper | None) -> Stop | None:
        """Advance to the end, or until the run stops; return the reason in that case."""
        pace = self.pace
        try:
            for target in self.targets[self.targets > pace.t].tolist():
                if self.recorder.stop is None:
                    self._go_to(target, kinks_changed, keeper)
        except Breakdown as broken:
            self._roll_back()
            pace.speed = self.scheme.evaluate()
            return _breakdown(broken, self)
        except Halt as halt:
            self._roll_back()
            self.scheme.evaluate()
            return Stop(halt.stop.reason, "stopped at t = {t:.6g}: {why}", values={"t": Time(pace.t), "why": halt.stop})
        except _StepTooSmall:
            self.scheme.evaluate()
            return _too_small_a_step(self)
        return self.recorder.stop

    def last_good_state(self) -> None:
        """Store and show the state at which the run stopped."""
        pace, recorder = self.pace, self.recorder
        if not recorder.rows or recorder.columns[0][recorder.rows - 1] < pace.t:
            recorder.save(pace.t, self.scheme)
        self.batch = self.batch._replace(dt=0.0)  # no step led from this state to another
        with suppress(Halt, Breakdown):
            self.watchers.show_last(self._state(pace.t, pace.steps, pace.speed))

    def _go_to(self, target: float, kinks_changed: Callable[[State], bool], keeper: Keeper | None) -> None:
        """Advance to a time that is hit exactly. Raise Breakdown, Halt, _StepTooSmall."""
        while self.pace.t < target:
            self.batch = self._choose(target)
            state = self._advance(kinks_changed)
            if state is not None:
                self._accept(state)
                if keeper and keeper.due():
                    keeper.keep(self.pace.t, remember(self.parts))

    def _choose(self, target: float) -> _Batch:
        """Return the largest allowed batch, with a step length for a speed slightly above the last one."""
        pace, problem = self.pace, self.problem
        bound = max(pace.speed * (1.0 + MARGIN + 1.5 * pace.rise), pace.rejected_speed * (1.0 + MARGIN))
        dt = self.cfl * self.scheme.cfl_limit * self.grid.dx / bound
        remaining = target - pace.t
        needed = max(1, math.ceil(remaining / dt * (1.0 - 1e-12)))
        if needed <= pace.most:
            dt = remaining / needed
        steps = min(needed, pace.most, self.close_leap if pace.t < pace.close_until else MOST_STEPS)
        batch = _Batch(dt, steps, bound, target, steps == needed)
        if needed > pace.most and dt < STEP_FLOOR * problem.end and (pace.steps > STEPS_BEFORE_FLOOR or self.cfl > 1.0):
            self.batch = batch
            raise _StepTooSmall
        return batch

    def _advance(self, kinks_changed: Callable[[State], bool]) -> State | None:
        """Return the state after the batch, or None if the batch was rolled back. Raise Breakdown, Halt."""
        batch, pace, factor = self.batch, self.pace, self.factor
        started, self.frozen_before = time.perf_counter(), factor.frozen_K
        try:
            largest_speed = self.scheme.advance(batch.dt, batch.steps, batch.bound)
            pace.seconds += time.perf_counter() - started
            if batch.bound < largest_speed < np.inf and (self.cfl <= 1.0 or batch.steps > 1):
                self._roll_back()
                if self.cfl <= 1.0:
                    pace.rejected_speed = largest_speed
                else:  # no bound is guaranteed; each step uses the speed before it, and shows the consequence
                    pace.most = max(1, batch.steps // 4)
                return None
            factor.t = batch.target if batch.arrives else pace.t + batch.steps * batch.dt
            if batch.arrives and batch.target in self.refresh_times:
                self.refreshed_speed = self._refresh()
            state = self._state(factor.t, pace.steps + batch.steps, largest_speed)
            if not largest_speed < np.inf:
                raise Breakdown(state.q, np.full(1, np.inf), state.first)
        except Breakdown:
            if batch.steps == 1:
                raise
            self._roll_back()  # repeat in smaller batches to locate the breakdown
            pace.most = max(1, batch.steps // 4)
            return None
        if batch.steps > self.close_leap and kinks_changed(state):
            pace.close_until = state.t
            self._roll_back()
            return None
        return state

    def _accept(self, state: State) -> None:
        """Notify the monitors, and continue from this state. Raise Halt."""
        batch, pace = self.batch, self.pace
        self._show(state, every=batch.arrives and batch.target == self.targets[-1])
        pace.rise = min(max(state.speed / pace.speed - 1.0, 0.0), 1.0)
        pace.t, pace.steps, pace.speed, pace.rejected_speed = state.t, state.steps, state.speed, 0.0
        pace.most = min(2 * pace.most, self.longest_leap)
        pace.shortest, pace.longest = min(pace.shortest, batch.dt), max(pace.longest, batch.dt)
        if pace.t == batch.target:
            if batch.target in self.refresh_times:
                pace.speed = max(pace.speed, self.refreshed_speed)
            if batch.target in self.saved_times:
                self._store()

    def _roll_back(self) -> None:
        """Return to the state before the last batch."""
        self.scheme.roll_back()
        self.factor.t, self.factor.frozen_K = self.pace.t, self.frozen_before

    def _refresh(self) -> float:
        """Refresh the frozen K; return the largest K f'."""
        self.factor.frozen_K = NOTHING
        speed = self.scheme.evaluate()
        self.factor.frozen_K = self.scheme.K.copy()
        return speed

    def _state(self, t: float, steps: int, speed: float) -> State:
        """Return the current state for monitors. Raise Breakdown."""
        scheme = self.scheme
        first, q = scheme.means()
        if not q.min() > -1.0:  # excludes NaN
            raise Breakdown(q, scheme.K, first)
        scheme.law = scheme.law.covering(q)
        K = self.factor.given(nodes=slice(first, first + q.size + 1))
        return State(
            t, steps, first, q, scheme.law.kernel, speed, self.batch.bound, self.batch.dt, scheme.toe_gain,
            scheme.crest_lowering, scheme.volume, None if K is None else K[0],
        )  # fmt: skip

    def _show(self, state: State, every: bool) -> None:
        """Show a state to the monitors, and the progress to the user."""
        self.watchers.show(state, self.pace.t / self.problem.end if self.problem.end else 1.0, every)

    def _store(self) -> None:
        """Save the current state as a row of the result."""
        self.pace.speed = max(self.pace.speed, self.scheme.evaluate())
        self.recorder.save(self.pace.t, self.scheme)
        self.recorder.show()


def march(
    scheme: Scheme, problem: Problem, grid: Grid, cfl: float,
    monitors: Mapping[str, Monitor] = NOBODY, progress: Callable[[float], None] | None = None,
    kinks_changed: Callable[[State], bool] = lambda state: False,
    keeper: Keeper | None = None, identity: Mapping[str, Any] = NOBODY, callback: Callback | None = None,
) -> Recording:  # fmt: skip
    """Run `scheme` to the end of the problem; call `progress` with the completed fraction.

    If `kinks_changed` returns True for a new state, the steps since the last state are repeated in small batches. A
    keeper stores checkpoints, and the run continues from the stored one with the same `identity`. The callback observes
    each saved state, and may stop the run. Raise RunError if the run cannot start, or if it was interrupted.
    """
    one = March(scheme, problem, grid, cfl, _Watchers(monitors, progress), callback)
    one.start()
    with keeper or nullcontext():
        if keeper and (stored := keeper.recall(identity)):
            one.recall(stored)
        else:
            one.first_state()
        stop = one.run(kinks_changed, keeper)
    if stop:
        one.last_good_state()
    times, W, q, K = (column[: one.recorder.rows] for column in one.recorder.columns)
    pace = one.pace
    return Recording(times, W, q, K, stop, pace.steps, (float(pace.shortest), float(pace.longest)), pace.seconds)


def _no_start(broken: Breakdown, grid: Grid) -> Stop:
    """Return the reason if the initial state is not admissible."""
    return Stop(
        Reason.NOT_ADMISSIBLE,
        "the run cannot start: K f' is not a finite number near x = {x:.6g}, where q = {q:.6g}; the integral of f is "
        "too large (K spans more than 300 decades) or q is too near -1",
        values={"x": Place(grid.centres[broken.cell]), "q": broken.q},
    )


def _too_small_a_step(run: March) -> Stop:
    """Return the reason if the time step is below STEP_FLOOR."""
    scheme, grid = run.scheme, run.grid
    K = np.maximum(scheme.K[1:], scheme.K[:-1])
    fastest = int(np.argmax(K * run.problem.law.derivative(scheme.q)))
    return Stop(
        Reason.TOO_SMALL_STEPS,
        "stopped at t = {t:.6g}: the time step {dt:.3g} fell below {floor:g} of the run, because K f' = {speed:.3g} at "
        "x = {x:.6g} (K = {K:.3g}, q = {q:.6g}) and cfl = {cfl:g}",
        f"use {'a larger cfl, ' if run.cfl < SMALL_CFL else ''}fewer cells or an earlier end",
        {"t": Time(run.pace.t), "dt": run.batch.dt, "floor": STEP_FLOOR, "speed": run.pace.speed,
         "x": Place(grid.centres[fastest]), "K": K[fastest], "q": scheme.q[fastest], "cfl": run.cfl},
    )  # fmt: skip


def _breakdown(broken: Breakdown, run: March) -> Stop:
    """Return the reason if a step left the admissible range."""
    what = "q = {q:.6g} reached -1" if np.isfinite(broken.q) else "q is no longer finite"
    return Stop(
        Reason.NOT_ADMISSIBLE,
        "stopped at t = {t:.6g} near x = {x:.6g}: " + what + " in a time step of {dt:.3g} (cfl = {cfl:g}, K = {K:.3g} "
        "there)",
        "set cfl to 1 or less" if run.cfl > 1 else f"use a monotone method ({ROBUST_METHOD}), or a smaller cfl",
        {"t": Time(run.pace.t), "x": Place(run.grid.centres[broken.cell]), "q": broken.q, "dt": run.batch.dt,
         "cfl": run.cfl, "K": run.scheme.K[broken.cell + 1]},
    )  # fmt: skip
