"""Repair a bag that was cut off or damaged: the same messages in a file that every reader takes.

The new file is written beside the old one, read back, and takes its name in one step; the old one
stays as `NAME.mcap.torn`. A kill at any moment leaves the old file or the new one under the name,
and the old one in any case; to repair again is harmless.

Of evidence that was only cut off the old file goes: the new one has every whole message of it, and
it would take the same room once more.
"""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, TypeAlias

from mcap.records import Metadata

from recorder.bag import (
    METADATA_FILE,
    YAML_PROBLEMS,
    BagInformation,
    RawMessage,
    Topic,
    is_evidence,
)
from recorder.errors import RecorderError
from recorder.mcap_reader import DamageError, ForeignError
from recorder.mcap_writer import ROSBAG2_RECORD, McapFile
from recorder.reader import (
    RECOVERY_RECORD,
    bag_files,
    bag_information,
    listed_names,
    natural_order,
    not_a_bag,
    read_items,
    refuse_sqlite,
)
from recorder.survey import (
    TORN,
    Survey,
    keep,
    listing,
    lock,
    metadata_part,
    open_file,
    prepare_metadata,
    put_back,
    put_listing,
    put_metadata,
    remove,
    summarised,
)

_SUFFIX = ".mcap"
_PART = ".recovering"

_REMEDIES = {
    errno.ENOSPC: "make room on its disk or copy it to another",
    errno.EDQUOT: "make room on its disk or copy it to another",
    errno.EFBIG: "copy it to a disk that takes large files",
    errno.EACCES: "copy it to a folder that can be read and written",
    errno.EPERM: "copy it to a folder that can be read and written",
    errno.EROFS: "copy it to a disk that can be written",
    errno.ENOENT: "check the path",
    errno.ENOTDIR: "check the path",
    errno.ELOOP: "give the path of the file itself and not of a link",
}


NewRecords: TypeAlias = Callable[[], Mapping[str, Mapping[str, str]]]
"""Called only where a new file is written."""


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


def recover(path: Path, new_records: NewRecords = dict) -> Recovered:
    """Repair a bag folder or an `.mcap` file; a whole one stays as it is.

    Whole chunks are kept and the whole messages of a cut one, with their bytes, order and both
    times, and types, channels, QoS and metadata records. Left in the old file is what no bag
    recorded here has: attachments, and definitions in another language than `ros2msg`.
    `new_records` are added to the new file. Raises RecorderError; nothing is then lost.
    """
    try:
        folder, name, in_bag = _find(path)
        with ExitStack() as stack:
            folder_fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
            stack.callback(os.close, folder_fd)
            recovered = _recover_file(folder / name, folder_fd, new_records, in_bag=in_bag)
            if path.is_dir():
                done, hopeless = _recover_evidence(folder, folder_fd)
                recovered = replace(recovered, evidence=tuple(done), hopeless=tuple(hopeless))
            elif is_evidence(name) and recovered.changed:
                put_listing(folder_fd)
            return recovered
    except ForeignError as error:
        raise not_a_bag(path, error) from None
    except OSError as error:
        raise _refused(path, error) from None


def recover_evidence(folder: Path) -> tuple[Recovered, ...]:
    """The recording is left alone."""
    try:
        folder_fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            return tuple(_recover_evidence(folder, folder_fd)[0])
        finally:
            os.close(folder_fd)
    except OSError as error:
        raise _refused(folder, error) from None


def _refused(path: Path, error: OSError) -> RecorderError:
    return RecorderError(
        f"cannot repair {path}: {error.strerror or error}; "
        f"nothing is lost, {_REMEDIES.get(error.errno or 0, 'check the disk')}"
    )


def _find(path: Path) -> tuple[Path, str, bool]:
    if path.is_dir():
        files = _files(path)
        refuse_sqlite(path, files)
        if len(files) > 1:
            raise RecorderError(
                f"{path} holds {len(files)} recordings; repair each of the files, "
                f"then make their {METADATA_FILE} by `ros2 bag reindex`"
            )
        return path, files[0].name, True
    path = Path(os.path.realpath(path))
    refuse_sqlite(path, [path])
    if path.suffix != _SUFFIX:
        path.stat()
        raise ForeignError(f"its name does not end in {_SUFFIX}")
    try:
        in_bag = bag_files(path.parent)[0] == [path]
    except (RecorderError, ForeignError):
        in_bag = False
    return path.parent, path.name, in_bag


def _files(folder: Path) -> list[Path]:
    try:
        return bag_files(folder)[0]
    except ForeignError:
        torn = list(folder.glob(f"*{_SUFFIX}{TORN}"))
        if len(torn) != 1:
            raise
        return [torn[0].with_suffix("")]  # an exchange was cut off, see `put_back`


def _recover_file(
    path: Path, folder_fd: int, new_records: NewRecords = dict, *, in_bag: bool = False
) -> Recovered:
    put_back(folder_fd, path.name)
    with open_file(folder_fd, path.name) as file:
        lock(folder_fd, path.name, file)
        return _repair(path, folder_fd, file, new_records, in_bag=in_bag)


def _recover_evidence(folder: Path, folder_fd: int) -> tuple[list[Recovered], list[str]]:
    """A file with a summary is taken for whole and not read."""
    names = {name.partition(TORN)[0] for name in os.listdir(folder_fd)}
    done: list[Recovered] = []
    hopeless: list[str] = []
    for name in sorted(filter(is_evidence, names), key=natural_order):
        file = folder / name
        if summarised(folder_fd, name) is not None:
            continue
        try:
            done.append(_recover_file(file, folder_fd))
        except ForeignError as error:
            hopeless.append(f"{file} is no evidence: {error}; remove it")
        except RecorderError as error:
            hopeless.append(str(error))
        except OSError as error:
            hopeless.append(str(_refused(file, error)))
    if any(file.changed for file in done):
        put_listing(folder_fd)
    return done, hopeless


def _repair(
    path: Path, folder_fd: int, file: BinaryIO, new_records: NewRecords, *, in_bag: bool
) -> Recovered:
    before = os.fstat(file.fileno())
    survey = Survey.of(file, path)
    information = survey.information()
    part = path.name + _PART
    torn = metadata = None
    with ExitStack() as undo:
        if survey.cut:
            remove(folder_fd, part)
            undo.callback(_give_up, folder_fd, part)
            new = McapFile(folder_fd, part, listed_as=path.name)
            undo.callback(new.close)  # it is locked up to the end
            _write(new, file, survey, new_records())
            _compare(folder_fd, part, path, information)
        listed = listing(folder_fd, information) if in_bag else None
        if listed is not None and (survey.cut or not _described(path.parent, listed)):
            remove(folder_fd, metadata_part())
            undo.callback(_give_up, folder_fd, metadata_part())
            prepare_metadata(folder_fd, listed)
            metadata = path.parent / METADATA_FILE
        after = os.fstat(file.fileno())
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
            raise RecorderError(f"{path} is being written; end its recording, then try again")
        if survey.cut:
            if not (is_evidence(path.name) and survey.only_cut_off):
                torn = path.with_name(keep(folder_fd, path.name))
                os.fsync(folder_fd)
            os.rename(part, path.name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
            os.fsync(folder_fd)
        if metadata is not None:
            if _is_damaged(metadata):
                keep(folder_fd, METADATA_FILE)
            put_metadata(folder_fd)
    return Recovered(path, survey.messages, torn, metadata, tuple(survey.cut), survey.tail_bytes)


def _give_up(folder_fd: int, name: str) -> None:
    with suppress(OSError):
        remove(folder_fd, name)


def _write(
    new: McapFile, file: BinaryIO, survey: Survey, records: Mapping[str, Mapping[str, str]]
) -> None:
    new.start((), records)
    with suppress(DamageError):  # the survey has met it and told it
        for item in read_items(file):
            match item:
                case RawMessage():
                    new.add_message(item)
                case Topic():
                    new.register(item)
                case Metadata() if item.name != ROSBAG2_RECORD:  # it is made anew
                    new.add_record(item.name, item.metadata)
    if survey.lost is not None:
        record = {"problem": survey.lost, "tail_bytes": str(survey.tail_bytes)}
        new.add_record(RECOVERY_RECORD, record)
    new.finish()


def _compare(folder_fd: int, part: str, path: Path, information: BagInformation) -> None:
    with open_file(folder_fd, part) as file:
        again = Survey.of(file, path)
    if again.cut or again.information() != information:
        raise RecorderError(
            f"cannot repair {path}: what was written is not what is read back; "
            "nothing is lost, copy it to another disk"
        )


def _described(folder: Path, information: BagInformation) -> bool:
    try:
        document = bag_information(folder)
        topics = document["topics_with_message_count"]
        told = {topic["topic_metadata"]["name"]: topic["message_count"] for topic in topics}
        files = (information, *information.more)
        counts = sum((Counter(file.counts) for file in files), Counter[str]())
        return (
            document["message_count"] == counts.total()
            and {name: number for name, number in told.items() if number} == counts
            and listed_names(document) == [file.file_name for file in files]
        )
    except (FileNotFoundError, *YAML_PROBLEMS):
        return False


def _is_damaged(metadata: Path) -> bool:
    try:
        bag_information(metadata.parent)
    except FileNotFoundError:
        return False
    except YAML_PROBLEMS:
        return True
    return False
