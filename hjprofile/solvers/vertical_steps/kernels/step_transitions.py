"""Transitions between kinks and vertical steps, births and exits, in the conventions of `steps` (theory, §14)."""

import math

import numpy as np

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.journal import BIRTH, BLOW_UP, EXIT, OUTFLOW, new_label, note
from hjprofile.solvers.vertical_steps.kernels.step_merging import copy_front
from hjprofile.solvers.vertical_steps.kernels.steps import at, f_of, v_of_r, y_of


@compiled
def transitions(fronts, n, t, quantum, strong, law, sides, journal):
    """Kinks that have become steps and the reverse, slopes that steps leave behind, births and exits.

    Return how many fronts there are. A step slower than the steep slopes just above it lets them go: a front of
    strength `quantum` leaves it to the right.
    """
    j = 0
    while j < n:
        change_kind(fronts, j, t, strong, sides, journal)
        if fronts.is_step[j]:
            date_blow_up(fronts, j, t, law, sides)
            if n < fronts.x.size and lets_go(j, quantum, law, sides):
                release(fronts, n, j, quantum, law, sides)
                n += 1
                j += 1
        j += 1
    number_steps(fronts, n, t, strong, sides, journal)
    x, label = fronts.x, fronts.label
    while n > 0 and x[n - 1] >= 0.0:
        n -= 1
        if fronts.is_step[n]:
            journal.totals[OUTFLOW] += sides.height[n]  # what is above a step falls over the edge with it
        if label[n] > 0:
            note(journal, t - x[n] / sides.speed[n], EXIT, label[n], 0, 0.0)
    return n


@compiled
def change_kind(fronts, j, t, strong, sides, journal):
    """Make a kink a step where W on its right has no room under an infinite slope, and a step without height a kink.

    A front that has merged is a kink once its jump is above `strong`, born when it first merged.
    """
    x, label, m, first_merge = fronts.x, fronts.label, sides.height, fronts.first_merge
    if not fronts.is_step[j] and m[j] > 0.0:
        fronts.is_step[j], fronts.y[j] = True, 0.0
        if label[j] > 0:
            note(journal, t, BLOW_UP, label[j], 0, x[j])
    elif fronts.is_step[j] and m[j] <= 0.0:
        fronts.is_step[j] = False
    elif label[j] == 0 and not fronts.is_step[j] and first_merge[j] <= t and fronts.jump[j] > strong:
        label[j] = new_label(journal)
        note(journal, first_merge[j], BIRTH, label[j], 0, x[j] - (t - first_merge[j]) * sides.speed[j])


@compiled
def date_blow_up(fronts, j, t, law, sides):
    """Set when q became infinite midway through a step, by dR/dt = K (f - q f') from when it is so on its right."""
    if fronts.blow_up[j] == np.inf:
        middle = sides.r_left[j] + 0.5 * fronts.jump[j]
        over, v = middle - law.r_most, v_of_r(middle, law)
        fronts.blow_up[j] = t - over / (sides.K[j] * (f_of(v, law) - math.expm1(v) * at(law.df, law, v)))


@compiled
def lets_go(j, quantum, law, sides):
    """Return whether step j is slower than the slope that would lie on its right without a front of that strength."""
    if not sides.r_right[j] + quantum < law.r_most:
        return False
    v = v_of_r(sides.r_right[j] + quantum, law)
    return sides.speed[j] < sides.K[j] * at(law.df, law, v)


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
def number_steps(fronts, n, t, strong, sides, journal):
    """Number steps that open in a smooth slope: of neighbours that do so together, one that outweighs the rest."""
    x, label, m = fronts.x, fronts.label, sides.height
    j = 0
    while j < n:
        first, tallest, height, born = j, j, 0.0, np.inf
        numbered = False
        while j < n and fronts.is_step[j]:
            numbered |= label[j] > 0
            height += m[j]
            born = min(born, fronts.blow_up[j])
            if m[j] > m[tallest]:
                tallest = j
            j += 1
        if j > first and not numbered and m[tallest] > 0.5 * height and height > strong and t >= born:
            label[tallest] = new_label(journal)
            born = min(born, t)
            note(journal, born, BLOW_UP, label[tallest], 0, x[tallest] - (t - born) * sides.speed[tallest])
        j = max(j, first + 1)
