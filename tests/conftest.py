"""Shared by all tests."""

import numpy as np
import pytest

np.seterr(all="raise", under="ignore")  # a silent overflow or NaN in the library fails the test that meets it


@pytest.fixture
def in_tmp(tmp_path, monkeypatch):
    """A working directory of one's own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
