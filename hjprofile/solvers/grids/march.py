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
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.grids.factor import NOTHING, Factor
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.run import Array, Breakdown, Halt, Keeper, Monitor, State

STEP_FLOOR = 1e-9  # of the run's end: more steps than this allows would take days, ...
PATIENCE = 20_000  # ... but the first ones can be much shorter than those after them: K falls, and hollows fill
SMALL_CFL = 0.3  # below it short time steps are the user's choice
MOST_STEPS = 64  # at a time; fewer on coarse grids, so that between two states that monitors see ...
MOST_WAY = 1 / 32  # ... nothing moves further than this part of the grid
CLOSE_WAY = 3e-3  # ... of the grid and no further, where a monitor wants to know when something happened
MARGIN = 0.01  # by which the speed may rise while steps are taken, beyond half as much again as it rose last
NOBODY: Mapping[str, Any] = MappingProxyType({})
BESIDE = 64  # critical cells that monitors see beside what is not critical, as many as their stencils can ask for


class Scheme(Protocol):
    """A discretisation with its own time steps. `q`, `K` belong to the present state after `evaluate`.

    `memory` names the attributes that make up its state, for a checkpoint.
    """

    @property
    def W(self) -> Array: ...

    law: GridLaw
    factor: Factor
    q: Array
    K: Array
    growth: float
    outflow: float
    memory: tuple[str, ...]
    cfl_limit: float  # Δt max(K f')/Δx at which the scheme is still monotone (limited: total variation diminishing)

    def evaluate(self) -> float:
        """Brings q and K up to the present state; returns max K f'. Raises Breakdown."""
        ...

    def means(self) -> tuple[int, Array]:
        """q at present on the cells where it need not be 0, and the first of these cells."""
        ...

    def advance(self, dt: float, steps: int, bound: float) -> float:
        """At most MOST_STEPS steps; returns the largest K f' met, which should not exceed `bound`.

        Where the state breaks down that is not finite, or Breakdown is raised.
        """
        ...

    def restore(self) -> None:
        """Back to the state before the last `advance`."""
        ...

    def volume(self) -> float:
        """∫(u - x) dx by the sum whose change the scheme's own budget states."""
        ...


class Restorable:
    """A state that is kept and restored by what it names as its memory: what is kept must not be written into."""

    memory: tuple[str, ...]

    def keep(self) -> None:
        """Keeps the present state."""
        self.kept = {name: getattr(self, name) for name in self.memory}

    def restore(self) -> None:
        """Back to it."""
        vars(self).update(self.kept)


class _StepTooSmall(Exception):
    """The time step fell below STEP_FLOOR."""


class Recording(NamedTuple):
    """What was saved on the way, with an account of the steps."""

    times: Array
    W: Array
    q: Array
    K: Array
    status: str
    steps: int
    step_range: tuple[float, float]
    wall_seconds: float


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


class _Recorder:
    """Rows of t, W, q and K at the times that are kept."""

    memory: tuple[str, ...] = ("kept",)

    def __init__(self, times: int, grid: Grid):
        self.columns = [
            np.empty((times, *shape)) for shape in ((), (grid.cells + 1,), (grid.cells,), (grid.cells + 1,))
        ]
        self.rows = 0

    def save(self, t: float, scheme: Scheme) -> None:
        for i, value in enumerate((t, scheme.W, scheme.q, scheme.K)):
            if self.rows == len(self.columns[i]):  # the last good state of a run that stopped after all kept times
                self.columns[i] = np.concatenate([self.columns[i], [value]])
            self.columns[i][self.rows] = value
        self.rows += 1

    @property
    def kept(self) -> Array:
        return np.hstack([column[: self.rows].reshape(self.rows, column[0].size) for column in self.columns])

    @kept.setter
    def kept(self, rows: Array) -> None:
        self.rows = len(rows)
        widths = np.cumsum([1] + [column.shape[1] for column in self.columns[1:]])
        for column, part in zip(self.columns, np.split(rows, widths[:-1], axis=1), strict=True):
            column[: self.rows] = part.reshape(column[: self.rows].shape)


def _remember(parts: Mapping[str, Any]) -> dict[str, Array]:
    """What the parts of a run name as their memory, by "part.name"."""
    return {f"{part}.{name}": np.asarray(getattr(what, name)) for part, what in parts.items() for name in what.memory}


def _recall(parts: Mapping[str, Any], stored: Mapping[str, Array]) -> None:
    for part, what in parts.items():
        for name in what.memory:
            value, present = stored[f"{part}.{name}"], getattr(what, name)
            if isinstance(present, np.ndarray):
                setattr(what, name, np.array(value))
            else:
                setattr(what, name, tuple(value.tolist()) if isinstance(present, tuple) else value.item())


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
    kept = problem.times
    recorder, pace = _Recorder(kept.size, grid), _Pace()
    close_leap = max(6, int(grid.cells * CLOSE_WAY))
    factor = scheme.factor
    longest_leap = min(MOST_STEPS, max(1, int(grid.cells * MOST_WAY)), factor.steps)
    parts: dict[str, Any] = {"pace": pace, "recorder": recorder, "scheme": scheme, "factor": factor, **monitors}
    targets, due = _targets(problem, factor.refresh)
    bound, dt, status, held = 0.0, 0.0, "done", factor.held
    seen = dict.fromkeys(monitors, -1.0)  # when each monitor looked last

    def present(t: float, steps: int, speed: float) -> State:
        first, q = scheme.means()
        if not np.min(q) > -1.0:  # nor NaN
            raise Breakdown(q, scheme.K, first)
        scheme.law = scheme.law.covering(q)
        K = factor.given(nodes=slice(first, first + q.size + 1))
        return State(
            t, steps, first, q, scheme.law.kernel, speed, bound, dt, scheme.growth, scheme.outflow, scheme.volume,
            None if K is None else K[0],
        )  # fmt: skip

    def renew() -> float:
        """Takes the factor anew; returns the largest K f'."""
        factor.held = NOTHING
        speed = scheme.evaluate()
        factor.held = scheme.K.copy()
        return speed

    def back() -> None:
        """To the state before the last steps."""
        scheme.restore()
        factor.t, factor.held = pace.t, held

    def watch(state: State, every: bool = False) -> None:
        for name, monitor in monitors.items():
            if every or monitor.wants(state):
                seen[name] = state.t
                monitor.observe(state)
        if progress:
            progress(pace.t / problem.end if problem.end else 1.0)

    def save() -> None:
        pace.speed = max(pace.speed, scheme.evaluate())
        recorder.save(pace.t, scheme)

    try:
        pace.speed = renew() if factor.refresh else scheme.evaluate()
    except Breakdown as broken:
        x = grid.centres[broken.cell]
        raise RunError(
            f"the run cannot start: K f' is not a finite number near x = {x:.6g}, where q = {broken.q:.6g}; "
            "the integral of f is too large (K spans more than 300 decades) or q is too near -1"
        ) from None
    scheme.advance(0.0, 1, pace.speed)  # compiles what is to be compiled
    pace.most = longest_leap
    with keeper or nullcontext():
        if keeper and (stored := keeper.recall(identity)):
            _recall(parts, stored)
            factor.t = pace.t
            scheme.evaluate()
        else:
            watch(present(0.0, 0, pace.speed), every=True)
            if kept[0] == 0.0:
                save()
        try:
            for target in targets[targets > pace.t]:
                while pace.t < target:
                    bound = max(pace.speed * (1.0 + MARGIN + 1.5 * pace.rise), pace.outgrown * (1.0 + MARGIN))
                    dt = cfl * scheme.cfl_limit * grid.dx / bound
                    remaining = float(target) - pace.t
                    needed = max(1, math.ceil(remaining / dt * (1.0 - 1e-12)))
                    if needed <= pace.most:
                        dt = remaining / needed
                    elif dt < STEP_FLOOR * problem.end and (pace.steps > PATIENCE or cfl > 1.0):
                        raise _StepTooSmall
                    leap = min(needed, pace.most, close_leap if pace.t < pace.close_until else MOST_STEPS)
                    started, held = time.perf_counter(), factor.held
                    try:
                        met = scheme.advance(dt, leap, bound)
                        pace.seconds += time.perf_counter() - started
                        if bound < met < np.inf and (cfl <= 1.0 or leap > 1):
                            back()
                            if cfl <= 1.0:
                                pace.outgrown = met
                            else:  # no bound is promised; each step by the speed before it, to show what comes of it
                                pace.most = max(1, leap // 4)
                            continue
                        factor.t = float(target) if leap == needed else pace.t + leap * dt
                        if leap == needed and target in due:
                            renewed = renew()
                        state = present(factor.t, pace.steps + leap, met)
                        if not met < np.inf:
                            raise Breakdown(state.q, np.full(1, np.inf), state.first)
                    except Breakdown:
                        if leap == 1:
                            raise
                        back()  # and once more, to find out where
                        pace.most = max(1, leap // 4)
                        continue
                    if leap > close_leap and happened(state):
                        pace.close_until = state.t
                        back()
                        continue
                    watch(state, every=leap == needed and target == targets[-1])
                    pace.rise = min(max(met / pace.speed - 1.0, 0.0), 1.0)
                    pace.t, pace.steps, pace.speed, pace.outgrown = state.t, state.steps, met, 0.0
                    pace.most = min(2 * pace.most, longest_leap)
                    pace.shortest, pace.longest = min(pace.shortest, dt), max(pace.longest, dt)
                    if pace.t == target and target in due:
                        pace.speed = max(pace.speed, renewed)
                    if pace.t == target and target in kept:
                        save()
                    if keeper and keeper.due():
                        keeper.keep(pace.t, _remember(parts))
        except Breakdown as broken:
            back()
            pace.speed = scheme.evaluate()
            status = _breakdown_sentence(broken, scheme.K[broken.cell + 1], grid, pace.t, dt, cfl)
        except Halt as halt:
            back()
            scheme.evaluate()
            status = f"stopped at t = {pace.t:.6g}: {halt}"
        except _StepTooSmall:
            scheme.evaluate()
            status = _small_step_sentence(scheme, problem, grid, pace.t, dt, pace.speed, cfl)
    if status != "done":
        if not recorder.rows or recorder.columns[0][recorder.rows - 1] < pace.t:
            recorder.save(pace.t, scheme)
        dt = 0.0  # no step led from this state to another
        with suppress(Halt, Breakdown):  # what monitors tell of the end is told of the last good state too
            last = present(pace.t, pace.steps, pace.speed)
            for monitor in (m for name, m in monitors.items() if seen[name] < pace.t):
                monitor.observe(last)
    times, W, q, K = (column[: recorder.rows] for column in recorder.columns)
    return Recording(times, W, q, K, status, pace.steps, (float(pace.shortest), float(pace.longest)), pace.seconds)


def _small_step_sentence(
    scheme: Scheme, problem: Problem, grid: Grid, t: float, dt: float, speed: float, cfl: float
) -> str:
    K = np.maximum(scheme.K[1:], scheme.K[:-1])
    fastest = int(np.argmax(K * problem.law.derivative(scheme.q)))
    return (
        f"stopped at t = {t:.6g}: the time step {dt:.3g} fell below {STEP_FLOOR:g} of the run, since K f' = "
        f"{speed:.3g} at x = {grid.centres[fastest]:.6g} (K = {K[fastest]:.3g}, q = {scheme.q[fastest]:.6g}) "
        f"and cfl = {cfl:g}; use {'a larger cfl, ' if cfl < SMALL_CFL else ''}fewer cells or an earlier end"
    )


def _breakdown_sentence(broken: Breakdown, K: float, grid: Grid, t: float, dt: float, cfl: float) -> str:
    x = grid.centres[broken.cell]
    what = f"q = {broken.q:.6g} reached -1" if np.isfinite(broken.q) else "q stopped being finite"
    remedy = "set cfl to 1 or less" if cfl > 1 else "use a monotone method (godunov), or a smaller cfl"
    step = f"in a step of {dt:.3g} (cfl = {cfl:g}, K = {K:.3g} there)"
    return f"stopped at t = {t:.6g} near x = {x:.6g}: {what} {step}; {remedy}"
