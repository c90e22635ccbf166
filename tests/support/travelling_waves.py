"""Perturbed travelling waves on the whole line: data of a given mass, distances from the wave, and rates from I."""

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

import hjprofile as hj


def amplitude(law, mass):
    """Return the amplitude of the wave with ∫q dx = mass: R(A) = R(0) + mass, as I is constant right of its kink."""
    return slope_of(law, float(law.R(0.0)) + mass)


def slope_of(law, R):
    """Return q with R(q) = R."""
    return float(np.expm1(brentq(lambda v: float(law.R(np.expm1(v))) - R, -5.0, 50.0, xtol=1e-14)))


def kinks(law, positions, amplitudes, mass):
    """Return kinks with these amplitudes and the last one such that ∫q dx = mass."""
    before = hj.kinks(positions[:-1], amplitudes)
    W = float(before.W(np.array(positions[-1]), law))
    return hj.kinks(positions, [*amplitudes, slope_of(law, float(law.R(0.0)) + mass - W)])


def wave_with_bump(law, mass, centre, size, width=0.5, spacing=0.02):
    """Return the wave of a kink at 0 plus a bump of compact support: a cosine bell of that width, height and centre.

    The mass is that of the sum. q is sampled, up to 18 decay lengths from the kink.
    """
    A = amplitude(law, mass - size * width)  # the integral of the bell

    def bell(x):
        return size * np.where(np.abs(x - centre) < width, 0.5 * (1.0 + np.cos(np.pi * (x - centre) / width)), 0.0)

    right = np.arange(spacing, 18.0 * float(law.R_derivative(0.0)), spacing)
    left = np.arange(min(centre - 1.5 * width, -spacing), -0.5 * spacing, spacing)
    tail = law.decay(A, right)
    at_kink = float(bell(0.0))
    return hj.points([*left, 0.0, 0.0, *right], [*bell(left), at_kink, A + at_kink, *(tail + bell(right))])


def smooth(mass, decay):
    """Return q = 2 b mass e^{-bx} (1 - e^{-bx}) for x > 0, with b = `decay`: smooth, decays like e^{-bx}."""
    return hj.profile(lambda x: x + mass * (-np.expm1(-decay * np.maximum(x, 0.0))) ** 2)


def distances(law, mass, run):
    """Return ‖q - q_wave‖₁ and ‖u - u_wave‖_∞ at the saved times, each the minimum over shifts of the wave.

    q is compared by means over cells.
    """
    behind = np.linspace(0.0, run.x[-1] - run.x[0], 200_001)  # the kink; W is linear in between to 1e-7
    W_behind = hj.kinks([0.0], [amplitude(law, mass)]).W(behind, law)
    found = []
    for u, q in zip(run.u, run.q, strict=True):
        W, near = u - run.x - (u[0] - run.x[0]), run.x_cell[int(np.argmax(q))]

        def wave(s):
            return np.interp(run.x - s, behind, W_behind)

        def in_q(s, W=W):
            return float(np.abs(np.diff(wave(s)) - np.diff(W)).sum())

        def in_u(s, W=W):
            return float(np.abs(wave(s) - W).max())

        found.append([_least(f, near) for f in (in_q, in_u)])
    return np.array(found).T


def _least(f, near):
    """Return the minimum of f, which has one valley, over shifts near a position."""
    shifts = near + np.linspace(-4.0, 4.0, 161)
    values = [f(s) for s in shifts]
    i = int(np.argmin(values))
    ends = shifts[max(i - 1, 0)], shifts[min(i + 1, shifts.size - 1)]
    return min(minimize_scalar(f, bounds=ends, method="bounded", options={"xatol": 1e-13}).fun, values[i])


def excess(law, mass, run):
    """Return R(q⁺) - R(A) at the saved times, for the strongest kink; NaN where there is none."""
    RA, found = float(law.R(amplitude(law, mass))), []
    for t in run.time:
        jumps = [k.q_right for k in run.kinks if k.time == t]
        found.append(float(law.R(max(jumps))) - RA if jumps else np.nan)
    return np.array(found)


def excess_by_invariant(law, mass, q, W, labels):
    """Return times, and R(q⁺) - R(A) when the characteristics with these initial positions reach the kink.

    q = 0 and W = 0 left of the kink, so R(q⁺) is the invariant I = W + R(q) of the characteristic that arrives. On its
    way dq/dt = K f², K = R(q)/R(0) up to a factor that tends to 1, so it arrives at R(0) ∫ R/q² dq. `q` and `W` are
    functions of the initial position.
    """
    R0 = float(law.R(0.0))
    at = np.array([float(W(x)) + float(law.R(q(x))) for x in labels])
    times = [arrival(law, q(x), slope_of(law, I)) for x, I in zip(labels, at, strict=True)]
    return np.array(times), at - R0 - mass


def arrival(law, q, amplitude):
    """Return the time in which q on a characteristic grows to an amplitude where I is constant, R(0) ∫ R/q² dq."""
    found = quad(lambda v: float(law.R(np.exp(v))) * np.exp(-v), np.log(q), np.log(amplitude))
    return float(law.R(0.0)) * found[0]
