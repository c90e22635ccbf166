"""Cases made from files of measured points as programs write them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hjprofile.problem.flank import one_flank
from hjprofile.problem.ranges import number
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
    """A survey and a case, as texts.

    Attributes:
        csv: the points with the header `x,height`, x increasing.
        case: the case file in TOML.
        account: sentences on everything that was done and assumed.
    """

    csv: str
    case: str
    account: list[str]


def import_survey(
    source: Path, file: str, title: str, critical_slope: float | None = None, length: float | None = None,
    columns: Sequence[str | int] | None = None, uphill: str | None = None, nodata: Sequence[float] = (),
    stretch: tuple[float | None, float | None] = (None, None),
) -> Imported:  # fmt: skip
    """Return a survey in the notation of hjprofile, and a case for it.

    Args:
        source: the file of measured points, see `read_survey`.
        file: the name of the new CSV file, which the case names.
        title: the title of the case.
        critical_slope: the neutral slope, height over length; the mean slope of the survey by default.
        length: the exchange length, in the unit of x; a tenth of the extent of the survey by default.
        columns, nodata: see `read_survey`.
        uphill: "left" or "right", the side of the crest; found from the heights by default.
        stretch: the smallest and the largest x that are used; None for no limit.

    Raises InputError for a file that is no survey, or one of two flanks.
    """
    points = read_points(source, columns, nodata)
    flank = one_flank(f"file = {str(source)!r}", points, uphill, *stretch)
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
    return Imported("x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows), case, account)
