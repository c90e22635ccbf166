"""Sweeps of a survey: equal volumes, equal ground, and columns in the unit of the survey."""

import csv
import dataclasses

import numpy as np
import pytest
import tomli_w
import xarray

import hjprofile as hj
from hjprofile.output.sweep_results import account, netcdf, report
from hjprofile.studies.sweep import held, members

LENGTHS, SUPPLIED, LEFT = [100.0, 150.0, 230.0], 4500.0, -3.0
X_TOP, HEIGHT_TOP, CRITICAL = 500.0, 155.0, 0.4
CONTENT = {
    "title": "A slope",
    "profile": {"kind": "survey", "file": "slope.csv", "critical_slope": CRITICAL, "length": 150.0},
    "erosion": {"law": "rational"},
    "domain": {"left": LEFT, "cells": 60},
    "time": {"supplied": SUPPLIED, "snapshots": 3},
}


@pytest.fixture
def scene(in_tmp):
    (in_tmp / "slope.csv").write_text("x,height\n100,10\n200,30\n300,95\n500,155\n")

    def write(**sections):
        path = in_tmp / "scene.toml"
        path.write_text(tomli_w.dumps(CONTENT | sections))
        return path

    return write


def grids(made):
    return [m.units.x(np.array([m.grid.left, m.grid.right])) for m in made]


def test_every_length_has_the_same_volume_on_the_same_ground(scene):
    """To rounding: left is multiplied by a quotient, the volume is divided by another."""
    result = hj.sweep(scene(), {"profile.length": LENGTHS})
    assert [o.status for o in result.outcomes] == ["done"] * 3
    assert np.allclose(result.quantity("end_survey"), SUPPLIED, rtol=1e-14)
    assert np.allclose(result.quantity("end") * np.square(LENGTHS) * CRITICAL, SUPPLIED, rtol=1e-14)
    made = members(scene(), {"profile.length": LENGTHS})
    assert np.allclose(grids(made), [X_TOP + LEFT * 150.0, X_TOP], rtol=0, atol=1e-10)
    assert made[1].grid.left == LEFT  # the member with the length of the case is the case
    assert np.allclose(result.distance, np.linspace(50.0, 500.0, 61), rtol=0, atol=1e-10) and result.x is None


def test_left_moves_only_with_the_length_and_only_if_stated(scene):
    left = [m.grid.left for m in members(scene(), {"profile.critical_slope": [0.3, 0.4], "domain.cells": [50]})]
    assert left == [LEFT, LEFT]
    both = members(scene(), {"profile.length": [100.0, 150.0], "domain.left": [-4.5]})
    assert [m.grid.left for m in both] == [-4.5, -4.5] and both[0].moved == ()
    absent = members(scene(domain={"cells": 60}), {"profile.length": LENGTHS})
    assert [m.moved for m in absent] == [()] * 3
    begins = [1.05 * (100.0 - 500.0) / length - 0.05 for length in LENGTHS]  # from the profile of each
    assert [m.grid.left for m in absent] == pytest.approx(begins, rel=1e-12)


def test_both_ends_of_a_window_move(scene):
    """On the whole line a survey that is neutral at its crest may continue; here the ends alone are of interest."""
    domain = {"line": "whole", "left": -3.0, "right": 1.0, "cells": 80}
    made = members(scene(domain=domain), {"profile.length": [100.0, 150.0]})
    assert all(set(m.moved) == {"left", "right"} for m in made) and [m.content["domain"]["right"] for m in made] == [
        1.5,
        1.0,
    ]


@pytest.mark.parametrize("value", [0.0, -1.0, "long", True])
def test_a_wrong_length_is_rejected_as_such(scene, value):
    with pytest.raises(hj.InputError) as found:
        members(scene(), {"profile.length": [value]})
    assert "length = " in str(found.value) and "left" not in str(found.value)


def test_columns_in_the_unit_of_the_survey(scene, in_tmp):
    """Closed forms of the dimensionless columns, in the table, the netCDF file and the array."""
    result = hj.sweep(
        scene(), {"profile.length": LENGTHS, "profile.critical_slope": [0.35, 0.4]}, folder=in_tmp / "out"
    )
    with open(in_tmp / "out" / "sweep.csv", newline="") as stream:
        table = list(csv.DictReader(stream))
    names = list(table[0])
    assert names[-9:] == [
        "end_survey", "eroded_volume_survey", "volume_budget_error_survey", "toe_outflow_survey",
        "crest_lowering_survey", "largest_lowering_survey", "largest_rise_survey", "kink_x_survey",
        "error_estimate_survey",
    ]  # fmt: skip
    assert names[-10] == "wall_seconds" and report(result)["members"][0].keys() == table[0].keys()
    for row in table:
        length, slope = float(row["profile.length"]), float(row["profile.critical_slope"])
        for name in ("end", "eroded_volume", "volume_budget_error", "toe_outflow"):
            assert float(row[f"{name}_survey"]) == pytest.approx(length**2 * slope * float(row[name]), rel=1e-13)
        for name in ("crest_lowering", "largest_lowering", "largest_rise"):
            assert float(row[f"{name}_survey"]) == pytest.approx(length * slope * float(row[name]), rel=1e-13)
        error = float(row["error_estimate"])
        assert error > 0.0 and float(row["error_estimate_survey"]) == pytest.approx(length * slope * error, rel=1e-13)
        assert float(row["kink_x_survey"]) == pytest.approx(X_TOP + length * float(row["kink_x"]), rel=1e-13)
    with xarray.open_dataset(in_tmp / "out" / "sweep.nc") as data:
        assert np.array_equal(data.toe_outflow_survey.values, result.quantity("toe_outflow_survey"))
        assert "units" not in data.toe_outflow_survey.attrs and data.toe_outflow.attrs["units"] == "1"
        assert data.height.dims == ("profile_length", "profile_critical_slope", "distance")
        last = result.outcomes[-1].u
        assert np.allclose(data.height.values[-1, -1], HEIGHT_TOP + LENGTHS[-1] * 0.4 * last, rtol=1e-14)
        assert np.array_equal(data.distance.values, result.distance) and "u" not in data


def test_a_unit_with_a_name_is_in_the_file_and_the_account(scene, tmp_path):
    result = hj.sweep(scene(), {"profile.length": LENGTHS})
    named = dataclasses.replace(result, units=[dataclasses.replace(units, unit="m") for units in result.units])
    (tmp_path / "named.nc").write_bytes(netcdf(named))
    with xarray.open_dataset(tmp_path / "named.nc") as data:
        units = {name: data[name].attrs["units"] for name in data.data_vars if name.endswith("_survey")}
        areas = {"end_survey", "eroded_volume_survey", "volume_budget_error_survey", "toe_outflow_survey"}
        assert {name for name, unit in units.items() if unit == "m2"} == areas
        assert {unit for name, unit in units.items() if name not in areas} == {"m"}
        assert data.height.attrs["units"] == data.distance.attrs["units"] == "m" and data.end.attrs["units"] == "1"
    assert "  columns that end in _survey: lengths in m, volumes per unit width in m²\n" in account(named)
    made = members(scene(), {"profile.length": LENGTHS})
    vary = {"profile.length": LENGTHS}
    assert held(vary, [m._replace(units=u) for m, u in zip(made, named.units, strict=True)]).endswith(" 4500 m²")


def test_a_failed_member_has_no_values(scene):
    """A saved time, which is dimensionless, lies beyond the end of the member with a long length and a small supply."""
    time = {"supplied": SUPPLIED, "snapshots": [0.0, 0.4]}
    result = hj.sweep(scene(time=time), {"profile.length": [150.0, 300.0], "time.supplied": [SUPPLIED, 4 * SUPPLIED]})
    *_, failed, last = result.outcomes
    assert last.done and "times must lie between 0 and end = 0.125" in failed.status
    ends = result.quantity("end_survey")
    assert np.isnan(ends[1, 0]) and np.isfinite(ends).sum() == 3
    assert report(result)["members"][2]["end_survey"] is None


def test_a_case_without_a_survey_has_no_such_columns(in_tmp):
    result = hj.sweep("two_kinks", {"domain.cells": [20], "time.end": [0.5]}, folder=in_tmp)
    assert "survey" not in (in_tmp / "sweep.csv").read_text() and "survey" not in account(result)
    with xarray.open_dataset(in_tmp / "sweep.nc") as data:
        assert "u" in data and "height" not in data


def test_the_account_states_what_is_held(scene):
    """Columns of members with different units are in the unit of the survey, because the others cannot be compared."""
    text = account(hj.sweep(scene(), {"profile.length": LENGTHS}))
    assert "  profile.length  end_survey  eroded_volume_survey  toe_outflow_survey  largest_lowering_survey\n" in text
    assert text.endswith(
        "  columns that end in _survey: lengths in survey units, volumes per unit width in survey units²\n"
        "  in each member domain.left times profile.length is constant: all grids cover the same ground; every member "
        "is supplied with the same volume per unit width, 4500"
    )
    same = account(hj.sweep(scene(time={"end": 0.5}), {"erosion.law": ["rational", "log"]}))
    assert "eroded_volume  toe_outflow" in same and "_survey" not in same and "same" not in same
