"""Front tracking on the invariant I = W + R(q), which is constant along characteristics (theory, §4 and §5).

I is piecewise constant between fronts that move at x' = K [f]/[q]. For data that are kinks only this is the exact
solution, integrated to 1e-12; smooth data and the fans of downward jumps become many small fronts, second order in
their number through the formation and the merging of shocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.profiles import Kinks
from hjprofile.solvers import kernels
from hjprofile.solvers.run import Array

PIECE = 0.05  # width in ln R of the pieces of a law's table: degree 7 leaves (PIECE/4)^8 = 6e-16


class FrontLaw(NamedTuple):
    """f as a function of ln R, in the form the kernels take; the rational law has formulas and an empty table."""

    table: Array
    start: float
    width: float


def front_law(law: ErosionLaw, q_least: float, q_most: float) -> FrontLaw:
    """Tabulates f over ln R(q) between two values of q, to rounding."""
    if law.name == "rational":
        return FrontLaw(np.empty((0, 8)), 0.0, 1.0)
    from scipy.optimize import elementwise

    v = np.log1p([q_least, q_most])
    low, high = np.log(law.R(np.expm1(v)))
    pieces = int(np.ceil((high - low) / PIECE))
    z = np.cos(np.pi * (np.arange(8) + 0.5) / 8)
    rho = low + PIECE * (np.arange(pieces)[:, None] + 0.5 * (z + 1.0))
    bracket = np.full_like(rho, v[0] - 0.5), np.full_like(rho, v[1] + 2.0)
    found = elementwise.find_root(lambda v, rho: np.log(law.R(np.expm1(v))) - rho, bracket, args=(rho,))
    f = law.f(np.expm1(found.x))
    coefficients = np.linalg.solve(np.vander(z, 8, increasing=True), f.T).T
    return FrontLaw(np.ascontiguousarray(coefficients), float(low), PIECE)


@dataclass
class Fronts:
    """Fronts and the pieces between them.

    Attributes:
        x, jump: places and jumps of I, from left to right; x may repeat where a fan opens.
        label: the number of the kink that a front is, or 0.
        smooth: whether the piece right of a front stands for a stretch in which I varies.
        spacing: distance of the fronts of smooth data.
        r0: R(0), r on the far left.
        top: W at x = 0.
    """

    x: Array
    jump: Array
    label: Array
    smooth: Array
    spacing: float
    r0: float
    top: float

    @property
    def kinks_only(self) -> bool:
        """Whether the fronts are the data themselves, not an approximation."""
        return not self.smooth.any()


def cut_into_fronts(problem: Problem, left: float, fronts: int) -> tuple[Fronts, FrontLaw]:
    """Piecewise constant I whose W is exact at the ends of the pieces; downward jumps become fans of small fronts."""
    law, profile = problem.law, problem.profile
    breaks = profile.breaks(law)
    start = profile.start(tail=1e-14)
    start = left if not np.isfinite(start) else max(start, left)
    spacing = -start / fronts
    if isinstance(profile, Kinks):
        cuts = breaks[:, 0]
    else:
        marks = np.unique(np.concatenate([[start], breaks[breaks[:, 0] > start, 0], [0.0]]))
        pieces = np.maximum(np.ceil(np.diff(marks) / spacing - 1e-9).astype(int), 1)
        cuts = np.concatenate(
            [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(marks[:-1], marks[1:], pieces, strict=True)]
        )
    ends = np.append(cuts, 0.0)
    W = profile.W(ends, law)
    W -= W[0]
    mass, h = np.diff(W), np.diff(ends)
    mean = np.divide(mass, h, out=np.zeros_like(mass), where=h > 0)

    reached = np.concatenate([mean, breaks[:, 1:].ravel(), [0.0]])
    ceiling = float(np.max(law.R(reached)) + np.ptp(W))
    table = front_law(law, float(np.min(reached)) * 0.75 - 0.25 + 1e-9, _slope_at(law, 1.1 * ceiling))
    r0 = float(law.R(0.0))
    r = law.R(breaks[:, 2]) if isinstance(profile, Kinks) else _start_of_pieces(law, table, mean, mass, h)
    I = W[:-1] + r
    jump = np.diff(np.concatenate([[r0], I]))
    smooth = np.abs(mass) > 1e-15 if not isinstance(profile, Kinks) else np.zeros(h.size, dtype=bool)

    downward = breaks[breaks[:, 1] > breaks[:, 2]]
    drops = law.R(downward[:, 1]) - law.R(downward[:, 2])
    columns: list[Array] = []
    number = 0
    upward = set(breaks[breaks[:, 2] > breaks[:, 1] + 1e-12, 0].tolist())
    fan = dict(zip(downward[:, 0].tolist(), zip(downward[:, 1], drops, strict=True), strict=True))
    for k, x in enumerate(cuts.tolist()):
        if x in fan:
            q_left, drop = fan[x]
            n = max(4, int(np.ceil(0.25 * fronts * drop / drops.sum())))
            level = W[k] + float(law.R(q_left)) - drop * (np.arange(n) + 0.5) / n
            before = I[k - 1] if k else r0
            steps = np.diff(np.concatenate([[before], level, [I[k]]]))
            flags = np.append(np.ones(n), smooth[k])
            columns.append(np.array([np.full(n + 1, x), steps, np.zeros(n + 1), flags]))
        elif x in upward:
            number += 1
            columns.append(np.array([[x], [jump[k]], [number], [smooth[k]]]))
        elif abs(jump[k]) > 1e-15:
            columns.append(np.array([[x], [jump[k]], [0], [smooth[k]]]))
        elif columns:
            columns[-1][3, -1] = max(columns[-1][3, -1], smooth[k])
    x, jumps, label, flag = np.concatenate(columns, axis=1) if columns else np.empty((4, 0))
    return Fronts(x, jumps, label.astype(np.int64), flag.astype(bool), spacing, r0, float(W[-1])), table


def _slope_at(law: ErosionLaw, r: float) -> float:
    """A q with R(q) >= r."""
    q = 1.0
    while law.R(q) < r:
        q *= 2.0
    return q


def _start_of_pieces(law: ErosionLaw, table: FrontLaw, mean: Array, mass: Array, h: Array) -> Array:
    """r at the left end of pieces of constant I that hold the given mass: r - r(h) = mass."""
    if law.name == "rational":
        return 1.0 + mass / -np.expm1(-h)
    decay = np.vectorize(lambda r, h: kernels.front_decay(r, h, 0.0, *table), otypes=[float])
    q, r = mean, law.R(mean)
    for _ in range(6):  # Newton in q, with d(mass)/dq = h to first order
        off = mass - (r - decay(r, h))
        q = np.maximum(q + np.divide(off, h, out=np.zeros_like(h), where=h > 0), 0.5 * (q - 1.0))
        r = law.R(q)
    return r
