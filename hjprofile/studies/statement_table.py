"""Table of the statements that bound a solution at its saved times, and the functions that evaluate them.

Each function returns the times, the values and the bounds. The proofs are in theory.md §6; a comment states what is not
obvious for a solution that is constant in each cell, whose K is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.run import Array
from hjprofile.studies.dependence import NOTHING
from hjprofile.studies.statement_runs import FractionalStep, History, maximum, total_variation

Series = tuple[Array, Array, Array]
Evaluate = Callable[[History, Sequence[FractionalStep]], Series]

# conditions of statements, each as the reason why a statement does not apply if it is not satisfied
NONLOCAL = "a prescribed coefficient does not depend on q"
CLOSED = "a flux enters at the left end, where q is not 0"
NEGATIVE = "q is nowhere negative at t = 0"
POSITIVE = "q is nowhere positive at t = 0"
SHIFTED_CELLS = 2, 8, 32  # shifts h at which (3.9) is evaluated


class Statement(NamedTuple):
    """One statement: its name, number in the paper, formula, conditions, and the function that evaluates it."""

    name: str
    equation: str
    words: str
    needs: tuple[str, ...]
    series: Evaluate


def conditions(history: History) -> frozenset[str]:
    """Return the conditions of statements that a problem does not satisfy, as reasons."""
    q = history.q[0]
    violated = {
        NONLOCAL: not history.nonlocal_, CLOSED: history.inflow != 0.0,
        NEGATIVE: q.min() >= -NOTHING, POSITIVE: q.max() <= NOTHING,
    }  # fmt: skip
    return frozenset(reason for reason, missing in violated.items() if missing)


# ---- norms at the saved times


def _l1(h: History, q: Array) -> Array:
    return h.dx * np.abs(q).sum(axis=-1)


def _from_zero(q: Array) -> Array:
    """Return q with the value 0 on its left: its total variation is that on the half line."""
    return np.concatenate([np.zeros((*q.shape[:-1], 1)), q], axis=-1)


def _between(values: Array) -> Array:
    """Return the increments of a sum between saved times."""
    return np.diff(values)


def _steepest(h: History, *states: Array) -> Array:
    """Return f'(κ) with κ = min(inf q, 0) over states, at each saved time."""
    lowest = np.minimum.reduce([np.minimum(q.min(axis=1), 0.0) for q in states])
    return h.law.derivative(lowest)


def _later(time: Array, value: Array, bound: Array) -> Series:
    """Return a series without t = 0, where the bound of a statement on growth is the value itself."""
    return time[1:], value[1:], bound[1:]


def _pairwise(values: Array) -> Array:
    """Return the larger of the values at two consecutive saved times."""
    return np.maximum(values[1:], values[:-1])


# ---- definition 1 and section 2


def _continuity(h: History, _: Sequence[FractionalStep]) -> Series:
    return h.time[1:], _l1(h, np.diff(h.q, axis=0)), _between(h.sums["variation"])


def _frozen_maximum(_: History, steps: Sequence[FractionalStep]) -> Series:
    time, value, bound = _columns(steps, "end", "largest_maximum", "maximum")
    return time, value, bound


def _frozen_variation(_: History, steps: Sequence[FractionalStep]) -> Series:
    time, value, bound = _columns(steps, "end", "largest_variation", "variation")
    return time, value, bound


def _columns(steps: Sequence[FractionalStep], *names: str) -> tuple[Array, ...]:
    return tuple(np.array([getattr(step, name) for step in steps]) for name in names)


def _k_in_time(h: History, _: Sequence[FractionalStep]) -> Series:
    value = maximum(np.diff(h.k, axis=0)) / np.diff(h.time)
    if not h.nonlocal_:
        return h.time[1:], value, np.full(value.size, h.sums["k_rate"][-1])
    # the Lipschitz constant of the appendix, with ∫ TV(F) in the place of L Δt
    L = h.k.max() * float(_steepest(h, h.q).max()) * _between(h.sums["variation"]) / np.diff(h.time)
    return h.time[1:], value, np.full(value.size, L.max())


def _slope_of_k_in_time(h: History, _: Sequence[FractionalStep]) -> Series:
    value = total_variation(np.diff(h.k, axis=0)) / np.diff(h.time)
    if not h.nonlocal_:
        return h.time[1:], value, np.full(value.size, h.sums["k_variation_rate"][-1])
    f = _l1(h, h.law.f(h.q))
    L = _between(h.sums["variation"]) / np.diff(h.time) * _pairwise(_steepest(h, h.q))
    bound = _pairwise(h.k.max(axis=1)) * (1.0 + _pairwise(f)) * L
    return h.time[1:], value, np.full(value.size, bound.max())


def _flux_growth(h: History, _: Sequence[FractionalStep]) -> Series:
    F = maximum(h.F)
    return _later(h.time, F, F[0] * np.exp(h.sums["rate"]))


def _flux_growth_frozen(_: History, steps: Sequence[FractionalStep]) -> Series:
    growth = np.log1p([step.relative for step in steps])
    return (*_columns(steps, "end", "largest_maximum"), steps[0].maximum * np.exp(np.cumsum(growth) - growth))


def _refreshed_maximum(_: History, steps: Sequence[FractionalStep]) -> Series:
    time, value, last, growth = _columns(steps, "end", "next_maximum", "last_maximum", "relative")
    return time, value, last * (1.0 + growth)


def _refreshed_variation(_: History, steps: Sequence[FractionalStep]) -> Series:
    time, value, last, growth = _columns(steps, "end", "next_variation", "last_variation", "coarse")
    size, rise = _columns(steps, "last_maximum", "relative_variation")
    return time, value, last * (1.0 + growth) + size * rise


def _variation_growth(h: History, _: Sequence[FractionalStep]) -> Series:
    return _later(h.time, total_variation(h.F), h.sums["flux_variation"])


def _variation_of_q(h: History, _: Sequence[FractionalStep]) -> Series:
    # f = F/k at the nodes right of the left end
    F, k = h.F[:, 1:], h.k[:, 1:]
    least = k.min(axis=1)
    bound = (total_variation(F) / least + maximum(F) * total_variation(k) / least**2) / h.law.derivative(
        h.q.max(axis=1)
    )
    return h.time, total_variation(h.q), bound


# ---- section 3


def _lower(h: History, _: Sequence[FractionalStep]) -> Series:
    assert h.local is not None and h.local.low is not None
    return tuple(np.array([value]) for value in (h.local.end, -h.local.lowest, -h.local.low))  # type: ignore[return-value]


def _upper(h: History, _: Sequence[FractionalStep]) -> Series:
    assert h.local is not None and h.local.high is not None
    return tuple(np.array([value]) for value in (h.local.end, h.local.highest, h.local.high))  # type: ignore[return-value]


def _deepest(h: History, _: Sequence[FractionalStep]) -> Series:
    return _later(h.time, -np.minimum(h.q.min(axis=1), 0.0), h.sums["deepest"])


def _highest(h: History, _: Sequence[FractionalStep]) -> Series:
    return _later(h.time, np.maximum(h.q.max(axis=1), 0.0), h.sums["highest"])


def _moved(q: Array, cells: int) -> Array:
    """Return q(· - h) on the half line, with 0 left of the domain."""
    return np.concatenate([np.zeros((*q.shape[:-1], cells)), q[..., :-cells]], axis=-1)


def _quotients(h: History, _: Sequence[FractionalStep]) -> Series:
    shifts = [m for m in SHIFTED_CELLS if m < h.q.shape[1]]
    values = [np.abs(h.q - _moved(h.q, m)).sum(axis=1) / m for m in shifts]
    return h.time, np.max(values, axis=0), total_variation(_from_zero(h.q))


def _growth_of_quotient(h: History, _: Sequence[FractionalStep]) -> Series:
    length = h.shift * h.dx
    value = _l1(h, h.q - _moved(h.q, h.shift)) / length
    return _later(h.time, value, value[0] + h.sums["shifted"] / length)


def _same_coefficient(h: History, _: Sequence[FractionalStep]) -> Series:
    other = h.middle if h.nonlocal_ else h.q2
    apart = _l1(h, h.q - other)
    return _later(h.time, apart, np.full(apart.size, apart[0]))


def _other_coefficient(h: History, _: Sequence[FractionalStep]) -> Series:
    return _later(h.time, _l1(h, h.middle - h.q2), h.sums["apart"])


def _pair(h: History) -> tuple[Array, Array]:
    """Return sup K f'(κ) ‖q₁ - q₂‖₁ for the pair, and 1 + ‖f(q₁)‖₁."""
    top = np.maximum(h.k.max(axis=1), h.k2.max(axis=1))
    return top * _steepest(h, h.q, h.q2) * _l1(h, h.q - h.q2), 1.0 + _l1(h, h.law.f(h.q))


def _k_apart(h: History, _: Sequence[FractionalStep]) -> Series:
    return h.time, maximum(h.k - h.k2), _pair(h)[0]


def _variation_apart(h: History, _: Sequence[FractionalStep]) -> Series:
    size, factor = _pair(h)
    return h.time, total_variation(h.k - h.k2), size * factor


# ---- appendix


def _domain(h: History) -> tuple[float, float]:
    """Return the constants C₀ and κ₀ of (1.7) for the run."""
    largest = float(np.maximum(total_variation(_from_zero(h.q)), _l1(h, h.q)).max())
    return largest, min(float(h.q.min()), 0.0)


def _sup_of_q(h: History, _: Sequence[FractionalStep]) -> Series:
    return h.time, maximum(h.q), np.full(h.time.size, _domain(h)[0])


def _sup_of_f(h: History, _: Sequence[FractionalStep]) -> Series:
    return h.time, maximum(h.law.f(h.q)), np.full(h.time.size, np.abs(h.law.f(np.array(_domain(h)))).max())


def _l1_of_f(h: History, _: Sequence[FractionalStep]) -> Series:
    return h.time, _l1(h, h.law.f(h.q)), _steepest(h, h.q) * _l1(h, h.q)


def _f_in_time(h: History, _: Sequence[FractionalStep]) -> Series:
    apart = _l1(h, np.diff(h.law.f(h.q), axis=0))
    return h.time[1:], apart, _pairwise(_steepest(h, h.q)) * _between(h.sums["variation"])


def _K_in_time(h: History, _: Sequence[FractionalStep]) -> Series:
    apart = _l1(h, np.diff(h.law.f(h.q), axis=0))
    return h.time[1:], maximum(np.diff(h.k, axis=0)), _pairwise(h.k.max(axis=1)) * apart


def _slope_of_K(h: History, _: Sequence[FractionalStep]) -> Series:
    top = np.maximum(h.k[:, 1:], h.k[:, :-1])  # K is monotone in a cell
    return h.time, maximum(np.diff(h.k)) / h.dx, maximum(top * h.law.f(h.q))


def _variation_of_slope(h: History, _: Sequence[FractionalStep]) -> Series:
    f = h.law.f(h.q)
    value = total_variation(_from_zero(np.diff(h.k) / h.dx))  # means of K_x over cells vary less than K_x
    return h.time, value, total_variation(h.k) * maximum(f) + h.k.max(axis=1) * total_variation(_from_zero(f))


STATEMENTS: tuple[Statement, ...] = (
    Statement("q_in_time", "H1", "‖q(t) - q(t₀)‖₁ <= ∫ TV(F) dt", (), _continuity),
    Statement("frozen_maximum", "(2.6)", "sup|F| <= sup|F(t_n)|, k frozen", (), _frozen_maximum),
    Statement("frozen_variation", "(2.7)", "TV(F) <= TV(F(t_n)), k frozen", (), _frozen_variation),
    Statement("k_in_time", "(2.9)", "sup|k(t) - k(t₀)|/|t - t₀| <= L", (), _k_in_time),
    Statement("k_x_in_time", "(2.10)", "TV(k(t) - k(t₀))/|t - t₀| <= L₁", (), _slope_of_k_in_time),
    Statement("flux_growth", "(2.13), (2.14)", "sup|F(t)| <= sup|F(0)| exp ∫ sup|k_t/k| dt", (), _flux_growth),
    Statement(
        "flux_growth_frozen", "(2.15)", "sup|F(t)| <= sup|F(0)| ∏ (1 + sup|Δk/k|), k frozen", (), _flux_growth_frozen
    ),
    Statement("refreshed_maximum", "(2.16)", "sup|F(t_n)| <= (1 + sup|Δk/k|) sup|F(t_n-)|", (), _refreshed_maximum),
    Statement(
        "refreshed_variation", "(2.17)", "TV(F(t_n)) <= (1 + sup|Δk|/inf k) TV(F(t_n-)) + sup|F| TV(Δk/k)", (),
        _refreshed_variation,
    ),
    Statement("flux_variation_growth", "after (2.17)", "TV(F(t)) <= product of (2.17)", (), _variation_growth),
    Statement(
        "variation_of_q", "(2.18)", "TV(q) <= (TV(F)/inf k + sup|F| TV(k)/(inf k)²)/f'(sup q)", (), _variation_of_q
    ),
    Statement("local_lower_bound", "(3.5)", "-q <= 1 - δ until T(δ, M)", (NONLOCAL, CLOSED, NEGATIVE), _lower),
    Statement("local_upper_bound", "(3.5)", "q <= M until T(δ, M)", (NONLOCAL, CLOSED, POSITIVE), _upper),
    Statement(
        "infimum_of_q", "(3.6)", "-inf q(t) <= -inf q(0) + ∫ sup|k_x| |f(inf q)| dt", (CLOSED, NEGATIVE), _deepest
    ),
    Statement("supremum_of_q", "(3.7)", "sup q(t) <= sup q(0) + ∫ sup|k_x| f(sup q) dt", (CLOSED, POSITIVE), _highest),
    Statement("quotients", "(3.9)", "‖q - q(· - h)‖₁/h <= TV(q)", (CLOSED,), _quotients),
    Statement(
        "growth_of_quotient", "(3.10)", "‖q - q(· - h)‖₁/h <= value at 0 + ∫ E dt/h", (CLOSED,), _growth_of_quotient
    ),
    Statement("same_k", "(3.19)", "‖q₁ - q̂‖₁ <= ‖q₁(0) - q₂(0)‖₁", (CLOSED,), _same_coefficient),
    Statement("other_k", "(3.20)", "‖q̂ - q₂‖₁ <= ∫ E dt", (NONLOCAL, CLOSED), _other_coefficient),
    Statement("k_apart", "(3.24)", "sup|k₁ - k₂| <= sup k f'(κ) ‖q₁ - q₂‖₁", (NONLOCAL, CLOSED), _k_apart),
    Statement(
        "variation_apart", "(3.25)", "TV(k₁ - k₂) <= sup k f'(κ) (1 + ‖f(q₁)‖₁) ‖q₁ - q₂‖₁", (NONLOCAL, CLOSED),
        _variation_apart,
    ),
    Statement("supremum", "(A.1)", "sup|q| <= C₀", (CLOSED,), _sup_of_q),
    Statement("supremum_of_f", "(A.2)", "sup|f(q)| <= max(|f(C₀)|, |f(κ₀)|)", (CLOSED,), _sup_of_f),
    Statement("l1_of_f", "(A.3)", "‖f(q)‖₁ <= f'(κ) ‖q‖₁", (), _l1_of_f),
    Statement("f_in_time", "(A.4)", "‖f(q(t)) - f(q(t₀))‖₁ <= f'(κ) ∫ TV(F) dt", (), _f_in_time),
    Statement("K_in_time", "(A.5)", "sup|K(t) - K(t₀)| <= sup K ‖f(q(t)) - f(q(t₀))‖₁", (NONLOCAL,), _K_in_time),
    Statement("slope_of_K", "(A.6)", "sup|K_x| <= sup K|f(q)|", (NONLOCAL,), _slope_of_K),
    Statement(
        "variation_of_K_x", "after (A.6)", "TV(K_x) <= TV(K) sup|f(q)| + sup K TV(f(q))", (NONLOCAL, CLOSED),
        _variation_of_slope,
    ),
)  # fmt: skip
