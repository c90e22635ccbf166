"""Statements along characteristics: equations (2.11), (2.12), (3.13), and the invariant I = W + R(q) of (3.15).

Characteristics are followed backwards through a run of METHOD. Each statement is an equality between the values at two
points of a characteristic; its defect is the difference of the two sides. The defect of a correct solution is the error
of the computation. It is estimated by evaluations on a half and a quarter of the cells, and with half of the times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.methods import find_method
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.solve import solve_with
from hjprofile.studies.tracing import KinkPath, kink_paths, place, trace_back

METHOD = "conservative"  # second order where q is smooth
TIMES = 401  # number of saved times, both ends included
GENERATIONS = 4  # number of times from which characteristics are followed back
EACH = 6  # number of characteristics from each
COARSER = 1, 2, 4  # the grids have the cells of the finest one divided by these numbers
# Allowed defect relative to the estimated error, which is the error if that is of first order. With jumps in the data
# the error depends on their positions in the cells: in 120 random profiles the defect was at most 3.1 estimates.
SAFETY = 4.0
NEAR = 5.0  # distance to a kink, in cells of the coarser run, below which q is not resolved
WIDTH = 4.0  # the same for the change of q across a point
STEEP = 0.1  # largest change of q across 2 WIDTH cells, relative to the range of q

INVARIANT = "invariant"
WORDS = {
    "flux_on_characteristics": ("(2.11)", "dF/dt = (k_t/k) F along characteristics"),
    "q_on_characteristics": ("(2.12), (3.13)", "dq/dt = -k_x f(q) along characteristics"),
    INVARIANT: ("(3.15)", "W + R(q) is constant along characteristics"),
}


class Values(NamedTuple):
    """Values along characteristics, each of shape (times, characteristics); NaN where they are not followed.

    W is u - x, q the excess slope, K the coefficient, F = K f(q), and I = W + R(q), NaN for a prescribed coefficient.
    """

    x: Array
    q: Array
    K: Array
    F: Array
    W: Array
    I: Array


class Characteristics(NamedTuple):
    """Characteristics, and the defects of the statements along them.

    Attributes:
        time: saved times, shape (times,).
        values: along the characteristics.
        defects: statement -> differences of its two sides between a time and the end of the characteristic, shape
            (times, characteristics).
        allowances: statement -> SAFETY times the estimated error of a defect.
        kinks: paths of the kinks of the run.
        reason: the reason why no characteristic was followed, or "".
    """

    time: Array
    values: Values
    defects: dict[str, Array]
    allowances: dict[str, float]
    kinks: dict[int, KinkPath]
    reason: str = ""

    def rows(self) -> list[tuple[float, ...]]:
        """Return the rows of a table: the number of a characteristic, the time, and the values."""
        known = np.isfinite(self.values.x)
        return [
            (number, float(self.time[i]), *(float(v[i, c]) for v in self.values))
            for number, c in enumerate(np.flatnonzero(known.any(axis=0)), start=1)
            for i in np.flatnonzero(known[:, c])
        ]


COLUMNS = "characteristic", "time", *Values._fields


def follow(problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None) -> Characteristics:
    """Follow characteristics of a problem backwards from several times."""
    runs = []
    for part, coarser in enumerate(COARSER, start=1):
        run = solved(problem, Grid(grid.left, max(grid.cells // coarser, 2)))
        if not run.done:
            return _none(f"the method {METHOD} {run.status}")
        runs.append(run)
        if progress:
            progress(part / len(COARSER))
    return along(problem, *runs)


def _none(reason: str) -> Characteristics:
    """Return no characteristics, for this reason."""
    return Characteristics(np.empty(0), Values(*(np.empty((0, 0)) for _ in Values._fields)), {}, {}, {}, reason)


def solved(problem: Problem, grid: Grid) -> Run:
    """Return the run of METHOD at TIMES even times."""
    times = np.linspace(0.0, problem.end, TIMES).tolist()
    return solve_with(find_method(METHOD), replace(problem, snapshots=times), grid)


def along(problem: Problem, fine: Run, half: Run, quarter: Run) -> Characteristics:
    """Return the characteristics of `fine`, with errors estimated by runs on a half and a quarter of its cells."""
    law, nonlocal_ = problem.law, problem.coefficient is None
    ends, kinks = _ends(fine), kink_paths(fine)
    traced = trace_back(fine, law, ends)
    x, fewer = (_while_resolved(traced, fine, kinks, float(run.x[1] - run.x[0])) for run in (half, quarter))
    if not (np.isfinite(x).sum(axis=0) > 1).any():
        return _none("no characteristic is far enough from kinks on this grid; use more cells")
    values, defects = _defects(fine, law, x, nonlocal_)
    every = replace(fine, time=fine.time[::2], u=fine.u[::2], q=fine.q[::2], K=fine.K[::2])
    by_half, by_quarter = (_defects(run, law, trace_back(run, law, ends), nonlocal_)[1] for run in (half, quarter))
    _, in_time = _defects(every, law, trace_back(every, law, [(i // 2, at) for i, at in ends]), nonlocal_)
    allowances = {}
    for name, defect in defects.items():
        on_grids = (
            _largest(defect - by_half[name]),
            _largest(np.where(np.isfinite(fewer), defect - by_quarter[name], 0.0)),
        )
        allowances[name] = SAFETY * (max(on_grids[0], on_grids[1] / 3.0) + _largest(defect[::2] - in_time[name]))
    return Characteristics(fine.time, values, defects, allowances, kinks)


def _largest(values: Array) -> float:
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _ends(run: Run) -> list[tuple[int, float]]:
    """Return the ends of the characteristics: EACH at several times, where the slope is not neutral."""
    last, ends = run.time.size - 1, []
    for generation in range(1, GENERATIONS + 1):
        i = 2 * round(generation * last / (2 * GENERATIONS))
        weight = np.abs(run.q[i])
        weight = weight + 0.1 * weight.mean() + 1e-300  # some of them on the neutral parts
        passed = np.cumsum(weight) / weight.sum()
        parts = (np.arange(EACH) + 0.5) / EACH
        ends += [(i, float(at)) for at in np.interp(parts, passed, run.x_cell)]
    return ends


def _while_resolved(x: Array, run: Run, kinks: dict[int, KinkPath], width: float) -> Array:
    """Return positions of characteristics, NaN before the last time at which q is not resolved on cells of `width`."""
    resolved, spread = np.isfinite(x), float(np.ptp(run.q))
    for i, t in enumerate(run.time.tolist()):
        at = np.where(resolved[i], x[i], run.x[0])
        right, left = (np.interp(at + side * WIDTH * width, run.x_cell, run.q[i]) for side in (1.0, -1.0))
        resolved[i] &= np.abs(right - left) <= STEEP * spread
        for number in kinks:
            resolved[i] &= ~(np.abs(at - place(kinks, number, t)) < NEAR * width)  # also where there is no kink
        resolved[i] &= (at > run.x[0] + WIDTH * width) & (at < run.x[-1] - width)
    after = np.isfinite(x)
    unresolved = (~resolved & after)[::-1].cumsum(axis=0)[::-1] > 0
    return np.where(after & ~unresolved, x, np.nan)


def _defects(run: Run, law: ErosionLaw, x: Array, nonlocal_: bool) -> tuple[Values, dict[str, Array]]:
    """Return the values along characteristics and the defects of the statements."""
    q, K, W, falls = (np.full(x.shape, np.nan) for _ in range(4))
    grown = np.full((x.shape[0] - 1, x.shape[1]), np.nan)
    ln_K, dx = np.log(run.K), float(run.x[1] - run.x[0])
    for i in range(run.time.size):
        known = np.isfinite(x[i])
        at = x[i, known]
        q[i, known] = np.interp(at, run.x_cell, run.q[i])
        K[i, known] = np.exp(np.interp(at, run.x, ln_K[i]))
        W[i, known] = np.interp(at, run.x, run.u[i] - run.x)
        if not nonlocal_:
            falls[i, known] = -np.interp(at, run.x, np.gradient(run.K[i], dx))
        if i:
            change = ln_K[i] - ln_K[i - 1]
            at_both = (np.interp(x[j, known], run.x, change) for j in (i - 1, i))  # NaN where x is
            grown[i - 1, known] = 0.5 * sum(at_both)
    f = law.f(np.where(np.isfinite(q), q, 0.0)) + 0.0 * q
    F = K * f
    rate = F * f if nonlocal_ else falls * f
    R = law.R(np.where(np.isfinite(q), q, 0.0)) + 0.0 * q
    I = W + R if nonlocal_ else np.full(x.shape, np.nan)
    steps = np.diff(run.time)[:, None]
    defects = {
        "flux_on_characteristics": np.diff(F, axis=0) - 0.5 * (F[1:] + F[:-1]) * grown,
        "q_on_characteristics": np.diff(q, axis=0) - 0.5 * steps * (rate[1:] + rate[:-1]),
    }
    if nonlocal_:
        defects[INVARIANT] = np.diff(I, axis=0)
    return Values(x, q, K, F, W, I), {name: _from_the_end(x, part) for name, part in defects.items()}


def _from_the_end(x: Array, increments: Array) -> Array:
    """Return the sums of increments from each time to the end of a characteristic."""
    sums = np.zeros(x.shape)
    sums[:-1] = np.nancumsum(increments[::-1], axis=0)[::-1]
    return np.where(np.isfinite(x), sums, np.nan)
