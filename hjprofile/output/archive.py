"""Archives of arrays and text in one file, with a digest that detects damage."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hjprofile.solvers.run import Array

_DIGEST = "digest"


def pack(arrays: Mapping[str, Array]) -> bytes:
    """Return the content of an archive. Reading it runs no code."""
    buffer = io.BytesIO()
    np.savez(buffer, **{**arrays, _DIGEST: np.array(_digest(arrays))})  # type: ignore[arg-type]
    return buffer.getvalue()


def unpack(path: Path) -> dict[str, Array]:
    """Return name -> array of an archive. Raise FileNotFoundError, and ValueError if it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if str(arrays.pop(_DIGEST)) == _digest(arrays):
            return arrays
        reason = "other arrays than were written"
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged file raises any of many types, of zipfile, zlib and numpy
        reason = type(error).__name__
    raise ValueError(reason)


def _digest(arrays: Mapping[str, Array]) -> str:
    """Return a hash of names, types, shapes and values."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
