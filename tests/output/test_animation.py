"""A run as a moving picture: every saved time, nothing else; whole or not at all."""

import dataclasses
import io
import os
import sys
from functools import lru_cache

import numpy as np
import pytest
from legible import assert_legible
from PIL import Image

import hjprofile as hj
from hjprofile.output.plots import animation as film
from hjprofile.output.plots import style
from hjprofile.output.plots.animation import animation, frames
from hjprofile.output.plots.style import DEPOSITED, ERODED, change_of
from hjprofile.output.store import write_run


@lru_cache
def solved(name="bump"):
    if name == "survey":
        case = hj.load_case("hillslope", {"domain.cells": 260, "time.end": 0.5, "time.snapshots": 4})
        return hj.solve_case(case)
    profile = hj.bumps([0.8, -0.3], [-3.0, -1.5], [0.5, 0.4])
    end, snapshots = {"bump": (2.0, 6), "short": (2.0, 2), "no time": (0.0, 1)}[name]
    problem = hj.Problem(hj.rational(), profile, end=end, snapshots=snapshots, title="A bump breaks")
    return hj.solve_hj(problem, hj.Grid(-5.0, 200))


@pytest.mark.parametrize("name", ["bump", "survey", "no time"])
def test_every_saved_time_is_shown(name):
    """In axes that stay where they are: the areas drawn are those of that time, kinks and trails reach until then."""
    run = solved(name)
    figure, moving, show = film._animated_figure(run)
    figure.canvas.draw()
    limits = [(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes]
    top, bottom = figure.axes
    for axes, values in ((top, run.units.height(run.u) if run.units else run.u), (bottom, run.q)):
        low, high = axes.get_ylim()
        assert low < values.min() and values.max() < high  # room for all times
    shades, trails, dots = top.collections, top.lines[2:-1], top.lines[-1]
    x, u = (run.units.x(run.x), run.units.height(run.u)) if run.units else (run.x, run.u)
    for i in range(run.time.size):
        show(i)
        figure.canvas.draw()
        assert [(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes] == limits
        assert np.array_equal(top.lines[1].get_ydata(), u[i]) and np.array_equal(bottom.lines[0].get_ydata(), run.q[i])
        areas = change_of(u[i], u[0], x)
        for shade, area in zip(shades, areas, strict=True):
            (path,) = shade.get_paths()
            a, b = path.vertices[:-1].T
            shoelace = 0.5 * abs(a @ np.roll(b, 1) - b @ np.roll(a, 1))
            assert shoelace == pytest.approx(area, rel=1e-9, abs=1e-6 * np.ptp(u))  # sums of large numbers
        strongest = sorted(run.kinks_at(i), key=lambda k: k.jump)[-style.DOTS :]
        assert sorted(dots.get_xdata()) == sorted(float(run.units.x(k.x)) if run.units else k.x for k in strongest)
        assert sum(len(t.get_xdata()) for t in trails) == sum(len(run.kinks_at(j)) for j in range(i + 1))
        poured = run.time[i] * (run.units.volume if run.units else 1.0)
        assert moving[-3].get_text().startswith("supplied ")
        assert float(moving[-3].get_text().split()[1].replace(",", "")) == pytest.approx(poured, rel=0.01, abs=0.5)
    assert_legible(figure)


@pytest.mark.parametrize(("unit", "words"), [("", "survey units²"), ("m", "m²")])
def test_the_unit_of_areas_is_named(unit, words):
    run = solved("survey")
    figure, _, _ = film._animated_figure(dataclasses.replace(run, units=dataclasses.replace(run.units, unit=unit)))
    assert f"areas and supplied volume per width in {words}" in [text.get_text() for text in figure.texts]
    assert figure.axes[1].get_xlabel() == f"x ({words[:-1]})"


def test_colours_of_the_areas_grow():
    """In proportion, as counted in the pictures themselves; lines lie on some of it."""
    images = list(frames(solved()))
    assert len(images) == 6 and {image.shape for image in images} == {images[0].shape}
    assert images[0].shape[0] % 2 == images[0].shape[1] % 2 == 0  # as MP4 needs
    run = solved()
    areas = np.array([change_of(u, run.u[0], run.x) for u in run.u]).T
    for colour, area in zip((ERODED, DEPOSITED), areas, strict=True):
        shade = np.round(255 * (0.6 + 0.4 * np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])))
        count = [np.count_nonzero(np.abs(image - shade).max(axis=2) <= 2) for image in images]
        count = np.array(count) - count[0]  # of its key in the legend
        assert count[-1] > 300 and np.corrcoef(count, area)[0, 1] > 0.95  # measured 0.97


def test_a_gif():
    told, images = [], list(frames(solved()))
    data = animation(solved(), ".gif", 5.0, told.append)
    assert told == [(i + 1) / 6 for i in range(6)] and len(data) < 2e5
    with Image.open(io.BytesIO(data)) as gif:
        assert gif.n_frames == 6 and gif.info["loop"] == 0
        lasts = []
        for i in range(6):
            gif.seek(i)
            lasts.append(gif.info["duration"])
            shown = np.asarray(gif.convert("RGB")).astype(int)
            assert tuple(shown[0, 0]) == (255, 255, 255)
            assert np.abs(shown - images[i]).mean() < 1.0  # 64 colours
        assert lasts == [200] * 5 + [1500]


@pytest.fixture
def result(in_tmp):
    write_run(solved("short"), "bump", vtk=False, plots=False)
    return in_tmp / "bump"


def test_the_command(result, call):
    code, out, err = call("animate", "bump")
    assert (code, err, out.strip()) == (0, "", "bump: profile.gif") and (result / "profile.gif").read_bytes()[
        :3
    ] == b"GIF"
    assert call("animate", "bump", "--out", "deep/film.gif", "--fps", "20")[0] == 0
    with Image.open("deep/film.gif") as gif:
        assert gif.info["duration"] == 50
    write_run(solved("short"), "bump", vtk=False, plots=False)  # a new run there
    assert not (result / "profile.gif").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "film.avi"], "ends in .gif or .mp4, not in '.avi'"),
        (["--out", "film"], "ends in .gif or .mp4, not in ''"),
        (["--fps", "0"], "fps = 0.0 must be a positive number"),
        (["--fps", "nan"], "fps = nan must be a positive number"),
        (["--out", "film.mp4"], "needs the program ffmpeg, which is not on the PATH"),
    ],
)
def test_one_sentence_where_it_cannot(result, call, monkeypatch, arguments, words):
    monkeypatch.setenv("PATH", str(result))
    before = sorted(p for p in result.parent.rglob("*"))
    code, out, err = call("animate", "bump", *arguments)
    assert (code, out) == (2, "") and words in err and err.count("\n") == err.count("(see: hjprofile explain a-") == 1
    assert sorted(p for p in result.parent.rglob("*")) == before


FFMPEG = """#!{python}
import sys
data = sys.stdin.buffer.read()
if {fails}:
    sys.exit("first line\\nNo room for a film")
with open(sys.argv[-1], "wb") as file:
    file.write(repr((len(data), sys.argv[1:-1])).encode())
"""


@pytest.fixture
def ffmpeg(in_tmp, monkeypatch):
    """A stand-in that takes what it is given: the pictures as bytes, and how to read them."""

    def install(fails=False):
        program = in_tmp / "bin" / "ffmpeg"
        program.parent.mkdir(exist_ok=True)
        program.write_text(FFMPEG.format(python=sys.executable, fails=fails))
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")

    return install


def test_an_mp4_by_ffmpeg(result, call, ffmpeg):
    ffmpeg()
    assert call("animate", "bump", "--out", "film.mp4", "--fps", "4")[0] == 0
    size, options = eval((result.parent / "film.mp4").read_text())
    rows, columns, _ = next(frames(solved())).shape
    assert size == (2 + 6) * rows * columns * 3  # the last picture stays for 1.5 seconds
    assert f"{columns}x{rows}" in options and options[options.index("-r") + 1] == "4" and "yuv420p" in options


def test_ffmpeg_that_fails(result, call, ffmpeg):
    ffmpeg(fails=True)
    code, _, err = call("animate", "bump", "--out", "film.mp4")
    assert code == 1 and "ffmpeg could not write the MP4: No room for a film" in err
    assert not (result.parent / "film.mp4").exists()


def test_whole_or_not_at_all(result, call, monkeypatch):
    call("animate", "bump")
    before = {p.name: p.read_bytes() for p in result.iterdir()}

    def no_room(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", no_room)
    code, _, err = call("animate", "bump", "--fps", "3")
    assert code == 1 and "No space left" in err
    assert {p.name: p.read_bytes() for p in result.iterdir()} == before
