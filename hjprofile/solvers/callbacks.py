"""Callbacks of a user that observe a run after it has been computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from hjprofile.problem import Problem
from hjprofile.solvers.run import Run
from hjprofile.solvers.states import Callback, stopped_by


def observed(solve: Callable[[Problem], Run], problem: Problem, callback: Callback | None) -> Run:
    """Return the run of a problem by a solver, shown to a callback at its saved times.

    Methods without a grid need the whole run, or several runs, before a state is final. If the callback stops the run,
    the problem is therefore solved again up to that time, which gives the totals there.
    """
    run = solve(problem)
    for i, t in enumerate(run.time.tolist() if callback else ()):
        assert callback
        stop = stopped_by(callback, run.at(t))
        if stop is not None:
            times = run.time[: i + 1].tolist()
            shorter = run if t == problem.end else solve(replace(problem, end=t, snapshots=times))
            return replace(shorter, case=run.case, stop=stop)
    return run
