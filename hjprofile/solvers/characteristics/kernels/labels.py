"""Labels of characteristics on panels of Chebyshev points, and the pairs of labels that meet in a shock (§14).

The position of a label is base[p] + X, with X = 0 at the start where its panel p begins. Far from x = 0 its rounding
error is then relative to the distance travelled, not to x. Segments of panels lie between shocks. A shock holds the
distances `off` of its two labels from the joint between its segments: to the left in the segment before, to the right
in the segment after. They solve X⁻ = X⁺, W⁻ = W⁺. Labels beyond them are dead: they follow the formula of their own
segment.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import by_type, compiled
from hjprofile.solvers.kernels.law import LawTable, Rational, law_derivatives

# Residuals of X and W, absolute for a distance X of at most 1 and relative for a longer one
RESIDUAL_FOUND = 4e-15  # at which the labels of a shock are found; below it Newton's step is rounding
RESIDUAL_ACCEPTED = 1e-13  # at which they are accepted if the residual decreases no further
RESIDUAL_LOST = 1e-11  # above which the label at x = 0 is lost
MAX_LOCAL = 1.5  # largest local variable to which the polynomial of a panel may be continued


class Rule(NamedTuple):
    """Interpolation on the points of a panel.

    Attributes:
        s, bary: points in [-1, 1] and their barycentric weights.
        D: derivative at the points.
        B: g @ B[:, i] is ∫ g ds from s[i] to 1.
    """

    s: np.ndarray
    bary: np.ndarray
    D: np.ndarray
    B: np.ndarray


class Mesh(NamedTuple):
    """The fixed data of the labels: panels from left to right, in segments.

    Attributes:
        I, dI: the invariant and its derivative by the local variable, shape (panels, points).
        half: half the width of a panel in the label.
        base: the position from which X is measured.
        joined: True if fields are analytic across the left end of a panel.
        first: the first panel of each segment, and one past the last; the first segment may be empty (q = 0).
    """

    I: np.ndarray
    dI: np.ndarray
    half: np.ndarray
    base: np.ndarray
    joined: np.ndarray
    first: np.ndarray


class Medium(NamedTuple):
    """Constants of a step: the mesh, the rule of its panels and the erosion law."""

    mesh: Mesh
    rule: Rule
    law: Rational | LawTable


class Shocks(NamedTuple):
    """The labels of shocks, which follow from a state, as they were found last.

    Attributes:
        off: distances of each shock's labels from its joint, shape (shocks, 2).
        birth, power, tau: of a young shock, whose `off` scale with (t - birth)^power from the age tau; later power = 0.
        crest: distance of the label at x = 0 from the last joint, shape (1,).
    """

    off: np.ndarray
    birth: np.ndarray
    power: np.ndarray
    tau: np.ndarray
    crest: np.ndarray


class Stages(NamedTuple):
    """Results of the stages of a step.

    Attributes:
        S, c: ln K = ln r + S + c in the last one, S at the points of panels, c for each segment.
        rates: dy/dt in all of them, shape (16, size of y).
    """

    S: np.ndarray
    c: np.ndarray
    rates: np.ndarray


@compiled
def weights(rule, s, w):
    """Fill w so that w @ values is the interpolant at s."""
    total = 0.0
    for j in range(w.size):
        d = s - rule.s[j]
        if d == 0.0:
            for i in range(w.size):
                w[i] = 0.0
            w[j] = 1.0
            return
        w[j] = rule.bary[j] / d
        total += w[j]
    for j in range(w.size):
        w[j] /= total


@compiled
def dot(w, values, p):
    """Return w @ values[p] for short rows."""
    total = 0.0
    for j in range(w.size):
        total += w[j] * values[p, j]
    return total


@compiled
def at_label(p, s, r, X, mesh, rule, w):
    """Return r, X, W and dX/ds at the local position s in panel p; fill the weights w."""
    weights(rule, s, w)
    slope = 0.0
    for i in range(w.size):
        slope += w[i] * dot(X[p], rule.D, i)
    rate = dot(w, r, p)
    return rate, dot(w, X, p), dot(w, mesh.I, p) - rate, slope


@compiled
def before_end(off, k, mesh):
    """Return panel and local position of the label `off` left of the end of segment k."""
    p = mesh.first[k + 1] - 1
    while off > 2.0 * mesh.half[p] and p > mesh.first[k] and mesh.joined[p]:
        off -= 2.0 * mesh.half[p]
        p -= 1
    return p, 1.0 - off / mesh.half[p]


@compiled
def after_start(off, k, mesh):
    """Return panel and local position of the label `off` right of the start of segment k."""
    p = mesh.first[k]
    while off > 2.0 * mesh.half[p] and p + 1 < mesh.first[k + 1] and mesh.joined[p + 1]:
        off -= 2.0 * mesh.half[p]
        p += 1
    return p, off / mesh.half[p] - 1.0


@by_type
def law_terms(r, law):
    """Return f, df/drho and q at r."""
    if law.instance_class is Rational:
        return lambda r, law: (1.0 - 1.0 / r, 1.0 / r, r - 1.0)

    def tabulated(r, law):
        f, f1, _ = law_derivatives(math.log(r), law)
        return f, f1, f * r

    return tabulated


@compiled
def newton_labels(k, off, r, X, mesh, rule, law, w):
    """Find the labels of shock k by Newton's method from `off`, in closed form by W_ξ = q X_ξ; return True if found."""
    empty = mesh.first[k] == mesh.first[k + 1]
    b0, b1 = off[k, 0], off[k, 1]
    best, rounding = 1e300, 1.0
    for _ in range(25):
        p, s = after_start(b1, k + 1, mesh)
        if not abs(s) <= MAX_LOCAL:
            break
        r1, X1, W1, slope1 = at_label(p, s, r, X, mesh, rule, w)
        half1, base1, rounding = mesh.half[p], mesh.base[p], max(1.0, abs(X1))
        q1 = law_terms(r1, law)[2] if r1 > 0.0 else math.nan
        if empty:
            off_X, off_W, slope0, q0, half0 = 0.0, -W1, 1.0, 0.0, 1.0
        else:
            p, s = before_end(b0, k, mesh)
            if not abs(s) <= MAX_LOCAL:
                break
            r0, X0, W0, slope0 = at_label(p, s, r, X, mesh, rule, w)
            half0 = mesh.half[p]
            q0 = law_terms(r0, law)[2] if r0 > 0.0 else math.nan
            off_X, off_W = mesh.base[p] - base1 + X0 - X1, W0 - W1
            rounding = max(rounding, abs(X0))
        size = max(abs(off_X), abs(off_W))
        if not size < 1e300:
            break
        if size < best:
            best = size
            off[k, 0], off[k, 1] = b0, b1
            if size <= RESIDUAL_FOUND * rounding:
                return True
        elif best <= RESIDUAL_ACCEPTED * rounding:
            return True
        if not q1 > q0 or slope0 <= 0.0 or slope1 <= 0.0:
            break
        move0 = (q1 * off_X - off_W) / (q0 - q1) * half0 / slope0
        move1 = (q0 * off_X - off_W) / (q0 - q1) * half1 / slope1
        if not empty:
            b0 -= min(max(move0, -0.5 * half0), 0.5 * half0)
        b1 += min(max(move1, -0.5 * half1), 0.5 * half1)
        b0, b1 = max(b0, 0.0), max(b1, 0.0)
    return best <= RESIDUAL_ACCEPTED * rounding


@compiled
def at_joint(side, k, off, r, X, mesh, rule, w):
    """Return local position, X, W and X_ξ of the label `off` left (side = -1.0) or right (1.0) of the joint of shock k.

    X is measured from the base of the panel right of the joint.
    """
    p, s = before_end(off, k, mesh) if side < 0.0 else after_start(off, k + 1, mesh)
    rate, at, W, slope = at_label(p, s, r, X, mesh, rule, w)
    return s, mesh.base[p] - mesh.base[mesh.first[k + 1]] + at, W, slope / mesh.half[p]


@compiled
def fold(side, k, r, X, mesh, rule, w):
    """Return the smallest `off` beyond which X increases with the label; NaN if not on the panels at the joint."""
    step = 0.1 * mesh.half[mesh.first[k + 1] - 1 if side < 0.0 else mesh.first[k + 1]]
    low = high = 0.0
    while True:
        s, _, _, slope = at_joint(side, k, high, r, X, mesh, rule, w)
        if not abs(s) <= MAX_LOCAL:
            return math.nan
        if slope > 0.0:
            break
        low = high
        high += step
        step *= 1.2
    while high > 0.0 and high - low > 1e-15 + 1e-13 * high:
        middle = 0.5 * (low + high)
        if at_joint(side, k, middle, r, X, mesh, rule, w)[3] > 0.0:
            high = middle
        else:
            low = middle
    return high


@compiled
def label_of(side, k, target, of_W, start, r, X, mesh, rule, w):
    """Return the `off` beyond `start` at which X (W if of_W = 1.0, not 0.0) is `target`; NaN if not on the panels."""
    step = mesh.half[mesh.first[k + 1] - 1 if side < 0.0 else mesh.first[k + 1]]
    low, high = start, start + 0.1 * step
    while True:
        s, at, W, _ = at_joint(side, k, high, r, X, mesh, rule, w)
        if not abs(s) <= MAX_LOCAL:
            return math.nan
        if (at + of_W * (W - at) - target) * side >= 0.0:
            break
        low = high
        high += 0.25 * step
        step *= 1.2
    for _ in range(60):
        middle = 0.5 * (low + high)
        _, at, W, _ = at_joint(side, k, middle, r, X, mesh, rule, w)
        if (at + of_W * (W - at) - target) * side >= 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@compiled
def bracket_labels(k, off, r, X, mesh, rule, w):
    """Bracket the labels of shock k between the folds of X, where W⁻ - W⁺ decreases with x, for Newton's method."""
    right = fold(1.0, k, r, X, mesh, rule, w)
    if mesh.first[k] == mesh.first[k + 1]:
        off[k, 1] = label_of(1.0, k, 0.0, 1.0, right, r, X, mesh, rule, w)
        return off[k, 1] == off[k, 1]
    left = fold(-1.0, k, r, X, mesh, rule, w)
    if not (left >= 0.0 and right >= 0.0):
        return False
    low, high = at_joint(1.0, k, right, r, X, mesh, rule, w)[1], at_joint(-1.0, k, left, r, X, mesh, rule, w)[1]
    if not low < high:
        return False
    b0 = b1 = 0.0
    for _ in range(60):
        x = 0.5 * (low + high)
        b0 = label_of(-1.0, k, x, 0.0, left, r, X, mesh, rule, w)
        b1 = label_of(1.0, k, x, 0.0, right, r, X, mesh, rule, w)
        if b0 != b0:
            low = x
        elif b1 != b1 or at_joint(-1.0, k, b0, r, X, mesh, rule, w)[2] < at_joint(1.0, k, b1, r, X, mesh, rule, w)[2]:
            high = x
        else:
            low = x
        if high - low < 1e-15 * max(1.0, abs(x)):
            break
    if not (b0 == b0 and b1 == b1):
        return False
    off[k, 0], off[k, 1] = b0, b1
    return True


@compiled
def shock_labels(k, off, r, X, mesh, rule, law, w):
    """Fill the labels of shock k by Newton's method, or between the folds; return True if they are found.

    X increases with the label at both, unless the shock is newborn and both labels are at the joint.
    """
    if newton_labels(k, off, r, X, mesh, rule, law, w):
        if max(off[k, 0], off[k, 1]) == 0.0:
            return True
        empty = mesh.first[k] == mesh.first[k + 1]
        rising = empty or at_joint(-1.0, k, off[k, 0], r, X, mesh, rule, w)[3] > 0.0
        if rising and at_joint(1.0, k, off[k, 1], r, X, mesh, rule, w)[3] > 0.0:
            return True
    return bracket_labels(k, off, r, X, mesh, rule, w) and newton_labels(k, off, r, X, mesh, rule, law, w)
