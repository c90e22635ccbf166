"""Whatever is read back may be damaged: it is read as it was written, or refused in one sentence."""

import csv
import io
import json
import random
import shutil
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from scipy.io import netcdf_file

import hjprofile as hj
from hjprofile.errors import InputError
from hjprofile.output import sweep_results as sweeps
from hjprofile.output.archive import pack, unpack
from hjprofile.output.folder import RECORD, Owner, ResultFolder
from hjprofile.problem.units import Units
from hjprofile.studies.sweep import members

COPIES = 30
WRONG = [None, True, "", "x", -1, 0, 1e308, float("nan"), float("inf"), 10**400, [], [1], {}, {"a": 1}, "x" * 10**6]


@lru_cache
def solved(name):
    if name == "steps":  # vertical steps, and a blow-up
        law, profile = hj.expression("q + q/(1+q)", growth="linear"), hj.kinks([-1.5, -1.2], [3.0, 5.0])
        return hj.track_fronts(hj.Problem(law, profile, end=0.5, snapshots=4), hj.Grid(-2.0, 40))
    profile = hj.kinks([-1.0, -0.7], [0.4, 1.2])  # a merge and an exit
    run = hj.solve_hj(hj.Problem(hj.rational(), profile, end=2.0, snapshots=4, title="Two kinks"), hj.Grid(-2.0, 40))
    return replace(run, units=Units(200.0, 0.25, 1000.0, 450.0, unit="m")) if name == "survey" else run


@pytest.fixture(params=["kinks", "steps", "survey"])
def stored(request, tmp_path):
    hj.write_run(solved(request.param), tmp_path / "run", vtk=False, plots=False)
    return tmp_path / "run", solved(request.param)


def damaged(data, rng):
    """A copy with bytes changed, cut off, removed, added or exchanged."""
    copy, at = bytearray(data), rng.randrange(len(data))
    match rng.randrange(5):
        case 0:
            for _ in range(rng.randint(1, 8)):
                copy[rng.randrange(len(copy))] = rng.randrange(256)
        case 1:
            del copy[at:]
        case 2:
            del copy[at : at + rng.randint(1, 50)]
        case 3:
            copy[at:at] = rng.randbytes(rng.randint(1, 50))
        case 4:
            other, size = rng.randrange(len(data)), rng.randint(1, 64)
            copy[at : at + size], copy[other : other + size] = data[other : other + size], data[at : at + size]
    return bytes(copy)


def with_wrong_value(content, rng):
    """A copy of JSON content in which a random value, at any depth, is another or is missing."""
    copy = json.loads(json.dumps(content))
    at = copy
    while True:
        key = rng.choice(list(at) if isinstance(at, dict) else range(len(at)))
        if isinstance(at[key], (dict, list)) and at[key] and rng.random() < 0.7:
            at = at[key]
            continue
        if rng.random() < 0.2:
            del at[key]
        else:
            at[key] = rng.choice(WRONG)
        return copy


def with_wrong_cell(text, rng):
    """A copy of a table with a random field that is another, a column too many, or rows exchanged."""
    rows = list(csv.reader(io.StringIO(text)))
    row = rng.choice([row for row in rows if row])
    match rng.randrange(4):
        case 0 | 1:
            row[rng.randrange(len(row))] = rng.choice(["", "nan", "-1", "1e308", "1e999", "x", "0.5", '"', "9" * 5000])
        case 2:
            row.append("1")
        case 3:
            row.pop()
    return "\n".join(",".join(row) for row in rows) + "\n"


def copies(data, rng):
    """Damaged copies of a file: of its bytes, and half of them of its values where it is text."""
    text = data.decode() if data[:3] not in (b"CDF", b"PK\x03") else ""
    for i in range(COPIES):
        if i % 2 or not text:
            yield damaged(data, rng)
        elif text[0] == "{":
            yield json.dumps(with_wrong_value(json.loads(text), rng)).encode()
        else:
            yield with_wrong_cell(text, rng).encode()


def in_one_sentence(error):
    """One for each fault of a case file."""
    faults = [str(fault) for fault in getattr(error, "faults", [error])]
    assert all(len(sentence) < 1000 and len(sentence.splitlines()) == 1 for sentence in faults)
    return True


@pytest.mark.parametrize("name", ["profile.nc", "kinks.csv", "events.csv", "vertical_steps.csv", "summary.json"])
def test_a_damaged_result_folder_is_read_or_refused(stored, name):
    """What is taken can be drawn: it has the shapes of a run, and its numbers lie within it."""
    folder, run = stored
    if not (folder / name).exists():
        pytest.skip("this run has no vertical steps")
    refused, rng, drawn = 0, random.Random(name), 0
    for data in copies((folder / name).read_bytes(), rng):
        (folder / name).write_bytes(data)
        try:
            back = hj.load_run(folder)
        except InputError as error:
            refused += in_one_sentence(error)
            continue
        assert back.u.shape == run.u.shape and np.abs(back.u - run.u).max() < 1e-6
        assert np.all(np.diff(back.time) > 0) and np.isfinite(back.K).all()
        assert all(isinstance(w, str) for w in back.warnings) and repr(back.kinks)
        if drawn < 2 and (name != "profile.nc" or not np.array_equal(back.time, run.time)):
            from hjprofile.output.plots.runs import pictures

            assert pictures(back, names=["diagram"])
            drawn += 1
    assert refused > COPIES / 4


def faulty(path, change):
    """Writes the stored run again with `change` applied to its arrays and attributes."""
    with netcdf_file(path, "r", mmap=False) as file:
        arrays = {name: np.array(v[:], dtype=float) for name, v in file.variables.items()}
        dimensions = {name: v.dimensions for name, v in file.variables.items()}
        attributes = dict(file._attributes)
    types = {}
    change(arrays, attributes, types)
    with netcdf_file(path, "w", version=2) as file:
        for name, value in attributes.items():
            setattr(file, name, value)
        for name, array in arrays.items():
            for dimension, size in zip(dimensions[name], array.shape, strict=False):
                if dimension not in file.dimensions:
                    file.createDimension(dimension, size)
                elif file.dimensions[dimension] != size:
                    dimensions[name] = tuple(f"{d}_{name}" if d == dimension else d for d in dimensions[name])
                    file.createDimension(f"{dimension}_{name}", size)
            file.createVariable(name, types.get(name, "f8"), dimensions[name][: array.ndim])[:] = array


def put(name, at, value):
    return lambda arrays, *_: arrays[name].__setitem__(at, value)


def replaced(name, make):
    return lambda arrays, *_: arrays.update({name: make(arrays[name])})


def said(name, value):
    return lambda _, attributes, __: attributes.update({name: value})


FAULTS = {
    "a wrong shape": replaced("u", lambda u: u[:, :-1]),
    "one dimension": replaced("K", lambda K: K[0]),
    "a time too few": replaced("time", lambda t: t[:-1]),
    "times reversed": replaced("time", lambda t: t[::-1]),
    "times zero": replaced("time", np.zeros_like),
    "times equal": put("time", 2, 0.0),
    "a negative time": put("time", 0, -1.0),
    "no times": lambda arrays, *_: arrays.update({n: a[:0] for n, a in arrays.items() if n not in ("x", "x_cell")}),
    "x reversed": replaced("x", lambda x: x[::-1]),
    "uneven x": put("x", 3, -1.9),
    "other midpoints": replaced("x_cell", lambda x: x + 0.01),
    "q at -1": put("q", (0, 0), -1.0),
    "q of another run": replaced("q", lambda q: q * 1.001),
    "K negative": put("K", (1, 1), -1.0),
    "single precision": lambda arrays, attributes, types: types.update(u="f4"),
    "whole numbers": lambda arrays, attributes, types: types.update(time="i4"),
    "a case that is no table": said("case", b"erosion = 3\n"),
    "a law that is no table": said("case", b"erosion = 3\n[profile]\n[domain]\n[time]\n[solver]\nmethod = 'fronts'\n"),
    "a law that is none": said("case", b"[erosion]\nlaw = 7\n[profile]\n[domain]\n[time]\n[solver]\nmethod = 'x'\n"),
    "a method that is a number": said("method", 3),
    "a status that is a list": said("status", np.arange(3.0)),
    "a length that is text": said("length", b"long"),
    **{f"{value} in {name}": put(name, -1, value) for name in ("time", "x", "x_cell", "u", "q", "K")
       for value in (np.nan, np.inf, 1e308)},
}  # fmt: skip


OF_ARRAYS = {fault for fault in FAULTS if not fault.startswith(("a case", "a law", "a method", "a status", "a length"))}


@pytest.mark.parametrize("fault", FAULTS)
def test_commands_refuse_a_faulty_folder(tmp_path, call, fault):
    hj.write_run(solved("kinks"), tmp_path / "run", vtk=False, plots=False)
    shutil.copytree(tmp_path / "run", tmp_path / "sound")
    with np.errstate(all="ignore"):
        faulty(tmp_path / "run" / "profile.nc", FAULTS[fault])
    folder, sound = tmp_path / "run", tmp_path / "sound"
    for command in (["plot", folder], ["export", folder, "--vtk"], ["compare", sound, folder], ["animate", folder]):
        code, out, err = call(*command)
        assert (code, out, err.count("\n")) == (2, "", 1) and "is not a readable result folder" in err
    if fault in OF_ARRAYS:
        with pytest.raises(InputError):
            hj.stored_coefficient(folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [("title", "x" * 10**6), ("cells", 41), ("supplied", 1.0), ("status", "stopped"), ("steps", -1), ("warnings", [3])],
)
def test_a_summary_that_is_not_of_the_run_is_refused(stored, key, value):
    path = stored[0] / "summary.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(InputError, match="is not a readable result folder") as refused:
        hj.load_run(stored[0])
    assert in_one_sentence(refused.value)


def test_a_damaged_coefficient_is_read_or_refused(tmp_path):
    hj.write_run(solved("kinks"), tmp_path, vtk=False, plots=False)
    path, run, refused = tmp_path / "profile.nc", solved("kinks"), 0
    for data in copies(path.read_bytes(), random.Random(3)):
        path.write_bytes(data)
        try:
            k = hj.stored_coefficient(tmp_path)
        except InputError as error:
            refused += in_one_sentence(error)
        else:
            assert k.left == run.x[0] and np.isfinite(k.values(k.end, run.x)).all()
    assert refused > COPIES / 4


CASE = {
    "erosion": {"law": "power", "m": 1.0},
    "profile": {"kind": "steps", "edges": [-3.0, -2.0, -1.0], "values": [0.4, 1.2]},
    "domain": {"left": -4.0, "cells": 40},
    "time": {"end": 0.2, "snapshots": 2},
}


def test_a_damaged_member_is_computed_again(in_tmp):
    Path("case.toml").write_text(tomli_w.dumps(CASE))
    vary = {"erosion.m": [0.5, 2.0]}
    whole = hj.sweep("case.toml", vary, folder="out")
    first, second = members("case.toml", vary)
    kept, other = (Path("out/members", f"{m.identity}.npz") for m in (first, second))
    good, again, expected = kept.read_bytes(), 0, repr(whole.outcomes[0])
    for data in [*copies(good, random.Random(4)), b"", other.read_bytes()]:
        kept.write_bytes(data)
        outcome = sweeps._recall(kept.parent, first)
        again += outcome is None
        assert outcome is None or repr(outcome) == expected
    assert again > COPIES / 2
    resumed = hj.sweep("case.toml", vary, folder="out", resume=True)
    assert resumed.recalled == 1 and sweeps.netcdf(resumed) == sweeps.netcdf(whole)


@pytest.mark.parametrize("method", [0, 8, 12, 14, 99])
@pytest.mark.parametrize("flags", [0, 1, 32, 64])
def test_an_archive_with_other_headers_is_damaged(tmp_path, flags, method):
    """Members that are marked as encrypted, patched or compressed raise many types of exceptions in the library."""
    path, arrays = tmp_path / "archive.npz", {"q": np.arange(6.0), "identity": np.array("text")}
    data = bytearray(pack(arrays))
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        start = -1
        while (start := data.find(mark, start + 1)) >= 0:
            data[start + at] |= flags
            data[start + at + 2] = method
    path.write_bytes(data)
    if flags == method == 0:
        assert unpack(path).keys() == arrays.keys()
    else:
        with pytest.raises(ValueError, match=r"^[A-Za-z.]+$"):
            unpack(path)


def test_arrays_that_were_not_written_are_no_archive(tmp_path):
    """Not even if the file itself is sound: a shape, a type or a value is another."""
    arrays = {"q": np.arange(6.0).reshape(2, 3), "identity": np.array("text")}
    path = tmp_path / "archive.npz"
    path.write_bytes(pack(arrays))
    back = unpack(path)
    assert back.keys() == arrays.keys() and all(np.array_equal(back[n], arrays[n]) for n in arrays)
    with np.load(path) as file:
        content = dict(file)
    for change in (
        {"q": np.arange(6.0)},
        {"q": np.arange(6).reshape(2, 3)},
        {"p": np.zeros(2)},
        {"digest": np.zeros(3)},
    ):
        np.savez(path, **content | change)
        with pytest.raises(ValueError, match="other arrays than were written"):
            unpack(path)


@pytest.mark.parametrize("name", ["hillslope.toml", "hillslope.csv", "two_kinks.toml"])
def test_a_damaged_case_or_survey_is_taken_or_refused(tmp_path, name):
    shipped = hj.shipped_cases()["hillslope"].parent
    for file in shipped.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    path = tmp_path / name
    case = path.with_suffix(".toml")
    for data in copies(path.read_bytes(), random.Random(name)):
        path.write_bytes(data)
        try:
            hj.load_case(case)
        except InputError as error:
            assert in_one_sentence(error)


def test_a_damaged_record_is_none(tmp_path):
    """It can hide which files are whose, but no file of the user's is removed by it."""
    owner = Owner((str(tmp_path / "case.toml"),), "0" * 64)
    ResultFolder(tmp_path, owner).open().write({"check.json": "{}", "vtk/profile.pvd": "x"})
    (tmp_path / "notes.csv").write_text("mine")
    for data in copies((tmp_path / RECORD).read_bytes(), random.Random(5)):
        (tmp_path / RECORD).write_bytes(data)
        place = ResultFolder(tmp_path, Owner(("other",), "1")).open()
        assert not {name for name in place.files | place.stale if ".." in name or name[0] == "/"}
        place.write({"chart.csv": "x"})
        assert (tmp_path / "notes.csv").exists()
