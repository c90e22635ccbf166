"""The commands on result folders: plot, compare, animate, export."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hjprofile.cli.common import OUT, Into, Json, Progress, Somewhere, answer, app, expanded, listing, say
from hjprofile.errors import InputError

if TYPE_CHECKING:
    from hjprofile.studies.accuracy import Comparison

Film = Annotated[
    Path | None,
    Parameter(
        OUT, converter=expanded, help="File that ends in .gif or .mp4; profile.gif in the result folder by default."
    ),
]
Fps = Annotated[float, Parameter(help="Saved times per second; 8 by default.")]


@app.command
def plot(result: Somewhere, /, *, out: Into = None, json: Json = False) -> None:
    """Draw the pictures of a result folder again, as PNG and as SVG, into it or into another folder."""
    from hjprofile.output.plots.runs import pictures
    from hjprofile.output.store import load_run

    _write(result, out or result, pictures(load_run(result), ("png", "svg")), json)


@app.command
def compare(result: Somewhere, other: Somewhere, /, *, out: Into = None, json: Json = False) -> None:
    """Print the differences of two results, and draw both with their differences into the first folder or another.

    The grids must be the same, or one a refinement of the other. Surveys with different exchange lengths or critical
    slopes are compared in their unit at equal supplied volumes. Writes comparison.png and comparison.svg.
    """
    from hjprofile.output.plots.comparison import comparison_pictures
    from hjprofile.output.store import load_run
    from hjprofile.studies.accuracy import compare as norms_of
    from hjprofile.studies.accuracy import in_survey_units

    first, second = load_run(result), load_run(other)
    norms = norms_of(first, second)
    names = (result.resolve().name, other.resolve().name)
    if names[0] == names[1]:
        names = (str(result), str(other))
    files = comparison_pictures(first, second, names)
    lines = [f"{name}: {run.method}, {run.cells} cells" for name, run in zip(names, (first, second), strict=True)]
    survey = in_survey_units(norms, first, second)
    lines += [*_distances(norms, (first.time.size, second.time.size), survey), "  written     "]
    document = norms._asdict() | {"survey": survey}
    _write(result, out or result, files, json, document, "\n".join(lines))


def _distances(norms: Comparison, saved: tuple[int, int], survey: Mapping[str, Any] | None) -> list[str]:
    """Return the account of a comparison: times, heights, slopes, kinks. `survey` holds values in the survey's unit."""
    from hjprofile.problem.units import IN_SURVEY, UNNAMED

    name = survey["unit"] if survey else ""
    unit, area = (f" {name}", f" {name}²") if name != UNNAMED else (f" {IN_SURVEY}",) * 2
    kinks = f"{norms.kinks:.2g}" if norms.kinks == norms.kinks else "no kinks to compare"
    if norms.unit:
        between = f"; the second run is interpolated at {norms.interpolated}" if norms.interpolated else ""
        return [
            f"  units       they differ; the runs are compared on their common ground, in {name}",
            f"  times       {norms.shared_times} equal supplied volumes, of {saved[0]} and {saved[1]} saved{between}",
            f"  height      ∫|Δ height| dx = {norms.height_l1:.2g}{area}, sup|Δ height| = {norms.height_sup:.2g}{unit}",
            f"  slope       ∫|Δ slope| dx = {norms.slope_l1:.2g}{unit}, sup|Δ slope| = {norms.slope_max:.2g}",
            f"  kinks       {kinks}{unit if norms.kinks == norms.kinks else ''}",
        ]
    heights = ""
    if survey:
        first = f"{survey['height_l1']:.2g}" + (area if name != UNNAMED else "")
        heights = f" ({first} and {survey['height_sup']:.2g}{unit})"
        kinks += f" ({survey['kinks']:.2g}{unit})" if norms.kinks == norms.kinks else ""
    return [
        f"  times       {norms.shared_times} shared, of {saved[0]} and {saved[1]} saved times",
        f"  height      ∫|u₁ - u₂| dx = {norms.height_l1:.2g}, sup|u₁ - u₂| = {norms.height_sup:.2g}{heights}",
        f"  slope       ∫|q₁ - q₂| dx = {norms.slope_l1:.2g}, sup|q₁ - q₂| = {norms.slope_max:.2g}",
        f"  kinks       {kinks}",
    ]


@app.command
def animate(result: Somewhere, /, *, out: Film = None, fps: Fps = 8.0, json: Json = False) -> None:
    """Write the saved times of a result folder as an animation: a GIF, or an MP4 if ffmpeg is installed."""
    from hjprofile.output.plots.animation import animation
    from hjprofile.output.store import load_run

    file = out or result / "profile.gif"
    with Progress("animating", solves=False) as progress:
        data = animation(load_run(result), file.suffix.lower(), fps, progress)
    _write(result, file.parent, {file.name: data}, json, mixed=out is not None)


@app.command
def export(
    result: Somewhere,
    /,
    *,
    vtk: Annotated[bool, Parameter(help="Write VTK files, for ParaView; the only format.")] = False,
    out: Into = None,
    json: Json = False,
) -> None:
    """Write the VTK files of a result folder into its folder `vtk` or into another."""
    from hjprofile.output.store import VTK_FOLDER, load_run

    if not vtk:
        raise InputError("export needs a format: --vtk", about="the-command-line")
    from hjprofile.output.vtk import vtk_files

    files = vtk_files(load_run(result))
    if out is None:
        files = {f"{VTK_FOLDER}/{name}": data for name, data in files.items()}
    _write(result, out or result, files, json)


def _write(
    result: Path,
    folder: Path,
    files: Mapping[str, bytes | str],
    json: bool,
    found: Mapping[str, Any] | None = None,
    account: str = "",
    mixed: bool = False,
) -> None:
    """Write the files made from a result. Then print the account, if there is one, and the files.

    `mixed` is True if the user names the file, in a folder of any content.
    """
    from hjprofile.output.folder import add_files

    paths = add_files(result, folder, files, mixed)
    inside = {path.parent for path in paths}
    shown = inside.pop() if len(inside) == 1 else folder
    say(json, f"{account}{shown}: {listing(shown, paths)}")
    answer(json, {**(found or {}), "files": paths})
