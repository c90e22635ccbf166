"""Every VTK file read back by value, by VTK's own readers and by a decoder of its own that knows only the format."""

import base64
import zlib
from functools import lru_cache, partial
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
POINTS = np.array([[1000.0, 20.0], [1100.0, 60.0], [1150.0, 150.0], [1200.0, 170.0]])  # x and height of a survey


@lru_cache
def solved(name):
    grid = hj.Grid(left=-5.0, cells=100)
    if name == "kinks":  # 2 kinks at first, 1 after the merge, 0 after the exit
        profile = hj.kinks([-3.0, -2.0], [0.4, 1.2])
        # times without a short decimal form
        return hj.solve_hj(hj.Problem(hj.rational(), profile, end=5.0, snapshots=[0.0, 0.1 + 0.2, 2 / 3, 3.0, 5.0]), grid)
    if name == "single":
        return hj.solve_hj(hj.Problem(hj.rational(), hj.bumps([-0.5], [-2.0], [0.4]), end=0.5, snapshots=1), grid)
    return hj.solve_conservative(hj.Problem(hj.rational(), solved_survey(), end=0.5, snapshots=3), grid)


@lru_cache
def solved_survey():
    raise NotImplementedError  # set by `runs`


@pytest.fixture(scope="module", autouse=True)
def runs(tmp_path_factory):
    path = tmp_path_factory.mktemp("survey") / "slope.csv"
    path.write_text("x,height\n" + "".join(f"{x},{height}\n" for x, height in POINTS))
    globals()["solved_survey"] = partial(hj.survey, path, CRITICAL, LENGTH)
