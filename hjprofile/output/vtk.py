"""VTK files for ParaView; the only module that imports vtkmodules.

Files are serialised in memory and written by Python, because VTK's own writer does not report a full disk.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkDataArray, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkDataSet, vtkFieldData, vtkPolyData, vtkRectilinearGrid
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLRectilinearGridWriter

from hjprofile.errors import InputError
from hjprofile.output.folder import ABOUT, ResultFolder, owner_of_run
from hjprofile.problem.ranges import as_path, instance
from hjprofile.solvers.run import Array, Run


def export_vtk(run: Run, folder: str | Path) -> list[Path]:
    """Write the VTK files of a run, for ParaView.

    Args:
        run: the run.
        folder: the path of the folder, which is created. The snapshots of an earlier export of the same run there are
            removed.

    Returns:
        The paths of the files: `profile.pvd` and `kinks.pvd` with a `.vtp` file for each saved time, and `sheet.vtr`.

    Raises:
        InputError: for an argument of another type, or if the folder belongs to another run or case.
        OSError: if the folder is not writable.

    >>> import tempfile
    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1, snapshots=2)
    >>> files = hj.export_vtk(hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40)), tempfile.mkdtemp())
    >>> sorted(file.name for file in files)[-3:]
    ['profile_0000.vtp', 'profile_0001.vtp', 'sheet.vtr']
    """
    instance("run", run, Run)
    place = ResultFolder(as_path("folder", folder), owner_of_run(run.case), replace=False)
    if place.stale:  # an export must not remove the data of another run
        raise InputError(f"{folder} belongs to another run; name another folder, or delete this one", ABOUT)
    files = vtk_files(run)
    place.open().remove(("*.vtp",))
    return place.write(files)


def vtk_files(run: Run) -> dict[str, bytes | str]:
    """Return name -> content: profiles and kinks at each saved time with their `.pvd`, and the (x, t) sheet.

    The files of a survey are in its units; time stays dimensionless.
    """
    files: dict[str, bytes | str] = {}
    collections: dict[str, list[tuple[float, str]]] = {"profile": [], "kinks": []}
    digits = max(4, len(str(run.time.size)))
    for i, t in enumerate(run.time):
        for name, mesh in (("profile", _profile(run, i)), ("kinks", _kinks(run, i))):
            _add(mesh.GetFieldData(), {"TimeValue": np.array([t])})
            file = f"{name}_{i:0{digits}d}.vtp"
            files[file] = _serialise(mesh, vtkXMLPolyDataWriter())
            collections[name].append((float(t), file))
    for name, members in collections.items():
        files[f"{name}.pvd"] = _collection(members)
    files["sheet.vtr"] = _serialise(_sheet(run), vtkXMLRectilinearGridWriter())
    return files


def _places(run: Run, x: Array, u: Array) -> tuple[Array, Array, float]:
    """Return x and u in the units of the survey, if there is one, and the critical slope."""
    if run.units is None:
        return x, u, 1.0
    return run.units.x(x), run.units.height(u), run.units.critical_slope


def _at_nodes(q: Array) -> Array:
    """Return cell means at the nodes: the mean of both neighbours, at each end the only one."""
    padded = np.concatenate([q[..., :1], q, q[..., -1:]], axis=-1)
    return 0.5 * (padded[..., 1:] + padded[..., :-1])


def _profile(run: Run, i: int) -> vtkPolyData:
    x, u, critical = _places(run, run.x, run.u[i])
    n = run.cells
    mesh = _points(x, u)
    mesh.SetLines(_cells(2 * np.arange(n + 1), np.column_stack([np.arange(n), np.arange(1, n + 1)])))
    _add(mesh.GetPointData(), {"u": u, "slope": critical * (1.0 + _at_nodes(run.q[i])), "K": run.K[i]})
    _add(mesh.GetCellData(), {"q": run.q[i]})
    mesh.GetCellData().SetActiveScalars("q")  # the array by which ParaView colours first
    return mesh


def _kinks(run: Run, i: int) -> vtkPolyData:
    kinks = run.kinks_at(i)
    at = np.array([k.x for k in kinks], dtype=float)
    x, u, _ = _places(run, at, np.interp(at, run.x, run.u[i]))
    mesh = _points(x, u)
    mesh.SetVerts(_cells(np.arange(at.size + 1), np.arange(at.size)))
    length = run.units.length if run.units else 1.0
    # a kink that was found at one saved time only has no measured speed
    speed = [k.rankine_hugoniot_speed if np.isnan(k.speed) else k.speed for k in kinks]
    values = {
        "kink": np.array([k.kink for k in kinks], dtype=np.int64),
        "jump": np.array([k.jump for k in kinks], dtype=float),
        "speed": length * np.array(speed, dtype=float),
    }
    _add(mesh.GetPointData(), values)
    mesh.GetPointData().SetActiveScalars("jump")
    return mesh


def _sheet(run: Run) -> vtkRectilinearGrid:
    x, u, _ = _places(run, run.x, run.u)
    order = slice(None, None, 1 if x[0] < x[-1] else -1)  # the coordinates of such a grid increase
    mesh = vtkRectilinearGrid()
    mesh.SetDimensions(x.size, run.time.size, 1)
    mesh.SetXCoordinates(_array("x", x[order]))  # VTK invents a missing name, a new one in each run
    mesh.SetYCoordinates(_array("t", run.time))
    mesh.SetZCoordinates(_array("z", np.zeros(1)))
    fields = {"u": u, "q": _at_nodes(run.q), "K": run.K}
    _add(mesh.GetPointData(), {name: values[:, order].ravel() for name, values in fields.items()})
    mesh.GetPointData().SetActiveScalars("q")
    return mesh


def _points(x: Array, u: Array) -> vtkPolyData:
    """Return a mesh with points (x, u, 0) only; it may have none, while ParaView rejects a mesh without points."""
    points = vtkPoints()
    points.SetData(_array("Points", np.column_stack([x, u, np.zeros(x.size)])))
    mesh = vtkPolyData()
    mesh.SetPoints(points)
    return mesh


def _cells(offsets: Array, points: Array) -> vtkCellArray:
    """Return cells: the points of cell j are points[offsets[j] : offsets[j + 1]]."""
    cells = vtkCellArray()
    cells.SetData(*(numpy_to_vtk(a.astype(np.int64).ravel(), deep=True) for a in (offsets, points)))
    return cells


def _add(data: vtkFieldData, arrays: dict[str, Array]) -> None:
    for name, values in arrays.items():
        data.AddArray(_array(name, values))


def _array(name: str, values: Array) -> vtkDataArray:
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName(name)
    return array


def _serialise(mesh: vtkDataSet, writer) -> bytes:
    writer.SetInputData(mesh)
    writer.SetDataModeToBinary()
    writer.SetCompressionLevel(1)  # 4 % larger files in half the time
    writer.WriteToOutputStringOn()
    if not writer.Write():
        raise OSError("VTK could not serialise a mesh")
    return writer.GetOutputString().encode()


def _collection(members: list[tuple[float, str]]) -> str:
    rows = "\n".join(f'    <DataSet timestep="{t!r}" part="0" file={quoteattr(file)}/>' for t, file in members)
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
        f"  <Collection>\n{rows}\n  </Collection>\n</VTKFile>\n"
    )
