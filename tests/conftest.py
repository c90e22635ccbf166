"""Shared by all tests."""

import numpy as np
import pytest

from hjprofile import cli
from hjprofile.cli import common

np.seterr(all="raise", under="ignore")  # a silent overflow or NaN in the library fails the test that meets it


@pytest.fixture(autouse=True)
def silent_compilation(monkeypatch):
    """Without this the first test of a method after an installation finds a line on stderr."""
    monkeypatch.setattr(common, "LONG_COMPILATION", float("inf"))


@pytest.fixture
def in_tmp(tmp_path, monkeypatch):
    """A working directory of one's own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def call(capsys, monkeypatch):
    """Runs a command in this process; exit code, stdout, stderr. No line of progress appears, however slow it is."""
    monkeypatch.setattr(common, "LINE_EVERY", float("inf"))

    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            cli.main([str(a) for a in arguments])
        return left.value.code, *capsys.readouterr()

    return call
