"""Transitions between kinks and vertical steps, births and exits, in the conventions of `steps` (§16)."""

import math

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.journal import BIRTH, BLOW_UP, CREST_LOWERING, EXIT, new_label, note
from hjprofile.solvers.vertical_steps.kernels.steps import at, f_of, v_of_r, y_of


@compiled
def transitions(fronts, n, t, quantum, strong, law, sides, journal):
    """Convert kinks to vertical steps and back, release slopes that steps leave behind, and record births and exits.

    Return the number of fronts. A kink becomes a vertical step if its jump of I exceeds the R of an infinite slope on
    its right. A merged front is a kink when its jump exceeds `strong`, born at its first merge. A step slower than the
    steep slopes just above it releases them: a front of strength `quantum` leaves it to the right.
    """
    x, jump, is_step, y, label = fronts.x, fronts.jump, fronts.is_step, fronts.y, fronts.label
    first_merge, blow_up = fronts.first_merge, fronts.blow_up
    r_left, r_right, m, K, speed = sides.r_left, sides.r_right, sides.height, sides.K, sides.speed
    j = 0
    while j < n:
        if not is_step[j] and m[j] > 0.0:
            is_step[j], y[j] = True, 0.0
            if label[j] > 0:
                note(journal, t, BLOW_UP, label[j], 0, x[j])
        elif is_step[j] and m[j] <= 0.0:
            is_step[j] = False
        elif label[j] == 0 and not is_step[j] and first_merge[j] <= t and jump[j] > strong:
            label[j] = new_label(journal)
            note(journal, first_merge[j], BIRTH, label[j], 0, x[j] - (t - first_merge[j]) * speed[j])
        if is_step[j]:
            if blow_up[j] == np.inf:
                blow_up[j] = t - time_since_vertical(r_left[j] + 0.5 * jump[j], K[j], law)
            if n < x.size and releases(r_right[j] + quantum, speed[j], K[j], law):
                release(fronts, n, j, quantum, law, sides)
                n += 1
                j += 1
        j += 1
    number_steps(fronts, n, t, strong, sides, journal)
    while n > 0 and x[n - 1] >= 0.0:
        n -= 1
        if is_step[n]:
            journal.totals[CREST_LOWERING] += m[n]  # the height of a step is part of the lowering when it leaves
        if label[n] > 0:
            note(journal, t - x[n] / speed[n], EXIT, label[n], 0, 0.0)
    return n


@compiled
def time_since_vertical(r, K, law):
    """Return the time since q was infinite where R is now r, by dR/dt = K (f - q f')."""
    v = v_of_r(r, law)
    return (r - law.r_most) / (K * (f_of(v, law) - math.expm1(v) * at(law.df, law, v)))


@compiled
def releases(r, speed, K, law):
    """Return True if a vertical step is slower than the slope with R = r that would then lie on its right."""
    return r < law.r_most and speed < K * at(law.df, law, v_of_r(r, law))


@compiled
def release(fronts, n, j, quantum, law, sides):
    """Split a front of strength `quantum` off the right of step j; it becomes front j + 1 of n + 1."""
    x, jump, r_right = fronts.x, fronts.jump, sides.r_right
    for i in range(n, j + 1, -1):
        copy_front(fronts, i - 1, i)
        for side in sides:
            side[i] = side[i - 1]
    v, r = v_of_r(r_right[j] + quantum, law), r_right[j] + quantum
    x[j + 1], jump[j + 1], fronts.is_step[j + 1], fronts.y[j + 1], fronts.label[j + 1] = x[j], -quantum, False, 0.0, 0
    fronts.blow_up[j + 1], fronts.first_merge[j + 1] = np.inf, np.inf
    sides.v_left[j + 1], sides.r_left[j + 1], sides.height[j + 1] = v, r, 0.0
    jump[j] += quantum
    sides.v_right[j], r_right[j], fronts.y[j] = v, r, y_of(v, law)


@compiled
def copy_front(fronts, j, k):
    """Copy front j to the index k."""
    fronts.x[k], fronts.jump[k], fronts.y[k] = fronts.x[j], fronts.jump[j], fronts.y[j]
    fronts.is_step[k], fronts.label[k] = fronts.is_step[j], fronts.label[j]
    fronts.blow_up[k], fronts.first_merge[k] = fronts.blow_up[j], fronts.first_merge[j]


@compiled
def number_steps(fronts, n, t, strong, sides, journal):
    """Label vertical steps that open in a smooth slope: of adjacent ones, the one higher than all others together."""
    x, is_step, label, blow_up, m = fronts.x, fronts.is_step, fronts.label, fronts.blow_up, sides.height
    j = 0
    while j < n:
        first, tallest, height, born = j, j, 0.0, np.inf
        numbered = False
        while j < n and is_step[j]:
            numbered |= label[j] > 0
            height += m[j]
            born = min(born, blow_up[j])
            if m[j] > m[tallest]:
                tallest = j
            j += 1
        if j > first and not numbered and m[tallest] > 0.5 * height and height > strong and t >= born:
            label[tallest] = new_label(journal)
            born = min(born, t)
            note(journal, born, BLOW_UP, label[tallest], 0, x[tallest] - (t - born) * sides.speed[tallest])
        j = max(j, first + 1)
