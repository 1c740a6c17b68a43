"""Zips that lead nobody out of their folder, and bags in them."""

from __future__ import annotations

import hashlib
import html
import os
import re
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import BinaryIO, NamedTuple, Self
from urllib.parse import quote, unquote

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.common.files import open_plain, refusal, stamp_of
from madrob_console.common.names import terminal_safe
from recorder.bag import METADATA_FILE, is_evidence, is_left_of_evidence
from recorder.survey import listing

# File names that are safe to unpack; a run's folder may hold any name.


LONGEST_PATH = 400
"""Longest path in an archive, characters: folders in folders have no end."""

_UNSAFE = re.compile(r"[/\\:]")  # `C:` and `..\` lead out of the folder on some systems


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """Names in an archive for the files and folders of one folder.

    Nearly all stay as they are. What leads out of the folder or steers a terminal goes or becomes
    `_`. Of two that are then alike one gets a number: the one that changes anyway.
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in sorted(names, key=lambda name: (_safe(name) != name, name)):
        path = PurePosixPath(_safe(name))
        called, number = str(path), 1
        while called in taken:
            number += 1
            called = f"{path.stem}_{number}{path.suffix}"
        taken.add(called)
        found[name] = called
    return found


def _safe(name: str) -> str:
    return _UNSAFE.sub("_", terminal_safe(name)).strip(" .") or "_"


SUMS_FILE = "SHA256SUMS"
"""In the archive: input of `sha256sum -c`."""

_BLOCK = 1 << 20
_FIRST, _LATEST = (1980, 1, 1, 0, 0, 0), 4.3e9  # what a zip can say, until the year 2106
_MODE = 0o100644 << 16


class Archive:
    """A zip that takes files as they come; memory does not grow with them.

    `problems` say what could not be read and why, `renamed` what has another name in it.
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
        """Adds the files of a folder and returns their names in the archive.

        What cannot be read is a problem. Links are not followed; hidden files are temporary.
        Names are made safe, see `safe_names`. `called` is the folder's name in the
        archive, if not its own. `without` tells which file names are left out. `instead` has
        content by name in the archive, added in place of files.

        Raises:
            OSError: the archive cannot be written.
        """
        added = []
        for found in self._files_in(folder, called or folder.name):
            if not without(found.path):
                added += [found.name] if self._add(found, instead.get(found.name)) else []
        return added

    def add_file(self, name: str, data: bytes, modified: float) -> None:
        self._zip.writestr(_info(name, modified), data, zipfile.ZIP_DEFLATED)
        self._count(name, hashlib.sha256(data).hexdigest())

    def finish(self, modified: float) -> None:
        """Adds the checksums; nothing can be added afterwards."""
        self.add_file(SUMS_FILE, "".join(self._sums).encode(), modified)
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
            self.add_file(found.name, instead, os.fstat(number).st_mtime)
            return True

    def _copy(self, name: str, file: BinaryIO) -> bool:
        """Copies what the file holds now; what it grows by meanwhile is left out."""
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
            names = self._safe(under, (*folders, *files))
            folders[:] = sorted(name for name in folders if name in names)
            links = (name for name in folders if Path(path, name).is_symlink())
            self.problems.extend(f"{under}/{name}: is a link" for name in links)
            called |= {f"{path}/{name}": names[name] for name in folders}
            for name in sorted(name for name in files if name in names):
                yield _Found(names[name], name, number)

    def _safe(self, under: str, names: Iterable[str]) -> dict[str, str]:
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
        for name, safe in safe_names(texts).items():
            path = f"{under}/{safe}"
            if len(path) > LONGEST_PATH:
                self.problems.append(f"{under}/{name}: too many folders, one in another")
                continue
            if safe != name:
                self.renamed.append(f"{path}: was {name}")
            found[name] = path
        return found


class _Found(NamedTuple):
    """A file: its name in the archive, and its name in an open folder."""

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


# The files of a bag that are packed: evidence is large and not always wanted.


@dataclass(frozen=True, slots=True)
class BagParts:
    """Parts of bags to pack: the scored recording, without which a bag is left out; evidence.

    Evidence is cameras and other topics.
    """

    recording: bool = True
    evidence: bool = True


WHOLE_BAGS = BagParts()


@dataclass(frozen=True, slots=True)
class PackedBag:
    """A bag as it is packed.

    Attributes:
        without: whether a file of this name of the run's folder is left out.
        metadata: the `metadata.yaml` of what is packed; None = the folder's.
        evidence_left_out: whether the run has evidence that is not wanted.
        problems: evidence that is missing and why, in words.
    """

    without: Callable[[str], bool]
    metadata: str | None = None
    evidence_left_out: bool = False
    problems: tuple[str, ...] = ()

    def has(self, name: str) -> bool:
        return not self.without(name) or (name == METADATA_FILE and self.metadata is not None)

    @classmethod
    def of(cls, run: Path, parts: BagParts) -> Self:
        """Evidence that nobody could open is not packed."""
        try:
            return cls._of(run, parts)
        except OSError:  # what cannot be read is named when it is packed
            return cls(lambda _name: False)

    @classmethod
    def _of(cls, run: Path, parts: BagParts) -> Self:
        names = os.listdir(run)  # noqa: PTH208  of the names only
        # a file that was made just before a power cut holds nothing
        evidence = {name for name in filter(is_evidence, names) if (run / name).lstat().st_size}
        if not parts.recording:
            return cls(
                lambda name: ".mcap" in name or METADATA_FILE in name,
                evidence_left_out=bool(evidence),
            )
        if not any(map(is_left_of_evidence, names)):
            return cls(lambda _name: False)
        folder_fd = os.open(run, os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            listed = listing(folder_fd, None, () if parts.evidence else evidence)
        finally:
            os.close(folder_fd)
        if listed is None:  # the recording is torn: then no evidence is listed
            return cls(
                is_left_of_evidence,
                evidence_left_out=not parts.evidence,
                problems=_not_whole(evidence) if parts.evidence else (),
            )
        packed = {file.file_name for file in listed.more}

        def without(name: str) -> bool:
            return name == METADATA_FILE or (is_left_of_evidence(name) and name not in packed)

        lost = _not_whole(evidence - packed) if parts.evidence else ()
        return cls(without, listed.metadata_yaml(), bool(evidence - packed), lost)


def _not_whole(evidence: Iterable[str]) -> tuple[str, ...]:
    words = "is evidence that is not whole: `madrob recover` repairs it, then export again"
    return tuple(f"{name}: {words}" for name in sorted(evidence))


def add_run(
    archive: Archive,
    run: Path,
    called: str,
    bag: PackedBag,
    instead: Mapping[str, bytes] = MappingProxyType({}),
) -> list[str]:
    """Adds the folder of a run and returns its names in the archive.

    `instead` has by name what is packed in place of a file; a report is packed only so.
    """
    instead = {f"{called}/{name}": data for name, data in instead.items()}

    def without(name: str) -> bool:  # anybody may have written the report in the folder
        unmade = name == REPORT_FILE and f"{called}/{name}" not in instead
        return unmade or bag.without(name)

    added = archive.add_folder(run, called, without=without, instead=instead)
    archive.problems += [f"{called}/{problem}" for problem in bag.problems]
    if bag.metadata is not None:
        name, stamp = f"{called}/{METADATA_FILE}", stamp_of(str(run / METADATA_FILE))
        archive.add_file(
            name, bag.metadata.encode(), 0.0 if stamp is None else stamp.modified / 1e9
        )
        added.append(name)
    return added


def size_of(run: Path, bag: PackedBag) -> tuple[int, int]:
    """Bytes of a run's packed files, and how many of these are evidence."""
    total = evidence = 0
    for path, _, names in os.walk(run):
        for name in names:
            if bag.without(name) or name.startswith("."):
                continue
            try:
                size = Path(path, name).lstat().st_size
            except OSError:
                continue
            total += size
            evidence += size if is_evidence(name) else 0
    return total, evidence


# Links of a report, rewritten for another place.


_LINK = re.compile(r'<a href="([^"#][^"]*)">([^<]*</a>)?')


def led_elsewhere(page: str, place: Callable[[str], str | None], nowhere: str = "") -> str:
    """Replaces a page's links by `place`; links to places on the page itself stay.

    `place` takes a relative path; None = no link. `nowhere` then follows the words.
    """

    def led(found: re.Match[str]) -> str:
        target = place(unquote(html.unescape(found[1])))
        words = found[2] or ""
        if target is None:
            return f"<a>{words}{words and nowhere}"
        return f'<a href="{quote(target)}">{words}'

    return _LINK.sub(led, page)
