"""The script of the mutation run: what it changes, what it leaves, and where it looks for tests."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = '''"""A docstring with 1 + 1."""

STEPS = 4


def f(a: int = 2, *, b: "list[int]" = ()) -> int:
    """Another with 2 < 3."""
    if a < 3 and not b:
        raise ValueError(f"{a + 1} of 3")
    a += 1
    total = max(a, 5) - a[0]
    return -total if total else total
'''


@pytest.fixture(scope="module")
def mutants():
    spec = importlib.util.spec_from_file_location("mutants", ROOT / "tests" / "benchmarks" / "mutants.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = module  # for its named tuple
    spec.loader.exec_module(module)
    return module


def test_every_kind_of_change_is_made_and_messages_stay(mutants):
    found = [(m.line, *m.lines(SOURCE)) for m in mutants.Sites("f.py", SOURCE).found]
    assert all(before != after for _, before, after in found)
    assert {line for line, _, _ in found} == {3, 6, 8, 9, 10, 11, 12}
    changes = {after for _, _, after in found}
    assert changes >= {
        "STEPS = (2 * 4)",
        "if a <= 3 and not b:",
        "if a < 3 or not b:",
        "if not (a < 3 and not b):",
        "pass",
        "a -= 1",
        "total = min(a, 5) - a[0]",
        "total = max(a, 5) + a[0]",
        "total = max(a, 5) - a[(0 + 1)]",
        "return -total if not (total) else total",
    }
    assert [after for line, _, after in found if line == 9] == ["pass"]  # a message is not changed


def test_draws_are_those_of_the_seed_and_can_be_parsed(mutants):
    scope = ["hjprofile/solvers/invariant.py", "hjprofile/studies/proved_constant.py"]
    draws = [list(mutants.drawn(scope, seed)) for seed in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2] and len(draws[0]) > 100
    for mutant in draws[0]:
        compile(mutants.changed(mutant), mutant.path, "exec")


def test_each_equivalent_mutant_is_one_of_the_present_source(mutants):
    """A row of the table names lines that are in its module, or in its function, and a change that is made of them."""
    rows, found = mutants.equivalent(), set()
    for path in {place.partition("::")[0] for place, _, _ in rows}:
        source = (ROOT / path).read_text(encoding="utf-8")
        for mutant in mutants.Sites(path, source).found:
            before, after = mutant.lines(source)
            if any(row[1:] == (before, after) for row in rows):
                found |= {(place, before, after) for place in mutants.places_of(mutant)}
    assert rows and not rows - found


def test_loops_that_contain_a_line_are_those_that_name_its_function(mutants):
    """A line of the decay under a law is in all that calls it, in any module, and in none that does not."""
    kernel = "hjprofile/solvers/kernels/law.py"
    lines = (ROOT / kernel).read_text(encoding="utf-8").splitlines()
    found = mutants.reaching(next(i for i, line in enumerate(lines, 1) if line.startswith("def law_decay")), kernel)
    assert {"law.law_decay", "law.start_pieces", "front_state.sweep", "front_state.speeds"} <= found
    assert not found & {"law.polynomial", "law.law_f", "layer_pass.layer_pass", "steps.sweep"}


@pytest.mark.parametrize(
    ("path", "folder", "first"),
    [
        ("hjprofile/studies/tracing.py", "tests/studies", "tests/studies/test_tracing.py"),
        ("hjprofile/solvers/fronts/front_data.py", "tests/fronts", "tests/fronts/test_fronts.py"),
        ("hjprofile/solvers/select.py", "tests/solvers", "tests/solvers/test_select.py"),
        ("hjprofile/solvers/kernels/law.py", "tests/solvers", None),
    ],
)
def test_the_tests_of_a_module_come_first(mutants, path, folder, first):
    near, rest = mutants.tests_of(path)
    assert {str(Path(test).parent) for test in near} == {folder} and near[0] == (first or near[0])
    every = {test.relative_to(ROOT).as_posix() for test in (ROOT / "tests").rglob("test_*.py")}
    assert {*near, *rest} == every and not {*near} & {*rest}
