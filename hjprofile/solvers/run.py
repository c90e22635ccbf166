"""Results of a solver, and the interfaces of monitors and checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

import hjprofile
from hjprofile.problem.case import law_from, to_toml
from hjprofile.problem.erosion import ErosionLaw
from hjprofile.problem.ranges import as_index, read_only
from hjprofile.problem.units import SurveyLine, Units
from hjprofile.solvers.norms import Limit, Norms, States, limits, norms
from hjprofile.solvers.run_repr import as_html, as_text
from hjprofile.solvers.run_tables import FIELDS, Field, dataset, table
from hjprofile.solvers.states import SavedStates
from hjprofile.solvers.stop import ROBUST_METHOD, Place, Reason, Stop, Time

if TYPE_CHECKING:
    import pandas
    import xarray

Array = np.ndarray


class State(NamedTuple):
    """A state of a run. The arrays belong to the solver: copy them to retain them."""

    t: float
    steps: int  # number of time steps so far
    first: int  # the cell of q[0] in the grid
    q: Array  # cell means of the excess slope, on the active cells and a halo
    law: Any  # for compiled loops, see grids/kernels/sweep_law.py
    speed: float  # largest K f' in the last steps
    bound: float  # of K f' in the last steps
    dt: float  # length of the last steps; 0 before the first
    toe_gain: float  # ∫(K(left) - 1) dt so far: toe outflow less supply
    crest_lowering: float  # ∫F(x = 0) dt so far
    volume: Callable[[], float]  # ∫(u - x) dx by the method's own sum
    K: Array | None = None  # K at these nodes, if it is prescribed or frozen


class Halt(Exception):
    """An exception of a monitor that stops the run, with the reason."""

    def __init__(self, stop: Stop):
        super().__init__(str(stop))
        self.stop = stop


class Breakdown(Exception):
    """A loss of admissibility at `cell` with the excess slope `q`; `first` is the grid cell of q[0]."""

    def __init__(self, q: Array, K: Array, first: int = 0):
        bad = ~(np.isfinite(q) & (q > -1.0))
        # K is summed from the right, so the rightmost bad cell is the cause
        elsewhere = np.argmin(q) if np.isfinite(K).all() else np.argmin(np.isfinite(K))
        cell = int(np.flatnonzero(bad)[-1]) if bad.any() else int(elsewhere)
        self.cell, self.q = first + cell, float(q[cell])


class Monitor(Protocol):
    """An observer of a run: of its first state, its last, and those in between that it requests.

    Attributes:
        checkpoint_fields: names of the attributes that a checkpoint must store: numbers, tuples of numbers, arrays.
    """

    checkpoint_fields: tuple[str, ...]

    def wants(self, state: State) -> bool:
        """Return True to observe this state."""
        ...

    def observe(self, state: State) -> None:
        """Observe a state. Raise Halt if the run must not continue."""
        ...


class Keeper(Protocol):
    """A store of checkpoints. As a context it also handles requests to stop."""

    def __enter__(self) -> Any: ...

    def __exit__(self, *error: Any) -> None: ...

    def recall(self, identity: Mapping[str, Any]) -> Mapping[str, Array] | None:
        """Return the stored checkpoint of the run with this `identity`, or None."""
        ...

    def due(self) -> bool:
        """Return True if a checkpoint is due."""
        ...

    def keep(self, t: float, memory: Mapping[str, Array]) -> None:
        """Store a checkpoint. Raise RunError afterwards if a stop was requested."""
        ...


class KinkRecord(NamedTuple):
    """A kink (upward jump of q) at one saved time; `speed` is measured, the last field is K [f]/[q]."""

    time: float
    kink: int
    x: float
    q_left: float
    q_right: float
    jump: float
    speed: float
    rankine_hugoniot_speed: float


class VerticalStep(NamedTuple):
    """A jump of u by `height` at one saved time, under a law of linear growth (§11)."""

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
    """Return events by time and kink. Kinks that meet within a `moment` all merge into the surviving one.

    `moment` is the accuracy of the times: if three kinks meet at a point, rounding decides which pair is first.
    """
    merges = {e.kink: e for e in events if e.event == "merge"}

    def survivor(e: Event) -> int | None:
        into = e.into
        while into in merges and abs(merges[into].time - e.time) <= moment:
            into = merges[into].into
        return into

    return sorted((e._replace(into=survivor(e)) for e in events), key=lambda e: (e.time, e.kink))


class Verdict(NamedTuple):
    """The result for a bound, with the time and position of its smallest margin (`x` is NaN if it has no position).

    The margin is the unused fraction of the allowance: 1 if unused, negative if exceeded.
    """

    holds: bool
    worst_margin: float
    time: float
    x: float
    allowance: str

    def broken(self, name: str) -> Stop:
        """Return the reason to stop, or a warning, for a bound of that name that is violated."""
        where = "" if np.isnan(self.x) else " near x = {x:.6g}"
        return Stop(
            Reason.BROKEN_BOUND,
            "{name} does not hold at t = {t:.6g}" + where + ": the excess is {excess:.3g} times the allowance "
            "({allowance})",
            f"use a monotone method ({ROBUST_METHOD}) with cfl at most 1, or more cells",
            {"name": name, "t": Time(self.time), "x": Place(self.x), "excess": -self.worst_margin,
             "allowance": self.allowance},
        )  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Run(SavedStates):
    """A solution on a grid at the saved times. Its arrays are read-only; copies are writable.

    A run can be pickled, and is equal to itself only; `compare` measures the distance of two runs.

    x is in exchange lengths, u in exchange lengths times the critical slope, t in supplied mass.

    Attributes:
        title, method: of the case.
        case: the resolved case, as a table ready for TOML.
        time: saved times, shape (times,).
        x, x_cell: nodes (cells + 1,) and midpoints of cells (cells,).
        u, K: height and grain flux relative to the supply, on nodes, shape (times, cells + 1). K is the one in use from
            that time on.
        q: cell means of u_x - 1, shape (times, cells).
        status: "done", or a sentence with time, position, reason and remedy if the run stopped. The last saved time is
            then the last good state.
        stop: the reason of `status` as a record; None if the run reached its end or was read from a file. A run that a
            callback stopped is done, and `stop` is the reason.
        steps, step_range: number of time steps, smallest and largest step.
        wall_seconds: of the time stepping alone, without compilation, monitoring and output.
        kinks, events: the kinks at the saved times; births, merges and exits.
        vertical_steps: the jumps of u at the saved times, with the numbers of the kinks that they come from; None if
            the law has none.
        bounds: name -> Verdict for each monitored bound and budget.
        eroded_volume: ∫(u(0,x) - u(t,x)) dx at the end.
        toe_outflow: ∫K(t, left) dt at the end, the grains that have left at the toe. It is the supply plus the eroded
            volume, up to the errors of both. NaN if the coefficient is prescribed.
        crest_lowering: ∫F(t, 0) dt at the end, which is u(0, 0) - u(t, 0).
        volume_budget_error: largest difference over the run between the eroded volume and ∫(K(left) - 1) dt.
        error_estimate: of sup|u - u_exact| over all saved times, by the method or by `solve_case`, else None.
        toe_outflow_error, eroded_volume_error: estimates of the errors of these two, by `solve_case`, else None.
        units: conversion to the units of a survey, else None.
        surveyed: the points of the survey, else None.
        account: changes of the input, and the choice of the method auto with its reason, or "".
        cautions: a sentence for each reason, other than a violated bound, to doubt the result: data that the grid or
            the fronts do not resolve, a tolerance that is not met, a large error of the toe outflow or of the eroded
            volume, an extreme grain flux at the toe, an output that could not be written.
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
    toe_outflow_error: float | None = None
    eroded_volume_error: float | None = None
    units: Units | None = None
    surveyed: SurveyLine | None = None
    account: str = ""
    cautions: Sequence[str] = ()
    stop: Stop | None = None
    law: ErosionLaw | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.stop is not None and self.stop.reason is not Reason.CALLBACK:
            object.__setattr__(self, "status", str(self.stop))
        self._protect_arrays()

    def _protect_arrays(self) -> None:
        for name in FIELDS:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __repr__(self) -> str:
        return as_text(self)

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        return as_html(self)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for another process: a law is a function, which cannot be sent."""
        state = self.__dict__ | {"norms": self.norms, "norm_limits": self.norm_limits, "law": None}
        return {name: value for name, value in state.items() if name != "_known_law"}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the state from another process, where arrays are writable."""
        self.__dict__.update(state)
        self._protect_arrays()

    @cached_property
    def norms(self) -> Norms:
        """The norms of q, F and I at the saved times."""
        return norms(self._states, self._known_law)

    @cached_property
    def norm_limits(self) -> Mapping[str, Sequence[Limit]]:
        """The bounds of the norms by the theory: column of `Norms` -> bounds at the saved times."""
        return limits(self.norms, self._states, self._known_law, self.case)

    @cached_property
    def _known_law(self) -> ErosionLaw | None:
        """The law, or None if it is in a Python file, which is not part of a stored run."""
        table = self.case["erosion"]
        return self.law or (None if table["law"] == "python" else law_from(table))

    @property
    def _states(self) -> States:
        dx = float(np.ptp(self.x)) / self.cells
        return States(self.time, dx, self.u - self.x, self.q, self.K, self._inflow)

    @property
    def done(self) -> bool:
        """True if the run reached its end."""
        return self.status == "done"

    @property
    def stepped(self) -> bool:
        """True if the run made the time steps of a scheme on a grid."""
        return not np.isnan(self.step_range[1])

    @property
    def warnings(self) -> list[str]:
        """The changes of the input, the cautions, then a sentence for each violated bound."""
        return [*self.input_changes, *self.cautions, *self.broken_bounds]

    @property
    def input_changes(self) -> list[str]:
        """The sentences of the account on changes of the input."""
        lines = self.account.splitlines()
        return lines[:-1] if self.case["solver"]["method"] == "auto" else lines  # the last one is on the choice

    @property
    def broken_bounds(self) -> list[str]:
        """A sentence for each violated bound that the method guarantees."""
        return [str(b.broken(name)) for name, b in self.bounds.items() if not b.holds]

    @property
    def cells(self) -> int:
        """The number of cells of the grid of the result."""
        return self.x_cell.size

    @property
    def attributes(self) -> dict[str, str | float]:
        """Global attributes of `profile.nc` and `to_xarray`: title, method, status, case as TOML, units of a survey."""
        text = {"Conventions": "CF-1.8", "title": self.title, "method": self.method, "status": self.status}
        text |= {"case": to_toml(self.case), "hjprofile_version": hjprofile.__version__}
        return text | (self.units.attributes if self.units else {})

    @property
    def fields(self) -> dict[str, Field]:
        """The variables of `profile.nc`: name -> dimensions, values, CF attributes."""
        found = {name: (dims, getattr(self, name), about) for name, (dims, about) in FIELDS.items()}
        if self.units is None:
            return found
        return found | self.units.fields(self.time, self.x, self.x_cell, self.u)

    def plot(self, ax: Any = None, kind: str = "profile") -> Any:
        """Plot the run on the axes `ax` of matplotlib, or in a new figure. See `hjprofile.plot`, which this calls.

        >>> import hjprofile as hj
        >>> from matplotlib.figure import Figure
        >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1)
        >>> run = hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40))
        >>> run.plot(ax=Figure().subplots()).get_ylabel()
        'height u'
        """
        # by name: pictures are above the solvers, which import none of them
        return import_module("hjprofile.output.plots.user_axes").plot(self, kind, ax)

    def to_xarray(self) -> xarray.Dataset:
        """Return an `xarray.Dataset` of u, q and K, with the coordinates `time`, `x` and `x_cell` as its dimensions.

        u and K have the dimensions (`time`, `x`), q has (`time`, `x_cell`). The run of a survey has the variable
        `height` and the coordinates `distance`, `distance_cell` and `supplied_volume` too. `profile.nc`, opened by
        xarray, is the same dataset after `.swap_dims(node="x", cell="x_cell")`. The method requires xarray, which is
        not a dependency of hjprofile. u, q and K are shared with the run and read-only; those of `.copy(deep=True)`
        are writable.

        >>> import hjprofile as hj
        >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1)
        >>> data = hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40)).to_xarray()
        >>> data.u.sel(time=0.0, x=-3.02, method="nearest").item()
        -3.0
        """
        return dataset(self.fields, self.attributes)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a `pandas.DataFrame` with one row for each saved time and node, indexed by `time` and `x`.

        Its columns are u, q and K, and for a survey `supplied_volume`, `distance` and `height`. q is the mean over the
        cell that ends at x, so it is NaN at the left end, and u rises by (1 + q) Δx from the row before. The method
        requires pandas, which is not a dependency of hjprofile.

        >>> import hjprofile as hj
        >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1, snapshots=2)
        >>> hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40)).to_dataframe().shape
        (82, 3)
        """
        return table(self.fields)

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
        """Return the kinks at the saved time `self.time[index]`, from left to right."""
        t = self.time[as_index("index", index, len(self.time))]
        return [k for k in self.kinks if k.time == t]

    def steps_at(self, index: int) -> list[VerticalStep]:
        """Return the vertical steps at the saved time `self.time[index]`, from left to right."""
        t = self.time[as_index("index", index, len(self.time))]
        return [s for s in self.vertical_steps or () if s.time == t]
