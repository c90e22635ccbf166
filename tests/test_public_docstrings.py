"""The docstrings of public functions and classes: their examples run and print what they state."""

import doctest
import sys

import pytest

import hjprofile

PUBLIC = [name for name in hjprofile.__all__ if name != "__version__"]
# shown by the examples of functions
RETURNED = {"Comparison", "Calibration", "Consistency", "Dependence", "Run", "Stability", "Statements"}
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.mark.parametrize("name", PUBLIC)
def test_examples(name, in_tmp):
    """Every public function and class has an example; lines with `# doctest: +SKIP`, which take seconds, do not run.

    Examples of methods run too.
    """
    found = getattr(hjprofile, name)
    tests = doctest.DocTestFinder().find(found, name, module=sys.modules[found.__module__])
    runner, report = doctest.DocTestRunner(optionflags=FLAGS), list[str]()
    for test in tests:
        runner.run(test, out=report.append)
    assert runner.failures == 0, "".join(report)
    assert name in RETURNED or any(test.examples for test in tests)
