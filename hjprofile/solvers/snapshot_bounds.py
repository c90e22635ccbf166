"""Bounds and budgets at the saved times, for methods with an exact volume."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.grid import Grid
from hjprofile.solvers.norms import invariant_variation
from hjprofile.solvers.run import Array, Verdict

UNIFORM_TV_TIMES = 9  # number of saved times at which TV(I) is evaluated: it costs R(q) of all cells
BOUNDS = ("mass_budget", "volume_budget", "minimum_principle", "l1_decay")


class SnapshotBounds:
    """The budgets, the minimum principle and the L1 decay of `BoundsMonitor`.

    `allowed` holds an allowance for each bound, and its reason; allowances grow with time as 1 + t. `least` is inf q of
    the data, if it is below the smallest mean of a cell. `variation_I` is TV(I) of the fronts or labels, 0 for
    an exact solution; without it the variation of I is not judged.
    """

    def __init__(
        self, grid: Grid, mass: float, volume: float, allowed: Mapping[str, tuple[float, str]], least: float = np.inf,
        variation_I: float | None = None,
    ):  # fmt: skip
        self.variation_I = variation_I
        self.grid, self.mass, self.first, self.allowed, self.least = grid, mass, volume, allowed, least
        self.bounds: dict[str, Verdict] = {}
        self.norm, self.floor, self.cancelled = np.inf, 0.0, 0.0
        self.eroded_volume = self.toe_outflow = self.budget_error = 0.0

    def observe(self, t: float, W: np.ndarray, volume: float, toe_gain: float, crest_lowering: float) -> None:
        mass = np.diff(W)
        norm, least = float(np.abs(mass).sum()), float(mass.min() / self.grid.dx)
        # in a cell where q changes its sign the parts of its mass cancel
        turns = mass[:-1] * mass[1:] < 0.0
        self.cancelled = max(self.cancelled, 2.0 * float((np.abs(mass[:-1]) + np.abs(mass[1:]))[turns].sum()))
        if np.isinf(self.norm):
            self.norm, self.floor = norm, min(least, self.least, 0.0)
        self.eroded_volume, self.toe_outflow = self.first - volume, t + toe_gain
        off = abs(self.eroded_volume - toe_gain)
        self.budget_error = max(self.budget_error, off)
        for name, excess in (
            ("mass_budget", float(W[-1]) - self.mass + crest_lowering),
            ("volume_budget", off),
            ("minimum_principle", max(self.floor - least, 0.0)),
            ("l1_decay", max(norm - self.norm - self.cancelled, 0.0)),
        ):
            allowed, allowance = self.allowed[name]
            margin = 1.0 - abs(excess) / (allowed * (1.0 + t))
            if name not in self.bounds or margin < self.bounds[name].worst_margin:
                x = float(self.grid.centres[np.argmin(mass)]) if name == "minimum_principle" else np.nan
                self.bounds[name] = Verdict(margin >= 0.0, margin, float(t), x, allowance)
        self.norm = min(self.norm, norm)


def uniform_tv(law: ErosionLaw, grid: Grid, times: Array, W: Array, data: float = 0.0) -> Verdict:
    """Return the verdict on TV(I(t)) <= TV(I(0)) (§4) from W at the nodes, shape (times, cells + 1).

    TV(I(0)) is the larger of that of the first state and of `data`, TV(I) of the fronts or labels: cells average
    features that are smaller than a cell, and fronts cut off the extremes of I. TV(I) is read to Δx TV(q), because a
    cell that contains a kink has a mean of q.
    """
    shown = np.unique(np.linspace(0, times.size - 1, min(times.size, UNIFORM_TV_TIMES)).round().astype(int))
    q = np.diff(W[shown], axis=1) / grid.dx
    variation = invariant_variation(law.R(q), W[shown], float(law.R(0.0)))
    read = grid.dx * (np.abs(np.diff(q, axis=1)).sum(axis=1) + np.abs(q[:, 0]))
    first = max(float(variation[0]), data)
    rounding = 1e-10 * (1.0 + first)  # of W, divided by dx and summed over cells
    margins = 1.0 - np.maximum(variation - first, 0.0) / (read + read[0] + rounding)
    worst = int(np.argmin(margins))
    margin = float(margins[worst])
    return Verdict(margin >= 0.0, margin, float(times[shown[worst]]), np.nan, "first order in dx")
