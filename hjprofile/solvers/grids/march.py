"""Marching a scheme through time: step size, snapshots hit exactly, failure, those who watch.

A scheme takes many steps of one length at a time. The length is chosen with a margin over the speed met last, the
speed that was met is looked at afterwards, and the steps are taken anew, shorter, if it was more than they allow.
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
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Stopped, Time

STEP_FLOOR = 1e-9  # of the run's end: more steps than this allows would take days, ...
PATIENCE = 20_000  # ... but the first ones can be much shorter than those after them: K falls, and hollows fill
SMALL_CFL = 0.3  # below it short time steps are the user's choice
MOST_WAY = 1 / 32  # of the grid: between two states that monitors see nothing moves further, ...
CLOSE_WAY = 3e-3  # ... of the grid and no further, where a monitor wants to know when something happened
MARGIN = 0.01  # by which the speed may rise while steps are taken, beyond half as much again as it rose last
NOBODY: Mapping[str, Any] = MappingProxyType({})


class _StepTooSmall(Exception):
    """The time step fell below STEP_FLOOR."""


@dataclass
class _Pace:
    """Where the march is, and how it gets on."""

    t: float = 0.0
    steps: int = 0
    seconds: float = 0.0
    shortest: float = np.inf
    longest: float = 0.0
    speed: float = 0.0  # K f' met last
    rise: float = 0.0  # of the speed from the last batch of steps to this, as a part of it
    outgrown: float = 0.0  # speed that was met in steps that were too long for it
    most: int = MOST_STEPS  # steps to take at once
    close_until: float = 0.0  # time up to which few steps are taken at once

    memory: ClassVar[tuple[str, ...]] = (
        "t", "steps", "seconds", "shortest", "longest", "speed", "rise", "outgrown", "most", "close_until",
    )  # fmt: skip


def _targets(problem: Problem, refresh: float | None) -> tuple[Array, frozenset[float]]:
    """Times after 0 that are hit exactly: those that are kept, the end, and nΔt, when the factor is taken anew.

    The latter are returned apart as well. What differs by rounding only is one time.
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
    """The monitors of a run, each of which looks when it wants to, and the progress that is shown."""

    def __init__(self, monitors: Mapping[str, Monitor], progress: Callable[[float], None] | None):
        self.monitors, self.progress = monitors, progress
        self.looked = dict.fromkeys(monitors, -1.0)  # when each did so last

    def show(self, state: State, fraction: float, every: bool) -> None:
        """To those that want to see it, or to `every` monitor."""
        for name, monitor in self.monitors.items():
            if every or monitor.wants(state):
                self.looked[name] = state.t
                monitor.observe(state)
        if self.progress:
            self.progress(fraction)

    def show_last(self, state: State) -> None:
        """To those that have not seen it: what they find of the end is then of the last good state, too."""
        for name, monitor in self.monitors.items():
            if self.looked[name] < state.t:
                monitor.observe(state)


class _Batch(NamedTuple):
    """Steps of one length that are taken at once."""

    dt: float
    steps: int
    bound: float  # of K f'
    target: float  # the next time that is hit exactly, and ...
    arrives: bool  # ... whether these steps reach it


class March:
    """One run of a scheme: choose a step, advance a batch, check it, roll back or accept, notify, store."""

    def __init__(self, scheme: Scheme, problem: Problem, grid: Grid, cfl: float, watchers: _Watchers):
        self.scheme, self.problem, self.grid, self.cfl, self.watchers = scheme, problem, grid, cfl, watchers
        self.factor = scheme.factor
        self.recorder, self.pace = Recorder(problem.kept, grid), _Pace()
        self.targets, self.renewals = _targets(problem, self.factor.refresh)
        self.close_leap = max(6, int(grid.cells * CLOSE_WAY))
        self.longest_leap = min(MOST_STEPS, max(1, int(grid.cells * MOST_WAY)), self.factor.steps)
        self.batch = _Batch(0.0, 0, 0.0, 0.0, False)  # the last one
        self.held = self.factor.held  # the factor before it
        self.renewed = 0.0  # largest K f' with the factor that was taken anew at its end

    @property
    def parts(self) -> dict[str, Any]:
        """What a checkpoint keeps the memory of."""
        own = {"pace": self.pace, "recorder": self.recorder, "scheme": self.scheme, "factor": self.factor}
        return own | dict(self.watchers.monitors)

    def start(self) -> None:
        """Evaluates the data. Raises Stopped if the run cannot start."""
        try:
            self.pace.speed = self._renew() if self.factor.refresh else self.scheme.evaluate()
        except Breakdown as broken:
            raise Stopped(_no_start(broken, self.grid)) from None
        self.scheme.advance(0.0, 1, self.pace.speed)  # compiles what is to be compiled
        self.pace.most = self.longest_leap

    def first_state(self) -> None:
        """Shows and stores it."""
        self._show(self._state(0.0, 0, self.pace.speed), every=True)
        if self.problem.times[0] == 0.0:
            self._store()

    def recall(self, stored: Mapping[str, Array]) -> None:
        """Goes on from a checkpoint."""
        recall(self.parts, stored)
        self.factor.t = self.pace.t
        self.scheme.evaluate()

    def run(self, happened: Callable[[State], bool], keeper: Keeper | None) -> Stop | None:
        """To the end, or to where it stops, with the reason."""
        pace = self.pace
        try:
            for target in self.targets[self.targets > pace.t].tolist():
                self._go_to(target, happened, keeper)
        except Breakdown as broken:
            self._back()
            pace.speed = self.scheme.evaluate()
            return _breakdown(broken, self)
        except Halt as halt:
            self._back()
            self.scheme.evaluate()
            return Stop(halt.stop.reason, "stopped at t = {t:.6g}: {why}", values={"t": Time(pace.t), "why": halt.stop})
        except _StepTooSmall:
            self.scheme.evaluate()
            return _too_small_a_step(self)
        return None

    def last_good_state(self) -> None:
        """Stores and shows the state at which the run stopped."""
        pace, recorder = self.pace, self.recorder
        if not recorder.rows or recorder.columns[0][recorder.rows - 1] < pace.t:
            recorder.save(pace.t, self.scheme)
        self.batch = self.batch._replace(dt=0.0)  # no step led from this state to another
        with suppress(Halt, Breakdown):
            self.watchers.show_last(self._state(pace.t, pace.steps, pace.speed))

    def _go_to(self, target: float, happened: Callable[[State], bool], keeper: Keeper | None) -> None:
        """To a time that is hit exactly. Raises Breakdown, Halt, _StepTooSmall."""
        while self.pace.t < target:
            self.batch = self._choose(target)
            state = self._advance(happened)
            if state is not None:
                self._accept(state)
                if keeper and keeper.due():
                    keeper.keep(self.pace.t, remember(self.parts))

    def _choose(self, target: float) -> _Batch:
        """As many steps as may be taken at once, of a length for a speed a little above the last one."""
        pace, problem = self.pace, self.problem
        bound = max(pace.speed * (1.0 + MARGIN + 1.5 * pace.rise), pace.outgrown * (1.0 + MARGIN))
        dt = self.cfl * self.scheme.cfl_limit * self.grid.dx / bound
        remaining = target - pace.t
        needed = max(1, math.ceil(remaining / dt * (1.0 - 1e-12)))
        if needed <= pace.most:
            dt = remaining / needed
        steps = min(needed, pace.most, self.close_leap if pace.t < pace.close_until else MOST_STEPS)
        batch = _Batch(dt, steps, bound, target, steps == needed)
        if needed > pace.most and dt < STEP_FLOOR * problem.end and (pace.steps > PATIENCE or self.cfl > 1.0):
            self.batch = batch
            raise _StepTooSmall
        return batch

    def _advance(self, happened: Callable[[State], bool]) -> State | None:
        """The state after the batch; None if that has been rolled back, to be chosen again. Raises Breakdown, Halt."""
        batch, pace, factor = self.batch, self.pace, self.factor
        started, self.held = time.perf_counter(), factor.held
        try:
            met = self.scheme.advance(batch.dt, batch.steps, batch.bound)
            pace.seconds += time.perf_counter() - started
            if batch.bound < met < np.inf and (self.cfl <= 1.0 or batch.steps > 1):
                self._back()
                if self.cfl <= 1.0:
                    pace.outgrown = met
                else:  # no bound is promised; each step by the speed before it, to show what comes of it
                    pace.most = max(1, batch.steps // 4)
                return None
            factor.t = batch.target if batch.arrives else pace.t + batch.steps * batch.dt
            if batch.arrives and batch.target in self.renewals:
                self.renewed = self._renew()
            state = self._state(factor.t, pace.steps + batch.steps, met)
            if not met < np.inf:
                raise Breakdown(state.q, np.full(1, np.inf), state.first)
        except Breakdown:
            if batch.steps == 1:
                raise
            self._back()  # and once more, to find out where
            pace.most = max(1, batch.steps // 4)
            return None
        if batch.steps > self.close_leap and happened(state):
            pace.close_until = state.t
            self._back()
            return None
        return state

    def _accept(self, state: State) -> None:
        """Notifies the monitors, and goes on from this state. Raises Halt."""
        batch, pace = self.batch, self.pace
        self._show(state, every=batch.arrives and batch.target == self.targets[-1])
        pace.rise = min(max(state.speed / pace.speed - 1.0, 0.0), 1.0)
        pace.t, pace.steps, pace.speed, pace.outgrown = state.t, state.steps, state.speed, 0.0
        pace.most = min(2 * pace.most, self.longest_leap)
        pace.shortest, pace.longest = min(pace.shortest, batch.dt), max(pace.longest, batch.dt)
        if pace.t == batch.target:
            if batch.target in self.renewals:
                pace.speed = max(pace.speed, self.renewed)
            if batch.target in self.problem.times:
                self._store()

    def _back(self) -> None:
        """To the state before the last batch."""
        self.scheme.restore()
        self.factor.t, self.factor.held = self.pace.t, self.held

    def _renew(self) -> float:
        """Takes the factor anew; returns the largest K f'."""
        self.factor.held = NOTHING
        speed = self.scheme.evaluate()
        self.factor.held = self.scheme.K.copy()
        return speed

    def _state(self, t: float, steps: int, speed: float) -> State:
        """The present state as monitors see it. Raises Breakdown."""
        scheme = self.scheme
        first, q = scheme.means()
        if not np.min(q) > -1.0:  # nor NaN
            raise Breakdown(q, scheme.K, first)
        scheme.law = scheme.law.covering(q)
        K = self.factor.given(nodes=slice(first, first + q.size + 1))
        return State(
            t, steps, first, q, scheme.law.kernel, speed, self.batch.bound, self.batch.dt, scheme.growth,
            scheme.crest_lowering, scheme.volume, None if K is None else K[0],
        )  # fmt: skip

    def _show(self, state: State, every: bool) -> None:
        self.watchers.show(state, self.pace.t / self.problem.end if self.problem.end else 1.0, every)

    def _store(self) -> None:
        self.pace.speed = max(self.pace.speed, self.scheme.evaluate())
        self.recorder.save(self.pace.t, self.scheme)


def march(
    scheme: Scheme, problem: Problem, grid: Grid, cfl: float,
    monitors: Mapping[str, Monitor] = NOBODY, progress: Callable[[float], None] | None = None,
    happened: Callable[[State], bool] = lambda state: False,
    keeper: Keeper | None = None, identity: Mapping[str, Any] = NOBODY,
) -> Recording:  # fmt: skip
    """Runs `scheme` to the problem's end; `progress` is called with the fraction that is done.

    Where `happened` says that something has since the last state, the steps in between are taken anew, few at a time.
    A keeper keeps checkpoints, and the run goes on from the one it has of the same `identity`. Raises RunError if the
    run cannot start, or was asked to stop.
    """
    one = March(scheme, problem, grid, cfl, _Watchers(monitors, progress))
    one.start()
    with keeper or nullcontext():
        if keeper and (stored := keeper.recall(identity)):
            one.recall(stored)
        else:
            one.first_state()
        stop = one.run(happened, keeper)
    if stop:
        one.last_good_state()
    times, W, q, K = (column[: one.recorder.rows] for column in one.recorder.columns)
    pace = one.pace
    return Recording(times, W, q, K, stop, pace.steps, (float(pace.shortest), float(pace.longest)), pace.seconds)


def _no_start(broken: Breakdown, grid: Grid) -> Stop:
    return Stop(
        Reason.NOT_ADMISSIBLE,
        "the run cannot start: K f' is not a finite number near x = {x:.6g}, where q = {q:.6g}; the integral of f is "
        "too large (K spans more than 300 decades) or q is too near -1",
        values={"x": Place(grid.centres[broken.cell]), "q": broken.q},
    )


def _too_small_a_step(run: March) -> Stop:
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
    what = "q = {q:.6g} reached -1" if np.isfinite(broken.q) else "q is no longer finite"
    return Stop(
        Reason.NOT_ADMISSIBLE,
        "stopped at t = {t:.6g} near x = {x:.6g}: " + what + " in a time step of {dt:.3g} (cfl = {cfl:g}, K = {K:.3g} "
        "there)",
        "set cfl to 1 or less" if run.cfl > 1 else f"use a monotone method ({ROBUST_METHOD}), or a smaller cfl",
        {"t": Time(run.pace.t), "x": Place(run.grid.centres[broken.cell]), "q": broken.q, "dt": run.batch.dt,
         "cfl": run.cfl, "K": run.scheme.K[broken.cell + 1]},
    )  # fmt: skip
