"""Checkpoints from which an interrupted run is resumed, bit for bit."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.files import write_whole
from hjprofile.interrupts import answered
from hjprofile.output.archive import pack, unpack
from hjprofile.solvers.run import Array

NAME = "checkpoint.npz"


class Checkpoint:
    """The checkpoint of a run: `checkpoint.npz` in its folder, written every `interval` seconds and at an interruption.

    It holds arrays and text only: reading it runs no code. With `resume` a run is resumed from the existing file.
    """

    def __init__(self, folder: Path, interval: float, resume: bool, claim: Callable[[str], None] = lambda name: None):
        """Prepare the checkpoint, which calls `claim` with its name before it is written."""
        self.path, self.interval, self.resume, self.claim = folder / NAME, interval, resume, claim
        self.resumed_at: float | None = None  # the time t from which the run was resumed
        self.heeding, self.asked = ExitStack(), False

    def __enter__(self) -> Checkpoint:
        self.last = time.monotonic()
        self.started = False
        return self

    def __exit__(self, *error: Any) -> None:
        self.heeding.close()

    def _ask(self, *_: Any) -> None:
        self.asked = True  # the state is complete only between two batches of time steps

    def recall(self, identity: Mapping[str, Any]) -> Mapping[str, Array] | None:
        """Return the stored state to resume from, else None.

        Raise InputError if it is damaged, or if it belongs to another run.
        """
        self.identity = dict(_flat(identity))
        if not self.resume:
            self.discard()
            return None
        try:
            stored = unpack(self.path)
            theirs = json.loads(str(stored.pop("identity")))
            self.resumed_at = float(stored["pace.t"])
        except FileNotFoundError:
            return None
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise InputError(
                f"{self.path} is damaged ({error}); run without --resume to start again", about="a-checkpoint"
            ) from None
        for key in self.identity | theirs:
            mine, kept = self.identity.get(key), theirs.get(key)
            if mine != kept:
                what = (
                    "the data that the case names have changed"
                    if key == "data"
                    else f"{key} = {kept} there, {mine} here"
                )
                raise InputError(
                    f"{self.path} is of another run: {what}; run without --resume to start again", about="a-checkpoint"
                )
        return stored

    def due(self) -> bool:
        """Return True if the interval has passed, or if the run was interrupted."""
        if not self.started:  # before the first time steps there is no state, and compilation takes long
            self.started = True
            self.heeding.enter_context(answered(self._ask))
        return self.asked or time.monotonic() - self.last >= self.interval

    def keep(self, t: float, memory: Mapping[str, Array]) -> None:
        """Write the state at t. Then raise RunError if the run was interrupted."""
        self.claim(NAME)
        write_whole(self.path, pack({**memory, "identity": np.array(json.dumps(self.identity))}))
        self.last = time.monotonic()
        if self.asked:
            raise RunError(
                f"interrupted at t = {t:.6g}; the state is saved in {self.path}; --resume continues from it",
                about="interrupted",
            )

    def discard(self) -> None:
        """Remove the checkpoint: the run has ended, or starts from t = 0."""
        self.path.unlink(missing_ok=True)


def _flat(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Return the entries of nested tables by dotted keys, with the types of JSON."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", json.loads(json.dumps(value))
