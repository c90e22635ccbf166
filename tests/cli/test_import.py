"""The command `import`: a case from a file of measured points, which runs."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import hjprofile as hj

X = np.arange(0.0, 121.0)
HEIGHT = np.round(400.0 + 0.36 * X + np.sin(X / 9.0), 2)


def export(path, x=X, height=HEIGHT):
    """Write points as a spreadsheet with decimal commas does."""
    rows = (f"{a:.2f};{b:.2f}".replace(".", ",") for a, b in zip(x, height, strict=True))
    Path(path).write_text("Abstand (m);Höhe (m)\n" + "\n".join(rows), encoding="latin-1")


def test_an_export_becomes_a_case_that_runs(in_tmp, call):
    """The clean survey has the points of the export, and the case gives their profile."""
    export("ridge.txt")
    code, out, err = call("import", "ridge.txt", "--critical-slope", "0.36", "--length", "12")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "ridge.txt: 121 points; separated by semicolons, decimal commas, Latin-1",
        "written: ridge.csv, ridge.toml",
        "next: hjprofile run ridge.toml",
    ]
    x, height, _ = hj.read_survey("ridge.csv")
    assert np.array_equal(x, X) and np.array_equal(height, HEIGHT)
    case = hj.load_case("ridge.toml")
    units = case.problem.profile.units
    assert (units.critical_slope, units.length) == (0.36, 12.0)
    assert case.grid.left == pytest.approx(-1.02 * 10.0)
    assert hj.solve_case(case).done


def test_parameters_that_are_not_given_are_assumed_and_stated(in_tmp, call):
    """The mean slope and a tenth of the extent; a survey that falls somewhere is repaired by the case."""
    height = HEIGHT.copy()
    height[60:64] = height[60]
    export("ridge.csv", height=height)
    code, out, _ = call("import", "ridge.csv")
    assert code == 0 and "assumed: critical_slope (the mean slope) and length (a tenth of the extent)" in out
    assert "does not rise in 3 of 120 intervals, so the case repairs it" in out and "ridge_clean.csv" in out
    table = tomllib.loads(Path("ridge.toml").read_text(encoding="utf-8"))["profile"]
    assert table["length"] == 12.0 and table["repair"] == "isotonic"
    assert table["critical_slope"] == pytest.approx(np.ptp(height) / 120.0, rel=5e-3)


@pytest.mark.parametrize("options", [[], ["--uphill", "left"]])
def test_a_crest_at_the_left_stays_there(in_tmp, call, options):
    """The survey keeps its coordinates, and the case states its direction."""
    export("left.txt", height=HEIGHT[::-1])
    assert call("import", "left.txt", *options)[0] == 0
    x, height, _ = hj.read_survey("left.csv")
    assert np.array_equal(x, X) and np.array_equal(height, HEIGHT[::-1])
    assert hj.load_case("left.toml").problem.profile.units.direction == -1.0


def test_one_flank_of_a_hill_is_imported(in_tmp, call):
    """The message on two flanks names the options that choose one."""
    export("hill.txt", x=np.arange(0.0, 240.5), height=np.append(HEIGHT, HEIGHT[-2::-1]))
    assert "with the crest at row 122 (x = 120); use from/to: to = 120" in call("import", "hill.txt")[2]
    assert call("import", "hill.txt", "--to", "120")[0] == 0
    assert np.array_equal(hj.read_survey("hill.csv")[1], HEIGHT)
    assert call("import", "hill.txt", "--from", "120", "--out", "right.toml")[0] == 0
    assert hj.load_case("right.toml").problem.profile.units.direction == -1.0


def test_columns_and_missing_heights_are_options(in_tmp, call):
    """Columns by name or number, and a number that stands for no height."""
    rows = "".join(f"{a},7,{b}\n" for a, b in zip(X, np.where(X == 5.0, 1.5, HEIGHT), strict=True))
    Path("log.csv").write_text("a,b,c\n" + rows)
    assert "--columns a,c" in call("import", "log.csv")[2]
    code, out, _ = call("import", "log.csv", "--columns", "1,3", "--nodata", "1.5", "--out", "made/log.toml")
    assert code == 0 and "1 row without a height left out" in out
    assert hj.read_survey("made/log.csv")[0].size == 120


@pytest.mark.parametrize(
    ("height", "options", "words"),
    [
        (np.concatenate([HEIGHT[:61], HEIGHT[:60][::-1]]), [], "has two flanks, with the crest at row 62 (x = 60)"),
        (np.full(121, 3.0), [], "is level"),
        (HEIGHT, ["--length", "-1"], "length = -1.0 must be a positive number"),
        (HEIGHT, ["--out", "there.toml"], "there.toml exists, and import replaces no file"),
    ],
)
def test_what_is_no_survey_leaves_no_file(in_tmp, call, height, options, words):
    """Exit code 2, the reason, and no new file."""
    export("ridge.txt", height=height)
    Path("there.toml").write_text("")
    code, out, err = call("import", "ridge.txt", *options)
    assert (code, out) == (2, "") and words in err
    assert sorted(path.name for path in in_tmp.iterdir()) == ["ridge.txt", "there.toml"]
