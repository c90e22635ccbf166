"""For scripts: `--json` on every command, the consistency test as a function, completion in the shell."""

import contextlib
import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import hjprofile as hj
from hjprofile.output import workers
from hjprofile.output.plots import statement_pictures, study_pictures
from hjprofile.problem.case_files import shipped_cases
from hjprofile.studies import characteristic_statements, chart, consistency, dependence, stability

SCENE = {
    "title": "Zwei Knicke",
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -4.0, "cells": 160},
    "time": {"end": 1.0, "snapshots": 3},
    "output": {"vtk": False, "plots": False},
}


@pytest.fixture
def scene(in_tmp):
    path = in_tmp / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE), encoding="utf-8")
    return path


@pytest.fixture
def ask(call):
    """Runs a command with --json; what it answers. Every file that it names is there."""

    def ask(*arguments, code=0):
        left, out, err = call(*arguments, "--json")
        assert (left, bool(err)) == (code, code != 0)
        document = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
        assert all(Path(file).is_file() for file in document.get("files", []))
        return document

    return ask


def test_cases(ask):
    listed = {entry["case"]: entry for entry in ask("cases")["cases"]}
    assert listed.keys() == shipped_cases().keys()
    assert listed["two_kinks"]["title"] == "Two kinks merge" and Path(listed["two_kinks"]["file"]).is_file()


def test_run_and_what_is_made_of_its_results(scene, ask, call):
    document = ask("run", "scene.toml")
    written = json.loads(Path("results/scene/summary.json").read_text())
    assert document == written | {"resumed_at": None, "files": document["files"]}
    assert "results/scene/profile.nc" in document["files"]
    assert ask("run", "scene.toml", "--resume")["resumed_at"] is None
    assert {Path(f).name for f in ask("plot", "results/scene")["files"]} >= {"profile.png", "diagram.png"}
    assert "results/scene/vtk/profile.pvd" in ask("export", "results/scene", "--vtk")["files"]


def test_a_run_that_fails_answers_all_the_same(scene, ask):
    document = ask("run", "scene.toml", "--cfl", "3", code=1)
    assert document["status"].startswith("stopped at t = ") and document["supplied"] < 1.0


def test_bad_input_answers_on_stderr_alone(scene, call):
    code, out, err = call("run", "scene.toml", "--method", "nonsense", "--json")
    assert (code, out) == (2, "") and "nonsense" in err


def test_sweep(scene, ask, monkeypatch):
    monkeypatch.setattr(workers, "processes", lambda number: contextlib.nullcontext())  # its members run in this one
    document = ask("sweep", "scene.toml", "--vary", "time.end=0.5,1.0", "--workers", "1")
    rows = list(csv.DictReader(Path("results/scene/sweep.csv").read_text().splitlines()))
    assert [row.keys() for row in document["members"]] == [row.keys() for row in rows]
    assert [m["time.end"] for m in document["members"]] == [0.5, 1.0]
    assert [m["eroded_volume"] for m in document["members"]] == [float(row["eroded_volume"]) for row in rows]


def test_fit(scene, ask):
    exact = hj.track_fronts(hj.load_case(scene).problem, hj.Grid(-4.0, 160))
    rows = np.column_stack([exact.x, exact.u[-1]])
    np.savetxt("after.csv", rows, delimiter=",", header="x,height", comments="", fmt="%.17g")
    document = ask("fit", "scene.toml", "after.csv", "--vary", "time.end")
    assert document | {"files": 0} == json.loads(Path("results/scene/fit.json").read_text()) | {"files": 0}
    assert document["parameters"]["time.end"]["value"] == pytest.approx(1.0, abs=1e-6)


def test_check(scene, ask, monkeypatch):
    monkeypatch.setattr(consistency, "check_consistency", lambda *_: COMPARISONS)
    document = ask("check", "scene.toml", code=1)
    written = json.loads(Path("results/scene/check.json").read_text())
    assert document == written | {"files": ["results/scene/check.json"]}
    assert [c["passes"] for c in document["cases"][0]["comparisons"]] == [True, True, False]


COMPARISONS = [
    consistency.Check("bounds:godunov", [250], [0.0], None, 0.0, True, "every run ends"),
    consistency.Check("budget:godunov", [250, 500], [2e-2, 1e-2], 1.0, 0.7, True, "order >= 0.7"),
    consistency.Check("identity:godunov", [2000], [3.0], None, 1e-10, False, "max |D u - 1 - q| <= 1e-10"),
]


def test_chart_stability_and_dependence(scene, ask, monkeypatch):
    """What they find is tested elsewhere; here that it is answered as it was found."""
    point = chart.Point("scene", "godunov", 250, 1e-2, 2e-2, 0.1, 300)
    worse = point._replace(cells=200, error_q_l1=3e-2, seconds=0.2)
    found = chart.Chart("scene", (point, worse), chart.Reference("closed form", 0.0, 0.0, *np.zeros((2, 1, 1))))
    monkeypatch.setattr(chart, "chart", lambda *_: found)
    (of_scene,) = ask("chart", "scene.toml")["cases"]
    assert of_scene["points"] == [point._asdict(), worse._asdict()] and of_scene["pareto"] == [point._asdict()]

    trials = [
        stability.Trial("scene", "godunov", "cfl", value, outcome, "", 1.0)
        for value, outcome in ((0.5, stability.HOLDS), (1.0, stability.HOLDS), (2.0, stability.FAILS))
    ]
    monkeypatch.setattr(stability, "scan", lambda *_: trials)
    for picture in ("chart_picture", "stability_picture", "dependence_picture"):  # drawn in the tests of each command
        monkeypatch.setattr(study_pictures, picture, lambda *_: b"")
    document = ask("stability", "scene.toml")
    assert document["limits"] == {"godunov": {"holds_at": 1.0, "fails_at": 2.0, "theory": 1.0}}
    assert document["trials"] == [t._asdict() | {"cfl": None} for t in trials]
    monkeypatch.setattr(stability, "scan", lambda *_: trials[:2])
    assert ask("stability", "scene.toml")["limits"]["godunov"]["fails_at"] is None  # it never does

    for name, value in (("PAIRS", 1), ("CELLS", 80), ("WAVES", 1), ("REFRESHES", (16, 8))):
        monkeypatch.setattr(dependence, name, value)
    document = ask("dependence", "scene.toml")
    assert document["passes"] is True and [line.split()[0] for line in document["found"]][:2] == ["data", "zero"]


def test_statements(scene, ask, monkeypatch):
    monkeypatch.setattr(characteristic_statements, "TIMES", 101)
    for picture in ("statements_picture", "invariant_picture"):
        monkeypatch.setattr(statement_pictures, picture, lambda *_: b"")
    document = ask("statements", "scene.toml")
    first = document["statements"][0]
    assert document["passes"] is True and first["statement"] == "q_in_time" and first["equation"] == "H1"
    assert first["holds"] is True and 0.0 < first["value"] <= first["bound"] and first["reason"] == ""
    (away,) = [s for s in document["statements"] if s["statement"] == "infimum_of_q"]
    assert away["applies"] is False and away["value"] is None and away["reason"]


def test_every_command_has_it(call):
    from hjprofile.cli.common import app

    commands = [name for name in app if not name.startswith("-")]
    assert len(commands) >= 10
    for name in commands:
        assert "--json" in call(name, "--help")[1], name


def test_check_is_a_function_for_tests(scene, tmp_path, capsys):
    """In pytest a failure shows the comparisons that failed, and no others."""
    verdict = consistency.Consistency("scene", "Zwei Knicke", COMPARISONS)
    assert not verdict and not verdict.passes
    assert str(verdict).splitlines()[0] == "scene: FAILS" and "bounds:godunov" not in str(verdict)
    assert "FAILS   identity:godunov" in str(verdict) and "passes  budget:godunov" in str(verdict)
    assert consistency.Consistency("scene", "", COMPARISONS[:2])
    (tmp_path / "test_mine.py").write_text(
        "import hjprofile as hj\nfrom hjprofile.studies import consistency\n"
        "def test_mine(monkeypatch):\n"
        "    bad = consistency.Check('identity:godunov', [2000], [3.0], None, 1e-10, False, 'max <= 1e-10')\n"
        "    monkeypatch.setattr(consistency, 'check_consistency', lambda *_: [bad])\n"
        "    assert hj.check('scene.toml')\n"
    )
    code = pytest.main(["-q", "-p", "no:cacheprovider", "-c", os.devnull, str(tmp_path / "test_mine.py")])
    assert code == pytest.ExitCode.TESTS_FAILED
    assert "<scene: FAILS identity:godunov 3 on 2000 cells (max <= 1e-10)>" in capsys.readouterr().out


def test_check_takes_what_a_user_has(scene, monkeypatch):
    monkeypatch.setattr(consistency, "check_consistency", lambda *given: given)
    by_file, by_case = hj.check("scene.toml"), hj.check(hj.load_case(scene))
    assert str(by_file.comparisons) == str(by_case.comparisons) and by_file.case == "scene"
    assert by_file.comparisons[0].title == "Zwei Knicke" and by_file.comparisons[1] == hj.Grid(-4.0, 160)
    with pytest.raises(hj.InputError, match="nowhere"):
        hj.check("nowhere.toml")


@pytest.mark.skipif(not Path("/bin/bash").exists(), reason="needs bash")
def test_completion_in_bash(in_tmp):
    """Installed as a user would; bash then completes commands, options and case files."""
    home = os.environ | {"HOME": str(in_tmp), "SHELL": "/bin/bash"}
    program = Path(sys.executable).parent / "hjprofile"
    done = subprocess.run([program, "--install-completion"], env=home, capture_output=True, text=True)
    assert done.returncode == 0
    (in_tmp / "mine.toml").write_text("")
    script = """
        . .local/share/bash-completion/completions/hjprofile
        COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
        _hjprofile
        echo "${COMPREPLY[@]}"
    """

    def complete(*words):
        done = subprocess.run(["/bin/bash", "-c", script, "-", "hjprofile", *words], capture_output=True, text=True)
        return done.stdout.split()

    assert set(complete("ch")) == {"check", "chart"}
    assert {"--cells", "--json"} <= set(complete("run", "--"))
    assert complete("run", "mi") == ["mine.toml"]
