"""Functions in Python files that a case names, and a hash of those files."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from hjprofile.errors import InputError, did_you_mean

Function = Callable[[Any], Any]
UNREADABLE, PYTHON = "a-file-that-cannot-be-read", "a-python-file"  # headings of the page on errors

_imported: dict[Path, bytes] = {}  # module beside a file that was run -> its bytes when it was imported


class Loaded(NamedTuple):
    """A function from a file, and a hash of the file and of the modules in its folder that it imports."""

    function: Function
    content: str


def require_file(path: Path) -> None:
    """Raises InputError unless `path` is a file; a folder has nothing to read, a pipe or a device may have no end."""
    try:
        there = path.is_file()
    except OSError as error:  # a name too long, a folder that may not be entered
        raise InputError(f"file = {str(path)!r} cannot be read: {error.strerror}", UNREADABLE) from None
    if not there:
        beside: list[str] = []
        with suppress(OSError, ValueError, NotImplementedError):  # no such folder, one that may not be entered, a NUL
            beside = [other.name for other in path.parent.glob(f"*{path.suffix}") if other.is_file()]
        hint = did_you_mean(path.name, beside)
        raise InputError(f"file = {str(path)!r} does not exist, or is not a file{hint}", UNREADABLE)


def load_function(path: Path, function: str) -> Loaded:
    """The function of that name in a Python file. Running the file runs its author's code.

    The bytes that are hashed are those that are run: Python's own cache of compiled files takes a file for unchanged
    that was edited within a second.
    """
    require_file(path)
    spec = importlib.util.spec_from_file_location(f"hjprofile_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"file = {str(path)!r} is not a Python file (.py)", PYTHON)
    module = importlib.util.module_from_spec(spec)
    try:
        source = path.read_bytes()
        content = _content(path, source)
        exec(compile(source, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:
        raise InputError(f"file = {str(path)!r} could not be run: {type(error).__name__}: {error}", PYTHON) from error
    f = getattr(module, function, None)
    if not callable(f):
        raise InputError(f"function = {function!r} is not defined in {path.name}", PYTHON)
    return Loaded(f, content)


def _content(path: Path, source: bytes) -> str:
    """A hash of a file and of the modules in its folder that it imports, directly or by way of one another.

    A module among them that has changed since it was imported is forgotten, so that it is imported again.
    """
    held = {path: source}
    todo = [source]
    while todo:
        for beside in _modules_beside(path.parent, todo.pop()):
            if beside not in held:
                held[beside] = beside.read_bytes()
                todo.append(held[beside])
    for beside in held.keys() - {path}:
        if _imported.setdefault(beside, held[beside]) != held[beside]:
            _imported[beside] = held[beside]
            for name, module in list(sys.modules.items()):
                if getattr(module, "__file__", None) and Path(str(module.__file__)).resolve() == beside.resolve():
                    del sys.modules[name]
    ordered = sorted((file.relative_to(path.parent).as_posix(), data) for file, data in held.items())
    parts = [name.encode() + hashlib.sha256(data).digest() for name, data in ordered if name != path.name]
    return hashlib.sha256(b"".join([hashlib.sha256(source).digest(), *parts])).hexdigest()


def _modules_beside(folder: Path, source: bytes) -> Iterator[Path]:
    """The files in a folder that are modules which a source imports; of a package there, all its modules."""
    names: set[str] = set()
    with suppress(SyntaxError, ValueError):  # of a file that is not imported after all
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module)
    for name in sorted({name.partition(".")[0] for name in names}):
        if (folder / f"{name}.py").is_file():
            yield folder / f"{name}.py"
        elif (folder / name).is_dir():
            yield from sorted((folder / name).rglob("*.py"))
