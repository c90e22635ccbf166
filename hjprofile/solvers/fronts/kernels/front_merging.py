"""Merges, births and exits of fronts, in the conventions of `front_state`."""

import math
from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import by_type, inner
from hjprofile.solvers.kernels.journal import BIRTH, EXIT, MERGE, new_label, note
from hjprofile.solvers.kernels.law import Rational, law_decay, law_q_f


class Stack(NamedTuple):
    """A stack of fronts in order, onto which later fronts are pushed or merged.

    Attributes:
        x, jump, label, first_merge, speed: of the front.
        first: the leftmost of the fronts that it consists of.
    """

    x: np.ndarray
    jump: np.ndarray
    label: np.ndarray
    first_merge: np.ndarray
    speed: np.ndarray
    first: np.ndarray


@inner
def meeting(xa, ra, xb, rb, jump, span, law):
    """Return the position at which the piece left of front a and the piece right of front b have the same W.

    The jump of I from a to b is `jump`. A merged front at this position keeps W continuous and the mass to its right
    unchanged. `span` is the extent of all fronts that merge.
    """
    x = same_W(xa, ra, xb, rb, jump, law)
    # The position lies between xa and xb if both jumps have the same sign, outside otherwise. It is undefined if the
    # net jump vanishes.
    m, most = 0.5 * (xa + xb), 20.0 * span
    return min(max(x, m - most), m + most) if x == x else m


@by_type
def same_W(xa, ra, xb, rb, jump, law):
    """Return the position for `meeting`; NaN if there is none, and infinite if the jump is too small for one."""
    if law.instance_class is Rational:

        def rational(xa, ra, xb, rb, jump, law):
            # 1 + (rb-1) e^{-(x-xb)} - 1 - (ra-1) e^{-(x-xa)} = jump; distances from the middle
            m = 0.5 * (xa + xb)
            ratio = ((rb - 1.0) * math.exp(xb - m) - (ra - 1.0) * math.exp(xa - m)) / jump
            return m + math.log(ratio) if ratio > 0.0 else m

        return rational

    def tabulated(xa, ra, xb, rb, jump, law):
        x = 0.5 * (xa + xb)
        for _ in range(4):  # Newton
            r1 = law_decay(ra, x - xa, law)
            r2 = law_decay(rb, x - xb, law)
            dq = law_q_f(r2, law)[0] - law_q_f(r1, law)[0]
            if dq == 0.0:
                break
            dx = (r2 - r1 - jump) / dq
            x += dx
            if abs(dx) < 1e-15:
                break
        return x

    return tabulated


@inner
def merge(fronts, n, t, law, sides, speed, stack, journal):
    """Merge fronts that are out of order, also several at once; return the number of remaining fronts.

    The log receives the time at which two kinks met within the step that ends at t.
    """
    x, jump, label, first_merge = fronts.x, fronts.jump, fronts.label, fronts.first_merge
    r_left, r_right, stack_x, stack_jump = sides.r_left, sides.r_right, stack.x, stack.jump
    stack_label, stack_merge, stack_speed, stack_first = stack.label, stack.first_merge, stack.speed, stack.first
    m = 0
    for j in range(n):
        xj, dj, lj, tj, vj, first = x[j], jump[j], label[j], first_merge[j], speed[j], j
        while m > 0 and stack_x[m - 1] > xj:
            m -= 1
            first = stack_first[m]
            other, closing, overlap = stack_label[m], stack_speed[m] - vj, stack_x[m] - xj
            dj += stack_jump[m]
            tj = min(tj, stack_merge[m], t)
            left = right = x[j]
            for i in range(first, j):
                left, right = min(left, x[i]), max(right, x[i])
            xj = meeting(x[first], r_left[first], x[j], r_right[j], dj, right - left, law)
            if other > 0 and lj > 0:
                ago = overlap / closing if closing > 0.0 else 0.0
                note(journal, t - ago, MERGE, max(lj, other), min(lj, other), xj - ago * vj)
                lj = min(lj, other)
            elif other > 0:
                lj, vj = other, stack_speed[m]
        stack_x[m], stack_jump[m], stack_label[m], stack_merge[m], stack_speed[m] = xj, dj, lj, tj, vj
        stack_first[m] = first
        m += 1
    if m < n:
        smooth = fronts.smooth
        for j in range(m):
            last = stack_first[j + 1] - 1 if j + 1 < m else n - 1
            x[j], jump[j], label[j], first_merge[j] = stack_x[j], stack_jump[j], stack_label[j], stack_merge[j]
            speed[j], smooth[j], r_left[j], r_right[j] = (
                stack_speed[j],
                smooth[last],
                r_left[stack_first[j]],
                r_right[last],
            )
    return m


@inner
def note_events(fronts, n, t, strong, speed, journal):
    """Label the kinks that were born and remove the fronts that left; return the number of fronts.

    A merged front becomes a kink when its jump exceeds `strong`; its birth is its first merge.
    """
    x, jump, label, first_merge = fronts.x, fronts.jump, fronts.label, fronts.first_merge
    for j in range(n):
        if label[j] == 0 and first_merge[j] <= t and jump[j] > strong:
            label[j] = new_label(journal)
            note(journal, first_merge[j], BIRTH, label[j], 0, x[j] - (t - first_merge[j]) * speed[j])
    while n > 0 and x[n - 1] >= 0.0:
        n -= 1
        if label[n] > 0:
            note(journal, t - x[n] / speed[n], EXIT, label[n], 0, 0.0)
    return n
