"""Signs that announce the events of characteristics: folds of X, and distances that shrink to 0 (§14).

The conventions are those of `kernels.labels`.
"""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.characteristics.kernels.labels import after_start, before_end, dot, weights
from hjprofile.solvers.kernels import compiled

NO_FOLD_RATIO = 0.5  # smallest by largest X_ξ at the points of a panel above which there is no fold between them
NEAR_FOLD = 0.02  # X_ξ below which its minimum is found by Newton's method


class Fine(NamedTuple):
    """The fine positions at which a fold is searched for.

    Attributes:
        s: positions in a panel, shape (fine,).
        D: derivative at these of values at the points, shape (fine, points).
        D2, D3: second and third derivative at the points.
    """

    s: np.ndarray
    D: np.ndarray
    D2: np.ndarray
    D3: np.ndarray


class Signs(NamedTuple):
    """Values that become negative at an event, and the numbers from which they are computed.

    Attributes:
        low, high: local range of each panel in which labels are alive, empty (high <= low) if there are none.
        fold, place: the smallest X_ξ on the living part of each panel, and its local position.
        merge: width of the living labels between shocks k - 1 and k; infinite for k = 0.
        left, right: distances of the labels of shock k from a joint across which fields are not analytic.
        ends: -x of the last shock, infinite without shocks, and the distance of the label at x = 0 from such a joint.
    """

    low: np.ndarray
    high: np.ndarray
    fold: np.ndarray
    place: np.ndarray
    merge: np.ndarray
    left: np.ndarray
    right: np.ndarray
    ends: np.ndarray


@compiled
def living(mesh, off, off_crest, low, high):
    """Fill the local range of each panel in which labels are alive."""
    low[:] = -1.0
    high[:] = 1.0
    shocks = off.shape[0]
    for k in range(shocks):
        p, s = after_start(off[k, 1], k + 1, mesh)
        low[mesh.first[k + 1] : p] = 1.0
        low[p] = s
        if mesh.first[k] < mesh.first[k + 1]:
            p, s = before_end(off[k, 0], k, mesh)
            high[p] = s
            high[p + 1 : mesh.first[k + 1]] = -1.0
    p, s = before_end(off_crest[0], shocks, mesh)
    high[p] = s
    high[p + 1 :] = -1.0


@compiled
def to_joint(mesh, p, last, towards):
    """Return the width of the panels from p on up to the first joint across which fields are not analytic."""
    total = 2.0 * mesh.half[p]
    while p != last and mesh.joined[p if towards < 0 else p + 1]:
        p += towards
        total += 2.0 * mesh.half[p]
    return total


@compiled
def fold_of(p, X, mesh, rule, fine, low, high, w):
    """Return the smallest X_ξ on the living part of panel p, and its local position."""
    least = most = 0.0
    for i in range(w.size):
        slope = dot(X[p], rule.D, i)
        least = slope if i == 0 or slope < least else least
        most = slope if i == 0 or slope > most else most
    if least > NO_FOLD_RATIO * most and least > NEAR_FOLD * mesh.half[p]:
        return least / mesh.half[p], 0.0
    best, at = np.inf, -1
    for i in range(fine.s.size):
        if low <= fine.s[i] <= high:
            slope = dot(X[p], fine.D, i)
            if slope < best:
                best, at = slope, i
    if at < 0:
        return np.inf, 0.0
    s, best = fine.s[at], best / mesh.half[p]
    if best < NEAR_FOLD:
        start = max(fine.s[max(at - 1, 0)], low)
        end = min(fine.s[min(at + 1, fine.s.size - 1)], high)
        trial = s
        for _ in range(4):
            weights(rule, trial, w)
            second = third = 0.0
            for i in range(w.size):
                second += w[i] * dot(X[p], fine.D2, i)
                third += w[i] * dot(X[p], fine.D3, i)
            if not third > 0.0:
                break
            trial = min(max(trial - second / third, start), end)
        weights(rule, trial, w)
        slope = 0.0
        for i in range(w.size):
            slope += w[i] * dot(X[p], rule.D, i)
        slope /= mesh.half[p]
        if slope < best:
            best, s = slope, trial
    return best, s


@compiled
def find_signs(X, mesh, off, off_crest, rule, fine, signs):
    """Fill the signs of a state with at least one panel."""
    shocks, first = off.shape[0], mesh.first
    w = np.empty(rule.s.size)
    living(mesh, off, off_crest, signs.low, signs.high)
    for p in range(X.shape[0]):
        signs.fold[p] = np.inf
        if signs.high[p] > signs.low[p]:
            signs.fold[p], signs.place[p] = fold_of(p, X, mesh, rule, fine, signs.low[p], signs.high[p], w)
    signs.ends[0] = np.inf
    for k in range(shocks):
        signs.merge[k] = signs.left[k] = np.inf
        if k > 0:
            signs.merge[k] = 2.0 * mesh.half[first[k] : first[k + 1]].sum() - off[k - 1, 1] - off[k, 0]
        if first[k] < first[k + 1]:
            signs.left[k] = to_joint(mesh, first[k + 1] - 1, first[k], -1) - off[k, 0]
        signs.right[k] = to_joint(mesh, first[k + 1], first[k + 2] - 1, 1) - off[k, 1]
        if k == shocks - 1:
            p, s = after_start(off[k, 1], shocks, mesh)
            weights(rule, s, w)
            signs.ends[0] = -(mesh.base[p] + dot(w, X, p))
    signs.ends[1] = to_joint(mesh, X.shape[0] - 1, first[shocks], -1) - off_crest[0]
