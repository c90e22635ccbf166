"""A-priori facts and budgets that every run must respect (theory, §1 and §3), watched from outside."""

from __future__ import annotations

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.run import State, Verdict

ROUNDING = 1e-10  # relative; some 1e5 steps add up errors of 1e-16 each, at worst all in one direction


class BoundsMonitor:
    """Records the worst margin of each bound with its time.

    mass_budget: ∫q changes by inflow - outflow.
    volume_budget: the eroded volume is ∫(K(left) - 1) dt (§6g): to rounding where the flux telescopes, else within
        dx ∫∫ (K f² + max(K f') |q_x|) dx dt, the first-order difference between Σ F dx and K(left) - 1.
    top_factor: K(0) = 1.
    minimum_principle: q >= min(inf q(0), 0).
    l1_decay: ‖q‖₁ does not increase (where nothing flows in).
    """

    def __init__(self, law: ErosionLaw, grid: Grid, inflow: float, telescoping: bool):
        self.law, self.grid, self.inflow, self.telescoping = law, grid, inflow, telescoping
        self.bounds: dict[str, Verdict] = {}
        self.first: State | None = None
        self.eroded_volume = 0.0
        self.budget_allowance = 0.0

    def observe(self, state: State) -> None:
        q, dx = state.q, self.grid.dx
        mass, norm, least = dx * float(np.sum(q)), dx * float(np.sum(np.abs(q))), float(np.min(q))
        f = self.law.f(q)
        allowance_rate = dx * (dx * float(state.K[1:] @ (f * f)) + state.speed * float(np.sum(np.abs(np.diff(q)))))
        if self.first is None:
            self.first = state
            self.mass, self.norm, self.floor, self.scale = mass, norm, min(least, 0.0), norm + ROUNDING
        else:
            self.budget_allowance += 0.5 * (state.t - self.t) * (self.allowance_rate + allowance_rate)
        self.t, self.allowance_rate = state.t, allowance_rate

        rounding = ROUNDING * (self.scale + state.outflow + self.inflow * state.t)
        self._record("mass_budget", rounding, mass - self.mass + state.outflow - self.inflow * state.t, state.t, "rounding")
        self.eroded_volume = self.first.volume - state.volume
        allowed = ROUNDING * (1.0 + abs(state.growth) + state.t + abs(self.first.volume))
        if not self.telescoping:
            allowed += self.budget_allowance
        kind = "rounding" if self.telescoping else "first order in dx"
        self._record("volume_budget", allowed, self.eroded_volume - state.growth, state.t, kind)
        self._record("top_factor", ROUNDING, float(state.K[-1]) - 1.0, state.t, "rounding")
        self._record("minimum_principle", ROUNDING, min(least - self.floor, 0.0), state.t, "rounding")
        if self.inflow == 0.0:
            self._record("l1_decay", ROUNDING * self.scale, max(norm - self.norm, 0.0), state.t, "rounding")
            self.norm = min(norm, self.norm)

    def _record(self, name: str, allowed: float, excess: float, t: float, allowance: str) -> None:
        margin = allowed - abs(excess)
        if name not in self.bounds or margin < self.bounds[name].worst_margin:
            self.bounds[name] = Verdict(margin >= 0.0, margin, t, allowance)
