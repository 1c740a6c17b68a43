"""Repairs a bag that was cut off or damaged: what can be read, in a file that every reader takes.

The new file is written beside the old one and takes its name in one step; the old one stays as
`NAME.mcap.torn`. A kill at any moment leaves the old file or the new one under the name, and the
old one in any case; to repair again is harmless.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from io import BufferedReader
from itertools import count
from pathlib import Path

from recorder import RecorderError
from recorder.bag import (
    METADATA_FILE,
    YAML_PROBLEMS,
    BagInformation,
    Batch,
    write_metadata,
)
from recorder.reader import (
    RECOVERY_RECORD,
    ForeignError,
    Outline,
    bag_files,
    bag_information,
    listed_names,
    not_a_bag,
    open_recording,
    read_parts,
    read_summary,
    refuse_sqlite,
)
from recorder.writer import ROSBAG2_RECORD, BagFile

_PART = ".recovering"
_TORN = ".torn"
_TOLD = 3
"""Damaged parts that are told one by one."""

_MOST_WAITING = 8_000_000
"""Bytes of the new file that wait in memory."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """A bag that is whole now.

    Attributes:
        torn: the old file; None if it was whole already.
        metadata: None if it was right, or the file is one of several in its folder.
        cut: what was wrong with the old file, in its order.
    """

    file: Path
    messages: int
    torn: Path | None
    metadata: Path | None
    cut: tuple[str, ...]

    @property
    def changed(self) -> bool:
        return bool(self.cut) or self.metadata is not None


def recover(path: Path) -> Recovered:
    """Repair a bag folder or an `.mcap` file.

    A whole one stays as it is.

    What the reader reads is kept, with its bytes, order and both times, and types, channels, QoS
    and metadata records. Raises RecorderError; nothing is then lost.
    """
    with _refusals(path):
        file, is_alone = _recording_at(path)
        recovered, information = _recover_file(file)
        if is_alone and (recovered.cut or not _is_listed(file.parent, information)):
            with _open_folder(file.parent) as folder_fd:
                write_metadata(folder_fd, information)
            recovered = replace(recovered, metadata=file.parent / METADATA_FILE)
        return recovered


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Say in words why something cannot be repaired."""
    try:
        yield
    except ForeignError as error:
        raise not_a_bag(path, error) from None
    except OSError as error:
        raise RecorderError(
            f"cannot repair {path}: {error.strerror or error}; nothing is lost, "
            "check the path, and whether its disk has room and can be written"
        ) from None


def _recording_at(path: Path) -> tuple[Path, bool]:
    """Return the recording, and whether it is all that its folder has."""
    if path.is_dir():
        files = bag_files(path)[0]
        refuse_sqlite(path, files)
        if len(files) > 1:
            raise RecorderError(
                f"{path} holds {len(files)} recordings; repair each of the files, "
                f"then make their {METADATA_FILE} by `ros2 bag reindex`"
            )
        return path / files[0].name, True
    path = Path(os.path.realpath(path))
    refuse_sqlite(path, [path])
    if path.suffix != ".mcap":
        path.stat()
        raise ForeignError("its name does not end in .mcap")
    with suppress(RecorderError, ForeignError):
        return path, bag_files(path.parent)[0] == [path]
    return path, False


def _recover_file(path: Path) -> tuple[Recovered, BagInformation]:
    with open_recording(path) as file:
        _lock(file, path.name)
        outline = _read(file, path)
        summary = read_summary(file)
        if summary is not None:  # it may tell records that damage hides
            outline.records |= summary.records
        torn = None
        if outline.problems:
            torn = _replace(file, path, outline)
    cut = outline.problems
    if len(cut) > _TOLD:
        cut = [*cut[:_TOLD], f"{len(cut) - _TOLD} more parts"]
    recovered = Recovered(path, outline.counts.total(), torn, None, tuple(cut))
    return recovered, outline.information(path.name)


def _lock(file: BufferedReader, name: str) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise RecorderError(
            f"{name} is being written; end its recording or repair, then try again"
        ) from None
    except OSError:
        pass  # not every network disk has locks


def _read(file: BufferedReader, path: Path) -> Outline:
    """Read a file to its end, whole or torn.

    RecorderError if no bag can hold what is in it.
    """
    outline = Outline()
    has_gaps = False
    for part in read_parts(file):
        for topic in part.topics:
            if outline.topics.get(topic.name, topic).type != topic.type:
                raise RecorderError(
                    f"{path}: {topic.name[:80]!r} has two types, which no bag can hold; "
                    "convert it by the tool that wrote it"
                )
        outline.add(part)
        has_gaps = has_gaps or (part.problem is not None and not part.is_end)
    if has_gaps and not outline.counts:
        raise RecorderError(
            f"{path}: {outline.problems[0]}, and nothing is left; it stays as it is"
        )
    return outline


def _replace(file: BufferedReader, path: Path, outline: Outline) -> Path:
    """Put what can be read in the place of a file.

    Returns where that is kept.
    """
    part = path.with_name(path.name + _PART)
    part.unlink(missing_ok=True)
    outline.records.pop(ROSBAG2_RECORD, None)  # it is made anew
    begins_with = Batch(records=outline.records)
    new = BagFile(part, begins_with, listed_as=path.name)  # it is locked up to the end
    try:
        for batch in read_parts(file):
            batch.records.clear()
            new.add(batch)
            new.end_chunk()
            if len(new.disk.waiting) > _MOST_WAITING:
                new.sync()
        new.add(Batch(records={RECOVERY_RECORD: {"problem": outline.problems[0]}}))
        new.finish()
        torn = _keep(path)
        part.rename(path)
        with _open_folder(path.parent) as folder_fd:
            os.fsync(folder_fd)
        return torn
    finally:
        new.close()
        part.unlink(missing_ok=True)


def _keep(path: Path) -> Path:
    """Give a file a second name, `NAME.torn`, and return it."""
    for number in count(1):
        torn = path.with_name(path.name + _TORN + (f".{number}" if number > 1 else ""))
        try:
            os.link(path, torn)
        except FileExistsError:
            if not torn.samefile(path):  # else a repair was ended here
                continue
        return torn
    raise AssertionError


def _is_listed(folder: Path, information: BagInformation) -> bool:
    """Return whether `metadata.yaml` tells what is there."""
    try:
        listed = bag_information(folder)
        counts = {
            topic["topic_metadata"]["name"]: topic["message_count"]
            for topic in listed["topics_with_message_count"]
            if topic["message_count"]
        }
        return listed_names(listed) == [information.file_name] and counts == information.counts
    except (FileNotFoundError, *YAML_PROBLEMS):
        return False


@contextmanager
def _open_folder(folder: Path) -> Iterator[int]:
    fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield fd
    finally:
        os.close(fd)
