"""Random admissible profiles: sums of bumps, and pieces with steps, slopes and corners."""

import numpy as np

import hjprofile as hj


def random_bumps(rng):
    while True:
        n = rng.integers(1, 6)
        amplitudes = rng.uniform(-0.95, 6.0, n) * rng.choice([0.1, 0.3, 1.0], n)
        try:
            return hj.bumps(amplitudes, rng.uniform(-8.0, -1.0, n), rng.uniform(0.2, 1.0, n))
        except hj.InputError:  # q <= -1 where bumps add up
            continue


def random_pieces(rng):
    n = rng.integers(2, 8)
    x = np.sort(rng.uniform(-9.0, -0.2, n + 1))
    if np.diff(x).min() < 0.05:
        return random_pieces(rng)

    def q():
        return float(rng.uniform(-0.95, 6.0) * rng.choice([0.1, 1.0]))

    if rng.random() < 0.5:
        return hj.steps(x, [q() for _ in range(n)])
    places, values = [x[0]], [0.0 if rng.random() < 0.5 else q()]
    for at in x[1:]:
        places.append(at)
        values.append(q())
        if at != x[-1] and rng.random() < 0.4:
            places.append(at)
            values.append(q())
    return hj.points(places, values)


def random_pair(rng, law, grid):
    """Return the cell means of two random slopes, unlike or close, whose K span a few decades at most."""
    make = random_bumps if rng.random() < 0.5 else random_pieces
    q, p = (make(rng).q_means(grid, law) for _ in range(2))
    share = rng.choice([1.0, 0.1, 0.01])  # of the way from q to p
    size = rng.choice([0.15, 0.4])  # of slopes up to 6
    return size * q, size * (q + share * (p - q))


def from_means(law, grid, q, end):
    """Return a problem with these cell means at t = 0, and nine saved times."""
    W = np.append(0.0, grid.dx * np.cumsum(q))
    return hj.Problem(law, hj.profile(lambda x: x + np.interp(x, grid.nodes, W)), end=end, snapshots=9)
