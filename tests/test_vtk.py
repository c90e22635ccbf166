"""Every VTK file read back by value: by VTK's own readers, and by a decoder that knows nothing but the format."""

import base64
import tempfile
import zlib
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLRectilinearGridReader

import hjprofile as hj
from hjprofile.output.store import write_whole
from hjprofile.output.vtk import vtk_files

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
    folders = {name: tmp_path_factory.mktemp(name) for name in ("kinks", "single", "large", "survey")}
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
    found = SimpleNamespace(
        point_data=vtk_arrays(mesh.GetPointData()),
        cell_data=vtk_arrays(mesh.GetCellData()),
        field_data=vtk_arrays(mesh.GetFieldData()),
    )
    if path.suffix == ".vtr":
        axes = (mesh.GetXCoordinates(), mesh.GetYCoordinates(), mesh.GetZCoordinates())
        found.coordinates = {axis.GetName(): vtk_to_numpy(axis) for axis in axes}
        return found
    points = mesh.GetPoints()
    found.points = vtk_to_numpy(points.GetData()) if points and points.GetNumberOfPoints() else np.empty((0, 3))
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
        point_data=section(piece, "PointData"),
        cell_data=section(piece, "CellData"),
        field_data=section(data, "FieldData"),
    )
    if root.get("type") == "RectilinearGrid":
        found.coordinates = section(piece, "Coordinates")
        sizes = [v.size for v in found.coordinates.values()]
        assert piece.get("Extent") == data.get("WholeExtent") == " ".join(f"0 {n - 1}" for n in sizes)
        return found
    found.points = next(iter(section(piece, "Points").values()), np.empty((0, 3)))
    assert int(piece.get("NumberOfPoints")) == len(found.points)
    for name in ("Lines", "Verts", "Polys", "Strips"):
        cells = section(piece, name)
        setattr(found, name.lower(), cells_of(cells["connectivity"], [0, *cells["offsets"]]))
        assert int(piece.get(f"NumberOf{name}")) == len(cells["offsets"])
    return found


@pytest.fixture(params=[by_vtk, by_format])
def read(request):
    return request.param


scenes = pytest.mark.parametrize("name", ["kinks", "single", "large", "survey"])


def test_the_scenes_hold_what_the_tests_need(folders):
    counts = [len(solved("kinks").kinks_at(i)) for i in range(5)]
    assert counts[0] == 2 and 1 in counts and counts[-1] == 0
    assert solved("survey").kinks and solved("single").time.size == 1
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
        kinks = [k for k in run.kinks if k.time == t]
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
def test_no_file_is_left_unread(folders, name):
    numbered = {f"{kind}_{i:04d}.vtp" for kind in ("profile", "kinks") for i in range(solved(name).time.size)}
    assert {path.name for path in folders[name].iterdir()} == numbered | {"profile.pvd", "kinks.pvd", "sheet.vtr"}


@scenes
def test_two_writings_are_the_same_bytes(folders, name):
    again = vtk_files(solved(name))
    for file, content in again.items():
        assert (folders[name] / file).read_bytes() == (content.encode() if isinstance(content, str) else content), file
