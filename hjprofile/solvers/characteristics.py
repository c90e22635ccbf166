"""Shock-fitted characteristics: the solution to rounding, through births, merges and exits of kinks (theory, §5).

Over the labels of characteristics r = R(q) and X are a system of ordinary differential equations with one quadrature;
a shock is the pair of labels that meet in it, found by algebra. Steps are of order 8, panels are halved where they need
it, and events are found in their own time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.monitors.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import as_number, shown
from hjprofile.solvers.invariant import law_table
from hjprofile.solvers.kernels import characteristics as kernels
from hjprofile.solvers.kernels.dormand_prince import tableau
from hjprofile.solvers.kernels.labels import after_start, before_end
from hjprofile.solvers.kernels.law import LawTable, law_q_f
from hjprofile.solvers.label_events import (
    FINE,
    Sign,
    exited,
    folds,
    merged,
    parted,
    passed,
    place,
    signs,
    with_joint_at,
)
from hjprofile.solvers.panels import POINTS, RULE, TAIL, Panels, cut_into_panels, interpolation, tails
from hjprofile.solvers.run import Array, Event, KinkRecord, Run, in_order
from hjprofile.solvers.units_of_the_law import Units, in_units_of_the_law
from hjprofile.solvers.whole_line import also_on_the_whole_line

TOLERANCE = 1e-12
LEAST = 1e-15  # error of a step, below which it is rounding
FINEST, COARSEST = 1e-13, 1e-4  # that may be asked for: finer is rounding
STEPS = 1e-7  # coarsest tolerance of the steps: coarser ones save nothing, and at 1e-4 they can miss a birth
COARSER, COARSE_STEPS = 100.0, 1e-6  # ratio of the tolerances of the two runs for the estimate; the second's most
TRY, LABEL, READ = 3e-4, 2e-6, 1.5e-3  # seconds of a step, a label in it and a saved time, where they were measured
BUDGET = 30.0  # allowance of a budget in tolerances, of the size of its terms; 2000 random runs kept it
ROUNDING = 1e-14  # of W of order 1, after some hundred steps; measured 7e-14 at most on the rational closed forms
CORNER = 1e-3  # part of a panel within which a birth beside a corner is at it; a sliver would halve every step
FLOOR = 1e-13  # least step, as a part of the end
TOO_LONG = "it would take too long"
MOMENT, BEYOND, LOOK = 1e-11, 10.0, 100.0  # of events: in ends, in tolerances, and in thresholds of a birth
MOST_PANELS, MOST_EVENTS = 4000, 200  # events at one moment; each takes a kink, a panel or a label away


class Lost(RunError):
    """The labels of a shock or an admissible state are lost; the message says where."""


@dataclass
class _Stretch:
    """What a step is tried on: the panels at its start, and where its time is counted from."""

    panels: Panels
    t: float
    origin: float  # NaN, or the latest birth: time runs in sqrt(t - origin)

    def clock(self, t: float) -> float:
        return t if np.isnan(self.origin) else float(np.sqrt(max(t - self.origin, 0.0)))

    def time(self, clock: float) -> float:
        return clock if np.isnan(self.origin) else self.origin + clock * clock


class _Solver:
    """Characteristics on their way."""

    def __init__(self, problem: Problem, panels: Panels, table: LawTable, tolerance: float, patience: float):
        self.table, self.requested, self.end, self.patience = table, tolerance, float(problem.end), patience
        # births need X_ξ and q, so that errors have to be small against the narrowest panel and the largest q
        narrowest, largest = float(panels.mesh.half.min()), float(np.abs(panels.r - problem.law.R(0.0)).max())
        self.tolerance = max(tolerance * min(1.0, narrowest) * min(1.0, largest), LEAST)
        self.now = _Stretch(panels, 0.0, np.nan)
        self.r0 = float(problem.law.R(0.0))
        self.h = 0.01 * max(problem.end, 1e-300)
        self.events: list[Event] = []
        self.count, self.steps = panels.shocks, 0
        # the smallest negative slope of X in the label that is no noise of panels or steps
        self.threshold = max(1e-7, 30.0 * POINTS**2 * tolerance)
        self.moment = problem.end * max(MOMENT, BEYOND * tolerance)
        self._room()

    @property
    def flat(self) -> bool:
        """Whether every label has left at x = 0."""
        return len(self.now.panels.r) == 0

    def _room(self) -> None:
        panels = self.now.panels
        self.S, self.c = np.zeros(panels.r.shape), np.zeros(panels.shocks + 1)
        self.k = np.zeros((13, 2 * panels.r.size + 2))

    def advance(self, target: float) -> None:
        """To the time `target`. Raises Lost where it cannot go on."""
        idle = 0
        while self.now.t < target and not self.flat:
            before = self.now.t
            self._step(target)
            idle = idle + 1 if self.now.t == before else 0
            if idle > MOST_EVENTS:
                raise Lost(f"more than {MOST_EVENTS} events fall on one moment")
        if self.flat:
            self.now.t = target

    def _try(self, h: float) -> tuple[Panels, float]:
        """The panels after a step h of the clock, and the error of the step as a part of the tolerance."""
        now, panels = self.now, self.now.panels
        self.patience -= TRY + LABEL * panels.r.size
        if self.patience < 0.0:
            raise Lost(TOO_LONG)
        off, off_top, tau = panels.off.copy(), panels.off_top.copy(), panels.tau.copy()
        new = np.empty(2 * panels.r.size + 2)
        error, found = kernels.step(
            panels.y, now.clock(now.t), h, now.origin, tableau(), panels.mesh, RULE, self.table,
            off, off_top, panels.birth, panels.power, tau, self.S, self.c, self.k, new,
        )  # fmt: skip
        self.found = found
        return panels.at(new, off, off_top, tau), error / self.tolerance

    def _step(self, target: float) -> None:
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
                self._room()
                if len(now.panels.r) > MOST_PANELS:
                    raise Lost(f"the profile needs more than {MOST_PANELS} panels")
                continue
            before, reached = h, h == left
            crossed = [e for e, value in signs(panels, self.threshold).items() if value < 0.0]
            if crossed:
                h, panels, event, error = self._first_event(crossed, h, panels)
                if not error <= 1.0:  # the estimate of the longer step was small by chance
                    self.h, h = 0.0, 0.5 * h
                    continue
                reached = False
            break
        self.steps += 1
        t = target if reached else now.time(now.clock(now.t) + h)
        self.now = _Stretch(panels, t, now.origin)
        if crossed:
            self._apply(event)
        if not self.flat:
            trimmed = self.now.panels.trimmed()
            if trimmed is not self.now.panels or crossed:
                self.now = replace(self.now, panels=trimmed)
                self._room()
        if not crossed:  # a step that only a saved time cut short says nothing against longer ones
            self.h = max(self.h, before * (min(2.0, 0.9 * error**-0.125) if error > 0.0 else 2.0))
        elif self.h == 0.0:
            self.h = before

    def _why(self) -> str:
        if self.found > 0:
            return f"the labels of kink {self.now.panels.number[self.found - 1]} cannot be told"
        if self.found < 0:
            return "the labels fold where no kink is known"
        return "steps become too small"

    def _rough(self, panels: Panels) -> list[int]:
        """Panels whose last Chebyshev coefficients are no rounding."""
        most = max(0.1 * self.tolerance, TAIL)
        low, high = panels.living()
        return np.flatnonzero(
            (np.maximum(tails(panels.r), tails(panels.X)) > most) & (high > low) & (panels.mesh.half > 1e-9)
        ).tolist()

    def finish(self) -> list[KinkRecord]:
        """Return the kinks at the end. Events that rounding puts just behind it are noted, and end kinks."""
        kinks, ahead = self.kinks(), copy(self)  # the next lines overwrite K
        ahead.events = []
        with suppress(Lost):
            ahead.advance(self.end * (1.0 + LOOK * self.threshold))
        self.events += (late := [e._replace(time=self.end) for e in ahead.events if e.time <= self.end + self.moment])
        return [k for k in kinks if k.kink not in {e.kink for e in late if e.event != "birth"}]

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """W and K at the nodes."""
        W, K = np.zeros_like(nodes), np.ones_like(nodes)
        if not self.flat:
            panels = self.now.panels
            self._rates(panels)
            kernels.read(panels.y, panels.mesh, RULE, *panels.living(), self.S, self.c, nodes, W, K)
        return W, K

    def _rates(self, panels: Panels) -> Array:
        """dy/dt now, and S and c."""
        out = np.empty(2 * panels.r.size + 2)
        self.found = kernels.rates(
            panels.y, self.now.t, panels.mesh, RULE, self.table, panels.off, panels.off_top, panels.birth,
            panels.power, panels.tau, self.S, self.c, np.nan, out,
        )  # fmt: skip
        if self.found:
            raise Lost(self._why())
        return out

    def kinks(self) -> list[KinkRecord]:
        """The kinks now, from left to right."""
        if self.flat:
            return []
        panels, records = self.now.panels, []
        for k in range(panels.shocks):
            x = place(panels, k)
            sides = [self.r0]
            if panels.mesh.first[k] < panels.mesh.first[k + 1]:
                p, s = before_end(panels.off[k, 0], k, panels.mesh)
                sides = [float((interpolation(np.array([s])) @ panels.r[p])[0])]
            p, s = after_start(panels.off[k, 1], k + 1, panels.mesh)
            row = interpolation(np.array([s]))[0]
            sides.append(float(row @ panels.r[p]))
            with np.errstate(over="ignore"):  # of such a K the status tells
                K = sides[1] * np.exp(row @ self.S[p] + self.c[k + 1])
            (q0, f0), (q1, f1) = (law_q_f(r, self.table) for r in sides)
            if q1 > q0:
                speed = float(K * (f1 - f0) / (q1 - q0))
                records.append(KinkRecord(self.now.t, panels.number[k], x, q0, q1, q1 - q0, speed, speed))
        return records

    def _apply(self, event: Sign) -> None:
        """The panels after an event."""
        kind, i = event
        panels, t = self.now.panels, self.now.t
        if kind == "birth":
            self._birth(i)
            return
        if kind == "merge":
            a, b = panels.number[i - 1], panels.number[i]
            self.events.append(Event(t, "merge", max(a, b), min(a, b), place(panels, i)))
            panels = merged(panels, i)
        elif kind == "exit":
            self.events.append(Event(t, "exit", panels.number[i], None, 0.0))
            panels = exited(panels)
        else:
            panels = passed(panels, kind, i)
            if np.any(np.diff(panels.mesh.first)[1:] == 0):  # only the first segment may be empty: q = 0
                raise Lost("the labels between two kinks run out")
        self.now = replace(self.now, panels=panels)

    def _birth(self, p: int) -> None:
        """A shock where X first folds: a joint of segments there, and how its labels will part."""
        panels, t = self.now.panels, self.now.t
        values, places = folds(panels)
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
            cut = p + at_right  # the panel that will begin the new segment
        else:
            panels, cut = with_joint_at(panels, p, s)
            mesh = panels.mesh
        x = float(mesh.base[cut - 1] + panels.X[cut - 1, -1] if cut > 0 else mesh.base[cut] + panels.X[cut, 0])
        self.now = replace(self.now, panels=panels)
        self._room()
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
            raise Lost(f"a kink would be born at x = {x:.6g} in no ordinary way")
        if at_left or at_right:  # X = -a τ δ + bend δ²/2 on the side that folds, X_ξ = far on the other (theory, §5)
            near = [1.5 * a / bend, 1.0], [0.375 * a * a / (bend * far), 2.0]
            sides = near[::-1] if at_left else near
        else:  # X = -a τ δ + bend δ³
            sides = ([np.sqrt(a / bend), 0.5],) * 2
        self.count += 1
        tau = 1e-14 * self.end  # labels so near are at the joint itself
        self.now = _Stretch(parted(panels, cut, t, tau, sides, self.count), t, t)
        self.h = min(self.h, float(np.sqrt(0.01 * self.end)))
        self.events.append(Event(t, "birth", self.count, None, x))

    def _first_event(self, crossed: list, h: float, panels: Panels) -> tuple[float, Panels, Sign, float]:
        """The step up to the first of these events, the panels there, the event, and the error of the step."""
        start = signs(self.now.panels, self.threshold, crossed)
        # an event that noise has begun before the step is shifted by that much
        shift = {e: min(start[e], 0.0) - (1e-300 if start[e] <= 0.0 else 0.0) for e in crossed}
        end = signs(panels, self.threshold, crossed)
        if any(start[e] <= 0.0 and e[0] != "birth" for e in crossed):
            event = next(e for e in crossed if start[e] <= 0.0 and e[0] != "birth")
            return 0.0, self.now.panels, event, 0.0

        from scipy.optimize import brentq

        def least(part: float) -> float:
            tried, error = self._try(part * h)
            if not np.isfinite(error):
                raise Lost(self._why())
            now = signs(tried, self.threshold, crossed)
            return min(now[e] - shift[e] for e in crossed)

        if min(end[e] - shift[e] for e in crossed) < 0.0:
            part = brentq(
                lambda a: least(a) if a else min(start[e] - shift[e] for e in crossed), 0.0, 1.0, xtol=1e-15, rtol=1e-14
            )
        else:
            part = 1.0
        panels, error = self._try(part * h)
        found = signs(panels, self.threshold, crossed)
        return part * h, panels, min(crossed, key=lambda e: abs(found[e] - shift[e])), error


@also_on_the_whole_line
def solve_characteristics(
    problem: Problem,
    grid: Grid | None = None,
    tolerance: float | None = None,
    progress: Callable[[float], None] | None = None,
    patience: float = np.inf,
) -> Run:
    """Solve by shock-fitted characteristics, with steps and panels to `tolerance`, and read the result on a grid.

    The method is in theory, §5; the tolerance is 1e-12 by default. A second run with a coarser tolerance gives
    `error_estimate`, the error of u over the whole run. The grid is by default 2000 cells over the profile. `patience`
    is the largest work in counted seconds, the same on every machine. If the method cannot go on, `status` gives time,
    position and reason, and the last saved time is the last good one. Raises InputError for bad input or a flux at the
    left end, RunError if the data cannot be cut.
    """
    asked, tolerance = tolerance, TOLERANCE if tolerance is None else as_number(tolerance)
    if not FINEST <= tolerance <= COARSEST:
        raise InputError(f"tolerance = {shown(asked)} must lie between {FINEST:g} and {COARSEST:g}")
    if problem.profile.inflow:
        raise InputError("characteristics need q = 0 at the left end; this profile has a flux that enters there")
    grid = problem.grid() if grid is None else grid
    problem.check(grid, "characteristics")
    steps = float(np.clip(tolerance / Units.of(problem.law).length, FINEST, STEPS))
    run = _two_runs(problem, grid, steps, progress, patience)
    return replace(run, case=resolved_case(problem, grid, "characteristics", tolerance=asked))


@in_units_of_the_law
def _two_runs(
    problem: Problem, grid: Grid, steps: float, progress: Callable[[float], None] | None, patience: float
) -> Run:
    """Return a run with a tolerance of its steps, and its error by comparison with a coarser one."""
    try:
        panels = cut_into_panels(problem, grid.left)
    except RunError as error:
        raise RunError(f"stopped at t = 0: {error}; use the method fronts") from None
    table = _table(problem, panels)
    first = _Solver(problem, panels, table, min(COARSER * steps, COARSE_STEPS), patience)
    coarse, W_coarse = _march(first, problem, grid)
    fine, W = _march(_Solver(problem, panels, table, steps, first.patience), problem, grid, progress)
    if not len(W):
        raise RunError(fine.status)
    apart = float(np.abs(W_coarse[: len(W)] - W).max()) if len(W) <= len(W_coarse) else COARSER * steps
    rounding = 10.0 * ROUNDING * (1.0 + float(np.abs(W).max()))
    return replace(
        fine,
        wall_seconds=fine.wall_seconds + coarse.wall_seconds,
        error_estimate=max(2.0 * apart, 10.0 * fine.volume_budget_error) + rounding,
    )


def _march(
    solver: _Solver, problem: Problem, grid: Grid, progress: Callable[[float], None] | None = None
) -> tuple[Run, Array]:
    """Through all saved times, or as far as the method gets; and W from the left end on, with less rounding than u."""
    start, profile = solver.now.panels, problem.profile
    ends = np.array([start.mesh.base[0] + start.X[0, 0], 0.0])
    mass = float(np.diff(profile.W(ends, problem.law))[0])
    volume = start.volume()
    # a step may add its tolerance, a panel its own, and the grid reads u to rounding
    room = BUDGET * (solver.requested + ROUNDING) * (1.0 + abs(volume) + float(np.ptp(start.mesh.I)))
    read = room + 4.0 * ROUNDING / grid.dx
    allowed = {n: (room if n == "volume_budget" else read, "the tolerance") for n in BOUNDS}
    # the least r lies a little below the least found on so many points, by less than that below the least on few
    few, many = float(start.r.min()), float((start.r @ interpolation(FINE).T).min())
    watch = SnapshotBounds(grid, mass, volume, allowed, law_q_f(max(2.0 * many - few, 0.5 * many), solver.table)[0])
    kept, rows, kinks, seconds, status = problem.times, [], list[KinkRecord](), 0.0, "done"
    for target in np.unique(np.append(kept, problem.end)).tolist():
        started = time.perf_counter()
        try:
            solver.advance(target)
        except Lost as lost:
            status = f"stopped at t = {solver.now.t:.6g}, before t = {target:.6g}: {lost}; use the method fronts"
            break
        finally:
            seconds += time.perf_counter() - started
        solver.patience -= READ
        W, K = solver.read(grid.nodes)
        panels = solver.now.panels
        watch.observe(target, W, panels.volume(), *panels.totals.tolist())
        found = solver.kinks() if target < problem.end else solver.finish()
        if target in kept:
            rows.append((W, K))
            kinks += found
        if progress:
            progress(target / problem.end if problem.end else 1.0)
    W, K = (np.array([row[i] for row in rows]).reshape(-1, grid.cells + 1) for i in (0, 1))
    run = Run(
        title=problem.title,
        method="characteristics",
        case=resolved_case(problem, grid, "characteristics"),
        time=kept[: len(W)],
        x=grid.nodes,
        x_cell=grid.centres,
        u=grid.nodes + W + float(profile.W(grid.nodes[:1], problem.law)[0]),
        q=np.diff(W, axis=1) / grid.dx,
        K=K,
        status=status,
        steps=solver.steps,
        wall_seconds=seconds,
        kinks=kinks,
        events=in_order(solver.events, solver.moment),
        bounds=watch.bounds,
        eroded_volume=watch.eroded_volume,
        outflow=float(solver.now.panels.totals[1]),
        volume_budget_error=watch.budget_error,
        units=profile.units,
        account=profile.account,
    )
    return run, W


@np.errstate(over="ignore")  # R is 0 where f overflows, far from the r that is looked for
def _table(problem: Problem, panels: Panels) -> LawTable:
    """The law over all that r may become: dead labels go beyond what is alive."""
    from scipy.optimize import brentq

    most = float(panels.r.max() + np.ptp(panels.mesh.I))
    low, high = (
        np.expm1(brentq(lambda v, r: float(problem.law.R(np.expm1(v))) - r, -30.0, 60.0, args=(r,)))
        for r in (float(panels.r.min()), most)
    )
    return law_table(problem.law, 0.5 * (1.0 + min(low, 0.0)) - 1.0, 2.0 * high + 1.0)
