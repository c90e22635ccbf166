"""Sweeps: each member is the run that it says, whoever runs it; what is done stays done; failures cost nobody else."""

import csv
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import xarray as xr

import hjprofile as hj
from hjprofile.output import workers
from hjprofile.output.folder import RECORD
from hjprofile.output.sweep_results import KEPT, netcdf
from hjprofile.problem.case_files import read_choices
from hjprofile.solvers.solve import solve_case
from hjprofile.studies import sweep as evidence
from hjprofile.studies.sweep import QUANTITIES

SCENE = {
    "title": "Zwei Knicke",
    "erosion": {"law": "power", "m": 1.0},
    "profile": {"kind": "steps", "edges": [-3.0, -2.0, -1.0], "values": [0.4, 1.2]},
    "domain": {"left": -4.0, "cells": 80},
    "time": {"end": 1.0, "snapshots": 3},
}
VARY = {"erosion.m": [0.5, 2.0], "profile.values": [[0.4, 1.2], [0.5, 1.2]], "solver.method": ["godunov", "fronts"]}
COUNT = 8
SLOW_LAW = """
import os
import time
import numpy as np

def f(q):
    if np.size(q) == 81 and "IN_HASTE" not in os.environ:  # the nodes, some hundreds of times
        time.sleep(0.001)
    return q / (1 + q)
"""


FAR_LAW = """
import numpy as np

def f(q):  # like another law at the nodes, and up to q = 9
    bend = {bend} * np.maximum(np.asarray(q) - 12.0, 0.0) ** 3 / (12.0 + np.asarray(q)) ** 4
    return q / (1 + q) - bend
"""
PROFILE = "import numpy as np\n\ndef u(x):\n    return x + {} * np.tanh(np.maximum(x + 3, 0) ** 2)\n"
SURVEY = "x,height\n0,0\n100,{}\n200,60\n"
PYTHON = {"law": "python", "file": "law.py", "function": "f"}
# kind -> the file that is edited, its text before and after, and what the case says of it
EDITED = {
    "law": ("law.py", "def f(q):\n    return 1 * q / (1 + q)\n", "def f(q):\n    return 2 * q / (1 + q)\n",
            {"erosion": PYTHON}),
    "law far away": ("far.py", FAR_LAW.format(bend=0), FAR_LAW.format(bend=1e-3),
                     {"erosion": PYTHON | {"file": "far.py"}}),
    "profile": ("u.py", PROFILE.format(0.3), PROFILE.format(0.5),
                {"profile": {"kind": "python", "file": "u.py", "function": "u"}}),
    "survey": ("s.csv", SURVEY.format(20), SURVEY.format(25),
               {"profile": {"kind": "survey", "file": "s.csv", "critical_slope": 0.3, "length": 100.0}}),
    "coefficient": ("k.py", "def k(t, x):\n    return 1 + 0 * x\n",
                    "def k(t, x):\n    return 1 + 8 * t * (0.5 - t) + 0 * x\n",  # alike at t = 0 and at the end
                    {"coefficient": {"kind": "python", "file": "k.py", "function": "k"}}),
}  # fmt: skip


def write_case(folder, name="scene", **changes):
    path = Path(folder) / f"{name}.toml"
    path.write_text(tomli_w.dumps(SCENE | changes), encoding="utf-8")
    return path


@pytest.fixture
def scene(in_tmp):
    return write_case(in_tmp)


@pytest.fixture
def alone(monkeypatch):
    """Commands sweep in this process: a second is saved for each process that is not begun."""
    monkeypatch.setattr(workers, "processes", lambda count: nullcontext())


@pytest.fixture
def ran(monkeypatch):
    """The values of the members that are really run in this process, in their order."""
    values = []
    honest = evidence.run_member

    def noted(member):
        values.append(member.values)
        return honest(member)

    monkeypatch.setattr(evidence, "run_member", noted)
    return values


def rows(path):
    return list(csv.DictReader(Path(path).read_text(encoding="utf-8").splitlines()))


def test_members_are_the_runs_that_they_say(scene):
    """To the last bit those of `solve_case`, in the order of the product; numbers against integrals taken here."""
    result = hj.sweep(scene, VARY)
    assert result.shape == (2, 2, 2) and result.values[1] == (0.5, [0.4, 1.2], "fronts") and result.recalled == 0
    for values, outcome in zip(result.values, result.outcomes, strict=True):
        run = solve_case(hj.load_case(scene, dict(zip(VARY, values, strict=True))))
        assert outcome.done and outcome.method == run.method == values[2]
        assert outcome.u.tobytes() == run.u[-1].tobytes()
        found = outcome.quantities
        assert list(found) == list(QUANTITIES)
        assert (found["end"], found["steps"], found["cells"]) == (1.0, run.steps, 80)
        lowered = run.u[0] - run.u[-1]
        assert found["eroded_volume"] == pytest.approx(np.trapezoid(lowered, run.x), abs=0.02)  # first order in dx
        assert found["crest_lowering"] == pytest.approx(lowered[-1], abs=1e-8)
        # fronts stand for a fan by many small jumps: their u(0) is off by 2e-10
        assert found["largest_lowering"] == pytest.approx(lowered.max(), abs=1e-8)
        assert found["largest_rise"] == pytest.approx(max(-lowered.min(), 0), abs=1e-8)
        kinks = sorted((k.jump, k.x) for k in run.kinks_at(-1))
        assert (found["kinks_at_end"], found["kink_jump"], found["kink_x"]) == (len(kinks), *kinks[-1])
        assert outcome.broken_bounds == ""


def test_the_steady_slope_over_flux_and_end(in_tmp):
    """A closed form for a whole table: under the steady slope of flux a everything sinks by a t (§5e)."""
    case = write_case(in_tmp, profile={"kind": "steady", "flux": 0.5}, erosion={"law": "rational"})
    flux, end = np.linspace(0.2, 0.5, 3), np.array([0.5, 1.0])
    cells = [200, 400]
    result = hj.sweep(case, {"profile.flux": flux, "time.end": end, "domain.cells": cells})
    sunk, foot = np.multiply.outer(flux, end), flux / (1.0 + 4.0 * flux)  # the second is f at the left end
    exact = {
        "crest_lowering": (sunk, 1.4e-3),  # and what was measured: 1.16e-3
        "eroded_volume": (4.0 * sunk, 2.2e-3),  # 1.85e-3
        "K_toe": ((1.0 + 4.0 * flux)[:, None], 2.0e-3),  # 1.70e-3
        "q_max": ((flux / (1.0 - flux))[:, None], 5.5e-3),  # 4.65e-3
        "q_min": ((foot / (1.0 - foot))[:, None], 4e-4),  # 3.3e-4
    }
    for name, (values, most) in exact.items():
        errors = np.abs(result.quantity(name) - values[..., None]).max(axis=(0, 1))
        assert 0.9 <= hj.observed_order(cells, errors) <= 1.1, name  # a monotone scheme on smooth data
        assert errors[-1] <= most, name
    assert result.quantity("kinks_at_end").max() == 0
    assert result.quantity("largest_rise").max() == 0
    # the left end, where the flux a enters, sinks by a t to rounding, and nothing sinks further
    assert np.abs(result.quantity("largest_lowering") - sunk[..., None]).max() <= 1e-14


def test_the_largest_rise_of_a_slope_with_deposition(scene):
    vary = {"profile.values": [[-0.5, 0.4], [0.4, -0.5]]}
    found = hj.sweep(scene, vary)
    for value, rise, lowering in zip(
        vary["profile.values"], found.quantity("largest_rise"), found.quantity("largest_lowering"), strict=True
    ):
        run = solve_case(hj.load_case(scene, {"profile.values": value}))
        change = run.u[-1] - run.u[0]
        assert change.max() > 0.1 and change.min() < -0.01
        assert (rise, lowering) == pytest.approx((change.max(), -change.min()), abs=1e-14)  # rounding of u


@pytest.mark.parametrize("name", hj.shipped_cases())
def test_every_shipped_case_can_be_swept(name, in_tmp):
    vary = {"time.end": [0.01, 0.02], "time.snapshots": [2], "domain.cells": [100], "solver.cfl": [0.5]}
    result = hj.sweep(name, vary, folder="out")
    assert [o.status for o in result.outcomes] == ["done"] * 2
    assert result.quantity("end").ravel().tolist() == [0.01, 0.02]
    assert hj.sweep(name, vary, folder="out", resume=True).recalled == 2


def dask_executor():
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    return distributed.Client(cluster), cluster


class Backwards(Executor):
    """Runs nothing before the last member is there, and then that one first."""

    def __init__(self, count):
        self.tasks, self.count = [], count

    def submit(self, function, /, *arguments):
        self.tasks.append((Future(), function, arguments))
        if len(self.tasks) == self.count:
            for future, function, arguments in reversed(self.tasks):
                future.set_result(function(*arguments))
        return self.tasks[-1][0]


def test_bytes_do_not_depend_on_who_runs_them(scene):
    vary = VARY | {"erosion.m": [0.5]}
    alone = netcdf(hj.sweep(scene, vary))
    assert netcdf(hj.sweep(scene, vary, Backwards(4))) == alone
    with ThreadPoolExecutor(3) as threads:
        assert netcdf(hj.sweep(scene, vary, threads)) == alone
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:  # the order is that of threads
        assert netcdf(hj.sweep(scene, vary, processes)) == alone


def test_dask_gives_the_same_bytes(scene):
    client, cluster = dask_executor()
    with cluster, client:
        shared = hj.sweep(scene, VARY, client.get_executor(pure=False))
    assert netcdf(shared) == netcdf(hj.sweep(scene, VARY))


def test_the_files(scene):
    result = hj.sweep(scene, VARY, folder="out")
    table = rows("out/sweep.csv")
    header = [*VARY, "status", "method", *QUANTITIES, "broken_bounds", "wall_seconds"]
    assert list(table[0]) == header and len(table) == COUNT
    assert table[3]["profile.values"] == "[0.5, 1.2]" and table[3]["steps"].isdigit()
    for name in QUANTITIES:
        read = [float(row[name] or "nan") for row in table]
        assert np.array_equal(read, result.quantity(name).ravel(), equal_nan=True)
    with xr.open_dataset("out/sweep.nc") as data:
        assert dict(data.sizes) == {
            "erosion_m": 2, "profile_values": 2, "solver_method": 2, "x": 81,
        }  # fmt: skip
        assert data.erosion_m.values.tolist() == [0.5, 2.0]
        assert data.profile_values_label.values.tolist() == ["[0.4, 1.2]", "[0.5, 1.2]"]
        assert {"profile_values_label", "solver_method_label"} < set(data.coords)
        assert np.array_equal(data.eroded_volume.values, result.quantity("eroded_volume"))
        one = data.sel(erosion_m=2.0).isel(profile_values=1, solver_method=0)
        assert np.array_equal(one.u.values, result.outcomes[6].u) and one.x.values[-1] == 0.0
        assert one.status.item() == "done" and one.solver_method_label.item() == "godunov"
        assert data.attrs["title"] == "Zwei Knicke" and data.eroded_volume.attrs["long_name"]


def test_heights_on_different_grids_are_left_out(scene):
    result = hj.sweep(scene, {"domain.cells": [40, 80]}, folder="out")
    assert result.x is None
    with xr.open_dataset("out/sweep.nc") as data:
        assert "u" not in data and data.domain_cells.values.tolist() == [40, 80]


def test_heights_that_a_file_cannot_hold_are_left_out(scene, monkeypatch):
    """The numbers of the members are not lost over it."""
    monkeypatch.setattr("hjprofile.output.sweep_results.LARGEST_VARIABLE", 2 * 81 * 8)
    for ends, there in (([0.1], True), ([0.1, 0.2], False)):
        assert hj.sweep(scene, {"time.end": ends}, folder="out").quantity("end").tolist() == ends
        with xr.open_dataset("out/sweep.nc") as data:
            assert ("u" in data) == there


FAILING_LAW = """
def f(q):
    if {condition}:
        raise KeyError("no such slope")
    return q / (1 + q)
"""


def test_failures_are_rows_like_others(scene, call, alone):
    """Values that do not go together, a run that breaks down, and data that a method cannot do."""
    vary = [
        "--vary",
        "domain.left=-2.5,-4",
        "--vary",
        "profile.edges=[-3,-2,-1],[-2,-1,-0.5]",
        "--vary",
        "solver.cfl=0.9,3",
    ]
    code, out, err = call("sweep", "scene.toml", *vary)
    assert (code, err) == (0, "")
    table = rows("results/scene/sweep.csv")
    refused = [row for row in table if "left must be at most -3" in row["status"]]
    stopped = [row for row in table if row["status"].startswith("stopped at t = ")]
    assert [(row["domain.left"], row["profile.edges"]) for row in refused] == [("-2.5", "[-3, -2, -1]")] * 2
    assert {row["solver.cfl"] for row in stopped} == {"3"} and len(stopped) == 3
    assert [row["status"] for row in table].count("done") == 3
    assert all(row["eroded_volume"] == row["wall_seconds"] == "" for row in refused + stopped)
    assert "8 members, 3 done, 5 failed" in out and "first failure, at domain.left = -2.5, " in out
    with xr.open_dataset("results/scene/sweep.nc") as data:
        assert int((data.status == "done").sum()) == int(data.eroded_volume.notnull().sum()) == 3


def test_whatever_a_users_law_raises_is_the_members_own(in_tmp, monkeypatch):
    honest = evidence.solve_case

    def faulty(case):
        if case.problem.end == 0.5:
            raise KeyError("no such slope")
        if case.problem.end == 0.6:
            raise MemoryError
        return honest(case)

    monkeypatch.setattr(evidence, "solve_case", faulty)
    statuses = [o.status for o in hj.sweep(write_case(in_tmp), {"time.end": [0.4, 0.5, 0.6]}).outcomes]
    assert (
        statuses[:2] == ["done", "KeyError: 'no such slope'"]
        and "memory of this machine is not sufficient" in statuses[2]
    )


def test_broken_bounds_are_named(scene, call, alone):
    code, out, _ = call("sweep", scene, "--vary", "solver.cfl=1.8,0.5", "--vary", "solver.method=godunov")
    table = rows("results/scene/sweep.csv")
    assert code == 0 and table[0]["status"] == "done" and table[0]["broken_bounds"] and not table[1]["broken_bounds"]
    assert "bounds are violated in 1 members" in out


def test_all_failed_is_exit_code_1(scene, call, alone):
    code, out, err = call("sweep", scene, "--vary", "solver.cfl=20,30")
    assert code == 1 and "2 failed" in out and err.count("\n") == 1 and "no member was solved" in err
    assert len(rows("results/scene/sweep.csv")) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--vary"),
        (["erosion.m"], "'erosion.m' must be written section.key=value"),
        (["erosion.m="], "'erosion.m=' must have values"),
        (["erosion.m=1,,2"], "must have values"),
        (["erosion.m=[1"], "must have values"),
        (["erosion.m=1 2"], "must have values"),
        (["erosion.m=1", "erosion.m=2"], "erosion.m is given twice"),
        (["erosion.m=1,1.0"], "erosion.m has a value twice: 1, 1"),
        (["m=1"], "'m' is not a key of a case"),
        (["cells=10"], "'cells' is not a key of a case; did you mean 'domain.cells'? it is written section.key"),
        (["a.b.c=1"], "'a.b.c' is not a key of a case"),
        ([".m=1"], "'.m' is not a key of a case"),
        (["title.x=1"], "title.x cannot be varied"),
        (["output.vtk=true"], "output.vtk cannot be varied"),
        (["erosoin.m=1"], "erosoin is not a known key; did you mean 'erosion'?"),
        (["erosion.n=1"], "[erosion] n is not a known key"),
        (["erosion.m=1,-2"], "[erosion] m = -2 must be a positive number"),
        (["erosion.m=1,heavy"], "[erosion] m = 'heavy' must be a positive number"),
        (["domain.cells=80,80.5"], "[domain] cells = 80.5 must be a whole number"),
        (["domain.cells=9" + "0" * 30], "of memory, but this machine has"),
        (["solver.method=godunov,godnov", "erosion.m=1,2"], "did you mean 'godunov'?"),
        (["solver.tolerance=1e-6"], "tolerance applies to the methods characteristics and auto"),
        (["profile.values=[0.4,1.2],[0.4]"], "values has 1"),
        (["time.end=" + ",".join(map(str, range(1, 401))), "erosion.m=" + ",".join(map(str, range(1, 401)))], "160000"),
        (["time.end=1", "--workers", "0"], "--workers 0 must be from 1 to 1000"),
        (["time.end=1", "--workers", "many"], "--workers"),
    ],
)
def test_what_cannot_be_varied(scene, call, ran, arguments, words):
    """One sentence, exit code 2, and nothing was run or written."""
    options = [part for a in arguments for part in ((a,) if a[:2] == "--" or not set(a) & set("=.") else ("--vary", a))]
    code, out, err = call("sweep", "scene.toml", *options)
    assert (code, out, err.count("\n")) == (2, "", 1) and words in err
    assert ran == [] and not Path("results").exists()


@pytest.mark.parametrize("vary", [{}, {"erosion.m": []}, {"erosion.m": 2}, {"solver.method": "godunov"}])
def test_what_the_library_refuses(scene, vary):
    with pytest.raises(hj.InputError, match=r"at least one key|one value or more|a list of values"):
        hj.sweep(scene, vary)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.5,1,2", [0.5, 1, 2]),
        ("[0.4,1.2],[0.5,1.2]", [[0.4, 1.2], [0.5, 1.2]]),
        ("godunov,conservative-eno2", ["godunov", "conservative-eno2"]),
        ('"q/(1+q)",log', ["q/(1+q)", "log"]),
        ("true, false", [True, False]),
        ("inf,law_2.py", [float("inf"), "law_2.py"]),
    ],
)
def test_values_as_they_are_typed(text, values):
    assert read_choices([f"section.key={text}"]) == {"section.key": values}


def test_what_is_done_is_not_run_again(scene, ran):
    """After an interrupt, with more values, with another title; again after a change of the case or its data."""
    vary = {"erosion.m": [0.5, 1.0, 2.0], "time.end": [0.5, 1.0]}
    whole = netcdf(hj.sweep(scene, vary))
    ran.clear()
    stop = iter([None, None, KeyboardInterrupt])

    def progress(fraction):
        if what := next(stop):
            raise what

    with pytest.raises(hj.RunError, match=r"interrupted; 3 of 6 members are stored in out/members, and --resume"):
        hj.sweep(scene, vary, folder="out", progress=progress)
    assert len(ran) == 3 and sorted(p.name for p in Path("out").iterdir()) == [RECORD, KEPT]
    ran.clear()
    resumed = hj.sweep(scene, vary, folder="out", resume=True)
    assert ran == [(1.0, 1.0), (2.0, 0.5), (2.0, 1.0)] and resumed.recalled == 3
    assert netcdf(resumed) == Path("out/sweep.nc").read_bytes() == whole

    def again(**changes):
        ran.clear()
        hj.sweep(write_case(".", **changes), vary, folder="out", resume=True)
        return len(ran)

    assert again() == 0 and again(title="Another", output={"vtk": False}) == 0
    vary["time.end"] = [0.25, 0.5, 1.0]
    assert again() == 3  # those that are new
    assert again(domain={"left": -4.0, "cells": 60}) == 9
    damaged = sorted(Path("out", KEPT).glob("*.npz"))
    damaged[0].write_bytes(b"PK\x03\x04 half")
    assert again() + again(domain={"left": -4.0, "cells": 60}) == 1
    ran.clear()
    hj.sweep(scene, vary, folder="out")
    assert len(ran) == 9 and len(list(Path("out", KEPT).iterdir())) == 9  # without resume, all anew


@pytest.mark.parametrize(("file", "before", "after", "changes"), EDITED.values(), ids=EDITED)
def test_an_edited_file_is_another_case(in_tmp, ran, file, before, after, changes):
    """Of each kind of file that a case may name: what the edited file gives comes out, and nothing that was kept."""
    (in_tmp / file).write_text(before)
    case = write_case(in_tmp, **changes)
    vary = {"time.end": [0.5]}
    old = hj.sweep(case, vary, folder="out")
    assert old.outcomes[0].done
    assert hj.sweep(case, vary, folder="out", resume=True).recalled == 1 and len(ran) == 1
    (in_tmp / file).write_text(after)
    new = hj.sweep(case, vary, folder="out", resume=True)
    assert new.recalled == 0 and len(ran) == 2
    fresh = hj.sweep(case, vary)
    assert netcdf(new) == netcdf(fresh)
    (edited,), (first,) = new.outcomes, old.outcomes
    same = np.array_equal(edited.u, first.u) and edited.quantities["K_toe"] == first.quantities["K_toe"]
    assert same == (file == "far.py")  # slopes here stay below 9, which is not the end of the table of the reference
    (in_tmp / file).write_text(before)
    assert netcdf(hj.sweep(case, vary, folder="out", resume=True)) == netcdf(old)


def test_what_a_python_file_reads_is_seen_in_its_values(in_tmp, ran):
    Path("k.py").write_text("import numpy as np\n\ndef k(t, x):\n    return 1 + np.loadtxt('k.txt') * t + 0 * x\n")
    case = write_case(in_tmp, coefficient={"kind": "python", "file": "k.py", "function": "k"})
    for number, recalled in ((0.5, 0), (0.5, 1), (0.7, 0)):
        Path("k.txt").write_text(f"{number}")
        assert hj.sweep(case, {"time.end": [0.5]}, folder="out", resume=True).recalled == recalled


def test_a_stored_run_that_changed_is_another_case(in_tmp, ran):
    law = hj.rational()
    for k, recalled in (("1", 0), ("1 + t*(0.5 - t)", 0), ("1 + t*(0.5 - t)", 1)):  # alike at t = 0 and at the end
        problem = hj.Problem(law, hj.steps([-3.0, -1.0], [0.4]), 0.5, 5, coefficient=hj.coefficient(k))
        hj.write_run(hj.solve_hj(problem, hj.Grid(-4.0, 40)), "stored", vtk=False, plots=False)
        case = write_case(in_tmp, coefficient={"kind": "run", "result": "stored"})
        assert hj.sweep(case, {"time.end": [0.5]}, folder="out", resume=True).recalled == recalled


def test_a_file_that_changes_while_a_sweep_runs(in_tmp):
    """A member is not run with another file than the one that it is kept under."""
    (in_tmp / "law.py").write_text("def f(q):\n    return q / (1 + q)\n")
    case = write_case(in_tmp, erosion={"law": "python", "file": "law.py", "function": "f"})
    result = hj.sweep(
        case, {"time.end": [0.4, 0.5]}, folder="out",
        progress=lambda done: (in_tmp / "law.py").write_text("def f(q):\n    return 2 * q / (1 + q)\n"),
    )  # fmt: skip
    assert result.outcomes[0].done and "has changed since the sweep began" in result.outcomes[1].status
    assert len(list(Path("out", KEPT).iterdir())) == 1


def test_failures_are_tried_again(scene, ran):
    vary = {"solver.cfl": [0.5, 30.0]}
    for resume in (False, True):
        hj.sweep(scene, vary, folder="out", resume=resume)
    assert ran == [(0.5,), (30.0,), (30.0,)]


def test_the_account_stays_short(scene, call, alone):
    ends = ",".join(f"{t / 100}" for t in range(1, 31))
    arguments = ["sweep", scene, "--vary", f"time.end={ends}", "--vary", "domain.cells=20", "--out", "there"]
    code, out, err = call(*arguments)
    lines = out.splitlines()
    assert (code, err) == (0, "") and len(lines) <= 20 and max(map(len, lines)) < 120
    assert lines[0] == "Zwei Knicke: 30 members, 30 done, 0 failed" and lines[-2] == "  ... and 16 more"
    assert lines[-1] == "written to there: sweep.csv, sweep.nc"
    code, out, _ = call(*arguments, "--resume")
    assert code == 0 and out.startswith("Zwei Knicke: 30 members, 30 done (30 of them in an earlier sweep), 0 failed\n")


def test_a_lost_worker(in_tmp, call):
    """As when the machine ends a process for its memory."""
    condition = "__import__('multiprocessing').parent_process() and __import__('os')._exit(9)"
    (in_tmp / "law.py").write_text(FAILING_LAW.format(condition=condition))
    write_case(in_tmp, erosion={"law": "python", "file": "law.py", "function": "f"})
    code, out, err = call("sweep", "scene.toml", "--vary", "time.end=0.5,1", "--workers", "2")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "a worker was lost" in err and "0 of 2 members are stored in results/scene/members, and --resume" in err


def descendants(pid):
    try:
        mine = [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return mine + [d for c in mine for d in descendants(c)]


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.slow)])
def test_a_sweep_that_is_stopped_loses_only_what_was_in_flight(in_tmp, call, monkeypatch, how):
    """An interrupt at a terminal reaches every process; a kill only the first. Nobody outlives it."""
    (in_tmp / "law.py").write_text(SLOW_LAW)
    law = {"law": "python", "file": "law.py", "function": "f"}
    write_case(in_tmp, erosion=law, solver={"method": "eno2"})
    ends = [round(0.5 + 0.01 * i, 2) for i in range(12)]
    arguments = ["sweep", "scene.toml", "--vary", f"time.end={','.join(map(str, ends))}", "--workers", "2"]
    command = [sys.executable, "-m", "hjprofile", *arguments]
    kept = Path("results/scene", KEPT)
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as running:
        until = time.monotonic() + 60
        while len(list(kept.glob("*.npz"))) < 2:
            assert running.poll() is None and time.monotonic() < until
            time.sleep(0.02)
        children = descendants(running.pid)
        assert len(children) >= 2
        if how == signal.SIGINT:
            os.killpg(running.pid, how)
        else:
            running.kill()
        err = running.stderr.read()
    if how == signal.SIGINT:
        assert running.returncode == 1 and err.count("\n") == 1 and "interrupted; " in err and "--resume" in err
    while any(map(alive, children)):
        assert time.monotonic() < until
        time.sleep(0.05)
    done = len(list(kept.glob("*.npz")))
    assert 2 <= done < 12 and not Path("results/scene/sweep.csv").exists()
    monkeypatch.setenv("IN_HASTE", "yes")
    monkeypatch.setattr(workers, "processes", lambda count: nullcontext())
    code, out, _ = call(*arguments, "--resume")
    assert code == 0 and f"12 done ({done} of them in an earlier sweep)" in out
    assert [float(row["time.end"]) for row in rows("results/scene/sweep.csv")] == ends
    assert [p.suffix for p in kept.iterdir()] == [".npz"] * 12


def test_an_executor_is_one(scene):
    with pytest.raises(hj.InputError, match="executor = 'folder' must be of the type Executor"):
        hj.sweep(scene, VARY, "folder")
