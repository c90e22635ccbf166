"""Files of points in the notations that programs write: what is read, what is reported, what is refused."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hjprofile as hj
from hjprofile.problem import survey_file
from hjprofile.problem.survey_file import read_points

X = np.arange(0.0, 60.5, 0.5)
HEIGHT = np.round(1200.0 + 0.4 * X + np.sin(X / 9.0), 2)


def text_number(value, decimals, comma, thousands):
    text = f"{value:,.{decimals}f}" if thousands else f"{value:.{decimals}f}"
    return text.translate(str.maketrans(",.", ".,")) if comma else text


NOTATIONS = st.fixed_dictionaries(
    {
        "separator": st.sampled_from([",", ";", "\t", "|", "  ", " "]),
        "comma": st.booleans(),
        "thousands": st.booleans(),
        "encoding": st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
        "header": st.sampled_from(
            ["", "x{}height", "Distance (m){}Elevation (m)", "CHAINAGE{}Z", "dist_m{}elev_m", "Länge [m]{}Höhe [m]"]
        ),
        "comments": st.booleans(),
        "newline": st.sampled_from(["\n", "\r\n"]),
        "descends": st.booleans(),
        "trailing": st.booleans(),
    }
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(NOTATIONS)
def test_a_table_is_read_in_any_notation(tmp_path_factory, notation):
    """Points written in a random notation come back as they were, and the account names the notation."""
    n = notation
    separator, quoted = n["separator"], False
    if separator == "," and (n["comma"] or n["thousands"]):
        quoted = True
    if quoted and n["comma"]:
        n["comma"] = False  # quoted decimal commas in a file with commas are thousands to every program
    header = "" if separator.isspace() and separator != "\t" else n["header"].format(separator)
    points = list(zip(X.tolist(), HEIGHT.tolist(), strict=True))
    lines = ["# measured in June"] * n["comments"] + [header] * bool(header)
    for x, height in points[::-1] if n["descends"] else points:
        cells = text_number(x, 2, n["comma"], False), text_number(height, 2, n["comma"], n["thousands"])
        cells = [f'"{cell}"' for cell in cells] if quoted else cells
        lines.append(separator.join(cells))
    path = tmp_path_factory.mktemp("survey") / "survey.txt"
    path.write_bytes((n["newline"].join(lines) + n["newline"] * n["trailing"]).encode(n["encoding"]))
    found = read_points(path)
    assert np.array_equal(found.x, X) and np.array_equal(found.height, HEIGHT)
    assert ("x descends" in found.account) == n["descends"]
    assert ("decimal commas" in found.account) == n["comma"]
    assert found.unit == ("m" if "[m]" in header or "(m)" in header or "_m" in header else "")


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "survey.csv"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("text", "columns", "x", "height", "account"),
    [
        ("id,x,height,note\n1,0,5,ok\n2,1,6,wet\n", None, [0, 1], [5, 6], "columns x and height"),
        ("a,b,c\n0,9,5\n1,8,6\n", ["a", "c"], [0, 1], [5, 6], "columns a and c"),
        ("a,b,c\n0,9,5\n1,8,6\n", [1, 3], [0, 1], [5, 6], "columns a and c"),
        ("x,y,z\n10,20,5\n13,24,6\n", None, [0, 5], [5, 6], "distance along the line"),
        ("easting;northing;elev\n10,0;20,0;5,5\n13,0;24,0;6,5\n", None, [0, 5], [5.5, 6.5], "distance along"),
        ("500000.5 4000000 5\n500003.5 4000004 6\n", None, [0, 5], [5, 6], "distance along the line"),
        ("x,height\n0,5\n1,\n2,nan\n3,8\n", None, [0, 3], [5, 8], "2 rows without a height left out"),
        ("x,height\n0,5\n1,-9999\n2,7\n3,8\n", None, [0, 2, 3], [5, 7, 8], "1 row without a height left out"),
        ("x,height\n0,5\n1,6\n1,8\n2,9\n", None, [0, 1, 2], [5, 7, 9], "1 repeated x, heights averaged"),
        ("x,height\n2,9\n0,5\n1,6\n", None, [0, 1, 2], [5, 6, 9], "rows sorted by x"),
        ("sep=;\nx;height\n0,5;1,5\n1,5;2,5\n", None, [0.5, 1.5], [1.5, 2.5], "semicolons, decimal commas"),
        ("0+000,5\n0+020,6\n1+000,7\n", None, [0, 20, 1000], [5, 6, 7], ""),
        ("1'200;5\n1'300;6\n", None, [1200, 1300], [5, 6], "semicolons"),
        ("1 200,5;5\n1 300,5;6\n", None, [1200.5, 1300.5], [5, 6], "decimal commas"),
        ("Profile 7\nx,height\nm,m\n0,5\n1,6\n", None, [0, 1], [5, 6], ""),
    ],
)
def test_columns_gaps_and_order(tmp_path, text, columns, x, height, account):
    """Each file gives its points, and the account states what was done to it."""
    found = read_points(written(tmp_path, text), columns)
    assert found.x.tolist() == x and found.height.tolist() == height
    assert account in found.account and (found.account == "" if not account else True)


def dialect(name):
    """The points X, HEIGHT as a program of that name writes them; written independently of the reader."""
    rows = list(enumerate(zip(X.tolist(), HEIGHT.tolist(), strict=True)))

    def comma(value):
        return f"{value:.2f}".replace(".", ",")

    head, line = {
        "pandas": (",x,z", lambda i, x, h: f"{i},{x},{h}"),
        "markdown": ("| x | z |\n|---|---|", lambda i, x, h: f"| {x} | {h} |"),
        "reduced levels": ("Chainage(m),RL(m)", lambda i, x, h: f"{x:.2f},{h:.2f}"),
        "long names": (
            "Nr;Distance along profile [m];Elevation above sea level [m];Code", lambda i, x, h: f"{i};{x};{h};A1"
        ),
        "Fortran": ("", lambda i, x, h: f"  {x:.4e}  {h:.9e}".replace("e", "D")),
        "separators at the end": ("x;height;", lambda i, x, h: f"{x};{h};"),
        "survey book": (
            "Point,Northing,Easting,Elevation,Description",
            lambda i, x, h: f"{i},{5160000 + 0.8 * x:.3f},{540000 + 0.6 * x:.3f},{h},gs",
        ),
        "German": ("Entfernung;Höhe ü. NN", lambda i, x, h: f"{comma(x)};1.{comma(h - 1000.0)}"),
        "Spanish": ("Punto;Progresiva (m);Cota (m);Obs", lambda i, x, h: f"{i};{comma(x)};{comma(h)};-"),
        "French": ("N°;Distance;Altitude;Remarque", lambda i, x, h: f"{i};{comma(x)};{comma(h)};ok"),
        "hard blanks": ("x;h", lambda i, x, h: f"{comma(x)};1\u00a0{comma(h - 1000.0)}"),
        "two lines of names": ("Profile A, 2024\nDistance,Height\n(m),(m)", lambda i, x, h: f"{x},{h}"),
        "quoted decimal commas": ('"x","height"', lambda i, x, h: f'"{comma(x)}","{comma(h)}"'),
        "shape file": ("FID,Id,FIRST_DIST,FIRST_Z", lambda i, x, h: f"{i},0,{x},{h}"),
        "track": (
            "id,time,distance_m,ele", lambda i, x, h: f"{i},2024-05-01T10:{i // 60:02d}:{i % 60:02d}Z,{x},{h}"
        ),
        "height first": ("elevation,distance", lambda i, x, h: f"{h},{x}"),
        "aligned": ("x ,  height", lambda i, x, h: f"{x:8.2f} , {h:10.2f}"),
        "a last line": ("x,height", lambda i, x, h: f"{x},{h}" + "\nEND" * (i == X.size - 1)),
        "remarks in some rows": ("x,height,remark", lambda i, x, h: f"{x},{h}" + ",tree" * (i % 3 == 0)),
        "signs": ("", lambda i, x, h: f"+{x:.2f},+{h:.2f}"),
    }[name]  # fmt: skip
    return "\n".join([head] * bool(head) + [line(i, x, h) for i, (x, h) in rows]) + "\n"


DIALECTS = (
    "pandas", "markdown", "reduced levels", "long names", "Fortran", "separators at the end", "survey book", "German",
    "Spanish", "French", "hard blanks", "two lines of names", "quoted decimal commas", "shape file", "track",
    "height first", "aligned", "a last line", "remarks in some rows", "signs",
)  # fmt: skip


@pytest.mark.parametrize("name", DIALECTS)
def test_exports_of_programs_are_read(tmp_path, name):
    """To within the digits that the export has."""
    x, height, _ = hj.read_survey(written(tmp_path, dialect(name)))
    np.testing.assert_allclose(x, X, rtol=0, atol=2e-3)  # millimetres of easting and northing
    np.testing.assert_allclose(height, HEIGHT, rtol=0, atol=1e-5)


def test_numbers_of_missing_heights_may_be_given(tmp_path):
    """A number that is listed stands for no height, even if it could be one."""
    path = written(tmp_path, "x,height\n0,5\n1,0\n2,7\n")
    assert read_points(path).height.tolist() == [5, 0, 7]
    assert read_points(path, nodata=[0]).height.tolist() == [5, 7]


@pytest.mark.parametrize(
    ("text", "columns", "words"),
    [
        (
            "x,height\n0,5\n1,wet\n2,7\n3,?\n",
            None,
            "2 rows without numbers in the columns x, height: row 3: '1,wet'; row 5",
        ),
        ("x,height\n" + "a,b\n" * 9 + "1,2\n3,4\n", None, "9 rows without numbers.*; 4 more"),
        ("a,b,c\n0,9,5\n1,8,6\n", None, r"numeric columns 'a', 'b', 'c'; name those .* --columns a,c"),
        ("a,height\n0\n0,0\n\x010,\x010\n", None, r"numeric columns 'a', 'height'; name those .* --columns a,height"),
        ("a,b\n0,9\n1,8\n", ["a", "z"], "no column 'z'; it has 'a', 'b'"),
        ("a,b\n0,9\n1,8\n", [1, 3], "no column 3"),
        ("lon,lat,z\n9.1,48.2,5\n9.2,48.2,6\n", None, "degrees are no lengths"),
        ("x (km),height (m)\n0,5\n1,6\n", None, "the units km and m in its header"),
        ("x,height\nkm,m\n0,5\n1,6\n", None, "the units km and m in its header"),
        ("x,height\n", None, "no line with two numbers"),
        ("x,height\n1,2\n", None, "has 1 point;"),
        ("nothing here\n", None, "no line with two numbers"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, text, columns, words):
    """Every fault of a file is in one message, with rows."""
    with pytest.raises(hj.InputError, match=words):
        read_points(written(tmp_path, text), columns)


def test_a_spreadsheet_is_no_text(tmp_path):
    """A file of bytes is refused with the remedy."""
    path = tmp_path / "survey.csv"
    path.write_bytes(b"PK\x03\x04" + bytes(200))
    with pytest.raises(hj.InputError, match="is not text; export the table as CSV"):
        read_points(path)


def test_a_file_is_parsed_once_and_read_each_time(in_tmp, monkeypatch):
    """As the members of a sweep do; an edit that leaves size and time unchanged counts, and results may be changed."""
    parsed = []
    honest = survey_file._split
    monkeypatch.setattr(survey_file, "_split", lambda text: parsed.append(text) or honest(text))
    path = in_tmp / "repeated.csv"
    path.write_text("x,height\n0,0\n10,20\n25,60\n")
    first = read_points(path)
    first.x[0], first.height[0] = -99.0, -99.0
    first.rows.clear()
    again = read_points(path)
    assert (again.x.tolist(), again.height.tolist(), again.rows) == ([0.0, 10.0, 25.0], [0.0, 20.0, 60.0], [2, 3, 4])
    assert len(parsed) == 1
    times = path.stat().st_atime_ns, path.stat().st_mtime_ns
    path.write_text("x,height\n0,0\n10,25\n25,60\n")
    os.utime(path, ns=times)
    assert read_points(path).height.tolist() == [0.0, 25.0, 60.0]
    assert read_points(path, nodata=[25.0]).height.tolist() == [0.0, 60.0]
    assert read_points(path, columns=[2, 1]).height.tolist() == [0.0, 10.0, 25.0]
    assert len(parsed) == 4
