"""Labels of characteristics on panels of Chebyshev points, constructed from a profile (§14).

A label is the initial position of a characteristic; inside the fan of a downward jump it is ln R. On each panel r =
R(q), X and I = W + r are polynomials of the label.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev

from hjprofile.problem import Problem
from hjprofile.solvers.characteristics.kernels.announced_events import living
from hjprofile.solvers.characteristics.kernels.labels import Mesh, Rule, Shocks, after_start, before_end
from hjprofile.solvers.data_resolution import Sample, fine_sample
from hjprofile.solvers.run import Array
from hjprofile.solvers.stop import Place, Reason, Stop, Stopped

POINTS = 16
FAN_PANEL = 0.5  # largest range of ln R in a panel of a fan
NARROWEST = 1e-7  # smallest width of a panel; a profile that needs narrower ones is not smooth between its corners
MOST_PENDING = 4000  # largest number of unresolved panels of one width: it doubles where a profile is rough
TAIL = 1e-15 * POINTS**2  # rounding of the highest Chebyshev coefficients
MISSED = 1e-11  # error of W between the points of a panel: rounding, and far below every tolerance
MOST_DEAD, MARGIN = 0.0, 0.02  # largest dead local position at an end of a panel; dead width after a crop
TAIL_OF_DATA = 2e-14  # R near q = 0 is a polynomial, with rounding of 1e-15


def _rule() -> Rule:
    """Return the interpolation rule of a panel."""
    s = -np.cos(np.pi * np.arange(POINTS) / (POINTS - 1))
    bary = (-1.0) ** np.arange(POINTS)
    bary[[0, -1]] *= 0.5
    with np.errstate(divide="ignore"):
        D = bary[None, :] / bary[:, None] / (s[:, None] - s[None, :])
    np.fill_diagonal(D, 0.0)
    np.fill_diagonal(D, -D.sum(axis=1))
    primitives = chebyshev.chebint(np.eye(POINTS), lbnd=1.0)  # one Chebyshev polynomial per column
    B = -_to_coefficients(s).T @ chebyshev.chebval(s, primitives)
    return Rule(s, bary, D, np.ascontiguousarray(B))


def _to_coefficients(s: Array) -> Array:
    """Return the matrix from values at s to Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(s, POINTS - 1))


RULE = _rule()
TO_COEFFICIENTS = _to_coefficients(RULE.s)
GAUSS = np.polynomial.legendre.leggauss(POINTS)


def interpolation(s: Array) -> Array:
    """Return the matrix from values at the points of a panel to values at s."""
    apart = s[:, None] - RULE.s
    there = apart == 0.0
    rows = RULE.bary / np.where(there, 1.0, apart)
    hit = there.any(axis=1)
    rows[hit] = there[hit]
    return rows / rows.sum(axis=1, keepdims=True)


AT_GAUSS = interpolation(GAUSS[0])


def tails(values: Array) -> Array:
    """Return the largest of the last Chebyshev coefficients of each row, relative to the row's size (at least 1)."""
    coefficients = np.abs(values @ TO_COEFFICIENTS.T)
    return coefficients[:, -3:].max(axis=1) / np.maximum(coefficients.max(axis=1), 1.0)


@dataclass
class Panels:
    """The state of a solution by characteristics, in the conventions of `kernels.labels`.

    Attributes:
        r, X: shape (panels, points); X is measured from the panel's base.
        mesh: the fixed data of the labels.
        off, birth, power, tau: of the shocks, (shocks, 2) and (shocks,), see `rates`.
        number: permanent numbers of the shocks.
        off_crest: distance of the label at x = 0 from the last joint, shape (1,).
        totals: ∫(K_left - 1) dt and ∫F(0) dt.
    """

    r: Array
    X: Array
    mesh: Mesh
    off: Array
    birth: Array
    power: Array
    tau: Array
    number: list[int]
    off_crest: Array
    totals: Array

    @property
    def shocks(self) -> int:
        return self.off.shape[0]

    @property
    def y(self) -> Array:
        return np.concatenate([self.r.ravel(), self.X.ravel(), self.totals])

    def labels(self) -> Shocks:
        """Return the labels of shocks, with copies of the arrays that a step changes."""
        return Shocks(self.off.copy(), self.birth, self.power, self.tau.copy(), self.off_crest.copy())

    def at(self, y: Array, shocks: Shocks) -> Panels:
        """Return the same panels with another state."""
        size, shape = self.r.size, self.r.shape
        return replace(
            self, r=y[:size].reshape(shape), X=y[size : 2 * size].reshape(shape), totals=y[2 * size :],
            off=shocks.off, off_crest=shocks.crest, tau=shocks.tau,
        )  # fmt: skip

    def segment(self, p: int) -> int:
        """Return the segment of panel p."""
        return int(np.searchsorted(self.mesh.first, p, side="right")) - 1

    def living(self) -> tuple[Array, Array]:
        """Return the local range of each panel in which labels are alive, empty (high <= low) if there are none."""
        low, high = np.empty(len(self.r)), np.empty(len(self.r))
        living(self.mesh, self.off, self.off_crest, low, high)
        return low, high

    def volume(self) -> float:
        """Return ∫W dx over the living labels, by Gauss-Legendre quadrature."""
        if not len(self.r):
            return 0.0
        low, high = self.living()
        W, slope = self.mesh.I - self.r, self.X @ RULE.D.T
        whole = (low == -1.0) & (high == 1.0)
        total = float((((W[whole] @ AT_GAUSS.T) * (slope[whole] @ AT_GAUSS.T)) @ GAUSS[1]).sum())
        for p in np.flatnonzero((high > low) & ~whole):
            half = 0.5 * (high[p] - low[p])
            row = interpolation(0.5 * (low[p] + high[p]) + half * GAUSS[0])
            total += half * float(GAUSS[1] @ ((row @ W[p]) * (row @ slope[p])))
        return total

    def resampled(self, pieces: list[tuple[int, float, float]], first: Array) -> Panels:
        """Return panels that consist of parts (panel, low s, high s) of these; `first` counts the new ones."""
        source = np.array([p for p, _, _ in pieces])
        ends = np.array([(a, b) for _, a, b in pieces])
        part = 0.5 * (ends[:, 1] - ends[:, 0])
        changed = np.flatnonzero(part < 1.0)
        E = [interpolation(0.5 * (a + b) + 0.5 * (b - a) * RULE.s) for a, b in ends[changed]]

        def values(old: Array) -> Array:
            new = old[source]
            for i, rows in zip(changed, E, strict=True):
                new[i] = rows @ new[i]
            return new

        joined = self.mesh.joined[source]
        joined[1:] |= np.diff(source) == 0
        mesh = Mesh(
            values(self.mesh.I), values(self.mesh.dI) * part[:, None], self.mesh.half[source] * part,
            self.mesh.base[source], joined, first,
        )  # fmt: skip
        return replace(self, r=values(self.r), X=values(self.X), mesh=mesh)

    def split(self, where: dict[int, float]) -> Panels:
        """Return panels cut in two at the local positions `where`."""
        pieces: list[tuple[int, float, float]] = []
        first = self.mesh.first.copy()
        for p in range(len(self.r)):
            if p in where:
                pieces += [(p, -1.0, where[p]), (p, where[p], 1.0)]
                first[np.searchsorted(self.mesh.first, p, side="right") :] += 1
            else:
                pieces.append((p, -1.0, 1.0))
        return self.resampled(pieces, first)

    def selected(self, keep: Array) -> Panels:
        """Return the panels for which `keep` is true, in the same segments."""
        m = self.mesh
        first = np.append(0, np.cumsum(keep))[m.first]
        mesh = Mesh(m.I[keep], m.dI[keep], m.half[keep], m.base[keep], m.joined[keep], first)
        return replace(self, r=self.r[keep], X=self.X[keep], mesh=mesh)

    def trimmed(self) -> Panels:
        """Return panels without those that are entirely dead, and without large dead parts of others."""
        if not len(self.r):
            return self
        low, high = self.living()
        if np.all(high > low):
            return self._cropped(low, high)
        m = self.mesh
        keep = np.ones(len(self.r), dtype=bool)
        off, power, off_crest = self.off.copy(), self.power.copy(), self.off_crest.copy()
        for k in range(self.shocks):
            p = after_start(off[k, 1], k + 1, m)[0]
            gone = slice(m.first[k + 1], p)
            keep[gone] = False
            off[k, 1] -= 2.0 * m.half[gone].sum()
            if m.first[k] < m.first[k + 1]:
                last = before_end(off[k, 0], k, m)[0]
                behind = slice(last + 1, m.first[k + 1])
                keep[behind] = False
                off[k, 0] -= 2.0 * m.half[behind].sum()
                p = max(p, m.first[k + 1] + (m.first[k + 1] - 1 - last))
            if p > m.first[k + 1]:
                power[k] = 0.0
        last = before_end(off_crest[0], self.shocks, m)[0]
        keep[last + 1 :] = False
        off_crest[0] -= 2.0 * m.half[last + 1 :].sum()
        if keep.all():
            return self._cropped(low, high)
        rest = replace(self.selected(keep), off=np.maximum(off, 0.0), power=power, off_crest=off_crest)
        return rest._cropped(*rest.living()) if len(rest.r) else rest

    def _cropped(self, low: Array, high: Array) -> Panels:
        """Return panels without dead parts of more than half a panel, which can diverge and would limit the step.

        A panel without an analytic continuation stays: beyond its end a label is found by the panel's own formula.
        """
        if low.max() <= MOST_DEAD and high.min() >= -MOST_DEAD:
            return self
        joined_left = self.mesh.joined.copy()
        joined_left[self.mesh.first[:-1][self.mesh.first[:-1] < len(joined_left)]] = False
        joined_right = np.append(joined_left[1:], False)
        a = np.where((low > MOST_DEAD) & joined_right, low - MARGIN, -1.0)
        b = np.where((high < -MOST_DEAD) & joined_left, high + MARGIN, 1.0)
        if np.all((a == -1.0) & (b == 1.0)):
            return self
        off, power, off_crest = self.off.copy(), self.power.copy(), self.off_crest.copy()
        half, first = self.mesh.half, self.mesh.first
        for k in range(self.shocks):
            after, before = first[k + 1], first[k + 1] - 1
            off[k, 1] -= (a[after] + 1.0) * half[after]
            off[k, 0] -= (1.0 - b[before]) * half[before] if first[k] < first[k + 1] else 0.0
            if a[after] > -1.0 or (first[k] < first[k + 1] and b[before] < 1.0):
                power[k] = 0.0
        off_crest[0] -= (1.0 - b[-1]) * half[-1]
        rest = self.resampled([(p, float(a[p]), float(b[p])) for p in range(len(self.r))], first)
        return replace(rest, off=off, power=power, off_crest=off_crest)


def cut_into_panels(problem: Problem, left: float, tail: float = TAIL_OF_DATA) -> Panels:
    """Return the profile of a problem on panels between its corners and jumps, right of `left` or of the start of q.

    `tail` is the largest of the last Chebyshev coefficients of R(q). Raise RunError if the profile is not smooth
    between corners and jumps.
    """
    law, profile = problem.law, problem.profile
    start = profile.start(tail=1e-17)
    start = max(start, left) if start < 0.0 else left
    breaks = profile.breaks(law)
    marks = np.unique(np.concatenate([[start], breaks[:, 0], [0.0]]))
    at = dict(zip(breaks[:, 0].tolist(), breaks[:, 1:].tolist(), strict=True))
    sample = fine_sample(problem, start)
    columns: list[tuple[Array, Array, Array, Array, float, float, bool]] = []  # r, X, I, dI, half, base, joined
    first = [0]
    for x, end in zip(marks[:-1].tolist(), marks[1:].tolist(), strict=True):
        before, after = at.get(x, (0.0, 0.0))
        if after > before + 1e-12:
            first.append(len(columns))
        elif after < before - 1e-12:
            W = float(profile.W(np.array([x]), law)[0] - profile.W(np.array([start]), law)[0])
            columns += _fan(x, W, float(law.R(before)), float(law.R(after)))
        ends = (after if x in at else None, at[end][0] if end in at else None)
        columns += _smooth(problem, x, end, ends, sample, max(tail, TAIL_OF_DATA))
    first.append(len(columns))
    r, X, I, dI, half, base, joined = (np.array(a) for a in zip(*columns, strict=True))
    shocks = len(first) - 2
    mesh = Mesh(I, dI, half, base, joined.astype(np.bool_), np.array(first))
    return Panels(
        r, X, mesh, np.zeros((shocks, 2)), np.zeros(shocks), np.zeros((shocks, 2)), np.ones(shocks),
        list(range(1, shocks + 1)), np.zeros(1), np.zeros(2),
    )  # fmt: skip


def _fan(x: float, W: float, r_left: float, r_right: float) -> list:
    """Return the panels of a fan that opens at x: r decreases geometrically, and I with it."""
    pieces = int(np.ceil(np.log(r_left / r_right) / FAN_PANEL))
    joints = np.linspace(np.log(r_left), np.log(r_right), pieces + 1)
    columns = []
    for i, (a, b) in enumerate(pairwise(joints.tolist())):
        r = np.exp(0.5 * (a + b) + 0.5 * (b - a) * RULE.s)
        columns.append((r, np.zeros(POINTS), W + r, 0.5 * (b - a) * r, 0.5 * (a - b), x, i > 0))
    return columns


def _smooth(problem: Problem, x: float, end: float, ends: tuple, sample: Sample, tail: float) -> list:
    """Return panels of a piece without corners, halved until their last Chebyshev coefficients are below `tail`.

    A panel must also reproduce W at all positions of the sample, because a narrow bump may lie between its own points.
    """
    law, profile = problem.law, problem.profile
    W0 = float(sample.W[0])
    most_missed = max(tail, MISSED) * float(np.ptp(sample.W)) + 1e-14
    columns, pending = [], np.array([[x, end]])
    while pending.size:  # all panels of one width at once
        a, b = pending.T[:, :, None]
        half = 0.5 * (b - a)
        at = 0.5 * (a + b) + half * RULE.s
        at[:, :1], at[:, -1:] = a, b
        W = profile.W(at, law) - W0
        stated = profile.excess(at, law)
        q = W @ RULE.D.T / half if stated is None else stated
        if ends[0] is not None:
            q[pending[:, 0] == x, 0] = ends[0]
        if ends[1] is not None:
            q[pending[:, 1] == end, -1] = ends[1]
        r = law.R(q)
        dI = (W + r) @ RULE.D.T
        dI[np.abs(dI) < 1e-13] = 0.0
        # x has a rounding error, and r has that error times its slope, which is meaningless on a panel that is too wide
        slope = np.abs(r @ RULE.D.T).max(axis=1) / half[:, 0] if stated is not None else np.zeros(len(r))
        rounding = 2.0 * np.finfo(float).eps * np.abs(pending).max(axis=1)
        noise = np.minimum(np.maximum(tail, rounding * slope), max(tail, MISSED))
        rough = np.maximum(tails(r), tails(W + r))
        good = rough <= noise
        allowed = most_missed + rounding * np.abs(q).max(axis=1)
        for p in np.flatnonzero(good):
            inside = slice(*np.searchsorted(sample.x, pending[p]))
            rows = interpolation((sample.x[inside] - pending[p].mean()) / half[p, 0])
            missed = np.abs(rows @ W[p] - (sample.W[inside] - W0)).max(initial=0.0)
            good[p] = missed <= allowed[p]
        columns += [
            (r[p], half[p] * (1.0 + RULE.s), W[p] + r[p], dI[p], half[p, 0], a[p, 0], a[p, 0] > x)
            for p in np.flatnonzero(good)
        ]
        narrow = ~good & ((half[:, 0] < NARROWEST) | (len(pending) > MOST_PENDING))
        if narrow.any():
            worst = int(np.argmax(np.where(narrow, rough, 0.0)))
            raise Stopped(
                Stop(
                    Reason.NOT_SMOOTH,
                    "the profile is not smooth near x = {x:.6g} and declares no corner there, so characteristics "
                    "cannot represent it",
                    values={"x": Place(a[worst, 0])},
                )
            )
        wide, middle = pending[~good], 0.5 * pending[~good].sum(axis=1)
        pending = np.concatenate([np.stack([wide[:, 0], middle], axis=1), np.stack([middle, wide[:, 1]], axis=1)])
    return sorted(columns, key=lambda column: column[5])
