"""Evidence in a bag: cameras and other topics, in files of their own beside what is scored.

`metadata.yaml` lists what a reader can open. Evidence that is still written, was cut off or is
damaged is left out until it is whole: readers refuse a bag with a file that they cannot open.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from recorder.bag import METADATA_FILE, YAML_PROBLEMS, BagInformation, is_evidence
from recorder.reader import (
    METADATA_LIMIT,
    ForeignError,
    information_in,
    listed_names,
    natural_order,
    open_recording,
    read_summary,
)

_GOES = 100
"""The most tries to list again; each needs a file that came or went meanwhile."""


@dataclass(frozen=True, slots=True)
class FurtherFile:
    """An evidence file of a bag that others record.

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


def put_listing(folder_fd: int, recording: BagInformation | None = None) -> None:
    """List all files of a bag in its `metadata.yaml`; on disk on return.

    Call it after a file of the bag was finished, repaired or removed. Several processes may do
    so at once without a lock: the last one looks once more. Nothing is listed while the recording
    is unfinished: who finishes or repairs it lists all.
    """
    listed = listing(folder_fd, recording)
    for _ in range(_GOES):
        if listed is None:
            return
        write_metadata(folder_fd, listed)
        before, listed = listed, listing(folder_fd, recording)
        if listed == before:
            return


def listing(
    folder_fd: int, recording: BagInformation | None = None, without: Collection[str] = ()
) -> BagInformation | None:
    """Return what `put_listing` would write, but for the evidence `without`; reads no message."""
    names = [name for name in os.listdir(folder_fd) if name.endswith(".mcap")]
    names.sort(key=natural_order)
    recordings = [recording]
    if recording is None:
        scored = _listed(folder_fd) or [name for name in names if not is_evidence(name)]
        recordings = [summarised(folder_fd, name) for name in scored]
    if not recordings or None in recordings:
        return None
    evidence = [name for name in names if is_evidence(name) and name not in without]
    files = [*recordings, *(summarised(folder_fd, name) for name in evidence)]
    first, *more = [file for file in files if file is not None]
    return replace(first, more=tuple(more))


def _listed(folder_fd: int) -> list[str]:
    try:
        with open_recording(METADATA_FILE, folder_fd) as file:
            names = listed_names(information_in(file.read(METADATA_LIMIT)))
    except (ForeignError, OSError, *YAML_PROBLEMS):
        return []
    return [name for name in names if not is_evidence(name)]


def summarised(folder_fd: int, name: str) -> BagInformation | None:
    """Return what the summary of a file tells of it; None while there is none."""
    try:
        with open_recording(name, folder_fd) as file:
            outline = read_summary(file)
    except (ForeignError, OSError):
        return None
    return None if outline is None else outline.information(name)


def write_metadata(folder_fd: int, information: BagInformation) -> None:
    """Replace `metadata.yaml`, on disk on return; a crash leaves one or the other."""
    part = f"{METADATA_FILE}.{threading.get_native_id()}.part"  # no reader looks at it
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with os.fdopen(os.open(part, flags, 0o666, dir_fd=folder_fd), "wb") as file:
            file.write(information.metadata_yaml().encode())
            file.flush()
            os.fsync(file.fileno())
        os.rename(part, METADATA_FILE, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        os.fsync(folder_fd)
    except OSError:
        remove(folder_fd, part)
        raise


@contextmanager
def open_folder(folder: Path) -> Iterator[int]:
    fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield fd
    finally:
        os.close(fd)


def remove(folder_fd: int, name: str) -> None:
    """Remove a file; errors are ignored, because the next create fails instead."""
    with suppress(OSError):
        os.unlink(name, dir_fd=folder_fd)
