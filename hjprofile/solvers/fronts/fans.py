"""Fans of small fronts at the downward jumps of q, and how long each part of them exists (§13)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hjprofile.problem import Problem
from hjprofile.solvers.data_resolution import Sample
from hjprofile.solvers.run import Array

NODES = 33  # number of values of q along a fan, between which its fronts are interpolated
SWALLOWED = 16.0  # largest width to which a fall opens, in distances to the nearest shock
FAN_FRONT = 0.25  # largest fall of ln R across one front, if fans are not dense
FEWEST_IN_FAN = 4  # smallest number of fronts in the fan of a stated jump, likewise
DENSE = 100  # number of jumps above which fans are graded if there are sufficient fronts, and jumps merged otherwise
FRONTS_PER_JUMP = 0.5  # of a number of fronts that is sufficient; the fronts of graded fans are additional
JUMP = 1e-12  # smallest jump of q at a break
MEAN_OVER = 0.25  # distance on either side over which a mean slope is taken, in decay lengths R'(0)
FINEST, GRADING = 0.05, 0.8  # fall of ln(1 + q) across a front, and relative to that from the mean slope


class Limits(NamedTuple):
    """Limits of the fronts of a fan.

    Attributes:
        strongest: largest fall of ln R across one front; stronger ones, if q changes sign, approach q = -1.
        fewest: smallest number of fronts of a stated jump.
        dense: number of the jumps if they are so near to each other that most fans are swallowed soon, otherwise 0.
    """

    strongest: float = FAN_FRONT
    fewest: int = FEWEST_IN_FAN
    dense: int = 0

    @classmethod
    def of(cls, fronts: int, jumps: int) -> Limits:
        """Return the limits of the fans of many jumps: both fractions of a fall are halved by twice the fronts."""
        return cls(min(FRONTS_PER_JUMP * jumps / fronts, 1.0), 1, jumps)


class Fans(NamedTuple):
    """Fans along which q falls: ln R and the cumulative need of fronts, shape (fans, nodes)."""

    level: Array
    need: Array


def fans(problem: Problem, sample: Sample, shocks: Array, x: Array, before: Array, after: Array) -> Fans:
    """Return the fans at x, along q from `before` down to `after`."""
    law = problem.law
    part = np.linspace(0.0, 1.0, NODES)
    q = np.expm1(np.log1p(before)[:, None] * (1.0 - part) + np.log1p(after)[:, None] * part)
    K = np.exp(np.maximum(np.interp(x, sample.x, sample.ln_K), 0.0))[:, None]
    R, lasts = law.R(q), duration(problem, x[:, None], q, K)
    opening = np.maximum(K * np.diff(law.derivative(q)) * np.minimum(lasts[:, 1:], lasts[:, :-1]), 0.0)
    most = room(x, shocks)[:, None]
    opening *= np.minimum(1.0, most / np.maximum(opening.sum(axis=1, keepdims=True), 1e-300))
    need = np.cumsum(np.sqrt(np.maximum(-np.diff(R), 0.0) * opening), axis=1)
    return Fans(np.log(R), np.hstack([np.zeros((x.size, 1)), need]))


def graded_fans(problem: Problem, left: float, limits: Limits, x: Array, before: Array, after: Array) -> Fans:
    """Return fans at x for dense jumps: the need is the number of fronts.

    Most of these fans are swallowed soon. What remains has slopes near the mean slope around it, so the levels are
    graded towards that slope: a front there falls by `nearest`, others by a fraction of the distance from that slope.
    An equal number for each fan is essential. A fan with few levels erodes more slowly and wins over its neighbours.
    """
    law = problem.law
    w = MEAN_OVER * float(law.R_derivative(0.0))
    ends = np.clip([x - w, x + w], left, 0.0)
    mean = np.log1p(np.diff(problem.profile.W(ends.ravel(), law).reshape(2, -1), axis=0)[0] / (ends[1] - ends[0]))
    finest, ratio = limits.strongest * FINEST, limits.strongest * GRADING
    z0 = finest / ratio

    def number(v: Array) -> Array:  # of fronts from the mean slope to v
        z = v - mean
        far = np.log(np.maximum(np.abs(z) / z0, 1.0)) / ratio
        return np.clip(z, -z0, z0) / finest + np.sign(z) * far

    top, bottom = number(np.log1p(before)), number(np.log1p(after))
    n = top[:, None] + (bottom - top)[:, None] * np.linspace(0.0, 1.0, NODES)
    far = np.maximum(np.abs(n) - 1.0 / ratio, 0.0)
    v = mean[:, None] + np.where(far > 0.0, np.sign(n) * z0 * np.exp(ratio * far), n * finest)
    v[:, 0], v[:, -1] = np.log1p(before), np.log1p(after)
    return Fans(np.log(law.R(np.expm1(v))), top[:, None] - n)


def interpolated(x: Array, row: Array, xp: Array, fp: Array) -> Array:
    """Return the piecewise linear functions of the rows of xp and fp at x, each of which belongs to a row."""
    i = np.clip((xp[row] <= x[:, None]).sum(axis=1) - 1, 0, xp.shape[1] - 2)
    slope = (fp[row, i + 1] - fp[row, i]) / (xp[row, i + 1] - xp[row, i])
    return slope * (x - xp[row, i]) + fp[row, i]


def room(x: Array, shocks: Array) -> Array:
    """Return the largest width to which a fall at x opens, before it leaves or the nearest shock swallows it."""
    at = np.searchsorted(shocks, x)
    nearest = np.minimum(x - np.append(-np.inf, shocks)[at], np.append(shocks, np.inf)[at] - x)
    return np.minimum(-x, SWALLOWED * nearest)


def duration(problem: Problem, x: Array, q: Array, K: Array) -> Array:
    """Return the time of nearly constant motion of a characteristic: until the end, its exit, or a change of q.

    A negative q rises by q' = K f² in the time |q|/q'.
    """
    law = problem.law
    with np.errstate(all="ignore"):
        rise = np.where(q < 0.0, law.R(q) / (K * -law.f(q)), np.inf)
    return np.minimum(np.minimum(problem.end, -x / (K * law.derivative(q))), rise)
