"""Merges of kinks and vertical steps, in the conventions of `steps` (§16)."""

import math

from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.journal import BLOW_UP, MERGE, note
from hjprofile.solvers.vertical_steps.kernels.steps import at, moved, r_of, v_of, y_of

LEVEL = 1e-14  # height of a vertical step, relative to the jump of I, that counts as rounding


@compiled
def excess_area(y, h, law):
    """Return ∫(R - R(0)) dx over a distance h (of either sign) from a point with y, in a piece of constant I."""
    area = at(law.area, law, v_of(y, law)) - at(law.area, law, v_of(moved(y, h, law), law))
    if h < 0.0 and y < 1.0:  # beyond its vertical slope a piece is level
        area += min(h - math.log1p(-y) / law.rate, 0.0) * (law.r_most - law.r0)
    return area


@compiled
def height(x, left, right, jump, law):
    """Return the height of a vertical step at x between two pieces, and its derivative by x.

    A piece is a position with y there. I right of the step exceeds I left of it by `jump`.
    """
    v1 = v_of(moved(left[1], x - left[0], law), law)
    v2 = v_of(moved(right[1], x - right[0], law), law)
    return r_of(v1, law) + jump - r_of(v2, law), math.expm1(v2) - math.expm1(v1)


@compiled
def corner(left, right, jump, law):
    """Return the position at which W is continuous between two pieces, and True if W is continuous there.

    Newton's method finds it, between the positions of the pieces if it lies there. It does for two jumps of the same
    sign.
    """
    xa, xb = left[0], right[0]
    x, most = 0.5 * (xa + xb), 20.0 * abs(xa - xb)
    at_a, at_b = height(xa, left, right, jump, law)[0], height(xb, left, right, jump, law)[0]
    for end, m in ((xa, at_a), (xb, at_b)):
        if abs(m) <= LEVEL * max(1.0, abs(jump)):
            return end, True
    between = at_a > 0.0 > at_b or at_a < 0.0 < at_b
    low, high = (min(xa, xb), max(xa, xb)) if between else (x - most, x + most)
    rising = at_b > at_a if xb > xa else at_a > at_b
    for _ in range(60):
        m, slope = height(x, left, right, jump, law)
        if between and (m < 0.0) == rising:
            low = x
        elif between:
            high = x
        nearer = x - m / slope
        if not low <= nearer <= high:
            nearer = 0.5 * (low + high) if between else min(max(nearer, low), high) if nearer == nearer else x
        done = abs(nearer - x) < 1e-15
        x = nearer
        if done:
            break
    m = height(x, left, right, jump, law)[0]
    return x, m <= 1e-9 * max(1.0, abs(jump))


@compiled
def balance(left, middle, right, jump_left, jump_right, law):
    """Return the position of a step between `left` and `right` with the same ∫W dx as with `middle` between them.

    The front left of `middle` lies at the position of `left` and `middle`, the front right of it at that of `right`.
    """
    (xa, ya), (xb, yb), jump = left, right, jump_left + jump_right
    now = jump_left * (xb - xa) - excess_area(middle[1], xb - xa, law)
    x, most = 0.5 * (xa + xb), 20.0 * abs(xa - xb)
    low, high = x - most, x + most
    for _ in range(60):
        m = height(x, left, right, jump, law)[0]
        gain = jump * (xb - x) + excess_area(yb, x - xb, law) - excess_area(ya, x - xa, law) - now
        nearer = min(max(x + gain / m, low), high) if m > 0.0 else x
        done = abs(nearer - x) < 1e-15
        x = nearer
        if done:
            break
    return x


@compiled
def merge(fronts, n, t, law, sides, y_right, journal):
    """Merge fronts that are out of order, also several at once; return the number of remaining fronts.

    Two kinks merge where W stays continuous. If one of them is a vertical step, or becomes one, the position preserves
    ∫W dx instead. The piece on the right of all fronts is unchanged, and with it the mass. `y_right` holds y on the
    right of the fronts.
    """
    x, jump, is_step, y, label = fronts.x, fronts.jump, fronts.is_step, fronts.y, fronts.label
    blow_up, first_merge = fronts.blow_up, fronts.first_merge
    v_left, v_right, m, speed = sides.v_left, sides.v_right, sides.height, sides.speed
    k = -1
    for j in range(n):
        k += 1
        if k < j:
            x[k], jump[k], is_step[k], y[k], label[k] = x[j], jump[j], is_step[j], y[j], label[j]
            blow_up[k], first_merge[k] = blow_up[j], first_merge[j]
            y_right[k], v_left[k], v_right[k], m[k], speed[k] = y_right[j], v_left[j], v_right[j], m[j], speed[j]
        while k > 0 and x[k - 1] > x[k]:
            i = k - 1
            total = jump[i] + jump[k]
            left, middle, right = (x[i], y_of(v_left[i], law)), (x[i], y_right[i]), (x[k], y_right[k])
            place, fits = corner(left, right, total, law)
            as_step = is_step[i] or is_step[k] or not fits
            if as_step:
                place = balance(left, middle, right, jump[i], jump[k], law)
            known = (is_step[i] and label[i] > 0) or (is_step[k] and label[k] > 0)
            if label[i] > 0 and label[k] > 0:
                closing = speed[i] - speed[k]
                ago = (x[i] - x[k]) / closing if closing > 0.0 else 0.0
                note(journal, t - ago, MERGE, max(label[i], label[k]), min(label[i], label[k]), place)
                label[i] = min(label[i], label[k])
            else:
                label[i] = max(label[i], label[k])
            vertical_at = min(blow_up[i], blow_up[k])
            if as_step and label[i] > 0 and not known:
                note(journal, min(t, vertical_at), BLOW_UP, label[i], 0, place)
            y[i] = y_right[i] = moved(right[1], place - right[0], law)
            v_left[i] = v_of(moved(left[1], place - left[0], law), law)
            v_right[i] = v_of(y[i], law)
            m[i] = r_of(v_left[i], law) + total - r_of(v_right[i], law) if as_step else 0.0
            x[i], jump[i], is_step[i], blow_up[i] = place, total, as_step, vertical_at
            first_merge[i] = min(first_merge[i], first_merge[k], t)
            speed[i] = speed[i] if is_step[i] else speed[k]
            k = i
    return k + 1
