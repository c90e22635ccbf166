"""Erosion laws f(q): the erosion rate per unit grain flux of a slope of excess q = u_x - 1.

Assumptions [eq:f]: f in C², f(0) = 0, f' > 0, f'' < 0, f -> -∞ as q -> -1, f(q)/q -> 0 as q -> ∞. A law with
growth "linear" instead of the last has f' -> η0 > 0: slopes then become infinite, and the profile jumps (theory, §14).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev

from hjprofile.errors import InputError, did_you_mean
from hjprofile.problem.expressions import arithmetic
from hjprofile.problem.python_files import content_of
from hjprofile.problem.ranges import number, shown

Array = np.ndarray
Function = Callable[[Any], Any]

NEAR_ZERO = 0.05  # |q| below which f(q)/q is read from a polynomial: f may be a difference of numbers of order one
DEGREES = 13, 29  # of the polynomial: the first whose last coefficients are below DIGITS of the largest
DIGITS = 1e-13
TINY = -37.0  # ln|q| below which a decay is exponential to rounding
NODES, HALVINGS = 16, 6  # of a panel of a decay, and how often it is halved at most for DIGITS
NEWTON, LAST_MOVE = 30, 1e-14  # most steps to invert a panel, and the last of them, in parts of half a panel
# headings of the page on errors
UNREADABLE, PYTHON, NO_LAW = "a-file-that-cannot-be-read", "a-python-file", "what-a-law-must-be"
LINEAR = "linear"  # the growth of a law outside [eq:f]
FAR = 1e100, 1e50, 1e30, 1e15  # slopes at which f' is looked for its limit: the largest where f is finite, and the next
FARTHEST = 1e5  # slopes beyond which f - q f' of a law of linear growth is taken as constant
LIMIT = 1e-10  # relative difference of f' at the two up to which it has one
_STENCIL = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])  # eighth-order central difference


def differentiate(f: Function) -> Function:
    """f' by an eighth-order central difference with steps of 1 % of 1 + q, so that it never leaves q > -1.

    On a scale of 1 + q truncation is below 1e-14 for logarithms and powers, rounding about 1e-14.
    """

    def derivative(q):
        h = 0.01 * (1.0 + np.asarray(q, dtype=float))
        return sum(c * (f(q + k * h) - f(q - k * h)) for k, c in enumerate(_STENCIL, start=1)) / h

    return derivative


@dataclass(frozen=True)
class ErosionLaw:
    """An erosion function with all that is derived from it; every function takes and returns arrays.

    Attributes:
        f: the erosion function, defined for q > -1.
        derivative: f', positive and decreasing.
        table: the `[erosion]` table of a case file that makes this law again.
        closed_inverse: f⁻¹ where it is known in closed form.
        eta0: η0 = lim f' as q -> ∞: 0 for the laws of [eq:f], positive for those of linear growth.
        content: a hash of the file that holds f; "" where `table` holds everything; None for a function of no file.
    """

    f: Function
    derivative: Function
    table: Mapping[str, Any] = field(default_factory=dict)
    closed_inverse: Function | None = None
    eta0: float = 0.0
    content: str | None = None

    @property
    def grows_linearly(self) -> bool:
        """Whether slopes can become infinite and the profile can jump (theory, §14)."""
        return self.eta0 > 0.0

    @property
    def name(self) -> str:
        """The law's name in a case file: "rational", "log", "power", "expression" or "python"."""
        return str(self.table["law"])

    def inverse(self, y) -> Array:
        """f⁻¹(y): the excess slope at which erosion is y. Raises ValueError where y is not a value of f."""
        y = np.asarray(y, dtype=float)
        if self.closed_inverse is not None:
            q = self.closed_inverse(y)
        else:
            from scipy.optimize import elementwise

            # in v = ln(1+q), where a law that is logarithmic at both ends is nearly straight
            def residual(v, y):
                return self.f(np.expm1(v)) - y

            bracket = elementwise.bracket_root(residual, -0.5, 0.5, xmin=-36.0, xmax=600.0, args=(y,))
            q = np.expm1(elementwise.find_root(residual, bracket.bracket, args=(y,)).x)
        if not np.all(np.isfinite(q) & (q > -1.0)):
            raise ValueError("f does not reach every requested value, so its inverse does not exist there")
        return q

    @cached_property
    def _f_over_q(self) -> Chebyshev:
        """f(q)/q for |q| <= NEAR_ZERO; an even number of nodes keeps q = 0 out of the sample."""
        for degree in DEGREES:
            found = Chebyshev.interpolate(lambda q: self.f(q) / q, degree, domain=[-NEAR_ZERO, NEAR_ZERO])
            if np.abs(found.coef[-2:]).max() <= DIGITS * np.abs(found.coef).max():
                break
        return found

    @cached_property
    def _f_over_q_derivative(self) -> Chebyshev:
        return self._f_over_q.deriv()

    def R(self, q) -> Array:
        """R = q/f(q), increasing; R(0) = 1/f'(0). W + R(q) is constant along characteristics (theory, §4)."""
        q = np.asarray(q, dtype=float)
        near = np.abs(q) <= NEAR_ZERO
        away = np.where(near, 1.0, q)
        return np.where(near, 1.0 / self._f_over_q(np.clip(q, -NEAR_ZERO, NEAR_ZERO)), away / self.f(away))

    def R_derivative(self, q) -> Array:
        """R'(q) = (f - q f')/f² > 0."""
        q = np.asarray(q, dtype=float)
        near = np.abs(q) <= NEAR_ZERO
        inner, away = np.clip(q, -NEAR_ZERO, NEAR_ZERO), np.where(near, 1.0, q)
        f, gain = self.f(away), away
        if self.grows_linearly:  # f - q f' grows, slowly at last, and far out is lost in rounding
            gain = np.minimum(away, FARTHEST)
        return np.where(
            near,
            -self._f_over_q_derivative(inner) / self._f_over_q(inner) ** 2,
            (self.f(gain) - gain * self.derivative(gain)) / f**2,
        )

    def decay(self, q0: float, distance) -> Array:
        """q at `distance` >= 0 to the right of a place with q = q0, where W + R(q) is constant in x.

        Solves R'(q) q_x = -q (theory, §4); for the rational law q = q0 exp(-distance). `distance` may have any shape.
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
    """Return edges and Chebyshev coefficients, shape (NODES, panels), of a function, halving panels for DIGITS."""
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


def rational() -> ErosionLaw:
    """f = q/(1+q), the law of the slow-erosion limit [fex]."""
    return ErosionLaw(
        f=lambda q: q / (1.0 + q),
        derivative=lambda q: 1.0 / np.square(1.0 + q),
        table={"law": "rational"},
        closed_inverse=lambda y: np.where(y < 1.0, y / np.where(y < 1.0, 1.0 - y, 1.0), np.nan),
        content="",
    )


def log() -> ErosionLaw:
    """f = ln(1+q)."""
    return ErosionLaw(
        f=np.log1p,
        derivative=lambda q: 1.0 / (1.0 + q),
        table={"law": "log"},
        closed_inverse=np.expm1,
        content="",
    )


def power(m: float) -> ErosionLaw:
    """f = (1 - (1+q)^-m)/m with m > 0; m = 1 is the rational law, m -> 0 the logarithm.

    Raises InputError unless 1e-100 <= m <= 100.
    """
    m = number("m", m)

    def inverse(y):
        less = -m * np.asarray(y)  # (1+q)^-m - 1
        return np.where(less > -1, np.expm1(-np.log1p(np.where(less > -1, less, 0.0)) / m), np.nan)

    return ErosionLaw(
        f=lambda q: -np.expm1(-m * np.log1p(q)) / m,
        derivative=lambda q: np.exp(-(m + 1.0) * np.log1p(q)),
        table={"law": "power", "m": m},
        closed_inverse=inverse,
        content="",
    )


def expression(text: str, growth: str | None = None) -> ErosionLaw:
    """A law from an arithmetic expression in q: numbers, + - * / **, exp, log, log1p, expm1, sqrt.

    Raises InputError for anything else, and for a law that breaks an assumption. `growth` as in `erosion_law`.
    """
    f = arithmetic(text, "q").value
    table = {"law": "expression", "expression": text.strip()}
    return replace(erosion_law(f, table=table, growth=growth), content="")


def erosion_law(
    f: Function, derivative: Function | None = None, inverse: Function | None = None, table: Mapping | None = None,
    growth: str | None = None,
) -> ErosionLaw:  # fmt: skip
    """A law from a Python function of q; f' and the inverse are derived where they are not given.

    `f` may take arrays, or single numbers only (slower). Raises InputError if an assumption of [eq:f] is broken. With
    growth = "linear" the last of them is replaced by f' -> η0 > 0 (theory, §14).
    """
    if not (growth is None or (isinstance(growth, str) and growth == LINEAR)):
        raise InputError(f"growth = {shown(growth)} must be 'linear', or left out for a law of sublinear growth")
    for role, function in (("f", f), ("derivative", derivative), ("inverse", inverse)):
        if not (callable(function) or (function is None and role != "f")):
            raise InputError(f"{role} = {shown(function)} must be a function of one number or array")
    name = getattr(f, "__name__", "f")
    vectorised = _over_arrays(f)
    law = ErosionLaw(
        f=vectorised,
        derivative=_over_arrays(derivative) if derivative is not None else differentiate(vectorised),
        table=dict(table or {"law": "python", "file": getattr(f, "__module__", ""), "function": name})
        | ({"growth": growth} if growth else {}),
        closed_inverse=inverse and _of_a_copy(inverse),
    )
    check_assumptions(law, growth)
    return replace(law, eta0=_slope_at_infinity(law)) if growth else law


def from_file(path: Path, function: str, file: str | None = None, growth: str | None = None) -> ErosionLaw:
    """A law from the function of that name in a Python file, which is run; `growth` as in `erosion_law`."""
    loaded = load_function(path, function)
    table = {"law": "python", "file": file or str(path), "function": function}
    return replace(erosion_law(loaded.function, table=table, growth=growth), content=loaded.content)


def located(base: Path, file: str | Path) -> Path:
    """Return the path of a file that a case names, relative to the folder `base`; ~ is the home folder."""
    path = Path(file)
    with suppress(RuntimeError):  # there is no such home
        path = path.expanduser()
    return base / path


def require_file(path: Path) -> None:
    """Raises InputError unless `path` is a file; a folder has nothing to read, a pipe or a device may have no end."""
    try:
        there = path.is_file()
    except OSError as error:  # a name too long, a folder that may not be entered
        raise InputError(f"file = {str(path)!r} cannot be read: {error.strerror}", UNREADABLE) from None
    if not there:
        beside: list[str] = []
        with suppress(OSError, ValueError, NotImplementedError):  # no such folder, one that may not be entered, a NUL
            beside = [other.name for other in path.parent.glob(f"*{path.suffix}") if other.is_file()]
        hint = did_you_mean(path.name, beside)
        raise InputError(f"file = {str(path)!r} does not exist, or is not a file{hint}", UNREADABLE)


class Loaded(NamedTuple):
    """A function from a file, and the hash of the file."""

    function: Function
    content: str


def load_function(path: Path, function: str) -> Loaded:
    """Return the function of that name in a Python file. Running the file runs its author's code.

    The bytes that are hashed are those that are run, because Python's own cache of compiled files misses an edit
    within a second.
    """
    require_file(path)
    spec = importlib.util.spec_from_file_location(f"hjprofile_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"file = {str(path)!r} is not a Python file (.py)", PYTHON)
    module = importlib.util.module_from_spec(spec)
    try:
        source = path.read_bytes()
        content = content_of(path, source)
        exec(compile(source, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:
        raise InputError(f"file = {str(path)!r} could not be run: {type(error).__name__}: {error}", PYTHON) from error
    f = getattr(module, function, None)
    if not callable(f):
        raise InputError(f"function = {function!r} is not defined in {path.name}", PYTHON)
    return Loaded(f, content)


def _of_a_copy(f: Function) -> Function:
    """Return f with a copy of its argument, into which it may write."""
    return lambda q: f(np.array(q, dtype=float))


def _over_arrays(f: Function) -> Function:
    """Return f if it maps arrays element by element, else a loop over it; either works on a copy of its argument."""
    probe = np.array([0.5, -0.3, 2.0])
    try:
        values = np.asarray(f(probe.copy()), dtype=float)
        if values.shape == probe.shape and np.allclose(
            values, [float(f(float(q))) for q in probe], rtol=1e-12, atol=0, equal_nan=True
        ):
            return _of_a_copy(f)
    except Exception:  # whatever a scalar function raises when it is handed an array
        pass
    looped = np.vectorize(f, otypes=[float])
    return lambda q: looped(q)


def _slope_at_infinity(law: ErosionLaw) -> float:
    """lim f' as q -> ∞, or 0 where f' has not settled at a positive limit; read off f/q, which is exact so far out."""
    q = np.array(FAR)
    with np.errstate(all="ignore"):
        f, slopes = np.asarray(law.f(q), dtype=float), np.asarray(law.derivative(q), dtype=float)
    finite = np.isfinite(f) & np.isfinite(slopes)
    far, mean = slopes[finite], (f / q)[finite]
    settled = far.size > 1 and far[0] > 0.0 and max(abs(far[:2] - mean[0])) <= LIMIT * far[0]
    return float(mean[0]) if settled else 0.0


CONCAVE = "f must be concave: each further bit of steepness adds less"


def check_assumptions(law: ErosionLaw, growth: str | None = None) -> None:
    """Raises InputError naming the assumption that the law breaks, of [eq:f] or of growth "linear", and a q where."""
    v = np.linspace(np.log(1e-8), np.log(1e8), 4001)  # ln(1+q)
    q = np.expm1(v)
    try:
        with np.errstate(all="ignore"):
            f, df = np.asarray(law.f(q), dtype=float), np.asarray(law.derivative(q), dtype=float)
            f0 = float(law.f(np.array(0.0)))
    except Exception as error:
        raise InputError(f"the law cannot be evaluated: {type(error).__name__}: {error}") from error

    def refuse(assumption: str, where: float, because: str) -> None:
        raise InputError(
            f"the law is not an erosion function: {assumption} fails at q = {where:.10g}; {because}", NO_LAW
        )

    if not np.isfinite(f0) or abs(f0) > 1e-12:
        because = "at the critical slope nothing erodes or settles" if np.isfinite(f0) else "f must be a number there"
        raise InputError(
            f"the law is not an erosion function: f(0) = 0 fails at q = 0, where f = {f0:.6g}; {because}", NO_LAW
        )
    limit = 0.0
    if growth == LINEAR:
        limit = _slope_at_infinity(law)
        if not limit:
            raise InputError(
                "the law has not the growth = 'linear' that it is given: its slope f' does not settle at a positive "
                "limit as q -> infinity; leave growth out if it tends to 0"
            )
        df = df - limit  # concave towards a line: what is positive and falls is f' - η0
    # A derivative found by differences carries rounding of about 1e-14 f/(1+q); far below it nothing can be said.
    resolved = np.abs(df) > 1e-9 * np.abs(f) / (1 + q)
    flat = (df <= 0) & (resolved | (q < 20))
    if limit and flat.any():
        refuse("f'' < 0", q[np.argmax(flat)], CONCAVE)
    middle = v.size // 2  # q = 0
    if 0 < df[middle] * (1 + 1e-6) < df[middle + 1]:
        refuse("f'' < 0", 0.0, CONCAVE)
    if flat.any():
        turned = df[middle] < 0 and "its sign is wrong, f must be positive where q > 0"
        refuse("f' > 0", q[np.argmax(flat)], turned or "f must increase: a steeper slope erodes more")
    rising = (df[1:] >= df[:-1] * (1 - 1e-10)) & resolved[1:] & resolved[:-1]

    def refuse_convexity(within: Array) -> None:
        at = np.flatnonzero(rising & within)
        if at.size:
            refuse("f'' < 0", q[at[np.argmin(np.abs(v[at]))]], CONCAVE)

    # (1+q) f' is the slope of f in ln(1+q): where it dies out towards q = -1, f has a finite limit there.
    slope = (1 + q) * df
    if slope[0] < 0.5 * np.interp(np.log(1e-4), v, slope):
        refuse("f -> -infinity as q -> -1", q[0], "no slope may become flat, so f falls without bound, as q/(1+q) does")
    refuse_convexity(q[1:] < 100)
    broken = ~(np.isfinite(f) & np.isfinite(df))
    if broken.any():
        where = q[np.argmax(broken)]
        refuse("that f is finite with a derivative for every q > -1", where, "any slope may occur on the way")
    if not limit and df[-1] > 0.5 * np.interp(np.log(1e4), v, df):
        raise InputError(
            "the law is not an erosion function: f(q)/q -> 0 as q -> infinity (sublinear growth) fails at "
            f"q = {q[-1]:.10g}; a law whose slope f' tends to a positive limit is admitted with growth = 'linear'",
            NO_LAW,
        )
    refuse_convexity(q[1:] >= 100)
    number("f'(0)", df[middle] + limit, NO_LAW)
