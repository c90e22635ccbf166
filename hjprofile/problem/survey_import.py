"""Cases made from files of measured points as programs write them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.heights import crest, falls_on_the_whole
from hjprofile.problem.ranges import Array, number
from hjprofile.problem.survey_file import Points, read_points

ABOUT = "an-imported-survey"
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
{repair}
[domain]
left = {left!r}  # in exchange lengths; the toe lies at {toe:.4g}
cells = 2000

[time]
end = 1.0  # supplied grains, in units of critical_slope * length^2, which is {volume:.4g} per unit width
snapshots = 21
"""


class Imported(NamedTuple):
    """A survey and a case, as texts.

    Attributes:
        csv: the points with the header `x,height`, x increasing uphill.
        case: the case file in TOML.
        account: sentences on everything that was done and assumed.
    """

    csv: str
    case: str
    account: list[str]


def import_survey(
    source: Path, file: str, title: str, critical_slope: float | None = None, length: float | None = None,
    columns: Sequence[str | int] | None = None, uphill: str | None = None, nodata: Sequence[float] = (),
) -> Imported:  # fmt: skip
    """Return a survey in the notation of hjprofile, and a case for it.

    Args:
        source: the file of measured points, see `read_points`.
        file: the name of the new CSV file, which the case names.
        title: the title of the case.
        critical_slope: the neutral slope, height over length; the mean slope of the survey by default.
        length: the exchange length, in the unit of x; a tenth of the extent of the survey by default.
        columns, nodata: see `read_points`.
        uphill: "left" or "right", the side of the crest; found from the heights by default.

    Raises InputError for a file that is no survey, or one of two flanks.
    """
    points = read_points(source, columns, nodata)
    account = [points.account or f"{source.name}: {points.x.size} points"]
    x, height = _one_flank(source, points)
    if uphill == "left" or (uphill is None and falls_on_the_whole(height) and np.argmax(height) < height.size // 2):
        x, height = (x[0] + x[-1] - x)[::-1], height[::-1]
        account.append("mirrored, because the crest is at the left")
    extent, relief = float(x[-1] - x[0]), float(np.ptp(height))
    if not relief > 0.0:
        raise InputError(f"file = {str(source)!r} is level; a slope must rise from its toe to its crest", ABOUT)
    given = critical_slope is not None, length is not None
    slope = number("critical_slope", critical_slope, ABOUT) if given[0] else float(f"{relief / extent:.3g}")
    scale = number("length", length, ABOUT) if given[1] else float(f"{extent / LENGTHS_IN_EXTENT:.3g}")
    assumed = ["critical_slope (the mean slope)"] * (not given[0]) + ["length (a tenth of the extent)"] * (not given[1])
    if assumed:
        account.append(f"assumed: {' and '.join(assumed)}; replace by values of your ground")
    falls = int(np.count_nonzero(np.diff(height) <= 0.0))
    if falls:
        account.append(f"it does not rise in {falls} of {x.size - 1} intervals, so the case repairs it")
    case = CASE.format(
        source=source.name, account="; ".join(account).replace("\n", " "), title=title.replace('"', "'"), file=file,
        critical_slope=slope, length=scale, left=-float(f"{(1.0 + BEYOND_TOE) * extent / scale:.4g}"),
        slope_from="given" if given[0] else "assumed: the mean slope of the survey",
        length_from="given" if given[1] else "assumed: a tenth of the extent of the survey",
        repair='repair = "isotonic"  # the nearest heights that rise everywhere\n' if falls else "",
        toe=-extent / scale, volume=slope * scale**2,
    )  # fmt: skip
    rows = zip(x.tolist(), height.tolist(), strict=True)
    return Imported("x,height\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows), case, account)


def _one_flank(source: Path, points: Points) -> tuple[Array, Array]:
    """Return x and height of a survey that does not pass a crest. Raises InputError."""
    top = crest(points.height)
    if top is not None:
        raise InputError(
            f"file = {str(source)!r} passes its crest in row {points.rows[top]} (x = {points.x[top]:g}), but a case "
            "has one flank; delete the rows on the other side of the crest",
            ABOUT,
        )
    return points.x, points.height
