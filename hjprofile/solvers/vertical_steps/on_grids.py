"""Laws of linear growth on grids: a scheme in which vertical steps form, and their detection (§16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.grid import Grid
from hjprofile.problem.profiles import Kinks
from hjprofile.solvers.grids.conservation import FirstOrder
from hjprofile.solvers.grids.flux import Flux
from hjprofile.solvers.grids.grid_law import GridLaw
from hjprofile.solvers.grids.scheme import Scheme
from hjprofile.solvers.run import Array, Monitor, Run, in_order
from hjprofile.solvers.vertical_steps.kernels import telescoping
from hjprofile.solvers.vertical_steps.step_fronts import step_law
from hjprofile.solvers.vertical_steps.step_monitor import StepMonitor, with_dates


class StepsOnGrid:
    """The monitor of vertical steps of a run on a grid, as an extension of the run."""

    def __init__(self, problem: Problem, grid: Grid, scheme: Scheme):
        self.problem, self.grid = problem, grid
        self.table = step_law(problem.law, 0.5 * (float(np.min(np.diff(scheme.W))) / grid.dx - 1.0))
        self.steps = StepMonitor(self.table, grid, problem.times, problem.law.f)
        self.monitors: Mapping[str, Monitor] = {"steps": self.steps}
        self.hidden = self.steps.hidden

    def complete(self, run: Run) -> Run:
        """Return the run with its vertical steps, numbered after all kinks: a grid cannot identify their kinks."""
        taken = max([k.kink for k in run.kinks] + [e.kink for e in run.events], default=0)
        vertical_steps, more = self.steps.result(taken)
        exact = isinstance(self.problem.profile, Kinks)
        events, doubts = with_dates(in_order([*run.events, *more]), self.grid, self.table, exact)
        return replace(run, vertical_steps=vertical_steps, events=events, cautions=(*run.cautions, *doubts))


class SecondOrderTelescoping(FirstOrder):
    """F̂_i = (K_{i-1/2} - K_{i+1/2})/Δx with K in the middle of cells, for laws of linear growth; Heun's method.

    For any such K a vertical step moves with (K⁻ - K⁺)/m; q >= 0 and q <= 0 are preserved if cfl <= 1 (§16).
    """

    def __init__(self, law: GridLaw, grid: Grid, q: Array, W_left: float, inflow: float, flux: Flux):
        super().__init__(law, grid, q, W_left, inflow, flux)
        self.cfl_limit = 0.5
        self.steep = float(telescoping.steepest_slope(grid.dx, step_law(law.law)))
        self.work = np.empty((4, grid.cells))

    def advance(self, dt: float, steps: int, bound: float) -> float:
        self.save()
        f, df, *dq = self.work
        fastest = 0.0
        for _ in range(steps):
            q = self.q
            for stage in range(2):
                if not np.min(q) > -1.0:
                    return np.inf
                speed, K_left, F_top = telescoping.rates(
                    q, self.law.kernel, self.grid.dx, self.inflow, self.law.law.eta0, self.steep, f, df, dq[stage]
                )
                fastest = max(fastest, speed)
                q = self.q + dt * dq[0]
                self.toe_gain += 0.5 * dt * (K_left - 1.0)
                self.crest_lowering += 0.5 * dt * F_top
            self.q = 0.5 * (self.q + (q + dt * dq[1]))
            self.W_left -= dt * self.inflow
        return fastest

    def volume(self) -> float:
        return self.grid.integral(self.W)
