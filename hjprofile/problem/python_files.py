"""A hash of a Python file that a case names, and of the modules in its folder that it imports."""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_imported: dict[Path, bytes] = {}  # module next to a file that was run -> its bytes when it was imported


def content_of(path: Path, source: bytes) -> str:
    """Return a hash of a file and of the modules in its folder that it imports, directly or indirectly.

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
    """Return the files in a folder that a source imports; for a package, all its modules."""
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
