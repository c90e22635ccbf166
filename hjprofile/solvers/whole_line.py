"""Solution on the whole line by the half line: a window x <= right with a transformed time (§10).

Right of the window I = W + R(q) is constant. There K/R(q) is constant too, hence K(t, right) = R(q)/R(0). q at x =
right decays at constant I and moves with the speed 1/R(0). So K at the end of the window is known before the run, and
in the time τ with dτ = K(t, right) dt the solution in the window is that of the half line that ends there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, wraps
from typing import Any, ParamSpec

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.case import resolved_case
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.line import moved, tail
from hjprofile.problem.model import WholeLine
from hjprofile.problem.profiles import TAIL
from hjprofile.problem.ranges import instance
from hjprofile.solvers.run import Array, Run
from hjprofile.solvers.stop import Place, Reason, Stop, Stopped, Time

P = ParamSpec("P")
TOLERANCE = 1e-13  # relative tolerance of the transformation of time
GRID_ALLOWANCE = 10.0  # allowance for W at the end of the window on a grid, in cells times q there


@lru_cache(maxsize=8)  # runs that differ in their cells or method have the same tail
def _follow_tail(law: ErosionLaw, q0: float, end: float, most: float) -> tuple[float, Callable | None]:
    """Return the time for which R at the window's end stays below `most`, and ln q there and τ over that time.

    q there is q0 at the time 0.
    """
    if not q0 or not end:
        return end, None
    from scipy.integrate import solve_ivp

    R0 = float(law.R(0.0))

    def rates(t: float, state: Array) -> list[float]:
        q = np.exp(state[0])
        return [1.0 / (R0 * float(law.R_derivative(q))), float(law.R(q)) / R0]

    def steepest(t: float, state: Array) -> float:
        return most - float(law.R(np.exp(state[0])))

    steepest.terminal = True  # type: ignore[attr-defined]
    tail = solve_ivp(
        rates, (0.0, end), [np.log(q0), 0.0], method="DOP853", rtol=TOLERANCE, atol=TOLERANCE,
        events=steepest, dense_output=True, max_step=0.1,
    )  # fmt: skip
    return float(tail.t[-1]), tail.sol


class Window:
    """A problem on the whole line and its grid; `problem` and `half_grid` are the same on the half line.

    Attributes:
        last: the time at which q at the end of the window would reach its largest possible value at a kink; the kink
            leaves the window no later.
        outer_times: τ -> t of the saved times.
    """

    def __init__(self, problem: Problem, grid: Grid):
        instance("grid", grid, Grid)
        problem.check_line(grid)
        problem.check_profile(grid)
        self.whole, self.grid, self.law, profile = problem, grid, problem.law, problem.profile
        self.R0 = float(self.law.R(0.0))
        self.q = tail(profile, grid.right, self.law)
        W = profile.W(np.array([grid.left, grid.right]), self.law)
        self.I = float(W[1] + self.law.R(self.q))
        self.last, self._solution = _follow_tail(self.law, self.q, problem.end, self.I - float(W[0]))
        outer_times = problem.times[problem.times <= self.last]
        if not outer_times.size:
            raise Stopped(self._left("before the first saved time, t = {t:.6g}, ", problem.times[0]))
        inner = self.time(np.append(outer_times, self.last))
        self.outer_times = dict(zip(inner.tolist(), outer_times.tolist(), strict=False))
        self.problem = replace(
            problem,
            line="half",
            profile=moved(profile, -grid.right),
            end=float(inner[-1]),
            snapshots=list(self.outer_times),
        )
        self.half_grid = replace(grid, left=grid.left - grid.right, right=0.0)

    def slope(self, t: Array) -> Array:
        """Return q at the end of the window."""
        return np.exp(self._solution(t)[0]) if self._solution else np.full_like(t, self.q)

    def time(self, t: Array) -> Array:
        """Return τ, the time of the half line; 0 at 0, increasing."""
        return np.where(t > 0.0, self._solution(t)[1], 0.0) if self._solution else t.copy()

    def outer_time(self, tau: float) -> float:
        """Return t at τ."""
        if tau in self.outer_times or not self._solution:
            return self.outer_times.get(tau, tau)
        if not tau < self.problem.end:
            return self.last
        from scipy.optimize import brentq

        return brentq(lambda t: float(self.time(np.array(t))) - tau, 0.0, self.last, xtol=1e-15) if tau > 0.0 else 0.0

    def K_at_right(self, t: Array) -> Array:
        """Return K(t, right) = dτ/dt."""
        return self.law.R(self.slope(t)) / self.R0

    def _left(self, words: str, t: float) -> Stop:
        """Return the reason to stop after a kink has left the window."""
        return Stop(
            Reason.LEFT_THE_WINDOW,
            words + "q left the window at x = {x:g}",
            "increase right",
            {"t": Time(t), "x": Place(self.grid.right)},
        )

    def place(self, x: float) -> float:
        """Return the position on the whole line of a position on the half line."""
        return x + self.grid.right

    def run_on_line(self, run: Run) -> Run:
        """Return the run of `problem` on `half_grid` as one of the whole line, until a kink leaves the window."""
        time = np.array([self.outer_time(t) for t in run.time.tolist()])
        right, K = self.grid.right, self.K_at_right(time)
        exits = [self.outer_time(e.time) for e in run.events if e.event == "exit"]
        W, expected = run.u[:, -1] - run.x[-1], self.I - self.law.R(self.slope(time))
        wrong = TAIL * (1.0 + np.abs(self.I))
        if run.stepped:
            wrong += GRID_ALLOWANCE * self.grid.dx * self.slope(time)
        left = np.append(time[np.abs(W - expected) > wrong], exits)
        good = time < left.min() if left.size else time == time
        stop, until = run.stop and run.stop.mapped(self.outer_time, self.place), np.inf
        gone = not good.all() or exits or (run.done and self.last < self.whole.end)
        if gone:
            stop = self._left("stopped at t = {t:.6g}: ", min([*exits, *time[~good], self.last]))
        if not good.any():
            assert stop is not None
            raise Stopped(stop)
        pace = dict(zip(run.time.tolist(), K.tolist(), strict=True))
        case = resolved_case(self.whole, self.grid, run.method)
        if gone:  # the integrals of the run extend beyond the last saved time
            until = float(time[good][-1])
            lowered = run.u[good][0] - run.u[good][-1]
            run = replace(run, eroded_volume=self.grid.integral(lowered), toe_outflow=np.nan, crest_lowering=np.nan)
        return replace(
            run,
            case={**run.case, **{name: case[name] for name in ("profile", "domain", "time")}},
            time=time[good],
            x=self.grid.nodes,
            x_cell=self.grid.centres,
            u=run.u[good] + right,
            q=run.q[good],
            K=run.K[good] * K[good, None],
            stop=stop,
            kinks=[
                k._replace(
                    time=self.outer_time(k.time), x=k.x + right, speed=k.speed * pace[k.time],
                    rankine_hugoniot_speed=k.rankine_hugoniot_speed * pace[k.time],
                )
                for k in run.kinks if self.outer_time(k.time) <= until
            ],
            events=[
                e._replace(time=self.outer_time(e.time), x=e.x + right)
                for e in run.events if self.outer_time(e.time) <= until
            ],
            bounds={name: b._replace(time=self.outer_time(b.time), x=b.x + right) for name, b in run.bounds.items()},
        )  # fmt: skip


def _with_caution(run: Run, problem: Problem) -> Run:
    """Return the run with the caution of its problem on its domain, once, after any number of solvers."""
    caution = problem.caution(float(run.x[0]))
    return replace(run, cautions=(*run.cautions, caution)) if caution and caution not in run.cautions else run


def also_on_the_whole_line(solver: Callable[P, Run]) -> Callable[P, Run]:
    """Return a solver of problems on the half line that also solves on windows of the whole line."""

    run_half: Callable[..., Run] = solver

    def solve(problem: Problem, grid: Grid | None = None, *args: Any, **kwargs: Any) -> Run:
        instance("problem", problem, Problem)
        if not isinstance(problem.model, WholeLine):
            return _with_caution(run_half(problem, grid, *args, **kwargs), problem)
        window = Window(problem, problem.grid() if grid is None else grid)
        try:
            run = run_half(window.problem, window.half_grid, *args, **kwargs)
        except Stopped as error:
            raise error.mapped(window.outer_time, window.place) from None
        return _with_caution(window.run_on_line(run), problem)

    return wraps(solver)(solve)  # type: ignore[return-value]
