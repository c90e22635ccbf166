"""Cache of compiled loops on disk, valid only for unchanged sources and undamaged files."""

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
    """Return a digest of all sources of compiled code: every kernel, and the modules that compile them.

    All kernels are included because a kernel contains the functions that it calls, from any file.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.parent.rglob("kernels/*.py")):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


SOURCES = _sources()


class KernelCache(FunctionCache):
    """The cache of numba for one function, with files in a format of this package.

    numba itself detects changes only in the file of the function, and passes the file that it reads to LLVM without a
    check, although half of it may be lost. The constructor raises RuntimeError if no folder can be written.
    """

    def __init__(self, function):
        super().__init__(function)
        self._cache_file = _Files(Path(self.cache_path), f"{function.__module__}.{function.__qualname__}")

    def save_overload(self, sig, data):
        """Write compiled code; ignore a full disk, which costs only a compilation in the next process."""
        with suppress(OSError):
            super().save_overload(sig, data)


class _Files:
    """One file for each signature: a digest of the sources and of the content, then a key and compiled code.

    The name of the file does not depend on the sources, so a stale file is overwritten.
    """

    def __init__(self, folder, name):
        self.folder, self.name = folder, f"{name.rpartition('kernels.')[2]}.{sys.implementation.cache_tag}"

    def load(self, key):
        """Return the compiled code, or None if no file exists or if it is stale or damaged."""
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
        """Write the compiled code; raise OSError if that fails."""
        body = dumps((key, code))
        write_whole(self._path(key), _digest(body) + body)

    def _path(self, key):
        signature, target, _ = key
        name = hashlib.sha256(repr((signature, target)).encode()).hexdigest()[:16]
        return self.folder / f"{self.name}.{name}.kernel"


def _digest(body):
    """Return the digest of the sources and of the content of a file."""
    return hashlib.sha256(SOURCES + body).digest()
