"""The functions of a user: loaded from a Python file, tried with arrays, evaluated and hashed."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import update_wrapper
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hjprofile.errors import InputError, RunError
from hjprofile.problem.paths import require_file
from hjprofile.problem.ranges import Array

Function = Callable[..., Any]

ABOUT = "a-python-file"  # heading of the page on errors
_imported: dict[Path, bytes] = {}  # module next to a file that was run -> its bytes when it was imported


class Sendable:
    """A function of one or more arrays that can be sent to another process if the function `f` in it can."""

    def __init__(self, f: Function):
        self.f = f

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (sendable(self.f),)


class OnCopies(Sendable):
    """A function applied to copies of its arguments, so that it may write into them."""

    def __call__(self, *arrays: Any) -> Any:
        return self.f(*(np.array(array, dtype=float) for array in arrays))


class Looped(Sendable):
    """A function of single numbers, applied to arrays in a loop."""

    def __call__(self, *arrays: Any) -> Any:
        return np.vectorize(self.f, otypes=[float])(*arrays)


class FromFile(Sendable):
    """A function from a Python file, which another process loads again."""

    def __init__(self, f: Function, path: Path, name: str, content: str):
        update_wrapper(self, f)  # first, because it copies attributes of f
        super().__init__(f)
        self._origin = str(path.resolve()), name, content

    def __call__(self, *arguments: Any) -> Any:
        return self.f(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return _loaded_again, self._origin


def _loaded_again(path: str, name: str, content: str) -> Function:
    """Return the function of that name in a file. Raise InputError if the file has changed."""
    loaded = load_function(Path(path), name)
    if loaded.content != content:
        raise InputError(f"file = {path!r} has changed since {name!r} was loaded; load the case again", ABOUT)
    return loaded.function


def sendable(f: Function) -> Function:
    """Return a function that can be sent to another process. Raise PicklingError for a lambda or a local function."""
    if not isinstance(f, Sendable):
        try:
            pickle.dumps(f)
        except Exception as error:  # a callable object of a user may raise any exception
            name = getattr(f, "__qualname__", type(f).__name__)
            raise pickle.PicklingError(
                f"the function {name!r} cannot be pickled, because it has no name in a module; define it with def "
                "outside of other functions, or give an expression as text"
            ) from error
    return f


class Loaded(NamedTuple):
    """A function from a file, and the hash of the file."""

    function: Function
    content: str


def load_function(path: Path, function: str) -> Loaded:
    """Return the function of that name in a Python file. Running the file runs its author's code.

    The hashed bytes are the bytes that are run, because Python's cache of compiled files misses an edit within a
    second.
    """
    require_file(path)
    spec = importlib.util.spec_from_file_location(f"hjprofile_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"file = {str(path)!r} is not a Python file (.py)", ABOUT)
    module = importlib.util.module_from_spec(spec)
    try:
        source = path.read_bytes()
        content = content_of(path, source)
        exec(compile(source, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:
        raise InputError(f"file = {str(path)!r} could not be run: {type(error).__name__}: {error}", ABOUT) from error
    f = getattr(module, function, None)
    if not callable(f):
        raise InputError(f"function = {function!r} is not defined in {path.name}", ABOUT)
    return Loaded(FromFile(f, path, function, content), content)


@contextmanager
def evaluating(what: str, error: type[InputError | RunError] = InputError) -> Iterator[None]:
    """Raise that error, without earlier warnings of numpy, if a function of a user fails inside."""
    try:
        with np.errstate(all="ignore"):
            yield
    except Exception as cause:  # a user's function may raise any exception
        raise error(f"{what} cannot be evaluated: {type(cause).__name__}: {cause}") from cause


def maps_arrays(f: Function, *probe: Array) -> bool:
    """Return True if f maps these arrays, which broadcast, to the values that it gives for single numbers."""
    try:
        values = np.asarray(f(*(array.copy() for array in probe)), dtype=float)
        shape = np.broadcast_shapes(*(array.shape for array in probe))
        if len(probe) == 1 and values.shape != shape:  # a function of several variables need not depend on each
            return False
        alone = [float(f(*map(float, numbers))) for numbers in np.broadcast(*probe)]
        values = np.broadcast_to(values, shape).ravel()
        return np.allclose(values, alone, rtol=1e-12, atol=0.0, equal_nan=True)
    except Exception:  # a function of single numbers may raise any exception if it is called with an array
        return False


def over_arrays(f: Function, *probe: Array) -> Function:
    """Return a function of arrays: f itself, on copies, if it maps the probe, else a loop over it."""
    if maps_arrays(f, *probe):
        return OnCopies(f)
    return Looped(f)


def values_at(f: Function, x: Array) -> Array:
    """Return f at x, in one call if f takes arrays, else in one call per number."""
    try:
        values = np.asarray(f(x.copy()), dtype=float)  # a function may write into its argument
    except Exception:  # a function of single numbers may raise any exception if it is called with an array
        values = None
    if values is None or values.shape != x.shape:
        values = np.vectorize(f, otypes=[float])(x)
    return values


def content_of(path: Path, source: bytes) -> str:
    """Return a hash of a file and of the modules in its folder that it imports, directly or indirectly.

    Remove a module among them that has changed since its import from `sys.modules`, so that it is imported again.
    """
    held = {path: source}
    todo = [source]
    while todo:
        for module_file in _modules_in(path.parent, todo.pop()):
            if module_file not in held:
                held[module_file] = module_file.read_bytes()
                todo.append(held[module_file])
    for module_file in held.keys() - {path}:
        if _imported.setdefault(module_file, held[module_file]) != held[module_file]:
            _imported[module_file] = held[module_file]
            for name, module in list(sys.modules.items()):
                if getattr(module, "__file__", None) and Path(str(module.__file__)).resolve() == module_file.resolve():
                    del sys.modules[name]
    ordered = sorted((file.relative_to(path.parent).as_posix(), data) for file, data in held.items())
    parts = [name.encode() + hashlib.sha256(data).digest() for name, data in ordered if name != path.name]
    return hashlib.sha256(b"".join([hashlib.sha256(source).digest(), *parts])).hexdigest()


def _modules_in(folder: Path, source: bytes) -> Iterator[Path]:
    """Return the files in a folder that a source imports; for a package, all its modules."""
    names: set[str] = set()
    with suppress(SyntaxError, ValueError):  # such a file cannot be imported
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
