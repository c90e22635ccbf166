"""Every VTK file read back by value: by VTK's own readers, and by a decoder that knows nothing but the format."""

import base64
import runpy
import sys
import tempfile
import zlib
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista
from scipy.io import netcdf_file
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLRectilinearGridReader

import hjprofile as hj
from hjprofile.files import write_whole
from hjprofile.output.vtk import vtk_files

SCRIPT = Path(__file__).parents[2] / "docs" / "open_in_paraview.py"
SCENES = ("kinks", "single", "large", "survey", "births", "stopped")
LENGTH, CRITICAL = 50.0, 0.6
SURVEY = np.array(
    [[1000.0, 20.0], [1100.0, 60.0], [1150.0, 150.0], [1200.0, 170.0]]
)  # x, height; the points lie on nodes


@lru_cache
def solved(name):
    law, grid = hj.rational(), hj.Grid(left=-5.0, cells=100)
    if name == "kinks":  # two kinks at first, one after they merge, none after the exit; times of no short decimal form
        profile = hj.kinks([-3.0, -2.0], [0.4, 1.2])
        return hj.solve_hj(hj.Problem(law, profile, end=5.0, snapshots=[0.0, 0.1 + 0.2, 2 / 3, 3.0, 5.0]), grid)
    if name == "single":
        return hj.solve_hj(hj.Problem(law, hj.bumps([-0.5], [-2.0], [0.4]), end=0.5, snapshots=1), grid)
    if name == "births":
        profile = hj.bumps([0.8], [-4.0], [1.0])
        return hj.solve_hj(hj.Problem(law, profile, end=2.0, snapshots=7), hj.Grid(left=-8.0, cells=200))
    if name == "stopped":  # long before its second time; and without a kink
        problem = hj.Problem(law, hj.bumps([3.0], [-4.0], [1.0]), end=3.0, snapshots=4)
        return hj.solve_hj(problem, hj.Grid(left=-8.0, cells=400), cfl=2.5)
    if name == "large":  # more than one compressed block an array
        profile = hj.kinks([-3.0, -2.0], [0.4, 1.2])
        return hj.solve_hj(hj.Problem(law, profile, end=0.02, snapshots=12), hj.Grid(left=-5.0, cells=1500))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "slope.csv"
        path.write_text("x,height\n" + "".join(f"{x},{height}\n" for x, height in SURVEY))
        profile = hj.survey(path, critical_slope=CRITICAL, length=LENGTH)
    return hj.solve_conservative(hj.Problem(law, profile, end=0.5, snapshots=3), grid)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Scene -> folder with its files."""
    folders = {name: tmp_path_factory.mktemp(name) for name in SCENES}
    for name, folder in folders.items():
        for file, content in vtk_files(solved(name)).items():
            write_whole(folder / file, content)
    return folders


def in_units(name, x, u):
    """x and u as they must be in the files."""
    if name != "survey":
        return x, u
    return SURVEY[-1, 0] + LENGTH * x, SURVEY[-1, 1] + LENGTH * CRITICAL * u


# --- VTK's own readers ---


def vtk_arrays(attributes):
    return {
        attributes.GetArrayName(i): vtk_to_numpy(attributes.GetArray(i)) for i in range(attributes.GetNumberOfArrays())
    }


def cells_of(points, ends):
    """The points of each cell."""
    return [tuple(points[i:j]) for i, j in pairwise(ends)]


def by_vtk(path):
    reader = (vtkXMLRectilinearGridReader if path.suffix == ".vtr" else vtkXMLPolyDataReader)()
    reader.SetFileName(str(path))
    reader.Update()
    assert reader.GetErrorCode() == 0
    mesh = reader.GetOutput()
    scalars = (mesh.GetPointData().GetScalars(), mesh.GetCellData().GetScalars())
    found = SimpleNamespace(
        active=tuple(None if array is None else array.GetName() for array in scalars),
        point_data=vtk_arrays(mesh.GetPointData()),
        cell_data=vtk_arrays(mesh.GetCellData()),
        field_data=vtk_arrays(mesh.GetFieldData()),
    )
    if path.suffix == ".vtr":
        axes = (mesh.GetXCoordinates(), mesh.GetYCoordinates(), mesh.GetZCoordinates())
        found.coordinates = {axis.GetName(): vtk_to_numpy(axis) for axis in axes}
        return found
    found.points = vtk_to_numpy(mesh.GetPoints().GetData())
    cells = {"lines": mesh.GetLines(), "verts": mesh.GetVerts(), "polys": mesh.GetPolys(), "strips": mesh.GetStrips()}
    for name, kind in cells.items():
        at, ends = (vtk_to_numpy(a) for a in (kind.GetConnectivityArray(), kind.GetOffsetsArray()))
        setattr(found, name, cells_of(at, ends))
    return found


# --- a decoder of its own ---


def decode(element, root):
    """A DataArray of inline binary data: base64 of a header and base64 of zlib's blocks."""
    assert (element.get("format"), root.get("compressor")) == ("binary", "vtkZLibDataCompressor")
    order = {"LittleEndian": "<", "BigEndian": ">"}[root.get("byte_order")]
    word = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[root.get("header_type")])
    kind = np.dtype(order + {"Float64": "f8", "Int64": "i8"}[element.get("type")])
    text = "".join(element.text.split())

    def part(start, size):
        """`size` bytes whose base64 begins at `start`, and where it ends."""
        end = start + -(-size // 3) * 4
        return base64.b64decode(text[start:end])[:size], end

    count = int(np.frombuffer(part(0, word.itemsize)[0], word)[0])
    header, end = part(0, (3 + count) * word.itemsize)
    _, block, last, *packed = np.frombuffer(header, word).tolist()
    data, end = part(end, sum(packed))
    assert end == len(text)
    places = np.cumsum([0, *packed])
    blocks = [zlib.decompress(data[i:j]) for i, j in pairwise(places)]
    assert [len(b) for b in blocks] == [block] * (count - bool(last)) + [last] * bool(last)
    values = np.frombuffer(b"".join(blocks), kind)
    columns = int(element.get("NumberOfComponents", 1))
    return values.reshape(-1, columns) if columns > 1 else values


def by_format(path):
    root = ElementTree.parse(path).getroot()
    assert root.tag == "VTKFile"
    data = root.find(root.get("type"))
    piece = data.find("Piece")

    def section(parent, name):
        return {a.get("Name"): decode(a, root) for a in parent.iterfind(f"{name}/DataArray")}

    found = SimpleNamespace(
        active=(piece.find("PointData").get("Scalars"), piece.find("CellData").get("Scalars")),
        point_data=section(piece, "PointData"),
        cell_data=section(piece, "CellData"),
        field_data=section(data, "FieldData"),
    )
    if root.get("type") == "RectilinearGrid":
        found.coordinates = section(piece, "Coordinates")
        sizes = [v.size for v in found.coordinates.values()]
        assert piece.get("Extent") == data.get("WholeExtent") == " ".join(f"0 {n - 1}" for n in sizes)
        return found
    (found.points,) = section(piece, "Points").values()  # also of 0 points: ParaView 5.11 complains where there is none
    assert int(piece.get("NumberOfPoints")) == len(found.points)
    for name in ("Lines", "Verts", "Polys", "Strips"):
        cells = section(piece, name)
        setattr(found, name.lower(), cells_of(cells["connectivity"], [0, *cells["offsets"]]))
        assert int(piece.get(f"NumberOf{name}")) == len(cells["offsets"])
    return found


@pytest.fixture(params=[by_vtk, by_format])
def read(request):
    return request.param


scenes = pytest.mark.parametrize("name", SCENES)


def test_the_scenes_hold_what_the_tests_need(folders):
    counts = [len(solved("kinks").kinks_at(i)) for i in range(5)]
    assert counts[0] == 2 and 1 in counts and counts[-1] == 0
    assert solved("survey").kinks and solved("single").time.size == 1
    births = solved("births")
    assert not births.kinks_at(0) and births.kinks_at(-1) and births.events[0].event == "birth"
    stopped = solved("stopped")
    assert not stopped.done and not stopped.kinks and stopped.time.size == 2 and 0 < stopped.time[-1] < 1
    root = ElementTree.parse(folders["large"] / "profile_0000.vtp").getroot()
    array = root.find("PolyData/Piece/Points/DataArray")
    assert np.frombuffer(base64.b64decode(array.text.split()[0][:8])[:4], "<u4")[0] == 2  # blocks


@scenes
def test_profiles(folders, read, name):
    run = solved(name)
    for i, t in enumerate(run.time):
        mesh = read(folders[name] / f"profile_{i:04d}.vtp")
        assert mesh.field_data.keys() == {"TimeValue"} and mesh.field_data["TimeValue"].tolist() == [t]
        x, u = in_units(name, run.x, run.u[i])
        # the files hold doubles: a rounding or two of the numbers themselves, against 1e-7 in single precision
        np.testing.assert_allclose(mesh.points, np.column_stack([x, u, 0 * x]), rtol=1e-15, atol=0)
        assert mesh.points.dtype == np.float64
        assert mesh.lines == [(j, j + 1) for j in range(run.cells)] and not (mesh.verts or mesh.polys or mesh.strips)
        assert mesh.point_data.keys() == {"u", "slope", "K"} and mesh.cell_data.keys() == {"q"}
        assert np.array_equal(mesh.point_data["u"], mesh.points[:, 1])
        assert np.array_equal(mesh.point_data["K"], run.K[i])
        assert np.array_equal(mesh.cell_data["q"], run.q[i])
        # the slope is that of the polyline, beside a node on average; a difference of heights up to 200 over steps of
        # 0.05 loses 1e-16 * 200 / 0.05
        steps = np.diff(mesh.points[:, 1]) / np.diff(mesh.points[:, 0])
        slope = np.concatenate([steps[:1], 0.5 * (steps[1:] + steps[:-1]), steps[-1:]])
        np.testing.assert_allclose(mesh.point_data["slope"], slope, rtol=0, atol=2e-12)


def test_the_survey_is_found_in_the_file(folders, read):
    """The first snapshot runs through the surveyed points themselves, and is critical left of them."""
    mesh = read(folders["survey"] / "profile_0000.vtp")
    x, u, _ = mesh.points.T
    at = np.searchsorted(x, SURVEY[:, 0] - 1e-9)
    # metres, by way of sums over 100 cells that lose 1e-16 of 200 each
    np.testing.assert_allclose(np.column_stack([x, u])[at], SURVEY, rtol=0, atol=1e-11)
    assert mesh.point_data["slope"][0] == pytest.approx(CRITICAL, rel=1e-12)


@scenes
def test_kinks(folders, read, name):
    run = solved(name)
    length = LENGTH if name == "survey" else 1.0
    for i, t in enumerate(run.time):
        mesh = read(folders[name] / f"kinks_{i:04d}.vtp")
        kinks = [k._replace(speed=k.rankine_hugoniot_speed) if np.isnan(k.speed) else k for k in run.kinks_at(i)]
        assert mesh.field_data["TimeValue"].tolist() == [t]
        assert mesh.points.shape == (len(kinks), 3) and mesh.verts == [(j,) for j in range(len(kinks))]
        assert mesh.point_data.keys() == {"kink", "jump", "speed"} and not mesh.cell_data
        assert mesh.point_data["kink"].dtype == np.int64
        for key, scale in (("kink", 1), ("jump", 1.0), ("speed", length)):
            assert mesh.point_data[key].tolist() == [scale * getattr(k, key) for k in kinks]
        x, _ = in_units(name, np.array([k.x for k in kinks]), 0.0)
        np.testing.assert_allclose(mesh.points[:, 0], x, rtol=1e-15, atol=0)  # one rounding
        px, pu, _ = read(folders[name] / f"profile_{i:04d}.vtp").points.T
        # on the polyline: interpolated before or after the change of units, to rounding
        np.testing.assert_allclose(mesh.points[:, 1], np.interp(x, px, pu), rtol=1e-12, atol=1e-12)
        assert not mesh.points[:, 2].any()


@scenes
def test_sheet(folders, read, name):
    run = solved(name)
    mesh = read(folders[name] / "sheet.vtr")
    assert list(mesh.coordinates) == ["x", "t", "z"]  # named, else VTK invents names
    x, u = in_units(name, run.x, run.u)
    assert np.array_equal(mesh.coordinates["t"], run.time) and mesh.coordinates["z"].tolist() == [0.0]
    np.testing.assert_allclose(mesh.coordinates["x"], x, rtol=1e-15, atol=0)
    assert mesh.point_data.keys() == {"u", "q", "K"}
    sheets = {key: values.reshape(run.u.shape) for key, values in mesh.point_data.items()}  # x runs fastest
    np.testing.assert_allclose(sheets["u"], u, rtol=1e-15, atol=0)
    assert np.array_equal(sheets["K"], run.K)
    inner = 0.5 * (run.q[:, 1:] + run.q[:, :-1])
    assert np.array_equal(sheets["q"], np.column_stack([run.q[:, :1], inner, run.q[:, -1:]]))


@scenes
@pytest.mark.parametrize("kind", ["profile", "kinks"])
def test_collections(folders, name, kind):
    run = solved(name)
    rows = list(ElementTree.parse(folders[name] / f"{kind}.pvd").getroot().iterfind("Collection/DataSet"))
    assert [row.get("timestep") for row in rows] == [repr(float(t)) for t in run.time]
    assert [row.get("file") for row in rows] == [f"{kind}_{i:04d}.vtp" for i in range(run.time.size)]
    reader = pyvista.get_reader(folders[name] / f"{kind}.pvd")
    assert reader.time_values == run.time.tolist()
    for i, t in enumerate(run.time):
        reader.set_active_time_value(t)
        (mesh,) = reader.read()
        assert mesh.field_data["TimeValue"].tolist() == [t]
        assert mesh.n_points == (run.cells + 1 if kind == "profile" else len(run.kinks_at(i)))


@scenes
def test_paraview_colours_at_once_by_what_one_looks_for(folders, read, name):
    """It takes the active scalars, those of points before those of cells."""
    for i in range(solved(name).time.size):
        assert read(folders[name] / f"profile_{i:04d}.vtp").active == (None, "q")
        assert read(folders[name] / f"kinks_{i:04d}.vtp").active == ("jump", None)
    assert read(folders[name] / "sheet.vtr").active == ("q", None)


@scenes
def test_collections_hold_what_the_other_files_say(folders, tmp_path, name):
    """A result folder as someone else opens it: profile.nc and kinks.csv against what ParaView plays."""
    hj.write_run(solved(name), tmp_path, plots=False)
    units = solved(name).units
    kinks = np.genfromtxt(tmp_path / "kinks.csv", delimiter=",", names=True, ndmin=1)
    with netcdf_file(tmp_path / "profile.nc", mmap=False) as stored:
        time, x, u, q, K = (stored.variables[key][:].astype(float) for key in ("time", "x", "u", "q", "K"))
    readers = {kind: pyvista.get_reader(tmp_path / "vtk" / f"{kind}.pvd") for kind in ("profile", "kinks")}
    for i, t in enumerate(time):
        for reader in readers.values():
            reader.set_active_time_value(t)
        (profile,), (points,) = (reader.read() for reader in readers.values())
        px, pu = in_units(name, x, u[i])
        np.testing.assert_allclose(profile.points, np.column_stack([px, pu, 0 * x]), rtol=1e-15, atol=0)  # a rounding
        assert np.array_equal(profile["q"], q[i]) and np.array_equal(profile["K"], K[i])
        now = kinks[kinks["time"] == t]
        assert points["kink"].tolist() == now["kink"].tolist() and points["jump"].tolist() == now["jump"].tolist()
    assert (units is not None) == (name == "survey")


@pytest.mark.parametrize("name", ["survey", "births", "stopped"])
def test_the_script_for_paraview_finds_what_it_asks_for(folders, monkeypatch, name):
    """Run with a ParaView that knows nothing but how to look into files; with the real one it is run by hand."""

    class Source:
        def __init__(self, path, **names):
            self.FileName, self.mesh = path, pyvista.read(path)
            self.TimestepValues = solved(name).time.tolist()
            self.UpdatePipeline()

        def UpdatePipeline(self, t=0.0):
            mesh = self.mesh
            if isinstance(mesh, pyvista.MultiBlock):
                reader = pyvista.get_reader(self.FileName)
                reader.set_active_time_value(t)
                (mesh,) = reader.read()
            empty = not mesh.n_points  # then ParaView tells of no arrays
            self.arrays = {"POINTS": {} if empty else dict(mesh.point_data), "CELLS": dict(mesh.cell_data)}
            self.PointData = MagicMock(GetArray=self.arrays["POINTS"].get)
            self.PointData.__getitem__.side_effect = lambda key: MagicMock(
                GetRange=lambda: (self.arrays["POINTS"][key].min(), self.arrays["POINTS"][key].max())
            )

        def GetDataInformation(self):
            return MagicMock(GetBounds=lambda: self.mesh.bounds)

    shown = {}
    simple = MagicMock(OpenDataFile=Source, Show=lambda source, view: MagicMock(source=source))
    simple.GetActiveSource.return_value = MagicMock(FileName=str(folders[name] / "profile.pvd"))
    colours = {"q": MagicMock(RGBPoints=[-0.5, 0, 0, 0, 2.0, 1, 1, 1]), "jump": MagicMock()}
    simple.GetColorTransferFunction.side_effect = colours.get

    def colour(display, array):
        assert array[1] in display.source.arrays[array[0]]
        shown[Path(display.source.FileName).name] = array

    simple.ColorBy.side_effect = colour
    monkeypatch.setitem(sys.modules, "paraview", MagicMock(simple=simple))
    monkeypatch.setattr(sys, "argv", ["paraview"])
    runpy.run_path(str(SCRIPT))
    assert shown.pop("kinks.pvd", None) == (("POINTS", "jump") if solved(name).kinks else None)
    assert shown == {"profile.pvd": ("CELLS", "q"), "sheet.vtr": ("POINTS", "q")}
    colours["q"].RescaleTransferFunction.assert_called_once_with(-2.0, 2.0)


@scenes
def test_no_file_is_left_unread(folders, name):
    numbered = {f"{kind}_{i:04d}.vtp" for kind in ("profile", "kinks") for i in range(solved(name).time.size)}
    assert {path.name for path in folders[name].iterdir()} == numbered | {"profile.pvd", "kinks.pvd", "sheet.vtr"}


@scenes
def test_two_writings_are_the_same_bytes(folders, name):
    again = vtk_files(solved(name))
    for file, content in again.items():
        assert (folders[name] / file).read_bytes() == (content.encode() if isinstance(content, str) else content), file
