"""A result folder belongs to one case: files of another case or of an older version of it are refused or removed."""

import json
from pathlib import Path

import pytest
import tomli_w

import hjprofile as hj
from hjprofile.errors import InputError
from hjprofile.output.checkpoint import NAME
from hjprofile.output.folder import RECORD, Owner, ResultFolder, owner_of
from hjprofile.studies.verdict import Consistency

CASE = {
    "title": "A kink",
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-1.0], "amplitudes": [0.5]},
    "domain": {"left": -2.0, "cells": 20},
    "time": {"end": 0.1, "snapshots": 2},
    "output": {"vtk": False, "plots": False},
}
RUN = {"profile.nc", "kinks.csv", "events.csv", "norms.csv", "summary.json"}


def write_case(path, **changes):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(tomli_w.dumps(CASE | changes), encoding="utf-8")
    return path


def names(folder):
    found = (p.relative_to(folder).as_posix() for p in Path(folder).rglob("*") if p.is_file())
    return set(found) - {RECORD}


@pytest.fixture
def stand_ins(monkeypatch):
    """Studies that take no time: their files are at stake here."""
    monkeypatch.setattr("hjprofile.studies.consistency.check", lambda case, progress: Consistency("case", "Case", ()))
    monkeypatch.setattr("hjprofile.output.workers.processes", lambda count: __import__("contextlib").nullcontext())
    undrawn(monkeypatch)


def undrawn(monkeypatch):
    """The pictures of a run are empty files, which take no time."""
    every = "profile", "diagram", "factor", "norms"

    def empty(run, forms=("png",), names=every):
        return {f"{name}.{form}": b"" for name in names for form in forms}

    monkeypatch.setattr("hjprofile.output.plots.runs.pictures", empty)
    monkeypatch.setattr("hjprofile.output.plots.animation.animation", lambda *_: b"")


def fill(call, case, *options):
    """Every kind of file that commands leave in the folder of a case."""
    for arguments in (["run", case], ["check", case], ["sweep", case, "--vary", "time.end=0.05,0.1"]):
        code, _, err = call(*arguments, *options)
        assert (code, err) == (0, "")


ALL = RUN | {"check.json", "sweep.csv", "sweep.nc"}


def test_commands_on_one_case_share_its_folder(in_tmp, call, stand_ins):
    fill(call, write_case("a/case.toml"))
    found = names("results/case")
    assert found > ALL and len(found) == len(ALL) + 2  # with two members
    assert call("run", "a/case.toml", "--cells", 20)[0] == 0 and names("results/case") == found  # as in the file


@pytest.mark.parametrize("change", [["--cells", "40"], ["--set", "erosion.law=log"], ["--end", "0.05"]])
def test_options_make_another_case(in_tmp, call, stand_ins, change):
    """The verdict and the sweep of the file are not those of the changed case; only the pictures are no part of it."""
    case = write_case("case.toml")
    fill(call, case)
    assert call("run", case, *change)[0] == 0 and names("results/case") == RUN
    Path("results/case/notes.txt").write_text("mine")
    assert call("check", case)[0] == 0 and names("results/case") == {"check.json", "notes.txt"}
    assert call("run", case, "--no-vtk", "--set", "output.plots=true")[0] == 0
    assert names("results/case") > RUN | {"check.json", "profile.png"}


def test_two_cases_of_one_name_do_not_share_a_folder(in_tmp, call, stand_ins):
    fill(call, write_case("a/case.toml"))
    before = {name: Path("results/case", name).read_bytes() for name in names("results/case")}
    write_case("b/case.toml", time={"end": 0.2, "snapshots": 2})
    studies = (["check"], ["stability"], ["dependence"], ["statements"], ["chart"])
    for command in (["run"], *studies, ["sweep", "--vary", "time.end=1"]):
        code, out, err = call(command[0], "b/case.toml", *command[1:])
        assert (code, out, err.count("\n")) == (2, "", 1) and "results/case belongs to " in err and "--out" in err
        assert str(in_tmp / "a/case.toml") in err and str(in_tmp / "b/case.toml") in err
    assert {name: Path("results/case", name).read_bytes() for name in names("results/case")} == before
    write_case("b/case.toml")  # the same case at another place
    assert call("run", "b/case.toml")[0] == 0


def test_a_folder_that_is_named_passes_to_the_new_case(in_tmp, call, stand_ins):
    fill(call, write_case("a/case.toml"), "--out", "out")
    Path("out/notes.csv").write_text("mine")
    Path("out/fit.json").write_text("mine")  # a name that hjprofile uses, but a file that it has not written
    code, _, err = call("check", write_case("b/other.toml", title="Another"), "--out", "out")
    assert (code, err) == (0, "") and names("out") == {"check.json", "notes.csv", "fit.json"}


def test_files_of_an_older_version_of_the_case_are_removed(in_tmp, call, stand_ins):
    case = write_case("case.toml")
    fill(call, case)
    write_case(case, output={"vtk": False, "plots": False}, expect={"anything": 1})  # nothing that changes a result
    assert call("check", case)[0] == 0 and names("results/case") > ALL
    write_case(case, time={"end": 0.15, "snapshots": 2})
    assert call("run", case)[0] == 0 and names("results/case") == RUN


def test_a_file_that_the_case_names_is_part_of_it(in_tmp, call, stand_ins):
    write_case("case.toml", profile={"kind": "survey", "file": "slope.csv", "critical_slope": 0.5, "length": 10.0})
    Path("slope.csv").write_text("x,height\n0,0\n10,6\n")
    first = owner_of([Path("case.toml")])
    assert call("check", "case.toml")[0] == 0
    Path("slope.csv").write_text("x,height\n0,0\n10,7\n")
    second = owner_of([Path("case.toml")])
    assert first.cases == second.cases and first.fingerprint != second.fingerprint
    assert call("run", "case.toml")[0] == 0 and names("results/case") == RUN | {"survey.csv"}


def test_a_run_that_does_not_start_leaves_the_older_one(in_tmp, call, monkeypatch):
    call("run", write_case("case.toml"))
    before = names("results/case")

    def stopped(*_):
        raise KeyboardInterrupt

    write_case("case.toml", time={"end": 0.15, "snapshots": 2})
    monkeypatch.setattr("hjprofile.solvers.solve.solve_and_keep", stopped)
    assert call("run", "case.toml")[0] == 1
    assert names("results/case") == before and hj.load_run("results/case").time[-1] == 0.1


def test_members_of_a_sweep_identify_themselves(in_tmp, call, stand_ins):
    """They outlive a change of the case only if the sweep is resumed."""
    case, members = write_case("case.toml"), Path("results/case/members")
    sweep = ["sweep", case, "--vary", "time.end=0.05,0.1"]
    call(*sweep)
    write_case(case, domain={"left": -2.0, "cells": 24})
    assert call(*sweep, "--resume")[0] == 0 and len(list(members.iterdir())) == 4
    write_case(case, domain={"left": -2.0, "cells": 28})
    assert call("run", case)[0] == 0 and not members.exists()


def test_a_checkpoint_of_another_case_is_not_discarded(in_tmp, call, monkeypatch):
    """A run that was killed has left nothing but its checkpoint, and the folder is that case's all the same."""
    owner = owner_of([Path(write_case("a/case.toml"))])
    folder = ResultFolder("results/case", owner).open()
    folder.claim(NAME)
    (folder.path / NAME).write_bytes(b"hours of work")
    write_case("b/case.toml", time={"end": 0.2, "snapshots": 2})
    assert call("run", "b/case.toml")[0] == 2 and (folder.path / NAME).read_bytes() == b"hours of work"


def test_pictures_do_not_go_into_the_folder_of_another_case(in_tmp, call):
    for name, end in (("a", 0.1), ("b", 0.2)):
        call("run", write_case(f"{name}.toml", time={"end": end, "snapshots": 2}))
    before = names("results/b")
    for command in (["export", "results/a", "--vtk"], ["compare", "results/a", "results/a"]):
        code, out, err = call(*command, "--out", "results/b")
        assert (code, out, err.count("\n")) == (2, "", 1) and "results/b belongs to " in err
    assert names("results/b") == before
    assert call("export", "results/a", "--vtk")[0] == 0 and "vtk/sheet.vtr" in names("results/a")
    assert call("run", "a.toml")[0] == 0 and names("results/a") == RUN  # what came of the former run is stale


def test_files_made_elsewhere_are_of_one_run(in_tmp, call, monkeypatch):
    """Those of an older run with more saved times are removed, and a folder of another run is refused."""
    undrawn(monkeypatch)
    call("run", write_case("a.toml", time={"end": 0.1, "snapshots": 5}))
    assert call("export", "results/a", "--vtk", "--out", "vtk")[0] == 0 and len(names("vtk")) > 5
    Path("vtk/notes.txt").write_text("mine")
    call("run", write_case("a.toml"))
    assert call("plot", "results/a", "--out", "vtk")[0] == 0
    assert not [name for name in names("vtk") if name.endswith(".vtp")] and Path("vtk/notes.txt").exists()
    call("run", write_case("b.toml", time={"end": 0.2, "snapshots": 2}))
    before = names("vtk")
    code, _, err = call("export", "results/b", "--vtk", "--out", "vtk")
    assert code == 2 and "vtk belongs to " in err and names("vtk") == before
    for name in ("a", "b"):  # a film that the user names is no folder of one case
        assert call("animate", f"results/{name}", "--out", f"films/{name}.gif")[0] == 0
    assert names("films") == {"a.gif", "b.gif"} and not Path("films", RECORD).exists()
    Path("results/b", RECORD).unlink()  # a result that was copied without its record
    assert call("plot", "results/b")[0] == 0 and call("run", "b.toml")[0] == 0


def test_runs_from_python_replace_each_other(in_tmp):
    grid = hj.Grid(-2.0, 20)
    for end in (0.1, 0.2):
        problem = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=end, snapshots=2)
        hj.write_run(hj.solve_hj(problem, grid), "out", vtk=end < 0.2, plots=False)
    assert names("out") == RUN and not Path("out/vtk").exists()


@pytest.mark.parametrize("files", [["../notes.csv"], ["/notes.csv"], ["vtk/../notes.csv"], ["*.csv"], [7], 7, None])
def test_a_record_cannot_remove_other_files(in_tmp, files):
    Path("out").mkdir()
    for path in ("notes.csv", "out/notes.csv"):
        Path(path).write_text("mine")
    Path("out", RECORD).write_text(json.dumps({"cases": ["x"], "fingerprint": "y", "files": files}))
    ResultFolder("out", Owner(("z",), "z")).open().write({"check.json": "{}"})
    assert Path("notes.csv").exists() and Path("out/notes.csv").exists()


def test_a_home_folder_in_paths(in_tmp, call, monkeypatch, stand_ins):
    """Also where no shell expands it: --out=~/results, and the files that a case names."""
    monkeypatch.setenv("HOME", str(in_tmp / "home"))
    survey = {"kind": "survey", "file": "~/slope.csv", "critical_slope": 0.5, "length": 10.0}
    write_case("home/case.toml", profile=survey)
    Path("home/slope.csv").write_text("x,height\n0,0\n10,6\n")
    assert call("check", "~/case.toml", "~/case.toml", "--out=~/both")[0] == 0 and Path("home/both").is_dir()
    assert call("run", "~/case.toml", "--out=~/results")[0] == 0 and names("home/results") == RUN | {"survey.csv"}
    assert call("export", "~/results", "--vtk", "--out=~/vtk")[0] == 0 and Path("home/vtk/sheet.vtr").exists()
    write_case("k.toml", coefficient={"kind": "run", "result": "~/results"})
    assert call("run", "k.toml")[0] == 0
    assert call("run", "~nobody-of-this-name/case.toml")[0] == 2
    assert not Path("~").exists()


def test_the_account_of_a_run_names_what_could_not_be_made(in_tmp, call, monkeypatch):
    """A picture and VTK files that fail cost the run nothing: data and summary are there, with a warning each."""

    def failing(*_, **__):
        raise ValueError("no\nfont")

    monkeypatch.setattr("hjprofile.output.plots.runs.draw_factor", failing)
    monkeypatch.setattr("hjprofile.output.vtk.vtk_files", failing)
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # no helper: it would not know of these
    code, out, err = call("run", write_case("case.toml", output={"vtk": True, "plots": True}))
    warnings = hj.load_run("results/case").warnings
    assert (code, err) == (0, "") and names("results/case") == RUN | {"profile.png", "diagram.png", "norms.png"}
    assert warnings == [
        "the VTK files could not be made (ValueError: no font); the data are complete",
        "factor.png could not be drawn (ValueError: no font); the data are complete",
    ]
    assert all(f"  WARNING     {warning}\n" in out for warning in warnings)


def test_a_picture_of_a_study_that_fails_costs_no_data(in_tmp, call, monkeypatch):
    from hjprofile.studies import stability

    def failing(*_):
        raise ValueError("no font")

    trial = stability.Trial("case", "godunov", "cfl", 0.5, "holds", "", 1.0)
    monkeypatch.setattr(stability, "scan", lambda *_: [trial])
    monkeypatch.setattr("hjprofile.output.plots.study_pictures.draw_stability", failing)
    code, out, err = call("stability", write_case("case.toml"))
    assert (code, err) == (0, "") and names("results/case") == {"stability.csv"}
    assert "WARNING: stability.png could not be drawn (ValueError: no font); the data are complete\n" in out


def test_no_picture_of_an_earlier_study_remains(in_tmp, call, monkeypatch):
    """With the tables of a later one, whose picture could not be drawn."""
    from hjprofile.studies import stability

    trial = stability.Trial("case", "godunov", "cfl", 0.5, "holds", "", 1.0)
    monkeypatch.setattr(stability, "scan", lambda *_: [trial])
    case = write_case("case.toml")
    monkeypatch.setattr("hjprofile.output.plots.study_pictures.stability_picture", lambda trials: b"drawn")
    assert call("stability", case)[0] == 0 and names("results/case") == {"stability.csv", "stability.png"}
    monkeypatch.setattr("hjprofile.output.plots.study_pictures.stability_picture", lambda trials: {}["font"])
    code, out, err = call("stability", case)
    assert (code, err) == (0, "") and names("results/case") == {"stability.csv"} and "could not be drawn" in out


def test_a_warning_from_python(in_tmp, monkeypatch):
    monkeypatch.setattr("hjprofile.output.vtk.vtk_files", lambda run: {}["mesh"])
    problem = hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=0.1, snapshots=2)
    with pytest.warns(UserWarning, match="the VTK files could not be made"):
        files = hj.write_run(hj.solve_hj(problem, hj.Grid(-2.0, 20)), "out", plots=False)
    assert {p.name for p in files} == RUN


def test_long_titles_are_refused(in_tmp):
    with pytest.raises(InputError, match=r"case\.toml: title has 501 characters; at most 500 are allowed"):
        hj.load_case(write_case("case.toml", title="x" * 501))
    with pytest.raises(InputError, match="title has 501 characters"):
        hj.Problem(hj.rational(), hj.kinks([-1.0], [0.5]), end=0.1, title="x" * 501)
