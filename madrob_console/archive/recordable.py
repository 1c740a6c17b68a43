"""Whether a run could be recorded in a results folder."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from madrob_console.archive.folders import NUMBERS_FILE, link_problem, series_folder
from madrob_console.files.plain import open_plain, refusal

_REMEDY = "choose another results folder"
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NONBLOCK | os.O_CLOEXEC
_NAMELESS_FILE = os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC
_UNSUPPORTED = (errno.EOPNOTSUPP, errno.EISDIR, errno.ENOENT)
"""Of file systems that know no file without a name: FAT, NFS."""


def recording_problem(root: Path, *, attempt: bool, practice: bool = False) -> str | None:
    """Why no run could be recorded in a results folder, in words; None when one could.

    Args:
        root: the results folder; one that is not there yet will be made.
        attempt: make a file without a name there, too: a disk that turned read-only shows itself
            only then, and one that hangs lets this wait. It leaves nothing.
        practice: a practice run.
    """
    if practice and (problem := link_problem(root)) is not None:
        return problem
    root = series_folder(root, practice=practice)
    place = next((p for p in (root, *root.absolute().parents) if os.path.lexists(p)), root)
    try:
        os.close(os.open(place, _FOLDER))
        if not os.access(place, os.W_OK | os.X_OK):
            return f"{place}: nothing can be written there; make it yours, or {_REMEDY}"
        if attempt:
            _make_nameless_file(place)
    except OSError as error:
        return f"{place}: {error.strerror}; {_REMEDY}"
    return None if place != root else _numbers_problem(root / NUMBERS_FILE)


def _make_nameless_file(folder: Path) -> None:
    try:
        os.close(os.open(folder, _NAMELESS_FILE, 0o600))
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise


def _numbers_problem(path: Path) -> str | None:
    """Why no run number can be given out, in words."""
    try:
        os.close(open_plain(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"{path}: cannot be used ({refusal(error)}); put a plain file in its place"
    if os.access(path, os.W_OK):
        return None
    return f"{path}: cannot be written; make it yours"
