"""The text of a new case file: a case that runs, with the alternatives of each section as comments."""

from __future__ import annotations

import json
from pathlib import Path

from hjprofile.errors import InputError
from hjprofile.files import write_whole
from hjprofile.problem import LONGEST_TITLE
from hjprofile.problem.ranges import as_path

ABOUT = "the-command-line"

# Lines that begin with "# " and hold a key are alternatives: without the mark they are valid TOML
TEMPLATE = """# A case file of hjprofile. It runs as it is: change it step by step.
# `hjprofile validate FILE` checks it, `hjprofile run FILE` solves it. docs/cases.md lists every key.
title = {title}

# The erosion law f(q): the erosion rate per unit grain flux at the excess slope q = u_x - 1
[erosion]
law = "rational"                # f = q/(1 + q)

# law = "log"                   # f = ln(1 + q)

# law = "power"                 # f = (1 - (1 + q)^-m)/m
# m = 2.0

# law = "expression"
# expression = "log1p(q) + q/(1+q)"

# The profile at the start. The crest is at x = 0, and lengths are in exchange lengths
[profile]
kind = "kinks"                  # q jumps up to each amplitude, and decays to the next position
positions = [-7.0, -5.0]
amplitudes = [0.4, 1.2]

# kind = "bumps"                # q is the sum of a exp(-((x - c)/w)^2)
# amplitudes = [0.8, -0.3]
# centres = [-5.0, -3.0]
# widths = [1.0, 0.5]

# kind = "steps"                # q is constant between two edges
# edges = [-6.0, -4.0]
# values = [-0.4]

# kind = "points"               # q is linear between points; a repeated x is a jump
# x = [-6.0, -5.0, -5.0, -3.0]
# q = [0.0, 0.5, 1.0, 0.0]

# For a survey, a table of x and height, `hjprofile import FILE` writes the case.

[domain]
left = -10.0                    # left end of the grid; the slope must be neutral there
cells = 1000

[time]
end = 3.0                       # supplied mass at the end
snapshots = 31                  # number of saved times, or a list of them

[solver]
method = "local-lax-friedrichs" # `hjprofile methods` lists the methods
cfl = 0.9                       # time step, relative to the largest one that the method admits

# method = "auto"               # the method with the least work for a tolerance
# tolerance = 1e-4              # largest error of the height u

[output]
vtk = true                      # files for ParaView
plots = true                    # pictures
"""


def new_case(path: str | Path) -> Path:
    """Write a case file with comments, which runs and is a start for a case of your own.

    Args:
        path: the path of the new file; `.toml` is added if it is missing.

    Returns:
        The path of the file.

    Raises:
        InputError: if the file exists, or if the path has no name.
        OSError: if it cannot be written.

    >>> import tempfile
    >>> import hjprofile as hj
    >>> file = hj.new_case(f"{tempfile.mkdtemp()}/my_slope")
    >>> file.name, hj.load_case(file).method
    ('my_slope.toml', 'local-lax-friedrichs')
    """
    path = as_path("path", path)
    if not path.name:
        raise InputError(f"{path} is not a name of a case; write for example my_slope", ABOUT)
    path = path if path.suffix == ".toml" else path.with_name(f"{path.name}.toml")
    if path.exists():
        raise InputError(f"{path} exists, and a new case replaces no file; choose another name", ABOUT)
    write_whole(path, TEMPLATE.format(title=json.dumps(path.stem[:LONGEST_TITLE])))
    return path
