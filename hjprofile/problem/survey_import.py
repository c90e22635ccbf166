"""Cases made from files of measured points as programs write them."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path
from typing import NamedTuple, TypedDict, Unpack

import numpy as np

from hjprofile.errors import InputError
from hjprofile.files import write_whole
from hjprofile.problem.case import load_case
from hjprofile.problem.flank import one_flank
from hjprofile.problem.ranges import as_path, number
from hjprofile.problem.survey import check_options, nodata_of
from hjprofile.problem.survey_file import ABOUT, read_points

BEYOND_TOE = 0.02  # the grid begins this part of the extent below the toe
LENGTHS_IN_EXTENT = 10  # exchange lengths in the extent of a survey, if none is given
CASE = """# Made by `hjprofile import` from {source}: {account}
title = "{title}"

[erosion]
law = "rational"

[profile]
kind = "survey"
file = "{file}"
critical_slope = {critical_slope!r}  # neutral slope, height over length; {slope_from}
length = {length!r}  # exchange length, in the unit of x; {length_from}
{options}
[domain]
left = {left!r}  # in exchange lengths; the toe lies at {toe:.4g}
cells = 2000

[time]
supplied = {volume!r}  # volume of grains per unit width, in the unit of x squared; this is t = 1
snapshots = 21

[solver]
method = "auto"  # the method with the least work for this error
tolerance = 1e-3  # largest error of heights, in units of critical_slope * length, which is {rise:.3g}
"""


class Imported(NamedTuple):
    """A case made from a file of measured points.

    Attributes:
        case: the path of the case file.
        survey: the path of the CSV file of the points, which the case names.
        account: sentences on everything that was done and assumed.
    """

    case: Path
    survey: Path
    account: list[str]


# Which points of the file are used, as for `survey`
Reading = TypedDict(
    "Reading",
    {
        "columns": "Sequence[str | int] | None",
        "nodata": "float | Sequence[float] | None",
        "uphill": "str | None",
        "from": "float | None",
        "to": "float | None",
    },
    total=False,
)


def import_survey(
    source: str | Path, case: str | Path | None = None, critical_slope: float | None = None,
    length: float | None = None, **reading: Unpack[Reading],
) -> Imported:  # fmt: skip
    """Make a case from a file of measured points: a clean CSV file, and a case file next to it.

    Separators, decimal commas, headers, units in headers, gaps and the direction are recognised. No file is replaced.

    Args:
        source: the file of measured points, see `read_survey`.
        case: the path of the new case file; by default the name of the source, with .toml, in the current folder.
        critical_slope: the neutral slope, height over length; the mean slope of the survey by default.
        length: the exchange length, in the unit of x; a tenth of the extent of the survey by default.
        reading: `columns`, `nodata`, `uphill`, `from` and `to`, as for `survey`.

    Returns:
        The paths of both files, and an account of all changes and assumptions.

    Raises:
        InputError: for a file that is no survey, or one of two flanks, and if a file exists that would be replaced.
        OSError: if the files cannot be written.

    >>> import pathlib, tempfile
    >>> import hjprofile as hj
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "gps.txt").write_text("dist;elev\\n0;10,0\\n5;12,5\\n10;16,0\\n20;20,0\\n")
    >>> made = hj.import_survey(folder / "gps.txt", folder / "slope.toml", length=4.0)
    >>> made.case.name, made.survey.name, hj.load_case(made.case).problem.profile.units.length
    ('slope.toml', 'slope.csv', 4.0)
    """
    source = as_path("source", source)
    check_options(reading, Reading.__annotations__)
    path = Path(source.stem + ".toml") if case is None else as_path("case", case)
    table = path.with_suffix(".csv")
    if table.exists() and source.exists() and table.samefile(source):
        table = path.with_name(f"{path.stem}_clean.csv")
    for new in (path, table):
        if new.exists():
            raise InputError(f"{new} exists, and import replaces no file; choose another name for the case", ABOUT)
    csv, toml, account = _texts(source, table.name, path.stem, critical_slope, length, reading)
    with tempfile.TemporaryDirectory() as trial, chdir(trial):  # a case that would be rejected is not written
        Path(table.name).write_text(csv, encoding="utf-8")
        Path(path.name).write_text(toml, encoding="utf-8")
        load_case(Path(path.name))
    write_whole(table, csv)
    write_whole(path, toml)
    return Imported(path, table, account)


def _texts(
    source: Path, file: str, title: str, critical_slope: float | None, length: float | None, reading: Reading
) -> tuple[str, str, list[str]]:
    """Return a survey in the notation of hjprofile, a case for it, and the account.

    `file` is the name of the new CSV file, `title` the title of the case; options as for `import_survey`.

    Raise InputError for a file that is no survey, or one of two flanks.
    """
    points = read_points(source, reading.get("columns"), nodata_of(reading.get("nodata")))
    stretch = reading.get("from"), reading.get("to")
    flank = one_flank(f"file = {str(source)!r}", points, reading.get("uphill"), *stretch)
    account = [*flank.account] if points.account else [f"{source.name}: {points.x.size} points", *flank.account]
    extent, relief = float(np.ptp(flank.s)), float(np.ptp(flank.height))
    given = critical_slope is not None, length is not None
    slope = number("critical_slope", critical_slope, ABOUT) if given[0] else float(f"{relief / extent:.3g}")
    scale = number("length", length, ABOUT) if given[1] else float(f"{extent / LENGTHS_IN_EXTENT:.3g}")
    assumed = ["critical_slope (the mean slope)"] * (not given[0]) + ["length (a tenth of the extent)"] * (not given[1])
    if assumed:
        account.append(f"assumed: {' and '.join(assumed)}; replace by values of your ground")
    falls = int(np.count_nonzero(np.diff(flank.height) <= 0.0))
    if falls:
        account.append(f"it does not rise in {falls} of {flank.s.size - 1} intervals, so the case repairs it")
    options = f'unit = "{points.unit}"\n' if points.unit else ""
    options += 'uphill = "left"\n' if flank.direction < 0.0 else ""
    options += 'repair = "isotonic"  # the nearest heights that rise everywhere\n' if falls else ""
    case = CASE.format(
        source=source.name, account="; ".join(account).replace("\n", " "), title=title.replace('"', "'"), file=file,
        critical_slope=slope, length=scale, left=-float(f"{(1.0 + BEYOND_TOE) * extent / scale:.4g}"),
        slope_from="given" if given[0] else "assumed: the mean slope of the survey",
        length_from="given" if given[1] else "assumed: a tenth of the extent of the survey",
        options=options, toe=-extent / scale, volume=float(f"{slope * scale**2:.6g}"), rise=slope * scale,
    )  # fmt: skip
    order = slice(None, None, int(flank.direction))
    rows = zip(flank.x[order].tolist(), flank.height[order].tolist(), strict=True)
    return "x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows), case, account
