"""The same run in profile.nc, as a dataset of xarray and as a table of pandas, and the rules of CF for the file."""

import re
import subprocess
import sys
from functools import lru_cache

import matplotlib
import numpy as np
import pytest
import xarray
from scipy.io import netcdf_file

import hjprofile as hj
from hjprofile.output.store import netcdf

KINKS = hj.Problem(hj.rational(), hj.kinks([-3.0, -2.0], [0.4, 1.2]), end=2.0, snapshots=5)
PLACES = {"x": [400.3, 300.0, 200.0, 100.0], "height": [5.0, 60.0, 100.0, 233.3]}  # it rises to the left


def of_survey(unit):
    profile = hj.survey(**PLACES, critical_slope=0.6, length=123.4, unit=unit)
    return hj.Problem(hj.log(), profile, end=1.0, snapshots=3)


PROBLEMS = {
    "kinks": (KINKS, hj.Grid(-4.0, 80)),
    "survey": (of_survey("m"), hj.Grid(-4.0, 80)),
    "survey without a unit": (of_survey(""), hj.Grid(-4.0, 80)),
}


@lru_cache
def solved(name):
    return hj.solve_hj(*PROBLEMS[name])


@pytest.fixture(params=PROBLEMS)
def run(request):
    return solved(request.param)


def opened(run, tmp_path):
    (tmp_path / "profile.nc").write_bytes(netcdf(run))
    return xarray.load_dataset(tmp_path / "profile.nc")


def test_the_file_is_the_dataset_after_its_dimensions_have_their_coordinates(run, tmp_path):
    data, made = opened(run, tmp_path).swap_dims(node="x", cell="x_cell"), run.to_xarray()
    made.attrs["title"] = made.attrs["title"] or " "  # netCDF has no empty text
    xarray.testing.assert_identical(made, data)
    assert dict(made.sizes) == {"time": run.time.size, "x": run.cells + 1, "x_cell": run.cells}
    assert np.shares_memory(made.u.values, run.u)


@pytest.mark.parametrize("read", [False, True])
def test_positions_are_indices(read, tmp_path):
    run = solved("kinks")
    data = opened(run, tmp_path).swap_dims(node="x", cell="x_cell") if read else run.to_xarray()
    assert set(data.indexes) == {"time", "x", "x_cell"}
    assert data.u.sel(x=-3, method="nearest").values.tolist() == run.u[:, 20].tolist()  # Δx = 0.05 from x = -4
    assert data.q.sel(x_cell=-2.976, method="nearest").values.tolist() == run.q[:, 20].tolist()
    assert data.u.sel(x=slice(-2.0, 0.0)).sizes["x"] == 41
    lowered = (data.u.isel(time=0) - data.u.isel(time=-1)).integrate("x")  # trapezoidal; the budget is of first order
    assert float(lowered) == pytest.approx(run.eroded_volume, rel=0.02)


def test_a_plot_of_xarray_has_x_on_its_axis():
    run = solved("kinks")
    with matplotlib.rc_context({"backend": "agg"}):
        (line,) = run.to_xarray().u.isel(time=-1).plot()
        assert line.axes.get_xlabel().startswith("distance from the crest")
        np.testing.assert_array_equal(line.get_data(), [run.x, run.u[-1]])
        matplotlib.pyplot.close(line.figure)


def test_a_table_has_one_row_for_each_saved_time_and_node(run):
    table = run.to_dataframe()
    assert len(table) == run.u.size and table.index.names == ["time", "x"] and table.index.is_unique
    survey = ["supplied_volume", "distance", "height"] if run.units else []
    assert sorted(table.columns) == sorted(["u", "q", "K", *survey])
    for i, t in enumerate(run.time):
        part = table.loc[t]
        assert np.array_equal(part.index, run.x)
        assert np.array_equal(part.u, run.u[i]) and np.array_equal(part.K, run.K[i])
        assert np.isnan(part.q.iloc[0]) and np.array_equal(part.q.iloc[1:], run.q[i])
        rises = (part.u.diff() - (1.0 + part.q) * (run.x[1] - run.x[0])).iloc[1:]
        assert np.abs(rises).max() < 1e-12  # rounding of heights of order 10
        if run.units:
            assert np.array_equal(part.distance, run.units.x(run.x))
            assert np.array_equal(part.height, run.units.height(run.u[i]))
            assert set(part.supplied_volume) == {run.units.volume * t}


def test_the_variables_on_nodes_and_on_cells_are_tables_of_their_own():
    """The table of all variables of the dataset would have a row for each pair of a node and a cell."""
    run = solved("kinks")
    data = run.to_xarray()
    assert len(data[["u", "K"]].to_dataframe()) == run.u.size
    assert len(data.q.to_dataframe()) == run.q.size


def test_xarray_and_pandas_are_not_imported_unless_asked_for():
    program = (
        "import sys, hjprofile as hj\n"
        "run = hj.solve_hj(hj.Problem(hj.rational(), hj.kinks([-1.0], [1.0]), 0.1), hj.Grid(-2.0, 40))\n"
        "assert not {'xarray', 'pandas'} & set(sys.modules)\nassert run.to_xarray().u.shape == run.u.shape\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
UNITS = {"1", "m", "m2"}  # those of these runs; udunits knows each


def cf_faults(path):
    """Yield each violation of the CF conventions 1.8, by the number of the section that states the rule."""
    with netcdf_file(path, mmap=False) as file:
        variables = file.variables
        if not re.fullmatch(rb"CF-1\.\d+", file.Conventions):
            yield f"2.6.1 Conventions = {file.Conventions}"
        for name in [*variables, *file.dimensions, *file._attributes]:
            if not NAME.fullmatch(name):
                yield f"2.3 the name {name}"
        if len({name.lower() for name in variables}) < len(variables):
            yield "2.3 names that differ by their case only"
        for name, variable in variables.items():
            yield from (f"{fault} of {name}" for fault in faults_of(name, variable, variables, file.dimensions))


def faults_of(name, variable, variables, dimensions):
    if variable.data.dtype.kind not in "fiSu" or variable.data.dtype.itemsize > 8:
        yield "2.2 the type"
    if len(set(variable.dimensions)) < len(variable.dimensions):
        yield "2.4 a repeated dimension"
    if variable.dimensions and None in [dimensions[d] for d in variable.dimensions[1:]]:
        yield "2.4 an unlimited dimension that is not the first"
    units = getattr(variable, "units", b"").decode()
    surveyed = name in ("supplied_volume", "distance", "distance_cell", "height")
    if units not in UNITS and not (surveyed and not units):
        yield f"3.1 units = {units!r}"
    if not getattr(variable, "long_name", getattr(variable, "standard_name", b"")):
        yield "3.2, 3.3 neither a long_name nor a standard_name"
    if name in dimensions:  # a coordinate variable, section 5
        if variable.dimensions != (name,) or not np.all(np.isfinite(variable.data)):
            yield "2.5.1 a coordinate variable of other dimensions, or with missing values"
        steps = np.diff(variable.data)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            yield "5 a coordinate variable that is not monotonic"
    named = getattr(variable, "coordinates", b"").decode().split()
    for other in named:
        if other not in variables or not set(variables[other].dimensions) <= set(variable.dimensions):
            yield f"5 the auxiliary coordinate {other}"
        if other in dimensions:
            yield f"5 the coordinate variable {other} among the auxiliary ones"
    along = [variables[n] for n in {*variable.dimensions, *named} if n in variables]
    axes = [getattr(v, "axis", b"").decode() for v in along]
    if not set(axes) <= {"", "X", "Y", "Z", "T"} or any(axes.count(axis) > 1 for axis in "XYZT"):
        yield f"4, 5 axes {axes}"
    if len(variable.dimensions) > 1 and not {"T", "X"} <= set(axes):
        yield f"4 axes {axes}; T and X are expected"


def test_the_file_follows_the_rules_of_cf(run, tmp_path):
    (tmp_path / "profile.nc").write_bytes(netcdf(run))
    assert list(cf_faults(tmp_path / "profile.nc")) == []


def test_violated_rules_are_found(tmp_path):
    faulty = {
        "no Conventions": lambda file: setattr(file, "Conventions", b"none"),
        "2.3 the name": lambda file: setattr(file, "9th", b"a name"),
        "3.1 units = ''": lambda file: setattr(file.variables["u"], "units", b""),
        "3.2": lambda file: setattr(file.variables["K"], "long_name", b""),
        "monotonic": lambda file: file.variables["time"].data.__setitem__(1, 9.0),
        "5 the auxiliary coordinate x_cell": lambda file: setattr(file.variables["u"], "coordinates", b"x_cell"),
        "axes": lambda file: setattr(file.variables["x"], "axis", b"T"),
    }
    for words, spoil in faulty.items():
        path = tmp_path / "profile.nc"
        path.write_bytes(netcdf(solved("kinks")))
        with netcdf_file(path, "a", mmap=False) as file:
            spoil(file)
        assert any(words.removeprefix("no ") in fault for fault in cf_faults(path)), words
