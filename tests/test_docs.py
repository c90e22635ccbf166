"""What the README shows is what comes out."""

import contextlib
import io
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def blocks(language):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.M | re.S)


def test_python_example_prints_what_the_readme_says():
    (code,), (shown,) = blocks("python"), blocks("text")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    assert printed.getvalue() == shown


def test_links_lead_somewhere():
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert target.startswith("http") or (page.parent / target).exists(), f"{page.name}: {target}"


def test_continuous_integration_runs_the_readmes_tests():
    test_command = blocks("sh")[1].splitlines()[-1].split("python ")[-1]
    assert test_command in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
