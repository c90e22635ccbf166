"""The paths of the files that a case names."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from hjprofile.errors import InputError, did_you_mean

UNREADABLE = "a-file-that-cannot-be-read"  # heading of the page on errors


class InCase(str):
    """A path that a case file in `folder` names."""

    folder: Path

    @classmethod
    def of(cls, file: str, folder: Path) -> InCase:
        """Return the path `file` in a case file in `folder`."""
        path = cls(file)
        path.folder = folder
        return path


def folder_of(file: object) -> Path:
    """Return the folder to which a path is relative: that of its case file, or the current one."""
    return file.folder if isinstance(file, InCase) else Path()


def located(base: Path, file: str | Path) -> Path:
    """Return the path of a file that a case names, relative to the folder `base`; ~ is the home folder."""
    path = Path(file)
    with suppress(RuntimeError):  # this user has no home folder
        path = path.expanduser()
    return base / path


def require_file(path: Path) -> None:
    """Raise InputError unless `path` is a file. A folder has no content, and a pipe or a device may have no end."""
    try:
        there = path.is_file()
    except OSError as error:  # a name too long, a folder that may not be entered
        raise InputError(f"file = {str(path)!r} cannot be read: {error.strerror}", UNREADABLE) from None
    if not there:
        siblings: list[str] = []
        with suppress(OSError, ValueError, NotImplementedError):  # no such folder, one that may not be entered, a NUL
            siblings = [other.name for other in path.parent.glob(f"*{path.suffix}") if other.is_file()]
        hint = did_you_mean(path.name, siblings)
        raise InputError(f"file = {str(path)!r} does not exist, or is not a file{hint}", UNREADABLE)
