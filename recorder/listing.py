"""Writes `metadata.yaml` of a bag of several files: the recording first, then its evidence.

It lists what a reader can open. Evidence that is still written, was cut off or is damaged is
left out until it is whole, because readers refuse a bag with a file that they cannot open.
"""

from __future__ import annotations

import os
import re
import threading
from collections import Counter
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace

from recorder.bag import MAX_NS, METADATA_FILE, YAML_PROBLEMS, BagInformation, is_evidence
from recorder.catalogue import read_outline
from recorder.mcap_reader import DamageError
from recorder.reader import (
    METADATA_LIMIT,
    information_in,
    listed_names,
    natural_order,
    open_recording,
)

_SUFFIX = ".mcap"
_PART = re.compile(rf"{re.escape(METADATA_FILE)}\.([0-9]+)\.part")
_GOES = 100
"""The most tries to list again; each needs a file that came or went meanwhile."""


def put_listing(folder_fd: int, recording: BagInformation | None = None) -> BagInformation | None:
    """List all files of a bag in its `metadata.yaml`; on disk on return.

    Call it after a file of the bag was finished, repaired or removed. Several processes may do
    so at once without a lock: the last one looks once more, so all is listed. None = the
    recording is unfinished: who finishes or repairs it lists all.
    """
    listed = listing(folder_fd, recording)
    for _ in range(_GOES):
        if listed is None:
            break
        write_metadata(folder_fd, listed)
        before, listed = listed, listing(folder_fd, recording)
        if listed == before:
            break
    return listed


def listing(
    folder_fd: int, recording: BagInformation | None = None, without: Collection[str] = ()
) -> BagInformation | None:
    """What `put_listing` would write, but for the evidence `without`; reads no message."""
    names = [name for name in os.listdir(folder_fd) if name.endswith(_SUFFIX)]
    evidence = sorted(filter(is_evidence, names), key=natural_order)
    if recording is None:
        others = sorted(set(names).difference(evidence), key=natural_order)
        recordings = [summarised(folder_fd, name) for name in _listed_names(folder_fd) or others]
    else:
        recordings = [recording]
    files = [file for file in recordings if file is not None]
    if not files or len(files) < len(recordings):
        return None
    evidence_files = [summarised(folder_fd, name) for name in evidence if name not in without]
    return replace(
        files[0], more=(*files[1:], *(file for file in evidence_files if file is not None))
    )


def _listed_names(folder_fd: int) -> list[str]:
    try:
        with open_recording(METADATA_FILE, folder_fd) as file:
            names = listed_names(information_in(file.read(METADATA_LIMIT)))
    except (DamageError, OSError, *YAML_PROBLEMS):
        return []
    return [name for name in names if not is_evidence(name)]


def summarised(folder_fd: int, name: str) -> BagInformation | None:
    try:
        with open_recording(name, folder_fd) as file:
            catalogue = read_outline(file)
        topics, statistics = catalogue.topics(), catalogue.statistics
        assert statistics is not None
        counts = Counter[str]()
        for channel, number in statistics.channel_message_counts.items():
            counts[catalogue.topic(channel).name] += number
    except (DamageError, OSError):
        return None
    if not counts.total():
        return BagInformation(name, topics, {}, None, None)
    start_ns, end_ns = statistics.message_start_time, statistics.message_end_time
    if not start_ns <= end_ns < MAX_NS:
        return None
    return BagInformation(name, topics, counts, start_ns, end_ns)


def write_metadata(folder_fd: int, information: BagInformation) -> None:
    """Replace `metadata.yaml`, on disk on return; a crash leaves one or the other."""
    part = f"{METADATA_FILE}.{threading.get_native_id()}.part"  # no reader looks at it
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with os.fdopen(
            os.open(part, flags, 0o666, dir_fd=folder_fd), "w", encoding="utf-8"
        ) as file:
            file.write(information.metadata_yaml())
            file.flush()
            os.fsync(file.fileno())
        os.rename(part, METADATA_FILE, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        os.fsync(folder_fd)
    except OSError:
        remove(folder_fd, part)
        raise


def remove_metadata_parts(folder_fd: int) -> None:
    """Remove stale temporary files of `metadata.yaml`; each names its writer's thread."""
    for name in os.listdir(folder_fd):
        part = _PART.fullmatch(name)
        if part is not None and not os.path.exists(f"/proc/{part[1]}"):  # noqa: PTH110
            remove(folder_fd, name)


def remove(folder_fd: int, name: str) -> None:
    """Errors are ignored: the next create fails instead."""
    with suppress(OSError):
        os.unlink(name, dir_fd=folder_fd)
