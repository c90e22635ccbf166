"""A run that is stopped goes on bit for bit; whatever is wrong with a checkpoint is told in one sentence."""

import json
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from grid_methods import GRID_METHODS, LAYER_METHOD
from stopped_runs import CONTENT, Stop, case_of, fingerprint

import hjprofile as hj
from hjprofile.output.checkpoint import NAME, Checkpoint
from hjprofile.output.folder import RECORD
from hjprofile.problem.case import parse_case
from hjprofile.problem.identity import identity
from hjprofile.solvers.solve import solve_and_keep, solve_case

KEPT = {"solver__refresh": 0.9}  # a factor that is kept across saved times and checkpoints
PRESCRIBED = {"coefficient__kind": "expression", "coefficient__expression": "exp(-0.2*x)*(1 + 0.1*t)"}
LAYER = {"erosion__law": "rational", "layer__supply_flux": 0.1}
PULSES = {"erosion__law": "rational", "layer__supply_flux": "0.1*(1 + 0.9*sin(20*t))"}
LINE = {"erosion__law": "rational", "domain__line": "whole", "domain__right": 3.0}
STEPS = {  # kinks merge, a vertical step begins and leaves at the toe
    "erosion": {"law": "expression", "expression": "q + q/(1+q)", "growth": "linear"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.5], "amplitudes": [3.0, 5.0]},
    "domain": {"left": -4.0, "cells": 400},
    "time": {"end": 1.5, "snapshots": 7},
}


@pytest.mark.parametrize(
    ("method", "changes"),
    [(m, {}) for m in GRID_METHODS]
    + [("godunov", KEPT), ("eno2", KEPT), ("conservative", PRESCRIBED), (LAYER_METHOD, LAYER), ("conservative", LINE)]
    + [("telescoping", STEPS), (LAYER_METHOD, PULSES)],
)
def test_every_method_goes_on_bit_for_bit(method, changes, tmp_path):
    case = case_of(method, **{"domain__cells": 200} | changes)
    whole = fingerprint(solve_case(case))
    for lots in (3, 3, 5):  # the second and third stop a run that was resumed
        keeper = Checkpoint(tmp_path, 1e9, resume=True)
        with pytest.raises(hj.RunError, match=r"interrupted at t = .*--resume continues from it"):
            solve_and_keep(case, keeper, Stop(keeper, lots))
    again = Checkpoint(tmp_path, 1e-9, resume=True)
    assert fingerprint(solve_and_keep(case, again)) == whole
    assert again.resumed_at >= 0.0
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL  # as it was


def kept(folder, case):
    """A checkpoint of an interrupted run."""
    keeper = Checkpoint(folder, 1e9, resume=False)
    with pytest.raises(hj.RunError):
        solve_and_keep(case, keeper, Stop(keeper, 6))
    return folder / NAME


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"domain__cells": 401}, "domain.cells = 400 there, 401 here"),
        ({"time__end": 5.0}, "time.end = 4.0 there, 5.0 here"),
        ({"solver__method": "eno2"}, "solver.method = godunov there, eno2 here"),
        ({"erosion__law": "rational"}, "erosion.law = log there, rational here"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused(change, words, tmp_path):
    kept(tmp_path, case_of("godunov"))
    with pytest.raises(hj.InputError, match="is of another run: " + words):
        solve_and_keep(case_of("godunov", **change), Checkpoint(tmp_path, 1.0, resume=True))


def test_a_law_that_was_edited_is_another_run(in_tmp):
    law = {"law": "python", "file": "law.py", "function": "f"}
    Path("law.py").write_text("def f(q):\n    return q / (1 + q)\n")
    kept(in_tmp, parse_case(CONTENT | {"erosion": law}, "scene", "scene.toml", in_tmp))
    Path("law.py").write_text("def f(q):\n    return 2 * q / (1 + q)\n")
    edited = parse_case(CONTENT | {"erosion": law}, "scene", "scene.toml", in_tmp)
    with pytest.raises(hj.InputError, match="the data that the case names have changed"):
        solve_and_keep(edited, Checkpoint(in_tmp, 1.0, resume=True))


def test_a_coefficient_that_was_edited_between_its_ends_in_time_is_another_run(in_tmp):
    """Alike at t = 0 and at the end, at every node; and so is a module beside it that it imports."""
    sys.path.insert(0, str(in_tmp))
    content = CONTENT | {"coefficient": {"kind": "python", "file": "k.py", "function": "k"}}
    try:
        Path("beside_k.py").write_text("def swell(t):\n    return 0 * t\n")
        Path("k.py").write_text("from beside_k import swell\n\ndef k(t, x):\n    return 1 + swell(t) + 0 * x\n")
        kept(in_tmp, parse_case(content, "scene", "scene.toml", in_tmp))
        unchanged = parse_case(content, "scene", "scene.toml", in_tmp)
        keeper = Checkpoint(in_tmp, 1e9, resume=True)
        assert solve_and_keep(unchanged, keeper).done and keeper.resumed_at > 0.0
        Path("beside_k.py").write_text("def swell(t):\n    return t * (4 - t)\n")
        edited = parse_case(content, "scene", "scene.toml", in_tmp)
        assert float(edited.problem.coefficient.values(1.0, -1.0)) == 4.0  # the module as it is now
        with pytest.raises(hj.InputError, match="the data that the case names have changed"):
            solve_and_keep(edited, Checkpoint(in_tmp, 1.0, resume=True))
    finally:
        sys.path.remove(str(in_tmp))
        sys.modules.pop("beside_k", None)


def test_a_changed_package_is_another_run(tmp_path, monkeypatch):
    kept(tmp_path, case_of("godunov"))
    monkeypatch.setattr("hjprofile.problem.identity._package", lambda: "another")
    with pytest.raises(hj.InputError, match=r"is of another run: hjprofile = .* there, .*another.* here"):
        solve_and_keep(case_of("godunov"), Checkpoint(tmp_path, 1.0, resume=True))


@pytest.mark.parametrize("part", ["law", "profile", "coefficient"])
def test_functions_of_no_file_keep_no_checkpoints(part, tmp_path):
    """Nothing would tell such a run from one with another function."""
    given = {
        "law": hj.erosion_law(lambda q: q / (1 + q)),
        "profile": hj.profile(lambda x: x + 0.3 * np.tanh(np.maximum(x + 3.0, 0.0) ** 2)),
        "coefficient": hj.coefficient(lambda t, x: 1.0 + 0.0 * x),
    }
    case = case_of("godunov")
    case = replace(case, problem=replace(case.problem, **{part: given[part]}))
    assert solve_case(case).done
    with pytest.raises(hj.InputError, match=f"scene.toml: the {part} is a Python function that is in no file"):
        solve_and_keep(case, Checkpoint(tmp_path, 1.0, resume=False))


def test_windows_of_the_whole_line_are_told_apart(in_tmp):
    """Two windows of one width are one half line with one table of the profile; the case has both ends."""
    Path("u.py").write_text("import numpy as np\n\ndef u(x):\n    return x + 0.3 * np.tanh(np.maximum(x + 3, 0))\n")
    profile = {"kind": "python", "file": "u.py", "function": "u"}
    identities = []
    for right in (20.0, 21.0):
        domain = {"left": right - 40.0, "cells": 400, "right": right, "line": "whole"}
        identities.append(
            identity(parse_case(CONTENT | {"profile": profile, "domain": domain}, "line", "line.toml", in_tmp))
        )
    assert identities[0]["domain"] != identities[1]["domain"] and identities[0]["data"] != identities[1]["data"]


def test_damaged_checkpoints_are_refused_in_a_sentence(tmp_path):
    """Bytes changed, cut off, added: another state must not come of it, nor anything but InputError."""
    case = case_of("godunov")
    path = kept(tmp_path, case)
    good, rng = path.read_bytes(), random.Random(7)
    whole = fingerprint(solve_case(case))
    outcomes = set()
    for trial in range(45):
        data = bytearray(good)
        kind = trial % 3
        if kind == 0:
            for _ in range(rng.randint(1, 8)):
                data[rng.randrange(len(data))] = rng.randrange(256)
        elif kind == 1:
            del data[rng.randrange(len(data)) :]
        else:
            at = rng.randrange(len(data))
            data[at : at + rng.randint(0, 50)] = rng.randbytes(rng.randint(1, 50))
        path.write_bytes(data)
        try:
            run = solve_and_keep(case, Checkpoint(tmp_path, 1e9, resume=True))
        except hj.InputError as error:
            assert "\n" not in str(error) and str(path) in str(error)
            outcomes.add("refused")
        else:  # a bit that nobody reads
            assert fingerprint(run) == whole
            outcomes.add("as good")
        path.write_bytes(good)
    assert "refused" in outcomes


def test_a_checkpoint_holds_no_code(tmp_path):
    path = kept(tmp_path, case_of("godunov"))
    np.savez(path, identity=np.array([object()], dtype=object))
    with pytest.raises(hj.InputError, match="is damaged"):
        solve_and_keep(case_of("godunov"), Checkpoint(tmp_path, 1.0, resume=True))


def run_once(folder, *options, kill_after=None, how=signal.SIGKILL):
    command = [sys.executable, "-m", "hjprofile", "run", "scene.toml", "--out", "out", *options]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if kill_after is not None:
        time.sleep(kill_after)
        process.send_signal(how)
    out, err = process.communicate(timeout=120)
    return process.returncode, out.decode(), err.decode()


def files_of(folder):
    """Name -> bytes, the clock's readings left out."""
    found = {}
    for path in sorted((folder / "out").rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            found[path.relative_to(folder).as_posix()] = path.read_bytes()
    summary = json.loads(found["out/summary.json"])
    for name in ("wall_seconds", "cell_updates_per_second"):
        summary.pop(name)
    return found | {"out/summary.json": summary}


def killed_again_and_again(tmp_path, kills, seed):
    """Runs that are killed at random moments and resumed until they end, until so many have been killed."""
    content = CONTENT | {"solver": {"method": "weno5"}, "domain": {"left": -10.0, "cells": 800}}
    content |= {"output": {"vtk": True, "plots": False, "checkpoint": 0.02}, "time": {"end": 3.0, "snapshots": 4}}
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.toml").write_text(tomli_w.dumps(content))
    started = time.monotonic()
    assert run_once(tmp_path / "whole")[0] == 0
    seconds = time.monotonic() - started
    expected, rng, killed, resumed = files_of(tmp_path / "whole"), random.Random(seed), 0, 0
    while killed < kills:
        code, out, err = run_once(tmp_path / "killed", "--resume", kill_after=rng.uniform(0.0, 1.1 * seconds))
        if code == -signal.SIGKILL:
            killed += 1
            continue
        assert code == 0, err
        resumed += "from the checkpoint at t =" in out
        assert files_of(tmp_path / "killed") == expected
    code, out, err = run_once(tmp_path / "killed", "--resume")
    assert code == 0 and files_of(tmp_path / "killed") == expected
    left = [p.name for p in (tmp_path / "killed" / "out").rglob("*") if NAME in p.name or p.name.startswith(".")]
    assert left == [RECORD]
    return resumed


def test_kill_and_resume(tmp_path):
    killed_again_and_again(tmp_path, 1, seed=5)  # killed at 0.69 of the time of a run


@pytest.mark.slow
def test_two_hundred_kills_and_resumes(tmp_path):
    assert killed_again_and_again(tmp_path, 200, seed=2) > 10


def test_ctrl_c_saves_and_says_so(tmp_path):
    content = CONTENT | {"solver": {"method": "weno5"}, "domain": {"left": -10.0, "cells": 20000}}
    content |= {"output": {"vtk": False, "plots": False, "checkpoint": 0.1}}
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(content))
    command = [sys.executable, "-m", "hjprofile", "run", "scene.toml", "--out", "out"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE) as process:
        while not (tmp_path / "out" / NAME).exists() and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)  # long before the run's end
        err = process.stderr.read().decode()
    assert process.returncode == 1
    assert err.startswith("hjprofile: interrupted at t = ") and f"out/{NAME}" in err and "--resume" in err
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [RECORD, NAME]
