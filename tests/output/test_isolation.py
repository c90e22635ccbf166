"""The same run gives the same pictures, whatever the user has set up, and leaves the user's settings as they were."""

import dataclasses
import os
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path

import matplotlib
import pytest
import tomli_w

import hjprofile as hj
from hjprofile.output.plots import style
from hjprofile.output.plots.animation import animation
from hjprofile.output.plots.comparison import draw_comparison
from hjprofile.output.plots.runs import draw_factor, pictures
from hjprofile.output.plots.study_pictures import stability_picture
from hjprofile.studies.stability import Trial


@lru_cache
def solved():
    problem = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=0.2, snapshots=3, title="A kink")
    return hj.solve_hj(problem, hj.Grid(-2.0, 40))


def all_settings():
    return {name: repr(value) for name, value in matplotlib.rcParams.copy().items()}


CHANGES = {
    "text.usetex": True, "font.size": 30.0, "axes.grid": True, "lines.linewidth": 9.0, "savefig.facecolor": "red",
    "axes.prop_cycle": matplotlib.cycler(color=["red"]), "text.antialiased": False, "savefig.bbox": "tight",
    "figure.facecolor": "blue", "text.parse_math": True, "axes.formatter.use_locale": True, "path.simplify": False,
}  # fmt: skip


def test_the_users_settings_have_no_effect_and_stay():
    trials = [Trial("case", "godunov", "cfl", cfl, "holds", "", 1.0) for cfl in (0.5, 1.0)]

    def all_pictures():
        return [pictures(solved(), ["png"], ["factor"]), stability_picture(trials), animation(solved(), ".gif")]

    plain = all_pictures()
    title = Trial("$x_$", "godunov", "cfl", 1.0, "holds", "", 1.0)
    assert stability_picture([title])
    with matplotlib.rc_context(CHANGES):
        before = all_settings()
        assert all_pictures() == plain
        assert all_settings() == before


def test_threads_draw_the_same_and_leave_the_settings(monkeypatch):
    """One begins to draw while the other is at it, and the one that began first ends first."""
    run, before, honest = solved(), all_settings(), style.sheet
    names = ["factor", "diagram"]
    alone = pictures(run, names=names)

    def slow(*arguments, **named):
        time.sleep(0.2)
        return honest(*arguments, **named)

    monkeypatch.setattr(style, "sheet", slow)
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(lambda name: pictures(run, names=[name]), names))
    assert [data for files in together for data in files.values()] == [*alone.values()]
    assert all_settings() == before


@pytest.mark.parametrize(
    "title",
    [
        "100 $ and $ \\frac",
        "字 \U0001f600 \x07",
        *(pytest.param(title, marks=pytest.mark.slow) for title in ("$x_$", "_hidden %")),
    ],
)
def test_a_title_is_text_and_nothing_else(title):
    run = dataclasses.replace(solved(), title=title)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert style.encode(draw_factor(run), "png")
        assert style.encode(draw_comparison(run, run, (title, title)), "svg")
    assert draw_factor(run).texts[0].get_text().strip() == title.strip()


SCENE = {
    "title": "A kink",
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-1.0], "amplitudes": [0.5]},
    "domain": {"left": -2.0, "cells": 40},
    "time": {"end": 0.2, "snapshots": 3},
    "output": {"vtk": False},
}


@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline"])
def test_a_notebooks_backend_and_a_matplotlibrc_have_no_effect(in_tmp, backend):
    """No such module is installed, LaTeX neither; one line of the file is no setting."""
    Path("scene.toml").write_text(tomli_w.dumps(SCENE))
    Path("matplotlibrc").write_text("text.usetex: True\nfont.size: 30\nno.such: setting\n")
    command = [sys.executable, "-m", "hjprofile", "run", "scene.toml"]
    done = subprocess.run(command, env=os.environ | {"MPLBACKEND": backend}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "") and "WARNING" not in done.stdout
    expected = pictures(hj.load_run("results/scene"))
    assert {name: Path("results/scene", name).read_bytes() for name in expected} == expected


def test_the_backend_of_a_notebook_remains(in_tmp):
    """What the library imports first, the user's own pictures still go where they went."""
    program = "import hjprofile.output.plots, matplotlib; print(dict.__getitem__(matplotlib.rcParams, 'backend'))"
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"MPLBACKEND": "svg"}, capture_output=True, text=True
    )
    assert (done.stdout, done.stderr) == ("svg\n", "")


@pytest.mark.parametrize("encoding", ["ascii"])
def test_a_terminal_that_lacks_letters_ends_no_command(in_tmp, encoding):
    Path("scène α.toml").write_text(
        tomli_w.dumps(SCENE | {"title": "α ∫ 字", "output": {"vtk": False, "plots": False}}), encoding="utf-8"
    )
    environment = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    program = (
        "import sys\nfrom hjprofile.cli import main\n"
        "for command in (['run', 'scène α.toml'], ['run', 'scène α.toml', '--json'],\n"
        "                ['compare', 'results/scène α', 'results/scène α']):\n"
        "    try: main(command)\n    except SystemExit as left: assert left.code == 0\n"
        "main(['run', 'no ∫.toml'])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True)
    out, err = done.stdout.decode(encoding), done.stderr.decode(encoding)
    assert (
        done.returncode == 2 and err.startswith("hjprofile: no ?.toml: there is no such file") and err.count("\n") == 1
    )
    assert Path("results/scène α/comparison.png").exists() and "sup|u? - u?| = 0" in out
    document = out[out.index("{") : out.index("\n}\n") + 2]
    assert __import__("json").loads(document)["title"] == "α ∫ 字"  # a script loses no letter
