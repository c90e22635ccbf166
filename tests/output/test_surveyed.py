"""Results of surveys: the points as measured, and slopes that rise to the left, in every product."""

import numpy as np
import pytest

import hjprofile as hj
from hjprofile.output.plots.runs import draw_profiles
from hjprofile.output.vtk import vtk_files

X = 10.0 * np.arange(13)
HEIGHT = 400.0 + 0.4 * X + 3.0 * np.sin(X / 9.0)


def solved(x, height, **options):
    slope = hj.survey(x=x, height=height, critical_slope=0.36, length=15.0, unit="m", **options)
    problem = hj.Problem(hj.rational(), slope, 0.5, 3)
    return hj.solve_hj(problem, hj.Grid(-9.0, 200))


def drawn_points(run):
    top = draw_profiles(run).axes[0]
    return [line.get_xydata() for line in top.lines if line.get_marker() == "."]


def test_the_survey_as_measured_is_stored_and_drawn(tmp_path):
    """Only if the profile differs from it are the points drawn; they are stored in any case."""
    falls = HEIGHT.copy()
    falls[5] = falls[6] + 1.0
    plain, repaired = solved(X, HEIGHT), solved(X, falls, repair="isotonic")
    assert not drawn_points(plain)
    (points,) = drawn_points(repaired)
    assert np.array_equal(points, np.column_stack([X, falls]))
    for run in (plain, repaired):
        hj.write_run(run, tmp_path, vtk=False, plots=False)
        assert np.array_equal(hj.load_run(tmp_path).surveyed, run.surveyed)
    table = np.loadtxt(tmp_path / "survey.csv", delimiter=",", skiprows=1)
    assert np.array_equal(table[:, :2], np.column_stack([X, falls])) and table[5, 2] != falls[5]


@pytest.mark.parametrize("content", ["x,height\n1,2\n3,4\n", "x,height,used\n1,2,3\n", "x,height,used\n1,2,3\n1,2,\n"])
def test_a_damaged_survey_is_refused(tmp_path, content):
    """As other tables of a result folder."""
    hj.write_run(solved(X, HEIGHT), tmp_path, vtk=False, plots=False)
    (tmp_path / "survey.csv").write_text(content)
    with pytest.raises(hj.InputError, match=r"is not a readable result folder: survey.csv .*; run the case again"):
        hj.load_run(tmp_path)


def test_a_slope_that_rises_to_the_left_is_the_mirror_image(tmp_path):
    """Same heights at mirrored positions in the pictures and in VTK files; the direction is stored."""
    right, left = solved(X, HEIGHT), solved(500.0 - X, HEIGHT)
    np.testing.assert_allclose(left.u, right.u, rtol=0, atol=1e-12)
    np.testing.assert_allclose(left.units.x(left.x), 500.0 - right.units.x(right.x), rtol=0, atol=1e-9)
    hj.write_run(left, tmp_path, vtk=False, plots=False)
    assert hj.load_run(tmp_path).units == left.units
    pyvista = pytest.importorskip("pyvista")
    sheets = []
    for run in (right, left):
        (tmp_path / "sheet.vtr").write_bytes(vtk_files(run)["sheet.vtr"])
        sheets.append(pyvista.read(tmp_path / "sheet.vtr"))
    (a, b), n = sheets, right.x.size
    assert np.all(np.diff(b.x) > 0.0)
    np.testing.assert_allclose(b.x, 500.0 - a.x[::-1], rtol=0, atol=1e-9)
    for name in ("u", "q", "K"):
        mirrored = a.point_data[name].reshape(-1, n)[:, ::-1].ravel()
        np.testing.assert_allclose(b.point_data[name], mirrored, rtol=0, atol=1e-9)
