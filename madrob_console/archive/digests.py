"""What tells that the files of a run are those that made its result."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from madrob_console.files.plain import open_plain, refusal

Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A digest as `sha256sum` prints it."""

_DATA = (".mcap", ".yaml", ".csv")


@dataclass(frozen=True, slots=True)
class FileDigest:
    """A file of the run as it was when the result was written.

    Attributes:
        sha256: its digest.
        bytes: its size.
    """

    sha256: Sha256
    bytes: int


def digests_of(folder: Path) -> tuple[dict[str, FileDigest], tuple[str, ...]]:
    """The digests of a run's recording and data files, and which have none and why, in words."""
    digests, left_out = {}, []
    for name in sorted({f"{folder.name}_0.mcap", "metadata.yaml", *_data_files(folder)}):
        try:
            digests[name] = _digest(folder / name)
        except OSError as error:
            left_out.append(f"{name}: cannot be read ({refusal(error)})")
    return digests, tuple(left_out)


def _data_files(folder: Path) -> list[str]:
    try:
        names = os.listdir(folder)  # noqa: PTH208  of the names only
    except OSError:
        return []  # the files that must be there tell why
    return [name for name in names if name.endswith(_DATA) and not name.startswith(".")]


def _digest(path: Path) -> FileDigest:
    with os.fdopen(open_plain(path), "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return FileDigest(sha256=digest, bytes=file.tell())
