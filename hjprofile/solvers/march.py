"""Marching a scheme through time: step size, snapshots hit exactly, failure, those who watch."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from hjprofile.errors import RunError
from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.solvers.run import Array, Monitor, State

STEP_FLOOR = 1e-9  # of the run's end: more steps than this allows would take days
OBSERVE_EVERY = 6  # steps, so that between two states that monitors see nothing moves further than six cells


class Scheme(Protocol):
    """A space discretisation with its own time step. `W`, `q`, `K` are valid after `evaluate`."""

    @property
    def W(self) -> Array: ...

    q: Array
    K: Array
    growth: float
    outflow: float
    cfl_limit: float  # Δt max(K f')/Δx at which the scheme is still monotone (limited: total variation diminishing)

    def evaluate(self) -> float:
        """Brings q, K and the fluxes up to the present state; returns max K f'. Raises Breakdown."""
        ...

    def advance(self, dt: float) -> None:
        """One time step from the state last evaluated."""
        ...

    def restore(self) -> None:
        """Back to the state before the last step."""
        ...

    def volume(self) -> float:
        """∫(u - x) dx by the sum whose change the scheme's own budget states."""
        ...


class Breakdown(Exception):
    """The state is no longer admissible. Carries the cell and q there."""

    def __init__(self, q: Array, K: Array):
        bad = ~(np.isfinite(q) & (q > -1.0))
        # K is summed from the right, so the rightmost bad cell is the first to blame
        self.cell = int(np.flatnonzero(bad)[-1]) if bad.any() else int(np.argmin(np.isfinite(K)))
        self.q = float(q[self.cell])


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
) -> Recording:  # fmt: skip
    """Runs `scheme` to the problem's end; `progress` is called with the fraction that is done."""
    saved: list[tuple[float, Array, Array, Array]] = []
    kept = problem.times
    t, steps, seconds, status = 0.0, 0, 0.0, "done"
    shortest, longest = np.inf, 0.0

    def watch(speed: float) -> None:
        state = State(t, scheme.W, scheme.q, scheme.K, speed, scheme.volume(), scheme.growth, scheme.outflow)
        for monitor in monitors:
            monitor.observe(state)
        if progress:
            progress(t / problem.end if problem.end else 1.0)

    def save() -> None:
        saved.append((t, scheme.W.copy(), scheme.q.copy(), scheme.K.copy()))

    try:
        speed = scheme.evaluate()
    except Breakdown as broken:
        x = grid.centres[broken.cell]
        raise RunError(
            f"the run cannot start: K f' is not a finite number near x = {x:.6g}, where q = {broken.q:.6g}; "
            "the integral of f is too large (K spans more than 300 decades) or q is too near -1"
        ) from None
    scheme.advance(0.0)  # compiles what is to be compiled
    watch(speed)
    if kept[0] == 0.0:
        save()
    dt, started = 0.0, time.perf_counter()
    try:
        for target in np.unique(np.append(kept[kept > 0.0], problem.end if problem.end else [])):
            while t < target:
                started = time.perf_counter()
                seen = steps
                while t < target and steps < seen + OBSERVE_EVERY:
                    dt = cfl * scheme.cfl_limit * grid.dx / speed
                    remaining = target - t
                    if dt >= remaining:
                        dt = remaining
                    elif 2 * dt > remaining:  # two equal steps rather than a long and a tiny one
                        dt = 0.5 * remaining
                    if dt < STEP_FLOOR * problem.end and dt < remaining:
                        raise _StepTooSmall
                    scheme.advance(dt)
                    speed = scheme.evaluate()
                    t = target if dt == remaining else t + dt
                    steps += 1
                    shortest, longest = min(shortest, dt), max(longest, dt)
                seconds += time.perf_counter() - started
                watch(speed)
            if target in kept:
                save()
    except Breakdown as broken:
        seconds += time.perf_counter() - started
        status = _breakdown_sentence(broken, grid, t, dt, cfl)
        scheme.restore()
        speed = scheme.evaluate()
    except _StepTooSmall:
        seconds += time.perf_counter() - started
        status = _small_step_sentence(scheme, problem, grid, t, dt, speed)
    if status != "done" and (not saved or saved[-1][0] < t):
        save()
    times, W, q, K = (np.array(column) for column in zip(*saved, strict=True))
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
    return f"stopped at t = {t:.6g} near x = {x:.6g}: {what} in a step of {dt:.3g} (cfl = {cfl:g}); {remedy}"
