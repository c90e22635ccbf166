"""Commands on result folders: plot, export."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hjprofile.cli.common import Into, Json, answer, app, listing, say
from hjprofile.errors import InputError


@app.command
def plot(result: Path, /, *, out: Into = None, json: Json = False) -> None:
    """Draw the pictures of a result folder again, into it or into another folder."""
    from hjprofile.output.plots import pictures
    from hjprofile.output.store import load_run

    _write(out or result, pictures(load_run(result)), json)


@app.command
def export(
    result: Path,
    /,
    *,
    vtk: Annotated[bool, Parameter(help="Files for ParaView; the only format so far.")] = False,
    out: Into = None,
    json: Json = False,
) -> None:
    """Write the VTK files of a result folder, into its folder `vtk` or into another."""
    from hjprofile.output.store import VTK_FOLDER, load_run

    if not vtk:
        raise InputError("export needs a format: --vtk", about="the-command-line")
    from hjprofile.output.vtk import vtk_files

    _write(out or result / VTK_FOLDER, vtk_files(load_run(result)), json)


def _write(folder: Path, files: Mapping[str, bytes | str], json: bool) -> None:
    from hjprofile.output.store import write_whole

    for name, data in files.items():
        write_whole(folder / name, data)
    paths = [folder / name for name in files]
    say(json, f"{folder}: {listing(folder, paths)}")
    answer(json, {"files": paths})
