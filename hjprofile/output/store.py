"""A result folder: netCDF, tables and a summary, each file whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import re
import tempfile
import tomllib
from collections.abc import Iterable
from concurrent.futures import BrokenExecutor, Executor, ThreadPoolExecutor
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

import hjprofile
from hjprofile.errors import InputError
from hjprofile.files import write_whole
from hjprofile.problem.units import Units
from hjprofile.solvers.run import FIELDS, UNITS, Event, KinkRecord, Run, Verdict, VerticalStep

VTK_FOLDER = "vtk"
STEPS_FILE = "vertical_steps.csv"
_HALF = re.compile(r"\..+\.(nc|csv|json|toml|png|svg|gif|mp4|npz|pvd|vtp|vtr)\.\w{8}")  # as `write_whole` names them
_PICTURES = ("profile", "diagram", "factor", "comparison")
_STALE = (
    STEPS_FILE, *(f"{name}.{form}" for name in _PICTURES for form in ("png", "svg")), "profile.gif", "profile.mp4",
    "vtk/*.pvd", "vtk/*.vtp", "vtk/*.vtr",
)  # fmt: skip


def open_folder(folder: Path) -> Path:
    """Makes the folder, tries that it can be written to, and removes halves that a killed run left beside its files.

    Raises OSError if it cannot be written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in (*folder.glob(".*"), *(folder / VTK_FOLDER).glob(".*")):
        if _HALF.fullmatch(path.name):
            path.unlink(missing_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return folder


def write_run(
    run: Run, folder: str | Path, vtk: bool = True, plots: bool = True, helper: Executor | None = None
) -> list[Path]:
    """Writes the whole result folder and returns its files; files of an earlier run there are replaced.

    A helper draws the pictures while the other files are made.
    """
    drawn = None
    if plots and helper:
        with suppress(BrokenExecutor):  # whoever is lost is done without
            drawn = helper.submit(_pictures, run)
    files: dict[str, bytes | str] = {
        "profile.nc": netcdf(run),
        "kinks.csv": to_csv(KinkRecord._fields, run.kinks),
        "events.csv": to_csv(Event._fields, run.events),
    }
    if run.vertical_steps is not None:
        files[STEPS_FILE] = to_csv(VerticalStep._fields, run.vertical_steps)
    if vtk:
        from hjprofile.output.vtk import vtk_files

        files |= {f"{VTK_FOLDER}/{name}": data for name, data in vtk_files(run).items()}
    if plots:
        try:
            files |= drawn.result() if drawn else _pictures(run)
        except BrokenExecutor:
            files |= _pictures(run)
    files["summary.json"] = to_json(summary(run))  # last: a folder with a summary is complete
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "summary.json").unlink(missing_ok=True)
    with ThreadPoolExecutor(8) as pool:
        for is_vtk, group in groupby(files.items(), lambda file: file[0].startswith(VTK_FOLDER)):
            # VTK's are many, and each waits for the disk; the others are written in their order
            for _ in (pool.map if is_vtk else map)(lambda file: write_whole(folder / file[0], file[1]), group):
                pass
    for pattern in _STALE:
        for path in folder.glob(pattern):
            if path.relative_to(folder).as_posix() not in files:
                path.unlink()
    return [folder / name for name in files]


def _pictures(run: Run) -> dict[str, bytes | str]:
    from hjprofile.output.plots.runs import pictures

    return pictures(run)


def netcdf(run: Run) -> bytes:
    """`profile.nc`: netCDF-3 with 64-bit offsets and CF attributes."""
    from scipy.io import netcdf_file

    buffer = io.BytesIO()
    file = netcdf_file(buffer, "w", version=2)
    for name, value in run.attributes.items():
        # scipy takes a str for ASCII, cannot store an empty one, and keeps a plain float in single precision
        setattr(file, name, (value or " ").encode() if isinstance(value, str) else np.float64(value))
    for dimension, size in (("time", run.time.size), ("node", run.x.size), ("cell", run.x_cell.size)):
        file.createDimension(dimension, size)
    for name, (dimensions, attributes) in FIELDS.items():
        variable = file.createVariable(name, "f8", dimensions)
        variable[:] = getattr(run, name)
        for attribute, value in attributes.items():
            setattr(variable, attribute, value)
        if len(dimensions) == 2:
            variable.coordinates = "x_cell" if dimensions[1] == "cell" else "x"
    file.flush()
    data = buffer.getvalue()
    file.close()
    return data


def summary(run: Run) -> dict[str, Any]:
    """`summary.json`, as a dictionary."""
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
        "end": float(run.time[-1]),
        "kinks_at_end": len(run.kinks_at(-1)),
        "eroded_volume": run.eroded_volume,
        "outflow": run.outflow,
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
    if run.error_estimate is not None:
        content["error_estimate"] = run.error_estimate
    if run.units:
        content["units"] = {name: getattr(run.units, name) for name in UNITS}
        content["units"]["volume_of_one"] = run.units.volume
    if run.account:
        content["account"] = run.account
    return content


def to_json(content: Any) -> str:
    """JSON text, with null for what is not a finite number and paths as text."""

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

    return json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def to_csv(header: Iterable[str], rows: Iterable[tuple]) -> str:
    """A table in which floats keep all their digits, and what is None or NaN is an empty field."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow(["" if v is None or v != v else repr(float(v)) if isinstance(v, float) else v for v in row])
    return stream.getvalue()


def load_run(folder: str | Path) -> Run:
    """A run read back from its result folder. Raises InputError if there is none."""
    from scipy.io import netcdf_file

    folder = Path(folder)
    try:
        with netcdf_file(folder / "profile.nc", "r", mmap=False) as file:
            arrays = {name: np.array(file.variables[name][:], dtype=float) for name in FIELDS}
            text = {n: getattr(file, n).decode() for n in ("method", "case", "status")}
            units = Units(*(float(getattr(file, n)) for n in UNITS)) if hasattr(file, UNITS[0]) else None
        kinks = [
            KinkRecord(**{n: int(v) if n == "kink" else float(v or "nan") for n, v in row.items()})  # type: ignore[arg-type]
            for row in _read(folder, "kinks.csv")
        ]
        events = [
            Event(float(r["time"]), r["event"], int(r["kink"]), int(r["into"]) if r["into"] else None, float(r["x"]))
            for r in _read(folder, "events.csv")
        ]
        steps = None
        if (folder / STEPS_FILE).exists():
            steps = [
                VerticalStep(**{n: int(v) if n == "step" else float(v) for n, v in row.items()})  # type: ignore[arg-type]
                for row in _read(folder, STEPS_FILE)
            ]
        content = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        broken = sum(not b["holds"] for b in content["bounds"].values())
        return Run(
            title=content["title"], method=text["method"], case=tomllib.loads(text["case"]), **arrays,  # type: ignore[arg-type]
            status=text["status"], steps=content["steps"], wall_seconds=content["wall_seconds"],
            step_range=(_number(content["time_step"]["least"]), _number(content["time_step"]["largest"])),
            kinks=kinks, events=events, vertical_steps=steps, eroded_volume=_number(content["eroded_volume"]),
            outflow=_number(content["outflow"]), units=units,
            bounds={
                name: Verdict(
                    b["holds"], _number(b["worst_margin"]), _number(b["time"]), _number(b["x"]), b["allowance"]
                )
                for name, b in content["bounds"].items()
            },
            volume_budget_error=_number((content["volume_budget"] or {}).get("difference")),
            error_estimate=content.get("error_estimate"),
            account=content.get("account", ""),
            cautions=tuple(content["warnings"][: len(content["warnings"]) - broken]),  # before those of broken bounds
        )  # fmt: skip
    except FileNotFoundError as error:
        under = Path("results") / folder
        remedy = f"did you mean {under}?" if under.is_dir() else "`hjprofile run` writes them whole"
        message = f"{folder} is not a complete result folder: {Path(error.filename).name} is missing; {remedy}"
        raise InputError(message, about="a-result-folder") from None
    except NotADirectoryError:
        message = f"{folder} is not a readable result folder: it is a file; name the folder that `hjprofile run` wrote"
        raise InputError(message, about="a-result-folder") from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        message = f"{folder} is not a readable result folder: {type(error).__name__}: {error}; run the case again"
        raise InputError(message, about="a-result-folder") from None


def _number(value: float | None) -> float:
    """JSON has no NaN: `to_json` writes null for it."""
    return float("nan") if value is None else float(value)


def _read(folder: Path, name: str) -> list[dict[str, str]]:
    with open(folder / name, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))
