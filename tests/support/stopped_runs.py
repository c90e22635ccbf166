"""Cases that are stopped by a signal, and all that a run has to repeat after it is resumed."""

import os
import signal
from pathlib import Path

from hjprofile.problem.case import parse_case

CONTENT = {
    "title": "Two kinks",
    "erosion": {"law": "log"},
    "profile": {"kind": "kinks", "positions": [-7.0, -5.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -10.0, "cells": 400},
    "time": {"end": 4.0, "snapshots": 7},
    "output": {"vtk": False, "plots": False, "checkpoint": 1e-9},
}


def case_of(method, **changes):
    """CONTENT by a method, with other values of `section__key` or other tables of `section`."""
    content = {section: dict(v) if isinstance(v, dict) else v for section, v in CONTENT.items()}
    content["solver"] = {"method": method}
    for key, value in changes.items():
        section, _, name = key.partition("__")
        if name:
            content.setdefault(section, {})[name] = value
        else:
            content[section] = value
    return parse_case(content, "scene", "scene.toml", Path())


class Stop:
    """Asks a checkpoint to stop after so many lots of steps, of which the first two are the start and a first lot."""

    def __init__(self, keeper, lots):
        self.keeper, self.left = keeper, lots

    def __call__(self, fraction):
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGTERM)


def fingerprint(run):
    arrays = [getattr(run, name).tobytes() for name in ("time", "u", "q", "K")]
    lists = [str(found) for found in (run.kinks, run.vertical_steps, run.events, run.bounds)]
    return [*arrays, *lists, run.steps, run.step_range, run.status]
