"""A small disk of its own that a test can fill, spoil and pull out; nothing stays mounted."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.programs import found
from tests.stories.disks import Disk

_SHUTDOWN = 0x8004587D  # FS_IOC_SHUTDOWN: what was not synced is gone, every access fails
_NO_LOGFLUSH = struct.pack("I", 2)
_IMMUTABLE = 0x00000010
_GET_FLAGS, _SET_FLAGS = 0x80086601, 0x40086602
_EXT4_BYTES = 8 * 1024 * 1024
_CLONE_NEWNS = 0x00020000


class SmallDisk(Disk):
    """A mounted disk of 2 to 8 MB.

    Attributes:
        folder: where it is mounted.
    """

    def __init__(self, folder: Path, mounting: list[str], image: Path | None = None) -> None:
        super().__init__(folder)
        self._mounting = mounting
        self._image = image

    def mount(self) -> None:
        """Put it in place; skips the test where that is not allowed."""
        self.folder.mkdir(exist_ok=True)
        _leave_the_mounts_of_others()
        device = "tmpfs" if self._image is None else str(self._image)
        command = ["mount", *self._mounting, device, str(self.folder)]
        try:
            subprocess.run(command, check=True, capture_output=True, text=True)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no disk can be mounted here: {error.stderr.strip()}")

    def unmount(self) -> None:
        """Take it away even where files are open."""
        subprocess.run(["umount", "--lazy", str(self.folder)], check=False, capture_output=True)

    def come_back(self) -> None:
        """Plug it in again: another device, since files are open on the one that failed."""
        self.unmount()
        if self._image is not None:
            again = self._image.with_suffix(".again.img")
            self._image = Path(shutil.copyfile(self._image, again))
        self.mount()

    def fill(self, free_blocks: int = 0) -> None:
        """Leave so many blocks, or none."""
        room = os.statvfs(self.folder)
        with self._ballast.open("wb", buffering=0) as file, suppress(OSError):
            for _ in range(room.f_bavail - free_blocks):
                file.write(bytes(room.f_bsize))

    def turn_read_only(self) -> None:
        """What the kernel does when a file system finds an error."""
        device = next(
            line.split()[0].rpartition("/")[2]
            for line in Path("/proc/thread-self/mounts").read_text().splitlines()
            if line.split()[1] == str(self.folder)
        )
        Path(f"/sys/fs/ext4/{device}/trigger_fs_error").write_text("1")

    def pull_out(self) -> None:
        """Every access fails from now on."""
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.ioctl(folder, _SHUTDOWN, _NO_LOGFLUSH)
        finally:
            os.close(folder)


def lock_folder(folder: Path, *, locked: bool) -> None:
    """Let nobody, not even root, make or rename a file there; open files can be written."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        (flags,) = struct.unpack("i", fcntl.ioctl(fd, _GET_FLAGS, struct.pack("i", 0)))
        flags = flags | _IMMUTABLE if locked else flags & ~_IMMUTABLE
        fcntl.ioctl(fd, _SET_FLAGS, struct.pack("i", flags))
    finally:
        os.close(fd)


@contextmanager
def memory_disk(folder: Path) -> Iterator[SmallDisk]:
    """A tmpfs of 2 MB."""
    yield from _mounted(SmallDisk(folder, ["-t", "tmpfs", "-o", "size=2m"]))


@contextmanager
def disk_image(folder: Path) -> Iterator[SmallDisk]:
    """An ext4 file system of 8 MB in a file beside the folder; needs mkfs.ext4."""
    image = folder.with_name(f"{folder.name}.img")
    with image.open("wb") as file:
        file.truncate(_EXT4_BYTES)
    make = found("mkfs.ext4") or "mkfs.ext4"
    subprocess.run([make, "-q", "-F", str(image)], check=True, capture_output=True)
    options = ["-t", "ext4", "-o", "loop,errors=remount-ro"]
    yield from _mounted(SmallDisk(folder, options, image))


def _leave_the_mounts_of_others() -> None:
    """Give this thread and what it starts mounts of their own, which end with them, killed or not.

    A disk that stays mounted in a folder of pytest's makes every later session of pytest fail.
    """
    ctypes.CDLL(None).unshare(_CLONE_NEWNS)  # not allowed: nor is `mount`, which says so
    subprocess.run(["mount", "--make-rprivate", "/"], check=False, capture_output=True)


def _mounted(disk: SmallDisk) -> Iterator[SmallDisk]:
    disk.mount()
    try:
        yield disk
    finally:
        disk.unmount()
