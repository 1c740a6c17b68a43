"""A zip that is written file by file, whatever their size, with a sum for each."""

from __future__ import annotations

import hashlib
import os
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, NamedTuple, Self

from madrob_console.export.portable_names import LONGEST_PATH, portable_names
from madrob_console.files.plain import open_plain, refusal
from recorder.bag import is_evidence

SUMS_FILE = "SHA256SUMS"
"""In the archive: what `sha256sum -c` reads."""

_BLOCK = 1 << 20
_FIRST, _LATEST = (1980, 1, 1, 0, 0, 0), 4.3e9  # what a zip can say, until the year 2106
_MODE = 0o100644 << 16


class Archive:
    """Takes files in the order in which they come; memory does not grow with them.

    Args:
        file: where the zip goes.

    Attributes:
        count: files in it.
        problems: what could not be read and why, in words.
        renamed: what is called otherwise in the archive, in words.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.count = 0
        self.problems: list[str] = []
        self.renamed: list[str] = []
        self._zip = zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED)
        self._sums: list[str] = []

    @property
    def sums(self) -> tuple[tuple[str, str], ...]:
        """SHA-256 and name of each file so far, in their order."""
        return tuple((line[:64], line[66:].removesuffix("\n")) for line in self._sums)

    def add_folder(
        self,
        folder: Path,
        called: str = "",
        *,
        without: Callable[[str], bool] = lambda _name: False,
        instead: Mapping[str, bytes] = MappingProxyType({}),
    ) -> list[str]:
        """Add the files of a folder; what cannot be read is a problem.

        Links are not followed, hidden files are temporary ones. Names that not every system can
        unpack are replaced, see `portable_names`.

        Args:
            folder: the folder.
            called: its name in the archive, where that is another than its own.
            without: whether a file of this name is left out.
            instead: what is added in place of a file, by the file's name in the archive.

        Returns:
            The names of the files that are in the archive now.

        Raises:
            OSError: the archive cannot be written.
        """
        added = []
        for found in self._files_in(folder, called or folder.name):
            if not without(found.path):
                added += [found.name] if self._add(found, instead.get(found.name)) else []
        return added

    def add(self, name: str, data: bytes, modified: float) -> None:
        """Add a file that is not on disk.

        Raises:
            OSError: the archive cannot be written.
        """
        self._zip.writestr(_info(name, modified), data, zipfile.ZIP_DEFLATED)
        self._count(name, hashlib.sha256(data).hexdigest())

    def finish(self, modified: float) -> None:
        """Add the sums; nothing can be added any more.

        Raises:
            OSError: the archive cannot be written.
        """
        self.add(SUMS_FILE, "".join(self._sums).encode(), modified)
        self._zip.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with suppress(OSError):  # whoever was cut short throws the file away
            self._zip.close()

    def _add(self, found: _Found, instead: bytes | None) -> bool:
        try:
            number = open_plain(found.path, folder=found.folder)
        except OSError as error:
            self.problems.append(f"{found.name}: cannot be read ({refusal(error)})")
            return False
        with os.fdopen(number, "rb") as file:
            if instead is None:
                return self._copy(found.name, file)
            self.add(found.name, instead, os.fstat(number).st_mtime)
            return True

    def _copy(self, name: str, file: BinaryIO) -> bool:
        """Copy what the file holds now; of one that grows no more than that."""
        state = os.fstat(file.fileno())
        info = _info(name, state.st_mtime)
        stored = is_evidence(name)  # pictures are compressed already, and many
        info.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
        info.file_size = left = state.st_size  # a large one gets the fields of zip64
        digest = hashlib.sha256()
        why = "it became shorter"
        with self._zip.open(info, "w") as member:
            while left:
                try:
                    block = file.read(min(_BLOCK, left))
                except OSError as error:
                    why, block = refusal(error), b""
                if not block:
                    break
                digest.update(block)
                member.write(block)
                left -= len(block)
        if left:
            self.problems.append(f"{name}: its last {left} bytes cannot be read ({why})")
            return False
        self._count(name, digest.hexdigest())
        return True

    def _count(self, name: str, digest: str) -> None:
        self.count += 1
        self._sums.append(f"{digest}  {name}\n")

    def _files_in(self, folder: Path, named: str) -> Iterator[_Found]:
        """The files below a folder, by name; folders that are links are problems."""

        def tell(error: OSError) -> None:
            self.problems.append(f"{folder.name}: cannot be read ({error.strerror})")

        called = {str(folder): named}
        for path, folders, files, number in _walk(folder, tell):
            under = called[path]
            names = self._portable(under, (*folders, *files))
            folders[:] = sorted(name for name in folders if name in names)
            links = (name for name in folders if Path(path, name).is_symlink())
            self.problems.extend(f"{under}/{name}: is a link" for name in links)
            called |= {f"{path}/{name}": names[name] for name in folders}
            for name in sorted(name for name in files if name in names):
                yield _Found(names[name], name, number)

    def _portable(self, under: str, names: Iterable[str]) -> dict[str, str]:
        """The paths in the archive of what is in a folder; what has none is a problem."""
        found = {}
        texts = []
        for name in names:
            if name.startswith("."):
                continue
            try:
                name.encode()
            except UnicodeEncodeError:
                self.problems.append(f"{under}/{name}: its name is no text")
            else:
                texts.append(name)
        for name, portable in portable_names(texts).items():
            path = f"{under}/{portable}"
            if len(path) > LONGEST_PATH:
                self.problems.append(f"{under}/{name}: too many folders, one in another")
                continue
            if portable != name:
                self.renamed.append(f"{path}: was {name}")
            found[name] = path
        return found


class _Found(NamedTuple):
    """A file: its name in the archive, and where it is: a name in an open folder."""

    name: str
    path: str
    folder: int


def _walk(
    folder: Path, tell: Callable[[OSError], None]
) -> Iterator[tuple[str, list[str], list[str], int]]:
    try:
        yield from os.fwalk(folder, onerror=tell)
    except OSError as error:  # of the folder itself
        tell(error)


def _info(name: str, modified: float) -> zipfile.ZipInfo:
    stamp = time.localtime(min(max(modified, 0.0), _LATEST))[:6]
    info = zipfile.ZipInfo(name, max(stamp, _FIRST))
    info.external_attr = _MODE
    return info
