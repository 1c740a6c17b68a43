"""`metadata.yaml` of a bag of several files: the recording first, then its evidence.

Listed is what a reader can open: evidence that is still written, was cut off or is damaged is left
out until it is whole, since readers refuse a bag of which they cannot open a file.
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
from recorder.catalogue import Catalogue
from recorder.mcap_stream import DamageError, read_summary
from recorder.reader import METADATA_LIMIT, information_in, listed_names, natural_order
from recorder.torn_file import open_file

_SUFFIX = ".mcap"
_PART = re.compile(rf"{re.escape(METADATA_FILE)}\.[0-9]+\.part")
_GOES = 100
"""Of listing again; each needs a file that came or went meanwhile."""


def put_listing(
    folder_fd: int, recording: BagInformation | None = None, without: Collection[str] = ()
) -> BagInformation | None:
    """List all files of a bag in its `metadata.yaml`; on the disk on return.

    Whoever has finished, repaired or removed a file of the bag calls it then. Several processes
    may do so at once and wait for nobody: who was last looks once more, so all is listed.

    Args:
        folder_fd: the open bag folder.
        recording: what is known of the bag's one recording; without it, its summary tells.
        without: evidence that is not to be listed, because it is about to be removed.

    Returns:
        What is listed; None if the recording is unfinished: who finishes or repairs it lists all.

    Raises:
        OSError: the disk refuses.
    """
    listed = listing(folder_fd, recording, without)
    for _ in range(_GOES):
        if listed is None:
            break
        try:
            prepare_metadata(folder_fd, listed)
            put_metadata(folder_fd)
        except OSError:
            with suppress(OSError):
                os.unlink(metadata_part(), dir_fd=folder_fd)
            raise
        before, listed = listed, listing(folder_fd, recording, without)
        if listed == before:
            break
    return listed


def listing(
    folder_fd: int, recording: BagInformation | None = None, without: Collection[str] = ()
) -> BagInformation | None:
    """What `put_listing` would write, by the summaries of the files; reads no message.

    Raises:
        OSError: the folder cannot be read.
    """
    names = [name for name in os.listdir(folder_fd) if name.endswith(_SUFFIX)]
    evidence = sorted(filter(is_evidence, names), key=natural_order)
    if recording is None:
        others = sorted(set(names).difference(evidence), key=natural_order)
        known = [summarised(folder_fd, name) for name in _told(folder_fd) or others]
    else:
        known = [recording]
    files = [file for file in known if file is not None]
    if not files or len(files) < len(known):
        return None
    found = [summarised(folder_fd, name) for name in evidence if name not in without]
    listed = replace(files[0], more=(*files[1:], *(file for file in found if file is not None)))
    while len(listed.more) >= len(files) and not _is_readable(listed):
        listed = replace(listed, more=listed.more[:-1])
    return listed


def _told(folder_fd: int) -> list[str]:
    """The recordings of a bag by its `metadata.yaml`: a copy that lies beside them is none."""
    try:
        with open_file(folder_fd, METADATA_FILE) as file:
            names = listed_names(information_in(file.read(METADATA_LIMIT)))
    except (DamageError, OSError, *YAML_PROBLEMS):
        return []
    return [name for name in names if not is_evidence(name)]


def _is_readable(listed: BagInformation) -> bool:
    """Whether readers here take what is listed: evidence may have topics without end."""
    text = listed.metadata_yaml().encode()
    try:
        return len(text) <= METADATA_LIMIT and bool(information_in(text))
    except YAML_PROBLEMS:
        return False


def summarised(folder_fd: int, name: str) -> BagInformation | None:
    """What a file's summary says of it; None for one that no reader can open as it is."""
    try:
        with open_file(folder_fd, name) as file:
            catalogue = Catalogue(read_summary(file))
        topics, statistics = catalogue.topics(), catalogue.statistics
        if statistics is None or not catalogue.whole:
            return None
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


def metadata_part() -> str:
    """The name of `metadata.yaml` before it is whole, another for each who writes one.

    No reader looks at it.
    """
    return f"{METADATA_FILE}.{threading.get_native_id()}.part"


def remove_metadata_parts(folder_fd: int) -> None:
    """Remove what killed writers of `metadata.yaml` have left; nobody may write one now.

    Raises:
        OSError: the disk refuses.
    """
    for name in filter(_PART.fullmatch, os.listdir(folder_fd)):
        os.unlink(name, dir_fd=folder_fd)


def prepare_metadata(folder_fd: int, information: BagInformation) -> None:
    """Write the next `metadata.yaml` beside the one that stands; on the disk on return.

    Raises:
        OSError: the disk refuses.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    fd = os.open(metadata_part(), flags, 0o666, dir_fd=folder_fd)
    with os.fdopen(fd, "w", encoding="utf-8") as file:
        file.write(information.metadata_yaml())
        file.flush()
        os.fsync(file.fileno())


def put_metadata(folder_fd: int) -> None:
    """Make the prepared `metadata.yaml` the one that counts; after a crash it is either of them.

    Raises:
        OSError: the disk refuses.
    """
    os.rename(metadata_part(), METADATA_FILE, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
    os.fsync(folder_fd)
