"""A state of a run at one time, and time series at positions, with their interpolation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.lists import as_numbers
from hjprofile.problem.profiles import Points, Profile, steps
from hjprofile.problem.ranges import SAME_TIME, Array, as_index, as_number, read_only, shown
from hjprofile.problem.units import Units
from hjprofile.solvers.stop import Reason, Stop, Time

ABOUT = "a-state-of-a-run"  # heading of the page on errors


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A state of a run at one time. Its arrays are read-only; copies are writable.

    Attributes:
        t: the supplied mass.
        x, x_cell: nodes (cells + 1,) and midpoints of cells (cells,), in exchange lengths.
        u: height on the nodes, in exchange lengths times the critical slope.
        q: cell means of u_x - 1, shape (cells,).
        K: grain flux on the nodes, relative to the supply.
        kinks: positions of the kinks, from left to right; None between saved times.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
    >>> hj.track_fronts(problem, hj.Grid(-5.0, 100)).at(0.0)
    Snapshot at t = 0: 100 cells on [-5, 0]
    """

    t: float
    x: Array
    x_cell: Array
    u: Array
    q: Array
    K: Array
    kinks: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _protect(self, "x", "x_cell", "u", "q", "K")

    def __repr__(self) -> str:
        return f"Snapshot at t = {self.t:g}: {self.q.size} cells on [{self.x[0]:g}, {self.x[-1] + 0.0:g}]"


@dataclass(frozen=True, eq=False)
class Gauges:
    """Time series at positions. Its arrays are read-only; copies are writable.

    Attributes:
        x: the positions, in exchange lengths.
        time: the saved times, shape (times,).
        u, q, K: height, excess slope and grain flux, shape (times, *x.shape).
    """

    x: Array
    time: Array
    u: Array
    q: Array
    K: Array

    def __post_init__(self) -> None:
        _protect(self, "x", "time", "u", "q", "K")

    def __repr__(self) -> str:
        return f"Gauges at {self.x.size} positions x, {self.time.size} times"


Callback = Callable[[float, Snapshot], Any]


def stopped_by(callback: Callback, state: Snapshot) -> Stop | None:
    """Show a state to a callback; return the reason to stop if it returns True."""
    answer = callback(state.t, state)
    if not (isinstance(answer, (bool, np.bool_)) and answer):
        return None
    values = {"name": name_of(callback), "t": Time(state.t)}
    return Stop(Reason.CALLBACK, "{name} returned True at t = {t:.6g}", values=values)


def name_of(callback: Callback) -> str:
    """Return the name of a function, or an object that is called as it is written."""
    return str(getattr(callback, "__name__", None) or repr(callback))


def _protect(holder: Any, *names: str) -> None:
    for name in names:
        object.__setattr__(holder, name, read_only(getattr(holder, name)))


def place_in_time(time: Array, t: Any) -> tuple[int, float]:
    """Return the saved time before t and the fraction of its interval up to t; 0 at a saved time.

    Raise InputError if t is not a number between the first and the last saved time.
    """
    asked = as_number(t)
    first, last = float(time[0]), float(time[-1])
    same = SAME_TIME * last
    if not first - same <= asked <= last + same:
        raise InputError(
            f"t = {shown(t)} must be a number from {first:g} to {last:g}, the saved times of the run", ABOUT
        )
    nearest = int(np.argmin(np.abs(time - asked)))
    if abs(float(time[nearest]) - asked) <= same:
        return nearest, 0.0
    before = int(np.searchsorted(time, asked)) - 1
    return before, (asked - float(time[before])) / float(time[before + 1] - time[before])


def row_at(place: tuple[int, float], values: Array, logarithmic: bool = False) -> Array:
    """Return the row of values, shape (times, n), at a place in time."""
    before, part = place
    return values[before] if part == 0.0 else _between(values[before], values[before + 1], part, logarithmic)


def columns_at(knots: Array, x: Array, values: Array, logarithmic: bool = False) -> Array:
    """Return the columns of values, shape (times, knots), at positions x; constant beyond the first and last knot."""
    at = np.clip(x, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    part = (at - knots[i]) / (knots[i + 1] - knots[i])
    return _between(values[:, i], values[:, i + 1], part, logarithmic)


def _between(before: Array, after: Array, part: Array | float, logarithmic: bool) -> Array:
    """Return values between two, linear, or linear in the logarithm where both are positive."""
    linear = (1.0 - part) * before + part * after
    if not logarithmic:
        return linear
    positive = (before > 0.0) & (after > 0.0)
    logs = (np.log(np.where(positive, value, 1.0)) for value in (before, after))
    return np.where(positive, np.exp((1.0 - part) * next(logs) + part * next(logs)), linear)


def positions_in(nodes: Array, x: float | Sequence[float] | Array) -> Array:
    """Return positions as an array of any shape. Raise InputError unless they are numbers on the domain."""
    at = as_numbers(x)
    if at is None:
        raise InputError(f"x = {shown(x)} must be a number or an array of numbers", ABOUT)
    wrong = ~((at >= nodes[0]) & (at <= nodes[-1]))
    if wrong.any():
        raise InputError(
            f"x holds {at[wrong].flat[0]:g}; positions must lie on the domain, from {nodes[0]:g} to {nodes[-1]:g}",
            ABOUT,
        )
    return at


class SavedStates:
    """The saved states of a run, and the states between them."""

    case: Mapping[str, Any]
    time: Array
    x: Array
    x_cell: Array
    u: Array
    q: Array
    K: Array
    units: Units | None
    kinks: Sequence[Any]

    @property
    def _inflow(self) -> bool:
        """True if a flux enters at the left end."""
        profile = self.case.get("profile", {})
        return profile.get("kind") == "steady" and "kink" not in profile

    def at(self, t: float) -> Snapshot:
        """Return the state at a time t between the first and the last saved time.

        At a saved time it is the stored state. Between two of them u and q are linear in t, so that q is the slope of
        u; ln K is linear in t, and K itself where it is 0. The error is of second order in the distance of the saved
        times, and of first order where a kink passes between them. Raise InputError outside of the saved times.

        >>> import hjprofile as hj
        >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
        >>> state = hj.solve_hj(problem, hj.Grid(left=-5.0, cells=200)).at(0.25)
        >>> state.t, state.u.shape, state.q.shape
        (0.25, (201,), (200,))
        """
        place = before, part = place_in_time(self.time, t)
        u, q, K = row_at(place, self.u), row_at(place, self.q), row_at(place, self.K, True)
        kinks = None
        if part == 0.0:
            kinks = tuple(kink.x for kink in self.kinks if kink.time == self.time[before])
        return Snapshot(float(t), self.x, self.x_cell, u, q, K, kinks)

    def sample(self, x: float | Sequence[float] | Array) -> Gauges:
        """Return time series of u, q and K at positions x on the domain, in exchange lengths.

        Their shape is (times, *x.shape). u is linear between the nodes. q is linear between the midpoints of cells, and
        constant in the outer halves of the first and the last cell. ln K is linear between the nodes, and K itself
        where it is 0. The error is of second order in the width of a cell, and of first order in the cells next to
        a kink, where q is only a mean. Raise InputError for positions outside of the domain.

        >>> import hjprofile as hj
        >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0)
        >>> gauges = hj.solve_hj(problem, hj.Grid(left=-5.0, cells=200)).sample([-2.5, -1.0])
        >>> gauges.u.shape, gauges.time.shape
        ((31, 2), (31,))
        """
        at = positions_in(self.x, x)
        u, K = columns_at(self.x, at, self.u), columns_at(self.x, at, self.K, True)
        return Gauges(at, self.time, u, columns_at(self.x_cell, at, self.q), K)

    def restart(self, index: int = -1) -> Profile:
        """Return the profile at the saved time `self.time[index]`, from which another run can start.

        Its cell means of q are those of the run, its units those of the survey. q is constant in each cell, so a run on
        the same grid starts from the same state. Other grids and methods without a grid see a step at each node, an
        error of first order in the width of a cell. Time starts again at 0: a run to t1 and another one of the length
        t2 - t1 replace a run to t2. A coefficient or a supply that depends on t must be shifted by t1.

        Raise InputError if there is no such saved time, and for runs whose state is more than a profile: those of a
        rolling layer, and those with a flux that enters at the left end.

        >>> import hjprofile as hj
        >>> grid = hj.Grid(left=-5.0, cells=200)
        >>> first = hj.solve_hj(hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.0), grid)
        >>> second = hj.solve_hj(hj.Problem(hj.rational(), first.restart(), end=0.5), grid)
        >>> whole = hj.solve_hj(hj.Problem(hj.rational(), hj.kinks([-3.0], [1.0]), end=1.5), grid)
        >>> bool(abs(second.u[-1] - whole.u[-1]).max() < 1e-3)
        True
        """
        row = as_index("index", index, len(self.time))
        if self._inflow:
            raise InputError(
                "a run with a flux that enters at the left end has no restart; use its own profile, which is steady",
                ABOUT,
            )
        if "layer" in self.case:
            raise InputError("a run with a rolling layer has no restart, because its profile does not hold it", ABOUT)
        found = steps(edges=self.x, values=self.q[row])  # type: ignore[arg-type]
        assert isinstance(found, Points)
        return replace(found, height=float(self.u[row, 0] - self.x[0]), units=self.units)
