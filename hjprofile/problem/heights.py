"""Tests on the heights of a survey: numbers that cannot be heights, and surveys of more than one flank."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

# Numbers that programs write for missing heights. Each may also be a height, so the neighbouring rows decide.
STAND_INS = -9999.0, 9999.0, -99999.0, 99999.0, -999.0, -32768.0, -32767.0, 32767.0
HIGHEST = 1e12  # in any unit of length; larger numbers, such as 1e20 and ±3.4e38, are not heights
OUT_OF_LINE = 10.0  # slope to the nearest other row, relative to the steepest slope of the other rows
FAR_OFF = 1000.0  # gap to the other heights, relative to their relief, for a height that is not in STAND_INS
FEW, ENOUGH_ROWS = 0.1, 10  # largest fraction of the rows with such heights; smallest number of rows
# Fewer heights may be multiples of a power of 10 by chance, or drawn by hand; more decimals are no rounding
ENOUGH_TO_ROUND, DECIMALS = 20, range(-3, 7)
MEDIAN = 0.6745  # median of |z| for a standard normal z
EPS = float(np.finfo(float).eps)
FLANK = 0.2  # smallest descent on either side of a crest, relative to the relief


def rounding_of(height: Array) -> float:
    """Return the unit to which heights are rounded, a power of 10; 0 if it is not known."""
    if height.size < ENOUGH_TO_ROUND:
        return 0.0
    for decimals in DECIMALS:
        scaled = height * 10.0**decimals
        if np.all(np.abs(scaled - np.round(scaled)) <= np.maximum(1e-6, 8.0 * EPS * np.abs(scaled))):
            return float(10.0**-decimals)
    return 0.0


def scatter_of(x: Array, height: Array) -> float:
    """Return the standard deviation of heights from a smooth line, by the median; robust to corners and outliers.

    The distance r of a height from the line through its neighbours contains the curvature, the difference of two
    neighbouring r does not. White noise of the deviation σ at even spacing gives them the variance 5 σ².
    """
    if height.size < ENOUGH_TO_ROUND:
        return 0.0
    h = np.diff(x)
    off = height[1:-1] - (height[:-2] * h[1:] + height[2:] * h[:-1]) / (h[1:] + h[:-1])
    return float(np.median(np.abs(np.diff(off)))) / (MEDIAN * np.sqrt(5.0))


def without_height(x: Array, height: Array) -> Array:
    """Return a mask of rows that hold a stand-in for a height, or a number off by orders of magnitude; x increases."""
    none = np.abs(height) > HIGHEST
    candidates = np.isin(height, STAND_INS)
    sound = ~(none | candidates)
    for value in np.unique(height[candidates]):
        here = height == value
        if _out_of_line(x[sound], height[sound], x[here], value):
            none |= here
    found = np.flatnonzero(~none)
    none[found[_far_off(height[found])]] = True
    return none


def _out_of_line(x: Array, height: Array, at: Array, value: float) -> bool:
    """Return True if a height `value` at the positions `at` is too steep a step from the nearest of the other rows."""
    if x.size < 2:
        return True
    steepest = np.max(np.abs(np.diff(height) / np.diff(x)))
    right = np.clip(np.searchsorted(x, at), 1, x.size - 1)
    nearest = np.where(at - x[right - 1] < x[right] - at, right - 1, right)
    return bool(np.any(np.abs(value - height[nearest]) > OUT_OF_LINE * steepest * np.abs(at - x[nearest])))


def _far_off(height: Array) -> Array:
    """Return the few heights that a gap of FAR_OFF times the relief of the others separates from them."""
    order = np.argsort(height)
    if order.size < ENOUGH_ROWS:
        return order[:0]
    gaps = np.diff(height[order])
    cut = int(np.argmax(gaps)) + 1
    few, others = sorted((order[:cut], order[cut:]), key=len)
    relief = np.ptp(height[others])
    return few if few.size <= FEW * order.size and gaps[cut - 1] > FAR_OFF * relief > 0.0 else order[:0]


def falls_on_the_whole(height: Array) -> bool:
    """Return True if heights fall from left to right, by the medians of their halves, which are robust to a few wrong
    heights.
    """
    half = (height.size + 1) // 2
    return half > 0 and bool(np.median(height[:half]) > np.median(height[-half:]))


def crest(height: Array) -> int | None:
    """Return the highest row if the survey rises to it and falls beyond it, by the medians; else None."""
    top = int(np.argmax(height))
    left, right = height[:top], height[top + 1 :]
    if not (falls_on_the_whole(right) and falls_on_the_whole(left[::-1])):
        return None
    descent = height[top] - max(height[0], height[-1])
    return top if descent > FLANK * np.ptp(height) else None
