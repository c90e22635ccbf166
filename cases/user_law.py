"""An erosion law of one's own: any increasing, concave f with f(0) = 0 that falls to -infinity at q = -1."""

import numpy as np


def f(q):
    return np.sqrt(1 + q) - 1 / np.sqrt(1 + q)
