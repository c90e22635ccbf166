"""A-priori facts and budgets that every run must respect (theory, §1 and §3), watched from outside."""

from __future__ import annotations

from collections.abc import Mapping

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

    A monotone scheme keeps the last two to rounding, a limited second-order one within dx TV(q).
    """

    def __init__(self, law: ErosionLaw, grid: Grid, inflow: float, monotone: bool, telescoping: bool):
        self.law, self.grid, self.inflow = law, grid, inflow
        self.monotone, self.telescoping = monotone, telescoping
        self.bounds: dict[str, Verdict] = {}
        self.first: State | None = None
        self.eroded_volume = self.outflow = 0.0
        self.budget_error = 0.0  # worst so far
        self.budget_allowance = 0.0
        self.t = self.allowance_rate = 0.0

    def observe(self, state: State) -> None:
        q, dx, t = state.q, self.grid.dx, state.t
        mass, norm, least = dx * float(np.sum(q)), dx * float(np.sum(np.abs(q))), float(np.min(q))
        rises = np.diff(q)
        variation = float(np.sum(np.abs(rises, out=rises)))
        del rises  # runs of a million cells should not need many more arrays than they solve for
        f = self.law.f(q)
        allowance_rate = dx * (dx * float(state.K[1:] @ np.multiply(f, f, out=f)) + state.speed * variation)
        if self.first is None:
            self.first = state
            self.mass, self.norm, self.floor, self.scale = mass, norm, min(least, 0.0), norm + 1.0
        else:
            self.budget_allowance += 0.5 * (t - self.t) * (self.allowance_rate + allowance_rate)
        self.t, self.allowance_rate = t, allowance_rate

        rounding = ROUNDING * (self.scale + state.outflow + self.inflow * t)
        smear = 0.0 if self.monotone else dx * variation
        scheme = "rounding" if self.monotone else "first order in dx"

        record(self.bounds, "mass_budget", rounding, mass - self.mass + state.outflow - self.inflow * t, t, "rounding")
        self.eroded_volume, self.outflow = self.first.volume - state.volume, state.outflow
        off = abs(self.eroded_volume - state.growth)
        self.budget_error = max(self.budget_error, off)
        small = ROUNDING * (1.0 + abs(state.growth) + t + abs(self.first.volume))
        if self.telescoping:
            record(self.bounds, "volume_budget", small, off, t, "rounding")
        else:
            record(self.bounds, "volume_budget", small + self.budget_allowance, off, t, "first order in dx")
        record(self.bounds, "top_factor", ROUNDING, float(state.K[-1]) - 1.0, t, "rounding")
        record(self.bounds, "minimum_principle", ROUNDING + smear, max(self.floor - least, 0.0), t, scheme)
        if self.inflow == 0.0:
            record(self.bounds, "l1_decay", rounding + smear, max(norm - self.norm, 0.0), t, scheme)
            self.norm = min(norm, self.norm)


class SnapshotBounds:
    """Bounds and budgets of a method that knows its own volume, judged at the saved times.

    `allowed` holds an allowance for each bound, and what it is; allowances grow with time as 1 + t. `least` is inf q of
    the data, if it is below the least mean of a cell.
    """

    def __init__(
        self, grid: Grid, mass: float, volume: float, allowed: Mapping[str, tuple[float, str]], least: float = np.inf
    ):
        self.grid, self.mass, self.first, self.allowed, self.least = grid, mass, volume, allowed, least
        self.bounds: dict[str, Verdict] = {}
        self.norm, self.floor, self.cancelled = np.inf, 0.0, 0.0
        self.eroded_volume = self.budget_error = 0.0

    def observe(self, t: float, W: np.ndarray, volume: float, growth: float, outflow: float) -> None:
        mass = np.diff(W)
        norm, least = float(np.abs(mass).sum()), float(mass.min() / self.grid.dx)
        # in a cell where q changes its sign the parts of its mass cancel
        turns = mass[:-1] * mass[1:] < 0.0
        self.cancelled = max(self.cancelled, 2.0 * float((np.abs(mass[:-1]) + np.abs(mass[1:]))[turns].sum()))
        if np.isinf(self.norm):
            self.norm, self.floor = norm, min(least, self.least, 0.0)
        self.eroded_volume = self.first - volume
        off = abs(self.eroded_volume - growth)
        self.budget_error = max(self.budget_error, off)
        for name, excess in (
            ("mass_budget", float(W[-1]) - self.mass + outflow),
            ("volume_budget", off),
            ("minimum_principle", max(self.floor - least, 0.0)),
            ("l1_decay", max(norm - self.norm - self.cancelled, 0.0)),
        ):
            allowed, allowance = self.allowed[name]
            record(self.bounds, name, allowed * (1.0 + t), excess, t, allowance)
        self.norm = min(self.norm, norm)


def record(bounds: dict[str, Verdict], name: str, allowed: float, excess: float, t: float, allowance: str) -> None:
    """Keeps the verdict with the worst margin."""
    margin = 1.0 - abs(float(excess)) / allowed
    if name not in bounds or margin < bounds[name].worst_margin:
        bounds[name] = Verdict(margin >= 0.0, margin, float(t), allowance)
