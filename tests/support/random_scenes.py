"""Random slopes under random laws, of ordinary and of unusual scales, and the same problems in other units."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from random_profiles import random_bumps, random_pieces

import hjprofile as hj
from hjprofile.solvers.data_resolution import fine_sample


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


KINDS = "bumps", "signs", "narrow-wide", "wide", "crowd", "points", "steps"
MOST_FOLDS = 8.0  # largest ∫|f(q)| dx, which bounds |ln K|

SMALL = 1e-3  # factor of q with which a profile is surely admissible


def unusual_scene(rng):
    """Return a problem of unusual scales, and a grid. The first word of the title is one of KINDS.

    Widths are 1e-3 to 1, or 10 to 500 with small amplitudes; positions reach -1000; f has the scale 1e-3 to 1e3. The
    end is a multiple of a time in which the slope changes.
    """
    law, scale = _unusual_law(rng)
    kind = str(rng.choice(KINDS))
    make, widths = _unusual_points(rng, kind) if kind in ("points", "steps") else _unusual_bumps(rng, kind)
    most = _log_uniform(rng, 0.3, MOST_FOLDS)
    small = fine_sample(problem := hj.Problem(law, make(SMALL), end=1.0), min(problem.profile.start(1e-14), -1e-3))
    shrink = 1.0
    while True:
        q = shrink / SMALL * small.q
        if q.min() > -0.99 and np.abs(law.f(q)) @ np.diff(small.x) < most:
            with suppress(hj.InputError):  # q <= -1 between the positions of the sample
                problem = hj.Problem(law, make(shrink), end=1.0)
                break
        shrink *= 0.7
    sample = small._replace(q=q)
    times = _times(law, sample, widths, scale)
    end = float(min(times[rng.integers(0, len(times))] * _log_uniform(rng, 0.2, 5.0), 1.2 * times[-1]))
    snapshots = [0.0, end] if rng.random() < 0.7 else np.sort(rng.uniform(0.0, end, int(rng.integers(2, 6)))).tolist()
    title = f"{kind}, {widths.size} features, widths {widths.min():.2g} to {widths.max():.2g}, f'(0) = {scale:.2g}"
    problem = replace(problem, end=end, snapshots=snapshots, title=title)
    return problem, problem.profile.grid(int(rng.choice([200, 400, 1000, 2000])), tail=1e-12)


def twin(problem, ratio):
    """Return the same problem in other units: x, u and widths times `ratio`, t times its square, f over it."""
    table = problem.law.table
    match table["law"]:
        case "rational":
            text = "q/(1+q)"
        case "log":
            text = "log1p(q)"
        case "power":
            text = f"-expm1(-{table['m']!r}*log1p(q))/{table['m']!r}"
        case _:
            text = table["expression"]
    times = [float(t) * ratio**2 for t in problem.times]
    law = hj.expression(f"({text})/{ratio!r}", growth=table.get("growth"))
    return replace(
        problem, law=law, profile=_twin_profile(problem.profile, ratio),
        end=problem.end * ratio**2, snapshots=times,
    )  # fmt: skip


def twin_grid(grid, ratio):
    """Return the grid of the twin problem."""
    return hj.Grid(grid.left * ratio, grid.cells)


def _twin_profile(profile, ratio):
    table = dict(profile.table)
    kind = table.pop("kind")
    lengths = {"kinks": ("positions",), "bumps": ("centres", "widths"), "points": ("x",), "steps": ("edges",)}[kind]
    return getattr(hj, kind)(**table | {name: (ratio * np.array(table[name])).tolist() for name in lengths})


def _log_uniform(rng, low, high, size=None):
    value = np.exp(rng.uniform(np.log(low), np.log(high), size))
    return float(value) if size is None else value


def _unusual_law(rng):
    """Return a law and its f'(0)."""
    if rng.random() < 0.6:
        scale = _log_uniform(rng, 1e-3, 1e3)
        return hj.expression(f"{scale:.4g}*q/(1+q)"), scale
    law = [hj.rational(), hj.log(), hj.power(float(rng.uniform(0.2, 3.0)))][rng.integers(0, 3)]
    return law, 1.0


def _amplitudes(rng, n, most=10.0, both=True):
    """Return values of q of both signs and of all sizes from 1e-3 of the largest."""
    negative = rng.random(n) < (0.35 if both else 0.0)
    return np.where(
        negative, -_log_uniform(rng, 1e-3 * min(most, 1.0), 0.95 * min(most, 1.0), n),
        _log_uniform(rng, 1e-3 * most, most, n),
    )  # fmt: skip


def _features(rng):
    return int(np.exp(rng.uniform(0.0, np.log(61.0))))


def _unusual_bumps(rng, kind):
    """Return a function of a factor of the amplitudes that makes bumps, and their widths."""
    n = _features(rng)
    most = 10.0
    if kind == "narrow-wide":
        n = max(n, 2)
        widths = np.append(_log_uniform(rng, 1e-3, 3e-2, n - 1), _log_uniform(rng, 0.3, 3.0))
    elif kind == "wide":
        widths, most = _log_uniform(rng, 10.0, 500.0, n), 1e-2
    elif kind == "crowd":
        n = int(rng.integers(30, 61))
        widths = np.full(n, _log_uniform(rng, 1e-3, 1.0))
    else:
        widths = _log_uniform(rng, 1e-3, 1.0, n)
    a = _amplitudes(rng, n, most, kind != "bumps")
    far = _log_uniform(rng, 0.1, 1000.0)
    reach = far if rng.random() < 0.5 else min(far, float(widths.sum() * rng.uniform(0.2, 3.0)))
    centres = -far + reach * rng.uniform(0.0, 1.0, n)
    if kind == "signs" and n > 1:  # each second one inside the one before it
        m = n // 2
        centres[1 : 2 * m : 2] = centres[: 2 * m : 2] + widths[: 2 * m : 2] * rng.uniform(-1.0, 1.0, m)
        widths[1 : 2 * m : 2] = widths[: 2 * m : 2] * rng.uniform(0.1, 1.0, m)
    return lambda shrink: hj.bumps(shrink * a, np.minimum(centres, 0.0), widths), widths


def _unusual_points(rng, kind):
    """Return a function of a factor of q that makes pieces, and their lengths."""
    n = _features(rng)
    lengths = _log_uniform(rng, 1e-3, 1.0, n)
    if rng.random() < 0.3:
        lengths[rng.integers(0, n)] = _log_uniform(rng, 1.0, 300.0)
    edges = np.append(0.0, np.cumsum(lengths))
    edges -= edges[-1] + (0.0 if rng.random() < 0.1 else _log_uniform(rng, 1e-2, 1000.0))
    if kind == "steps":
        values = _amplitudes(rng, n)
        return lambda shrink: hj.steps(edges, shrink * values), lengths
    twice = np.append(False, rng.random(n - 1) < 0.4)
    x = np.append(np.repeat(edges[:-1], 1 + twice), edges[-1])
    q = _amplitudes(rng, x.size)
    if rng.random() < 0.5:
        q[[0, -1]] = 0.0
    return lambda shrink: hj.points(x, shrink * q), lengths


def _times(law, sample, widths, scale):
    """Return times in which the slope changes: to cross a feature, to steepen, of the law, and to leave at x = 0."""
    h = np.diff(sample.x)
    g = law.f(sample.q) * h
    K = np.exp(np.cumsum(g[::-1])[::-1] - 0.5 * g)
    speed = K * law.derivative(sample.q)
    typical = float(np.median(widths))
    crossing = typical / float(np.average(speed, weights=np.abs(sample.q) * h + 1e-300))
    steepening = typical / max(float(np.ptp(speed)), 1e-3 * float(speed.max()))
    return crossing, steepening, 1.0 / scale**2, float(h @ (1.0 / speed))
