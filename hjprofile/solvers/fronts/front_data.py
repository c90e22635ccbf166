"""Initial data of front tracking: pieces of constant I = W + R(q), distributed by their error (§13)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.profiles import Kinks
from hjprofile.solvers.data_resolution import Sample, apart, divided, fine_sample
from hjprofile.solvers.fronts.fans import (
    DENSE,
    FRONTS_PER_JUMP,
    JUMP,
    NODES,
    Limits,
    duration,
    fans,
    graded_fans,
    interpolated,
    room,
)
from hjprofile.solvers.run import Array
from hjprofile.solvers.stop import ROBUST_METHOD, Reason, Stop, Stopped

FOLDS = 5000.0  # largest sum of |ln K| changes; the time of a run grows with its square, to 20 s
FLAT = 1e-10  # largest |q| that counts as the neutral slope
LEAST_RATE = 0.3  # smallest |I_x| as a fraction of |W_x| + |R_x|: if they cancel, pieces would be too long
PART = 1 / 32  # largest change between two intervals of the sample, as a fraction of the range of ln(1 + q)
MARKS = 0.25  # largest number of marks, as a fraction of the fronts; of more, the weak ones are merged
LEVEL = 1e-14  # smallest fall of ln R whose levels differ by more than rounding
LARGEST = 0.15  # mean spacing of fronts that steps of a law of linear growth assume, in decay lengths R'(0)


@dataclass
class FrontData:
    """The fronts of a profile and the pieces between them.

    Attributes:
        x, jump: positions and jumps of I, from left to right; x may repeat where a fan opens.
        label: the number of the kink that a front is, or 0.
        smooth: True if the piece right of a front represents a stretch in which I varies.
        area: |change of I| times length of a piece, the same for all pieces of smooth data.
        spacing: mean length of the pieces, weighted by the change of I.
        largest_f: the largest |f|.
        r0: R(0), r on the far left.
        W_crest: W at x = 0.
        dense: number of jumps if there are many, with a graded fan at each; otherwise 0.
        sample: the profile on a fine sample, or None if the fronts are the data.
    """

    x: Array
    jump: Array
    label: Array
    smooth: Array
    area: float
    spacing: float
    largest_f: float
    r0: float
    W_crest: float
    dense: int = 0
    sample: Sample | None = None

    @property
    def kinks_only(self) -> bool:
        """True if the fronts are the data themselves, not an approximation."""
        return not self.smooth.any()


class Pieces(NamedTuple):
    """Functions for pieces of constant I under laws of one kind of growth.

    Attributes:
        table: (law, smallest q, largest R(q)) -> the law in the form of the kernels.
        start: (law, this form, masses, lengths) -> r at the left ends of pieces, where r - r(length) = mass.
    """

    table: Callable[[ErosionLaw, float, float], Any]
    start: Callable[[ErosionLaw, Any, Array, Array], Array]


def cut_into_fronts(problem: Problem, left: float, fronts: int, pieces: Pieces) -> tuple[FrontData, Any]:
    """Return the fronts of a profile and its law in the form of `pieces.table`.

    I is piecewise constant, with W exact at the ends of the pieces; downward jumps become fans of small fronts.
    """
    law, profile = problem.law, problem.profile
    breaks = profile.breaks(law)
    if isinstance(profile, Kinks):
        cuts, sample, quantum, limits = breaks[:, 0], None, 0.0, Limits()
    else:
        cuts, sample, quantum, breaks, limits = _placed(problem, left, fronts, breaks)
    area = quantum**2
    ends = np.append(cuts, 0.0)
    W = profile.W(ends, law)
    W -= W[0]
    mass, h = np.diff(W), np.diff(ends)
    mean = np.divide(mass, h, out=np.zeros_like(mass), where=h > 0)

    reached_q = np.concatenate([mean, breaks[:, 1:].ravel(), [0.0]])
    ceiling = float(np.max(law.R(reached_q)) + np.ptp(W))
    # a downward front lowers q on its right slightly, unlike the exact fan
    floor = (1.0 + float(np.min(reached_q))) / 8.0 - 1.0
    table = pieces.table(law, floor, ceiling)
    r0 = float(law.R(0.0))
    r = law.R(breaks[:, 2]) if sample is None else pieces.start(law, table, mass, h)
    I = W[:-1] + r
    jump = np.diff(np.concatenate([[r0], I]))
    smooth = np.abs(mass) > 1e-15 if sample is not None else np.zeros(h.size, dtype=bool)

    upward = np.isin(cuts, breaks[breaks[:, 2] > breaks[:, 1] + JUMP, 0])
    label = np.where(upward, np.cumsum(upward), 0)
    is_front = upward | (np.abs(jump) > 1e-15)
    members = is_front.astype(np.int64)
    levels = np.empty(0)
    if sample is not None:
        r_left = np.append(r0, I[:-1]) - W[:-1]
        levels, fan = _levels(problem, sample, quantum, cuts, mean, breaks, limits, r_left, r)
        members = np.where(fan > 0, fan + 1, members)
    owner = np.repeat(np.arange(h.size), members)
    last = np.append(np.diff(owner) > 0, True)[: owner.size]
    if sample is not None:
        reached = I[owner]
        reached[~last] = W[owner[~last]] + np.exp(levels)
        jumps = np.diff(reached, prepend=r0)
    else:
        jumps = jump[owner]
    flags = np.where(last, smooth[owner], True)
    # a front without a jump is omitted: the piece on its left continues
    gone = np.maximum(np.searchsorted(owner, np.flatnonzero(~is_front & (members == 0))) - 1, 0)
    if owner.size:
        flags[gone] |= smooth[~is_front & (members == 0)]
    weight = np.abs(jump) * smooth
    spacing = float(weight @ h / weight.sum()) if weight.any() else -float(cuts[0]) / fronts
    spacing = min(spacing, LARGEST * float(law.R_derivative(0.0)))
    if sample is None:
        area = -float(cuts[0]) * float(np.abs(jump).sum()) / fronts**2
    largest_f = float(np.abs(law.f(reached_q)).max())
    data = FrontData(
        cuts[owner], jumps, label[owner] * last, flags, area, spacing, largest_f, r0, float(W[-1]), limits.dense, sample
    )
    return data, table


def _placed(problem: Problem, left: float, fronts: int, breaks: Array) -> tuple[Array, Sample, float, Array, Limits]:
    """Return the left ends of pieces, a fine sample, the need of a piece, the breaks that are cuts, and limits of fans.

    If there are more jumps than fronts, only the strongest jump of each piece is a cut, and
    the others are merged. W stays exact at the ends of pieces, and `compare_data` bounds the error between them.
    """
    start = problem.profile.start(tail=1e-14)
    start = max(start, left) if np.isfinite(start) and start < 0.0 else left
    sample = fine_sample(problem, left, part=PART)
    inside = (breaks[:, 0] > start) & (breaks[:, 0] < 0.0)
    jumps = np.abs(breaks[:, 2] - breaks[:, 1]) > JUMP
    if np.count_nonzero(inside) > MARKS * fronts:  # corners alone need no cut
        inside &= jumps
    marked = breaks[inside]
    count = marked.shape[0]
    dense = count > DENSE and FRONTS_PER_JUMP * count <= fronts
    many = count > MARKS * fronts and not dense
    limits = Limits.of(fronts, count) if dense else Limits()
    shocks = breaks[breaks[:, 2] > breaks[:, 1] + JUMP, 0]
    need = _need(problem, sample, np.empty(0) if many else breaks[jumps, 0], shocks)
    s = np.append(0.0, np.cumsum(need * np.diff(sample.x)))
    total = float(s[-1])
    if not many:
        falls = breaks[breaks[:, 1] > breaks[:, 2] + JUMP]
        total += float(fans(problem, sample, shocks, *falls.T).need[:, -1].sum())
    if not total > 0.0:
        return np.array([start]), sample, 0.0, breaks, limits
    s *= fronts / total
    if many:  # the strongest jump of each piece
        piece = np.floor(np.interp(marked[:, 0], sample.x, s)).astype(int)
        strength = np.abs(np.diff(np.log1p(marked[:, 1:]), axis=1)[:, 0])
        order = np.lexsort((-strength, piece))
        first = order[np.append(True, np.diff(piece[order]) > 0)]
        marked = marked[np.sort(first)]
    at_start = breaks[breaks[:, 0] == start]
    # the neutral slope on the right begins at an end of a piece, so that no piece contains its start
    sloping = np.flatnonzero(np.abs(sample.q) > FLAT)
    ends = sample.x[sloping[-1:] + 1]
    ends = ends[ends > start]
    marks = np.unique(np.concatenate([[start], marked[:, 0], ends, [0.0]]))
    at = np.interp(marks, sample.x, s)
    parts = np.maximum(np.round(np.diff(at)), 1).astype(int)
    cuts = np.interp(divided(at, parts), s, sample.x)
    cuts[np.append(0, np.cumsum(parts))] = marks
    cuts = apart([cuts], start, 0.0)
    return _folded(problem, cuts), sample, total / fronts, np.concatenate([at_start, marked]), limits


def _need(problem: Problem, sample: Sample, jumps: Array, shocks: Array) -> Array:
    """Return the need of fronts per length between the positions of the sample; at `jumps` I has no derivative.

    A piece of the length h in which I changes by D errs by a multiple of h D, its area. Where characteristics part at
    the rate λ_x it grows longer, by λ_x t. Pieces of equal area have the density sqrt(|I_x| (1 + λ_x t)).
    """
    law, x, q = problem.law, sample.x, sample.q
    h = np.diff(x)
    with np.errstate(all="ignore"):
        between = 0.5 * (h[1:] + h[:-1])
        K = np.exp(np.maximum(sample.ln_K[1:-1], 0.0))
        f, slope = law.f(q), law.derivative(q)
        decay, change = 0.5 * (q[1:] + q[:-1]), np.diff(law.R(q)) / between
        rate = np.maximum(np.abs(decay + change), LEAST_RATE * (np.abs(decay) + np.abs(change)))
        parting = K * (np.diff(slope) / between - 0.5 * (f * slope)[1:] - 0.5 * (f * slope)[:-1])
        lasts = np.minimum(duration(problem, x[1:-1], q[1:], K), duration(problem, x[1:-1], q[:-1], K))
        longer = 1.0 + np.minimum(np.maximum(parting, 0.0) * lasts, room(x[1:-1], shocks) / between)
        node = np.sqrt(rate * longer)
    known = np.isfinite(node) & ~np.isin(x[1:-1], jumps)
    node = np.where(known, node, 0.0)
    count = np.append(0.0, known) + np.append(known, 0.0)
    return (np.append(0.0, node) + np.append(node, 0.0)) / np.maximum(count, 1.0)


@np.errstate(invalid="ignore")  # a piece too near q = -1 has no r; the run reports it
def _levels(
    problem: Problem, sample: Sample, quantum: float, cuts: Array, mean: Array, breaks: Array, limits: Limits,
    r_left: Array, r_right: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the levels of ln r in fans, in one array, and the number of levels at each cut; 0 if there is no fan.

    A fall that needs more than one front is divided, whether or not the profile states a jump there. No front of it is
    stronger than the limit.
    """
    falls = breaks[breaks[:, 1] > breaks[:, 2] + JUMP]
    at = np.searchsorted(cuts, falls[:, 0])
    before, after = np.append(0.0, mean[:-1]), mean.copy()
    before[at], after[at] = falls[:, 1], falls[:, 2]
    stated = np.zeros(cuts.size, dtype=bool)
    stated[at] = True
    steep = np.flatnonzero(stated | (r_left > r_right) & (before > after))
    if limits.dense:
        fan = graded_fans(problem, float(cuts[0]), limits, cuts[steep], before[steep], after[steep])
    else:
        shocks = breaks[breaks[:, 2] > breaks[:, 1] + JUMP, 0]
        fan = fans(problem, sample, shocks, cuts[steep], before[steep], after[steep])
    level = fan.level
    # the values of r on both sides of a front differ from R of the mean slopes
    upper, lower = np.log(r_left[steep]), np.log(r_right[steep])
    upper, lower = np.where(stated[steep], level[:, 0], upper), np.where(stated[steep], level[:, -1], lower)
    drop = level[:, :1] - level[:, -1:]
    part = np.where(drop > LEVEL, (level[:, :1] - level) / np.maximum(drop, LEVEL), np.linspace(0.0, 1.0, NODES))
    part = np.clip(part, 0.0, 1.0)  # graded levels have rounding of their own
    level = upper[:, None] + (lower - upper)[:, None] * part
    s = fan.need / (1.0 if limits.dense else quantum) if quantum > 0.0 else np.zeros_like(level)
    count = np.maximum(np.round(s[:, -1]), np.ceil((upper - lower) / limits.strongest))
    count = np.where(stated[steep], np.maximum(count, limits.fewest), count).astype(np.int64)
    # uniform in ln r if the needs are small
    s += (1e-3 * s[:, -1:] + 1e-12) * np.linspace(0.0, 1.0, NODES)
    return _divided_fans(level, s, count, limits.strongest, steep, cuts.size)


def _divided_fans(
    level: Array, s: Array, count: Array, strongest: float, where: Array, cuts: int
) -> tuple[Array, Array]:
    """Return the levels of fronts at equal steps of s, and their number at each cut, `where` the fans are."""
    opened = np.flatnonzero(count > 1)
    if not opened.size:
        return np.empty(0), np.zeros(cuts, dtype=np.int64)
    count = count[opened]
    row = np.repeat(opened, count + 1)
    place = np.arange(row.size) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    n = np.repeat(count, count + 1)
    edges = interpolated(place / n * s[row, -1], row, s, level)
    edges[place == 0], edges[place == n] = level[opened, 0], level[opened, -1]
    inner = place[:-1] < n[:-1]  # from an edge to the next one of the same fan
    with np.errstate(invalid="ignore"):
        parts = np.where(inner, np.maximum(np.ceil(-np.diff(edges) / strongest), 1.0), 1.0).astype(np.int64)
    edges = divided(edges, parts)
    within = np.repeat(inner, parts)
    number = np.zeros(cuts, dtype=np.int64)
    np.add.at(number, where[row[:-1]], parts * inner)
    return 0.5 * (edges[1:] + edges[:-1])[within], number


def _folded(problem: Problem, cuts: Array) -> Array:
    """Return the left ends of pieces over each of which K changes by a factor of at most sqrt(e)."""
    law = problem.law
    folds = np.diff(cuts) * np.abs(law.f(np.diff(problem.profile.W(cuts, law)) / np.diff(cuts)))
    if not folds.sum() < FOLDS:
        raise Stopped(
            Stop(
                Reason.NOT_RESOLVED,
                "front tracking cannot start: ln K changes by {folds:.3g} along the slope, but at most {most:g} "
                "is possible, because q is too near -1 over too long a distance",
                f"use the method {ROBUST_METHOD}",
                {"folds": folds.sum(), "most": FOLDS},
            )
        )
    return divided(cuts, np.maximum(np.ceil(2.0 * folds).astype(int), 1))[:-1]
