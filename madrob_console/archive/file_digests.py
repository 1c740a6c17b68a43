"""Checksums that tie the files of a run to the result that was computed from them."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from madrob_console.common.plain_files import open_plain, refusal
from madrob_console.referee.records import Sha256

LARGEST_DIGESTED = 4_000_000_000
"""Larger files have no digest, bytes: it would take a minute. A run of 3 h takes half of that."""

_RECORDING = ".mcap"
_METADATA = "metadata.yaml"
_DATA = (_RECORDING, ".yaml", ".csv")


@dataclass(frozen=True, slots=True)
class FileDigest:
    """A file of the run as it was when the result was written.

    Attributes:
        sha256: its digest.
        bytes: its size.
    """

    sha256: Sha256
    bytes: int


def digests_of(
    folder: Path, new: Mapping[str, bytes] | None = None, run: str = ""
) -> tuple[dict[str, FileDigest], tuple[str, ...]]:
    """Digests of recording and data files, `new` ones included; then why others have none.

    `run` names the recording; by default it is called like the folder. A result that is attached
    to it does not count.
    """
    digests, left_out, new = {}, [], new or {}
    names = {f"{run or folder.name}_0.mcap", _METADATA, *filter(_is_data, _names(folder)), *new}
    for name in sorted(names):
        try:
            digests[name] = _digest_of(new[name]) if name in new else _digest(folder / name)
        except OSError as error:
            left_out.append(f"{name}: cannot be read ({refusal(error)})")
    return digests, tuple(left_out)


def digests_of_torn(recording: Path) -> set[str]:
    """The checksums of the torn files that `recover` has kept beside a recording."""
    digests = set()
    for name in _names(recording.parent):
        if name.startswith(f"{recording.name}.torn"):
            with suppress(OSError):
                digests.add(_digest(recording.parent / name).sha256)
    return digests


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208  of the names only
    except OSError:
        return []  # the files that must be there tell why


def _is_data(name: str) -> bool:
    return name.endswith(_DATA) and not name.startswith(".")


def _digest(path: Path) -> FileDigest:
    with os.fdopen(open_plain(path), "rb") as file:
        if (size := os.fstat(file.fileno()).st_size) > LARGEST_DIGESTED:
            raise OSError(errno.EFBIG, f"{size / 1e9:.1f} GB, too much for a digest")
        digest = hashlib.file_digest(file, "sha256")
        return FileDigest(sha256=digest.hexdigest(), bytes=file.tell())


def _digest_of(content: bytes) -> FileDigest:
    return FileDigest(sha256=hashlib.sha256(content).hexdigest(), bytes=len(content))
