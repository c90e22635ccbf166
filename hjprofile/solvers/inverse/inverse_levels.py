"""Solution of x_t = K g(x_u) at evenly spaced heights u, and its run (§19).

x(t, u) is the inverse function of the profile, K the grain flux, and g(z) = z f(1/z - 1). A time step is one of
backward Euler with the K of its beginning. Under a law of linear growth the L2 projection onto the non-decreasing
functions follows: where x is constant, u jumps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.problem.ranges import whole
from hjprofile.solvers.data_resolution import compare_data, fine_sample
from hjprofile.solvers.inverse.kernels import level_steps as kernels
from hjprofile.solvers.inverse.kernels.level_steps import LevelLaw, Levels
from hjprofile.solvers.inverse.level_features import Features
from hjprofile.solvers.kernels.journal import CREST_LOWERING, TOE_GAIN
from hjprofile.solvers.run import Array, Event, KinkRecord, Run, VerticalStep
from hjprofile.solvers.snapshot_bounds import BOUNDS, SnapshotBounds
from hjprofile.solvers.snapshots import Lost, Solution, assembled, walk
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Stopped, Time
from hjprofile.solvers.units_of_the_law import in_units_of_the_law

FEWEST_LEVELS, MOST_LEVELS = 4, 100_000  # the time of a run grows with the square of their number
JOINTS = 0.01  # distance of the joints of g in ln(1 + q): cubics leave 1e-10 of g
STEEPEST = 25.0  # ln(1 + q) at the end of the table of g: beyond, rounding of g exceeds its changes
BELOW = 0.5  # ln(1 + q) by which the table begins below the data
WATCHED = 4  # time steps from one observation of kinks to the next: none crosses more than some 8 cells
MOST_STEPS = 1_000_000  # largest number of time steps of a run
SHORTEST = 1e-12  # smallest time step, as a fraction of the time: shorter ones are not resolved
SPARE = 64  # levels above the highest crest that is possible
ROUGH = 8.0  # factor of the first-order allowance; measured: at most 4.1 on 200 random problems, K up to 1e12
ROUNDING = 1e-9  # relative allowance of bounds that the scheme satisfies exactly


def level_law(law: ErosionLaw, z_most: float) -> LevelLaw:
    """Return g of a law for the inverse slopes from 0 to `z_most`."""
    below, above = (int(np.ceil(v / JOINTS)) for v in (np.log(max(z_most, 1.0)) + BELOW, STEEPEST))
    v = JOINTS * np.arange(-below, above + 1)
    q, z = np.expm1(v), np.exp(-v)
    with np.errstate(all="ignore"):
        g = z * np.array(law.f(q), dtype=float)
        dg = law.derivative(q) - g
    g[below] = 0.0  # the neutral slope must not change
    top, z_top = int(np.argmax(dg < 0.0)), 0.0  # g is concave: as a function of v it increases, then decreases
    if dg[top] < 0.0 and top:
        z_top = float(np.exp(-(v[top] - JOINTS * dg[top] / (dg[top] - dg[top - 1]))))
    found = LevelLaw(g, dg, below, JOINTS, z_top, 0.0, law.eta0)
    return found._replace(g_top=float(kernels.g_and_slope(z_top, found)[0]))


class InverseSolution(Solution):
    """x(t, u) at levels u.

    Attributes:
        u: the heights of the levels, those above the crest included.
        n: the first level beyond the crest.
        law: g.
        scale: max |q| of the data, at most 1: the graph of u moves by a fraction of Δu in proportion.
    """

    def __init__(self, problem: Problem, grid: Grid, levels: int):
        profile, law = problem.profile, problem.law
        self.left, self.t, self.steps, self.moment = grid.left, 0.0, 0, 0.0
        self.sample = fine_sample(problem, grid.left)
        W = self.sample.W
        low, crest = grid.left + W[0], float(W[-1])
        self.spacing = float(crest - low) / levels
        most = levels + int(np.ceil((np.max(W) - crest) / self.spacing)) + SPARE
        self.u = low + self.spacing * np.arange(most)
        self.levels = Levels(*np.zeros((12, most)))
        self.n = levels + 1
        x = self.levels.x
        x[:levels] = _positions(problem, self.sample.x, self.u[:levels])
        x[0] = grid.left
        x[levels] = 0.0
        x[levels + 1] = -x[levels - 1]
        z = np.diff(x[: self.n + 1]) / self.spacing
        self.law = level_law(law, float(z.max()))
        self.scale = min(float(np.max(np.abs(1.0 / z - 1.0))), 1.0) or 1.0
        self.features = Features(law, replace(grid, cells=levels), profile.rounding)
        self.totals: list[float] = [0.0, 0.0]
        self.step_range = np.nan, np.nan
        self.events: list[Event] = []
        kernels.cells(self.levels, 0, self.n, self.spacing, self.law)
        self._observe()

    def _observe(self) -> None:
        """Record the kinks and vertical steps, and the lowering of the crest."""
        part = kernels.fill_ln_K(self.levels, self.n, self.spacing)
        self.crest = float(self.u[self.n - 1] + part * self.spacing)
        if not self.features.tracker.frames:
            self.first_crest = self.crest
        self.totals[CREST_LOWERING] = self.first_crest - self.crest
        now = slice(0, self.n + 1)
        self.features.observe(self.t, self.levels.x[now], self.u[now], self.levels.ln_K[now])

    def advance(self, target: float) -> None:
        """Move to the time `target`."""
        if target <= self.t:
            return
        while self.t < target:
            n, dt, iterations = kernels.advance(
                self.levels, self.n, self.spacing, target - self.t, self.scale, self.law
            )
            if iterations < 0 or dt < SHORTEST * target or self.steps >= MOST_STEPS:
                raise Lost(self._lost())
            self.n = n
            kernels.fill_ln_K(self.levels, n, self.spacing)
            # K at the end of a time step is nearer to the change of the volume than the mean over the time step
            self.totals[TOE_GAIN] += dt * float(np.expm1(self.levels.ln_K[0]))
            self.steps += 1
            self.step_range = float(np.fmin(self.step_range[0], dt)), float(np.fmax(self.step_range[1], dt))
            self.t = target if self.t + dt >= target * (1.0 - 1e-14) else self.t + dt
            if self.steps % WATCHED == 0 or self.t == target:
                self._observe()

    def _lost(self) -> Stop:
        """Return the reason if a time step is not possible."""
        K = np.nan_to_num(self.levels.ln_K[: self.n + 1], nan=np.inf)
        return Stop(
            Reason.TOO_SMALL_STEPS,
            "stopped at t = {t:.6g}: the time steps become too small, because K is e^{K:.3g} near x = {x:.6g}",
            f"use the method auto with a tolerance, or the method {ROBUST_METHOD}",
            {"t": Time(self.t), "K": float(K.max()), "x": Place(float(self.levels.x[int(np.argmax(K))]))},
        )

    def read(self, nodes: Array) -> tuple[Array, Array]:
        """Return W and K at the nodes, by inversion of the piecewise linear function x(u)."""
        now = slice(0, self.n + 1)
        u = np.interp(nodes, self.levels.x[now], self.u[now])
        K = np.exp(np.interp(u, self.u[now], self.levels.ln_K[now]))
        return u - nodes - (self.u[0] - self.left), K

    def volume(self) -> float:
        """Return ∫W dx."""
        x = np.append(self.levels.x[: self.n], 0.0)
        W = np.append(self.u[: self.n], self.crest) - x - (self.u[0] - self.left)
        return float(np.sum(0.5 * (W[1:] + W[:-1]) * np.diff(x)))

    def kinks(self) -> list[KinkRecord]:
        """Return no kinks: all paths are linked at the end of the run."""
        return []

    def history(self, times: Array) -> tuple[list[KinkRecord], list[VerticalStep] | None]:
        """Return the kinks and the vertical steps at the saved times, and store the events."""
        kinks, steps, self.events = self.features.result(times)
        return kinks, steps if self.law.eta0 > 0.0 else None


def _positions(problem: Problem, x: Array, u: Array) -> Array:
    """Return the positions at which the profile has the heights u, from a sample x of positions."""
    for _ in range(3):  # regula falsi with all known positions: each time the distance to them is squared
        height = np.maximum.accumulate(x + problem.profile.W(x, problem.law))
        found = np.interp(u, height, x)
        x = np.union1d(x, found)
    return found


@in_units_of_the_law
def _in_units(problem: Problem, grid: Grid, levels: int, progress: Callable[[float], None] | None) -> Run:
    """Solve in units of the law."""
    solution = InverseSolution(problem, grid, levels)
    sample = solution.sample
    W, K = solution.read(sample.x)
    with np.errstate(all="ignore"):
        caution = compare_data(problem, sample, W, np.log(K)).caution(f"{levels} levels", "more cells")
    allowed = _allowances(solution)
    watch = SnapshotBounds(grid, float(sample.W[-1] - sample.W[0]), solution.volume(), allowed)
    snapshots = walk(solution, problem, grid, watch, progress)
    if not snapshots.states:
        assert snapshots.stop is not None
        raise Stopped(snapshots.stop)
    reached = problem.times[: len(snapshots.states)]
    snapshots.kinks, snapshots.vertical_steps = solution.history(reached)
    run = assembled("inverse", solution, snapshots, watch, problem, grid)
    return replace(run, cautions=caution, step_range=solution.step_range)


def _allowances(solution: InverseSolution) -> dict[str, tuple[float, str]]:
    """Return the allowance of each bound, and the reason for it: the scheme is monotone, and K is of first order."""
    size = 1.0 + float(np.abs(np.diff(solution.sample.W)).sum())
    allowed = dict.fromkeys(BOUNDS, (ROUNDING * size, "rounding"))
    allowed["volume_budget"] = ROUGH * solution.spacing * size, "first order in the spacing of levels"
    return allowed


def solve_inverse(
    problem: Problem, grid: Grid, levels: int | None = None, progress: Callable[[float], None] | None = None
) -> Run:
    """Solve for x as a function of u; arguments as for `solve.solve_inverse`."""
    count = grid.cells if levels is None else levels
    return _in_units(problem, grid, whole("levels", count, FEWEST_LEVELS, MOST_LEVELS), progress)
