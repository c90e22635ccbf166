"""Erosion law inside the loops of the grid solvers: the rational law by its formula, any other as a table.

The type of the law selects the code, so each variant is compiled separately and on demand, and a loop contains no
branch on the law. A formula is evaluated where it is needed. A table is read for all lanes of a loop at once, ahead of
it, because to copy its coefficients does not vectorise and the rest of the loop should.
"""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import by_type, inlined, inner, vectorised
from hjprofile.solvers.kernels.law import Rational

PIECES = 9  # log2 of the number of pieces in each binade of 1 + q
SHIFT = 52 - PIECES  # bits of a double that hold the position of 1 + q within its piece
LANES = 64  # time levels that the sweeps of wavefront.py advance at once


class Tabulated(NamedTuple):
    """Cubics on the pieces into which the leading bits of 1 + q divide the positive numbers.

    With s the distance from a piece's left end, f = c0 + s (c1 + s (c2 + s c3)). f and f' are continuous, so states
    that differ by rounding have nearly the same f and f', also if they lie in different pieces.

    Attributes:
        c: the coefficients, those of a piece one after another: c[4 j : 4 j + 4] of piece j.
        first: leading bits of the first piece.
        start, found: work arrays of LANES and 4 LANES, so a table belongs to one run.
    """

    c: np.ndarray
    first: int
    start: np.ndarray
    found: np.ndarray


class Linear(Tabulated):
    """The same table for a law of linear growth: f Δx is not small where the profile jumps (§11)."""


# unsigned integers, because numba checks signed indices for negative ones, and shifts of them do not vectorise
@vectorised
def _piece(x):
    return np.float64(x).view(np.uint64) >> np.uint64(SHIFT)


@vectorised
def _left_end(piece):
    return np.uint64(piece << np.uint64(SHIFT)).view(np.float64)


@vectorised
def _place(p, law):
    """Return where the coefficients of the piece of p start, and the distance of p from its left end."""
    piece = _piece(p)
    return (piece - np.uint64(law.first)) << np.uint64(2), p - _left_end(piece)


@vectorised
def positive(p):
    """Return p, or 0 if p is not a positive number: the speed is then infinite, which marks an inadmissible state."""
    return p if p > 0.0 else 0.0


@inlined
def _look_up(p, law):
    """Copy the coefficients of the piece of each lane of p to `found`, and replace p by the distance from its left end.

    Values outside the table are replaced by its ends. Only the second loop does not vectorise.
    """
    c, start, found, first = law.c, law.start, law.found, np.uint64(law.first)
    least, end = _left_end(first), (first + (np.uint64(c.size) >> np.uint64(2))) << np.uint64(SHIFT)
    most = np.uint64(end - np.uint64(1)).view(np.float64)
    for l in range(LANES):
        inside = p[l] if p[l] > least else least
        start[l], p[l] = _place(inside if inside < most else most, law)
    for l in range(LANES):
        at, to = start[l], np.uint64(4 * l)
        # all are read before the first is written, so they are copied at once
        c0, c1, c2, c3 = c[at], c[at + np.uint64(1)], c[at + np.uint64(2)], c[at + np.uint64(3)]
        found[to], found[to + np.uint64(1)], found[to + np.uint64(2)], found[to + np.uint64(3)] = c0, c1, c2, c3


@inlined
def _read(p, law, f, df):
    _look_up(p, law)
    c = law.found
    for l in range(LANES):
        s, c1, c2, c3 = p[l], c[4 * l + 1], c[4 * l + 2], c[4 * l + 3]
        f[l] = c[4 * l] + s * (c1 + s * (c2 + s * c3))
        df[l] = c1 + s * (2.0 * c2 + 3.0 * s * c3)


@inlined
def _read_f(p, law, f):
    _look_up(p, law)
    c = law.found
    for l in range(LANES):
        s = p[l]
        f[l] = c[4 * l] + s * (c[4 * l + 1] + s * (c[4 * l + 2] + s * c[4 * l + 3]))


@by_type
def slope_at_zero(law):
    """Return f'(0)."""
    if law.instance_class is Rational:
        return lambda law: 1.0
    return lambda law: law.c[_place(1.0, law)[0] + np.uint64(1)]


@by_type
def curvature_at_zero(law):
    """Return f''(0)."""
    if law.instance_class is Rational:
        return lambda law: -2.0
    return lambda law: 2.0 * law.c[_place(1.0, law)[0] + np.uint64(2)]


@by_type
def is_table(law):
    """Return True if the law is read ahead of a loop."""
    return (lambda law: False) if law.instance_class is Rational else (lambda law: True)


@by_type
def read(p, law, f, df):
    """Fill f and f' at 1 + q = p, arrays of lanes, if the law is a table; p is overwritten."""
    if law.instance_class is Rational:
        return lambda p, law, f, df: None
    return lambda p, law, f, df: _read(p, law, f, df)


@by_type
def read_f(p, law, f):
    """Fill f alone at 1 + q = p, if the law is a table; p is overwritten."""
    if law.instance_class is Rational:
        return lambda p, law, f: None
    return lambda p, law, f: _read_f(p, law, f)


@by_type
def cell_law(l, d, dx, law, f, df):
    """Return f(q) dx and f'(q) in lane l for the mass d = q dx of a cell: by formula, or as read into f and df."""
    if law.instance_class is Rational:

        def rational(l, d, dx, law, f, df):
            r = dx / positive(dx + d)
            return d * r, r * r

        return rational

    def tabulated(l, d, dx, law, f, df):
        return f[l] * dx, df[l] if d > -dx else np.inf

    return tabulated


@by_type
def cell_law_with_mean(l, d, s, dx, law, f, df, f_mean):
    """Return f(q) dx, f'(q), and f dx at the mean of two neighbours whose masses have the sum s."""
    if law.instance_class is Rational:

        def rational(l, d, s, dx, law, f, df, f_mean):
            p, p_mean = positive(dx + d), 2.0 * dx + s
            r = dx / (p * p_mean)  # one division for both
            r1 = r * p_mean
            return d * r1, r1 * r1, s * (r * p)

        return rational

    def tabulated(l, d, s, dx, law, f, df, f_mean):
        return f[l] * dx, df[l] if d > -dx else np.inf, f_mean[l] * dx

    return tabulated


@inner
def summed(lanes):
    """Return the sum over an array of lanes; numba's own sum, minimum and maximum take seconds to compile."""
    total = 0.0
    for value in lanes:
        total += value
    return total


@inner
def smallest(lanes):
    """Return the minimum of an array of lanes."""
    least = lanes[0]
    for value in lanes:
        least = min(least, value)
    return least


@inner
def largest(lanes):
    """Return the maximum of an array of lanes."""
    most = lanes[0]
    for value in lanes:
        most = max(most, value)
    return most


@vectorised
def values(q, law, f, df):
    """Fill f(q) and f'(q) for a whole array."""
    row, f_row, df_row = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for start in range(0, q.size, LANES):
        width = min(LANES, q.size - start)
        for l in range(LANES):
            row[l] = q[start + l] if l < width else 0.0
        if is_table(law):
            for l in range(LANES):
                row[l] = 1.0 + row[l]
            read(row, law, f_row, df_row)
        else:
            for l in range(LANES):
                f_row[l], df_row[l] = cell_law(l, row[l], 1.0, law, f_row, df_row)
        for l in range(width):
            f[start + l], df[start + l] = f_row[l], df_row[l]
