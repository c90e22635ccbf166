"""VTK files for ParaView; the only module that imports pyvista.

Files are serialised in memory and written by Python, because VTK's own writer does not report a full disk.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pyvista
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
            mesh.field_data["TimeValue"] = np.array([t])
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


def _profile(run: Run, i: int) -> pyvista.PolyData:
    x, u, critical = _places(run, run.x, run.u[i])
    n = run.cells
    lines = np.column_stack([np.full(n, 2), np.arange(n), np.arange(1, n + 1)]).ravel()
    mesh = pyvista.PolyData(np.column_stack([x, u, np.zeros(n + 1)]), lines=lines)
    mesh.point_data["u"] = u
    mesh.point_data["slope"] = critical * (1.0 + _at_nodes(run.q[i]))
    mesh.point_data["K"] = run.K[i]
    mesh.cell_data["q"] = run.q[i]
    mesh.point_data.active_scalars_name = None
    mesh.cell_data.active_scalars_name = "q"  # the array by which ParaView colours first
    return mesh


def _kinks(run: Run, i: int) -> pyvista.PolyData:
    kinks = run.kinks_at(i)
    at = np.array([k.x for k in kinks], dtype=float)
    x, u, _ = _places(run, at, np.interp(at, run.x, run.u[i]))
    # without kinks 0 points instead of an empty mesh, which ParaView rejects
    mesh = pyvista.PolyData(np.column_stack([x, u, np.zeros(at.size)]))
    length = run.units.length if run.units else 1.0
    mesh.point_data["kink"] = np.array([k.kink for k in kinks], dtype=np.int64)
    mesh.point_data["jump"] = np.array([k.jump for k in kinks], dtype=float)
    mesh.point_data["speed"] = length * np.array(
        [k.rankine_hugoniot_speed if np.isnan(k.speed) else k.speed for k in kinks],
        dtype=float,  # the kink was found at one saved time only
    )
    mesh.point_data.active_scalars_name = "jump"
    return mesh


def _sheet(run: Run) -> pyvista.RectilinearGrid:
    x, u, _ = _places(run, run.x, run.u)
    order = slice(None, None, 1 if x[0] < x[-1] else -1)  # the coordinates of such a grid increase
    mesh = pyvista.RectilinearGrid(x[order], run.time, np.zeros(1))
    for axis, name in (("X", "x"), ("Y", "t"), ("Z", "z")):
        getattr(mesh, f"Get{axis}Coordinates")().SetName(name)  # VTK invents a missing name, a new one in each run
    for name, values in (("u", u), ("q", _at_nodes(run.q)), ("K", run.K)):
        mesh.point_data[name] = np.ascontiguousarray(values[:, order]).ravel()
    mesh.point_data.active_scalars_name = "q"
    return mesh


def _serialise(mesh: pyvista.DataSet, writer) -> bytes:
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
