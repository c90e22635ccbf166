"""One flank of a survey: its stretch of x, its direction, its spacing, and heights that rise everywhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hjprofile.errors import InputError
from hjprofile.problem.heights import crest, falls_on_the_whole
from hjprofile.problem.ranges import Array
from hjprofile.problem.survey_file import MOST_ROWS, Measured

# Move of a height by a repair, relative to the relief, that is reported. Noise of 2 m moves points of the hillslope by
# 0.7 % of its 652 m at most, noise of 5 m by 2 %. A point that moves by a tenth was mistyped or not measured.
FAR_MOVE = 0.1
ABOUT = "a-survey-that-does-not-rise"
STRETCH = "the-stretch-of-a-survey"


class Flank(NamedTuple):
    """The points of one flank, the crest last.

    Attributes:
        name: the description of the survey in messages.
        s: position, increasing uphill, shape (n,): x of the survey, or -x if the slope rises to the left.
        height: shape (n,), in the unit of the survey.
        rows: the row of each point in its file, or its index in an array; empty for points between those.
        direction: 1 if the slope rises to the right, -1 if to the left.
        account: a phrase for each change.
    """

    name: str
    s: Array
    height: Array
    rows: list[int]
    direction: float
    account: list[str]

    @property
    def x(self) -> Array:
        """Positions in the coordinate of the survey."""
        return self.direction * self.s + 0.0  # no -0

    def place(self, i: int) -> str:
        """Return the row of a point, or its position if it is in no row."""
        return f"row {self.rows[i]} (x = {self.x[i]:g})" if self.rows else f"x = {self.x[i]:g}"


def one_flank(name: str, points: Measured, uphill: str | None, start: float | None, end: float | None) -> Flank:
    """Return the flank of a survey between two positions.

    Args:
        uphill: "left" or "right", the side of the crest; None to find it from the heights.
        start, end: the stretch of x that is used; None for the whole survey.

    Raises InputError if less than two points remain, or if the heights are level, pass a crest, or pass a valley.
    """
    account = [points.account] if points.account else []
    x, height, rows = points.x, points.height, points.rows
    kept = (x >= (-np.inf if start is None else start)) & (x <= (np.inf if end is None else end))
    if not kept.all():
        if np.count_nonzero(kept) < 2:
            raise InputError(
                f"{name} has {np.count_nonzero(kept)} points in the stretch from {x[0] if start is None else start:g} "
                f"to {x[-1] if end is None else end:g}; a survey needs at least 2, and this one extends from "
                f"{x[0]:g} to {x[-1]:g}",
                STRETCH,
            )
        x, height, rows = x[kept], height[kept], np.array(rows)[kept].tolist()
        account.append(f"{x.size} of {kept.size} points used, from x = {x[0]:g} to {x[-1]:g}")
    if not np.ptp(height) > 0.0:
        raise InputError(f"{name} is level; a slope must rise from its toe to its crest", ABOUT)
    for what, turn in (("crest", crest(height)), ("valley", crest(-height))):
        if turn is not None:
            raise InputError(
                f"{name} has two flanks, with the {what} at row {rows[turn]} (x = {x[turn]:g}); use from/to: "
                f"to = {x[turn]:g} keeps the left flank, and from = {x[turn]:g} the right one",
                STRETCH,
            )
    left = falls_on_the_whole(height) and np.argmax(height) < height.size // 2
    if uphill == "left" or (uphill is None and left):
        account += ["it rises to the left"] if uphill is None else []
        return Flank(name, -x[::-1], height[::-1], rows[::-1], -1.0, account)
    return Flank(name, x, height, rows, 1.0, account)


def resampled(flank: Flank, spacing: float) -> Flank:
    """Return a flank with corners at about this spacing, the nearest one in the mean square over x.

    Raises InputError if the spacing exceeds half of the extent.
    """
    extent = float(np.ptp(flank.s))
    if not spacing <= 0.5 * extent:
        raise InputError(
            f"resample = {spacing:g} must be at most half of the extent of the survey, {extent:g}", STRETCH
        )
    corners = np.linspace(flank.s[0], flank.s[-1], round(extent / spacing) + 1)
    height = nearest_line(flank.s, flank.height, corners)
    moved = np.interp(flank.s, corners, height) - flank.height
    note = f"resampled to {corners.size} points, which moves heights by {np.sqrt(np.mean(moved**2)):.3g} (r.m.s.)"
    return flank._replace(s=corners, height=height, rows=[], account=[*flank.account, note])


def nearest_line(s: Array, height: Array, corners: Array) -> Array:
    """Return the heights at the corners of the polyline that is nearest to the polyline through points.

    The distance is ∫ (difference)² ds, which weights points by their spacing.
    """
    from scipy.linalg import solveh_banded

    # on pieces between neighbouring corners and points the integrands are quadratic: two Gauss points are exact
    ends = np.union1d(s, corners)
    gauss = 0.5 + np.array([[-0.5], [0.5]]) / np.sqrt(3.0)
    at = (ends[:-1] + gauss * np.diff(ends)).ravel()
    weight = np.tile(0.5 * np.diff(ends), 2)
    j = np.clip(np.searchsorted(corners, at, side="right") - 1, 0, corners.size - 2)
    right = (at - corners[j]) / np.diff(corners)[j]  # value of the hat function of the corner on the right
    h, n, left = np.interp(at, s, height), corners.size, 1.0 - right

    def summed(values: Array, i: Array) -> Array:
        return np.bincount(i, weight * values, minlength=n)

    diagonal = summed(left**2, j) + summed(right**2, j + 1)
    beyond = np.append(0.0, summed(left * right, j)[:-1])
    return solveh_banded(np.stack([beyond, diagonal]), summed(left * h, j) + summed(right * h, j + 1))


def rising(flank: Flank, least: float, repair: bool, limit: float | None) -> Flank:
    """Return a flank whose heights rise everywhere, with at least the slope `least` where they are repaired.

    Args:
        limit: the largest move of a height by a repair; None for any.

    Raises InputError if the heights do not rise and are not repaired, or move by more than the limit.
    """
    x, height = flank.s, flank.height
    at_least = least if repair else 0.0
    falls = np.flatnonzero(np.diff(height) <= at_least * np.diff(x))
    if not falls.size:
        return flank
    if not repair:
        raise InputError(f"{flank.name} {_course(flank, falls)}", ABOUT)
    repaired = nearest_rising(x, height, at_least)
    moved = np.abs(repaired - height)
    if limit is not None and (over := np.flatnonzero(moved > limit)).size:
        named = ", ".join(flank.place(i) for i in over[:MOST_ROWS]) + (", ..." if over.size > MOST_ROWS else "")
        raise InputError(
            f"{flank.name}: repair = 'isotonic' moves {over.size} heights by more than repair_limit = {limit:g}, by up "
            f"to {moved.max():.5g}: {named}; correct or delete these points, or use a larger limit",
            ABOUT,
        )
    rounding = 1e-9 * (np.ptp(height) + least * np.ptp(x))
    account = [
        f"survey repaired: {np.count_nonzero(moved > rounding)} of {x.size} points moved, "
        f"by {moved.max():.3g} at most and {np.sqrt(np.mean(moved**2)):.3g} on average (r.m.s.)"
    ]
    far = moved > FAR_MOVE * np.ptp(repaired)
    if far.any():
        i = _farthest_off(height, moved, far)
        account.append(
            f"the repair moves the height {height[i]:g} at {flank.place(i)} by {moved[i]:.3g}, more than a tenth of "
            "the relief; is it right?"
        )
    return flank._replace(height=repaired, account=[*flank.account, *account])


def _course(flank: Flank, falls: Array) -> str:
    """Return the places where heights do not rise, uphill, and the remedy."""
    drops = -np.diff(flank.height)[falls]
    stretches = np.split(falls, np.flatnonzero(np.diff(falls) > 1) + 1)
    marks, joint = (flank.rows, "-") if flank.rows else (flank.x.tolist(), " to ")
    ends = [sorted((marks[each[0]], marks[each[-1] + 1])) for each in stretches[:MOST_ROWS]]
    named = [f"{a:.10g}{joint}{b:.10g}" for a, b in ends]
    more = f", ... ({len(stretches)} stretches)" if len(stretches) > MOST_ROWS else ""
    where = f"{'rows' if flank.rows else 'x ='} {', '.join(named)}{more}"
    if np.max(drops) <= 0.0:
        return (
            f"is level in {where} (a plateau or a ledge), and the model needs a slope that rises; set "
            "repair = 'isotonic', which gives a level stretch 5 % of the critical slope, or use from/to"
        )
    side = "right" if flank.direction > 0.0 else "left"
    return (
        f"does not rise in {where}; a slope must rise to the {side}, where its crest is, and this one falls by up to "
        f"{np.max(drops):.6g} (correct it, or set repair = 'isotonic')"
    )


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
