"""Surveyed slopes: measured heights of one flank, scaled, and repaired on request."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.flank import Flank, one_flank, resampled, rising
from hjprofile.problem.heights import rounding_of, scatter_of
from hjprofile.problem.kinds import COLUMNS, LIST, NUMBER, NUMBERS, POSITIVE, TEXT, Kind
from hjprofile.problem.paths import folder_of, located
from hjprofile.problem.profile_base import Profile, kind
from hjprofile.problem.profiles import Points
from hjprofile.problem.ranges import RANGES, Array, as_path, number, shown
from hjprofile.problem.schema import REQUIRED
from hjprofile.problem.survey_file import Measured, from_arrays, read_points, unit_named
from hjprofile.problem.units import SurveyLine, Units

REPAIR_SLOPE = 0.05  # smallest slope of a repaired survey, as a fraction of the critical slope
# Ratios of mean and critical slope, or their inverses: one that is reported (a metre has 3.28 feet), and one that is
# refused (a kilometre has 1000 metres).
FAR, TOO_FAR = 3.0, 100.0
FEET = 1 / 0.3048
STEEPEST = 5.0  # critical slope above which it is probably an angle in degrees: 79 degrees
REPORTED_JUMP = 0.05  # jump of q of the weakest kinks on a grid; rounding that hides only weaker ones is not reported
MARGIN = 1.6  # jumps are multiples of unit/Δs: this one lies between the third and the fourth
MOST_POINTS = 0.9  # part of the points with a smaller jump by rounding; a few points may lie very near each other
SMOOTH_NOISE = 0.1  # noise of q, see `smoothed`
LEAST_SMOOTHING, MOST_SMOOTHING = (
    2.0,
    0.0625,
)  # spacings of a smoothed survey: of its points, and as a part of its extent
ABOUT = "a-survey"
UNITS_DIFFER = "feet-degrees-and-mixed-units"

OPTIONS: dict[str, Kind] = {
    "from": NUMBER, "to": NUMBER, "resample": POSITIVE, "repair_limit": POSITIVE, "columns": COLUMNS, "nodata": NUMBERS,
    "unit": TEXT,
}  # fmt: skip
# How the points of a survey are read and prepared
Reading = TypedDict(
    "Reading",
    {
        "columns": "Sequence[str | int] | None",
        "nodata": "float | Sequence[float] | None",
        "unit": "str | None",
        "uphill": "str | None",
        "from": "float | None",
        "to": "float | None",
        "resample": "float | None",
        "repair_limit": "float | None",
    },
    total=False,
)


@kind(
    "survey", file=TEXT, x=LIST, height=LIST, critical_slope=POSITIVE, length=POSITIVE, repair=TEXT,
    repair_limit=POSITIVE, columns=COLUMNS, nodata=NUMBERS, unit=TEXT, uphill=TEXT, resample=POSITIVE,
    to=NUMBER, **{"from": NUMBER},  # type: ignore[arg-type]
)  # fmt: skip
@np.errstate(all="ignore")  # numbers out of range become inf or NaN, which the checks reject
def survey(
    file: str | Path | None = None, critical_slope: float = REQUIRED, length: float = REQUIRED,
    repair: str | None = None, *, x: Sequence[float] | None = None,
    height: Sequence[float] | None = None, **reading: Unpack[Reading],
) -> Profile:  # fmt: skip
    """Return the profile of a surveyed slope, linear between its points, with the neutral slope below its toe.

    The crest becomes the origin.

    Args:
        file: a file of points in any of the usual notations (`read_survey`).
        critical_slope: the neutral slope, height over length, positive.
        length: the exchange length, in the unit of the survey, positive. Distances are divided by it, heights by it and
            by `critical_slope`.
        repair: "isotonic" replaces a survey that falls by the nearest heights (least squares) that rise everywhere by
            at least 0.05 of the critical slope; None rejects such a survey.
        x, height: the points as arrays, shape (n,), n >= 2, in the place of a file; NaN is a missing height.
        reading: `columns`: names, or numbers from 1 on, of the columns of x and height, or of x, y and height.
            `nodata`: a number or numbers that stand for a missing height. `unit`: name of the unit of length, for
            labels. `uphill`: "left" or "right", the side of the crest, by default found from the heights. `from`, `to`:
            the stretch of x that is used. `resample`: the spacing of new points, each the result of a least-squares
            fit, which smooths. `repair_limit`: the largest move of a height by a repair.

    Returns:
        The profile. `units` is the way back to the survey, `surveyed` are its points, and `account` states what was
        done to them.

    Raises:
        InputError: if the survey falls and is not repaired, if a repair moves a height by more than its limit, if the
            survey has two flanks, if its mean slope differs from the critical one by a factor of more than 100, or if
            the file holds no survey.

    >>> import hjprofile as hj
    >>> file = hj.shipped_cases()["hillslope"].parent / "hillslope.csv"
    >>> slope = hj.survey(file, critical_slope=0.257, length=200.0, repair="isotonic")
    >>> round(slope.start(), 2)
    -12.68
    >>> hj.survey(x=[0.0, 10.0, 20.0], height=[3.0, 5.0, 9.0], critical_slope=0.3, length=5.0, unit="m").start()
    -4.0
    """
    for key, value in (("critical_slope", critical_slope), ("length", length)):
        if value is REQUIRED:
            raise InputError(f"{key} is missing; it must be {RANGES[key].words}", ABOUT)
    critical_slope, length = number("critical_slope", critical_slope, ABOUT), number("length", length, ABOUT)
    check_options(reading, Reading.__annotations__, repair)
    name, points = _points(file, x, height, reading)
    flank = one_flank(name, points, reading.get("uphill"), reading.get("from"), reading.get("to"))
    _check_units(flank, critical_slope)
    spacing = reading.get("resample")
    used = resampled(flank, spacing) if spacing is not None else flank
    used = rising(used, REPAIR_SLOPE * critical_slope, repair is not None, reading.get("repair_limit"))
    units = Units(length, critical_slope, float(used.x[-1]), float(used.height[-1]), points.unit, flank.direction)
    profile = _scaled(used, units)
    line = SurveyLine(flank.x, flank.height, np.interp(flank.s, used.s, used.height))
    unit = rounding_of(flank.height)
    jump = _jump_of_rounding(used.s, unit) / critical_slope
    rounded = f"heights are rounded to {unit:g}, so kinks with a jump of q below {jump:.2g} are not reported"
    notes = [*used.account, *[rounded] * (jump >= REPORTED_JUMP), *_unlikely(flank, critical_slope)]
    return replace(profile, account="; ".join(notes), surveyed=line, rounding=jump)


class Smoothed(NamedTuple):
    """A survey without its noise.

    Attributes:
        profile: the profile of the survey resampled at `spacing`.
        spacing: in the unit of the survey.
        scatter: standard deviation of the heights from a smooth line, in the unit of the survey.
    """

    profile: Profile
    spacing: float
    scatter: float


def smoothed(profile: Profile) -> Smoothed | None:
    """Return a survey resampled so coarsely that noise changes q by about SMOOTH_NOISE / 3; None if it is smooth.

    Noise σ at the spacing Δ changes the mean height of H/Δ points by σ sqrt(Δ/H), hence a slope over the distance H by
    about σ sqrt(3 Δ/H)/H. At the spacing H where this is SMOOTH_NOISE times the critical slope, noise still lowers ln
    K; at 2 H it does not (docs/cases.md has the measurements).
    """
    line, units = profile.surveyed, profile.units
    if line is None or units is None or profile.table.get("resample") is not None:
        return None
    s = units.direction * line.x
    extent, gap = float(np.ptp(s)), float(np.median(np.diff(s)))
    scatter = scatter_of(s, line.height)
    spacing = 2.0 * (np.sqrt(3.0 * gap) * scatter / (SMOOTH_NOISE * units.critical_slope)) ** (2.0 / 3.0)
    if not MOST_SMOOTHING * extent >= spacing >= LEAST_SMOOTHING * gap:
        return None
    spacing = float(f"{spacing:.2g}")
    flank = resampled(Flank("the survey", s, line.height, [], units.direction, []), spacing)
    flank = rising(flank, REPAIR_SLOPE * units.critical_slope, True, None)
    return Smoothed(_scaled(flank, units), spacing, scatter)


def _scaled(flank: Flank, units: Units) -> Points:
    """Return the profile of a flank. Raise InputError if its numbers are out of range."""
    xi = (flank.s - flank.s[-1]) / units.length
    u = (flank.height - flank.height[-1]) / units.rise
    q = np.diff(u) / np.diff(xi) - 1.0
    if not (np.all((q > -1.0) & (q <= RANGES["q"].most)) and RANGES["x"].holds(xi[0])):
        raise InputError(
            f"{flank.name} divided by length = {units.length:g} and critical_slope = {units.critical_slope:g} leaves "
            "the range of numbers",
            ABOUT,
        )
    return Points(np.repeat(xi, 2)[1:-1], np.repeat(q, 2), units=units, height=float(u[0] - xi[0]))


def _jump_of_rounding(s: Array, unit: float) -> float:
    """Return the jump of slope at most points above which heights rounded to a unit are not its cause.

    Three heights that are wrong by half a unit change the slopes on both sides by unit/Δs each. MARGIN allows for the
    change of slope from point to point of a smooth slope, which adds to it.
    """
    gap = np.diff(s)
    jumps = MARGIN * unit * (1.0 / gap[:-1] + 1.0 / gap[1:])
    return float(np.quantile(jumps, MOST_POINTS)) if jumps.size else 0.0


def read_survey(
    file: str | Path, columns: Sequence[str | int] | None = None, nodata: float | Sequence[float] | None = None
) -> tuple[Array, Array, list[int]]:
    """Read the points of a survey from a text file.

    Separators (comma, semicolon, tab, bar, blanks), decimal commas, thousands, encodings (UTF-8, UTF-16, Latin-1),
    comments, headers, further columns, missing heights, and descending or repeated x are recognised.

    Args:
        file: the path of the file.
        columns: names, or numbers from 1 on, of the columns of x and height, or of x, y and height, of which the first
            two give the distance along the line; by default found from the header and the content.
        nodata: a number or numbers that stand for a missing height, besides the common ones.

    Returns:
        x, increasing, and height, both of shape (n,) in the unit of the survey, and the list of their rows; the first
        line of the file is row 1.

    Raises:
        InputError: with the rows that are at fault.

    >>> import hjprofile as hj
    >>> x, height, rows = hj.read_survey(hj.shipped_cases()["hillslope"].parent / "hillslope.csv")
    >>> x.shape == height.shape == (len(rows),)
    True
    """
    reading: Reading = {"columns": columns, "nodata": nodata}
    check_options(reading, Reading.__annotations__)
    points = _points(file, None, None, reading)[1]
    return points.x, points.height, points.rows


def _points(file: Any, x: Any, height: Any, reading: Reading) -> tuple[str, Measured]:
    """Return the points of a file or of two arrays, and their name in messages. Raises InputError."""
    unit, nodata = reading.get("unit"), nodata_of(reading.get("nodata"))
    if file is None and x is None and height is None:
        raise InputError("file is missing; it must be a file of points; in its place x and height may be given", ABOUT)
    if file is not None and not (x is None and height is None):
        raise InputError("a survey needs either a file, or x and height", ABOUT)
    if file is None:
        return "the survey", from_arrays(x, height, nodata, unit or "")
    path = located(folder_of(file), as_path("file", file))
    name = f"file = {str(path)!r}"
    points = read_points(path, reading.get("columns"), nodata)
    stated, found = unit_named(unit or ""), unit_named(points.unit)
    if stated and found and stated != found:
        raise InputError(
            f"{name} is in {found} according to its header, and unit = {unit!r}; correct one of them", UNITS_DIFFER
        )
    return name, points._replace(unit=unit or found)


def nodata_of(missing: float | Sequence[float] | None) -> Array:
    """Return the numbers that stand for a missing height, as an array."""
    return np.atleast_1d(np.array([] if missing is None else missing, dtype=float))


def check_options(reading: Mapping[str, Any], known: Iterable[str], repair: Any = None) -> None:
    """Raise InputError with all options that are not known or out of range."""
    faults = []
    for name in reading:
        if name not in known:
            faults.append(f"{name} is not an option of a survey (allowed: {', '.join(known)})")
    for name, value, allowed in (
        ("repair", repair, ("isotonic",)),
        ("uphill", reading.get("uphill"), ("left", "right")),
    ):
        if value is not None and not (isinstance(value, str) and value in allowed):
            faults.append(f"{name} = {shown(value)} is not known; allowed is {' or '.join(map(repr, allowed))}")
    for name, wanted in OPTIONS.items():
        value = reading.get(name)
        with_lists = list(value) if isinstance(value, (tuple, np.ndarray)) else value
        try:
            if value is not None:
                wanted.read(with_lists)
        except (TypeError, ValueError):
            faults.append(f"{name} = {shown(value)} must be {wanted.words}")
    if faults:
        raise InputError.of([InputError(fault, ABOUT) for fault in faults])


def _slopes(flank: Flank, critical_slope: float) -> tuple[float, float]:
    """Return the mean slope of a survey, and its ratio to the critical slope."""
    mean = float(np.ptp(flank.height) / np.ptp(flank.s))
    return mean, mean / critical_slope


def _check_units(flank: Flank, critical_slope: float) -> None:
    """Raise InputError if the mean slope is not of the size of the critical slope."""
    mean, ratio = _slopes(flank, critical_slope)
    if not 1 / TOO_FAR < ratio < TOO_FAR:
        raise InputError(
            f"{flank.name} has the mean slope {mean:.3g}, {ratio:.3g} times critical_slope = {critical_slope:g}; "
            f"{_cause(ratio, critical_slope)}",
            UNITS_DIFFER,
        )


def _unlikely(flank: Flank, critical_slope: float) -> list[str]:
    """Return a sentence on a mean slope that is far from the critical slope."""
    mean, ratio = _slopes(flank, critical_slope)
    if 1 / FAR < ratio < FAR:
        return []
    return [
        f"the mean slope {mean:.3g} is {ratio:.3g} times the critical slope {critical_slope:g}; "
        f"{_cause(ratio, critical_slope)}"
    ]


def _cause(ratio: float, critical_slope: float) -> str:
    """Return the likely cause of a ratio of mean and critical slope far from 1."""
    if critical_slope > STEEPEST:
        return (
            f"critical_slope is height over length, not an angle: for {critical_slope:g} degrees it is "
            f"{np.tan(np.radians(critical_slope)):.3g}"
        )
    for factor, one, other in ((FEET, "feet", "metres"), (1000.0, "metres", "kilometres"), (100.0, "cm", "metres")):
        for high, x_unit, height_unit in ((ratio, other, one), (1 / ratio, one, other)):
            if 1 / FAR < high / factor < FAR:
                return (
                    f"probably x is in {x_unit} and height in {height_unit}; both must have the same unit, and "
                    "critical_slope is height over length"
                )
    return "check that x and height have the same unit, and that critical_slope is height over length, not an angle"
