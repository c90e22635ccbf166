"""The assumptions on erosion laws, checked at 4001 slopes: (1.4), or linear growth instead of the last of them."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.ranges import Array, number
from hjprofile.problem.user_code import Function, evaluating

NO_LAW = "what-a-law-must-be"  # heading of the page on errors
FAR = 1e100, 1e50, 1e30, 1e15  # slopes at which the limit of f' is estimated: the two largest at which f is finite
LIMIT = 1e-10  # largest relative difference of f' at these two slopes
CONCAVE = "f must be concave, so its slope f' must decrease"


class _Sample(NamedTuple):
    """A law on 1e-8 <= 1 + q <= 1e8.

    Attributes:
        v: ln(1+q).
        df: f' less its limit, as a law of linear growth is concave towards a line.
        resolved: where f' is above the rounding of a derivative found by differences, about 1e-14 f/(1+q).
    """

    v: Array
    q: Array
    f: Array
    df: Array
    resolved: Array

    @property
    def middle(self) -> int:
        """The index at which q = 0."""
        return self.v.size // 2


def check_assumptions(f: Function, derivative: Function, linear: bool) -> float:
    """Return the limit of f' as q -> infinity if growth is linear, else 0.

    Raise InputError with the violated assumption, of (1.4) or of linear growth, and a q. The order of the checks
    decides
    which assumption is named, because a convex law violates several.
    """
    v = np.linspace(np.log(1e-8), np.log(1e8), 4001)
    q = np.expm1(v)
    with evaluating("the law"):
        values, df = np.asarray(f(q), dtype=float), np.asarray(derivative(q), dtype=float)
        f0 = float(f(np.array(0.0)))
    _check_zero(f0)
    limit = _limit(f, derivative) if linear else 0.0
    df = df - limit
    sample = _Sample(v, q, values, df, np.abs(df) > 1e-9 * np.abs(values) / (1 + q))
    _check_increasing(sample, limit)
    _check_fall(sample)
    _check_concave(sample, q[1:] < 100)
    _check_finite(sample)
    if not linear:
        _check_growth(sample)
    _check_concave(sample, q[1:] >= 100)
    number("f'(0)", df[sample.middle] + limit, NO_LAW)
    return limit


def refuse(assumption: str, where: float, because: str) -> NoReturn:
    """Raise InputError: an assumption fails at q = `where`."""
    raise InputError(f"the law is not an erosion function: {assumption} fails at q = {where:.10g}; {because}", NO_LAW)


def _check_zero(f0: float) -> None:
    """Check that f(0) = 0."""
    if np.isfinite(f0) and abs(f0) <= 1e-12:
        return
    because = (
        "at the neutral slope there is no erosion and no deposition" if np.isfinite(f0) else "f must be a number there"
    )
    raise InputError(
        f"the law is not an erosion function: f(0) = 0 fails at q = 0, where f = {f0:.6g}; {because}", NO_LAW
    )


def _limit(f: Function, derivative: Function) -> float:
    """Return lim f' as q -> infinity, from f/q, which is exact at such slopes. Raise InputError if f' has none."""
    q = np.array(FAR)
    with np.errstate(all="ignore"):
        values, slopes = np.asarray(f(q), dtype=float), np.asarray(derivative(q), dtype=float)
    finite = np.isfinite(values) & np.isfinite(slopes)
    far, mean = slopes[finite], (values / q)[finite]
    settled = far.size > 1 and far[0] > 0.0 and max(abs(far[:2] - mean[0])) <= LIMIT * far[0]
    if not (settled and mean[0]):
        raise InputError(
            "growth = 'linear' does not fit the law: its slope f' has no positive limit as q -> infinity; leave growth "
            "out if f' tends to 0"
        )
    return float(mean[0])


def _check_increasing(sample: _Sample, limit: float) -> None:
    """Check that f increases, and that f' does not increase at q = 0."""
    _, q, _, df, resolved = sample
    flat = (df <= 0) & (resolved | (q < 20))
    if limit and flat.any():
        refuse("f'' < 0", q[np.argmax(flat)], CONCAVE)
    middle = sample.middle
    if 0 < df[middle] * (1 + 1e-6) < df[middle + 1]:
        refuse("f'' < 0", 0.0, CONCAVE)
    if flat.any():
        turned = df[middle] < 0 and "its sign is wrong, because f must be positive for q > 0"
        refuse("f' > 0", q[np.argmax(flat)], turned or "f must increase: a steeper slope erodes more")


def _check_fall(sample: _Sample) -> None:
    # (1+q) f' is the slope of f in ln(1+q). If it decays towards q = -1, f has a finite limit there.
    """Check that f falls without bound as q -> -1."""
    slope = (1 + sample.q) * sample.df
    if slope[0] < 0.5 * np.interp(np.log(1e-4), sample.v, slope):
        because = "a slope cannot become flat, so f must fall without bound, as q/(1+q) does"
        refuse("f -> -infinity as q -> -1", sample.q[0], because)


def _check_concave(sample: _Sample, within: Array) -> None:
    """Check that f' decreases."""
    v, q, _, df, resolved = sample
    rising = (df[1:] >= df[:-1] * (1 - 1e-10)) & resolved[1:] & resolved[:-1]
    at = np.flatnonzero(rising & within)
    if at.size:
        refuse("f'' < 0", q[at[np.argmin(np.abs(v[at]))]], CONCAVE)


def _check_finite(sample: _Sample) -> None:
    """Check that f and f' are finite."""
    broken = ~(np.isfinite(sample.f) & np.isfinite(sample.df))
    if broken.any():
        where = sample.q[np.argmax(broken)]
        refuse("that f is finite with a derivative for every q > -1", where, "any slope can occur during a run")


def _check_growth(sample: _Sample) -> None:
    """Check that f grows more slowly than q."""
    if sample.df[-1] > 0.5 * np.interp(np.log(1e4), sample.v, sample.df):
        raise InputError(
            "the law is not an erosion function: f(q)/q -> 0 as q -> infinity (sublinear growth) fails at "
            f"q = {sample.q[-1]:.10g}; a law whose slope f' tends to a positive limit is admitted with "
            "growth = 'linear'",
            NO_LAW,
        )
