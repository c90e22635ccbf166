"""Checks of the parts of a result folder, each recomputed from the others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.model import LinearGrowth, Prescribed, RollingLayer
from hjprofile.solvers.methods import METHODS
from hjprofile.solvers.run import Array, KinkRecord, Run
from hjprofile.studies.verdict import Check

EPS = float(np.finfo(float).eps)
UNDERFLOW = float(np.log(np.finfo(float).tiny))  # smallest ln K with full precision
SMALLEST_SPEED = 1e-290  # of a kink that is compared: a normal number, and so are its quotients
TABLE = 1e-9  # accuracy of a tabulated law in ln K and in speeds; measured: 2e-11


def records(run: Run, problem: Problem, refresh: float | None, suffix: str) -> Iterator[Check]:
    """Check saved times, q, K, speeds and histories of kinks, and the eroded volume, each against the rest."""
    rounding = 8.0 * EPS * (1.0 + np.abs(run.u).max()) * np.sqrt(run.cells)
    dx = float(np.ptp(run.x)) / run.cells
    yield _most("times", suffix, run, *_times(run, problem), "those that the case asks for")
    slopes = np.diff(run.u, axis=1) / dx - 1.0 - run.q
    yield _most("q", suffix, run, np.abs(slopes), rounding / dx, "the difference quotient of u less 1")
    off, allowed = _factor(run, problem, refresh)
    yield _most("K", suffix, run, off, allowed, "exp of the integral of f(q), or the coefficient")
    yield _most("kinks", suffix, run, *_speeds(run, problem), "K [f]/[q] and [q] with the saved K")
    faults = float(sum(1 for _ in _impossible(run, problem)))
    yield _most("events", suffix, run, np.array([faults]), 0.0, "histories of kinks agree with their events")
    whole = run.time[0] == 0.0 and run.time[-1] == problem.end
    if whole and not _off_grid(run) and not isinstance(problem.model, RollingLayer):
        lowered = run.u[0, -1] - run.u[-1, -1] - run.crest_lowering
        allowed = rounding + 1e-9 * abs(run.crest_lowering)
        yield _most("crest_lowering", suffix, run, np.abs(lowered), allowed, "lowering of the crest")
    volume = np.trapezoid(run.u[0] - run.u[-1], run.x) - run.eroded_volume
    moved = 2.0 * dx * np.abs(run.u[0] - run.u[-1]).max() + rounding
    if whole:
        yield _most("volume", suffix, run, np.abs(volume), moved, "the integral of u(0, x) - u(t, x), to first order")


def _off_grid(run: Run) -> bool:
    """Return True if the method of a run does not use a grid."""
    method = METHODS.get(run.method)  # closed forms have none
    return method is not None and not method.on_grid


def _by_midpoints(run: Run) -> bool:
    """Return True if ln K is the integral of f of the cell means."""
    method = METHODS.get(run.method)
    return method is not None and method.midpoint


def _most(what: str, suffix: str, run: Run, off: Array, allowed: Array | float, rule: str) -> Check:
    """Return a Check of the largest deviation relative to its allowance."""
    off, allowed = np.broadcast_arrays(np.atleast_1d(off), np.asarray(allowed))
    if not off.size:
        return Check(f"saved-{what}{suffix}", [run.cells], [0.0], None, 0.0, True, rule)
    worst = np.unravel_index(np.argmax(np.nan_to_num(off - allowed, nan=np.inf)), off.shape)
    error, threshold = float(off[worst]), float(allowed[worst])
    return Check(f"saved-{what}{suffix}", [run.cells], [error], None, threshold, bool(error <= threshold), rule)


def _times(run: Run, problem: Problem) -> tuple[Array, Array | float]:
    """Return the deviations of the saved times, and the allowance."""
    if run.time.size != problem.times.size:
        return np.array([np.inf]), 0.0
    return np.abs(run.time - problem.times), 4.0 * EPS * problem.end


def _factor(run: Run, problem: Problem, refresh: float | None) -> tuple[Array, Array | float]:
    """Return |ln K - ln K'| at the nodes, with K' by the midpoint rule, and the allowance for rounding and rules."""
    dx = float(np.ptp(run.x)) / run.cells
    ln_K = _log(run.K)
    if isinstance(problem.model, Prescribed):
        times = run.time
        if refresh:  # frozen since the last multiple, which rounding can delay beyond a saved time
            times = np.minimum(refresh * np.floor(run.time / refresh * (1.0 + 1e-9) + 1e-9), run.time)
        return np.abs(ln_K - _log(problem.model.coefficient.values(times[:, None], run.x))), 1e-12
    f = problem.law.f(run.q)
    if refresh:  # K is that of the last refresh: compared at refresh times only
        part = run.time / refresh
        fresh = np.abs(part - np.round(part)) <= 1e-9 * np.maximum(part, 1.0)
        ln_K, f = ln_K[fresh], f[fresh]
    at_right = ln_K[:, -1:]  # on the whole line K is not 1 there
    right = np.zeros((len(f), 1))
    integral = dx * np.hstack([np.cumsum(f[:, ::-1], axis=1)[:, ::-1], right])
    off = np.abs(ln_K - np.maximum(at_right + integral, UNDERFLOW))
    if _by_midpoints(run):
        return off, TABLE * (1.0 + np.abs(ln_K).max(initial=0.0))
    # any rule with f between the values in its stencil differs by at most the variation of f there: weno5 takes 3 cells
    # on either side
    change = np.pad(np.abs(np.diff(f, axis=1)), ((0, 0), (3, 3)))
    vary = np.lib.stride_tricks.sliding_window_view(change, 6, axis=1).sum(axis=2)
    inside = f[:, -1:] * 0.0 + np.abs(f[:, -1:])  # the value at x = 0 is unknown
    return off, dx * np.hstack([np.cumsum(vary[:, ::-1], axis=1)[:, ::-1], right]) + dx * inside + TABLE


def _log(K: Array) -> Array:
    """Return ln K, and UNDERFLOW if K is too small for a normal number."""
    return np.log(np.maximum(K, np.finfo(float).tiny))


def _speeds(run: Run, problem: Problem) -> tuple[Array, Array]:
    """Return relative deviations of jumps and Rankine-Hugoniot speeds; off the grid K varies within a cell."""
    off, allowed = [], []
    exact, midpoint = _off_grid(run), _by_midpoints(run)
    dx = float(np.ptp(run.x)) / run.cells
    for i in range(run.time.size):
        for k in run.kinks_at(i):
            f_left, f_right = float(problem.law.f(k.q_left)), float(problem.law.f(k.q_right))
            speed = float(np.interp(k.x, run.x, run.K[i])) * (f_right - f_left) / k.jump
            if abs(speed) + abs(k.rankine_hugoniot_speed) < SMALLEST_SPEED:
                continue  # K has underflowed, and a quotient of the two has no digit
            off += [abs(speed / (k.rankine_hugoniot_speed or SMALLEST_SPEED) - 1.0)]
            off += [abs((k.q_right - k.q_left) / k.jump - 1.0)]
            at = int(np.clip(np.searchsorted(run.x, k.x) - 1, 0, run.cells - 1))
            steepest = np.abs(problem.law.f(run.q[i, max(at - 1, 0) : at + 2])).max()
            near = dx * (abs(f_left) + abs(f_right) + steepest)
            if not exact:
                near += dx * np.abs(np.diff(problem.law.f(run.q[i]))).sum()
            allowed += [TABLE + (0.0 if midpoint else near), TABLE]
    return np.array(off), np.array(allowed)


def _impossible(run: Run, problem: Problem) -> Iterator[KinkRecord | object]:
    """Yield the rows and events that contradict each other."""
    slack = 1e-9 * problem.end
    ends = {e.kink: e for e in run.events if e.event in ("merge", "exit")}
    births = {e.kink: e.time for e in run.events if e.event == "birth"}
    known = {k.kink for k in run.kinks} | births.keys()
    # a run that begins later, or in which steps turn into kinks, does not list all births
    first = known if run.time[0] > 0.0 or isinstance(problem.model, LinearGrowth) else {k.kink for k in run.kinks_at(0)}
    for e in run.events:
        if not -slack <= e.time <= problem.end + slack or not run.x[0] <= e.x <= run.x[-1]:
            yield e
        if e.event == "merge" and (e.into == e.kink or e.into not in known):
            yield e
    for k in run.kinks:
        if not run.x[0] <= k.x <= run.x[-1] or k.time not in run.time or k.time < births.get(k.kink, 0.0) - slack:
            yield k
        if k.kink in ends and ends[k.kink].time < k.time - slack:
            yield k
        if k.kink not in births and k.kink not in first:
            yield k
