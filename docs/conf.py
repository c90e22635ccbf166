"""How Sphinx makes the site of these pages: `python -m sphinx -W -b html docs docs/_build`."""

import re
from pathlib import Path

import hjprofile

project = "hjprofile"
author = "The hjprofile authors"
version = release = hjprofile.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["_build", "gallery", "auto_gallery/index.rst"]  # pages of scripts are in auto_gallery
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "auto_gallery",
    "filename_pattern": r"\.py$",  # every script is run
    "run_stale_examples": True,  # a script that has not changed may print other numbers
    "abort_on_example_error": True,
    "capture_repr": (),
    "backreferences_dir": "auto_gallery/uses",  # the directive minigallery needs one
    "doc_module": "hjprofile",
    "download_all_examples": False,
    "write_computation_times": False,
    "show_signature": False,
    "copyfile_regex": r"index\.rst",  # without a file of ours it writes a list of scripts; docs/gallery.md is that list
}
smartquotes_action = "D"  # dashes only: f' is a derivative, no quotation

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 4  # headings have the anchors that a code host gives them

html_theme = "furo"
html_title = f"hjprofile {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
highlight_language = "text"

default_role = "code"  # docstrings put names in single backticks
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 140
toc_object_entries_show_parents = "hide"


_SECTIONS = {  # number -> page and anchor; sections are numbered through these pages
    number: f"{page}.html#{number}-{re.sub(r'[^a-z0-9 -]', '', title.lower()).replace(' ', '-')}"
    for page in ("model", "theory", "methods")
    for number, title in re.findall(
        r"^## §(\d+) (.+)$", (Path(__file__).parent / f"{page}.md").read_text(encoding="utf-8"), re.M
    )
}


_LISTS = {"Attributes:": "", "Args:": "**Arguments**", "Returns:": "**Returns**", "Raises:": "**Raises**"}


def _as_written(app, what, name, obj, options, lines):
    """Docstrings are plain text: |u| is a modulus and * a product, no markup. Code in backticks is left alone.

    Attributes, arguments and exceptions become lists, and sections links.
    """
    listing, written = False, []
    for line in lines:
        parts = re.split(r"(`[^`]*`)", line)
        parts[::2] = [re.sub(r"([*|])", r"\\\1", part) for part in parts[::2]]
        text = re.sub(r"§(\d+)[a-h]?(-[a-h])?", _link, "".join(parts))
        if line in _LISTS:
            written += [_LISTS[line], ""]
            listing = True
            continue
        listing = listing and bool(line)
        if listing:
            text = re.sub(r"^    (\w[\w, ]*): ", r"- **\1**: ", text)
            text = re.sub(r"^ {8}", "  ", text) if text.startswith(" " * 8) else re.sub(r"^ {4}", "", text)
        written.append(text)
    lines[:] = written


def _link(section):
    return f"`{section[0]} <{_SECTIONS[section[1]]}>`__"


def _readable(app, what, name, obj, options, signature, returns):
    """Replace the text of a default factory, which Sphinx cannot parse."""
    return signature and signature.replace("<factory>", "..."), returns


def setup(app):
    """What is done to docstrings and signatures."""
    app.connect("autodoc-process-docstring", _as_written)
    app.connect("autodoc-process-signature", _readable)
