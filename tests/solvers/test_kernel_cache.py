"""Compiled loops on disk: an edit of one is an edit of all, what is damaged is compiled anew; and loops by Python."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.solvers.kernels import compiled, disk_cache

LOOP = """
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.probed import by_kind, constant, helper, inside

@compiled
def loop(x):
    return helper(x) + by_kind(x) + inside(x) + constant
"""
PROBED = """
from hjprofile.solvers.kernels import by_type, compiled, inner

constant = {constant}

@compiled
def helper(x):
    return {helper} * x

@inner
def inside(x):
    return {inside} * x

@by_type
def by_kind(x):
    return lambda x: {by_kind} * x
"""
ASK = (
    "from hjprofile.solvers.kernels.probe import loop\n"
    "print(loop(1.0), sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))"
)


class Copy:
    """A copy of the package with two kernels more, of which one is compiled into the other."""

    def __init__(self, folder, writable=True):
        home = folder / "copy" / "hjprofile"
        shutil.copytree(Path(hj.__file__).parent, home, ignore=shutil.ignore_patterns("__pycache__"))
        self.kernels, self.folder = home / "solvers" / "kernels", home.parent
        (self.kernels / "probe.py").write_text(LOOP)
        self.edit()
        self.cache = self.kernels / "__pycache__"
        if not writable:
            self.cache.write_text("not a folder")  # root may write anywhere
            self.cache = folder / "user"
        self.environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
        self.environment["XDG_CACHE_HOME"] = str(folder / "user")

    def edit(self, constant=1.0, helper=1.0, by_kind=1.0, inside=1.0):
        (self.kernels / "probed.py").write_text(
            PROBED.format(constant=constant, helper=helper, by_kind=by_kind, inside=inside)
        )

    def ask(self):
        """What the loop returns, and whether it was compiled for it: loads, compilations."""
        # -B: Python itself takes a file of the same size and second for the same
        done = subprocess.run([sys.executable, "-B", "-c", ASK], env=self.environment, cwd=self.folder, stdout=PIPE)
        value, hits, misses = done.stdout.split()
        return float(value), int(hits), int(misses)

    def files(self):
        return sorted(self.cache.rglob("*.kernel"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="where the user-wide cache is")
@pytest.mark.parametrize("writable", [True, False], ids=["in the package", "user-wide"])
def test_an_edited_kernel_is_the_kernel_that_runs(tmp_path, writable):
    """Whether a function, one without a file, one chosen by type or a constant has changed, or a file is damaged."""
    copy = Copy(tmp_path, writable)
    assert copy.ask() == (4.0, 0, 1)
    files = copy.files()
    assert len(files) == 2
    edits = {"helper": 2.0, "by_kind": 3.0, "inside": 5.0} if writable else {"constant": 6.0}
    for name, value in edits.items():
        copy.edit(**{name: value})
        assert copy.ask() == (value + 3.0, 0, 1)
    assert copy.files() == files  # what is stale is overwritten
    if writable:
        helper, loop = files
        helper.write_bytes(helper.read_bytes()[:-100])  # cut off
        loop.write_bytes(loop.read_bytes()[:40] + bytes(5000))  # blocks that were never written
        assert copy.ask() == (value + 3.0, 0, 1)
    assert copy.ask() == (value + 3.0, 1, 0)


@pytest.fixture
def stored(tmp_path):
    """A file as the cache writes it, and what reads it."""
    files = disk_cache._Files(tmp_path, "hjprofile.solvers.kernels.probe.loop")
    files.save(("signature", "target", "code"), (b"machine code", 17))
    (path,) = tmp_path.iterdir()
    return path, lambda code="code": files.load(("signature", "target", code))


def test_no_byte_may_be_lost_or_changed(stored):
    path, load = stored
    whole = path.read_bytes()
    assert load() == (b"machine code", 17) and load("edited") is None
    for i in range(len(whole)):
        path.write_bytes(whole[:i])
        assert load() is None
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        assert load() is None
    path.write_bytes(whole + b"\0")
    assert load() is None
    path.unlink()
    assert load() is None
    path.mkdir()
    assert load() is None


def test_other_sources_are_another_cache(stored, monkeypatch):
    monkeypatch.setattr(disk_cache, "SOURCES", bytes(32))
    assert stored[1]() is None


def test_a_full_disk_stops_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(disk_cache, "write_whole", full)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    twice = compiled(lambda x: 2.0 * x)
    assert twice(1.5) == 3.0 and not list(tmp_path.rglob("*.kernel"))


def test_no_place_for_a_cache_stops_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    for name in ("UserProvidedCacheLocator", "InTreeCacheLocator", "UserWideCacheLocator"):
        locator = getattr(disk_cache.numba.core.caching, name, None)
        if locator:
            monkeypatch.setattr(locator, "get_cache_path", lambda self: str(tmp_path / "file" / "cache"))
    assert compiled(lambda x: 3.0 * x)(1.5) == 4.5


RUNS = """
import hjprofile as hj
kinks = hj.kinks([-1.0], [0.5])
grid = hj.Grid(-2.0, 24)
rational, log = (hj.Problem(law, kinks, end=0.1, snapshots=2) for law in (hj.rational(), hj.log()))
runs = [
    hj.solve_hj(rational, grid),
    hj.solve_hj(log, grid, method="godunov"),
    hj.solve_hj(rational, grid, method="weno5"),
    hj.solve_conservative(log, grid),
    hj.track_fronts(rational, grid, fronts=50),
    hj.solve_characteristics(log, grid),
]
"""


def test_without_a_compiler_python_computes_the_same(tmp_path):
    """NUMBA_DISABLE_JIT=1, under which a division by zero is one of Python's. Products and sums may be rounded once."""
    save = f"import numpy; numpy.savez({str(tmp_path / 'runs')!r}, *[run.u for run in runs])"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-W", "error", "-c", RUNS + save], env=environment, check=True)
    compiled_ones: dict = {}
    exec(RUNS, compiled_ones)
    with np.load(tmp_path / "runs.npz") as by_python:
        for run, u in zip(compiled_ones["runs"], by_python.values(), strict=True):
            assert np.abs(run.u - u).max() <= 2e-15  # ten roundings of u <= 2
