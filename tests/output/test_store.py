"""A result folder: what is in it, that it comes back as it was, and that nothing in it is ever half written."""

import csv
import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import tomllib
from concurrent.futures import BrokenExecutor, Future
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import xarray
from scipy.io import netcdf_file

import hjprofile
from hjprofile.errors import InputError
from hjprofile.files import write_whole
from hjprofile.output import store
from hjprofile.output.folder import RECORD, Owner, ResultFolder, owner_of_run
from hjprofile.output.store import load_run, summary, to_json, write_results, write_run
from hjprofile.problem.case import parse_case
from hjprofile.problem.units import Units
from hjprofile.solvers.solve import solve_case

KINKS = {
    "title": "Zwei Knicke, α = 1",  # attributes of a netCDF file are bytes
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -4.0, "cells": 160},
    "time": {"end": 4.0, "snapshots": 7},
}
BUMP = {"kind": "bumps", "amplitudes": [0.9], "centres": [-2.0], "widths": [0.4]}
SURVEY = {"kind": "survey", "file": "slope.csv", "critical_slope": 0.6, "length": 123.4, "repair": "isotonic"}
SCENES = {
    "kinks": KINKS,  # a merge and an exit
    "bump": KINKS | {"profile": BUMP, "title": ""},  # a birth
    "survey": KINKS | {"profile": SURVEY, "domain": {"left": -4.0, "cells": 100}},
    "failed": KINKS | {"solver": {"method": "godunov", "cfl": 2.5}},
}
PICTURES = {"profile.png", "diagram.png", "factor.png", "norms.png"}
FILES = {"profile.nc", "kinks.csv", "events.csv", "norms.csv", "summary.json"} | PICTURES


@lru_cache
def solved(name, folder=None):
    return solve_case(parse_case(SCENES[name], name, name, folder))


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Where the survey lies. It descends between x = 200 and 300."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "slope.csv").write_text("x,height\n0.1,5\n100,40\n200,90\n300,80\n400.3,233.3\n")
    return folder


@pytest.fixture(params=SCENES)
def run(request, home):
    return solved(request.param, home)


@pytest.fixture(autouse=True)
def pictures(monkeypatch):
    """Stand-ins: the true ones take most of the time here, and have tests of their own."""
    drawn = "hjprofile.output.plots.runs.pictures"
    monkeypatch.setattr(drawn, lambda run, names: {f"{name}.png": b"P" for name in names})


def names(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file() and path.name != RECORD}


def snapshots(count):
    return {f"vtk/{kind}_{i:04d}.vtp" for kind in ("profile", "kinks") for i in range(count)} | {
        "vtk/profile.pvd", "vtk/kinks.pvd", "vtk/sheet.vtr"
    }  # fmt: skip


def test_the_scenes_hold_what_the_tests_need(home):
    events = {name: {e.event for e in solved(name, home).events} for name in SCENES}
    assert events["kinks"] == {"merge", "exit"} and "birth" in events["bump"]
    assert {name for name in SCENES if not solved(name, home).done} == {"failed"}
    assert solved("survey", home).account.startswith("survey repaired")


def test_every_file_is_there(run, tmp_path):
    folder = tmp_path / "deep" / "results"
    written = write_run(run, folder)
    survey = {"survey.csv"} if run.units else set()
    assert (
        names(folder)
        == FILES | survey | snapshots(run.time.size)
        == {p.relative_to(folder).as_posix() for p in written}
    )


@pytest.mark.parametrize(
    ("vtk", "plots", "expected"),
    [
        (False, False, FILES - PICTURES),
        (False, True, FILES),
        (True, False, FILES - PICTURES | snapshots(7)),
    ],
)
def test_vtk_and_plots_can_be_left_out(tmp_path, vtk, plots, expected):
    write_run(solved("kinks"), tmp_path, vtk=True, plots=True)  # what an earlier run left must go
    (tmp_path / "notes.txt").write_text("mine")
    write_run(solved("kinks"), tmp_path, vtk=vtk, plots=plots)
    assert names(tmp_path) == expected | {"notes.txt"}


def test_a_shorter_run_leaves_no_stale_snapshots(tmp_path):
    write_run(solved("kinks"), tmp_path, plots=False)
    run = solved("failed")
    assert run.time.size < solved("kinks").time.size
    write_run(run, tmp_path)
    assert names(tmp_path) == FILES | snapshots(run.time.size)


def test_netcdf_in_xarray(run, tmp_path):
    write_run(run, tmp_path, vtk=False, plots=False)
    with xarray.open_dataset(tmp_path / "profile.nc") as data:
        assert dict(data.sizes) == {"time": run.time.size, "node": run.cells + 1, "cell": run.cells}
        shapes = {
            "time": ("time",), "x": ("node",), "x_cell": ("cell",),
            "u": ("time", "node"), "q": ("time", "cell"), "K": ("time", "node"),
        }  # fmt: skip
        of_surveys = {
            "supplied_volume": ("time",), "distance": ("node",), "distance_cell": ("cell",), "height": ("time", "node")
        }  # fmt: skip
        assert {name: data[name].dims for name in data.variables} == shapes | (of_surveys if run.units else {})
        for name in shapes:
            assert data[name].dtype == np.float64
            assert np.array_equal(data[name].values, getattr(run, name)), name  # bitwise
            assert data[name].attrs["long_name"] and data[name].attrs["units"] == "1"
        assert (data["time"].attrs["axis"], data["x"].attrs["axis"]) == ("T", "X")
        assert data.attrs["Conventions"].startswith("CF-")
        assert (data.attrs["title"].strip(), data.attrs["method"]) == (run.title, run.method)
        assert data.attrs["hjprofile_version"] == hjprofile.__version__
        assert tomllib.loads(data.attrs["case"]) == run.case
        numbers = ("length", "critical_slope", "x_top", "height_top")
        back = {name: float(data.attrs[name]) for name in numbers if name in data.attrs}
    # 0.6, 123.4, 400.3 and 233.3 are no single-precision numbers (and equal to one only as a Python float)
    assert back == ({name: getattr(run.units, name) for name in numbers} if run.units else {})
    assert data.attrs.get("uphill") == ("right" if run.units else None)


@pytest.mark.parametrize("unit", ["", "m", "Fuß"])
def test_a_run_of_a_survey_has_fields_in_its_unit(home, tmp_path, unit):
    """Closed forms of the stored x, u and time, to the last bit; CF has no `units` where they are not known."""
    run = solved("survey", home)
    length, slope, top, height = 123.4, 0.6, 400.3, 233.3
    run = dataclasses.replace(run, units=dataclasses.replace(run.units, unit=unit))
    write_run(run, tmp_path, vtk=False, plots=False)
    with xarray.open_dataset(tmp_path / "profile.nc") as data:
        assert np.array_equal(data.distance, top + length * run.x)
        assert np.array_equal(data.distance_cell, top + length * run.x_cell)
        assert np.array_equal(data.height, height + length * slope * run.u)
        assert np.array_equal(data.supplied_volume, length**2 * slope * run.time)
        units = {name: data[name].attrs.get("units") for name in ("distance", "distance_cell", "height")}
        assert set(units.values()) == {unit or None}
        assert data.supplied_volume.attrs.get("units") == (f"{unit}2" if unit else None)
        assert set(data.coords) == {"time", "x", "x_cell", "distance", "distance_cell", "supplied_volume"}
        assert set(data.u.coords) == {"time", "x", "distance", "supplied_volume"} == set(data.height.coords)
        assert set(data.q.coords) == {"time", "x_cell", "distance_cell", "supplied_volume"}
        xarray.testing.assert_identical(run.to_xarray(), data.swap_dims(node="x", cell="x_cell"))
    back = load_run(tmp_path)
    assert back.units == run.units
    stored = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["units"]
    numbers = {"length": length, "critical_slope": slope, "x_top": top, "height_top": height}
    assert stored == numbers | {"unit": unit, "uphill": "right", "volume_of_one": length**2 * slope}


def test_a_folder_without_the_columns_of_a_survey_is_read(home, tmp_path):
    """It was written by an older version."""
    run = solved("survey", home)
    write_run(run, tmp_path, vtk=False, plots=False)
    for name, count in (("kinks.csv", 4), ("events.csv", 2)):
        old = "".join(",".join(row[:-count]) + "\n" for row in rows(tmp_path / name))
        (tmp_path / name).write_text(old)
    back = load_run(tmp_path)
    assert back.events == list(run.events) and [k[:6] for k in back.kinks] == [k[:6] for k in run.kinks]
    (tmp_path / "kinks.csv").write_text((tmp_path / "kinks.csv").read_text()[1:])
    with pytest.raises(InputError, match="must have the columns time, kink, x"):
        load_run(tmp_path)


def test_the_name_of_a_unit_may_not_be_a_text(home, tmp_path):
    run = solved("survey", home)
    write_run(dataclasses.replace(run, units=dataclasses.replace(run.units, unit="m" * 101)), tmp_path, plots=False)
    with pytest.raises(InputError, match="the name of a unit has more than 100 characters"):
        load_run(tmp_path)


def test_fields_may_exceed_two_gigabytes(tmp_path):
    """netCDF-3 allows it along the unlimited dimension only: 900,000 cells at 300 times are 2.01 GiB (written once)."""
    write_run(solved("kinks"), tmp_path, vtk=False, plots=False)
    with netcdf_file(tmp_path / "profile.nc", mmap=False) as file:
        assert file.dimensions["time"] is None
        assert {name for name, variable in file.variables.items() if variable.isrec} == {"time", "u", "q", "K"}


@pytest.mark.parametrize("name", SCENES)
def test_the_case_in_the_netcdf_runs_again(home, tmp_path, name):
    run = solved(name, home)
    write_run(run, tmp_path, vtk=False, plots=False)
    with xarray.open_dataset(tmp_path / "profile.nc") as data:
        again = solve_case(parse_case(tomllib.loads(data.attrs["case"]), name, name, home))
        assert np.array_equal(again.u, data["u"].values) and np.array_equal(again.q, data["q"].values)
        assert again.status == run.status


def rows(path):
    with open(path, newline="") as stream:
        return list(csv.reader(stream))


def test_tables(run, tmp_path):
    write_run(run, tmp_path, vtk=False, plots=False)
    header, *kinks = rows(tmp_path / "kinks.csv")
    in_units = ",time_survey,x_survey,slope_left,slope_right" if run.units else ""
    assert ",".join(header) == f"time,kink,x,q_left,q_right,jump,speed,rankine_hugoniot_speed{in_units}"
    values = np.array([[float(v or "nan") for v in row] for row in kinks])
    np.testing.assert_array_equal(values[:, :8], np.array(run.kinks, dtype=float))  # bitwise, with NaN for NaN
    assert all(row[1].isdigit() for row in kinks)
    header, *events = rows(tmp_path / "events.csv")
    assert ",".join(header) == "time,event,kink,into,x" + (",time_survey,x_survey" if run.units else "")
    assert [(float(t), e, int(k), int(i) if i else None, float(x)) for t, e, k, i, x, *_ in events] == list(run.events)
    if run.units:  # closed forms, to the last bit
        volume, (time, _, x, left, right, *_) = 123.4**2 * 0.6, values.T
        expected = volume * time, 400.3 + 123.4 * x, 0.6 * (1.0 + left), 0.6 * (1.0 + right)
        np.testing.assert_array_equal(values[:, 8:].T, expected)
        found = [[float(value) for value in row[5:]] for row in events]
        assert found == [[volume * e.time, 400.3 + 123.4 * e.x] for e in run.events]


def test_vertical_steps_in_the_unit_of_a_survey(tmp_path):
    law, profile = hjprofile.expression("q + q/(1+q)", growth="linear"), hjprofile.kinks([-1.5, -1.2], [3.0, 5.0])
    run = hjprofile.track_fronts(hjprofile.Problem(law, profile, end=0.5, snapshots=4), hjprofile.Grid(-2.0, 40))
    write_run(dataclasses.replace(run, units=Units(10.0, 0.5, 30.0, 7.0)), tmp_path, vtk=False, plots=False)
    header, *steps = rows(tmp_path / "vertical_steps.csv")
    assert ",".join(header) == "time,step,x,height,speed,time_survey,x_survey,height_survey" and steps
    for row, step in zip(steps, run.vertical_steps, strict=True):
        assert [float(value) for value in row[5:]] == [50.0 * step.time, 30.0 + 10.0 * step.x, 5.0 * step.height]
    np.testing.assert_equal(load_run(tmp_path).vertical_steps, run.vertical_steps)


def strict(text):
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def test_summary(run, tmp_path):
    write_run(run, tmp_path, vtk=False, plots=False)
    content = strict((tmp_path / "summary.json").read_text(encoding="utf-8"))
    for name in ("title", "method", "status", "cells", "steps", "wall_seconds", "eroded_volume"):
        assert content[name] == getattr(run, name), name
    # one division in each direction: exact to a few roundings
    assert content["cell_updates_per_second"] * run.wall_seconds == pytest.approx(run.steps * run.cells, rel=1e-14)
    assert content["bounds"].keys() == run.bounds.keys() and len(run.bounds) >= 4
    for name, bound in content["bounds"].items():
        verdict = run.bounds[name]
        assert isinstance(bound["holds"], bool) and bound["holds"] == verdict.holds
        assert (bound["worst_margin"], bound["time"]) == (verdict.worst_margin, verdict.time)


def test_summary_without_a_number():
    """What is not finite becomes null: NaN and Infinity are no JSON."""
    run = solved("kinks")
    bounds = {name: b._replace(worst_margin=np.float64(-np.inf)) for name, b in run.bounds.items()}
    lost = dataclasses.replace(run, wall_seconds=0.0, eroded_volume=np.nan, bounds=bounds)
    content = strict(to_json(summary(lost)))
    assert content["cell_updates_per_second"] is content["eroded_volume"] is None
    assert {b["worst_margin"] for b in content["bounds"].values()} == {None}


def assert_same(first, second):
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if field.name in ("kinks", "events", "bounds"):  # NaN where a speed or a place is not known
            assert list(map(str, a)) == list(map(str, b)), field.name
            assert field.name != "bounds" or str(dict(a)) == str(dict(b))
        elif field.name in ("law", "stop"):  # a function; a reason, whose sentence is the status
            assert a is None
        elif field.name == "surveyed":
            assert (a is None) == (b is None) and (a is None or np.array_equal(a, b))
        elif isinstance(a, np.ndarray):
            assert np.array_equal(a, b) and a.dtype == b.dtype, field.name
        else:
            assert a == b, field.name


def test_a_run_comes_back_as_it_was(run, tmp_path):
    write_run(run, tmp_path, vtk=False, plots=False)
    assert_same(load_run(tmp_path), run)
    np.testing.assert_array_equal(load_run(str(tmp_path)).kinks_at(-1), run.kinks_at(-1))  # NaN for NaN


def test_a_run_with_gaps_comes_back(tmp_path):
    """No bounds, no volume, a kink that was seen once: the numbers come back as NaN."""
    run = solved("kinks")
    kinks = [run.kinks[0]._replace(speed=np.nan)]
    write_run(dataclasses.replace(run, kinks=kinks, bounds={}, eroded_volume=np.nan), tmp_path, False, False)
    back = load_run(tmp_path)
    assert np.isnan([back.kinks[0].speed, back.eroded_volume, back.volume_budget_error]).all()
    assert dict(back.bounds) == {}


def test_two_writings_are_the_same_bytes(home, tmp_path):
    for folder in ("a", "b"):
        write_run(solved("survey", home), tmp_path / folder)
    for name in names(tmp_path / "a"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


@pytest.mark.parametrize("name", ["profile.nc", "kinks.csv", "events.csv", "summary.json"])
def test_a_folder_with_a_missing_or_broken_file_is_refused(tmp_path, name):
    write_run(solved("kinks"), tmp_path, vtk=False, plots=False)
    whole = (tmp_path / name).read_bytes()
    broken = [b"\xff\xfe\x00", b"[]" if name == "summary.json" else b"a,b\n1,2\n"]
    if name == "profile.nc":
        broken += [whole[:size] for size in range(0, 3000, 61)] + [whole[:-1]]
        broken += [whole.replace(b"[erosion]", b"[erosion", 1) + b"\0"]  # a case that is no TOML
    if name == "summary.json":
        broken += [whole[:size] for size in range(0, 60, 7)] + [b"{}", b"null"]
    for content in broken:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="is not a readable result folder"):
            load_run(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(InputError, match=f"is not a complete result folder: {name} is missing"):
        load_run(tmp_path)


def full(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("call", ["fsync", "replace", "chmod"])
@pytest.mark.parametrize("older", [None, b"older"])
def test_a_write_that_fails_leaves_nothing_half(tmp_path, monkeypatch, call, older):
    path = tmp_path / "profile.nc"
    if older:
        path.write_bytes(older)
    monkeypatch.setattr(os, call, full)
    with pytest.raises(OSError, match="No space left") as failure:
        write_whole(path, b"newer")
    assert failure.value.filename == str(path)
    assert names(tmp_path) == ({"profile.nc"} if older else set())
    assert not older or path.read_bytes() == older


def test_a_write_that_is_interrupted_leaves_nothing_half(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "new", "text")
    assert names(tmp_path) == set()


def test_nobody_sees_half_a_file(tmp_path, monkeypatch):
    """Up to the moment of the replacement the final name holds the older file, and then all of the new one."""
    path, seen = tmp_path / "kinks.csv", []
    path.write_text("older")
    replace = os.replace

    def watched(beside, final):
        seen.append((path.read_text(), Path(beside).read_text(), Path(beside).parent))
        replace(beside, final)

    monkeypatch.setattr(os, "replace", watched)
    write_whole(path, "häufig\n")
    assert seen == [("older", "häufig\n", tmp_path)]  # beside it: a rename across disks is a copy
    assert path.read_text(encoding="utf-8") == "häufig\n" and names(tmp_path) == {"kinks.csv"}


@pytest.mark.parametrize("after", range(8))
def test_a_disk_that_fills_up_leaves_a_run_or_none(tmp_path, monkeypatch, after):
    """Files are whole and of one run: it can be loaded once its summary is there, and not before."""
    whole = tmp_path / "whole"
    write_run(solved("kinks"), whole, vtk=False)
    write_run(solved("failed"), tmp_path / "cut", vtk=False)
    left = iter([os.fsync] * after)
    monkeypatch.setattr(os, "fsync", lambda handle: next(left, full)(handle))
    with pytest.raises(OSError, match="No space left"):
        write_run(solved("kinks"), tmp_path / "cut", vtk=False)
    there = names(tmp_path / "cut")
    assert not [name for name in there if name.startswith(".")]
    for name in there - {"summary.json"}:  # which holds a clock's reading
        assert (tmp_path / "cut" / name).read_bytes() == (whole / name).read_bytes()
    if "summary.json" in there:
        assert_same(load_run(tmp_path / "cut"), solved("kinks"))
    else:
        with pytest.raises(InputError, match=r"is not a complete result folder"):
            load_run(tmp_path / "cut")
    assert ("summary.json" in there) == (after > 5)  # record, profile.nc, 3 tables, summary.json


def test_a_disk_that_is_really_full(tmp_path):
    """profile.nc fits on a disk of 64 kB, the pictures do not."""
    if not shutil.which("unshare"):
        pytest.skip("no unshare")
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(KINKS | {"output": {"vtk": False}}), encoding="utf-8")
    (tmp_path / "disk").mkdir()
    solved("kinks")  # compiles, so that no cache is written below
    script = (
        "mount -t tmpfs -o size=64k none disk || exit 77; echo mounted;"
        f"{sys.executable} -m hjprofile run scene.toml --out disk/out; code=$?; ls -A disk/out; exit $code"
    )
    done = subprocess.run(["unshare", "-rm", "sh", "-c", script], cwd=tmp_path, capture_output=True, text=True)
    if not done.stdout.startswith("mounted"):
        pytest.skip("not allowed to mount a disk")
    assert done.returncode == 1
    assert done.stderr.startswith("hjprofile: disk/out/profile.png: No space left on device")
    assert done.stderr.count("\n") == 1
    data = ["events.csv", "kinks.csv", "norms.csv", "profile.nc", "summary.json"]
    assert done.stdout.split() == ["mounted", RECORD, *data]  # what is optional costs the run nothing


class LostHelper:
    """An executor whose process has died."""

    def __init__(self, at_once):
        self.at_once = at_once

    def submit(self, function, *arguments):
        if self.at_once:
            raise BrokenExecutor("killed")
        future = Future()
        future.set_exception(BrokenExecutor("killed"))
        return future


@pytest.mark.parametrize("at_once", [False, True])
def test_pictures_are_drawn_even_if_the_helper_is_lost(tmp_path, at_once):
    problem = hjprofile.Problem(hjprofile.rational(), hjprofile.kinks([-1.0], [0.5]), end=0.1, snapshots=2)
    run = hjprofile.solve_hj(problem, hjprofile.Grid(-2.0, 50))
    place = ResultFolder(tmp_path, owner_of_run(run.case)).open()
    _, files = write_results(run, place, vtk=False, plots=True, helper=LostHelper(at_once))
    assert {tmp_path / "profile.png", tmp_path / "diagram.png"} <= set(files)


class DrawnHere:
    """An executor that is this process."""

    def submit(self, function, *arguments):
        future = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the helper is a fork")
@pytest.mark.parametrize("killed", [False, True])
def test_a_fork_of_the_helper_draws_half_of_the_pictures(tmp_path, monkeypatch, killed):
    run, files, this = solved("kinks"), {}, os.getpid()
    drawn_by = tmp_path / "drawn_by"

    def picture(run, name, here=store._picture):
        with drawn_by.open("a") as file:
            file.write(f"{os.getpid()}\n")
        if killed and os.getpid() != this:
            os._exit(1)
        return here(run, name)

    monkeypatch.setattr(store, "_picture", picture)
    for helper in (DrawnHere(), None):
        place = ResultFolder(tmp_path / str(helper is None), owner_of_run(run.case)).open()
        written = write_results(run, place, vtk=False, plots=True, helper=helper)[1]
        files[helper] = {file.name: file.read_bytes() for file in written if file.suffix == ".png"}
    shared, alone = files.values()
    assert alone == shared and len(alone) == 4
    by_others = [int(line) != this for line in drawn_by.read_text().split()]
    # the fork dies at its first picture; this process then draws all four
    assert sum(by_others) == (1 if killed else 2)
    assert len(by_others) == (2 + 1 + 4 + 4 if killed else 4 + 4)


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
def test_a_fork_does_not_outlive_the_helper(tmp_path):
    """Its result exceeds the buffer of the pipe, from which nobody reads any more."""
    script = (
        "import os, signal, sys\n"
        "from hjprofile.output.workers import by_a_fork\n"
        "def work():\n"
        "    print(os.getpid(), flush=True)\n"
        "    return bytes(10_000_000)\n"
        "by_a_fork(work)\n"
        "sys.stdin.read(1)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", script], **streams) as helper:
        fork = int(helper.stdout.readline())
        assert Path(f"/proc/{fork}").exists()
        helper.stdin.write("x")
        helper.stdin.flush()
        try:
            _, err = helper.communicate(timeout=20)  # ends when the fork has closed its copies of the streams
        except subprocess.TimeoutExpired:
            os.kill(fork, signal.SIGKILL)
            raise
    assert helper.returncode == -signal.SIGKILL and err == ""


def test_halves_that_a_killed_run_left_are_removed(tmp_path):
    (tmp_path / "vtk").mkdir()
    halves = [".profile.nc.k3_9abcd", ".checkpoint.npz.00000000", "vtk/.profile_0003.vtp.abcdefgh"]
    others = [".profile.nc", ".gitignore", "notes.csv", ".notes.csv.swp", "vtk/.hidden"]
    for name in halves + others:
        (tmp_path / name).write_text("x")
    ResultFolder(tmp_path, Owner((), "")).open()
    left = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert left == set(others)
