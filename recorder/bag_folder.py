"""The folder and the file that a recorder writes: a bag from the first moment on."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from recorder.bag import METADATA_FILE, Topic, bag_file_name, evidence_file_name
from recorder.errors import RecorderError, remedy
from recorder.listing import put_listing, remove
from recorder.mcap_file import McapFile


@dataclass(frozen=True, slots=True)
class FurtherFile:
    """An evidence file of a bag that others record; its writes have low priority.

    Attributes:
        folder: of the bag.
        number: of the file, from 0.
        refusal: called by the writer's thread before about each MB, with the bytes of the file
            and those that come. It says why nothing more may be recorded: the file is then
            finished. It may wait.
    """

    folder: Path
    number: int
    refusal: Callable[[int, int], str | None]


class BagFolder:
    """A folder and the new file of it that is recorded to; not thread-safe.

    It is held open, so that it may be renamed while it is recorded to. Without evidence the folder
    is new as well.
    """

    def __init__(
        self,
        place: Path | FurtherFile,
        topics: Iterable[Topic],
        records: Mapping[str, Mapping[str, str]],
    ) -> None:
        """Make everything; on disk on return. RecorderError leaves nothing behind."""
        self._is_new = not isinstance(place, FurtherFile)
        if isinstance(place, FurtherFile):
            folder, name = place.folder, evidence_file_name(place.folder.name, place.number)
        else:
            folder, name = place, bag_file_name(place.name)
        with ExitStack() as undo:
            try:
                if self._is_new:
                    folder.mkdir()
                    undo.callback(_remove_folder, folder)
                self._fd = os.open(folder, os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
                undo.callback(os.close, self._fd)
                self.file = McapFile(self._fd, name)
                undo.callback(remove, self._fd, name)
                undo.callback(self.file.close)
                self.file.start(topics, records)
                if self._is_new:
                    undo.callback(remove, self._fd, METADATA_FILE)
                    put_listing(self._fd, self.file.information())
                    _sync_folder(folder.parent)
                else:
                    os.fsync(self._fd)
            except FileExistsError:
                existing = folder if self._is_new else folder / name
                raise RecorderError(
                    f"{existing} exists already; move it away or record under another name"
                ) from None
            except OSError as error:
                raise _cannot_record(folder, error) from None
            self._undo = undo.pop_all()

    def finish(self) -> None:
        """Complete the file and `metadata.yaml`; both are on disk on return.

        The recording lists the evidence that is whole by then; later evidence lists itself.
        """
        self.file.finish()
        put_listing(self._fd, self.file.information() if self._is_new else None)

    def close(self) -> None:
        with suppress(OSError):
            self.file.close()
        with suppress(OSError):
            os.close(self._fd)

    def remove(self) -> None:
        """Delete what is new; only as long as nothing was recorded."""
        self._undo.close()


def _cannot_record(folder: Path, error: OSError) -> RecorderError:
    otherwise = "choose a folder that exists and can be written, on a disk with room"
    hint = remedy(error) or otherwise
    return RecorderError(f"cannot record to {folder}: {error.strerror or error}; {hint}")


def _remove_folder(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _sync_folder(folder: Path) -> None:
    """The names in a folder then survive a power cut."""
    fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
