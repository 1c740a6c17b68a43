"""The folder of a site: what changes is written whole, what does not is left as it is.

Beside the pages lies a list of what was written there and of what it was made of. By it pages of
runs that are gone are removed, and never a file of somebody else.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path, PurePosixPath

import msgspec

from madrob_console.errors import MadrobError
from madrob_console.files.bounded import Stamp, read_all, stamp_of
from madrob_console.files.held import Hold
from madrob_console.files.plain import opened_folder
from madrob_console.files.whole import atomic_write, atomic_write_in

MANIFEST_FILE = ".madrob_site.json"
"""In the folder of a site: what was written there."""

LOCK_FILE = ".madrob_site.lock"
"""In the folder of a site while it is written."""

_LARGEST = 16_000_000  # bytes of the list: some 100,000 files
_NAME = re.compile(r"(?:[A-Za-z0-9_-][A-Za-z0-9._-]*/)*[A-Za-z0-9_-][A-Za-z0-9._-]*")


class SiteRefusedError(MadrobError):
    """The folder is not for a site: nothing was written, and trying again does not help."""


class SourceUnreadError(MadrobError):
    """What one file is made of cannot be read: the others are written all the same."""


class SiteNotWrittenError(MadrobError):
    """The site cannot be written now: trying again may help."""


@dataclass(frozen=True, slots=True)
class SiteFile:
    """A file of the site.

    Attributes:
        name: its path in the site's folder.
        key: what it is made of: the same key, the same content.
        make: makes its content; asked only where it changed. Raises `SourceUnreadError` where
            what it is made of cannot be read.
        whole: whether nothing was missing when it was made; else it is made again the next time.
    """

    name: str
    key: str
    make: Callable[[], bytes]
    whole: Callable[[], bool] = lambda: True

    @classmethod
    def of(cls, name: str, text: str, key: str | None = None) -> SiteFile:
        """A page that is made already.

        Args:
            name: its path in the site's folder.
            text: of it.
            key: the text less what alone is no reason to write it again; None = all of it.
        """
        digest = sha256((text if key is None else key).encode()).hexdigest()
        return cls(name, digest, text.encode)


class _Entry(msgspec.Struct, frozen=True):
    """The key of what a file is made of, and its stamp; none while it is written."""

    key: str = ""
    stamp: Stamp | None = None


class _Manifest(msgspec.Struct, frozen=True):
    files: dict[str, _Entry] = {}


@dataclass(frozen=True, slots=True)
class Written:
    """What became of a site.

    Attributes:
        files: how many it has.
        written: how many of them were written.
        removed: how many were, because their runs are gone.
        unread: why the others could not be made; they are tried again the next time.
    """

    files: int
    written: int
    removed: int
    unread: Sequence[str] = ()


@contextmanager
def site_held(folder: Path) -> Iterator[None]:
    """Nobody else writes the site meanwhile: its runs are read in here, and the newest come last.

    Args:
        folder: of the site: a new or empty one, or one that was written before.

    Raises:
        SiteRefusedError: the folder holds other things.
        SiteNotWrittenError: the disk refuses, or another writes there now.
    """
    _demand_site(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        hold = Hold(folder / LOCK_FILE)
    except BlockingIOError:
        raise SiteNotWrittenError(
            f"{folder}: another `madrob publish` writes there now; wait"
        ) from None
    except OSError as error:
        raise _refused(folder, error) from None
    with hold:
        yield


def write_site(
    folder: Path,
    files: Iterable[SiteFile],
    tell: Callable[[int, int], None] = lambda _done, _total: None,
) -> Written:
    """Write what has changed in the order given, and remove what is no more.

    Who looks at the site meanwhile sees each file as it was or as it will be.

    Args:
        folder: of the site, within `site_held`.
        files: all of it; those that others link to first.
        tell: is told how many files are done, and of how many.

    Raises:
        SiteRefusedError: the folder holds other things.
        SiteNotWrittenError: the disk refuses.
    """
    try:
        return _write(folder, {file.name: file for file in files}, tell)
    except OSError as error:
        raise _refused(folder, error) from None
    except SiteRefusedError:
        raise
    except MadrobError as error:
        raise SiteNotWrittenError(str(error)) from None


def _refused(folder: Path, error: OSError) -> SiteNotWrittenError:
    return SiteNotWrittenError(
        f"{folder}: not written ({error.strerror}); make room or name another folder"
    )


def _write(
    folder: Path, files: Mapping[str, SiteFile], tell: Callable[[int, int], None]
) -> Written:
    before = _known(folder)
    _refuse_links(folder, {*before, *files})
    for name in files:
        if name not in before and (folder / name).exists():
            raise SiteRefusedError(f"{folder / name}: is not of `madrob publish`; move it away")
    changed = [file for file in files.values() if not _is_there(folder, file, before)]
    written, unread = 0, []
    gone = [name for name in before if name not in files]
    if changed or gone:  # first whose the files are: one that is cut off leaves none to nobody
        known = before | {file.name: _Entry() for file in changed}
        _note(folder, known)
        for number, file in enumerate(changed):
            tell(number, len(changed))
            try:
                written += _put(folder, file.name, file.make())
            except SourceUnreadError as error:
                unread.append(str(error))
                _remove(folder, file.name)  # it is older than what it is made of
                continue
            stamp = stamp_of(f"{folder}/{file.name}")
            known[file.name] = _Entry(file.key if file.whole() else "", stamp)
        tell(len(changed), len(changed))
        for name in gone:
            _remove(folder, name)
            del known[name]
        _note(folder, known)
    return Written(len(files), written, len(gone), unread)


def _is_there(folder: Path, file: SiteFile, before: Mapping[str, _Entry]) -> bool:
    found = before.get(file.name, _Entry())
    there = found.stamp is not None and found.stamp == stamp_of(f"{folder}/{file.name}")
    return there and found.key == file.key


def _refuse_links(folder: Path, names: Iterable[str]) -> None:
    """Nobody leads a page, or its removal, out of the site."""
    within = {parent for name in names for parent in PurePosixPath(name).parents if parent.name}
    for link in sorted(folder / parent for parent in within):
        if link.is_symlink():
            raise SiteRefusedError(f"{link}: is a link, which leads out of the site; remove it")


def _put(folder: Path, name: str, content: bytes) -> bool:
    """Write a file, unless it is already as it shall be; whether it was written."""
    with suppress(OSError):
        if read_all(folder / name, len(content)) == content:
            return False
    *within, called = name.split("/")
    with opened_folder(folder, *within, make=True) as number:
        atomic_write_in(number, called, content)
    return True


def _demand_site(folder: Path) -> None:
    try:
        there = next(folder.iterdir(), None) is not None
    except FileNotFoundError:
        return
    except OSError as error:
        raise SiteRefusedError(
            f"{folder}: no folder for a site ({error.strerror}); name another one"
        ) from None
    if there and stamp_of(f"{folder}/{MANIFEST_FILE}") is None:
        left = [path.name for path in folder.iterdir() if path.name != LOCK_FILE]
        if left:
            raise SiteRefusedError(
                f"{folder}: holds other things; name an empty folder, or a new one, for the site"
            )


def _known(folder: Path) -> dict[str, _Entry]:
    """What was written before."""
    path = folder / MANIFEST_FILE
    try:
        found = msgspec.json.decode(read_all(path, _LARGEST), type=_Manifest)
    except FileNotFoundError:
        return {}
    except (OSError, msgspec.MsgspecError, ValueError):
        raise SiteRefusedError(
            f"{path}: cannot be read, so that nobody knows whose files lie beside it: remove the "
            "folder, all of it is made again"
        ) from None
    return {name: one for name, one in found.files.items() if _NAME.fullmatch(name)}


def _note(folder: Path, files: Mapping[str, _Entry]) -> None:
    atomic_write(folder / MANIFEST_FILE, msgspec.json.encode(_Manifest(dict(files))) + b"\n")


def _remove(folder: Path, name: str) -> None:
    """Remove a file, and the folders that it leaves empty."""
    *within, called = name.split("/")
    with suppress(FileNotFoundError), opened_folder(folder, *within) as number:
        os.unlink(called, dir_fd=number)
    while within:
        *within, called = within
        with suppress(OSError), opened_folder(folder, *within) as number:
            os.rmdir(called, dir_fd=number)  # unless something else is in it
