"""A run that was stopped goes on from its checkpoint, bit for bit."""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

import hjprofile
from hjprofile.errors import InputError, RunError
from hjprofile.files import write_whole
from hjprofile.interrupts import answered
from hjprofile.solvers.run import Array

NAME = "checkpoint.npz"


class Checkpoint:
    """Keeps the state of a run in `checkpoint.npz` of its folder, every `interval` seconds and when asked to stop.

    Arrays and text only: reading one runs no code. With `resume` a run goes on from the one that is there.
    """

    def __init__(self, folder: Path, interval: float, resume: bool):
        self.path, self.interval, self.resume = folder / NAME, interval, resume
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
        self.identity = dict(_flat({**identity, "hjprofile": hjprofile.__version__}))
        if not self.resume:
            self.discard()
            return None
        try:
            with np.load(self.path, allow_pickle=False) as file:
                stored = {name: file[name] for name in file.files}
            theirs = json.loads(str(stored.pop("identity")))
            self.resumed_at = float(stored["pace.t"])
        except FileNotFoundError:
            return None
        except (
            OSError,
            ValueError,
            LookupError,
            TypeError,
            zipfile.BadZipFile,
            EOFError,
            NotImplementedError,
        ) as error:
            raise InputError(
                f"{self.path} is damaged ({type(error).__name__}); run without --resume to start anew",
                about="a-checkpoint",
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
                    f"{self.path} is of another run: {what}; run without --resume to start anew", about="a-checkpoint"
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
        buffer = io.BytesIO()
        np.savez(buffer, **{**memory, "identity": np.array(json.dumps(self.identity))})  # type: ignore[arg-type]
        write_whole(self.path, buffer.getvalue())
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
