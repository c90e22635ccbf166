"""What a solver returns, and what it hands to those who watch it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

import hjprofile
from hjprofile.problem.case import to_toml
from hjprofile.problem.ranges import read_only
from hjprofile.problem.units import Units
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Time

if TYPE_CHECKING:
    import xarray

Array = np.ndarray

FIELDS: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {  # name -> dimensions, CF attributes
    "time": (("time",), {"long_name": "supplied mass of grains", "units": "1", "axis": "T"}),
    "x": (("node",), {"long_name": "distance from the crest, uphill positive", "units": "1", "axis": "X"}),
    "x_cell": (("cell",), {"long_name": "midpoints of the cells", "units": "1"}),
    "u": (("time", "node"), {"long_name": "height of the standing profile", "units": "1"}),
    "q": (("time", "cell"), {"long_name": "excess slope du/dx - 1, mean over the cell", "units": "1"}),
    "K": (("time", "node"), {"long_name": "grain flux relative to the supply", "units": "1"}),
}
UNITS = ("length", "critical_slope", "x_top", "height_top")


class State(NamedTuple):
    """A moment of a run. The arrays belong to the solver: copy what is to be kept."""

    t: float
    steps: int  # taken so far
    first: int  # the cell of the grid at which q begins
    q: Array  # cell means of the excess slope, where it is not known to be 0
    law: Any  # for compiled loops, see grids/kernels/sweep_law.py
    speed: float  # largest K f' met in the last steps
    bound: float  # of K f' in the last steps, and ...
    dt: float  # ... their length; 0 before the first
    growth: float  # ∫(K(left) - 1) dt so far: grains that left at the foot beyond those poured in
    crest_lowering: float  # ∫F(x = 0) dt so far
    volume: Callable[[], float]  # ∫(u - x) dx by the method's own sum
    K: Array | None = None  # the factor at the nodes of these cells, if q does not decide it


class Halt(Exception):
    """Raised by a monitor that stops the run, with the reason."""

    def __init__(self, stop: Stop):
        super().__init__(str(stop))
        self.stop = stop


class Breakdown(Exception):
    """The state is no longer admissible. Carries the cell and q there; `first` is the cell of the grid at q[0]."""

    def __init__(self, q: Array, K: Array, first: int = 0):
        bad = ~(np.isfinite(q) & (q > -1.0))
        # K is summed from the right, so the rightmost bad cell is the first to blame
        elsewhere = np.argmin(q) if np.isfinite(K).all() else np.argmin(np.isfinite(K))
        cell = int(np.flatnonzero(bad)[-1]) if bad.any() else int(elsewhere)
        self.cell, self.q = first + cell, float(q[cell])


class Monitor(Protocol):
    """Watches a run from outside: its first state, its last, and those in between that it asks for.

    Attributes:
        memory: names of the attributes that a checkpoint has to keep: numbers, tuples of numbers, arrays.
    """

    memory: tuple[str, ...]

    def wants(self, state: State) -> bool:
        """Whether to look at this state."""
        ...

    def observe(self, state: State) -> None:
        """Looks at it. Raises Halt if the run must not go on."""
        ...


class Keeper(Protocol):
    """Keeps checkpoints. As a context it also takes care of requests to stop."""

    def __enter__(self) -> Any: ...

    def __exit__(self, *error: Any) -> None: ...

    def recall(self, identity: Mapping[str, Any]) -> Mapping[str, Array] | None:
        """What was kept of the run that is told from others by `identity`, if there is anything to go on from."""
        ...

    def due(self) -> bool:
        """Whether to keep a checkpoint now."""
        ...

    def keep(self, t: float, memory: Mapping[str, Array]) -> None:
        """Keeps it. Raises RunError afterwards if the run was asked to stop."""
        ...


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


class VerticalStep(NamedTuple):
    """A jump of u by `height` at one snapshot, under a law of linear growth (theory, §14)."""

    time: float
    step: int
    x: float
    height: float
    speed: float


class Event(NamedTuple):
    """`birth`, `merge` (of `kink` into `into`), `exit` or `blow-up` (it becomes a vertical step) of a kink."""

    time: float
    event: str
    kink: int
    into: int | None
    x: float


def in_order(events: Sequence[Event], moment: float = 0.0) -> list[Event]:
    """Return events by time and kink. Kinks that meet within a `moment` all merge into the one that lives on.

    `moment` is the accuracy of the times: at a point where three kinks meet, rounding decides which pair is first.
    """
    merges = {e.kink: e for e in events if e.event == "merge"}

    def survivor(e: Event) -> int | None:
        into = e.into
        while into in merges and abs(merges[into].time - e.time) <= moment:
            into = merges[into].into
        return into

    return sorted((e._replace(into=survivor(e)) for e in events), key=lambda e: (e.time, e.kink))


class Verdict(NamedTuple):
    """Whether a bound held, and when and where it was nearest to being broken (`x` is NaN if it has no place).

    The margin is the part of its allowance that was left: 1 untouched, negative exceeded.
    """

    holds: bool
    worst_margin: float
    time: float
    x: float
    allowance: str

    def broken(self, name: str) -> Stop:
        """Return the reason to stop, or to doubt the result, of a bound of that name that does not hold."""
        where = "" if np.isnan(self.x) else " near x = {x:.6g}"
        return Stop(
            Reason.BROKEN_BOUND,
            "{name} does not hold at t = {t:.6g}" + where + ": the excess is {excess:.3g} times the allowance "
            "({allowance})",
            f"use a monotone method ({ROBUST_METHOD}) with cfl at most 1, or more cells",
            {"name": name, "t": Time(self.time), "x": Place(self.x), "excess": -self.worst_margin,
             "allowance": self.allowance},
        )  # fmt: skip


@dataclass(frozen=True)
class Run:
    """A solution on a grid at the saved times. Its arrays are read-only; a copy can be written into.

    Attributes:
        title, method: of the case.
        case: the resolved case, as a table ready for TOML.
        time: shape (times,).
        x, x_cell: nodes (cells + 1,) and midpoints of cells (cells,).
        u, K: on nodes, shape (times, cells + 1). u is the height, K the factor of the flux that was used from then on.
        q: cell means of u_x - 1, shape (times, cells).
        status: "done", or a sentence that says when, where and why the run stopped and what to try. The last saved
            time is then the last good state.
        stop: the same as a record of which `status` is the sentence; None for a run that went to its end or was read
            from a file.
        steps, step_range: number of time steps, least and largest.
        wall_seconds: of the time stepping alone; compilation, monitoring and output apart.
        kinks, events: the kinks at the saved times; births, merges and exits.
        vertical_steps: the jumps of u at the saved times, numbered as the kinks that they come from; None where the
            law has none.
        bounds: name -> Verdict for each a-priori fact and budget that was watched.
        eroded_volume: ∫(u(0,x) - u(t,x)) dx at the end.
        toe_outflow: ∫K(t, left) dt at the end: the grains that have left at the toe. It is the supply plus the eroded
            volume. NaN if the coefficient is prescribed.
        crest_lowering: ∫F(t, 0) dt at the end, which is u(0, 0) - u(t, 0).
        volume_budget_error: the most by which the eroded volume ever differed from ∫(K(left) - 1) dt.
        error_estimate: of sup|u - exact u| over all saved times, where the method knows one, else None.
        units: the way back to a survey's units, else None.
        account: what was done to the data, and what the method auto chose and why, or "".
        cautions: a sentence for each reason, other than a broken bound, to doubt the result: data that the grid or the
            fronts do not resolve, a tolerance that is not met, a product that could not be made.
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
    vertical_steps: Sequence[VerticalStep] | None = None
    bounds: Mapping[str, Verdict] = field(default_factory=dict)
    eroded_volume: float = np.nan
    toe_outflow: float = np.nan
    crest_lowering: float = np.nan
    volume_budget_error: float = np.nan
    error_estimate: float | None = None
    units: Units | None = None
    account: str = ""
    cautions: Sequence[str] = ()
    stop: Stop | None = None

    def __post_init__(self) -> None:
        if self.stop is not None:
            object.__setattr__(self, "status", str(self.stop))
        for name in FIELDS:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def done(self) -> bool:
        """Whether the run went to its end."""
        return self.status == "done"

    @property
    def stepped(self) -> bool:
        """Whether it took the time steps of a scheme on a grid."""
        return not np.isnan(self.step_range[1])

    @property
    def warnings(self) -> list[str]:
        """The cautions, then a sentence for each broken bound."""
        return [*self.cautions, *self.broken_bounds]

    @property
    def broken_bounds(self) -> list[str]:
        """A sentence for each bound that the method promises and that was broken."""
        return [str(b.broken(name)) for name, b in self.bounds.items() if not b.holds]

    @property
    def cells(self) -> int:
        """Number of cells of the grid on which it is told."""
        return self.x_cell.size

    @property
    def attributes(self) -> dict[str, str | float]:
        """What `profile.nc` and `to_xarray` say of the run as a whole: its case as TOML, the units of a survey, ..."""
        text = {"Conventions": "CF-1.8", "title": self.title, "method": self.method, "status": self.status}
        text |= {"case": to_toml(self.case), "hjprofile_version": hjprofile.__version__}
        return text | ({name: getattr(self.units, name) for name in UNITS} if self.units else {})

    def to_xarray(self) -> xarray.Dataset:
        """u, q and K over `time` and `node` or `cell`, with `x` and `x_cell`: what `xarray` reads from `profile.nc`.

        Needs xarray, which hjprofile does not bring along. The arrays are shared with the run, read-only; those of
        `.copy(deep=True)` are not.
        """
        import xarray

        arrays = {name: (dims, getattr(self, name), about) for name, (dims, about) in FIELDS.items()}
        coordinates = {name: arrays.pop(name) for name in ("time", "x", "x_cell")}
        return xarray.Dataset(arrays, coordinates, self.attributes)

    def meets(self, tolerance: float) -> bool:
        """Return True if the estimate of the error is known and at most the tolerance."""
        return self.error_estimate is not None and self.error_estimate <= tolerance

    def judged(self, tolerance: float) -> Run:
        """Return the run, not done and with a caution if its estimated error exceeds the tolerance or is missing."""
        if self.done and self.meets(tolerance):
            return self
        known = "is not known" if self.error_estimate is None else f"is about {self.error_estimate:.1g}"
        caution = f"the tolerance {tolerance:g} is not met: the error of u {known}. Use a larger tolerance."
        status = f"reached the end, but {caution}" if self.done else self.status
        return replace(self, status=status, cautions=(*self.cautions, caution))

    def kinks_at(self, index: int) -> list[KinkRecord]:
        """The kinks at the saved time `self.time[index]`, from left to right."""
        return [k for k in self.kinks if k.time == self.time[index]]

    def steps_at(self, index: int) -> list[VerticalStep]:
        """The vertical steps at the saved time `self.time[index]`, from left to right."""
        return [s for s in self.vertical_steps or () if s.time == self.time[index]]
