"""The application, the options and the functions that all commands share."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

import hjprofile
from hjprofile.interrupts import undone

if TYPE_CHECKING:
    from hjprofile.output.folder import ResultFolder
    from hjprofile.problem.case import Case

app = App(
    name="hjprofile",
    version=hjprofile.__version__,
    help_format="plaintext",
    default_parameter=Parameter(negative="", show_default=False),
    suppress_keyboard_interrupt=False,  # `main` prints a message instead
    help="Slow erosion of granular slopes: a nonlocal Hamilton-Jacobi equation and its cross-checks.",
)
app.register_install_completion_command(help="Complete commands and options in this shell (bash, zsh, fish).")


def _whole(_: Any, tokens: Any) -> int:
    """Return a whole number; cyclopts would round 60.7 cells to 61."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value[:40]!r} is not a whole number") from None


def expanded(_: Any, tokens: Any) -> Path:
    """Return a path in which ~ is the home folder, also if no shell has expanded it, as in --out=~/results."""
    from contextlib import suppress

    path = Path(tokens[0].value)
    with suppress(RuntimeError):  # this user has no home folder
        path = path.expanduser()
    return path


Somewhere = Annotated[Path, Parameter(converter=expanded)]
CasePath = Annotated[Somewhere, Parameter(help="A TOML file, or the name of a case that `hjprofile cases` lists.")]
After = Annotated[Somewhere, Parameter(help="The survey afterwards: a CSV file with the header x,height.")]
Cells = Annotated[int | None, Parameter(converter=_whole, help="Number of grid cells, instead of the case's.")]
Method = Annotated[str | None, Parameter(help="Method, instead of the case's; an unknown name lists all methods.")]
Cfl = Annotated[
    float | None, Parameter(help="CFL number, instead of the case's: time step relative to the largest monotone one.")
]
Tolerance = Annotated[
    float | None, Parameter(help="Largest allowed error of u; selects the method auto unless a method is named.")
]
End = Annotated[float | None, Parameter(help="Supplied mass at which the run ends, instead of the case's.")]
Resume = Annotated[bool, Parameter(help="Continue from the checkpoint in the folder for the results.")]
Strict = Annotated[bool, Parameter(help="Stop with exit code 1 if a bound is violated.")]
Fitted = Annotated[list[str], Parameter(help="Key of a parameter to fit, as in time.end. May be repeated.")]
Sigma = Annotated[
    float | None, Parameter(help="Standard deviation of a measured height; estimated from the residuals by default.")
]
Out = Annotated[
    Path | None, Parameter(converter=expanded, help="Folder for the results; results/<case name> by default.")
]
Into = Annotated[
    Path | None, Parameter(converter=expanded, help="Folder for the files; the folder of the result by default.")
]

Vary = Annotated[list[str], Parameter(help="A key of the case and its values: erosion.m=0.5,1,2. May be repeated.")]
Workers = Annotated[
    int | None, Parameter(converter=_whole, help="Number of processes; one for each processor by default.")
]
Kept = Annotated[bool, Parameter(help="Use the members that are stored in the folder for the results.")]
Json = Annotated[bool, Parameter(help="Print one JSON document, for scripts, instead of text.")]


def say(json: bool, text: str) -> None:
    """Print text for a reader on stdout, unless the command answers in JSON."""
    if not json:
        print(text)


def answer(json: bool, document: Mapping[str, Any]) -> None:
    """Print the JSON document of a command on stdout, with all digits, if the command answers in JSON."""
    if json:
        from hjprofile.output.store import to_json

        print(to_json(document, ascii_only=True), end="")


def load_cases(names: tuple[Path, ...], out: Path | None) -> tuple[ResultFolder, list[Case]]:
    """Return the folder for the results of these cases, and the cases."""
    from hjprofile.problem.case import load_case

    loaded = [load_case(name) for name in names]
    return folder_for(names, out), loaded


def folder_for(names: tuple[Path, ...], out: Path | None, keep: str = "") -> ResultFolder:
    """Return the folder for the results of these cases. A folder that the user names may have belonged to another case.

    Raise InputError if a case cannot be read, or if its default folder belongs to another case.
    """
    from hjprofile.output.folder import ResultFolder, owner_of
    from hjprofile.problem.case_files import find_case

    paths = [find_case(name) for name in names]
    path = out or (Path("results") / paths[0].stem if len(paths) == 1 else Path("results"))
    return ResultFolder(path, owner_of(paths), out is not None or len(paths) > 1, keep)


def listing(folder: Path, files: list[Path]) -> str:
    """Return the names of files as text, with the number of files for each folder."""
    names = [f.relative_to(folder).as_posix() for f in files]
    flat = [n for n in names if "/" not in n]
    if len(flat) > 12:
        flat = [f"{len(flat)} files"]
    inside: dict[str, int] = {}
    for n in names:
        if "/" in n:
            inside[n.split("/")[0]] = inside.get(n.split("/")[0], 0) + 1
    return ", ".join(flat + [f"{name}/ ({count} files)" for name, count in inside.items()])


class Progress:
    """A progress bar with the remaining time, on stderr, for work that takes longer than a second on a terminal."""

    def __init__(self, label: str):
        self.label, self.started = label, time.monotonic()
        self.bar: Any = None
        self.shown = ExitStack()

    def __enter__(self) -> Progress:
        return self

    def __call__(self, fraction: float) -> None:
        if self.bar is None:
            if not sys.stderr.isatty() or time.monotonic() - self.started < 1.0:
                return
            from rich.console import Console
            from rich.progress import Progress as Bar

            self.bar = Bar(console=Console(stderr=True), transient=True)
            self.task = self.bar.add_task(self.label, total=1.0)
            self.shown.enter_context(undone(self.bar.stop))
            self.bar.start()
        self.bar.update(self.task, completed=fraction)

    def __exit__(self, *_: Any) -> None:
        if self.bar is not None:
            self.bar.stop()
        self.shown.close()
