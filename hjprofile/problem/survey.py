"""Surveyed slopes: heights from a CSV file, scaled, checked and on request repaired."""

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

REPAIR_SLOPE = 0.05  # least slope that a repaired survey keeps, as a fraction of the critical slope
# Of the relief, the farthest that a repair may move a point. Noise of 2 m moves those of the hillslope by 0.7 % of its
# 652 m at most, noise of 5 m by 2 %; what moves by a tenth has been mistyped, or was not measured
MOST_MOVED = 0.1
MOST_ROWS = 5  # that a message names
LONGEST_SHOWN = 60  # characters of a line in a message
FAR = 3.0  # times the critical slope, or a part of it: a mean slope that is told; a metre has 3.28 feet
ABOUT = "a-survey"  # heading of the page on errors
FORMAT = "the-file-of-a-survey"
DOES_NOT_RISE = "a-survey-that-does-not-rise"


@kind("survey", file=TEXT, critical_slope=POSITIVE, length=POSITIVE, repair=TEXT)
@np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks refuse
def survey(
    file: str | Path, critical_slope: float, length: float, repair: str | None = None, base: Path | None = None
) -> Profile:
    """A surveyed slope: a CSV file with header `x,height`, x increasing and uphill to the right.

    x and height are divided by `length` (the exchange length, over which an avalanche grows e-fold), height also by
    `critical_slope`; the last point becomes the origin. The profile is linear between points and has the critical
    slope left of the first. Raises InputError if the survey descends somewhere, unless `repair` is "isotonic": then
    it is replaced by the nearest profile (least squares) that rises everywhere by at least 0.05 of the critical slope;
    InputError where that moves a point by more than 0.1 of the relief, or the top is at the left.
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
            f"{'; ' if account else ''}the mean slope {mean:.3g} is {mean / critical_slope:.3g} of the critical: are x "
            "and height in one unit, and is critical_slope height over length, not an angle?"
        )
    return Points(np.repeat(xi, 2)[1:-1], np.repeat(q, 2), units=units, height=float(u[0] - xi[0]), account=account)


def _check_that_it_rises(file: str, x: Array, height: Array, rows: Sequence[int], falls: Array, repaired: bool) -> None:
    """Raise InputError if a survey passes a crest, has its top at the left, or falls without a repair."""
    if (top := crest(height)) is not None:
        raise InputError(
            f"file = {file!r} passes its crest in row {rows[top]} (x = {x[top]:g}), and a case is of one flank; keep "
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
        remedy = "this one has its top at the left, so mirror it (write -x for x, and the last row first)"
    else:
        most = np.max(np.abs(np.diff(height)[falls]))
        course = f"falls there by up to {most:.6g}" if most > 0.0 else "is flat there"
        remedy = f"this one {course} (correct it, or set repair = 'isotonic')"
    raise InputError(
        f"file = {file!r} does not rise in rows {pairs}; a survey must rise from left to right, and {remedy}",
        DOES_NOT_RISE,
    )


def _repaired(file: str, x: Array, height: Array, rows: Sequence[int], least: float) -> tuple[Array, str]:
    """Return the nearest rising heights, and an account of them. Raises InputError if one would move too far."""
    repaired = nearest_rising(x, height, least)
    moved = np.abs(repaired - height)
    far = moved > MOST_MOVED * np.ptp(repaired)
    if far.any():
        i = _farthest_off(height, moved, far)
        raise InputError(
            f"file = {file!r} row {rows[i]}: repair = 'isotonic' would move its height of {height[i]:g} by "
            f"{moved[i]:.5g}, more than a tenth of all that the survey rises; correct or delete that row",
            DOES_NOT_RISE,
        )
    rounding = 1e-9 * (np.ptp(height) + least * np.ptp(x))
    account = (
        f"survey repaired: {np.count_nonzero(moved > rounding)} of {x.size} points moved, "
        f"by {moved.max():.3g} at most and {np.sqrt(np.mean(moved**2)):.3g} on average (r.m.s.)"
    )
    return repaired, account


def nearest_rising(x: Array, height: Array, least: float) -> Array:
    """The heights nearest to these, by least squares, that rise everywhere by a slope of `least` and a hair."""
    from scipy.optimize import isotonic_regression

    tilt = (1 + 1e-9) * least * (x - x[-1])  # the hair: rounding cannot bring the slope below
    return isotonic_regression(height - tilt).x + tilt


def _farthest_off(height: Array, moved: Array, far: Array) -> int:
    """Which of the points that are `far` off is to blame, as a wrong height takes its neighbours along.

    That is the one which moves farthest, and lies farthest beyond the heights that stay.
    """
    beyond = np.zeros_like(height)
    if not far.all():
        stay = height[~far]
        beyond = np.abs(height - np.clip(height, stay.min(), stay.max()))
    return int(np.argmax(np.where(far, moved + beyond, 0.0)))


@np.errstate(all="ignore")
def read_survey(file: str | Path) -> tuple[Array, Array, list[int]]:
    """x, height and their rows in a CSV file with header `x,height` (which is row 1), x increasing.

    Raises InputError naming the row.
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
                "decimals, no separator for thousands, no unit; a row without a height is left out)"
            )
            raise InputError(message, FORMAT) from None
        if not (np.isfinite(x) and np.isfinite(height)):
            message = f"file = {str(file)!r} row {n}: {line!r} must be finite; omit rows without a measurement"
            raise InputError(message, FORMAT)
        if values and x <= values[-1][0]:
            raise InputError(
                f"file = {str(file)!r} row {n}: x = {x:g} must be greater than the x = {values[-1][0]:g} before it; "
                "sort the rows by x, and keep one height for each",
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
    """What is wrong with a header, as far as it can be guessed."""
    if re.search(r"[;\t]", found):
        return "columns are separated by commas, and decimals have a point"
    if re.search(r"\b(m|km|ft|feet|foot|in|yd|metres?|meters?)\b", found.replace("_", " ")):
        return "the header names no unit: any will do, the same for x, for height and for length"
    return "x is the horizontal distance, growing uphill, and height the elevation, in the same unit"
