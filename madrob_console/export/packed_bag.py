"""What of a run's bag is packed: its evidence is large and not always wanted."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Self

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.export.zip_file import Archive
from madrob_console.files.bounded import stamp_of
from recorder.bag import METADATA_FILE, is_evidence, is_left_of_evidence
from recorder.listing import listing


@dataclass(frozen=True, slots=True)
class BagParts:
    """Which parts of bags are packed.

    Attributes:
        recording: what is scored; without it a bag is none, and is left out.
        evidence: cameras and other topics.
    """

    recording: bool = True
    evidence: bool = True


WHOLE_BAGS = BagParts()


@dataclass(frozen=True, slots=True)
class PackedBag:
    """A bag as it is packed.

    Attributes:
        without: whether a file of this name of the run's folder is left out.
        metadata: the `metadata.yaml` of what is packed; None = that of the folder is.
        evidence_left_out: whether the run has evidence that nobody wants packed.
        problems: what evidence is left out that should be there and why, in words.
    """

    without: Callable[[str], bool]
    metadata: str | None = None
    evidence_left_out: bool = False
    problems: tuple[str, ...] = ()

    def has(self, name: str) -> bool:
        """Whether a file of this name of the run's folder is packed, if it is there."""
        return not self.without(name) or (name == METADATA_FILE and self.metadata is not None)

    @classmethod
    def of(cls, run: Path, parts: BagParts) -> Self:
        """What is packed of a run; evidence that nobody could open is not."""
        try:
            return cls._of(run, parts)
        except OSError:  # what cannot be read is named when it is packed
            return cls(lambda _name: False)

    @classmethod
    def _of(cls, run: Path, parts: BagParts) -> Self:
        names = os.listdir(run)  # noqa: PTH208  of the names only
        # a file that was made just before a power cut holds nothing
        evidence = {name for name in filter(is_evidence, names) if (run / name).lstat().st_size}
        if not parts.recording:
            return cls(
                lambda name: ".mcap" in name or METADATA_FILE in name,
                evidence_left_out=bool(evidence),
            )
        if not any(map(is_left_of_evidence, names)):
            return cls(lambda _name: False)
        folder_fd = os.open(run, os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            listed = listing(folder_fd, None, () if parts.evidence else evidence)
        finally:
            os.close(folder_fd)
        if listed is None:  # the recording is torn: then no evidence is listed
            return cls(
                is_left_of_evidence,
                evidence_left_out=not parts.evidence,
                problems=_not_whole(evidence) if parts.evidence else (),
            )
        packed = {file.file_name for file in listed.more}

        def without(name: str) -> bool:
            return name == METADATA_FILE or (is_left_of_evidence(name) and name not in packed)

        lost = _not_whole(evidence - packed) if parts.evidence else ()
        return cls(without, listed.metadata_yaml(), bool(evidence - packed), lost)


def _not_whole(evidence: Iterable[str]) -> tuple[str, ...]:
    words = "is evidence that is not whole: `madrob recover` repairs it, then export again"
    return tuple(f"{name}: {words}" for name in sorted(evidence))


def add_run(
    archive: Archive,
    run: Path,
    called: str,
    bag: PackedBag,
    instead: Mapping[str, bytes] = MappingProxyType({}),
) -> list[str]:
    """Add the folder of a run, with its bag as it is packed.

    Args:
        archive: takes it.
        run: the folder.
        called: its name in the archive.
        bag: what is packed of its bag.
        instead: what is packed in place of a file of it, by name; its report only so.

    Returns:
        The names of the files that are in the archive now.

    Raises:
        OSError: the archive cannot be written.
    """
    instead = {f"{called}/{name}": data for name, data in instead.items()}

    def without(name: str) -> bool:  # anybody may have written the report in the folder
        unmade = name == REPORT_FILE and f"{called}/{name}" not in instead
        return unmade or bag.without(name)

    added = archive.add_folder(run, called, without=without, instead=instead)
    archive.problems += [f"{called}/{problem}" for problem in bag.problems]
    if bag.metadata is not None:
        name, stamp = f"{called}/{METADATA_FILE}", stamp_of(str(run / METADATA_FILE))
        archive.add(name, bag.metadata.encode(), 0.0 if stamp is None else stamp.modified / 1e9)
        added.append(name)
    return added


def size_of(run: Path, bag: PackedBag) -> tuple[int, int]:
    """Bytes of the files of a run that are packed, and how many of these are evidence."""
    total = evidence = 0
    for path, _, names in os.walk(run):
        for name in names:
            if bag.without(name) or name.startswith("."):
                continue
            try:
                size = Path(path, name).lstat().st_size
            except OSError:
                continue
            total += size
            evidence += size if is_evidence(name) else 0
    return total, evidence
