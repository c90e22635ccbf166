"""Detection of kinks on a grid, as upward jumps of q.

A shock spreads over a few cells. Its width distinguishes it from a smooth rise: a rise of q by J with a steepest part d
per cell has a width of J/d cells, and a rise narrower than WIDEST_SHOCK cells is a shock. The position of the kink
follows from conservation: two straight lines, which continue q from either side and meet there, have the mass of the
cells between them.
"""

import math

import numpy as np

from hjprofile.solvers.grids.kernels.sweep_law import LANES, cell_law, is_table, read, summed
from hjprofile.solvers.kernels import compiled, inner, vectorised

SMALLEST_JUMP = 0.05  # a weaker jump cannot be distinguished from a steep smooth rise on grids of a thousand cells
WIDEST_SHOCK = 16  # cells over which a shock may spread; Lax-Friedrichs spreads a jump of 0.4 over this many
STEEP_RISE = SMALLEST_JUMP / WIDEST_SHOCK  # rise per cell
RISE_END = 0.08  # a rise ends where the rise per cell is below this fraction of its maximum
GAP, FIT = 1, 4  # cells omitted on either side of the rise, and cells to which a line is fitted


@compiled
def find_kinks(q, x_left, dx, law):
    """Return x, q on the left, q on the right and K of each kink, from left to right; shape (kinks, 4).

    The cell means q begin at x_left. Right of them lies the neutral slope, or x = 0.
    """
    rises = _rises(q)
    found = np.empty((rises.shape[0], 4))
    n = 0
    exponent, summed = 0.0, q.size  # ∫f right of the first `summed` cells
    for k in range(rises.shape[0] - 1, -1, -1):
        a, b = rises[k]
        place, left, right = _locate(q, dx, a, b)
        if not right - left >= SMALLEST_JUMP:
            continue
        cell = min(max(int(place), 0), q.size - 1)
        exponent += _exponent(q, cell + 1, summed, dx, law)
        summed = cell + 1
        K_right = math.exp(exponent)
        K_left = math.exp(exponent + _exponent(q, cell, cell + 1, dx, law))
        K = K_left + (place - cell) * (K_right - K_left)
        found[n, 0], found[n, 1], found[n, 2], found[n, 3] = x_left + place * dx, left, right, K
        n += 1
    return found[:n][::-1]


@vectorised
def _exponent(q, first, stop, dx, law):
    """Return ∫f dx over the cells first..stop-1."""
    row, f, df, total = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for at in range(first, stop, LANES):
        width = min(LANES, stop - at)
        for l in range(LANES):
            row[l] = q[at + l] if l < width else 0.0
        if is_table(law):
            for l in range(LANES):
                row[l] = 1.0 + row[l]
            read(row, law, f, df)
        for l in range(LANES):
            total[l] += cell_law(l, row[l] * dx, dx, law, f, df)[0]
    return summed(total)


@inner
def _rises(q):
    """Return the pairs (a, b) of the first and last cell of each rise that is too steep for the grid."""
    n = q.size
    found = np.empty((0, 2), np.int64)
    count = 0
    for start in range(0, n - 1, LANES):
        stop = min(start + LANES, n - 1)
        steepest = -np.inf
        for i in range(start, stop):
            steepest = max(steepest, q[i + 1] - q[i])
        if not steepest >= STEEP_RISE:
            continue
        for p in range(start, stop):
            d = q[p + 1] - q[p]
            ahead = q[p + 2] - q[p + 1] if p + 2 < n else -np.inf
            behind = q[p] - q[p - 1] if p > 0 else -np.inf
            if not (d >= STEEP_RISE and d >= ahead and d > behind):
                continue
            floor, a, b = RISE_END * d, p, p + 1
            while a > 0 and p - a < 2 * WIDEST_SHOCK and q[a] - q[a - 1] > floor:
                a -= 1
            while b < n - 1 and b - p < 2 * WIDEST_SHOCK and q[b + 1] - q[b] > floor:
                b += 1
            if q[b] - q[a] > WIDEST_SHOCK * d:
                continue
            if count and a < found[count - 1, 1]:  # two peaks of one rise are joined
                count -= 1
                a, b = found[count, 0], max(b, found[count, 1])
            if count == found.shape[0]:
                more = np.empty((2 * count + 8, 2), np.int64)
                for i in range(count):
                    more[i, 0], more[i, 1] = found[i, 0], found[i, 1]
                found = more
            found[count, 0], found[count, 1] = a, b
            count += 1
    return found[:count]


@inner
def _line(q, first, last, near):
    """Return value and slope per cell at `near` of the line fitted to the cells first..last.

    The line is flat for fewer than three cells. Positions are in cells: cell i has its midpoint at i + 0.5.
    """
    n = last - first + 1
    if n < 3:
        return q[last] if first + 0.5 < near else q[first], 0.0
    centre = 0.5 * (first + last) + 0.5
    mean = 0.0
    for i in range(first, last + 1):
        mean += q[i]
    mean /= n
    spread = tilt = 0.0
    for i in range(first, last + 1):
        away = i + 0.5 - centre
        spread += away * away
        tilt += away * q[i]
    slope = tilt / spread
    return mean + slope * (near - centre), slope


@inner
def _locate(q, dx, a, b):
    """Return the position (in cells from the left) of the kink in a rise from cell a to cell b, and q on either side.

    The position conserves mass. All three values are NaN if there is no kink.
    """
    n = q.size
    middle = 0.5 * (a + b + 1)
    left_end, right_end = a - GAP, b + GAP  # the cells nearest to the rise that the lines are fitted to
    left_start, right_stop = left_end - FIT + 1, right_end + FIT - 1
    # a fit across a neighbouring rise or the end of the grid would be wrong
    while left_start < left_end and (left_start < 0 or q[left_start + 1] - q[left_start] > STEEP_RISE):
        left_start += 1
    while right_stop > right_end and (right_stop >= n or q[right_stop] - q[right_stop - 1] > STEEP_RISE):
        right_stop -= 1
    left_end, right_end = max(left_end, 0), min(right_end, n - 1)
    ql, sl = _line(q, max(left_start, 0), left_end, middle)
    qr, sr = _line(q, right_end, min(right_stop, n - 1), middle)
    if left_end > a:
        ql, sl = q[a], 0.0
    if right_end < b:
        qr, sr = q[b], 0.0
    nowhere = np.nan, np.nan, np.nan
    if not qr > ql:
        return nowhere
    first, last = min(a, left_end), max(b, right_end)
    start, stop = float(first), last + 1.0
    mass = 0.0
    for i in range(first, last + 1):
        mass += q[i]
    s = middle
    for _ in range(8):  # ∫ left line up to s + ∫ right line from s on = mass; Newton
        mass_of_lines = (
            ql * (s - start) + 0.5 * sl * ((s - middle) ** 2 - (start - middle) ** 2)
            + qr * (stop - s) + 0.5 * sr * ((stop - middle) ** 2 - (s - middle) ** 2)
        )  # fmt: skip
        jump = (qr + sr * (s - middle)) - (ql + sl * (s - middle))
        if not jump > 0:
            return nowhere
        s = min(max(s + (mass_of_lines - mass) / jump, start), stop)
    left, right = ql + sl * (s - middle), qr + sr * (s - middle)
    if not (right > left and left > -1.0):
        return nowhere
    return s, left, right
