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
from typing import Any

from mcap.records import Metadata

from recorder import RecorderError
from recorder.bag import (
    METADATA_FILE,
    YAML_PROBLEMS,
    BagInformation,
    RawMessage,
    Topic,
    is_evidence,
)
from recorder.evidence import listing, open_folder, put_listing, remove, summarised
from recorder.reader import (
    RECOVERY_RECORD,
    ChunkEnd,
    ForeignError,
    Outline,
    bag_files,
    bag_information,
    information_in,
    listed_names,
    natural_order,
    not_a_bag,
    open_recording,
    read_items,
    refuse_sqlite,
)
from recorder.writer import ROSBAG2_RECORD, BagFile

_PART = ".recovering"
_TORN = ".torn"
_TOLD = 3
"""Damaged chunks that are told one by one."""

_MOST_WAITING = 8_000_000
"""Bytes of the new file that wait in memory."""

_LARGEST_END = 100_000_000
"""A kill cuts one record, of no more bytes: a longer unreadable end is damage."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """A bag that is whole now.

    Attributes:
        torn: the old file; None if it was whole already, or is evidence that was only cut off.
        metadata: None if it was right, or the file is one of several in its folder.
        cut: what was wrong with the old file, in its order.
        tail_bytes: of the old file behind its last whole record, a cut chunk included, though
            its whole messages are kept.
        evidence: the same of each file of evidence that was not whole.
        hopeless: why other evidence stays as it is; it harms nothing.
    """

    file: Path
    messages: int
    torn: Path | None
    metadata: Path | None
    cut: tuple[str, ...]
    tail_bytes: int
    evidence: tuple[Recovered, ...] = ()
    hopeless: tuple[str, ...] = ()

    @property
    def changed(self) -> bool:
        written = bool(self.cut) or self.metadata is not None
        return written or any(file.changed for file in self.evidence)


def recover(path: Path) -> Recovered:
    """Repair a bag folder or an `.mcap` file; a whole one stays as it is.

    What the reader reads is kept, with its bytes, order and both times, and types, channels, QoS
    and metadata records. Raises RecorderError; nothing is then lost.
    """
    with _refusals(path):
        file, is_alone = _recording_at(path)
        with open_folder(file.parent) as folder_fd:
            recovered, information = _recover_file(file, folder_fd)
            if is_alone and (recovered.cut or not _is_listed(folder_fd, file.parent, information)):
                put_listing(folder_fd, information)
                recovered = replace(recovered, metadata=file.parent / METADATA_FILE)
            elif recovered.cut and is_evidence(file.name):
                put_listing(folder_fd)
            if path.is_dir():
                evidence, hopeless = _recover_evidence(path, folder_fd)
                recovered = replace(recovered, evidence=evidence, hopeless=hopeless)
            return recovered


def recover_evidence(folder: Path) -> tuple[Recovered, ...]:
    """Repair the evidence of a bag; the recording is left alone."""
    with _refusals(folder), open_folder(folder) as folder_fd:
        return _recover_evidence(folder, folder_fd)[0]


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Say in words why something cannot be repaired."""
    try:
        yield
    except ForeignError as error:
        if is_evidence(path.name):
            raise RecorderError(f"{path} is no evidence: {error}; remove it") from None
        raise not_a_bag(path, error) from None
    except OSError as error:
        raise RecorderError(
            f"cannot repair {path}: {error.strerror or error}; nothing is lost, "
            "check the path, and whether its disk has room and can be written"
        ) from None


def _recording_at(path: Path) -> tuple[Path, bool]:
    """Return the recording, and whether it is all that its folder has beside evidence."""
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


def _recover_evidence(
    folder: Path, folder_fd: int
) -> tuple[tuple[Recovered, ...], tuple[str, ...]]:
    """Repair each file without a summary; one that has it is taken for whole and not read."""
    done: list[Recovered] = []
    hopeless: list[str] = []
    for name in sorted(filter(is_evidence, os.listdir(folder_fd)), key=natural_order):
        if summarised(folder_fd, name) is not None:
            continue
        try:
            with _refusals(folder / name):
                done.append(_recover_file(folder / name, folder_fd)[0])
        except RecorderError as error:
            hopeless.append(str(error))
    if any(file.cut for file in done):
        put_listing(folder_fd)
    return tuple(done), tuple(hopeless)


def _recover_file(path: Path, folder_fd: int) -> tuple[Recovered, BagInformation]:
    with open_recording(path.name, folder_fd) as file:
        _lock(file, path.name)
        outline = _read(file, path)
        torn = None
        if outline.damages:
            torn = _replace(file, path, folder_fd, outline)
    cut = _damage_words(outline)
    count = outline.counts.total()
    recovered = Recovered(path, count, torn, None, cut, outline.tail_bytes)
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
    """Read a file to its end, whole or torn; RecorderError if no bag can hold its topics."""
    outline = Outline()
    for item in read_items(file):
        if isinstance(item, Topic) and outline.topics.get(item.name, item).type != item.type:
            raise RecorderError(
                f"{path}: {item.name[:80]!r} has two types, which no bag can hold; "
                "convert it by the tool that wrote it"
            )
        outline.add(item)
    foreign = [damage for damage in outline.damages if damage.is_foreign]
    if foreign:
        raise RecorderError(f"{path}: {foreign[0].words}; it is left as it is")
    return outline


def _damage_words(outline: Outline) -> tuple[str, ...]:
    gaps = [damage.outcome for damage in outline.damages if damage.tail_bytes is None]
    ends = [damage.words for damage in outline.damages if damage.tail_bytes is not None]
    if len(gaps) > _TOLD:
        ends.append(f"{len(gaps) - _TOLD} more chunks are left out")
    return (*gaps[:_TOLD], *ends)


def _replace(file: BufferedReader, path: Path, folder_fd: int, outline: Outline) -> Path | None:
    """Put what can be read in the place of a file; returns where that is kept."""
    part = path.name + _PART
    is_cut_off = all(damage.tail_bytes is not None for damage in outline.damages)
    remove(folder_fd, part)
    new = BagFile(folder_fd, part, listed_as=path.name)  # it is locked up to the end
    try:
        before = os.fstat(file.fileno())
        _copy(file, new, outline)
        after = os.fstat(file.fileno())
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
            raise RecorderError(f"{path} is being written; end its recording, then try again")
        torn = None
        if not (is_evidence(path.name) and is_cut_off and outline.tail_bytes <= _LARGEST_END):
            torn = path.with_name(_keep(folder_fd, path.name))
        os.rename(part, path.name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        os.fsync(folder_fd)
        return torn
    finally:
        new.close()
        remove(folder_fd, part)


def _copy(file: BufferedReader, new: BagFile, outline: Outline) -> None:
    new.start((), {})
    for item in read_items(file):
        match item:
            case RawMessage():
                new.add_message(item)
            case ChunkEnd():
                new.end_chunk()
                if len(new.disk.waiting) > _MOST_WAITING:
                    new.sync()
            case Topic():
                new.register(item)
            case Metadata() if item.name != ROSBAG2_RECORD:  # it is made anew
                new.add_record(item.name, item.metadata)
    record = {"problem": outline.damages[0].outcome, "tail_bytes": str(outline.tail_bytes)}
    new.add_record(RECOVERY_RECORD, record)
    new.finish()


def _keep(folder_fd: int, name: str) -> str:
    """Give a file a second name, `NAME.torn`, and return it."""
    for number in count(1):
        torn = name + _TORN + (f".{number}" if number > 1 else "")
        try:
            os.link(name, torn, src_dir_fd=folder_fd, dst_dir_fd=folder_fd, follow_symlinks=False)
        except FileExistsError:
            if not _is_same(folder_fd, name, torn):  # else a repair was ended here
                continue
        return torn
    raise AssertionError


def _is_same(folder_fd: int, *names: str) -> bool:
    first, second = (os.stat(name, dir_fd=folder_fd, follow_symlinks=False) for name in names)
    return os.path.samestat(first, second)


def _is_listed(folder_fd: int, folder: Path, information: BagInformation) -> bool:
    """Whether `metadata.yaml` tells what is there; a damaged one is kept under a second name."""
    listed = listing(folder_fd, information) or information
    expected = information_in(listed.metadata_yaml().encode())
    try:
        document = bag_information(folder)
        return (
            listed_names(document) == listed_names(expected)
            and document["message_count"] == expected["message_count"]
            and _counts(document) == _counts(expected)
        )
    except FileNotFoundError:
        return False
    except YAML_PROBLEMS:
        _keep(folder_fd, METADATA_FILE)
        return False


def _counts(document: dict[str, Any]) -> dict[str, int]:
    topics = document["topics_with_message_count"]
    counts = {topic["topic_metadata"]["name"]: topic["message_count"] for topic in topics}
    return {name: count for name, count in counts.items() if count}
