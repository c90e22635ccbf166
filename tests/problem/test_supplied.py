"""The supplied volume in the unit of a survey, in place of the dimensionless end."""

import dataclasses

import numpy as np
import pytest
import tomli_w

import hjprofile as hj
from hjprofile.problem.case import parse_case, resolved_case
from hjprofile.problem.case_keys import with_values
from hjprofile.problem.identity import digest_of
from hjprofile.problem.units import Units
from hjprofile.studies.sweep import members

LENGTH, CRITICAL, SUPPLIED = 150.0, 0.4, 4500.0
VOLUME = LENGTH**2 * CRITICAL  # of one unit of t
CONTENT = {
    "profile": {"kind": "survey", "file": "slope.csv", "critical_slope": CRITICAL, "length": LENGTH},
    "erosion": {"law": "rational"},
    "domain": {"left": -3.0, "cells": 60},
    "time": {"supplied": SUPPLIED, "snapshots": 3},
}


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "slope.csv").write_text("x,height\n100,10\n200,30\n300,95\n500,155\n")

    def write(**time):
        content = CONTENT | {"time": time or CONTENT["time"]}
        (tmp_path / "scene.toml").write_text(tomli_w.dumps(content))
        return tmp_path / "scene.toml"

    return write


def test_a_supplied_volume_is_the_end_times_the_unit_of_volume(scene):
    case = hj.load_case(scene())
    assert case.supplied == SUPPLIED and case.problem.end == SUPPLIED / VOLUME == 0.5
    assert case.problem.times.tolist() == [0.0, 0.25, 0.5]
    assert hj.load_case(scene(end=0.5)).supplied is None
    listed = hj.load_case(scene(supplied=SUPPLIED, snapshots=[0.1, 0.5]))
    assert listed.problem.times.tolist() == [0.1, 0.5]  # saved times are dimensionless
    assert hj.load_case(scene(supplied=0)).problem.end == 0.0


def test_the_stored_case_has_the_end(scene):
    """It repeats the run, and is the same run for checkpoints and sweeps."""
    case = hj.load_case(scene())
    table = resolved_case(case.problem, case.grid, case.method, case.cfl)
    assert table["time"] == {"end": 0.5, "snapshots": 3}
    again = parse_case(table, "again", "again", scene().parent)
    assert digest_of(again) == digest_of(hj.load_case(scene(end=0.5, snapshots=3))) == digest_of(case)


@pytest.mark.parametrize(
    ("time", "overrides", "end"),
    [
        ({"supplied": SUPPLIED}, {"time.end": 2.0}, 2.0),
        ({"end": 2.0}, {"time.supplied": SUPPLIED}, 0.5),
        ({"supplied": SUPPLIED}, {"time.supplied": 2 * SUPPLIED}, 1.0),
        ({"supplied": SUPPLIED}, {"profile.length": 2 * LENGTH}, 0.125),  # the same volume
        ({"supplied": SUPPLIED}, {"profile.critical_slope": 2 * CRITICAL}, 0.25),
        ({"end": 2.0}, {"profile.length": 2 * LENGTH}, 2.0),  # four times the volume
    ],
)
def test_each_of_end_and_supplied_replaces_the_other(scene, time, overrides, end):
    path = scene(**time)
    assert hj.load_case(path, overrides).problem.end == pytest.approx(end, rel=1e-15)
    (member,) = members(path, {key: [value] for key, value in overrides.items()})
    found = parse_case(member.content, "scene", "scene", path.parent).problem.end
    assert found == pytest.approx(end, rel=1e-15)  # a sweep and an override agree


def test_the_option_end_of_the_command_replaces_the_volume(scene, call, tmp_path):
    code, _, error = call("run", scene(), "--end", "0.1", "--cells", "20", "--out", tmp_path / "out")
    assert (code, error) == (0, "") and hj.load_run(tmp_path / "out").time[-1] == 0.1


def test_with_values_changes_a_copy():
    content = {"time": {"end": 1.0}}
    assert with_values(content, {"time.supplied": 2.0}) == {"time": {"supplied": 2.0}} and content["time"] == {
        "end": 1.0
    }
    both = with_values(content, {"time.supplied": 2.0, "time.end": 3.0})
    assert both == {"time": {"supplied": 2.0, "end": 3.0}}  # which the case rejects


BAD = {
    "both": (CONTENT, {"end": 1.0, "supplied": 2.0}, "end and supplied are both given; a case has one of them"),
    "none": (CONTENT, {"snapshots": 3}, "end is missing; it must be a finite number"),
    "misspelt": (CONTENT, {"suplied": 3.0}, "suplied is not a known key; did you mean 'supplied'?"),
    "negative": (CONTENT, {"supplied": -1.0}, "supplied = -1.0 must be a number, 0 or more, from 1e-300 to 1e36"),
    "too much": (
        CONTENT,
        {"supplied": 1e30},
        "supplied = 1e+30 is end = 1.11111e+26 in units of length² critical_slope",
    ),
    "text": (CONTENT, {"supplied": "30840"}, "supplied = '30840' must be a finite number (without quotes)"),
    "no units": (
        CONTENT | {"profile": {"kind": "kinks", "positions": [-1.0], "amplitudes": [1.0]}},
        {"supplied": 3.0},
        "supplied = 3 needs a profile with units, as a survey has them; state end, which is dimensionless",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_supply_is_rejected(scene, name):
    content, time, words = BAD[name]
    with pytest.raises(hj.InputError) as found:
        parse_case(content | {"time": time}, "scene", "scene.toml", scene().parent)
    assert f"scene.toml: [time] {words}" in str(found.value)


def test_a_fault_of_the_profile_is_not_one_of_the_supply(scene):
    content = CONTENT | {"profile": CONTENT["profile"] | {"length": -1.0}}
    with pytest.raises(hj.InputError) as found:
        parse_case(content, "scene", "scene.toml", scene().parent)
    assert [fault for fault in map(str, found.value.faults) if "[profile]" not in fault] == []


def test_units_convert_and_come_back_from_attributes():
    """Closed forms, and the attributes of a netCDF file, whose texts are bytes."""
    units = Units(200.0, 0.25, 1000.0, 450.0, unit="m")
    assert units.x(-1.5) == 700.0 and units.height(2.0) == 550.0 and units.slope(1.0) == 0.5
    assert (units.rise, units.volume) == (50.0, 10_000.0)
    stored = {name: v.encode() if isinstance(v, str) else np.float64(v) for name, v in units.attributes.items()}
    assert Units.from_attributes(stored) == units and Units.from_attributes({}) is None
    unnamed = dataclasses.replace(units, unit="")
    stored_unnamed = stored | {"unit": b""}
    assert Units.from_attributes(stored_unnamed) == unnamed and unnamed.same(units)
    left = dataclasses.replace(units, direction=-1.0)
    assert Units.from_attributes(stored | {"uphill": b"left"}) == left and not left.same(units)
    assert left.attributes["uphill"] == "left" and left.x(-1.5) == 1300.0 and left.place(1300.0) == -1.5
    for wrong in (
        {"length": 1.0},
        stored | {"x_top": b"x"},
        stored | {"unit": np.float64(1.0)},
        stored | {"unit": b"\xff"},
    ):
        with pytest.raises(ValueError, match="the units of a survey need the numbers length, critical_slope"):
            Units.from_attributes(wrong)


def test_texts_name_the_unit():
    units = Units(200.0, 0.257, 0.0, 0.0, unit="m")
    assert (
        units.volume_text(30840.0) == "30840 m² per unit width"
        and units.volume_text(12.34567) == "12.35 m² per unit width"
    )
    unnamed = dataclasses.replace(units, unit="")
    assert unnamed.volume_text(30840.0) == "30840 in the survey's units, per unit width"
    assert (units.label, unnamed.label) == ("m", "survey units")
    assert str(units).startswith("length = 200 m, ") and str(unnamed).startswith("length = 200, ")
