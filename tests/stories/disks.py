"""A small disk of its own that a story fills or lets hang; it needs root."""

from __future__ import annotations

import ctypes
import fcntl
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.stories.hands import system_program

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root: a disk is mounted")
"""Marks stories that mount disks."""
_FREEZE, _THAW = 0xC0045877, 0xC0045878
_NEW_MOUNTS = 0x00020000
_SIZE = 16 * 1024 * 1024


class Disk:
    """A mounted file system of 16 MB."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._ballast = folder / "ballast"

    def fill(self) -> None:
        """Leave no room."""
        with self._ballast.open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(4096))

    def make_room(self) -> None:
        self._ballast.unlink()

    @contextmanager
    def hanging(self) -> Iterator[None]:
        """No write comes back while inside."""
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.ioctl(folder, _FREEZE, 0)
            try:
                yield
            finally:
                fcntl.ioctl(folder, _THAW, 0)
        finally:
            os.close(folder)


@contextmanager
def mounted(folder: Path) -> Iterator[Disk]:
    """Mount a new disk at a folder while inside.

    The mounts are those of this process and of what it starts, so that none of them stays.
    """
    image = folder.with_suffix(".img")
    with image.open("wb") as file:
        file.truncate(_SIZE)
    _run([system_program("mkfs.ext4"), "-q", "-F", str(image)])
    folder.mkdir()
    ctypes.CDLL(None).unshare(_NEW_MOUNTS)
    _run(["mount", "--make-rprivate", "/"])
    try:
        _run(["mount", "-t", "ext4", "-o", "loop", str(image), str(folder)])
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no disk can be mounted here: {error.stderr}")
    try:
        yield Disk(folder)
    finally:
        _run(["umount", "--lazy", str(folder)])


def _run(command: list[str]) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True)
