"""The results of a sweep over the product of varied values: one table, and members stored as they are solved."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import hjprofile
from hjprofile.errors import InputError, RunError
from hjprofile.files import write_whole
from hjprofile.output.archive import pack, unpack
from hjprofile.output.folder import MEMBERS, Owner, ResultFolder, owner_of, owner_of_tables
from hjprofile.output.store import to_csv, to_json
from hjprofile.output.survey_columns import in_survey_units, survey_columns
from hjprofile.problem.case import AnyCase, Case, source_of
from hjprofile.problem.case_files import find_case
from hjprofile.problem.ranges import instance, plain, shown
from hjprofile.problem.units import SAME, UNNAMED, Units
from hjprofile.solvers.run import Array
from hjprofile.studies.sweep import QUANTITIES, Member, Outcome, held, members, run_members, text_of

KEPT = "members"  # subfolder of the stored members
SHOWN = 14  # rows of the account
LENGTHS = (
    "crest_lowering",
    "largest_lowering",
    "largest_rise",
    "kink_x",
    "error_estimate",
)  # the other quantities with units are areas
LARGEST_VARIABLE = 2**31  # bytes of a netCDF-3 variable without an unlimited dimension, as scipy writes it
_IN_ACCOUNT = ("eroded_volume", "toe_outflow", "largest_lowering", "kinks_at_end")
_IN_UNITS = ("end_survey", "eroded_volume_survey", "toe_outflow_survey", "largest_lowering_survey")  # if units differ
_OF_SURVEYS = survey_columns(QUANTITIES)  # name -> the quantity that is converted


@dataclass(frozen=True)
class Sweep:
    """A case that was run once for each combination of values.

    Attributes:
        name, title: name and title of the case.
        vary: dotted key -> its values.
        values: for each member one value per key, in the order of the product: the last key varies fastest.
        outcomes: the outcome of each member, in the same order.
        x: the nodes, if all members share them and their heights fit in one netCDF variable, else None.
        recalled: the number of members that were taken from an earlier sweep.
        units: the units of each member; None for a member without a survey, and for a rejected one.
        distance: the nodes in the survey's unit, if all members share them to rounding, else None.
        held: a sentence on keys that change with the varied ones, or "".
    """

    name: str
    title: str
    vary: Mapping[str, list[Any]]
    values: Sequence[tuple[Any, ...]]
    outcomes: Sequence[Outcome]
    x: Array | None
    recalled: int
    units: Sequence[Units | None] = ()
    distance: Array | None = None
    held: str = ""

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of values of each key."""
        return tuple(map(len, self.vary.values()))

    def quantity(self, name: str) -> Array:
        """Return a numeric column of sweep.csv over the grid of the values, `shape`; NaN for a failed member."""
        return np.array([self.value(i, name) for i in range(len(self.outcomes))]).reshape(self.shape)

    def value(self, i: int, name: str) -> float:
        """Return a numeric column of sweep.csv for the member i; NaN if it failed."""
        found = self.outcomes[i].quantities
        if name not in _OF_SURVEYS:
            return found.get(name, np.nan)
        units = self.units[i] if self.units else None
        return in_survey_units(_OF_SURVEYS[name], found.get(_OF_SURVEYS[name], np.nan), units) if units else np.nan

    @property
    def surveyed(self) -> bool:
        """True if a member has units."""
        return any(self.units)

    @property
    def columns(self) -> list[str]:
        """The columns of sweep.csv after those of the varied keys."""
        added = _OF_SURVEYS if self.surveyed else ()
        return ["status", "method", *QUANTITIES, "broken_bounds", "wall_seconds", *added]


def _owner(case: Any) -> Owner:
    """Return the owner of the results of a sweep of a case."""
    if not isinstance(case, Case | Mapping):
        return owner_of([find_case(case)])
    found = source_of(case)
    return owner_of_tables(found.content, found.base)


def sweep(
    case: AnyCase,
    vary: Mapping[str, Iterable[Any]],
    executor: Executor | None = None,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Sweep:
    """Run a case for every combination of values of some of its keys.

    With a folder, `sweep.csv` and `sweep.nc` are written to it, and each member is stored there when it is solved.

    Args:
        case: the path of a case file, the name of a case that comes with the package, the tables of a case file, or a
            `Case`.
        vary: dotted key -> values, as in {"erosion.m": [0.5, 1, 2], "time.end": [1.0, 3.0]}.
        executor: an executor of `concurrent.futures`, or None for one member after the other; the results are the same
            to the last bit.
        folder: the folder for the results, or None.
        resume: True to use the members that are stored in the folder.
        progress: a function that receives the finished fraction, from 0 to 1.

    Returns:
        The sweep. A failed member has its reason as status.

    Raises:
        InputError: for bad input, before any run.
        RunError: if workers are lost or the sweep is interrupted.

    >>> import hjprofile as hj
    >>> found = hj.sweep("two_kinks", {"domain.cells": [20, 40], "time.end": [0.5]})
    >>> found.shape, [outcome.status for outcome in found.outcomes]
    ((2, 1), ['done', 'done'])
    """
    if not isinstance(vary, Mapping) or not all(isinstance(key, str) for key in vary):
        raise InputError(f"vary = {shown(vary)} must be a table of keys and their values")
    if executor is not None:
        instance("executor", executor, Executor)
    choices = {key: _list(key, values) for key, values in vary.items()}
    made = members(case, choices)
    outcomes: dict[int, Outcome] = {i: Outcome(m.refused) for i, m in enumerate(made) if m.refused}
    place = kept = None
    recalled = 0
    if folder is not None:
        place = ResultFolder(folder, _owner(case), keep=MEMBERS if resume else "").open()
        kept = place.path / KEPT
        place.claim(MEMBERS, "sweep.csv", "sweep.nc")
        for name in ("sweep.csv", "sweep.nc"):
            (place.path / name).unlink(missing_ok=True)
        if resume:
            found = {i: _recall(kept, m) for i, m in enumerate(made) if not m.refused}
            outcomes |= {i: outcome for i, outcome in found.items() if outcome}
            recalled = sum(outcome is not None for outcome in found.values())
        else:
            for path in kept.glob("*.npz"):
                path.unlink()
    todo = {i: m for i, m in enumerate(made) if i not in outcomes}
    try:
        for i, outcome in run_members(todo, executor):
            outcomes[i] = outcome
            if kept and outcome.done:
                _keep(kept, made[i], outcome)
            if progress:
                progress(len(outcomes) / len(made))
    except (RunError, KeyboardInterrupt) as error:
        if not kept:
            raise
        done = sum(outcome.done for outcome in outcomes.values())
        what = f"{str(error) or 'interrupted'}; {done} of {len(made)} members are stored in {kept}"
        raise RunError(f"{what}, and --resume continues from them") from None
    grids = {m.grid for m in made if m.grid}
    title = made[0].content.get("title", made[0].name)
    found_all = [outcomes[i] for i in range(len(made))]
    fits = sum(m.grid.nodes.nbytes for m in made if m.grid) < LARGEST_VARIABLE
    x = grids.pop().nodes if len(grids) == 1 and fits else None
    result = Sweep(
        made[0].name, title, choices, [m.values for m in made], found_all, x, recalled,
        units=[m.units for m in made], distance=_shared_ground(made) if fits else None, held=held(choices, made),
    )  # fmt: skip
    if place:
        table = to_csv([*choices, *result.columns], _rows(result))
        place.write({"sweep.nc": netcdf(result), "sweep.csv": table})
    return result


def _shared_ground(made: Sequence[Member]) -> Array | None:
    """Return the nodes of the members in the survey's unit; None if they differ by more than rounding."""
    nodes = [m.units.x(m.grid.nodes) for m in made if m.grid and m.units]
    if not nodes or any(m.grid and not m.units for m in made):
        return None
    near = SAME * float(np.ptp(nodes[0]))
    same = all(x.shape == nodes[0].shape and np.abs(x[[0, -1]] - nodes[0][[0, -1]]).max() <= near for x in nodes)
    return nodes[0] if same else None


def _list(key: str, values: Any) -> list[Any]:
    """Return the values of a key as a list. Raise InputError for a single value."""
    scalar = isinstance(values, np.ndarray) and values.ndim == 0
    if scalar or isinstance(values, (str, Mapping)) or not isinstance(values, Iterable):
        raise InputError(f"{key} needs a list of values, one or more")
    return [plain(value) for value in values]


def _keep(folder: Path, member: Member, outcome: Outcome) -> None:
    """Store a member as arrays and text; reading them runs no code."""
    content = outcome._replace(u=None)._asdict() | {"identity": member.identity}
    archive = pack({"u": np.asarray(outcome.u), "outcome": np.array(to_json(content))})
    write_whole(folder / f"{member.identity}.npz", archive)


def _recall(folder: Path, member: Member) -> Outcome | None:
    """Return the stored outcome of the same run; None if there is no readable one."""
    try:
        kept = unpack(folder / f"{member.identity}.npz")
        content, u = json.loads(str(kept["outcome"])), kept["u"]
        if content.pop("identity") != member.identity or member.grid is None or u.shape != member.grid.nodes.shape:
            return None
        numbers = {name: _number(content["quantities"][name]) for name in QUANTITIES}
        return Outcome(**content | {"quantities": numbers, "u": u, "wall_seconds": _number(content["wall_seconds"])})
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _rows(result: Sweep) -> Iterator[tuple]:
    added = _OF_SURVEYS if result.surveyed else ()
    for i, (values, o) in enumerate(zip(result.values, result.outcomes, strict=True)):
        numbers = (_plain(o.quantities.get(name)) for name in QUANTITIES)
        cells = (v if isinstance(v, (int, float)) and not isinstance(v, bool) else text_of(v) for v in values)
        in_units = (result.value(i, name) if o.done else None for name in added)
        yield *cells, o.status, o.method, *numbers, o.broken_bounds, o.wall_seconds, *in_units


def _plain(value: float | None) -> Any:
    """Return a whole number without a decimal point, other values unchanged."""
    return int(value) if value is not None and value == value and float(value).is_integer() else value


def netcdf(result: Sweep) -> bytes:
    """Return the content of `sweep.nc`: netCDF-3 with CF attributes, a dimension for each varied key.

    It holds no run times, so the same members give the same bytes.
    """
    from scipy.io import netcdf_file

    buffer = io.BytesIO()
    file = netcdf_file(buffer, "w", version=2)
    file.Conventions = "CF-1.8"
    file.title, file.hjprofile_version = result.title.encode() or b" ", hjprofile.__version__

    def put(name: str, kind: str, dimensions: tuple[str, ...], data: Any, **attributes: Any) -> Any:
        variable = file.createVariable(name, kind, dimensions)
        variable[:] = data
        for attribute, value in attributes.items():
            setattr(variable, attribute, value)
        return variable

    def put_texts(name: str, dimensions: tuple[str, ...], texts: Sequence[str], long_name: str) -> Any:
        coded = [text.encode() for text in texts]
        length = max(map(len, coded)) or 1
        file.createDimension(f"{name}_length", length)
        shape = tuple(file.dimensions[d] for d in dimensions)
        letters = np.array(coded, dtype=f"S{length}").view("S1").reshape(*shape, length)
        return put(name, "c", (*dimensions, f"{name}_length"), letters, long_name=long_name, _Encoding="utf-8")

    names = {key: key.replace(".", "_") for key in result.vary}
    dimensions, labels = tuple(names.values()), []
    for key, values in result.vary.items():
        name = names[key]
        file.createDimension(name, len(values))
        if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
            put(name, "f8", (name,), values, long_name=key, units="1")
        else:
            put(name, "i4", (name,), range(len(values)), long_name=f"{key}, number of the value", units="1")
            put_texts(f"{name}_label", (name,), [text_of(v) for v in values], key)
            labels.append(f"{name}_label")
    with_labels = {"coordinates": " ".join(labels)} if labels else {}
    _put_quantities(put, result, dimensions, with_labels)
    texts = {
        "status": ("done, or the reason of the failure", [o.status for o in result.outcomes]),
        "method": ("method of the member", [o.method for o in result.outcomes]),
        "broken_bounds": ("violated bounds", [o.broken_bounds for o in result.outcomes]),
    }
    for name, (long_name, values) in texts.items():
        variable = put_texts(name, dimensions, values, long_name)
        for attribute, value in with_labels.items():
            setattr(variable, attribute, value)
    _put_heights(file, put, result, dimensions, with_labels)
    file.flush()
    data = buffer.getvalue()
    file.close()
    return data


def _unit_of(result: Sweep) -> str:
    """Return the name of the unit of length of all members; "" if they have none, or several."""
    names = {units.unit for units in result.units if units}
    return names.pop() if len(names) == 1 else ""


def _put_quantities(
    put: Callable[..., Any], result: Sweep, dimensions: tuple[str, ...], labels: dict[str, str]
) -> None:
    """Add the quantities to a netCDF file, then those in the survey's units if there are any."""
    for name, long_name in QUANTITIES.items():
        put(name, "f8", dimensions, result.quantity(name), long_name=long_name, units="1", **labels)
    unit = _unit_of(result)
    for name, source in (_OF_SURVEYS if result.surveyed else {}).items():
        power = "" if source in LENGTHS else "2"
        known = {"units": f"{unit}{power}".encode()} if unit else {}
        about = f"{QUANTITIES[source]}, in the survey's units{' per unit width' if power else ''}"
        put(name, "f8", dimensions, result.quantity(name), long_name=about, **known, **labels)


def _put_heights(
    file: Any, put: Callable[..., Any], result: Sweep, dimensions: tuple[str, ...], labels: dict[str, str]
) -> None:
    """Add the nodes that all members share, and the heights there: dimensionless, and in the survey's unit."""
    kept = [("x", "u", result.x, [o.u for o in result.outcomes])]
    heights = [units.height(o.u) if units and o.u is not None else None for o, units in zip(
        result.outcomes, result.units or [None] * len(result.outcomes), strict=True
    )]  # fmt: skip
    kept.append(("distance", "height", result.distance, heights))
    abouts = {
        "x": "distance from the crest, positive uphill",
        "u": "height at the last saved time",
        "distance": "distance along the survey, positive uphill",
        "height": "height at the last saved time, as surveyed",
    }
    for place, name, nodes, found in kept:
        if nodes is None:
            continue
        unit = _unit_of(result) if place == "distance" else "1"
        known = {"units": unit.encode()} if unit else {}
        file.createDimension(place, nodes.size)
        put(place, "f8", (place,), nodes, long_name=abouts[place], axis="X", **known)
        nothing = np.full(nodes.size, np.nan)
        data = np.array([nothing if h is None else h for h in found]).reshape(*result.shape, -1)
        put(name, "f8", (*dimensions, place), data, long_name=abouts[name], **known, **labels)


def report(result: Sweep) -> dict[str, Any]:
    """Return the table as a dictionary: a row for each member, with the columns of `sweep.csv`."""
    columns = [*result.vary, *result.columns]
    members = [dict(zip(columns, row, strict=True)) for row in _rows(result)]
    return {"case": result.name, "title": result.title, "recalled": result.recalled, "members": members}


def account(result: Sweep) -> str:
    """Return the account of a sweep, of about twenty lines at most."""
    done = sum(o.done for o in result.outcomes)
    failed = [(v, o.status) for v, o in zip(result.values, result.outcomes, strict=True) if not o.done]
    counts = f"{len(result.outcomes)} members, {done} done"
    counts += f" ({result.recalled} of them in an earlier sweep)" if result.recalled else ""
    lines = [f"{result.title}: {counts}, {len(failed)} failed"]
    known = [units for units in result.units if units]
    shown = _IN_UNITS if any(not units.same(known[0]) for units in known) else _IN_ACCOUNT
    table = [[*result.vary, *shown]]
    for i, (values, o) in list(enumerate(zip(result.values, result.outcomes, strict=True)))[:SHOWN]:
        numbers = [f"{result.value(i, n):.6g}" for n in shown] if o.done else ["failed", "", "", ""]
        table.append([*(text_of(v) for v in values), *numbers])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines += ["  " + "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    if len(result.outcomes) > SHOWN:
        lines.append(f"  ... and {len(result.outcomes) - SHOWN} more")
    if shown is _IN_UNITS:
        unit = _unit_of(result) or UNNAMED
        lines.append(f"  columns that end in _survey: lengths in {unit}, volumes per unit width in {unit}²")
    if result.held:
        lines.append(f"  {result.held}")
    if failed:
        which = ", ".join(f"{key} = {text_of(v)}" for key, v in zip(result.vary, failed[0][0], strict=True))
        lines.append(f"  first failure, at {which}: {failed[0][1]}")
    broken = sum(bool(o.broken_bounds) for o in result.outcomes)
    if broken:
        lines.append(f"  WARNING: bounds are violated in {broken} members; the column broken_bounds names them")
    return "\n".join(lines)
