"""What a solver returns, and what it hands to those who watch it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from hjprofile.problem.profiles import Units

Array = np.ndarray


class State(NamedTuple):
    """A moment of a run. The arrays belong to the solver: copy what is to be kept."""

    t: float
    W: Array  # u - x on the nodes
    q: Array  # cell means of the excess slope
    K: Array  # nonlocal factor on the nodes
    speed: float  # largest K f'
    volume: float  # ∫(u - x) dx by the method's own sum
    growth: float  # ∫(K(left) - 1) dt so far: grains that left at the foot beyond those poured in
    outflow: float  # ∫F(x = 0) dt so far


class Monitor(Protocol):
    """Watches a run from outside; sees every few steps, and each snapshot."""

    def observe(self, state: State) -> None: ...


class KinkRecord(NamedTuple):
    """A kink (upward jump of q) at one snapshot; `speed` is measured, the last by [f]/[q]."""

    time: float
    kink: int
    x: float
    q_left: float
    q_right: float
    jump: float
    speed: float
    rankine_hugoniot_speed: float


class Event(NamedTuple):
    """`birth`, `merge` (of `kink` into `into`) or `exit` of a kink."""

    time: float
    event: str
    kink: int
    into: int | None
    x: float


class Verdict(NamedTuple):
    """Whether a bound held. The margin is the part of its allowance that was left: 1 untouched, negative exceeded."""

    holds: bool
    worst_margin: float
    time: float
    allowance: str


@dataclass(frozen=True)
class Run:
    """A solution on a grid at the times that were kept.

    Attributes:
        title, method: of the case.
        case: the resolved case, as a table ready for TOML.
        time: shape (times,).
        x, x_cell: nodes (cells + 1,) and midpoints of cells (cells,).
        u, K: on nodes, shape (times, cells + 1). u is the height, K the nonlocal factor.
        q: cell means of u_x - 1, shape (times, cells).
        status: "done", or a sentence that says when, where and why the run stopped and what to try. The last saved
            time is then the last good state.
        steps, step_range: number of time steps, least and largest.
        wall_seconds: of the time stepping alone; compilation, monitoring and output apart.
        kinks, events: the kinks at the saved times; births, merges and exits.
        bounds: name -> Verdict for each a-priori fact and budget that was watched.
        eroded_volume: ∫(u(0,x) - u(t,x)) dx at the end.
        outflow: ∫F(x = 0) dt at the end: excess slope that has left at the top.
        volume_budget_error: the most by which the eroded volume ever differed from ∫(K(left) - 1) dt.
        error_estimate: of sup|u - exact u| over all saved times, where the method knows one, else None.
        units: the way back to a survey's units, else None.
        account: what was done to the data, or "".
    """

    title: str
    method: str
    case: Mapping[str, Any]
    time: Array
    x: Array
    x_cell: Array
    u: Array
    q: Array
    K: Array
    status: str = "done"
    steps: int = 0
    step_range: tuple[float, float] = (np.nan, np.nan)
    wall_seconds: float = 0.0
    kinks: Sequence[KinkRecord] = ()
    events: Sequence[Event] = ()
    bounds: Mapping[str, Verdict] = field(default_factory=dict)
    eroded_volume: float = np.nan
    outflow: float = np.nan
    volume_budget_error: float = np.nan
    error_estimate: float | None = None
    units: Units | None = None
    account: str = ""

    @property
    def done(self) -> bool:
        return self.status == "done"

    @property
    def cells(self) -> int:
        return self.x_cell.size

    def kinks_at(self, index: int) -> list[KinkRecord]:
        """The kinks at the saved time `self.time[index]`, from left to right."""
        return [k for k in self.kinks if k.time == self.time[index]]
