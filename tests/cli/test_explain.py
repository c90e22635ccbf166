"""`hjprofile explain`: the sections of the page on errors, and the page inside the package."""

import json
import tomllib

import pytest
from errors_page import ROOT, anchors, page

from hjprofile import error_page
from hjprofile.errors import PAGE


def test_headings_are_listed(call):
    code, out, err = call("explain")
    assert (code, err) == (0, "")
    listed = [line.strip() for line in out.splitlines()]
    assert len(listed) == len(set(listed)) and set(listed) < anchors() and len(listed) == len(anchors()) - 1  # no title
    assert json.loads(call("explain", "--json")[1]) == {"headings": listed}


@pytest.mark.parametrize("words", [["a-survey"], ["A", "survey"], ["docs/errors.md#a-survey"]])
def test_a_section_is_printed(call, words):
    code, out, err = call("explain", *words)
    assert (code, err) == (0, "") and out.startswith("A survey\n\n")
    assert "`a survey needs either a file, or x and height`" in out
    assert "`hjprofile explain the-stretch-of-a-survey`" in out and "](" not in out and "<!--" not in out


def test_every_section_has_text_or_subsections(call):
    for name, section in error_page.sections().items():
        assert section.text or section.within, name
        found = json.loads(call("explain", name, "--json")[1])
        assert found == {"heading": name, "title": section.heading, "text": section.text, "within": section.within}


def test_a_line_of_an_example_is_no_heading():
    assert "# Measured in May" in error_page.sections()["an-imported-survey"].text


def test_an_unknown_heading(call):
    code, out, err = call("explain", "a", "survy")
    assert (code, out) == (2, "") and "'a survy' is not a heading" in err and "did you mean 'a-survey'?" in err
    code, _, err = call("explain", "zzz")
    assert code == 2 and "did you mean" not in err and "`hjprofile explain` lists them" in err


def test_a_message_names_its_section(call, in_tmp):
    _, _, err = call("run", "nothing")
    heading = err.rpartition("(see: hjprofile explain ")[2].removesuffix(")\n")
    assert heading == "a-case-that-is-not-there" and heading in error_page.sections()


def test_a_wheel_contains_the_page(tmp_path, monkeypatch):
    """An installed package has no folder docs/: the page lies next to its modules."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included[PAGE] == "hjprofile/errors.md" and (ROOT / PAGE).is_file()
    (tmp_path / "hjprofile").mkdir()
    (tmp_path / "hjprofile" / "errors.md").write_text(page(), encoding="utf-8")
    expected = error_page.sections()
    monkeypatch.setattr(error_page, "__file__", str(tmp_path / "hjprofile" / "error_page.py"))
    error_page.sections.cache_clear()
    assert error_page.sections() == expected
    error_page.sections.cache_clear()
