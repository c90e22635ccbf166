"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from hjprofile.interrupts import undone


def write_whole(path: Path, data: bytes | str) -> None:
    """Writes beside `path` and then replaces it, so that nobody ever sees half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.urandom(4).hex()}")
    with undone(lambda: beside.unlink(missing_ok=True)):
        try:
            with open(beside, "xb") as stream:
                stream.write(data.encode() if isinstance(data, str) else data)
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(beside, 0o644)
            os.replace(beside, path)
        except BaseException as error:
            with suppress(OSError):
                beside.unlink()
            if isinstance(error, OSError):
                error.filename = str(path)  # a full disk does not say where
            raise
