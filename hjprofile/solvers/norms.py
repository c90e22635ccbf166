"""Norms of q, of its flux F = K f(q) and of the invariant I = W + R(q), and the a-priori bounds of them (§4, §6)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hjprofile.problem.erosion import ErosionLaw

Array = np.ndarray

BISECTIONS = 60  # for the largest q that a bound on R(q) permits: to rounding
LARGEST_LN_SLOPE = 700.0  # largest ln(1 + q) in double precision
SAMPLES = 1000  # number of slopes at which R' is evaluated for its minimum


class Norms(NamedTuple):
    """The norms of a run at its saved times, each an array of shape (times,).

    Values of cells enter, with F = f(q) times the mean of K at the two nodes of a cell, and W of I at its midpoint. A
    total variation includes the step from the neutral slope at the left end, unless a flux enters there. `sup_F`,
    `tv_F` and `tv_I` are NaN if the erosion law is not known.

    Attributes:
        time: t, the supplied mass.
        l1: ‖q‖₁ = ∫|q| dx.
        tv: TV(q).
        inf_q, sup_q: the smallest and the largest q.
        sup_F, tv_F: sup|F| and TV(F).
        tv_I: TV(I).
        K_left: K at the left end.
    """

    time: Array
    l1: Array
    tv: Array
    inf_q: Array
    sup_q: Array
    sup_F: Array
    tv_F: Array
    tv_I: Array
    K_left: Array

    def rows(self) -> Iterator[tuple[float, ...]]:
        """Yield the values of each saved time."""
        return zip(*(column.tolist() for column in self), strict=True)


class States(NamedTuple):
    """The states of a run that norms are computed from: `time` (times,), `W` and `K` at nodes, `q` in cells.

    `dx` is the width of a cell; `inflow` is True if a flux enters at the left end.
    """

    time: Array
    dx: float
    W: Array
    q: Array
    K: Array
    inflow: bool


def norms(states: States, law: ErosionLaw | None) -> Norms:
    """Return the norms of states. Rows are evaluated one by one, which limits the memory."""
    time, dx, W, q, K, inflow = states
    columns = np.full((len(Norms._fields), time.size), np.nan)
    for i in range(time.size):
        edge = 0.0 if inflow else abs(float(q[i, 0]))
        columns[1:5, i] = dx * np.abs(q[i]).sum(), np.abs(np.diff(q[i])).sum() + edge, q[i].min(), q[i].max()
        if law is not None:
            F = 0.5 * (K[i, 1:] + K[i, :-1]) * law.f(q[i])
            R, R_0 = law.R(q[i]), float(law.R(0.0))
            edge_F, edge_R = (0.0, float(R[0] + 0.5 * (W[i, 1] - W[i, 0]))) if inflow else (abs(float(F[0])), R_0)
            columns[5:8, i] = (
                np.abs(F).max(), np.abs(np.diff(F)).sum() + edge_F, invariant_variation(R, W[i], edge_R)
            )  # fmt: skip
    columns[0], columns[8] = time, K[:, 0]
    return Norms(*columns)


def invariant_variation(R: Array, W: Array, R_0: float) -> Array:
    """Return TV(I) of I = W + R(q) at the midpoints of cells, next to a neutral slope on the left.

    R = R(q) has the shape (..., cells), W = u - x the shape (..., cells + 1), and R_0 = R(0).

    >>> import numpy as np
    >>> q = np.array([0.0, 0.5, 0.5])  # I jumps by 0.5 and grows along the piece of constant q
    >>> float(invariant_variation(1.0 + q, np.append(0.0, np.cumsum(0.1 * q)), 1.0))
    0.575
    """
    first = R[..., 0] - R_0 + 0.5 * (W[..., 1] - W[..., 0])
    rest = np.diff(R, axis=-1) + 0.5 * (W[..., 2:] - W[..., :-2])
    return np.abs(first) + np.abs(rest).sum(axis=-1)


class Limit(NamedTuple):
    """A bound of a norm at the saved times, by the theory, with a short name; `values` has the shape (times,)."""

    name: str
    values: Array


def limits(
    found: Norms, states: States, law: ErosionLaw | None, case: Mapping[str, Any]
) -> Mapping[str, Sequence[Limit]]:
    """Return column of `Norms` -> its bounds, computed from the first saved state; columns without a bound are absent.

    The bounds depend on the model: `case` is the resolved case of the run. Their proofs are in §6 and §7.
    """
    ones = np.ones(found.time.size)
    floor = min(float(found.inf_q[0]), 0.0)
    l1 = (Limit("at t = 0", found.l1[0] * ones),)
    inf_q = (Limit("min(inf q, 0) at t = 0", floor * ones),)
    if states.inflow:
        return {"inf_q": inf_q}
    if "coefficient" in case or "layer" in case or "refresh" in case["solver"]:
        return {"l1": l1}
    every: dict[str, Sequence[Limit]] = {"l1": l1, "inf_q": inf_q}
    if law is None:
        return every
    q, W = states.q[0], states.W[0] - states.W[0, 0]
    plus, minus = (states.dx * float(np.maximum(sign * q, 0.0).sum()) for sign in (1.0, -1.0))
    every["K_left"] = (
        Limit("exp(f'(0) ‖[q]₊‖₁)", np.exp(float(law.derivative(0.0)) * plus) * ones),
        Limit("exp(-f'(κ) ‖[q]₋‖₁)", np.exp(-float(law.derivative(floor)) * minus) * ones),
    )
    if law.grows_linearly:
        return every
    top = inverse_of_R(law, float(np.max(law.R(q) + np.maximum(W[1:], W[:-1]))) + minus)
    slopes = floor + (top - floor) * np.linspace(0.0, 1.0, SAMPLES) ** 2  # R' varies most near q = -1
    uniform = (found.tv_I[0] + found.l1[0]) / float(law.R_derivative(slopes).min())
    every |= {
        "sup_q": (Limit("by R(q) <= sup I + ‖[q]₋‖₁", top * ones),),
        "tv": (Limit("uniform", uniform * ones), Limit("growing", _growing(found, states, law))),
        "tv_I": (Limit("at t = 0", found.tv_I[0] * ones),),
    }
    return every


def _growing(found: Norms, states: States, law: ErosionLaw) -> Array:
    """Return TV(q(0)) + ∫TV(K f²) dt by the trapezoidal rule between saved times."""
    rate = np.empty(found.time.size)
    for i in range(rate.size):
        source = 0.5 * (states.K[i, 1:] + states.K[i, :-1]) * law.f(states.q[i]) ** 2
        rate[i] = np.abs(np.diff(source)).sum() + source[0]
    return found.tv[0] + np.append(0.0, np.cumsum(0.5 * np.diff(found.time) * (rate[1:] + rate[:-1])))


@np.errstate(all="ignore")  # f may overflow at slopes far above the result
def inverse_of_R(law: ErosionLaw, value: float) -> float:
    """Return the q >= 0 with R(q) = `value`, from above, by bisection in ln(1 + q); 0 if R(0) is larger.

    >>> import hjprofile as hj
    >>> round(inverse_of_R(hj.rational(), 3.5), 12)
    2.5
    """
    if value <= float(law.R(0.0)):
        return 0.0
    low, high = 0.0, LARGEST_LN_SLOPE
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if float(law.R(np.expm1(middle))) <= value else (low, middle)
    return float(np.expm1(high))
