"""The journal of a solution by fronts: its events, the integrals of its fluxes, and counts."""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import compiled

# Kinds of events, and their names: a blow-up is a kink's, at which it becomes a vertical step
BIRTH, MERGE, EXIT, BLOW_UP = range(4)
EVENTS = ("birth", "merge", "exit", "blow-up")
GROWTH, CREST_LOWERING = 0, 1  # entries of `totals`
STEPS, HIGHEST_LABEL, LOGGED = range(3)  # entries of `counts`


class Journal(NamedTuple):
    """What loops that advance fronts write down.

    Each of these loops is advance(fronts, n, t, end, control, .., journal). It returns the number of fronts that are
    left and whether they have arrived at the time `end`: they stop on the way where time steps become too small.

    Attributes:
        log: rows (t, kind of event, kink, into, x); `into` is the kink that lives on after a merge, otherwise 0.
        totals: ∫(K_left - 1) dt and ∫F(0) dt, by GROWTH and CREST_LOWERING.
        counts: integers: the time steps, the highest label and the rows logged, by STEPS, HIGHEST_LABEL and LOGGED.
    """

    log: np.ndarray
    totals: np.ndarray
    counts: np.ndarray


@compiled
def note(journal, t, kind, kink, into, x):
    """Add a row to the log if there is room."""
    log, row = journal.log, journal.counts[LOGGED]
    if row < log.shape[0]:
        log[row, 0], log[row, 1], log[row, 2], log[row, 3], log[row, 4] = t, kind, kink, into, x
        journal.counts[LOGGED] = row + 1


@compiled
def new_label(journal):
    """Return the next label of a kink."""
    journal.counts[HIGHEST_LABEL] += 1
    return journal.counts[HIGHEST_LABEL]
