"""Compiled loops on disk: taken from there only if no source has changed since, and as they were written."""

import hashlib
import pickle
import sys
from contextlib import suppress
from pathlib import Path

import numba
from numba.core.caching import FunctionCache
from numba.core.serialize import dumps

from hjprofile.files import write_whole


def _sources():
    """A digest of all that compiled code is made from: every kernel, and what compiles them.

    All of them, because a kernel contains the functions that it calls, of whichever file.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.parent.rglob("kernels/*.py")):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


SOURCES = _sources()


class KernelCache(FunctionCache):
    """numba's cache of a function, with files of our own.

    numba looks only at the file that a function is in for changes, and gives what it reads to LLVM unseen, though half
    of it may be lost. Raises RuntimeError if there is no place to write to.
    """

    def __init__(self, function):
        super().__init__(function)
        self._cache_file = _Files(Path(self.cache_path), f"{function.__module__}.{function.__qualname__}")

    def save_overload(self, sig, data):
        """A disk that is full costs the next process a compilation, and this one nothing."""
        with suppress(OSError):
            super().save_overload(sig, data)


class _Files:
    """One file for each signature: a digest of the sources and of what follows, which is a key and compiled code.

    Its name stays when sources change, so that what is stale is overwritten.
    """

    def __init__(self, folder, name):
        self.folder, self.name = folder, f"{name.rpartition('kernels.')[2]}.{sys.implementation.cache_tag}"

    def load(self, key):
        """The compiled code; None where there is none that can be trusted."""
        try:
            data = self._path(key).read_bytes()
        except OSError:
            return None
        body = data[32:]
        if data[:32] != _digest(body):
            return None
        written_for, code = pickle.loads(body)
        return code if written_for == key else None

    def save(self, key, code):
        """Raises OSError."""
        body = dumps((key, code))
        write_whole(self._path(key), _digest(body) + body)

    def _path(self, key):
        signature, target, _ = key
        name = hashlib.sha256(repr((signature, target)).encode()).hexdigest()[:16]
        return self.folder / f"{self.name}.{name}.kernel"


def _digest(body):
    return hashlib.sha256(SOURCES + body).digest()
