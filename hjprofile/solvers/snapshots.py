"""Advance of a solution through the saved times, and assembly of a run from its snapshots."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.solvers.kernels.journal import CREST_LOWERING, TOE_GAIN
from hjprofile.solvers.run import Array, Event, KinkRecord, Run, VerticalStep, in_order
from hjprofile.solvers.snapshot_bounds import SnapshotBounds, uniform_tv
from hjprofile.solvers.stop import Stop, Stopped
from hjprofile.solvers.weak_kinks import without_weak_kinks


class Lost(Stopped):
    """A solution that cannot continue."""


class Solution:
    """A solution that moves through time without a grid.

    Attributes:
        moment: accuracy of the times of events.
        events: births, merges, exits and blow-ups so far, in any order.
        steps: number of time steps so far.
        totals: ∫(K_left - 1) dt and ∫F(0) dt so far, indexed by TOE_GAIN and CREST_LOWERING.
    """

    moment: float
    events: list[Event]
    steps: int
    totals: Array | Sequence[float]

    def advance(self, target: float) -> None:
        """Move to the time `target`. Raise Lost if the solution cannot continue."""
        raise NotImplementedError

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """Return W and K at the nodes, W being u - x less its value at the left end."""
        raise NotImplementedError

    def check(self, grid: Grid, W: Array, K: Array) -> None:
        """Raise Lost if a state that was read on a grid is not admissible."""

    def volume(self) -> float:
        """Return ∫W dx."""
        raise NotImplementedError

    def kinks(self) -> list[KinkRecord]:
        """Return the current kinks, from left to right."""
        raise NotImplementedError

    def finish(self) -> list[KinkRecord]:
        """Return the kinks at the end of the run."""
        return self.kinks()

    def vertical_steps(self) -> list[VerticalStep] | None:
        """Return the current vertical steps, from left to right; None if the law has none."""
        return None

    def stop(self, target: float, lost: Lost) -> Stop:
        """Return the reason for which a run stops before the time `target`."""
        return lost.stop


class Witness:
    """W at nodes at times that are not saved; shape (times, nodes) if the run reaches its end."""

    def __init__(self, times: Array, nodes: Array):
        self.times, self.nodes = times, nodes
        self.W: list[Array] = []


@dataclass
class Snapshots:
    """The states of a solution at the saved times that it has reached.

    Attributes:
        states: W and K at the nodes of the grid, for each time.
        kinks: of all times.
        vertical_steps: of all times, or None if the law has none.
        stop: the reason for which the solution stopped; None if it reached its end.
        seconds: of the time stepping.
    """

    states: list[tuple[Array, Array]] = field(default_factory=list)
    kinks: list[KinkRecord] = field(default_factory=list)
    vertical_steps: list[VerticalStep] | None = None
    stop: Stop | None = None
    seconds: float = 0.0

    def rows(self, grid: Grid) -> tuple[Array, Array]:
        """Return W and K, each of shape (times, nodes)."""
        W, K = (np.array([state[i] for state in self.states]).reshape(-1, grid.cells + 1) for i in (0, 1))
        return W, K


def walk(
    solution: Solution, problem: Problem, grid: Grid, watch: SnapshotBounds | None = None,
    progress: Callable[[float], None] | None = None, witness: Witness | None = None,
    judged: Sequence[float] | None = None,
) -> Snapshots:  # fmt: skip
    """Move a solution to each saved time and to the end, until it stops, and read it on the grid.

    The bounds, if `watch` judges them, are evaluated at the times `judged`, by default at all times at which the
    solution is read.
    """
    saved, found = problem.times, Snapshots()
    extra = [witness.times if witness else np.empty(0), np.empty(0) if judged is None else np.array(judged)]
    for target in np.unique(np.concatenate([saved, *extra, [problem.end]])).tolist():
        started = time.perf_counter()
        try:
            try:
                solution.advance(target)
            finally:
                found.seconds += time.perf_counter() - started
            W, K = solution.read(grid.nodes)
            solution.check(grid, W, K)
        except Lost as lost:
            found.stop = solution.stop(target, lost)
            break
        if watch and (judged is None or target in judged):
            watch.observe(target, W, solution.volume(), solution.totals[TOE_GAIN], solution.totals[CREST_LOWERING])
        if witness and target in witness.times:
            witness.W.append(solution.read(witness.nodes)[0])
        kinks = solution.kinks() if target < problem.end else solution.finish()
        if target in saved:
            found.states.append((W, K))
            found.kinks += kinks
            steps = solution.vertical_steps()
            if steps is not None:
                found.vertical_steps = [*(found.vertical_steps or []), *steps]
        if progress:
            progress(target / problem.end if problem.end else 1.0)
    return found


def assembled(
    method: str, solution: Solution, snapshots: Snapshots, watch: SnapshotBounds, problem: Problem, grid: Grid
) -> Run:
    """Return the run of a walk."""
    W, K = snapshots.rows(grid)
    times, bounds = problem.times[: len(W)], watch.bounds
    if times.size and watch.variation_I is not None and not problem.profile.inflow:
        bounds = bounds | {"uniform_tv": uniform_tv(problem.law, grid, times, W, watch.variation_I)}
    kinks, events = without_weak_kinks(
        snapshots.kinks, in_order(solution.events, solution.moment), problem.profile.rounding
    )
    return Run(
        title=problem.title,
        method=method,
        case=resolved_case(problem, grid, method),
        time=times,
        x=grid.nodes,
        x_cell=grid.centres,
        u=grid.nodes + W + float(problem.profile.W(grid.nodes[:1], problem.law)[0]),
        q=np.diff(W, axis=1) / grid.dx,
        K=K,
        stop=snapshots.stop,
        steps=solution.steps,
        wall_seconds=snapshots.seconds,
        kinks=kinks,
        events=events,
        vertical_steps=snapshots.vertical_steps,
        bounds=bounds,
        eroded_volume=watch.eroded_volume,
        toe_outflow=watch.toe_outflow,
        crest_lowering=float(solution.totals[CREST_LOWERING]),
        volume_budget_error=watch.budget_error,
        units=problem.profile.units,
        surveyed=problem.profile.surveyed,
        account=problem.profile.account,
        law=problem.law,
    )
