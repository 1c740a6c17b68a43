"""A bag folder while it is written: made exclusively, and a bag from its first moment on."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

from recorder.bag import METADATA_FILE, BagInformation, Topic, bag_file_name
from recorder.errors import RecorderError, remedy
from recorder.mcap_file import McapFile

METADATA_PART = f"{METADATA_FILE}.part"
"""`metadata.yaml` before it is whole; no reader looks at it."""


class BagFolder:
    """The folder, its recording and its `metadata.yaml`; not thread-safe.

    The folder is held open, so that it may be renamed while it is recorded to.

    Attributes:
        file: the recording.
    """

    def __init__(
        self, folder: Path, topics: Iterable[Topic], records: Mapping[str, Mapping[str, str]]
    ) -> None:
        """Make everything; it has reached the disk on return.

        Raises:
            RecorderError: it cannot be made; nothing is left behind.
        """
        try:
            folder.mkdir()
        except FileExistsError:
            raise RecorderError(
                f"{folder} exists already; move it away or record under another name"
            ) from None
        except OSError as error:
            raise _cannot_record(folder, error) from None
        name = bag_file_name(folder.name)
        self._folder, self._name = folder, name
        with ExitStack() as undo:
            undo.callback(_remove, folder, name)
            try:
                self._fd = os.open(folder, os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
                undo.callback(os.close, self._fd)
                self.file = McapFile(self._fd, name)
                undo.callback(self.file.close)
                self.file.start(topics, records)
                self._write_metadata()
                _sync_folder(folder.parent)
            except OSError as error:
                raise _cannot_record(folder, error) from None
            undo.pop_all()

    def finish(self) -> None:
        """Complete the recording and `metadata.yaml`; both are on the disk on return."""
        self.file.finish()
        self._write_metadata()

    def close(self) -> None:
        """Let go of everything, as it is."""
        with suppress(OSError):
            self.file.close()
        with suppress(OSError):
            os.close(self._fd)

    def remove(self) -> None:
        """Close it and take it away again, as long as nothing was recorded."""
        self.close()
        _remove(self._folder, self._name)

    def _write_metadata(self) -> None:
        prepare_metadata(self._fd, self.file.information())
        put_metadata(self._fd)


def prepare_metadata(folder_fd: int, information: BagInformation) -> None:
    """Write the next `metadata.yaml` beside the one that stands; on the disk on return.

    Raises:
        OSError: the disk refuses.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    fd = os.open(METADATA_PART, flags, 0o666, dir_fd=folder_fd)
    with os.fdopen(fd, "w", encoding="utf-8") as file:
        file.write(information.metadata_yaml())
        file.flush()
        os.fsync(file.fileno())


def put_metadata(folder_fd: int) -> None:
    """Make the prepared `metadata.yaml` the one that counts; after a crash it is either of them.

    Raises:
        OSError: the disk refuses.
    """
    os.rename(METADATA_PART, METADATA_FILE, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
    os.fsync(folder_fd)


def _cannot_record(folder: Path, error: OSError) -> RecorderError:
    otherwise = "choose a folder that exists and can be written, on a disk with room"
    hint = remedy(error) or otherwise
    return RecorderError(f"cannot record to {folder}: {error.strerror or error}; {hint}")


def _remove(folder: Path, name: str) -> None:
    """Take away what was just made here, and nothing else."""
    for made in (name, METADATA_FILE, METADATA_PART):
        with suppress(OSError):
            (folder / made).unlink()
    with suppress(OSError):
        folder.rmdir()


def _sync_folder(folder: Path) -> None:
    """Make the names in a folder survive a power cut."""
    fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
