"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from hjprofile.interrupts import undone


def write_whole(path: Path, data: bytes | str) -> None:
    """Write next to `path` and then replace it, so that half a file is never visible."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.urandom(4).hex()}")
    with undone(lambda: partial.unlink(missing_ok=True)):
        try:
            with open(partial, "xb") as stream:
                stream.write(data.encode() if isinstance(data, str) else data)
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(partial, 0o644)
            os.replace(partial, path)
        except BaseException as error:
            with suppress(OSError):
                partial.unlink()
            if isinstance(error, OSError):
                error.filename = str(path)  # the error of a full disk names no file
            raise
