"""Journal of a solution by fronts: events, integrals of fluxes, and counts."""

from typing import NamedTuple

import numpy as np

from hjprofile.solvers.kernels import inner

# Kinds of events, and their names. At a blow-up a kink becomes a vertical step.
BIRTH, MERGE, EXIT, BLOW_UP = range(4)
EVENTS = ("birth", "merge", "exit", "blow-up")
TOE_GAIN, CREST_LOWERING = 0, 1  # entries of `totals`
STEPS, HIGHEST_LABEL, LOGGED = range(3)  # entries of `counts`


class Journal(NamedTuple):
    """Records of the loops that advance fronts.

    Each of these loops is advance(fronts, n, t, end, control, .., journal). It returns the remaining number of fronts,
    and True if the fronts have reached the time `end`. A loop stops earlier if time steps become too small.

    Attributes:
        log: rows (t, kind of event, kink, into, x); `into` is the label of the surviving kink of a merge, otherwise 0.
        totals: ∫(K_left - 1) dt, which is the outflow at the toe less the supply, and ∫F(0) dt; indexed by TOE_GAIN and
            CREST_LOWERING.
        counts: integers: the time steps, the highest label and the rows logged, indexed by STEPS, HIGHEST_LABEL and
            LOGGED.
    """

    log: np.ndarray
    totals: np.ndarray
    counts: np.ndarray


@inner
def note(journal, t, kind, kink, into, x):
    """Add a row to the log unless the log is full."""
    log, row = journal.log, journal.counts[LOGGED]
    if row < log.shape[0]:
        log[row, 0], log[row, 1], log[row, 2], log[row, 3], log[row, 4] = t, kind, kink, into, x
        journal.counts[LOGGED] = row + 1


@inner
def new_label(journal):
    """Return the next label of a kink."""
    journal.counts[HIGHEST_LABEL] += 1
    return journal.counts[HIGHEST_LABEL]
