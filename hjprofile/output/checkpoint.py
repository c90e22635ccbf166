"""A run that was stopped goes on from its checkpoint, bit for bit."""

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
    """Keeps the state of a run in `checkpoint.npz` of its folder, every `interval` seconds and when asked to stop.

    Arrays and text only: reading one runs no code. With `resume` a run goes on from the one that is there.
    """

    def __init__(self, folder: Path, interval: float, resume: bool, claim: Callable[[str], None] = lambda name: None):
        """Prepare a keeper, which calls `claim` with the name of the checkpoint before it writes one."""
        self.path, self.interval, self.resume, self.claim = folder / NAME, interval, resume, claim
        self.resumed_at: float | None = None  # the time t from which the run went on
        self.heeding, self.asked = ExitStack(), False

    def __enter__(self) -> Checkpoint:
        self.last = time.monotonic()
        self.started = False
        return self

    def __exit__(self, *error: Any) -> None:
        self.heeding.close()

    def _ask(self, *_: Any) -> None:
        self.asked = True  # between two lots of steps the state is whole

    def recall(self, identity: Mapping[str, Any]) -> Mapping[str, Array] | None:
        """Raises InputError if there is a checkpoint to go on from that is damaged, or of another run."""
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
        """Also when the run was asked to stop."""
        if not self.started:  # before the first steps are done there is nothing to keep, and much to compile
            self.started = True
            self.heeding.enter_context(answered(self._ask))
        return self.asked or time.monotonic() - self.last >= self.interval

    def keep(self, t: float, memory: Mapping[str, Array]) -> None:
        """Raises RunError, when all is kept, if the run was asked to stop."""
        self.claim(NAME)
        write_whole(self.path, pack({**memory, "identity": np.array(json.dumps(self.identity))}))
        self.last = time.monotonic()
        if self.asked:
            raise RunError(
                f"interrupted at t = {t:.6g}; the run is kept in {self.path}, and --resume goes on from there",
                about="interrupted",
            )

    def discard(self) -> None:
        """Removes the checkpoint: the run has ended, or starts anew."""
        self.path.unlink(missing_ok=True)


def _flat(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Entries of nested tables by dotted keys, as JSON would give them back."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", json.loads(json.dumps(value))
