"""A bag folder while it is written: made exclusively, and a bag from its first moment on."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

from recorder.bag import METADATA_FILE, Topic, bag_file_name
from recorder.errors import RecorderError, remedy
from recorder.listing import metadata_part, prepare_metadata, put_listing, put_metadata
from recorder.mcap_file import McapFile


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
                prepare_metadata(self._fd, self.file.information())
                put_metadata(self._fd)
                _sync_folder(folder.parent)
            except OSError as error:
                raise _cannot_record(folder, error) from None
            undo.pop_all()

    def finish(self) -> None:
        """Complete the recording and `metadata.yaml`; both are on the disk on return.

        Listed is what evidence is whole by then; evidence that comes later lists itself.
        """
        self.file.finish()
        put_listing(self._fd, self.file.information())

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


def _cannot_record(folder: Path, error: OSError) -> RecorderError:
    otherwise = "choose a folder that exists and can be written, on a disk with room"
    hint = remedy(error) or otherwise
    return RecorderError(f"cannot record to {folder}: {error.strerror or error}; {hint}")


def _remove(folder: Path, name: str) -> None:
    """Take away what was just made here, and nothing else."""
    for made in (name, METADATA_FILE, metadata_part()):
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
