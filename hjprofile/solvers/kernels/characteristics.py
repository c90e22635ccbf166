"""Loops of shock-fitted characteristics: r = R(q) and X over labels, on panels of Chebyshev points (theory, §5).

Segments of panels lie between shocks. A shock holds the distances `off` of its two labels from the joint between its
segments: to the left in the segment before, to the right in the segment after. They solve X⁻ = X⁺, W⁻ = W⁺. Labels
beyond them are dead, and follow the formula of their own segment.
"""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.law import law_derivatives

CLOSE = 4e-15  # residual of X and W at which a shock's labels are found; below it Newton's step is noise
NOISE = 1e-11  # residual beyond which they are not
BEYOND = 1.5  # how far the polynomial of a panel may be continued, in its local variable


class Rule(NamedTuple):
    """Interpolation on the points of a panel.

    Attributes:
        s, bary: points in [-1, 1] and their barycentric weights.
        D: derivative at the points.
        B: B[i] @ g is ∫ g ds from s[i] to 1.
    """

    s: np.ndarray
    bary: np.ndarray
    D: np.ndarray
    B: np.ndarray


class Mesh(NamedTuple):
    """What is frozen in the labels. Panels from left to right, in segments.

    Attributes:
        I, dI: the invariant and its derivative by the local variable, shape (panels, points).
        half: half the width of a panel in the label.
        joined: whether fields are analytic across the left end of a panel.
        first: the first panel of each segment, and one past the last; the first segment may be empty (q = 0).
    """

    I: np.ndarray
    dI: np.ndarray
    half: np.ndarray
    joined: np.ndarray
    first: np.ndarray


@compiled
def weights(rule, s, w):
    """Fills w so that w @ values is the interpolant at s."""
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
    """w @ values[p] for short rows."""
    total = 0.0
    for j in range(w.size):
        total += w[j] * values[p, j]
    return total


@compiled
def at_label(p, s, r, X, mesh, rule, w):
    """r, X, W and dX/ds at a place in panel p; leaves the weights in w."""
    weights(rule, s, w)
    slope = 0.0
    for i in range(w.size):
        row = 0.0
        for j in range(w.size):
            row += rule.D[i, j] * X[p, j]
        slope += w[i] * row
    rate = dot(w, r, p)
    return rate, dot(w, X, p), dot(w, mesh.I, p) - rate, slope


@compiled
def before_end(off, k, mesh):
    """Panel and local place of the label `off` left of the end of segment k."""
    p = mesh.first[k + 1] - 1
    while off > 2.0 * mesh.half[p] and p > mesh.first[k] and mesh.joined[p]:
        off -= 2.0 * mesh.half[p]
        p -= 1
    return p, 1.0 - off / mesh.half[p]


@compiled
def after_start(off, k, mesh):
    """Panel and local place of the label `off` right of the start of segment k."""
    p = mesh.first[k]
    while off > 2.0 * mesh.half[p] and p + 1 < mesh.first[k + 1] and mesh.joined[p + 1]:
        off -= 2.0 * mesh.half[p]
        p += 1
    return p, off / mesh.half[p] - 1.0


@compiled
def law_terms(r, law):
    """f, df/drho and q at r."""
    if law.f.shape[0] == 0:
        return 1.0 - 1.0 / r, 1.0 / r, r - 1.0
    f, f1, _ = law_derivatives(math.log(r), law)
    return f, f1, f * r


@compiled
def newton_labels(k, off, r, X, mesh, rule, law, w):
    """Labels of shock k by Newton's method from `off`: with W_ξ = q X_ξ it is closed form. Returns whether found."""
    empty = mesh.first[k] == mesh.first[k + 1]
    b0, b1 = off[k, 0], off[k, 1]
    best = 1e300
    for _ in range(25):
        p, s = after_start(b1, k + 1, mesh)
        if not abs(s) <= BEYOND:
            break
        r1, X1, W1, slope1 = at_label(p, s, r, X, mesh, rule, w)
        half1 = mesh.half[p]
        q1 = law_terms(r1, law)[2] if r1 > 0.0 else math.nan
        if empty:
            off_X, off_W, slope0, q0, half0 = 0.0, -W1, 1.0, 0.0, 1.0
        else:
            p, s = before_end(b0, k, mesh)
            if not abs(s) <= BEYOND:
                break
            r0, X0, W0, slope0 = at_label(p, s, r, X, mesh, rule, w)
            half0 = mesh.half[p]
            q0 = law_terms(r0, law)[2] if r0 > 0.0 else math.nan
            off_X, off_W = X0 - X1, W0 - W1
        size = max(abs(off_X), abs(off_W))
        if not size < 1e300:
            break
        if size < best:
            best = size
            off[k, 0], off[k, 1] = b0, b1
            if size <= CLOSE:
                return True
        elif best <= NOISE * 0.01:
            return True
        if not q1 > q0 or slope0 <= 0.0 or slope1 <= 0.0:
            break
        move0 = (q1 * off_X - off_W) / (q0 - q1) * half0 / slope0
        move1 = (q0 * off_X - off_W) / (q0 - q1) * half1 / slope1
        if not empty:
            b0 -= min(max(move0, -0.5 * half0), 0.5 * half0)
        b1 += min(max(move1, -0.5 * half1), 0.5 * half1)
        b0, b1 = max(b0, 0.0), max(b1, 0.0)
    return best <= NOISE * 0.01


@compiled
def beside(side, k, off, r, X, mesh, rule, w):
    """Local place, X, W and X_ξ of the label `off` left (side = -1.0) or right (1.0) of the joint of shock k."""
    p, s = before_end(off, k, mesh) if side < 0.0 else after_start(off, k + 1, mesh)
    rate, at, W, slope = at_label(p, s, r, X, mesh, rule, w)
    return s, at, W, slope / mesh.half[p]


@compiled
def fold(side, k, r, X, mesh, rule, w):
    """Least `off` beyond which X rises with the label; NaN if it is not on the panels at the joint."""
    step = 0.1 * mesh.half[mesh.first[k + 1] - 1 if side < 0.0 else mesh.first[k + 1]]
    low = high = 0.0
    while True:
        s, _, _, slope = beside(side, k, high, r, X, mesh, rule, w)
        if not abs(s) <= BEYOND:
            return math.nan
        if slope > 0.0:
            break
        low = high
        high += step
        step *= 1.2
    while high > 0.0 and high - low > 1e-15 + 1e-13 * high:
        middle = 0.5 * (low + high)
        if beside(side, k, middle, r, X, mesh, rule, w)[3] > 0.0:
            high = middle
        else:
            low = middle
    return high


@compiled
def label_of(side, k, target, of_W, start, r, X, mesh, rule, w):
    """The `off` beyond `start` at which X (or W, if of_W = 1.0 and not 0.0) is `target`; NaN if not on the panels."""
    step = mesh.half[mesh.first[k + 1] - 1 if side < 0.0 else mesh.first[k + 1]]
    low, high = start, start + 0.1 * step
    while True:
        s, at, W, _ = beside(side, k, high, r, X, mesh, rule, w)
        if not abs(s) <= BEYOND:
            return math.nan
        if (at + of_W * (W - at) - target) * side >= 0.0:
            break
        low = high
        high += 0.25 * step
        step *= 1.2
    for _ in range(60):
        middle = 0.5 * (low + high)
        _, at, W, _ = beside(side, k, middle, r, X, mesh, rule, w)
        if (at + of_W * (W - at) - target) * side >= 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@compiled
def bracket_labels(k, off, r, X, mesh, rule, w):
    """Labels of shock k to start Newton's method from: between the folds of X, W⁻ - W⁺ falls with x."""
    right = fold(1.0, k, r, X, mesh, rule, w)
    if mesh.first[k] == mesh.first[k + 1]:
        off[k, 1] = label_of(1.0, k, 0.0, 1.0, right, r, X, mesh, rule, w)
        return off[k, 1] == off[k, 1]
    left = fold(-1.0, k, r, X, mesh, rule, w)
    if not (left >= 0.0 and right >= 0.0):
        return False
    low, high = beside(1.0, k, right, r, X, mesh, rule, w)[1], beside(-1.0, k, left, r, X, mesh, rule, w)[1]
    if not low < high:
        return False
    b0 = b1 = 0.0
    for _ in range(60):
        x = 0.5 * (low + high)
        b0 = label_of(-1.0, k, x, 0.0, left, r, X, mesh, rule, w)
        b1 = label_of(1.0, k, x, 0.0, right, r, X, mesh, rule, w)
        if b0 != b0:
            low = x
        elif b1 != b1 or beside(-1.0, k, b0, r, X, mesh, rule, w)[2] < beside(1.0, k, b1, r, X, mesh, rule, w)[2]:
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
    """Fills the labels of shock k, by Newton's method or between folds; returns whether found, X rising at both."""
    for attempt in range(2):
        if attempt == 1 and not bracket_labels(k, off, r, X, mesh, rule, w):
            return False
        if newton_labels(k, off, r, X, mesh, rule, law, w):
            rising = beside(1.0, k, off[k, 1], r, X, mesh, rule, w)[3] > 0.0
            if mesh.first[k] < mesh.first[k + 1]:
                rising = rising and beside(-1.0, k, off[k, 0], r, X, mesh, rule, w)[3] > 0.0
            if rising or attempt == 1 or max(off[k, 0], off[k, 1]) == 0.0:
                return True
    return False


@compiled
def rates(y, t, mesh, rule, law, off, off_top, birth, power, tau, S, c, unborn, out):
    """dy/dt for y = (r, X, ∫(K_left - 1), ∫F(0)); finds the labels of shocks and of x = 0 on the way.

    Fills S and c of ln K = ln r + S + c. For a young shock `off` scales with (t - birth)^power from its last time tau;
    nothing else is known of one born at the time `unborn`, whose fold the state does not hold yet.
    Returns 0, or 1 + k where the labels of shock k are lost, or -1 where a state is not admissible.
    """
    P, n = mesh.I.shape
    r, X = y[: P * n].reshape(P, n), y[P * n : 2 * P * n].reshape(P, n)
    w = np.empty(n)
    shocks = off.shape[0]
    for p in range(P):
        for i in range(n):
            if not r[p, i] > 0.0:
                return -1
    for k in range(shocks):
        if power[k, 1] > 0.0:
            age = t - birth[k]
            if age <= 0.0:
                continue
            for side in range(2):
                off[k, side] *= (age / tau[k]) ** power[k, side]
            tau[k] = age
            if birth[k] == unborn:
                continue
        if not shock_labels(k, off, r, X, mesh, rule, law, w):
            return 1 + k

    g = np.empty(n)
    for k in range(shocks + 1):
        right = 0.0
        for p in range(mesh.first[k + 1] - 1, mesh.first[k] - 1, -1):
            for i in range(n):
                g[i] = mesh.dI[p, i] / r[p, i]
            for i in range(n):
                S[p, i] = right + dot(g, rule.B, i)
            right = S[p, 0]

    at = off_top[0]
    for _ in range(30):  # the label at x = 0
        p, s = before_end(at, shocks, mesh)
        if not abs(s) <= BEYOND:
            return -1
        top_r, top_X, _, slope = at_label(p, s, r, X, mesh, rule, w)
        if abs(top_X) <= CLOSE or not slope > 0.0:
            break
        at += top_X * mesh.half[p] / slope
    if not abs(top_X) <= NOISE:
        return -1
    off_top[0] = at
    c[shocks] = -math.log(top_r) - dot(w, S, p)
    log_K = 0.0
    for k in range(shocks - 1, -1, -1):
        p, s = after_start(off[k, 1], k + 1, mesh)
        weights(rule, s, w)
        log_K = math.log(dot(w, r, p)) + dot(w, S, p) + c[k + 1]
        if mesh.first[k] < mesh.first[k + 1]:
            p, s = before_end(off[k, 0], k, mesh)
            weights(rule, s, w)
            c[k] = log_K - math.log(dot(w, r, p)) - dot(w, S, p)

    for k in range(shocks + 1):
        for p in range(mesh.first[k], mesh.first[k + 1]):
            for i in range(n):
                K = r[p, i] * math.exp(S[p, i] + c[k])
                f, f1, _ = law_terms(r[p, i], law)
                out[p * n + i] = K * f * f / (f + f1)
                out[P * n + p * n + i] = K * f1 / (r[p, i] * (f + f1))
    if mesh.first[0] < mesh.first[1]:
        log_K = math.log(r[0, 0]) + S[0, 0] + c[0]
    out[2 * P * n] = math.exp(log_K) - 1.0
    out[2 * P * n + 1] = law_terms(top_r, law)[0]
    return 0


@compiled
def step(y, clock, h, origin, rule_A, B, E3, E5, mesh, rule, law, off, off_top, birth, power, tau, S, c, k, new):
    """One step of Dormand and Prince's method of order 8 in t, or in z = sqrt(t - origin) where that is not NaN.

    `k` (13, size of y) is workspace. Returns the error estimate (largest entry), and as `rates`.
    """
    m = y.size
    stage = np.empty(m)
    in_root = origin == origin
    nodes = np.zeros(13)
    for i in range(1, 12):
        for j in range(i):
            nodes[i] += rule_A[i, j]
    nodes[12] = 1.0
    for i in range(13):
        for l in range(m):
            stage[l] = 0.0
        for j in range(min(i, 12)):
            a = rule_A[i, j] if i < 12 else B[j]
            if a != 0.0:
                for l in range(m):
                    stage[l] += a * k[j, l]
        for l in range(m):
            stage[l] = y[l] + h * stage[l]
        z = clock + nodes[i] * h
        t = origin + z * z if in_root else z
        # all rates by z vanish at a birth: the second stage has the state of the first, at a later time
        unborn = origin if i == 1 and clock == 0.0 else math.nan
        found = rates(stage, t, mesh, rule, law, off, off_top, birth, power, tau, S, c, unborn, k[i])
        if found != 0:
            return math.inf, found
        if in_root:
            for l in range(m):
                k[i, l] *= 2.0 * z
    fifth = third = 0.0
    for l in range(m):
        new[l] = stage[l]
        e5 = e3 = 0.0
        for i in range(13):
            e5 += E5[i] * k[i, l]
            e3 += E3[i] * k[i, l]
        scale = 1.0 + abs(new[l])
        e5, e3 = abs(e5) / scale, abs(e3) / scale
        if not e5 <= fifth:
            fifth = e5
        if not e3 <= third:
            third = e3
    if not fifth < math.inf:
        return math.inf, 0
    return abs(h) * fifth * fifth / math.sqrt(fifth * fifth + 0.01 * third * third + 1e-300), 0


@compiled
def read(y, mesh, rule, low, high, S, c, nodes, W_out, K_out):
    """W and K at increasing `nodes`: label by label where it is alive, low[p] <= s <= high[p], between shocks' places.

    S and c as `rates` leaves them.
    """
    P, n = mesh.I.shape
    r, X = y[: P * n].reshape(P, n), y[P * n : 2 * P * n].reshape(P, n)
    w = np.empty(n)
    left, right = np.empty(P), np.empty(P)
    of = np.zeros(P, dtype=np.int64)
    for k in range(mesh.first.size - 1):
        of[mesh.first[k] : mesh.first[k + 1]] = k
    p = 0
    for p in range(P):
        weights(rule, low[p], w)
        left[p] = dot(w, X, p)
        weights(rule, high[p], w)
        right[p] = dot(w, X, p)
    p = 0
    s = -1.0
    for i in range(nodes.size):
        x = nodes[i]
        while p < P - 1 and (high[p] <= low[p] or x > right[p]):
            p += 1
            s = low[p]
        a, b = low[p], high[p]
        if x <= left[p]:  # left of all labels, where q = 0, or within rounding of a shock
            s = a
        elif x >= right[p]:
            s = b
        else:
            s = min(max(s, a), b)
            for _ in range(60):
                _, at, _, slope = at_label(p, s, r, X, mesh, rule, w)
                if at > x:
                    b = s
                else:
                    a = s
                if abs(at - x) <= 1e-15 * max(1.0, abs(x)):
                    break
                trial = s + (x - at) / slope if slope > 0.0 else a
                s = trial if a < trial < b else 0.5 * (a + b)
        weights(rule, s, w)
        value = dot(w, r, p)
        W_out[i] = dot(w, mesh.I, p) - value
        K_out[i] = value * math.exp(dot(w, S, p) + c[of[p]])
        if x < left[p] and p == first_alive(low, high):
            W_out[i] = 0.0


@compiled
def first_alive(low, high):
    """The first panel with a living label."""
    for p in range(low.size):
        if high[p] > low[p]:
            return p
    return low.size - 1
