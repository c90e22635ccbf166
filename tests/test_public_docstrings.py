"""The docstrings of the public functions and classes: their examples run and print what they state."""

import doctest
import sys

import pytest

import hjprofile

PUBLIC = [name for name in hjprofile.__all__ if name != "__version__"]
WITH_EXAMPLES = ("hjprofile.errors", "hjprofile.problem", "hjprofile.output")  # every public name of these has one


@pytest.mark.parametrize("name", PUBLIC)
def test_examples(name):
    found = getattr(hjprofile, name)
    tests = doctest.DocTestFinder(recurse=False).find(found, name, module=sys.modules[found.__module__])
    runner = doctest.DocTestRunner()
    for test in tests:
        runner.run(test)
    assert runner.failures == 0
    assert any(test.examples for test in tests) or not found.__module__.startswith(WITH_EXAMPLES)
