"""An erosion law inside the loops of the grid solvers: the rational law by its formula, any other as a table.

Which one is meant is told by type, so that each is compiled by itself and on demand, with nothing to decide in a loop.
A formula is evaluated where it is needed; a table is read for all lanes of a loop at once, ahead of it, since reading
does not vectorise and the rest of the loop should.
"""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import by_type, vectorised

PIECES = 11  # log2 of the pieces in each binade of 1 + q
SHIFT = 52 - PIECES  # bits of a double that tell where in its piece 1 + q lies
LANES = 64  # time levels that the sweeps of wavefront.py advance at once


class Rational(NamedTuple):
    """f = q/(1+q)."""


class Tabulated(NamedTuple):
    """Parabolas on the pieces into which the leading bits of 1 + q divide the positive numbers.

    With s the distance from a piece's left end, f = c0 + s (c1 + s c2) and f' = c1 + s d1, both continuous: a state
    that is known to rounding only must not be told apart by the piece that it falls into.

    Attributes:
        c0, c1, c2, d1: coefficients, each of shape (pieces,).
        first: leading bits of the first piece.
    """

    c0: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    d1: np.ndarray
    first: int


class Linear(Tabulated):
    """The same table, of a law of linear growth: f Δx is not small where the profile jumps (theory, §14)."""


@vectorised
def _bits(x):
    return np.float64(x).view(np.int64)


@vectorised
def _double(bits):
    return np.int64(bits).view(np.float64)


@vectorised
def positive(p):
    """p, or 0 where it is not a positive number: a pole turns what must not be into an infinite speed."""
    return p if p > 0.0 else 0.0


@vectorised
def _confine(p, law):
    """Brings an array of lanes into the range of the table."""
    least = _double(law.first << SHIFT)
    most = _double(((law.first + law.c0.size) << SHIFT) - 1)
    for l in range(LANES):
        inside = p[l] if p[l] > least else least
        p[l] = inside if inside < most else most


@vectorised
def _place(p, law):
    """The piece where p lies, and its distance from the piece's left end."""
    piece = _bits(p) >> SHIFT
    # unsigned: an index that is not looked at for being negative
    return np.uint64(piece - law.first), p - _double(piece << SHIFT)


@vectorised
def _read(p, law, f, df):
    _confine(p, law)
    for l in range(LANES):
        j, s = _place(p[l], law)
        c1 = law.c1[j]
        f[l] = law.c0[j] + s * (c1 + s * law.c2[j])
        df[l] = c1 + s * law.d1[j]


@vectorised
def _read_f(p, law, f):
    _confine(p, law)
    for l in range(LANES):
        j, s = _place(p[l], law)
        f[l] = law.c0[j] + s * (law.c1[j] + s * law.c2[j])


@by_type
def slope_at_zero(law):
    """f'(0)."""
    if law.instance_class is Rational:
        return lambda law: 1.0
    return lambda law: law.c1[(_bits(1.0) >> SHIFT) - law.first]


@by_type
def is_table(law):
    """Whether the law is read ahead of a loop."""
    return (lambda law: False) if law.instance_class is Rational else (lambda law: True)


@by_type
def read(p, law, f, df):
    """Fills f and f' at 1 + q = p, arrays of lanes, if the law is a table."""
    if law.instance_class is Rational:
        return lambda p, law, f, df: None
    return lambda p, law, f, df: _read(p, law, f, df)


@by_type
def read_f(p, law, f):
    """Fills f alone."""
    if law.instance_class is Rational:
        return lambda p, law, f: None
    return lambda p, law, f: _read_f(p, law, f)


@by_type
def eroded(l, d, dx, law, f, df):
    """f(q) dx and f'(q) in lane l for the mass d = q dx of a cell: by formula, or as read into f and df."""
    if law.instance_class is Rational:

        def rational(l, d, dx, law, f, df):
            r = dx / positive(dx + d)
            return d * r, r * r

        return rational

    def tabulated(l, d, dx, law, f, df):
        return f[l] * dx, df[l] if d > -dx else np.inf

    return tabulated


@by_type
def eroded_with_mean(l, d, s, dx, law, f, df, f_mean):
    """The same, and f dx at the mean of two neighbours with masses of sum s."""
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


@vectorised
def values(q, law, f, df):
    """Fills f(q) and f'(q) for a whole array."""
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
                f_row[l], df_row[l] = eroded(l, row[l], 1.0, law, f_row, df_row)
        for l in range(width):
            f[start + l], df[start + l] = f_row[l], df_row[l]
