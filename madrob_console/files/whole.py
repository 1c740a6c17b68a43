"""Files that are written whole or not at all, and the room that is left for them."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from madrob_console.errors import MadrobError


def atomic_write(path: Path, data: bytes) -> None:
    """Write a file as `whole_file` does.

    Raises:
        MadrobError: the disk refuses.
    """
    with whole_file(path) as file:
        file.write(data)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to be written that, whatever happens, is either the old one or the whole new one.

    The data are on disk at the end. A link at `path` is replaced, not followed.

    Raises:
        MadrobError: the disk refuses.
    """
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise MadrobError(
            f"{path}: not written ({error.strerror}); make room or choose another folder"
        ) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def free_space(path: Path) -> int | None:
    """Bytes free where `path` lies or will lie; None if that cannot be found out."""
    for place in (path, *path.absolute().parents):
        try:
            return shutil.disk_usage(place).free
        except FileNotFoundError:
            continue
        except OSError:
            return None
    return None


def _sync_folder(folder: Path) -> None:
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(file)
    finally:
        os.close(file)
