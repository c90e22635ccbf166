"""Marching a scheme through time: step size, snapshots hit exactly, failure, those who watch.

A scheme takes many steps of one length at a time. The length is chosen with a margin over the speed met last, the
speed that was met is looked at afterwards, and the steps are taken anew, shorter, if it was more than they allow.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.run import Array, Monitor, State

STEP_FLOOR = 1e-9  # of the run's end: more steps than this allows would take days
MOST_STEPS = 64  # at a time; fewer on coarse grids, so that between two states that monitors see ...
MOST_WAY = 1 / 32  # ... nothing moves further than this part of the grid
CLOSE_STEPS = 6  # at a time, where a monitor wants to know when something happened
MARGIN = 0.01  # by which the speed may rise while steps are taken, beyond half as much again as it rose last
NEGLIGIBLE = 1e-40  # differences of W or q that are made none


class Scheme(Protocol):
    """A discretisation with its own time steps. `q`, `K` belong to the present state after `evaluate`."""

    @property
    def W(self) -> Array: ...

    q: Array
    K: Array
    growth: float
    outflow: float
    cfl_limit: float  # Δt max(K f')/Δx at which the scheme is still monotone (limited: total variation diminishing)

    def evaluate(self) -> float:
        """Brings q and K up to the present state; returns max K f'. Raises Breakdown."""
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


class Breakdown(Exception):
    """The state is no longer admissible. Carries the cell, q there, and K as it was there last."""

    def __init__(self, q: Array, K: Array):
        bad = ~(np.isfinite(q) & (q > -1.0))
        # K is summed from the right, so the rightmost bad cell is the first to blame
        elsewhere = np.argmin(q) if np.isfinite(K).all() else np.argmin(np.isfinite(K))
        self.cell = int(np.flatnonzero(bad)[-1]) if bad.any() else int(elsewhere)
        self.q, self.K = float(q[self.cell]), float(K[self.cell + 1])


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


def march(
    scheme: Scheme, problem: Problem, grid: Grid, cfl: float,
    monitors: Sequence[Monitor] = (), progress: Callable[[float], None] | None = None,
    happened: Callable[[State], bool] = lambda state: False,
) -> Recording:  # fmt: skip
    """Runs `scheme` to the problem's end; `progress` is called with the fraction that is done.

    Where `happened` says that something has since the last state, the steps in between are taken anew, few at a time.
    """
    kept = problem.times
    columns = [np.empty((kept.size, *shape)) for shape in ((), (grid.cells + 1,), (grid.cells,), (grid.cells + 1,))]
    saved = 0
    t, steps, seconds, status = 0.0, 0, 0.0, "done"
    shortest, longest = np.inf, 0.0

    def present(t: float, speed: float) -> State:
        return State(t, scheme.W, scheme.q, scheme.K, speed, scheme.volume(), scheme.growth, scheme.outflow)

    def watch(state: State) -> None:
        for monitor in monitors:
            monitor.observe(state)
        if progress:
            progress(t / problem.end if problem.end else 1.0)

    def save() -> None:
        nonlocal saved
        for i, value in enumerate((t, scheme.W, scheme.q, scheme.K)):
            if saved == kept.size:  # the last good state of a run that stopped after the last time that is kept
                columns[i] = np.concatenate([columns[i], [value]])
            columns[i][saved] = value
        saved += 1

    try:
        speed = scheme.evaluate()
    except Breakdown as broken:
        x = grid.centres[broken.cell]
        raise RunError(
            f"the run cannot start: K f' is not a finite number near x = {x:.6g}, where q = {broken.q:.6g}; "
            "the integral of f is too large (K spans more than 300 decades) or q is too near -1"
        ) from None
    scheme.advance(0.0, 1, speed)  # compiles what is to be compiled
    watch(present(t, speed))
    if kept[0] == 0.0:
        save()
    dt, rise, outgrown, close_until = 0.0, 0.0, 0.0, 0.0
    most = longest_leap = min(MOST_STEPS, max(1, int(grid.cells * MOST_WAY)))
    try:
        for target in np.unique(np.append(kept[kept > 0.0], problem.end if problem.end else [])):
            while t < target:
                bound = max(speed * (1.0 + MARGIN + 1.5 * rise), outgrown * (1.0 + MARGIN))
                dt = cfl * scheme.cfl_limit * grid.dx / bound
                remaining = float(target) - t
                needed = max(1, math.ceil(remaining / dt * (1.0 - 1e-12)))
                if needed <= most:
                    dt = remaining / needed
                elif dt < STEP_FLOOR * problem.end:
                    raise _StepTooSmall
                leap = min(needed, CLOSE_STEPS if t < close_until else most)
                started = time.perf_counter()
                try:
                    met = scheme.advance(dt, leap, bound)
                    seconds += time.perf_counter() - started
                    if bound < met < np.inf and (cfl <= 1.0 or leap > 1):
                        scheme.restore()
                        if cfl <= 1.0:
                            outgrown = met
                        else:  # no bound is promised; each step by the speed before it, to show what comes of it
                            most = max(1, leap // 4)
                        continue
                    scheme.evaluate()
                    if not met < np.inf:
                        raise Breakdown(scheme.q, scheme.K)
                except Breakdown:
                    if leap == 1:
                        raise
                    scheme.restore()  # and once more, to find out where
                    most = max(1, leap // 4)
                    continue
                state = present(float(target) if leap == needed else t + leap * dt, met)
                if leap > CLOSE_STEPS and happened(state):
                    close_until = state.t
                    scheme.restore()
                    continue
                rise, speed, outgrown, t = min(max(met / speed - 1.0, 0.0), 1.0), met, 0.0, state.t
                most = min(2 * most, longest_leap)
                steps += leap
                shortest, longest = min(shortest, dt), max(longest, dt)
                watch(state)
            if target in kept:
                save()
    except Breakdown as broken:
        status = _breakdown_sentence(broken, grid, t, dt, cfl)
        scheme.restore()
        speed = scheme.evaluate()
    except _StepTooSmall:
        status = _small_step_sentence(scheme, problem, grid, t, dt, speed)
    if status != "done" and (not saved or columns[0][saved - 1] < t):
        save()
    times, W, q, K = (column[:saved] for column in columns)
    return Recording(times, W, q, K, status, steps, (float(shortest), float(longest)), seconds)


def _small_step_sentence(scheme: Scheme, problem: Problem, grid: Grid, t: float, dt: float, speed: float) -> str:
    K = np.maximum(scheme.K[1:], scheme.K[:-1])
    fastest = int(np.argmax(K * problem.law.derivative(scheme.q)))
    return (
        f"stopped at t = {t:.6g}: the time step {dt:.3g} fell below {STEP_FLOOR:g} of the run, since K f' = "
        f"{speed:.3g} at x = {grid.centres[fastest]:.6g} (K = {K[fastest]:.3g}, q = {scheme.q[fastest]:.6g}); "
        "use fewer cells or an earlier end"
    )


def _breakdown_sentence(broken: Breakdown, grid: Grid, t: float, dt: float, cfl: float) -> str:
    x = grid.centres[broken.cell]
    what = f"q = {broken.q:.6g} reached -1" if np.isfinite(broken.q) else "q stopped being finite"
    remedy = "set cfl to 1 or less" if cfl > 1 else "use a monotone method (godunov), or a smaller cfl"
    step = f"in a step of {dt:.3g} (cfl = {cfl:g}, K = {broken.K:.3g} there)"
    return f"stopped at t = {t:.6g} near x = {x:.6g}: {what} {step}; {remedy}"
