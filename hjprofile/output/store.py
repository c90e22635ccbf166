"""The files of a run: netCDF, tables and a summary, each written atomically."""

from __future__ import annotations

import csv
import io
import json
import tomllib
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import hjprofile
from hjprofile.errors import InputError
from hjprofile.output.faults import fault_of
from hjprofile.output.folder import ResultFolder, owner_of_run
from hjprofile.output.survey_columns import names_with_survey_columns, with_survey_columns
from hjprofile.output.workers import by_a_fork
from hjprofile.problem.case import Case
from hjprofile.problem.ranges import as_path, instance
from hjprofile.problem.stored import read_profile
from hjprofile.problem.units import SurveyLine, Units
from hjprofile.solvers.norms import Norms
from hjprofile.solvers.run import Event, KinkRecord, Run, Verdict, VerticalStep
from hjprofile.solvers.run_tables import COORDINATES

_Row = TypeVar("_Row", KinkRecord, Event, VerticalStep)

VTK_FOLDER = "vtk"
STEPS_FILE = "vertical_steps.csv"
SURVEY_FILE = "survey.csv"
NORMS_FILE = "norms.csv"
PICTURES = "profile", "diagram", "factor", "norms"
# Measured arrays for each saved time, and others, of a run with its files: profile.nc is put together in memory, and so
# are VTK files; another process draws
RESULT_ONLY, WITH_FILES = (12, 15), (24, 24)
LONGEST_REASON = 200  # characters of an exception in a warning
# files that not every run writes
_OF_A_RUN = (
    "summary.json", STEPS_FILE, SURVEY_FILE, "*.gif", "*.mp4", f"{VTK_FOLDER}/*",
    *(f"{name}.{form}" for name in (*PICTURES, "comparison") for form in ("png", "svg")),
)  # fmt: skip


def write_run(run: Run, folder: str | Path, vtk: bool = True, plots: bool = True) -> list[Path]:
    """Write the result folder of a run.

    Files of another case or of an earlier run in the folder are removed. If a picture or the VTK files cannot be made,
    the data are complete and a UserWarning is issued.

    Args:
        run: the run.
        folder: the path of the folder, which is created.
        vtk: True to write VTK files.
        plots: True to draw pictures.

    Returns:
        The paths of the written files.

    Raises:
        InputError: for an argument of another type.
        OSError: if the folder is not writable.

    >>> import tempfile
    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1)
    >>> run = hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40))
    >>> files = hj.write_run(run, tempfile.mkdtemp(), vtk=False, plots=False)
    >>> sorted(file.name for file in files)
    ['events.csv', 'kinks.csv', 'norms.csv', 'profile.nc', 'summary.json']
    """
    instance("run", run, Run)
    place = ResultFolder(as_path("folder", folder), owner_of_run(run.case)).open()
    written, files = write_results(run, place, vtk, plots, None)
    for caution in written.cautions[len(run.cautions) :]:
        warnings.warn(caution, stacklevel=2)
    return files


def write_results(
    run: Run, place: ResultFolder, vtk: bool, plots: bool, helper: Executor | None
) -> tuple[Run, list[Path]]:
    """Write data and summary, then VTK files and pictures.

    Return the run, with a caution for each product that could not be made, and the files.
    """
    drawn = None
    if plots and helper:
        with suppress(BrokenExecutor):  # without the helper this process draws
            drawn = helper.submit(_drawn_by_two, run)
    data: dict[str, bytes | str] = {
        "profile.nc": netcdf(run),
        "kinks.csv": to_csv(*with_survey_columns(KinkRecord._fields, run.kinks, run.units)),
        "events.csv": to_csv(*with_survey_columns(Event._fields, run.events, run.units)),
    }
    data[NORMS_FILE] = to_csv(*with_survey_columns(Norms._fields, run.norms.rows(), run.units))
    if run.vertical_steps is not None:
        data[STEPS_FILE] = to_csv(*with_survey_columns(VerticalStep._fields, run.vertical_steps, run.units))
    if run.surveyed is not None:
        data[SURVEY_FILE] = to_csv(SurveyLine._fields, zip(*(a.tolist() for a in run.surveyed), strict=True))
    place.remove(_OF_A_RUN)
    place.claim(*data, "summary.json", *(f"{name}.png" for name in PICTURES if plots))
    files = place.write(data)
    end = place.write({"summary.json": to_json(summary(run))})  # after the data: a folder with a summary is complete
    failures: list[str] = []
    if vtk:
        files += place.write(attempt(failures, "the VTK files could not be made", _vtk, run))
    if plots:
        pictures, undrawn = _drawn(run, drawn)
        files += place.write(pictures)
        failures += undrawn
    if failures:
        run = replace(run, cautions=[*run.cautions, *failures])
        end = place.write({"summary.json": to_json(summary(run))})
    return run, files + end


def check_memory(case: Case) -> None:
    """Raise InputError if the run of a case with all its files would need more than the memory of the machine."""
    files = case.plots or case.vtk
    try:
        case.grid.check_memory(case.problem.kept, *(WITH_FILES if files else RESULT_ONLY))
    except InputError as error:
        remedy = ", or leave files out by --no-plots and --no-vtk" if files else ""
        raise InputError(f"{case.source}: [domain] {error}{remedy}", "the-domain-and-the-grid") from None


def _drawn(run: Run, drawn: Future | None) -> tuple[dict[str, bytes | str], list[str]]:
    """Return the pictures, by the helper or by this process, and a warning for each that could not be drawn."""
    try:
        return drawn.result() if drawn else _pictures(run)
    except Exception:  # the helper has ended, or the run could not be sent to it
        return _pictures(run)


def _drawn_by_two(run: Run) -> tuple[dict[str, bytes | str], list[str]]:
    """Return the pictures as `_pictures` does; a fork of this process draws half of them."""
    half = len(PICTURES) // 2
    rest = by_a_fork(_pictures, run, PICTURES[half:])
    (files, failures), (more, others) = _pictures(run, PICTURES[:half]), rest()
    return files | more, failures + others


def _pictures(run: Run, names: Sequence[str] = PICTURES) -> tuple[dict[str, bytes | str], list[str]]:
    """Return pictures of a run, and a warning for each that could not be drawn."""
    files: dict[str, bytes | str] = {}
    failures: list[str] = []
    for name in names:
        files |= attempt(failures, f"{name}.png could not be drawn", _picture, run, name)
    return files, failures


def _picture(run: Run, name: str) -> dict[str, bytes | str]:
    from hjprofile.output.plots.runs import pictures

    return pictures(run, names=(name,))


def _vtk(run: Run) -> dict[str, bytes | str]:
    from hjprofile.output.vtk import vtk_files

    return {f"{VTK_FOLDER}/{name}": data for name, data in vtk_files(run).items()}


def attempt(
    failures: list[str], failed: str, make: Callable[..., dict[str, bytes | str]], *arguments: Any
) -> dict[str, bytes | str]:
    """Return the files that `make` makes; if it fails, return none and add a warning to `failures`."""
    try:
        return make(*arguments)
    except Exception as error:  # a failed picture must not lose the run
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST_REASON]
        failures.append(f"{failed} ({reason}); the data are complete")
        return {}


def netcdf(run: Run) -> bytes:
    """Return the content of `profile.nc`: netCDF-3 with 64-bit offsets and CF attributes."""
    from scipy.io import netcdf_file

    buffer = io.BytesIO()
    file = netcdf_file(buffer, "w", version=2)
    for name, value in run.attributes.items():
        # scipy encodes str as ASCII, cannot store an empty one, and stores a plain float in single precision
        setattr(file, name, (value or " ").encode() if isinstance(value, str) else np.float64(value))
    # a variable of fixed dimensions is limited to 2 GiB, one along the unlimited dimension to 2 GiB per saved time
    for dimension, size in (("time", None), ("node", run.x.size), ("cell", run.x_cell.size)):
        file.createDimension(dimension, size)
    fields = run.fields
    for name, (dimensions, values, attributes) in fields.items():
        variable = file.createVariable(name, "f8", dimensions)
        variable[:] = values
        for attribute, text in attributes.items():
            setattr(variable, attribute, text.encode())
        if len(dimensions) == 2:  # all coordinates along these dimensions except the dimensions themselves
            along = [
                n for n, (dims, *_) in fields.items() if n in COORDINATES and n not in dims and dims[0] in dimensions
            ]
            variable.coordinates = " ".join(along)
    file.flush()
    data = buffer.getvalue()
    file.close()
    return data


def summary(run: Run) -> dict[str, Any]:
    """Return the content of `summary.json` as a dictionary."""
    updates = run.steps * run.cells / run.wall_seconds if run.wall_seconds > 0 else None
    content: dict[str, Any] = {
        "title": run.title,
        "method": run.method,
        "status": run.status,
        "cells": run.cells,
        "steps": run.steps,
        "time_step": {"least": run.step_range[0], "largest": run.step_range[1]},
        "wall_seconds": run.wall_seconds,
        "cell_updates_per_second": updates,
        "error_estimate": run.error_estimate,
        "supplied": float(run.time[-1]),
        "norms_start": _norms_at(run, 0),
        "norms_end": _norms_at(run, -1),
        "kinks_at_end": len(run.kinks_at(-1)),
        "eroded_volume": run.eroded_volume,
        "eroded_volume_error": run.eroded_volume_error,
        "toe_outflow": run.toe_outflow,
        "toe_outflow_error": run.toe_outflow_error,
        "crest_lowering": run.crest_lowering,
        "volume_budget": {"difference": run.volume_budget_error, "promise": run.bounds["volume_budget"].allowance}
        if "volume_budget" in run.bounds
        else None,
        "bounds": {
            name: {"holds": b.holds, "worst_margin": b.worst_margin, "time": b.time, "x": b.x, "allowance": b.allowance}
            for name, b in run.bounds.items()
        },
        "warnings": run.warnings,
        "hjprofile_version": hjprofile.__version__,
    }
    if run.units:
        content["units"] = {"unit": ""} | run.units.attributes | {"volume_of_one": run.units.volume}
    if run.account:
        content["account"] = run.account
    return content


def _norms_at(run: Run, index: int) -> dict[str, float]:
    """Return the norms of q at a saved time."""
    columns = run.norms
    return {name: float(values[index]) for name, values in zip(("l1", "tv", "inf", "sup"), columns[1:5], strict=True)}


def to_json(content: Any, ascii_only: bool = False) -> str:
    """Return JSON text, with null for numbers that are not finite and with paths as text."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: plain(v) for k, v in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(v) for v in value]
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Path):
            return str(value)
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return json.dumps(plain(content), indent=2, ensure_ascii=ascii_only, allow_nan=False) + "\n"


def to_csv(header: Iterable[str], rows: Iterable[tuple]) -> str:
    """Return a CSV table with all digits of floats; None and NaN are empty fields."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow(["" if v is None or v != v else repr(float(v)) if isinstance(v, float) else v for v in row])
    return stream.getvalue()


def load_run(folder: str | Path) -> Run:
    """Read a run back from its result folder.

    Args:
        folder: the path of the folder.

    Returns:
        The run, with the arrays, tables and attributes that the solver returned.

    Raises:
        InputError: if the folder holds no complete and undamaged run.

    >>> import tempfile
    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1)
    >>> folder = tempfile.mkdtemp()
    >>> _ = hj.write_run(hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40)), folder, vtk=False, plots=False)
    >>> hj.load_run(folder).u.shape
    (31, 41)
    """
    folder = as_path("folder", folder)
    try:
        arrays, attributes = read_profile(folder / "profile.nc")
        text = {name: attributes[name].decode() for name in ("method", "case", "status")}
        units = Units.from_attributes(attributes)
        content = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=_no_number)
        bounds = {name: _verdict(table) for name, table in content["bounds"].items()}
        broken = sum(not bound.holds for bound in bounds.values())
        run = Run(
            title=content["title"], method=text["method"], case=tomllib.loads(text["case"]), **arrays,  # type: ignore[arg-type]
            status=text["status"], steps=content["steps"], wall_seconds=content["wall_seconds"],
            step_range=(_number(content["time_step"]["least"]), _number(content["time_step"]["largest"])),
            kinks=_table(folder, "kinks.csv", KinkRecord), events=_table(folder, "events.csv", Event),
            vertical_steps=_table(folder, STEPS_FILE, VerticalStep) if (folder / STEPS_FILE).exists() else None,
            eroded_volume=_number(content["eroded_volume"]), toe_outflow=_number(content["toe_outflow"]),
            crest_lowering=_number(content["crest_lowering"]), units=units,
            surveyed=_survey_line(folder) if (folder / SURVEY_FILE).exists() else None,
            bounds=bounds, volume_budget_error=_number((content["volume_budget"] or {}).get("difference")),
            error_estimate=content["error_estimate"], account=content.get("account", ""),
            toe_outflow_error=content["toe_outflow_error"], eroded_volume_error=content["eroded_volume_error"],
        )  # fmt: skip
        sentences = content["warnings"]  # on changes of the input first, on violated bounds last
        run = replace(run, cautions=tuple(sentences[len(run.input_changes) : len(sentences) - broken]))
        if fault := fault_of(run, content):
            raise ValueError(fault)
        return run
    except FileNotFoundError as error:
        under = Path("results") / folder
        remedy = f"did you mean {under}?" if under.is_dir() else "run the case again"
        message = f"{folder} is not a complete result folder: {Path(error.filename).name} is missing; {remedy}"
        raise InputError(message, about="a-result-folder") from None
    except NotADirectoryError:
        message = f"{folder} is not a readable result folder: it is a file; name the folder that `hjprofile run` wrote"
        raise InputError(message, about="a-result-folder") from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError, csv.Error) as e:
        named = "" if type(e) in (ValueError, InputError) else f"{type(e).__name__}: "
        reason = " ".join(f"{named}{e}".split())[:LONGEST_REASON]
        message = f"{folder} is not a readable result folder: {reason}; run the case again"
        raise InputError(message, about="a-result-folder") from None


def _no_number(name: str) -> None:
    raise ValueError(f"summary.json holds {name}, which is not JSON")


def _number(value: float | None) -> float:
    """Return a number of summary.json; null, which `to_json` writes for NaN, is NaN."""
    if isinstance(value, (str, bool)):
        raise TypeError(f"summary.json holds {value!r} instead of a number")
    return float("nan") if value is None else float(value)


def _verdict(table: dict[str, Any]) -> Verdict:
    margin, time, x = (_number(table[name]) for name in ("worst_margin", "time", "x"))
    return Verdict(table["holds"], margin, time, x, table["allowance"])


_OF_COLUMN: dict[str, Callable[[str], Any]] = {
    "event": str, "kink": int, "step": int, "into": lambda text: int(text) if text else None
}  # fmt: skip


def _table(folder: Path, name: str, kind: type[_Row]) -> list[_Row]:
    """Return the rows of a table; a column that is not in _OF_COLUMN holds numbers, NaN for an empty field."""
    with open(folder / name, newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream, strict=True)
        rows = list(reader)
    columns: Any = kind._fields  # type: ignore[attr-defined]
    known = list(columns), names_with_survey_columns(columns)  # without units, and with them
    if reader.fieldnames not in known or any(None in row or None in row.values() for row in rows):
        raise ValueError(f"{name} must have the columns {', '.join(columns)}")
    try:
        return [kind(**{n: _OF_COLUMN.get(n, _float)(row[n]) for n in columns}) for row in rows]
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _survey_line(folder: Path) -> SurveyLine:
    """Return the points of the survey of a stored run. Raise ValueError if the table holds other text."""
    rows = np.genfromtxt(folder / SURVEY_FILE, delimiter=",", names=True, encoding="utf-8", ndmin=1)
    if rows.dtype.names != SurveyLine._fields or rows.size < 2:
        raise ValueError(f"{SURVEY_FILE} must have the columns {', '.join(SurveyLine._fields)} and at least 2 rows")
    line = SurveyLine(*(rows[name] for name in SurveyLine._fields))
    if not np.all(np.isfinite(line)):
        raise ValueError(f"{SURVEY_FILE} holds a value that is not a finite number")
    return line


def _float(text: str) -> float:
    return float(text or "nan")
