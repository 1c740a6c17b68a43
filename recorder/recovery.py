"""Repair a bag that was cut off or damaged: the same messages in a file that every reader takes.

The new file is written beside the old one, read back, and takes its name in one step; the old one
stays as `NAME.mcap.torn`. A kill at any moment leaves the old file or the new one under the name,
and the old one in any case; to repair again is harmless.

Of evidence that was only cut off the old file goes: the new one has every whole message of it, and
it would take the same room once more.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import BinaryIO

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
from recorder.listing import listing, put_listing, remove, remove_metadata_parts, summarised
from recorder.mcap_file import ROSBAG2_RECORD, McapFile
from recorder.mcap_reader import ChunkEnd, DamageError, ForeignError
from recorder.reader import (
    RECOVERY_RECORD,
    bag_files,
    bag_information,
    listed_names,
    natural_order,
    not_a_bag,
    open_recording,
    read_items,
    refuse_sqlite,
)
from recorder.survey import Survey

_SUFFIX = ".mcap"
_PART = ".recovering"
_TORN = ".torn"

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


def recover(path: Path) -> Recovered:
    """Repair a bag folder or an `.mcap` file; a whole one stays as it is.

    Whole chunks are kept and the whole messages of a cut one, with their bytes, order and both
    times, and types, channels, QoS and metadata records. Left in the old file is what no bag
    recorded here has: attachments, and definitions in another language than `ros2msg`.
    Raises RecorderError; nothing is then lost.
    """
    try:
        file, is_alone = _recording_at(path)
        with ExitStack() as stack:
            folder_fd = _open_folder(file.parent, stack)
            remove_metadata_parts(folder_fd)
            recovered, information = _recover_file(file, folder_fd)
            if is_alone:
                is_listed = _is_listed(file.parent, folder_fd, information)
                if recovered.cut or not is_listed:
                    put_listing(folder_fd, information)
                    recovered = replace(recovered, metadata=file.parent / METADATA_FILE)
            elif is_evidence(file.name) and recovered.cut:
                put_listing(folder_fd)
            if path.is_dir():
                done, hopeless = _recover_evidence(path, folder_fd)
                recovered = replace(recovered, evidence=done, hopeless=hopeless)
            return recovered
    except ForeignError as error:
        raise not_a_bag(path, error) from None
    except OSError as error:
        raise _refused(path, error) from None


def recover_evidence(folder: Path) -> tuple[Recovered, ...]:
    """The recording is left alone."""
    try:
        with ExitStack() as stack:
            folder_fd = _open_folder(folder, stack)
            return _recover_evidence(folder, folder_fd)[0]
    except OSError as error:
        raise _refused(folder, error) from None


def _refused(path: Path, error: OSError) -> RecorderError:
    return RecorderError(
        f"cannot repair {path}: {error.strerror or error}; "
        f"nothing is lost, {_REMEDIES.get(error.errno or 0, 'check the disk')}"
    )


def _open_folder(folder: Path, stack: ExitStack) -> int:
    folder_fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    stack.callback(os.close, folder_fd)
    return folder_fd


def _recording_at(path: Path) -> tuple[Path, bool]:
    """The recording, and whether it is all that its folder has beside evidence."""
    if path.is_dir():
        files = _files(path)
        refuse_sqlite(path, files)
        if len(files) > 1:
            raise RecorderError(
                f"{path} holds {len(files)} recordings; repair each of the files, "
                f"then make their {METADATA_FILE} by `ros2 bag reindex`"
            )
        return path / files[0].name, True
    path = Path(os.path.realpath(path))
    refuse_sqlite(path, [path])
    if path.suffix != _SUFFIX:
        path.stat()
        raise ForeignError(f"its name does not end in {_SUFFIX}")
    with suppress(RecorderError, ForeignError):
        return path, bag_files(path.parent)[0] == [path]
    return path, False


def _files(folder: Path) -> list[Path]:
    try:
        return bag_files(folder)[0]
    except ForeignError:
        torn = list(folder.glob(f"*{_SUFFIX}{_TORN}"))
        if len(torn) != 1:
            raise
        return [torn[0].with_suffix("")]  # an exchange was cut off, see `_put_back`


def _recover_evidence(
    folder: Path, folder_fd: int
) -> tuple[tuple[Recovered, ...], tuple[str, ...]]:
    """A file with a summary is taken for whole and not read."""
    names = {name.partition(_TORN)[0] for name in os.listdir(folder_fd)}
    done: list[Recovered] = []
    hopeless: list[str] = []
    for name in sorted(filter(is_evidence, names), key=natural_order):
        if summarised(folder_fd, name) is not None:
            continue
        try:
            done.append(_recover_file(folder / name, folder_fd)[0])
        except ForeignError as error:
            hopeless.append(f"{folder / name} is no evidence: {error}; remove it")
        except RecorderError as error:
            hopeless.append(str(error))
        except OSError as error:
            hopeless.append(str(_refused(folder / name, error)))
    if any(file.cut for file in done):
        put_listing(folder_fd)
    return tuple(done), tuple(hopeless)


def _recover_file(path: Path, folder_fd: int) -> tuple[Recovered, BagInformation]:
    name, torn = path.name, None
    _put_back(folder_fd, name)
    with open_recording(name, folder_fd) as file:
        _lock(folder_fd, name, file)
        before = os.fstat(file.fileno())
        survey = Survey.of(file, path)
        information = survey.information()
        if survey.cut:
            with ExitStack() as undo:
                undo.callback(remove, folder_fd, name + _PART)
                remove(folder_fd, name + _PART)
                new = McapFile(folder_fd, name + _PART, listed_as=name)
                undo.callback(new.close)  # it is locked up to the end
                _write(new, file, survey)
                _compare(folder_fd, path, information)
                after = os.fstat(file.fileno())
                if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
                    raise RecorderError(
                        f"{path} is being written; end its recording, then try again"
                    )
                if not (is_evidence(name) and survey.only_cut_off):
                    torn = path.with_name(_keep(folder_fd, name))
                    os.fsync(folder_fd)
                os.rename(name + _PART, name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
                os.fsync(folder_fd)
    cut = tuple(survey.cut)
    return Recovered(path, survey.messages, torn, None, cut, survey.tail_bytes), information


def _write(new: McapFile, file: BinaryIO, survey: Survey) -> None:
    new.start((), {})
    with suppress(DamageError):  # the survey has met it and told it
        for item in read_items(file):
            match item:
                case RawMessage():
                    new.add_message(item)
                case ChunkEnd():
                    new.end_chunk()
                case Topic():
                    new.register(item)
                case Metadata() if item.name != ROSBAG2_RECORD:  # it is made anew
                    new.add_record(item.name, item.metadata)
    if survey.lost is not None:
        record = {"problem": survey.lost, "tail_bytes": str(survey.tail_bytes)}
        new.add_record(RECOVERY_RECORD, record)
    new.finish()


def _compare(folder_fd: int, path: Path, information: BagInformation) -> None:
    with open_recording(path.name + _PART, folder_fd) as file:
        again = Survey.of(file, path)
    if again.cut or again.information() != information:
        raise RecorderError(
            f"cannot repair {path}: what was written is not what is read back; "
            "nothing is lost, copy it to another disk"
        )


def _is_listed(folder: Path, folder_fd: int, information: BagInformation) -> bool:
    """Whether `metadata.yaml` tells what is there; a damaged one is kept under a second name."""
    listed = listing(folder_fd, information) or information
    files = (listed, *listed.more)
    counts = sum((Counter(file.counts) for file in files), Counter[str]())
    try:
        document = bag_information(folder)
        topics = document["topics_with_message_count"]
        counted = {topic["topic_metadata"]["name"]: topic["message_count"] for topic in topics}
        return (
            document["message_count"] == counts.total()
            and {name: number for name, number in counted.items() if number} == counts
            and listed_names(document) == [file.file_name for file in files]
        )
    except FileNotFoundError:
        return False
    except YAML_PROBLEMS:
        _keep(folder_fd, METADATA_FILE)
        return False


_NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK}


def _lock(folder_fd: int, name: str, file: BinaryIO) -> None:
    """Lock a file against recording and repair until it is closed; RecorderError if locked."""
    busy = RecorderError(f"{name} is being written; end its recording or repair, then try again")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise busy from None
    except OSError:
        pass  # not every network disk has locks
    if not _is_named(folder_fd, name, os.fstat(file.fileno())):
        raise busy  # a repair has just ended


def _keep(folder_fd: int, name: str) -> str:
    """Give a file a second name, `NAME.torn`; where a disk has no hard links, a new name."""
    info = os.stat(name, dir_fd=folder_fd, follow_symlinks=False)
    for number in count(1):
        torn_name = _torn_name(name, number)
        if _is_named(folder_fd, torn_name, info):
            return torn_name  # an earlier repair was ended here
        if _exists(folder_fd, torn_name):
            continue
        try:
            os.link(
                name, torn_name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd, follow_symlinks=False
            )
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            os.rename(name, torn_name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        return torn_name
    raise AssertionError


def _put_back(folder_fd: int, name: str) -> None:
    """Undo the first half of an exchange that was cut off, on a disk without hard links.

    RecorderError if the exchange is going on.
    """
    if _exists(folder_fd, name) or not _exists(folder_fd, _torn_name(name, 1)):
        return
    last = next(n for n in count(1) if not _exists(folder_fd, _torn_name(name, n + 1)))
    torn_name = _torn_name(name, last)
    with open_recording(torn_name, folder_fd) as file:
        _lock(folder_fd, torn_name, file)
        if not _exists(folder_fd, name):
            os.rename(torn_name, name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)


def _torn_name(name: str, number: int) -> str:
    return name + _TORN + (f".{number}" if number > 1 else "")


def _exists(folder_fd: int, name: str) -> bool:
    try:
        os.stat(name, dir_fd=folder_fd, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


def _is_named(folder_fd: int, name: str, info: os.stat_result) -> bool:
    try:
        return os.path.samestat(os.stat(name, dir_fd=folder_fd, follow_symlinks=False), info)
    except FileNotFoundError:
        return False
