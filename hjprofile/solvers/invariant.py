"""Tables of an erosion law in the variables of the invariant, built once per law and run (§13)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial as P

from hjprofile.problem.erosion import Array, ErosionLaw, Function
from hjprofile.solvers.kernels.law import LawTable, Rational

RHO_PIECE = 0.05  # width of the pieces: degree 7 leaves (PIECE/4)^8 = 6e-16
END_STEP = 0.25  # unit of ln(1 + q) to which the ends of a table are rounded, so that runs of one slope share it
SMALLEST_SIGMA = 1e-14  # smallest 1 + s/offset that is not rounding: s does not determine a smaller r
_Z = np.cos(np.pi * (np.arange(8) + 0.5) / 8)  # sample points of a piece
_FIT = np.linalg.inv(np.vander(_Z, 8, increasing=True)).T


def law_table(law: ErosionLaw, q_least: float, q_most: float) -> Rational | LawTable:
    """Return the law for the loops: f(rho), s(rho) and rho(s), rho = ln R(q), for slopes between the two, to rounding.

    From q = f r follows R' = 1/(f + df/drho). Along a piece of constant I, where R' q_x = -q, s = q exp ∫ (1/R'(0) -
    1/R')/f drho decays as exp(-x/R'(0)).
    """
    if law.name == "rational":
        return Rational()
    low, high = np.log1p([q_least, q_most]) / END_STEP
    return _tabulated(law.f, law.R, END_STEP * float(np.floor(low)), END_STEP * float(np.ceil(high)))


@lru_cache(maxsize=8)  # by the identity of f
def _tabulated(law_f: Function, law_R: Function, v_least: float, v_most: float) -> LawTable:
    """Return the tables for ln(1 + q) between v_least and v_most."""
    from scipy.optimize import elementwise

    rho0 = float(np.log(law_R(0.0)))
    v = np.array([v_least, v_most])
    ends = np.atleast_1d(np.log(law_R(np.expm1(v))))
    # rho0 in the middle of a piece, so that the zeros of f and s there are exact
    below = max(0, int(np.ceil((rho0 - ends[0]) / RHO_PIECE - 0.5)))
    above = max(0, int(np.ceil((ends[1] - rho0) / RHO_PIECE - 0.5)))
    start, pieces = rho0 - (below + 0.5) * RHO_PIECE, below + above + 1
    rho = start + RHO_PIECE * (np.arange(pieces)[:, None] + 0.5 * (_Z + 1.0))
    bracket = np.full_like(rho, v[0] - 0.5), np.full_like(rho, v[1] + 2.0)
    with np.errstate(invalid="ignore"):  # where an interpolation has no root, the search bisects
        root = elementwise.find_root(lambda v, rho: np.log(law_R(np.expm1(v))) - rho, bracket, args=(rho,))
    f = law_f(np.expm1(root.x))
    f_table = f @ _FIT
    f_table[below, 0] = 0.0

    # g = (rate - df/drho - f)/f, in the middle piece divided by its own zero
    excess = -f_table.T
    excess[:-1] -= P.polyder(f_table.T) * (2.0 / RHO_PIECE)
    rate = -float(excess[0, below])
    excess[0] += rate
    g = P.polyval(_Z, excess) / f
    g[below] = P.polyval(_Z, excess[1:, below]) / P.polyval(_Z, f_table[below, 1:])
    primitive = P.polyint((g @ _FIT).T, lbnd=-1.0, axis=0) * (0.5 * RHO_PIECE)  # from the start of each piece
    before = np.concatenate([[0.0], np.cumsum(P.polyval(1.0, primitive))[:-1]])
    exponent = before[:, None] + P.polyval(_Z, primitive)
    exponent -= before[below] + primitive[0, below]
    s_table = (f * np.exp(rho + exponent)) @ _FIT
    s_table[below, 0] = 0.0

    at_joints = np.append(P.polyval(-1.0, s_table.T), P.polyval(1.0, s_table[-1]))
    # ds/dr is nearly constant near r = 0
    offset = float(P.polyval(-1.0, P.polyder(s_table[0])) * (2.0 / RHO_PIECE) - at_joints[0])
    low, high = np.log(max(1.0 + at_joints[0] / offset, SMALLEST_SIGMA)), np.log1p(at_joints[-1] / offset)
    count = int(np.ceil((high - low) / RHO_PIECE))
    sigma = low + RHO_PIECE * (np.arange(count)[:, None] + 0.5 * (_Z + 1.0))
    wanted = offset * np.expm1(sigma)
    at = np.interp(wanted, at_joints, start + RHO_PIECE * np.arange(pieces + 1))
    slope = P.polyder(s_table, axis=1) * (2.0 / RHO_PIECE)
    for _ in range(6):  # Newton
        at -= (_piecewise(s_table, start, at) - wanted) / _piecewise(slope, start, at)
    return LawTable(f_table, s_table, np.ascontiguousarray(at @ _FIT), start, float(low), 1.0 / RHO_PIECE, offset, rate)


def _piecewise(table: Array, start: float, x: Array) -> Array:
    """Evaluate `polynomial` for arrays, for tables of any degree."""
    s = (x - start) / RHO_PIECE
    piece = np.clip(s.astype(int), 0, table.shape[0] - 1)
    return P.polyval(2.0 * (s - piece) - 1.0, np.moveaxis(table[piece], -1, 0), tensor=False)
