"""Random slopes under random laws: kinks, bumps, pieces with fans, surveys, steady slopes, functions."""

import numpy as np
from random_profiles import random_bumps, random_pieces

import hjprofile as hj


def random_law(rng):
    match rng.integers(0, 5):
        case 0:
            return hj.log()
        case 1:
            return hj.power(float(rng.uniform(0.2, 3.0)))
        case 2:
            a, b = rng.uniform(0.2, 2.0, 2)
            return hj.expression(f"{a:.3g}*log1p(q) + {b:.3g}*q/(1+q)")
    return hj.rational()


def random_kinks(rng, law):
    x = np.sort(rng.uniform(-9.0, -0.3, int(rng.integers(1, 8))))
    amplitudes: list[float] = []
    for gap in np.diff(x, prepend=x[0]):
        met = float(law.decay(amplitudes[-1], gap)) if amplitudes else 0.0
        amplitudes.append(met + float(rng.uniform(0.1, 2.0)))
    return hj.kinks(x, amplitudes)


def random_survey(rng):
    """Straight pieces, some steeper than critical and some gentler."""
    n = int(rng.integers(10, 60))
    edges = np.cumsum(np.append(0.0, rng.uniform(0.05, 0.4, n)))
    return hj.steps(edges - edges[-1], np.clip(rng.normal(0.0, 0.4, n), -0.8, 2.0))


def random_function(rng):
    """A smooth rise or hollow with tails, of which only u(x) is known."""
    a, centre, width = rng.uniform(-0.4, 1.5), rng.uniform(-6.0, -2.0), rng.uniform(0.3, 1.0)
    return hj.profile(lambda x: x + a * width * np.tanh((x - centre) / width))


def random_scene(rng):
    """A problem; one in nine is a function, one a steady slope."""
    law = random_law(rng)
    match rng.integers(0, 9):
        case 0:
            profile = random_kinks(rng, law)
        case 1 | 2 | 3:
            profile = random_bumps(rng)
        case 4 | 5:
            profile = random_pieces(rng)
        case 6:
            profile = random_survey(rng)
        case 7:
            profile = random_function(rng)
        case _:
            kink = None if rng.random() < 0.3 else float(rng.uniform(-3.0, -0.3))
            profile = hj.steady(float(rng.uniform(0.1, 0.6)), kink) if law.name == "rational" else random_survey(rng)
    return hj.Problem(law, profile, end=float(rng.uniform(0.2, 4.0)), snapshots=11)


def grid_of(problem, cells=1000):
    """A grid that cuts nothing off; a flux enters on one of length 3."""
    return hj.Grid(-3.0, cells) if problem.profile.inflow else problem.profile.grid(cells, tail=1e-11)
