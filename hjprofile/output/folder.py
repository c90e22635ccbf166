"""Result folders: the case to which a folder belongs, and its files, written atomically."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from fnmatch import fnmatchcase
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from hjprofile.errors import InputError
from hjprofile.files import write_whole
from hjprofile.problem.case_files import read_case
from hjprofile.problem.case_keys import with_values
from hjprofile.problem.paths import located

RECORD = ".hjprofile.json"  # a file in the folder with its owner and the names of the files that hjprofile wrote there
INSIDE = ("vtk", "members")  # subfolders
_FORMS = "nc|csv|json|toml|png|svg|gif|mp4|npz|pvd|vtp|vtr"
_HALF = re.compile(rf"\..+\.({_FORMS})\.\w{{8}}")  # partial files of `write_whole`
MEMBERS = "members/*.npz"  # each identifies its own run
# names that a record may list; no other file is ever removed
_NAME = re.compile(rf"{re.escape(MEMBERS)}|(vtk/)?\w[\w.+-]*\.({_FORMS})")
ABOUT = "a-folder-of-another-case"


class Owner(NamedTuple):
    """The case to which the files of a folder belong.

    Attributes:
        cases: the absolute paths of its case files; empty for a run that was made in Python.
        fingerprint: a hash of the content of the case and of the files that it names.
    """

    cases: tuple[str, ...]
    fingerprint: str

    def __str__(self) -> str:
        return " and ".join(self.cases) or "another result that was written from Python"


def owner_of(cases: Sequence[Path], values: Mapping[str, Any] | None = None) -> Owner:
    """Return the owner of results computed from these case files. Raise InputError if one cannot be read.

    `values` replace those of the files, by dotted key. The sections [output] and [expect] change no result and are not
    hashed.
    """
    digest = hashlib.sha256()
    for path in cases:
        _hash_tables(digest, with_values(read_case(path), values or {}), path.parent)
    return Owner(tuple(str(path.resolve()) for path in cases), digest.hexdigest())


def owner_of_tables(content: Mapping[str, Any], base: Path) -> Owner:
    """Return the owner of results computed from the tables of a case that is in no file; paths are relative to base."""
    digest = hashlib.sha256()
    _hash_tables(digest, content, base)
    return Owner((), digest.hexdigest())


def _hash_tables(digest: Any, content: Mapping[str, Any], base: Path) -> None:
    """Add the tables of a case, and the files that they name, to a digest."""
    used = {name: table for name, table in content.items() if name not in ("output", "expect")}
    digest.update(_stable(used))
    for table in used.values():
        named = table if isinstance(table, Mapping) else {}
        for file in (named.get("file"), named.get("result")):
            if isinstance(file, str):
                digest.update(_bytes_of(located(base, file)))


def owner_of_run(case: Mapping[str, Any]) -> Owner:
    """Return the owner of a run that was made in Python, by its resolved case."""
    return Owner((), hashlib.sha256(_stable(case)).hexdigest())


def _stable(content: Mapping[str, Any]) -> bytes:
    try:
        return json.dumps(content, sort_keys=True, default=str).encode()
    except (ValueError, RecursionError):  # a number of thousands of digits, deep nesting: the command rejects it
        return b""


def _bytes_of(path: Path) -> bytes:
    """Return the content of a file, or of the stored run in a result folder; empty if there is none."""
    with suppress(OSError, ValueError):  # the command that needs the file reports it
        return (path / "profile.nc" if path.is_dir() else path).read_bytes()
    return b""


class _Record(NamedTuple):
    owner: Owner
    files: frozenset[str]


def _recorded(folder: Path) -> _Record | None:
    """Return the record of a folder; None if there is no readable one."""
    try:
        content = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        owner = Owner(tuple(map(str, content["cases"])), str(content["fingerprint"]))
        return _Record(owner, frozenset(name for name in content["files"] if _NAME.fullmatch(name)))
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


class ResultFolder:
    """A folder that belongs to one case: files of another case are rejected, or removed before the first is written.

    Only files that the record of the folder lists are removed.
    """

    def __init__(self, path: str | Path, owner: Owner, replace: bool = True, keep: str = ""):
        """Prepare the folder. `keep` is a file, or a pattern of files, that identifies its run itself and always stays.

        Raise InputError, unless `replace`, if the folder belongs to another case file with another content.
        """
        self.path, self.owner = Path(path), owner
        self.files, self.stale = frozenset[str](), frozenset[str]()
        found = _recorded(self.path)
        if found is None:
            return
        if found.owner.fingerprint == owner.fingerprint:
            self.files = found.files
        elif replace or found.owner.cases == owner.cases:
            self.files = found.files & {keep}
            self.stale = found.files - {keep}
        else:
            raise InputError(
                f"{path} belongs to {found.owner}, not to {owner}; name another folder with --out, or delete this one",
                ABOUT,
            )

    def __str__(self) -> str:
        return str(self.path)

    def open(self) -> ResultFolder:
        """Create the folder, test that it is writable, and remove the partial files of a killed run.

        Raise OSError if it is not writable.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        for path in (p for folder in ("", *INSIDE) for p in (self.path / folder).glob(".*")):
            if _HALF.fullmatch(path.name):
                path.unlink(missing_ok=True)
        with tempfile.TemporaryFile(dir=self.path):
            return self

    def claim(self, *names: str) -> None:
        """Remove the files of another case, and record that these names, or patterns, belong to this one."""
        for name in self.stale:
            self._delete(name)
        if self.stale or not self.files.issuperset(names) or not (self.path / RECORD).exists():
            now = _recorded(self.path)  # another command on the same case may have written in the meantime
            theirs = now.files if now and now.owner.fingerprint == self.owner.fingerprint else frozenset[str]()
            self.stale, self.files = frozenset(), self.files | theirs | set(names)
            self._write_record()

    def write(self, files: Mapping[str, bytes | str]) -> list[Path]:
        """Write files, name -> content, each atomically and in this order; those in `INSIDE` in parallel."""
        self.claim(*files)
        with ThreadPoolExecutor(8) as pool:
            for inside, group in groupby(files.items(), lambda file: "/" in file[0]):
                # these files are many, and each waits for the disk
                for _ in (pool.map if inside else map)(lambda file: write_whole(self.path / file[0], file[1]), group):
                    pass
        return [self.path / name for name in files]

    def remove(self, patterns: Iterable[str]) -> None:
        """Remove the recorded files whose names match."""
        gone = {name for name in self.files for pattern in patterns if fnmatchcase(name, pattern)}
        for name in gone:
            self._delete(name)
        if gone:
            self.files -= gone
            self._write_record()

    def _delete(self, name: str) -> None:
        for path in self.path.glob(name):
            path.unlink(missing_ok=True)
        with suppress(OSError):  # the subfolder holds other files
            if "/" in name:
                (self.path / name).parent.rmdir()

    def _write_record(self) -> None:
        content = {"cases": self.owner.cases, "fingerprint": self.owner.fingerprint, "files": sorted(self.files)}
        write_whole(self.path / RECORD, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def folder_of(path: Path, owner: Owner) -> ResultFolder:
    """Return an open folder for files made in Python. Raise InputError if it belongs to another owner."""
    there = _recorded(path)
    if there is not None and there.owner.fingerprint != owner.fingerprint:
        raise InputError(f"{path} belongs to {there.owner}; name another folder, or delete this one", ABOUT)
    return ResultFolder(path, owner).open()


def add_files(result: Path, folder: Path, files: Mapping[str, bytes | str], mixed: bool = False) -> list[Path]:
    """Write files made from a stored run into its own folder `result`, or into one that belongs to no other case.

    The folder then belongs to the case of the run, and files that were made there from an older run are removed. It
    belongs to nobody if it is `mixed`: the user names each file. Raise InputError if it belongs to another case.
    """
    mine, there = _recorded(result), _recorded(folder)
    unknown = mine is None and folder.resolve() == result.resolve()
    if there is None and (mixed or unknown):
        for name, data in files.items():
            write_whole(folder / name, data)
        return [folder / name for name in files]
    owner = mine.owner if mine else Owner((str(result.resolve()),), hashlib.sha256(_bytes_of(result)).hexdigest())
    return ResultFolder(folder, owner, replace=False).open().write(files)
