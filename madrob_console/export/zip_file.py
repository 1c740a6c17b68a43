"""Zips with checksums that lead nobody out of their folder."""

from __future__ import annotations

import hashlib
import os
import re
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, BinaryIO, NamedTuple

from madrob_console.common.names import terminal_safe
from madrob_console.common.plain_files import open_plain, refusal
from recorder.bag import EVIDENCE

LONGEST_PATH = 400
"""Longest path in an archive, characters: folders in folders have no end."""

_UNSAFE = re.compile("[/\\\\:\ud800-\udfff]")
"""Leads out of the folder on some systems (`C:`, `..\\`), or is no UTF-8."""


def is_safe_name(name: str) -> bool:
    """Whether a file of this name can be unpacked everywhere and steers no terminal."""
    return not _UNSAFE.search(name) and name == terminal_safe(name).strip(" .")


SUMS_FILE = "SHA256SUMS"
"""In the archive: input of `sha256sum -c`."""

_BLOCK = 1 << 20
_FIRST, _LATEST = (1980, 1, 1, 0, 0, 0), 4.3e9  # what a zip can say, until the year 2106
_MODE = 0o100644 << 16


class Archive:
    """A zip that takes files as they come; memory does not grow with them.

    `problems` say what is left out and why. `sums` has the SHA-256 of each whole file by its name.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.problems: list[str] = []
        self.sums: dict[str, str] = {}
        self._zip = zipfile.ZipFile(file, "w")

    def add_folder(
        self,
        folder: Path,
        called: str,
        without: Callable[[str], bool] = lambda _path: False,
    ) -> None:
        """Adds the files of a folder, which is `called` so in the archive.

        What cannot be read, or unpacked everywhere, is a problem. Links are not followed; hidden
        files are temporary. `without` says of a path within the folder whether it is left out.

        Raises:
            OSError: the archive cannot be written.
        """
        for entry in self._files_in(folder, called):
            path = entry.name.removeprefix(f"{called}/")
            if not without(path):
                self._add(entry)

    @contextmanager
    def new_file(self, name: str, modified: float, size: int = 0) -> Iterator[ZippedFile]:
        """Takes the content of a file while inside; `size` is about that of a large one."""
        stamp = time.localtime(min(max(modified, 0.0), _LATEST))[:6]
        info = zipfile.ZipInfo(name, max(stamp, _FIRST))
        info.external_attr = _MODE
        stored = EVIDENCE in name  # pictures are compressed already, and many
        info.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
        info.file_size = size  # a large one gets the fields of zip64
        with self._zip.open(info, "w") as member:
            file = ZippedFile(member)
            yield file
        self.sums[name] = file.sha256.hexdigest()

    def add_file(self, name: str, data: bytes, modified: float) -> None:
        with self.new_file(name, modified) as file:
            file.write(data)

    def finish(self, modified: float) -> None:
        """Adds the checksums; nothing can be added afterwards."""
        lines = "".join(f"{digest}  {name}\n" for name, digest in self.sums.items())
        self.add_file(SUMS_FILE, lines.encode(), modified)
        self._zip.close()

    def close(self) -> None:
        with suppress(OSError):  # whoever was cut short throws the file away
            self._zip.close()

    def _add(self, entry: _Entry) -> None:
        """Copies what the file holds now; what it grows by meanwhile is left out."""
        try:
            number = open_plain(entry.path, folder=entry.folder)
        except OSError as error:
            self.problems.append(f"{entry.name}: cannot be read ({refusal(error)})")
            return
        with os.fdopen(number, "rb") as file:
            state = os.fstat(number)
            try:
                with self.new_file(entry.name, state.st_mtime, state.st_size) as member:
                    _copy(file, member, state.st_size)
            except _TornError as torn:
                self.problems.append(f"{entry.name}: {torn}")

    def _files_in(self, folder: Path, called: str) -> Iterator[_Entry]:
        """The files below a folder, by name; folders that are links are problems."""

        def tell(error: OSError) -> None:
            self.problems.append(f"{called}: cannot be read ({error.strerror})")

        for path, folders, files, number in _walk(folder, tell):
            under = f"{called}{path.removeprefix(str(folder))}"
            packed = {name for name in (*folders, *files) if self._is_packed(under, name)}
            folders[:] = sorted(packed.intersection(folders))
            links = (name for name in folders if Path(path, name).is_symlink())
            self.problems.extend(f"{under}/{name}: is a link" for name in links)
            for name in sorted(packed.intersection(files)):
                yield _Entry(f"{under}/{name}", name, number)

    def _is_packed(self, under: str, name: str) -> bool:
        if name.startswith("."):
            return False
        path, why = f"{under}/{name}", ""
        if not is_safe_name(name):
            why = "its name cannot be unpacked everywhere: rename it"
        elif len(path) > LONGEST_PATH:
            why = "too many folders, one in another"
        self.problems += [f"{path}: {why}"] * bool(why)
        return not why


class ZippedFile:
    """A file in an archive that is being written."""

    def __init__(self, member: IO[bytes]) -> None:
        self.sha256 = hashlib.sha256()
        self._member = member

    def write(self, data: bytes) -> int:
        self.sha256.update(data)
        return self._member.write(data)


class _Entry(NamedTuple):
    """A file: its name in the archive, and its name in an open folder."""

    name: str
    path: str
    folder: int


class _TornError(Exception):
    """The end of a file cannot be read."""


def _copy(file: BinaryIO, member: ZippedFile, left: int) -> None:
    while left:
        why = "it became shorter"
        try:
            block = file.read(min(_BLOCK, left))
        except OSError as error:
            why, block = refusal(error), b""
        if not block:
            raise _TornError(f"its last {left} bytes cannot be read ({why})")
        member.write(block)
        left -= len(block)


def _walk(
    folder: Path, tell: Callable[[OSError], None]
) -> Iterator[tuple[str, list[str], list[str], int]]:
    try:
        yield from os.fwalk(folder, onerror=tell)
    except OSError as error:  # of the folder itself
        tell(error)
