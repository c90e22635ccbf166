"""Erosion laws f(q): the erosion rate per unit grain flux at the excess slope q = u_x - 1.

Assumptions (1.4): f in C², f(0) = 0, f' > 0, f'' < 0, f -> -∞ as q -> -1, f(q)/q -> 0 as q -> ∞. Under linear growth
the last one is replaced by f' -> η0 > 0: slopes then become infinite, and the profile jumps (§11).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev

from hjprofile.errors import InputError
from hjprofile.problem.assumptions import check_assumptions
from hjprofile.problem.expressions import arithmetic
from hjprofile.problem.kinds import POSITIVE, STRIPPED, TEXT
from hjprofile.problem.lists import as_numbers
from hjprofile.problem.paths import folder_of, located
from hjprofile.problem.ranges import Array, number, shown
from hjprofile.problem.schema import as_call, choice, table_of, with_origin
from hjprofile.problem.user_code import Function, OnCopies, Sendable, load_function, over_arrays

NEAR_ZERO = 0.05  # |q| below which a polynomial gives f(q)/q: f may be a difference of numbers of order one
DEGREES = 13, 29  # of the polynomial; the first one whose last coefficients are below DIGITS times the largest
DIGITS = 1e-13
TINY = -37.0  # ln|q| below which a decay is exponential to rounding
NODES, HALVINGS = 16, 6  # nodes of a panel of a decay, and the largest number of halvings to reach DIGITS
NEWTON, LAST_MOVE = 30, 1e-14  # largest number of Newton steps per panel; size of the last step, in half panels
PROBE = np.array([0.5, -0.3, 2.0])  # slopes at which a function is tried with arrays
LINEAR = "linear"  # the growth of a law outside (1.4)
FARTHEST = 1e5  # slope beyond which f - q f' of a law of linear growth is taken as constant
_STENCIL = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])  # eighth-order central difference


class Differentiated(Sendable):
    """f' by an eighth-order central difference with steps of 1 % of 1 + q, which stay within q > -1.

    On a scale of 1 + q the truncation error is below 1e-14 for logarithms and powers, the rounding error about 1e-14.
    """

    def __call__(self, q: Any) -> Any:
        h = 0.01 * (1.0 + np.asarray(q, dtype=float))
        return sum(c * (self.f(q + k * h) - self.f(q - k * h)) for k, c in enumerate(_STENCIL, start=1)) / h


@dataclass(frozen=True, eq=False, repr=False)
class ErosionLaw:
    """An erosion law and the functions derived from it, which take and return arrays of any shape.

    `law(q)` is f(q). A law is equal to itself only. It can be pickled, unless it holds a lambda or a local function.

    Attributes:
        f: the erosion rate per unit grain flux, dimensionless, for q > -1.
        derivative: f', positive and decreasing.
        table: the `[erosion]` table of a case file that makes this law again.
        closed_inverse: f⁻¹ if it is known in closed form, else None.
        eta0: η0 = lim f' as q -> ∞: 0 for the laws of (1.4), positive for those of linear growth.
        content: a hash of the file that holds f; "" if `table` holds everything; None for a function that is in no
            file.

    >>> import hjprofile as hj
    >>> law = hj.rational()
    >>> law.name, float(law.f(1.0)), float(law.R(1.0))
    ('rational', 0.5, 2.0)
    """

    f: Function
    derivative: Function
    closed_inverse: Function | None = None
    eta0: float = 0.0
    table: Mapping[str, Any] = field(default_factory=dict, init=False)
    content: str | None = field(default=None, init=False)

    def __call__(self, q: Any) -> Array:
        """Return f(q) for a number or an array; -∞ or NaN unless q > -1. Raise InputError for other types."""
        at = as_numbers(q)
        if at is None:
            raise InputError(f"q = {shown(q)} must be a number or an array of numbers")
        with np.errstate(all="ignore"):
            return np.asarray(self.f(at), dtype=float)[()]

    def __repr__(self) -> str:
        return as_call(self.table, "law", "erosion_law") if self.table else "ErosionLaw(...)"

    def __reduce__(self) -> tuple[Any, ...]:
        if self.content == "":
            return _from_table, (dict(self.table),)
        fields = self.f, self.derivative, self.closed_inverse, self.eta0
        return type(self), fields, {"table": dict(self.table), "content": self.content}

    def __setstate__(self, origin: Mapping[str, Any]) -> None:
        vars(self).update(origin)

    @property
    def grows_linearly(self) -> bool:
        """True if slopes can become infinite and the profile can jump (§11)."""
        return self.eta0 > 0.0

    @property
    def name(self) -> str:
        """The name of the law in a case file: "rational", "log", "power", "expression" or "python"."""
        return str(self.table["law"])

    def inverse(self, y) -> Array:
        """Return f⁻¹(y), the excess slope at which f = y. Raise ValueError if y is not a value of f."""
        y = np.asarray(y, dtype=float)
        if self.closed_inverse is not None:
            q = self.closed_inverse(y)
        else:
            from scipy.optimize import elementwise

            # in v = ln(1+q), in which a law that is logarithmic at both ends is nearly linear
            def residual(v, y):
                return self.f(np.expm1(v)) - y

            bracket = elementwise.bracket_root(residual, -0.5, 0.5, xmin=-36.0, xmax=600.0, args=(y,))
            q = np.expm1(elementwise.find_root(residual, bracket.bracket, args=(y,)).x)
        if not np.all(np.isfinite(q) & (q > -1.0)):
            raise ValueError("f does not reach every requested value, so its inverse does not exist there")
        return q

    @cached_property
    def _f_over_q(self) -> Chebyshev:
        """The polynomial of f(q)/q for |q| <= NEAR_ZERO; an even number of nodes excludes q = 0 from the sample."""
        for degree in DEGREES:
            found = Chebyshev.interpolate(lambda q: self.f(q) / q, degree, domain=[-NEAR_ZERO, NEAR_ZERO])
            if np.abs(found.coef[-2:]).max() <= DIGITS * np.abs(found.coef).max():
                break
        return found

    @cached_property
    def _f_over_q_derivative(self) -> Chebyshev:
        """The derivative of `_f_over_q`."""
        return self._f_over_q.deriv()

    def R(self, q) -> Array:
        """Return R = q/f(q), increasing; R(0) = 1/f'(0). W + R(q) is constant along characteristics (§4)."""
        q = np.asarray(q, dtype=float)
        near = np.abs(q) <= NEAR_ZERO
        away = np.where(near, 1.0, q)
        R = np.asarray(away / self.f(away))
        if near.any():
            R[near] = 1.0 / self._f_over_q(q[near])
        return R

    def R_derivative(self, q) -> Array:
        """Return R'(q) = (f - q f')/f² > 0."""
        q = np.asarray(q, dtype=float)
        near = np.abs(q) <= NEAR_ZERO
        inner, away = np.clip(q, -NEAR_ZERO, NEAR_ZERO), np.where(near, 1.0, q)
        f, gain = self.f(away), away
        if self.grows_linearly:  # at large q the growth of f - q f' is slow, and its value is lost in rounding
            gain = np.minimum(away, FARTHEST)
        return np.where(
            near,
            -self._f_over_q_derivative(inner) / self._f_over_q(inner) ** 2,
            (self.f(gain) - gain * self.derivative(gain)) / f**2,
        )

    def decay(self, q0: float, distance) -> Array:
        """Return q at `distance` >= 0 to the right of a point with q = q0, where W + R(q) is constant in x.

        Solve R'(q) q_x = -q (§4); for the rational law q = q0 exp(-distance). `distance` is in exchange lengths
        and may
        have any shape.
        """
        distance = np.asarray(distance, dtype=float)
        if self.name == "rational" or q0 == 0.0:
            return q0 * np.exp(-distance)
        sign = np.sign(q0)
        rate = float(self.R_derivative(np.zeros(1))[0])
        w0 = np.log(abs(np.log1p(q0)))
        if w0 <= TINY:
            return q0 * np.exp(-distance / rate)

        # the distance x as a function of w = ln|ln(1+q)|, with x(w₀) = 0 and
        # dx/dw = -R'(q) (1+q) ln(1+q) / q, which has no singularity near the real axis, on panels that end at TINY
        def slope(w):
            v = sign * np.exp(w)
            q = np.expm1(v)
            return -self.R_derivative(q) * np.exp(v) * v / q

        edges, coefficients = _chebyshev_panels(slope, np.linspace(w0, TINY, int(np.ceil(w0 - TINY)) + 1))
        half = 0.5 * np.diff(edges)
        x = half * chebyshev.chebint(coefficients, lbnd=-1.0)
        starts = np.append(0.0, np.cumsum(chebyshev.chebval(1.0, x)))
        panel = np.clip(np.searchsorted(starts, distance.ravel(), side="right") - 1, 0, half.size - 1)
        inside = np.minimum(distance.ravel(), starts[-1]) - starts[panel]
        at = 2.0 * inside / np.diff(starts)[panel] - 1.0
        for _ in range(NEWTON):
            move = (chebyshev.chebval(at, x[:, panel], tensor=False) - inside) / (
                half[panel] * chebyshev.chebval(at, coefficients[:, panel], tensor=False)
            )
            at = np.clip(at - move, -1.0, 1.0)
            if np.all(np.abs(move) <= LAST_MOVE):
                break
        q = np.expm1(sign * np.exp(edges[panel] + half[panel] * (1.0 + at)))
        beyond = np.maximum(distance.ravel() - starts[-1], 0.0)
        return (q * np.exp(-beyond / rate)).reshape(distance.shape)


def _chebyshev_panels(function: Function, edges: Array) -> tuple[Array, Array]:
    """Return edges and Chebyshev coefficients, shape (NODES, panels), of a function; halve panels down to the error
    DIGITS.
    """
    nodes = chebyshev.chebpts1(NODES)
    to_coefficients = chebyshev.chebvander(nodes, NODES - 1).T * (2.0 / NODES)
    to_coefficients[0] *= 0.5
    for halvings in range(HALVINGS + 1):
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        coefficients = to_coefficients @ function(middle + half * nodes[:, None])
        coarse = np.abs(coefficients[-2:]).max(axis=0) > DIGITS * np.abs(coefficients).max(axis=0)
        if halvings == HALVINGS or not coarse.any():
            break
        edges = np.sort(np.append(edges, middle[coarse]))[::-1]
    return edges, coefficients


_law = partial(choice, chooser="law")


@_law("rational")
def rational() -> ErosionLaw:
    """Return the law f = q/(1+q) of the slow-erosion limit (1.5).

    >>> import hjprofile as hj
    >>> float(hj.rational().f(1.0))
    0.5
    """
    law = ErosionLaw(
        f=lambda q: q / (1.0 + q),
        derivative=lambda q: 1.0 / np.square(1.0 + q),
        closed_inverse=lambda y: np.where(y < 1.0, y / np.where(y < 1.0, 1.0 - y, 1.0), np.nan),
    )
    return with_origin(law, content="")


@_law("log")
def log() -> ErosionLaw:
    """Return the law f = ln(1+q).

    >>> import hjprofile as hj
    >>> round(float(hj.log().f(1.0)), 6)
    0.693147
    """
    law = ErosionLaw(f=np.log1p, derivative=lambda q: 1.0 / (1.0 + q), closed_inverse=np.expm1)
    return with_origin(law, content="")


@_law("power", m=POSITIVE)
def power(m: float) -> ErosionLaw:
    """Return the law f = (1 - (1+q)^-m)/m; m = 1 is the rational law, m -> 0 the logarithm.

    Args:
        m: the exponent, dimensionless, from 1e-100 to 100.

    Returns:
        The law.

    Raises:
        InputError: for another m.

    >>> import hjprofile as hj
    >>> float(hj.power(2.0).f(1.0))
    0.375
    """
    m = number("m", m)

    def inverse(y):
        less = -m * np.asarray(y)  # (1+q)^-m - 1
        return np.where(less > -1, np.expm1(-np.log1p(np.where(less > -1, less, 0.0)) / m), np.nan)

    law = ErosionLaw(
        f=lambda q: -np.expm1(-m * np.log1p(q)) / m,
        derivative=lambda q: np.exp(-(m + 1.0) * np.log1p(q)),
        closed_inverse=inverse,
    )
    return with_origin(law, content="")


@_law("expression", expression=STRIPPED, growth=TEXT)
def expression(expression: str, growth: str | None = None) -> ErosionLaw:
    """Return a law from an arithmetic expression in q.

    Args:
        expression: text with numbers, q, + - * / **, exp, log, log1p, expm1, sqrt, sin, cos, at most 1000 characters.
        growth: "linear" for a law whose slope f' tends to a positive limit (§11), else None.

    Returns:
        The law.

    Raises:
        InputError: for another expression, and for a law that violates an assumption.

    >>> import hjprofile as hj
    >>> float(hj.expression("sqrt(1+q) - 1/sqrt(1+q)").f(3.0))
    1.5
    """
    return with_origin(erosion_law(arithmetic(expression, "q").value, growth=growth), content="")


@_law("python", file=TEXT, function=TEXT, growth=TEXT)
def from_file(file: str | Path, function: str, growth: str | None = None) -> ErosionLaw:
    """Return a law from the function of that name in a Python file, which is run; `growth` as in `erosion_law`."""
    loaded = load_function(located(folder_of(file), file), function)
    return with_origin(erosion_law(loaded.function, growth=growth), content=loaded.content)


def erosion_law(
    f: Function, derivative: Function | None = None, inverse: Function | None = None, growth: str | None = None
) -> ErosionLaw:
    """Return a law from a Python function f(q).

    Args:
        f: the erosion rate per unit grain flux, a function of q > -1, for arrays of any shape or for single numbers
            (slower).
        derivative: f'; None for a difference quotient of eighth order.
        inverse: f⁻¹; None for a root finder.
        growth: "linear" for a law whose slope f' tends to η0 > 0 as q -> ∞ (§11), else None.

    Returns:
        The law.

    Raises:
        InputError: if an assumption of (1.4) is violated; for growth = "linear" the last one is f' -> η0 > 0.

    >>> import numpy as np
    >>> import hjprofile as hj
    >>> hj.erosion_law(np.log1p).eta0
    0.0
    """
    if not (growth is None or (isinstance(growth, str) and growth == LINEAR)):
        raise InputError(f"growth = {shown(growth)} must be 'linear'; leave it out for a law of sublinear growth")
    for role, function in (("f", f), ("derivative", derivative), ("inverse", inverse)):
        if not (callable(function) or (function is None and role != "f")):
            raise InputError(f"{role} = {shown(function)} must be a function of one number or array")
    vectorised = over_arrays(f, PROBE)
    slope = over_arrays(derivative, PROBE) if derivative is not None else Differentiated(vectorised)
    origin = {"file": getattr(f, "__module__", None) or "", "function": getattr(f, "__name__", "f"), "growth": growth}
    eta0 = check_assumptions(vectorised, slope, growth == LINEAR)
    law = ErosionLaw(vectorised, slope, inverse and OnCopies(inverse), eta0)
    return with_origin(law, table=table_of(from_file, origin))


def _from_table(table: Mapping[str, Any]) -> ErosionLaw:
    """Return the law of a table that holds everything."""
    laws: tuple[Any, ...] = rational, log, power, expression
    makers = {maker.choice.name: maker for maker in laws}
    found: ErosionLaw = makers[table["law"]](**{key: value for key, value in table.items() if key != "law"})
    return found
