"""Plots on the axes of a user: the saved times and kinks where they are, and nothing else of the user's changed."""

import os
import subprocess
import sys
from functools import lru_cache

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import hjprofile as hj


@lru_cache
def solved(survey=False):
    profile = hj.kinks([-3.0, -2.0], [0.4, 1.2])
    if survey:
        profile = hj.survey(
            x=[0.0, 100.0, 200.0], height=[0.0, 40.0, 120.0], critical_slope=0.5, length=50.0, unit="ft"
        )
    return hj.solve_hj(hj.Problem(hj.rational(), profile, end=1.0, snapshots=3, title="$x_"), hj.Grid(-4.5, 90))


@pytest.fixture(autouse=True)
def nothing_is_left():
    """No setting of the user and no figure changes."""
    with matplotlib.rc_context({"backend": "agg", "lines.linewidth": 3.0, "font.size": 17.0}):
        own = pyplot.figure()
        before = {name: repr(value) for name, value in matplotlib.rcParams.copy().items()}
        yield
        assert {name: repr(value) for name, value in matplotlib.rcParams.copy().items()} == before
        assert own.number in pyplot.get_fignums()
        pyplot.close("all")


def curves(axes):
    return [line for line in axes.lines if len(line.get_xdata()) == 91]


def test_the_profile_shows_saved_times_and_kinks():
    run, axes = solved(), Figure().subplots()
    assert run.plot(ax=axes) is axes
    for line, u in zip(curves(axes), run.u, strict=True):
        np.testing.assert_array_equal(line.get_data(), [run.x, u])
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert [sorted(line.get_xdata()) for line in dots] == [[k.x for k in run.kinks_at(i)] for i in range(3)]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["0", "0.5", "1", "kink"]
    assert axes.get_legend().get_title().get_text() == "supplied mass t"
    assert axes.get_title() == ""  # the axes are the user's
    axes.figure.savefig(os.devnull, format="png")


def test_a_survey_is_plotted_in_its_units():
    run, axes = solved(survey=True), Figure().subplots()
    hj.plot(run, ax=axes)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (ft)", "height (ft)")
    np.testing.assert_allclose(curves(axes)[0].get_xdata(), 200.0 + 50.0 * run.x)
    np.testing.assert_allclose(curves(axes)[-1].get_ydata(), 120.0 + 25.0 * run.u[-1])
    assert axes.get_legend().get_title().get_text() == "supplied volume per width (ft²)"


def test_the_flux_and_the_diagram():
    run, (left, right) = solved(), Figure().subplots(1, 2)
    hj.plot(run, "flux", left)
    for line, K in zip(curves(left), run.K, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), K)
    hj.plot(run, "diagram", right)
    (sheet,) = right.images
    assert sheet.get_extent() == [run.x[0], run.x[-1], 0.0, 1.0] and right.get_ylabel() == "supplied mass t"
    (bar,) = set(right.figure.axes) - {left, right}
    assert bar.get_ylabel() == "excess slope q"
    right.figure.savefig(os.devnull, format="png")


def test_a_new_figure_belongs_to_pyplot_and_has_the_title():
    axes = hj.plot(solved())
    assert axes.figure.number in pyplot.get_fignums() and axes.get_title() == "$x_"
    axes.figure.savefig(os.devnull, format="png")  # the title is no formula
    figure = solved().plot(kind="norms")
    assert isinstance(figure, Figure) and len(figure.axes) == 8
    figure.savefig(os.devnull, format="png")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"kind": "profil"}, "kind = 'profil' is not known; did you mean 'profile'"),
        ({"kind": 3}, "kind = 3 is not known"),
        ({"kind": "norms", "ax": Figure().subplots()}, "eight panels"),
        ({"ax": Figure()}, "must be of the type Axes"),
    ],
)
def test_bad_arguments_are_rejected(arguments, words):
    with pytest.raises(hj.InputError, match=words):
        hj.plot(solved(), **arguments)
    with pytest.raises(hj.InputError, match="must be of the type Run"):
        hj.plot("results/two_kinks")


def test_it_works_without_a_display(tmp_path):
    program = (
        "import hjprofile as hj\n"
        "run = hj.solve_hj(hj.Problem(hj.rational(), hj.kinks([-1.0], [1.0]), 0.1), hj.Grid(-2.0, 40))\n"
        "run.plot().figure.savefig('a.png')\n"
    )
    absent = ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")
    settings = {name: value for name, value in os.environ.items() if name not in absent}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, env=settings)
    assert (done.returncode, done.stderr) == (0, "") and (tmp_path / "a.png").stat().st_size > 1000


def test_animations_and_vtk_files(tmp_path):
    """Both are the files of the commands; the names of snapshots of a longer run do not stay."""
    run = solved()
    assert hj.animate(run, tmp_path / "deep" / "a.gif", fps=4.0).read_bytes()[:3] == b"GIF"
    with pytest.raises(hj.InputError, match=r"ends in \.gif or \.mp4"):
        hj.animate(run, tmp_path / "a.avi")
    files = hj.export_vtk(run, tmp_path / "vtk")
    expected = {f"{kind}_{i:04d}.vtp" for kind in ("profile", "kinks") for i in range(3)}
    expected |= {"profile.pvd", "kinks.pvd", "sheet.vtr"}
    assert {path.name for path in files} == expected
    written = hj.write_run(run, tmp_path / "run", plots=False)
    for path in files:
        assert path.read_bytes() == (tmp_path / "run" / "vtk" / path.name).read_bytes()
    assert len(written) == 5 + len(files)
    with pytest.raises(hj.InputError, match="belongs to"):
        hj.export_vtk(solved(survey=True), tmp_path / "run")
