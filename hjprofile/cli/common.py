"""The application, the options and the functions that all commands share."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

import hjprofile
from hjprofile.errors import InputError
from hjprofile.interrupts import undone

if TYPE_CHECKING:
    from hjprofile.output.folder import ResultFolder
    from hjprofile.problem.case import Case

BAR_AFTER = 1.0  # seconds
LINE_EVERY = 60.0  # seconds between two lines of progress where no bar is possible
LONG_COMPILATION = 1.0  # seconds of compilation above which it is announced there
COMPILING = "compiling (once)"

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
Set = Annotated[
    Sequence[str],
    Parameter("--set", help="A value in place of the case's, as in domain.cells=400; TOML. May be repeated."),
]
NoVtk = Annotated[bool, Parameter(help="Write no VTK files.")]
NoPlots = Annotated[bool, Parameter(help="Draw no pictures.")]
Quiet = Annotated[bool, Parameter(("--quiet", "-q"), help="Print no account and show no progress.")]
Strict = Annotated[bool, Parameter(help="Stop with exit code 1 if a bound is violated.")]
Fitted = Annotated[list[str], Parameter(help="Key of a parameter to fit, as in time.end. May be repeated.")]
Sigma = Annotated[
    float | None, Parameter(help="Standard deviation of a measured height; estimated from the residuals by default.")
]
OUT = "--out", "-o"
Out = Annotated[
    Path | None, Parameter(OUT, converter=expanded, help="Folder for the results; results/<case name> by default.")
]
Into = Annotated[
    Path | None, Parameter(OUT, converter=expanded, help="Folder for the files; the folder of the result by default.")
]

Vary = Annotated[list[str], Parameter(help="A key of the case and its values: erosion.m=0.5,1,2. May be repeated.")]
Workers = Annotated[
    int | None, Parameter(converter=_whole, help="Number of processes; one for each processor by default.")
]
Kept = Annotated[bool, Parameter(help="Use the members that are stored in the folder for the results.")]
Json = Annotated[bool, Parameter(help="Print one JSON document, for scripts, instead of text.")]


def say(silent: bool, text: str) -> None:
    """Print text for a reader on stdout, unless the command is quiet or answers in JSON."""
    if not silent:
        print(text)


def answer(json: bool, document: Mapping[str, Any]) -> None:
    """Print the JSON document of a command on stdout, with all digits, if the command answers in JSON."""
    if json:
        from hjprofile.output.store import to_json

        print(to_json(document, ascii_only=True), end="")


def require_cases(command: str, names: Sequence[Path]) -> None:
    """Raise InputError if no case is given."""
    if not names:
        raise InputError(
            f"{command} needs at least one CASE: a TOML file or the name of a shipped case", "the-command-line"
        )


def load_cases(names: tuple[Path, ...], out: Path | None) -> tuple[ResultFolder, list[Case]]:
    """Return the folder for the results of these cases, and the cases."""
    from hjprofile.problem.case import load_case

    loaded = [load_case(name) for name in names]
    return folder_for(names, out), loaded


def folder_for(
    names: tuple[Path, ...], out: Path | None, keep: str = "", values: Mapping[str, Any] | None = None
) -> ResultFolder:
    """Return the folder for the results of these cases. A folder that the user names may have belonged to another case.

    `values` replace those of the cases, by dotted key. Raise InputError if a case cannot be read, or if its default
    folder belongs to another case.
    """
    from hjprofile.output.folder import ResultFolder, owner_of
    from hjprofile.problem.case_files import find_case

    paths = [find_case(name) for name in names]
    path = out or (Path("results") / paths[0].stem if len(paths) == 1 else Path("results"))
    return ResultFolder(path, owner_of(paths, values), out is not None or len(paths) > 1, keep)


def case_folders(names: Sequence[Path], out: Path | None) -> dict[Path, Path | None]:
    """Return case -> its folder in `out`, or None for its default folder.

    Raise InputError if two cases have the same name, and thus the same folder.
    """
    folders: dict[str, Path] = {}
    for name in names:
        if name.stem in folders:
            folder = (out or Path("results")) / name.stem
            raise InputError(
                f"{folders[name.stem]} and {name} would be written to the same folder {folder}; "
                "run them one at a time, each with --out",
                "a-folder-of-another-case",
            )
        folders[name.stem] = name
    return {name: out / stem if out else None for stem, name in folders.items()}


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
    """Progress of a command on stderr: a bar on a terminal and in a notebook, else a line each minute.

    The bar appears after a second, or as soon as a loop is compiled. Compilation is announced, because it takes some
    seconds, but only at the first use of a method: a cache on disk holds the loops.
    """

    def __init__(self, label: str, shown: bool = True, solves: bool = True):
        """Prepare the progress of work named by `label`. `solves` is False for work without compiled loops."""
        self.label, self.wanted, self.solves = label, shown, solves
        self.started = self.last_line = time.monotonic()
        self.compiling, self.compiled, self.announced = 0.0, 0.0, False  # start and total of compilation, seconds
        self.bar: Any = None
        self.shown = ExitStack()

    def __enter__(self) -> Progress:
        if self.wanted and self.solves:
            from hjprofile.solvers.compilation import noticed

            self.shown.enter_context(noticed(self._compile))
        return self

    def __call__(self, fraction: float) -> None:
        now = time.monotonic()
        if not self.wanted or now - self.started < BAR_AFTER:
            return
        if self._has_bar(self.label):
            self.bar.update(self.task, description=self.label, completed=fraction, total=1.0)
        elif now - self.last_line >= LINE_EVERY:
            self.last_line = now
            _note(f"{self.label}: {fraction:.0%} after {now - self.started:.0f} s")

    def _compile(self, begins: bool) -> None:
        """Announce a compilation that begins: in the bar, or by one line if it takes long."""
        now = time.monotonic()
        if begins:
            self.compiling = now
            if self._has_bar(COMPILING):
                self.bar.update(self.task, description=COMPILING, total=None)
        else:
            self.compiled += now - self.compiling
        if self.bar is None and not self.announced and self.compiled > LONG_COMPILATION:
            self.announced = True
            _note(COMPILING)

    def _has_bar(self, label: str) -> bool:
        """Return True if stderr is a terminal or the command runs in a notebook; a first bar there has this label."""
        if self.bar is None:
            console = _console()
            if console is None:
                return False
            from rich.progress import Progress as Bar

            self.bar = Bar(console=console, transient=True)
            self.task = self.bar.add_task(label, total=1.0)
            self.shown.enter_context(undone(self.bar.stop))
            self.bar.start()
        return True

    def __exit__(self, *_: Any) -> None:
        if self.bar is not None:
            self.bar.stop()
        self.shown.close()


def _console() -> Any:
    """Return a console for a bar: the terminal on stderr, or the output of a cell of a notebook; None if neither."""
    if not (sys.stderr.isatty() or "ipykernel" in sys.modules):
        return None
    from importlib.util import find_spec

    from rich.console import Console

    console = Console(stderr=True)
    widgets = console.is_jupyter and find_spec("ipywidgets") is not None  # without them rich shows no bar
    return console if sys.stderr.isatty() or widgets else None


def _note(text: str) -> None:
    print(f"hjprofile: {text}", file=sys.stderr, flush=True)
