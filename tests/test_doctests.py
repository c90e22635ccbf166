"""Examples in the docstrings of public names run and print what they show."""

import doctest

import pytest

import hjprofile as hj

FINDER = doctest.DocTestFinder(exclude_empty=True)
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
EXAMPLES = {
    test.name: test
    for name in hj.__all__
    for test in FINDER.find(getattr(hj, name), f"hjprofile.{name}", module=False, globs={})
    if test.examples
}
WITH_EXAMPLES = {  # the functions that solve a problem or study solutions
    "solve", "solve_case", "solve_characteristics", "solve_conservative", "solve_hj", "track_fronts", "compare",
    "observed_order", "fit", "chart", "check", "check_consistency", "slow_erosion",
}  # fmt: skip


def test_public_functions_have_examples():
    assert {f"hjprofile.{name}" for name in WITH_EXAMPLES} <= EXAMPLES.keys()


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_an_example_prints_what_it_shows(name, tmp_path, monkeypatch):
    """In a folder of its own; lines with `# doctest: +SKIP`, which take seconds, are left out."""
    monkeypatch.chdir(tmp_path)
    report: list[str] = []
    outcome = doctest.DocTestRunner(optionflags=FLAGS).run(EXAMPLES[name], out=report.append)
    assert outcome.failed == 0, "".join(report)
