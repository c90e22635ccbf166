"""Surveyed slopes: heights from a CSV file, scaled, checked and repaired on request."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.heights import crest, falls_on_the_whole, without_height
from hjprofile.problem.kinds import POSITIVE, TEXT
from hjprofile.problem.paths import located, require_file
from hjprofile.problem.profiles import Points, Profile, kind
from hjprofile.problem.ranges import RANGES, Array, as_path, number, shown
from hjprofile.problem.units import Units

REPAIR_SLOPE = 0.05  # smallest slope of a repaired survey, as a fraction of the critical slope
# Largest move of a point by a repair, relative to the relief. Noise of 2 m moves points of the hillslope by 0.7 % of
# its 652 m at most, noise of 5 m by 2 %. A point that moves by a tenth was mistyped or not measured.
MOST_MOVED = 0.1
MOST_ROWS = 5  # named in a message
LONGEST_SHOWN = 60  # characters of a line in a message
FAR = 3.0  # ratio of mean and critical slope, or its inverse, that is reported; a metre has 3.28 feet
ABOUT = "a-survey"  # heading of the page on errors
FORMAT = "the-file-of-a-survey"
DOES_NOT_RISE = "a-survey-that-does-not-rise"


@kind("survey", file=TEXT, critical_slope=POSITIVE, length=POSITIVE, repair=TEXT)
@np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks reject
def survey(
    file: str | Path, critical_slope: float, length: float, repair: str | None = None, base: Path | None = None
) -> Profile:
    """Return the profile of a surveyed slope, linear between its points, with the neutral slope left of the first.

    The last point becomes the origin.

    Args:
        file: a CSV file with the header `x,height`; x increases uphill, in the unit of the survey.
        critical_slope: the neutral slope, height over length, positive.
        length: the exchange length, in the unit of the survey, positive. x is divided by it, heights by it and by
            `critical_slope`.
        repair: "isotonic" replaces a survey that falls by the nearest heights (least squares) that rise everywhere by
            at least 0.05 of the critical slope; None rejects such a survey.
        base: the folder to which `file` is relative.

    Returns:
        The profile, with `units` for the way back to the survey.

    Raises:
        InputError: if the survey falls and is not repaired, if a repair would move a height by more than 0.1 of the
            relief, if the crest is at the left, or if the file holds no survey.

    >>> import hjprofile as hj
    >>> file = hj.shipped_cases()["hillslope"].parent / "hillslope.csv"
    >>> slope = hj.survey(file, critical_slope=0.257, length=200.0, repair="isotonic")
    >>> round(slope.start(), 2)
    -12.68
    """
    critical_slope, length = number("critical_slope", critical_slope, ABOUT), number("length", length, ABOUT)
    if not (repair is None or (isinstance(repair, str) and repair == "isotonic")):
        raise InputError(f"repair = {shown(repair)} is not known; allowed is 'isotonic'", ABOUT)
    x, height, rows = read_survey(located(base or Path(), as_path("file", file)))
    least = REPAIR_SLOPE * critical_slope if repair else 0.0
    falls = np.flatnonzero(np.diff(height) <= least * np.diff(x))
    _check_that_it_rises(str(file), x, height, rows, falls, repair is not None)
    account = ""
    if falls.size:
        height, account = _repaired(str(file), x, height, rows, least)
    units = Units(length, critical_slope, float(x[-1]), float(height[-1]))
    xi = (x - x[-1]) / length
    u = (height - height[-1]) / (length * critical_slope)
    q = np.diff(u) / np.diff(xi) - 1.0
    if not (np.all((q > -1.0) & (q <= RANGES["q"].most)) and RANGES["x"].holds(xi[0])):
        raise InputError(
            f"file = {str(file)!r} divided by length = {length:g} and critical_slope = {critical_slope:g} leaves the "
            "range of numbers",
            ABOUT,
        )
    mean = float(np.ptp(height) / np.ptp(x))
    if not 1 / FAR < mean / critical_slope < FAR:
        account += (
            f"{'; ' if account else ''}the mean slope {mean:.3g} is {mean / critical_slope:.3g} times the critical "
            "slope; check that x and height have the same unit, and that critical_slope is height over length, not "
            "an angle"
        )
    return Points(np.repeat(xi, 2)[1:-1], np.repeat(q, 2), units=units, height=float(u[0] - xi[0]), account=account)


def _check_that_it_rises(file: str, x: Array, height: Array, rows: Sequence[int], falls: Array, repaired: bool) -> None:
    """Raise InputError if a survey passes a crest, has its crest at the left, or falls without a repair."""
    if (top := crest(height)) is not None:
        raise InputError(
            f"file = {file!r} passes its crest in row {rows[top]} (x = {x[top]:g}), but a case has one flank; keep "
            f"rows {rows[0]} to {rows[top]}, or mirror rows {rows[top]} to {rows[-1]} (write -x for x, and the last "
            "row first)",
            DOES_NOT_RISE,
        )
    upside_down = falls_on_the_whole(height) and np.argmax(height) < height.size // 2
    if not falls.size or (repaired and not upside_down):
        return
    pairs = ", ".join(f"{rows[i]}-{rows[i + 1]}" for i in falls[:MOST_ROWS])
    pairs += ", ..." if falls.size > MOST_ROWS else ""
    if upside_down:
        remedy = "this one has its crest at the left, so mirror it (write -x for x, and the last row first)"
    else:
        most = np.max(np.abs(np.diff(height)[falls]))
        course = f"falls there by up to {most:.6g}" if most > 0.0 else "is flat there"
        remedy = f"this one {course} (correct it, or set repair = 'isotonic')"
    raise InputError(
        f"file = {file!r} does not rise in rows {pairs}; a survey must rise from left to right, and {remedy}",
        DOES_NOT_RISE,
    )


def _repaired(file: str, x: Array, height: Array, rows: Sequence[int], least: float) -> tuple[Array, str]:
    """Return the nearest rising heights, and an account of them. Raise InputError if a height would move too far."""
    repaired = nearest_rising(x, height, least)
    moved = np.abs(repaired - height)
    far = moved > MOST_MOVED * np.ptp(repaired)
    if far.any():
        i = _farthest_off(height, moved, far)
        raise InputError(
            f"file = {file!r} row {rows[i]}: repair = 'isotonic' would move its height of {height[i]:g} by "
            f"{moved[i]:.5g}, more than a tenth of the relief; correct or delete that row",
            DOES_NOT_RISE,
        )
    rounding = 1e-9 * (np.ptp(height) + least * np.ptp(x))
    account = (
        f"survey repaired: {np.count_nonzero(moved > rounding)} of {x.size} points moved, "
        f"by {moved.max():.3g} at most and {np.sqrt(np.mean(moved**2)):.3g} on average (r.m.s.)"
    )
    return repaired, account


def nearest_rising(x: Array, height: Array, least: float) -> Array:
    """Return the nearest heights, by least squares, that rise everywhere by slightly more than the slope `least`."""
    from scipy.optimize import isotonic_regression

    tilt = (1 + 1e-9) * least * (x - x[-1])  # the factor keeps the slope above `least` after rounding
    return isotonic_regression(height - tilt).x + tilt


def _farthest_off(height: Array, moved: Array, far: Array) -> int:
    """Return the index of the wrong height among the points that are `far` off; a wrong height also moves its
    neighbours.

    It is the one that moves farthest and lies farthest beyond the heights that stay.
    """
    beyond = np.zeros_like(height)
    if not far.all():
        stay = height[~far]
        beyond = np.abs(height - np.clip(height, stay.min(), stay.max()))
    return int(np.argmax(np.where(far, moved + beyond, 0.0)))


@np.errstate(all="ignore")
def read_survey(file: str | Path) -> tuple[Array, Array, list[int]]:
    """Read a survey from a CSV file with the header `x,height`.

    Args:
        file: the path of the file; its header is row 1, lines that begin with # are comments.

    Returns:
        x, increasing, and height, both of shape (n,) in the unit of the survey, and the list of their rows.

    Raises:
        InputError: with the row that is at fault.

    >>> import hjprofile as hj
    >>> x, height, rows = hj.read_survey(hj.shipped_cases()["hillslope"].parent / "hillslope.csv")
    >>> x.shape == height.shape == (len(rows),)
    True
    """
    file = as_path("file", file)
    require_file(file)
    try:
        with open(file, newline="", encoding="utf-8-sig") as stream:
            text = list(stream)
        reader = csv.reader(text)
        lines = [
            (n, row, text[reader.line_num - 1].strip()[:LONGEST_SHOWN])
            for n, row in enumerate(reader, start=1)
            if row and row[0].strip()[:1] != "#"
        ]
    except (OSError, csv.Error) as error:
        raise InputError(f"file = {str(file)!r} cannot be read as CSV: {error}", ABOUT) from None
    except ValueError as error:
        message = f"file = {str(file)!r} cannot be read as CSV: {error}; save it as text in UTF-8"
        raise InputError(message, FORMAT) from None
    if not lines or [c.strip() for c in lines[0][1]] != ["x", "height"]:
        found = lines[0][2] if lines else "nothing"
        message = f"file = {str(file)!r} must begin with the header 'x,height', not {found!r}"
        raise InputError(f"{message}; {_what_a_header_is(found)}", FORMAT)
    rows: list[int] = []
    values: list[tuple[float, float]] = []
    for n, row, line in lines[1:]:
        try:
            x, height = (float(c) for c in row)
        except ValueError:
            message = (
                f"file = {str(file)!r} row {n}: {line!r} must be two numbers (a comma between them, points for "
                "decimals, no separator for thousands, no unit; omit a row without a height)"
            )
            raise InputError(message, FORMAT) from None
        if not (np.isfinite(x) and np.isfinite(height)):
            message = f"file = {str(file)!r} row {n}: {line!r} must be finite; omit rows without a measurement"
            raise InputError(message, FORMAT)
        if values and x <= values[-1][0]:
            raise InputError(
                f"file = {str(file)!r} row {n}: x = {x:g} must be greater than the x = {values[-1][0]:g} before it; "
                "sort the rows by x, and keep one height per x",
                "a-survey-whose-x-does-not-increase",
            )
        rows.append(n)
        values.append((x, height))
    if len(values) < 2:
        raise InputError(f"file = {str(file)!r} has {len(values)} points; a survey needs at least 2", ABOUT)
    x, height = np.array(values).T
    if (none := without_height(x, height)).any():
        which = [row for row, missing in zip(rows, none, strict=True) if missing]
        more = f", ... ({len(which)} in all)" if len(which) > MOST_ROWS else ""
        raise InputError(
            f"file = {str(file)!r} row{'s' * (len(which) > 1)} {', '.join(map(str, which[:MOST_ROWS]))}{more}: "
            f"{height[none][0]:g} is not a measured height; delete these rows, or correct them",
            FORMAT,
        )
    return x, height, rows


def _what_a_header_is(found: str) -> str:
    """Return a guess at the fault of a header."""
    if re.search(r"[;\t]", found):
        return "columns are separated by commas, and decimals have a point"
    if re.search(r"\b(m|km|ft|feet|foot|in|yd|metres?|meters?)\b", found.replace("_", " ")):
        return "the header must not name a unit; x, height and length may have any unit, but the same one"
    return "x is the horizontal distance, increasing uphill, and height the elevation, in the same unit"
