"""Coefficients k(t, x) > 0 that are prescribed in place of the grain flux K: q_t + (k f(q))_x = 0 (2.1)."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem.expressions import arithmetic
from hjprofile.problem.kinds import STRIPPED, TEXT
from hjprofile.problem.paths import folder_of, located
from hjprofile.problem.ranges import RANGES, Array, as_path, brief, shown
from hjprofile.problem.schema import as_call, choice, table_of, with_origin
from hjprofile.problem.stored import read_profile
from hjprofile.problem.units import Units
from hjprofile.problem.user_code import Sendable, evaluating, load_function, over_arrays

PROBE = np.array([[0.0], [0.25]]), np.array([-0.5, -0.25, 0.0])  # (t, x) at which a function is tried with arrays


@dataclass(frozen=True, eq=False, repr=False)
class Coefficient:
    """A coefficient k(t, x) of the flux k f(q) (§7).

    Attributes:
        function: (t, x) -> k, for arrays that broadcast; t is the supplied mass, x is in exchange lengths.
        table: the `[coefficient]` table of a case file that makes this coefficient again.
        steady: True if k is known not to depend on t.
        left, end: the range in which k is known: left <= x <= 0, 0 <= t <= end.
        content: a hash of the file or of the values that hold k; "" if `table` holds everything; None for a function
            that is in no file.
        units: the units of the survey for which k was found, else None.

    >>> import hjprofile as hj
    >>> hj.coefficient("exp(-0.2*x)").steady
    True
    """

    function: Callable[[Any, Any], Any]
    steady: bool = False
    left: float = -np.inf
    end: float = np.inf
    units: Units | None = None
    table: Mapping[str, Any] = field(default_factory=dict, init=False)
    content: str | None = field(default=None, init=False)

    def __repr__(self) -> str:
        if "expression" in self.table:
            return f"coefficient({brief(self.table['expression'])})"
        if "result" in self.table:
            return f"stored_coefficient({brief(self.table['result'])})"
        return as_call(self.table, "kind", "coefficient")

    def __reduce__(self) -> tuple[Any, ...]:
        if self.content == "":
            return coefficient, (self.table["expression"],)
        fields = self.function, self.steady, self.left, self.end, self.units
        return type(self), fields, {"table": dict(self.table), "content": self.content}

    def __setstate__(self, origin: Mapping[str, Any]) -> None:
        vars(self).update(origin)

    def values(self, t: Any, x: Any) -> Array:
        """Return k at times t and positions x, arrays that broadcast; the result has their common shape.

        Raise RunError with t and x if k is not a positive number there.
        """
        t, x = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
        with evaluating("the coefficient", RunError):
            k = np.asarray(self.function(t.copy(), x.copy()), dtype=float)  # the function may write into its arguments
        with np.errstate(all="ignore"):
            k = np.array(np.broadcast_to(k, np.broadcast_shapes(t.shape, x.shape)))
            wrong = ~RANGES["k"].holds(k)
        if wrong.any():
            at = np.unravel_index(np.argmax(wrong), k.shape)
            t, x = np.broadcast_arrays(t, x)
            raise RunError(
                f"the coefficient k = {k[at]:.6g} at t = {t[at]:.6g}, x = {x[at]:.6g} is not {RANGES['k'].words}"
            )
        return k

    def check(self, x: Array, end: float) -> None:
        """Raise InputError unless k is known on these nodes up to `end`, and positive there at t = 0 and t = `end`."""
        if self.left > x[0] + 1e-9 * abs(x[0]):
            raise InputError(f"the coefficient is known from x = {self.left:g} on, but the domain begins at {x[0]:g}")
        if self.end < end * (1.0 - 1e-9):
            raise InputError(f"the coefficient is known until t = {self.end:g}, but the run ends at {end:g}")
        try:
            for t in (0.0, end):
                self.values(t, x)
        except RunError as error:
            raise InputError(str(error)) from None


def coefficient(k: str | Callable[..., Any]) -> Coefficient:
    """Return a prescribed coefficient k, the factor of the flux k f(q).

    Args:
        k: an arithmetic expression in t and x with + - * / **, exp, log, log1p, expm1, sqrt, sin, cos; or a Python
            function k(t, x) or k(x) of arrays that broadcast, or of single numbers (slower). t is the supplied mass, x
            is in exchange lengths.

    Returns:
        The coefficient.

    Raises:
        InputError: for another expression or another type.

    >>> import hjprofile as hj
    >>> float(hj.coefficient("1 + t").values(0.5, -1.0))
    1.5
    """
    if isinstance(k, str):
        return from_expression(k)
    if not callable(k):
        raise InputError(f"coefficient = {shown(k)} must be a function of t and x, or an expression in them")
    table = table_of(from_file, {"file": getattr(k, "__module__", None) or "", "function": getattr(k, "__name__", "k")})
    try:
        steady = len(inspect.signature(k).parameters) == 1
    except (TypeError, ValueError):  # compiled functions need not have a signature
        steady = False
    return with_origin(Coefficient(over_arrays(_OfPlace(k) if steady else k, *PROBE), steady), table=table)


class _OfPlace(Sendable):
    """A function of x as one of t and x."""

    def __call__(self, t: Any, x: Any) -> Any:
        return self.f(x)


@choice("expression", expression=STRIPPED)
def from_expression(expression: str) -> Coefficient:
    """Return a coefficient from an expression in t and x."""
    checked = arithmetic(expression, "t", "x")
    return with_origin(Coefficient(checked.value, "t" not in checked.used), content="")


@choice("python", file=TEXT, function=TEXT)
def from_file(file: str | Path, function: str) -> Coefficient:
    """Return a coefficient from the function of that name in a Python file, which is run."""
    loaded = load_function(located(folder_of(file), file), function)
    return with_origin(coefficient(loaded.function), content=loaded.content)


@choice("run", result=TEXT)
def stored_coefficient(result: str | Path) -> Coefficient:
    """Return the grain flux K of a stored run as a prescribed coefficient.

    ln K is linear in t and in x between the saved times and the nodes.

    Args:
        result: the result folder of the run.

    Returns:
        The coefficient, known on the domain and up to the end of that run.

    Raises:
        InputError: if the folder holds no run, or none that begins at t = 0 with K > 0.

    >>> import hjprofile as hj
    >>> try:
    ...     hj.stored_coefficient("no such folder")
    ... except hj.InputError:
    ...     print("not a result folder")
    not a result folder
    """
    path = located(folder_of(result), as_path("result", result)) / "profile.nc"
    try:
        arrays, attributes = read_profile(path)
        units = Units.from_attributes(attributes)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"result = {str(result)!r} is not a result folder: {path} cannot be read: {why}") from None
    except ValueError as error:
        raise InputError(f"result = {str(result)!r}: {path.parent} is not a stored run: {error}") from None
    time, x, K = arrays["time"], arrays["x"], arrays["K"]
    if not np.all(K > 0.0):
        raise InputError(f"result = {str(result)!r} holds no positive K at its saved times and nodes")
    if time[0] > 0.0:
        raise InputError(f"result = {str(result)!r} begins at t = {time[0]:g}; K is needed from t = 0 on")
    return with_origin(tabulated(time, x, K), units=units)


def tabulated(time: Array, x: Array, k: Array) -> Coefficient:
    """Return the coefficient of values k, shape (times, positions), at increasing times and positions; ln k is linear
    between.
    """
    found = _Tabulated(time, x, np.log(k))
    content = hashlib.sha256(b"".join(values.tobytes() for values in (time, x, found.ln_k))).hexdigest()
    table = table_of(stored_coefficient, {"result": ""})
    known = Coefficient(found, time.size == 1, float(x[0]), float(time[-1]))
    return with_origin(known, table=table, content=content)


@dataclass(frozen=True, eq=False)
class _Tabulated:
    """A function of t and x between values."""

    time: Array
    x: Array
    ln_k: Array

    def __call__(self, t: Array, at: Array) -> Array:
        (j, after), (i, right) = _place(self.time, t), _place(self.x, at)
        first = int(np.min(j))
        rows = self.ln_k[first : int(np.max(j)) + 2]
        across = (1.0 - right) * rows[:, i] + right * rows[:, i + 1]  # in x first: few times, many positions
        j = j - first
        next_j = np.minimum(j + 1, len(rows) - 1)
        if at.ndim == 1 and t.shape[-1:] in ((), (1,)):
            before, behind = (across[k.reshape(t.shape[:-1])] for k in (j, next_j))
        else:
            places = np.indices(at.shape, sparse=True)
            before, behind = across[(j, *places)], across[(next_j, *places)]
        return np.exp((1.0 - after) * before + after * behind)


def _place(knots: Array, at: Array) -> tuple[Array, Array]:
    """Return the interval between knots, and the part of it before `at`; move values outside to the nearest end."""
    at = np.clip(at, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, at, "right") - 1, 0, max(knots.size - 2, 0))
    width = knots[np.minimum(i + 1, knots.size - 1)] - knots[i]
    return i, np.divide(at - knots[i], width, out=np.zeros_like(at), where=width > 0.0)
