"""Case files by their schema: all faults of a file in one run, and tables that are read and written back the same."""

import copy
import pickle
import tomllib

import numpy as np
import pytest
import tomli_w
from bad_cases import REMOVED, VALID, changed, with_files
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_case import same

from hjprofile.cli import main
from hjprofile.errors import InputError
from hjprofile.problem.case import load_case, parse_case, resolved_case, to_toml
from hjprofile.problem.case_files import shipped_cases
from hjprofile.problem.case_keys import COEFFICIENTS, LAWS, PROFILES

FOUR = {  # an unknown key, a misspelt name, a wrong type, a missing key
    "title": "Four faults",
    "erosion": {"law": "ratinal"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -6.0, "cells": 60.0},
    "time": {"snapshots": 3},
    "solver": {"metod": "godunov"},
}
SENTENCES = [
    "[erosion] law = 'ratinal' is not known; did you mean 'rational'? allowed are 'rational', 'log', 'power', "
    "'expression', 'python' (see: hjprofile explain a-misspelt-name)",
    "[domain] cells = 60.0 must be a whole number (see: hjprofile explain a-value-of-the-wrong-kind)",
    "[time] end is missing; it must be a finite number (see: hjprofile explain a-key-that-is-missing)",
    "[solver] metod is not a known key; did you mean 'method'? (allowed: method, cfl, tolerance, refresh) "
    "(see: hjprofile explain a-misspelt-key)",
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return with_files(tmp_path_factory.mktemp("schema"))


def faults(content, folder):
    """The sentences on a case, without the name of the file, and their headings."""
    with pytest.raises(InputError) as refused:
        parse_case(copy.deepcopy(content), "scene", "scene.toml", folder)
    assert str(refused.value).splitlines() == [str(fault) for fault in refused.value.faults]
    return [(str(fault).removeprefix("scene.toml: "), fault.about) for fault in refused.value.faults]


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("order", [list(FOUR), list(reversed(FOUR))], ids=["in order", "reversed"])
def test_four_faults_are_told_at_once(in_tmp, capsys, command, order):
    (in_tmp / "four.toml").write_text(tomli_w.dumps({key: FOUR[key] for key in order}))
    with pytest.raises(SystemExit) as left:
        main([command, "four.toml"])
    out, err = capsys.readouterr()
    assert (left.value.code, out) == (2, "")
    assert err.splitlines() == [f"hjprofile: four.toml: {sentence}" for sentence in SENTENCES]
    assert [path.name for path in in_tmp.iterdir()] == ["four.toml"]


def test_each_fault_keeps_its_heading_and_survives_a_pickle(folder):
    with pytest.raises(InputError) as refused:
        parse_case(FOUR, "scene", "scene.toml", folder)
    error = pickle.loads(pickle.dumps(refused.value))
    told = [f"{fault} (see: hjprofile explain {fault.about})" for fault in error.faults]
    assert told == [f"scene.toml: {sentence}" for sentence in SENTENCES]
    assert error.about == "a-misspelt-name"
    one = InputError("x = 3 must be 4", "a-survey")
    assert InputError.of([one]) is one and one.faults == (one,)


ONE = {  # changes to VALID that are one fault, which could be taken for two -> the words of the only sentence
    "a section misspelt": (
        {"erosion": REMOVED, "erosoin": {"law": "log"}}, "erosoin is not a known key; did you mean 'erosion'?",
    ),
    "a required key misspelt": ({"time": {"ed": 1.0}}, "[time] end is missing ('ed' is not a known key)"),
    "a required key in capitals": ({"time": {"END": 1.0}}, "[time] end is missing ('END' is not a known key)"),
    "a chooser misspelt": (
        {"profile": {"kynd": "steady", "flux": 0.3}}, "[profile] kind is missing ('kynd' is not a known key)",
    ),
    "a law misspelt, whose keys are unknown": ({"erosion": {"law": "powr", "m": 2.0}}, "[erosion] law = 'powr' is not"),
    "a section that is no table": ({"domain": 3}, "domain = 3 must be a table"),
    "a profile at fault, whose grid is unknown": (
        {"profile.amplitudes": [0.4], "domain": {"cells": 60}}, "[profile] amplitudes has 1 entries and positions",
    ),
    "more cells than fit, for a profile left of them": ({"domain": {"left": -1.0, "cells": 10**15}}, "[domain] cells"),
    "a title too long": ({"title": "a" * 501}, "title has 501 characters; at most 500 are allowed"),
}  # fmt: skip


@pytest.mark.parametrize("name", ONE)
def test_one_fault_is_one_sentence(folder, name):
    changes, words = ONE[name]
    content = copy.deepcopy(VALID) | {key: value for key, value in changes.items() if "." not in key}
    content = {key: value for key, value in content.items() if value is not REMOVED}
    for key, value in changes.items():
        if "." in key:
            section, part = key.split(".")
            content[section][part] = value
    ((sentence, _),) = faults(content, folder)
    assert sentence.startswith(words)


SEVERAL = {  # changes to VALID -> the beginnings of the sentences
    "in one section": (
        {"time": {"end": "1", "snapshot": 3}},
        ["[time] end = '1' must be a finite number (without quotes)", "[time] snapshot is not a known key"],
    ),
    "numbers out of range": (
        {"domain.cells": 3, "time.end": -1.0, "solver.cfl": 1e9, "output.checkpoint": 1e99},
        ["[domain] cells = 3 must", "[time] end = -1.0 must", "[solver] cfl = 10", "[output] checkpoint = 1e+99 must"],
    ),
    "constructors": (
        {"erosion": {"law": "expression", "expression": "q*q"}, "profile.amplitudes": [0.4], "domain.left": 2.0,
         "time.snapshots": [2.0], "coefficient": {"kind": "expression", "expression": "y"}, "solver.cfl": 1e9},
        ["[erosion] the law is not an erosion function", "[profile] amplitudes has 1 entries", "[coefficient] express",
         "[domain] left = 2.0 must be a negative", "[time] snapshots holds 2; times must", "[solver] cfl = 10"],
    ),
    "parts that do not go together": (
        {"layer": {"supply_flux": 0.1}, "coefficient": {"kind": "expression", "expression": "-1"}, "domain.left": -2.5},
        ["[layer] a coefficient and a rolling layer cannot be", "[profile] the profile reaches left to x = -3",
         "[coefficient] the coefficient k = -1 at t = 0"],
    ),
    "above all sections": (
        {"titel": "x", "cells": 3, "domain": REMOVED},
        ["titel is not a known key; did you mean 'title'?", "cells is not a known key", "[domain] cells is missing"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SEVERAL)
def test_several_faults_are_told_by_section(folder, name):
    changes, beginnings = SEVERAL[name]
    found = faults(changed(changes), folder)
    assert [sentence[: len(start)] for (sentence, _), start in zip(found, beginnings, strict=True)] == beginnings
    assert all(about for _, about in found)


def test_overrides_are_told_with_the_faults_of_the_file(folder):
    (folder / "four.toml").write_text(tomli_w.dumps(FOUR))
    with pytest.raises(InputError) as refused:
        load_case(folder / "four.toml", {"solver.cfl": -1.0, "time.end": 1.0})
    told = [str(fault).removeprefix(f"{folder / 'four.toml'}: ") for fault in refused.value.faults]
    assert [sentence.split(" ")[:2] for sentence in told] == [
        ["[erosion]", "law"], ["[domain]", "cells"], ["[solver]", "cfl"], ["[solver]", "metod"],
    ]  # fmt: skip


def supplied(problem):
    """The supply flux, or its values if it depends on t."""
    flux = problem.supply_flux
    return flux if isinstance(flux, float) else flux.values(np.linspace(0.0, problem.end, 9)).tolist()


def round_trip(case, folder):
    """The resolved case is the case, and is written as it was read, to the last bit."""
    table = resolved_case(case.problem, case.grid, case.method, case.cfl, case.tolerance, case.refresh)
    text = to_toml(table)
    assert tomllib.loads(text) == table
    again = parse_case(tomllib.loads(text), case.name, "resolved", folder)
    assert resolved_case(again.problem, again.grid, again.method, again.cfl, again.tolerance, again.refresh) == table
    assert to_toml(table) == text
    assert (again.grid, again.method, again.cfl, again.tolerance, again.refresh) == (
        case.grid, case.method, case.cfl, case.tolerance, case.refresh
    )  # fmt: skip
    same(again.problem, case.problem, case.grid)
    assert supplied(again.problem) == supplied(case.problem) and again.problem.line == case.problem.line
    return table


@pytest.mark.parametrize("name", shipped_cases())
def test_a_shipped_case_is_written_as_it_is_read(name):
    round_trip(load_case(name), shipped_cases()[name].parent)


def numbers(least, most):
    return st.floats(least, most, allow_subnormal=False)


def rising(least, most, size):
    """Strictly increasing numbers, a hundredth apart at least."""
    places = st.lists(st.integers(int(100 * least), int(100 * most)), min_size=size, max_size=size, unique=True)
    return places.map(lambda found: [n / 100 for n in sorted(found)])


def table(chosen, chooser="kind", **values):
    """A section, with or without the keys whose values are None."""
    drawn = st.fixed_dictionaries({name: value for name, value in values.items()})
    return drawn.map(lambda found: {chooser: chosen} | {k: v for k, v in found.items() if v is not None})


LINEAR = table("expression", "law", expression=st.just("q + q/(1+q)"), growth=st.just("linear"))
SUBLINEAR = st.one_of(
    table("rational", "law"), table("log", "law"), table("power", "law", m=numbers(0.1, 5.0)),
    table("expression", "law", expression=numbers(0.5, 2.0).map(lambda a: f" {a!r}*q/(1+q) ")),
    table("python", "law", file=st.just("user.py"), function=st.just("f")),
)  # fmt: skip
HALF_LINE = [
    table("steady", flux=numbers(0.01, 0.15), kink=st.floats(-8.0, -0.5)),
    table("survey", file=st.just("survey.csv"), critical_slope=numbers(0.1, 2.0), length=numbers(0.5, 9.0),
          repair=st.just("isotonic")),
]  # fmt: skip
ANYWHERE = [
    st.integers(1, 4).flatmap(
        lambda n: table("kinks", positions=rising(-9.0, -0.1, n), amplitudes=rising(0.1, 20.0, n))
    ),
    st.integers(1, 3).flatmap(
        lambda n: table(
            "bumps", amplitudes=st.lists(numbers(-0.3, 5.0), min_size=n, max_size=n),
            centres=st.lists(numbers(-8.0, -4.0), min_size=n, max_size=n),
            widths=st.lists(numbers(0.1, 0.5), min_size=n, max_size=n),
        )
    ),
    st.integers(1, 4).flatmap(
        lambda n: table("steps", edges=rising(-9.0, 0.0, n + 1), values=st.lists(numbers(-0.9, 9.0), min_size=n,
                        max_size=n))
    ),
    st.integers(2, 5).flatmap(
        lambda n: table("points", x=rising(-9.0, 0.0, n), q=st.lists(numbers(-0.9, 9.0), min_size=n, max_size=n))
    ),
    table("python", file=st.just("user.py"), function=st.just("u")),
]  # fmt: skip
COEFFICIENT = st.one_of(
    table("expression", expression=numbers(0.0, 1.0).map(lambda a: f"exp(-{a!r}*x)/(1+t) ")),
    table("python", file=st.just("user.py"), function=st.just("k")),
)
LAYER = st.one_of(
    st.fixed_dictionaries({"supply_flux": numbers(1e-9, 5.0)}),
    st.fixed_dictionaries({"supply_flux": numbers(1e-9, 5.0).map(lambda a: f" {a!r}*(1 + 0.9*sin(20*t)) ")}),
    st.just({"file": "user.py", "function": "supply"}),
)


@st.composite
def cases(draw):
    """An admissible case: TOML tables, in which whatever has a default may be left out."""

    def perhaps(strategy):
        return draw(st.one_of(st.none(), strategy))

    def section(**values):
        return {key: value for key, value in values.items() if value is not None}

    scene = draw(st.sampled_from(["slope", "linear", "layer", "coefficient", "whole"]))
    end = draw(st.one_of(st.just(0.0), numbers(1e-9, 10.0), st.integers(1, 9)))
    times = st.lists(st.floats(0.0, float(end)), min_size=1, max_size=4, unique=True).map(sorted)
    times = times.filter(lambda found: min(np.diff(found), default=1.0) > 1e-6 * float(end) and found[-1] < 0.999 * end)
    snapshots = perhaps(st.one_of(st.integers(1, 50), times) if end else st.integers(1, 50))
    content = {
        "title": draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=30)),
        "erosion": {"law": "rational"} if scene == "layer" else draw(LINEAR if scene == "linear" else SUBLINEAR),
        "profile": draw(st.one_of(*ANYWHERE, *(HALF_LINE if scene != "whole" else []))),
        "domain": section(left=perhaps(numbers(-99.0, -40.0)), cells=draw(st.integers(40, 200))),
        "time": section(end=end, snapshots=snapshots),
        "solver": section(
            method=perhaps(st.sampled_from(["godunov", "fronts", "auto"])), cfl=perhaps(numbers(1e-4, 100.0)),
            tolerance=perhaps(numbers(1e-13, 1.0)), refresh=perhaps(numbers(1e-3, 9.0)),
        ),
        "output": section(vtk=perhaps(st.booleans()), checkpoint=perhaps(st.integers(1, 99))),
    }  # fmt: skip
    if scene == "layer":
        content["layer"] = draw(LAYER)
    if scene == "coefficient":
        content["coefficient"] = draw(COEFFICIENT)
    if scene == "whole":
        content["domain"] |= {"line": "whole", "left": -50.0, "right": draw(st.one_of(st.just(0.0), numbers(0.0, 3.0)))}
    return content


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(cases())
def test_any_admissible_case_is_written_as_it_is_read(folder, content):
    case = parse_case(content, "scene", "scene.toml", folder)
    stored = round_trip(case, folder)
    for name in ("erosion", "profile", "coefficient", "layer"):
        stripped = {k: v.strip() if isinstance(v, str) else v for k, v in content.get(name, {}).items()}
        assert stored.get(name, {}) == stripped
    assert stored["time"].keys() == {"end", "snapshots"} and stored["solver"].keys() >= {"method", "cfl"}
    for name in ("domain", "time", "solver"):
        assert stored[name] == stored[name] | {k: v for k, v in content[name].items() if k != "snapshots"}


@pytest.mark.parametrize("choices", [LAWS, PROFILES, COEFFICIENTS], ids=["laws", "profiles", "coefficients"])
def test_every_choice_is_tried(choices):
    """A new law or profile has to be added to the strategies above."""
    drawn = {"law": [SUBLINEAR, LINEAR], "kind": [*ANYWHERE, *HALF_LINE]}[choices.chooser.name]
    drawn = [COEFFICIENT, st.just({"kind": "run"})] if choices is COEFFICIENTS else drawn
    seen = set()

    @settings(max_examples=300, database=None)
    @given(st.one_of(*drawn))
    def look(found):
        seen.add(found[choices.chooser.name])

    look()
    assert seen == set(choices.choices)
