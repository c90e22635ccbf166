"""Random input, most of it bad: it is taken, or refused in one sentence, and at once; nothing else happens.

What is random comes from `random_inputs.py`. Hypothesis finds small examples of a fault, the slow study rare ones.
"""

import contextlib
import csv
import gc
import io
import json
import os
import random
import sys
import time
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from bad_cases import changed, with_files
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_inputs import random_case_file, random_expression, random_survey, small_run
from same_problem import same
from scipy.io import netcdf_file

from hjprofile.cli import main
from hjprofile.errors import InputError
from hjprofile.problem.case import load_case, parse_case, resolved_case
from hjprofile.problem.case_files import shipped_cases
from hjprofile.problem.erosion import expression

RANDOM = st.randoms(use_true_random=False)
LONGEST = 5.0  # seconds of this process for one input: the slowest takes 1.5 to 2.5, a hang would take for ever


def examples(count):
    """So many of Hypothesis's. What is slow to draw is so because a case has many values."""
    return settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the cases stand, with the files that they name."""
    folder = with_files(tmp_path_factory.mktemp("fuzz"))
    for name in ("hillslope.csv", "user_law.py"):
        (folder / name).write_bytes((shipped_cases()["hillslope"].parent / name).read_bytes())
    return folder


@contextlib.contextmanager
def at_once():
    started = time.process_time()
    yield
    assert time.process_time() - started < LONGEST


@contextlib.contextmanager
def small_machine():
    """16 MiB of memory, by what the operating system says, so that every grid that is taken is a small one."""
    sysconf, os.sysconf = os.sysconf, {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 4096}.__getitem__
    try:
        yield
    finally:
        os.sysconf = sysconf


def loads_or_is_refused(path):
    """Whether a case file is taken. Then it is a case that can be started, and its resolved form is that case."""
    with at_once(), small_machine():
        try:
            case = load_case(path)
        except InputError as error:
            assert all(str(fault).startswith(f"{path}: ") for fault in error.faults)
            assert len(str(error).splitlines()) == len(error.faults)
            return False
        q = case.problem.profile.q_means(case.grid, case.problem.law)
        assert np.all(np.isfinite(q) & (q > -1.0))
        times = case.problem.times
        assert np.all(np.diff(times) > 0) and 0 <= times[0] <= times[-1] <= case.problem.end
        text = tomli_w.dumps(
            resolved_case(case.problem, case.grid, case.method, case.cfl, case.tolerance, case.refresh)
        )
        again = parse_case(tomllib.loads(text), case.name, "resolved", path.parent)
        assert (again.grid, again.method, again.cfl, again.tolerance, again.refresh) == (
            case.grid, case.method, case.cfl, case.tolerance, case.refresh
        )  # fmt: skip
        same(again.problem, case.problem, case.grid)
    return True


@examples(100)
@given(RANDOM)
def test_any_case_file_loads_or_is_refused(folder, rng):
    (folder / "scene.toml").write_bytes(random_case_file(rng))
    loads_or_is_refused(folder / "scene.toml")


def survey_is_taken(folder, data):
    """Whether a case with this survey is taken."""
    (folder / "random.csv").write_bytes(data)
    profile = {"kind": "survey", "file": "random.csv", "critical_slope": 0.5, "length": 50.0}
    content = changed({"profile": profile, "domain.left": -50.0})
    if len(data) % 2:
        content["profile"]["repair"] = "isotonic"
    (folder / "scene.toml").write_text(tomli_w.dumps(content))
    return loads_or_is_refused(folder / "scene.toml")


@examples(75)
@given(RANDOM)
def test_any_survey_is_taken_or_refused(folder, rng):
    survey_is_taken(folder, random_survey(rng))


happened = None  # names of what Python was asked to do, while an expression is read and used


def _note(event, _):
    if happened is not None:
        happened.add(event)


def is_law(text):
    """Whether an expression is taken. Then it is increasing and concave; nothing but arithmetic is done in any case."""
    global happened
    happened = set()
    with at_once(), warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            law = expression(text)
        except InputError as error:
            law = None
            assert len(str(error).splitlines()) == 1
        else:
            assert abs(float(law.f(0.0))) <= 1e-12
            # a hole at a single round number, as of 0/(1-q), cannot be seen
            q = np.array([-0.8731, 0.0, 1.2345, 31.734])
            assert np.all(np.diff(law.f(q)) > 0)
            assert np.all(np.diff(law.derivative(q)) < 0)
    asked, happened = happened, None
    assert [str(w.message) for w in warned] == []  # Python has some of the syntax: further lines on stderr
    assert asked <= {"compile", "exec", "builtins.id"}  # of parsing and `eval`; no file, no import, no attribute
    return law is not None


@pytest.fixture(scope="module")
def watched():
    sys.addaudithook(_note)  # there is no way to take it away again


@examples(150)
@given(RANDOM)
def test_any_text_is_a_law_or_bad_input(watched, rng):
    is_law(random_expression(rng))


def assert_finite(folder):
    """No NaN and no infinity in any file of a result; kinks.csv may lack a speed, of a kink that was seen once."""
    with netcdf_file(folder / "profile.nc", mmap=False) as file:
        for name, variable in file.variables.items():
            assert np.all(np.isfinite(variable[:])), name
    for name in ("kinks.csv", "events.csv"):
        with open(folder / name, newline="") as stream:
            for row in csv.DictReader(stream):
                for key, value in row.items():
                    unknown = (key == "speed" and value in ("", "nan")) or (key == "into" and value == "")
                    assert key == "event" or unknown or np.isfinite(float(value)), (name, row)
    text = (folder / "summary.json").read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in summary.json"))
    for key in ("supplied", "eroded_volume", "toe_outflow", "crest_lowering", "wall_seconds"):
        assert np.isfinite(summary[key]), key


@examples(25)
@given(RANDOM)
def test_any_small_run_ends_in_good_order(tmp_path_factory, folder, rng):
    content = small_run(rng)
    (folder / "scene.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    out, into = tmp_path_factory.mktemp("out"), io.StringIO()
    with (
        np.errstate(all="warn", under="ignore"),  # as a user has it: a warning is a line on stderr
        warnings.catch_warnings(record=True) as warned,
        contextlib.redirect_stderr(into),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        warnings.simplefilter("default")
        with pytest.raises(SystemExit) as left:
            main(["run", str(folder / "scene.toml"), "--out", str(out)])
    said, code = into.getvalue(), left.value.code
    assert [str(w.message) for w in warned] == []
    assert code in (0, 1, 2)
    assert said.count("\n") == said.count("hjprofile: ") and (code == 0) == (said == "") and "Traceback" not in said
    assert code == 1 or (code == 0) == (out / "summary.json").exists()
    if code == 0:
        assert_finite(out)


def resident():
    """MB of memory that this process holds now."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs to be told of its memory")
def test_a_hundred_thousand_inputs(folder, watched):
    """As above, 45,000 case files, 5,000 surveys, 50,000 expressions: none is slow, and none leaves anything behind."""
    rng, taken, held = random.Random(20240501), {}, []
    for i in range(100_000):
        if i == 10_000:
            held.append(resident())
        match i % 20:
            case 0:
                kind, good = "survey", survey_is_taken(folder, random_survey(rng))
            case j if j < 10:
                (folder / "scene.toml").write_bytes(random_case_file(rng))
                kind, good = "case", loads_or_is_refused(folder / "scene.toml")
            case _:
                kind, good = "expression", is_law(random_expression(rng))
        taken.setdefault(kind, []).append(good)
    held.append(resident())
    print({kind: f"{np.mean(good):.1%} of {len(good)} taken" for kind, good in taken.items()}, held)
    assert all(0.03 < np.mean(good) < 0.97 for good in taken.values())  # both are seen often
    assert held[1] - held[0] < 8.0  # MB; 100 bytes kept of every input would be 9
