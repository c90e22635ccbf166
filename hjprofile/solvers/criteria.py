"""Criteria that stop a run: callbacks for its solver."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.ranges import as_number, shown
from hjprofile.solvers.states import Callback, Snapshot

ABOUT = "a-state-of-a-run"  # heading of the page on errors


def until_steady(rate: float) -> Callback:
    """Return a callback that stops a run when the profile is steady within a tolerance.

    The run stops at the first saved time t with sup|u(t) - u(s)| <= rate (t - s), where s is the saved time before.

    Args:
        rate: the lowering per unit of supply, in exchange lengths times the neutral slope; positive.

    Returns:
        A callback for a solver. It may be used for several runs, one after the other.

    Raises:
        InputError: for another rate.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.bumps([1.0], [-4.0], [0.7]), end=60.0, snapshots=121)
    >>> run = hj.solve_hj(problem, hj.Grid(left=-8.0, cells=200), callback=hj.until_steady(1e-3))
    >>> run.done, bool(run.time[-1] < 60.0)
    (True, True)
    """
    return _Steady(_positive("rate", rate))


def until_eroded(volume: float) -> Callback:
    """Return a callback that stops a run when a volume is eroded.

    The run stops at the first saved time with ∫(u(0, x) - u(t, x)) dx >= volume.

    Args:
        volume: the volume per unit width, in squared exchange lengths times the neutral slope; positive. For a survey
            divide a volume by `units.volume`.

    Returns:
        A callback for a solver. It may be used for several runs, one after the other.

    Raises:
        InputError: for another volume.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.bumps([1.0], [-4.0], [0.7]), end=3.0, snapshots=61)
    >>> run = hj.solve_hj(problem, hj.Grid(left=-8.0, cells=200), callback=hj.until_eroded(2.0))
    >>> run.done, bool(2.0 <= run.eroded_volume < 2.1)
    (True, True)
    """
    return _Eroded(_positive("volume", volume))


def until_kinks(most: int = 0) -> Callback:
    """Return a callback that stops a run when kinks have left the slope or merged.

    The run stops at the first saved time with at most so many kinks. Save times at which the kinks exist: a run whose
    profile has none at t = 0 stops there.

    Args:
        most: the largest number of remaining kinks, 0 or more.

    Returns:
        A callback for a solver.

    Raises:
        InputError: for another number.

    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-3.0, -1.0], [0.4, 1.2]), end=9.0, snapshots=181)
    >>> run = hj.track_fronts(problem, callback=hj.until_kinks(1))
    >>> run.done, len(run.kinks_at(-1))
    (True, 1)
    """
    number = as_number(most)
    if not (number >= 0.0 and number.is_integer()):
        raise InputError(f"most = {shown(most)} must be a whole number, 0 or larger", ABOUT)
    return _Kinks(int(number))


def _positive(name: str, value: object) -> float:
    number = as_number(value)
    if not 0.0 < number < np.inf:
        raise InputError(f"{name} = {shown(value)} must be a positive number", ABOUT)
    return number


@dataclass
class _Steady:
    rate: float
    before: Snapshot | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return f"until_steady({self.rate:g})"

    def __call__(self, t: float, state: Snapshot) -> bool:
        before, self.before = self.before, state
        if before is None or before.t >= t:  # the first state of a run
            return False
        return bool(np.abs(state.u - before.u).max() <= self.rate * (t - before.t))


@dataclass
class _Eroded:
    volume: float
    first: Snapshot | None = field(default=None, repr=False)
    last: float = field(default=np.inf, repr=False)

    def __repr__(self) -> str:
        return f"until_eroded({self.volume:g})"

    def __call__(self, t: float, state: Snapshot) -> bool:
        if self.first is None or t <= self.last:  # the first state of a run
            self.first = state
        self.last = t
        return bool(np.trapezoid(self.first.u - state.u, state.x) >= self.volume)


@dataclass
class _Kinks:
    most: int

    def __repr__(self) -> str:
        return f"until_kinks({self.most})"

    def __call__(self, t: float, state: Snapshot) -> bool:
        return state.kinks is not None and len(state.kinks) <= self.most
