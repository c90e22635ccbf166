"""A coefficient k(t, x) > 0 that is prescribed in place of the nonlocal factor: q_t + (k f(q))_x = 0 [eq:fixed_k]."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem.expressions import arithmetic
from hjprofile.problem.kinds import STRIPPED, TEXT
from hjprofile.problem.paths import located
from hjprofile.problem.ranges import RANGES, Array, as_path, shown
from hjprofile.problem.schema import choice, table_of
from hjprofile.problem.stored import read_profile
from hjprofile.problem.units import Units
from hjprofile.problem.user_code import evaluating, load_function, over_arrays

PROBE = np.array([[0.0], [0.25]]), np.array([-0.5, -0.25, 0.0])  # (t, x): does a function take arrays?


@dataclass(frozen=True)
class Coefficient:
    """k(t, x), which the flux k f(q) has for a factor (theory, §9).

    Attributes:
        function: (t, x) -> k, for arrays that broadcast against each other.
        table: the `[coefficient]` table of a case file that makes it again.
        steady: whether k is known not to depend on t.
        left, end: where k is known: for left <= x <= 0, 0 <= t <= end.
        content: a hash of the file or of the values that hold k; "" where `table` holds everything; None for a
            function of no file.
        units: of the survey on whose slope k was found, else None.
    """

    function: Callable[[Any, Any], Any]
    table: Mapping[str, Any]
    steady: bool = False
    left: float = -np.inf
    end: float = np.inf
    content: str | None = None
    units: Units | None = None

    def values(self, t: Any, x: Any) -> Array:
        """k at times t and places x, arrays that broadcast against each other.

        Raises RunError, which says where, if k is not a positive number.
        """
        t, x = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
        with evaluating("the coefficient", RunError):
            k = np.asarray(self.function(t.copy(), x.copy()), dtype=float)  # it may write into its arguments
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
        """Raises InputError unless k is known on these nodes up to `end`, and positive there at either end of time."""
        if self.left > x[0] + 1e-9 * abs(x[0]):
            raise InputError(f"the coefficient is known from x = {self.left:g} on, and the domain begins at {x[0]:g}")
        if self.end < end * (1.0 - 1e-9):
            raise InputError(f"the coefficient is known until t = {self.end:g}, and the run ends at {end:g}")
        try:
            for t in (0.0, end):
                self.values(t, x)
        except RunError as error:
            raise InputError(str(error)) from None


def coefficient(k: str | Callable[..., Any]) -> Coefficient:
    """A coefficient from an expression in t and x, or from a Python function k(t, x), or k(x) where time is no matter.

    The function may take arrays that broadcast, or single numbers only (slower). An expression is made of numbers,
    + - * / **, exp, log, log1p, expm1, sqrt. Raises InputError for anything else.
    """
    if isinstance(k, str):
        return from_expression(k)
    if not callable(k):
        raise InputError(f"coefficient = {shown(k)} must be a function of t and x, or an expression in them")
    table = table_of(from_file, {"file": getattr(k, "__module__", None) or "", "function": getattr(k, "__name__", "k")})
    try:
        steady = len(inspect.signature(k).parameters) == 1
    except (TypeError, ValueError):  # compiled functions need not say what they take
        steady = False
    return Coefficient(over_arrays((lambda t, x: k(x)) if steady else k, *PROBE), table, steady)


@choice("expression", expression=STRIPPED)
def from_expression(expression: str) -> Coefficient:
    """A coefficient from an expression in t and x."""
    checked = arithmetic(expression, "t", "x")
    return Coefficient(checked.value, {}, "t" not in checked.used, content="")


@choice("python", file=TEXT, function=TEXT)
def from_file(file: str | Path, function: str, base: Path | None = None) -> Coefficient:
    """A coefficient from the function of that name in a Python file, which is run."""
    loaded = load_function(located(base or Path(), file), function)
    return replace(coefficient(loaded.function), content=loaded.content)


@choice("run", result=TEXT)
def stored_coefficient(result: str | Path, base: Path = Path()) -> Coefficient:
    """The factor K of a run that was stored in a result folder, as a coefficient.

    ln K is linear in t and in x between the saved times and the nodes. Raises InputError if there is no such run.
    """
    path = located(base, as_path("result", result)) / "profile.nc"
    try:
        arrays, attributes = read_profile(path)
        names = [field.name for field in fields(Units)]
        units = Units(*(float(attributes[name]) for name in names)) if names[0] in attributes else None
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
    return replace(tabulated(time, x, K), units=units)


def tabulated(time: Array, x: Array, k: Array) -> Coefficient:
    """The coefficient of values k, shape (times, places), at increasing times and places, ln k linear between."""
    ln_k = np.log(k)

    def between(t: Array, at: Array) -> Array:
        (j, after), (i, right) = _place(time, t), _place(x, at)
        first = int(np.min(j))
        rows = ln_k[first : int(np.max(j)) + 2]
        across = (1.0 - right) * rows[:, i] + right * rows[:, i + 1]  # in x first: times are few, places many
        j = j - first
        next_j = np.minimum(j + 1, len(rows) - 1)
        if at.ndim == 1 and t.shape[-1:] in ((), (1,)):
            before, behind = (across[k.reshape(t.shape[:-1])] for k in (j, next_j))
        else:
            places = np.indices(at.shape, sparse=True)
            before, behind = across[(j, *places)], across[(next_j, *places)]
        return np.exp((1.0 - after) * before + after * behind)

    content = hashlib.sha256(b"".join(values.tobytes() for values in (time, x, ln_k))).hexdigest()
    table = table_of(stored_coefficient, {"result": ""})
    return Coefficient(between, table, time.size == 1, float(x[0]), float(time[-1]), content)


def _place(knots: Array, at: Array) -> tuple[Array, Array]:
    """The interval between knots, and the part of it that lies before `at`; what lies outside is brought to an end."""
    at = np.clip(at, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, at, "right") - 1, 0, max(knots.size - 2, 0))
    width = knots[np.minimum(i + 1, knots.size - 1)] - knots[i]
    return i, np.divide(at - knots[i], width, out=np.zeros_like(at), where=width > 0.0)
