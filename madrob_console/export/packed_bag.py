"""The files of a bag that are packed: evidence is large and not always wanted."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from madrob_console.archive.run_journal import evidence_removed
from madrob_console.common.plain_files import opened_folder, stamp_of
from recorder.bag import METADATA_FILE, is_evidence, is_left_of_evidence
from recorder.evidence import listing


@dataclass(frozen=True, slots=True)
class BagParts:
    """Parts of bags to pack: the scored recording, without which a bag is left out; evidence.

    Evidence is cameras and other topics.
    """

    recording: bool = True
    evidence: bool = True


WHOLE_BAGS = BagParts()

_TORN = "is evidence that is not whole: `madrob recover` repairs it, then export again"


@dataclass(frozen=True, slots=True)
class PackedBag:
    """A bag as it is packed.

    Attributes:
        without: whether a file of this name of the run's folder is left out.
        written: the `metadata.yaml` of what is packed, where it is not the folder's.
        has_evidence: whether there is some, packed or not.
        problems: evidence that is missing and why, in words.
    """

    without: Callable[[str], bool]
    written: Mapping[str, bytes] = field(default_factory=dict)
    has_evidence: bool = False
    problems: tuple[str, ...] = ()

    @classmethod
    def of(cls, run: Path, parts: BagParts) -> Self:
        """Evidence that nobody could open is not packed."""
        with suppress(OSError):  # what cannot be read is named when it is packed
            names = os.listdir(run)  # noqa: PTH208  of the names only
            # a file that was made just before a power cut holds nothing
            evidence = {name for name in filter(is_evidence, names) if (run / name).lstat().st_size}
            if not parts.recording:
                return cls(
                    lambda name: ".mcap" in name or METADATA_FILE in name,
                    has_evidence=bool(evidence),
                )
            if any(map(is_left_of_evidence, names)):
                with opened_folder(run) as folder_fd:
                    listed_bag = listing(folder_fd, None, () if parts.evidence else evidence)
                # without a listing the recording is torn: then no evidence is listed
                listed = () if listed_bag is None else listed_bag.more
                packed = {file.file_name for file in listed}
                torn = sorted(evidence - packed) if parts.evidence else ()
                return cls(
                    lambda name: is_left_of_evidence(name) and name not in packed,
                    {}
                    if listed_bag is None
                    else {METADATA_FILE: listed_bag.metadata_yaml().encode()},
                    bool(evidence),
                    tuple(f"{name}: {_TORN}" for name in torn),
                )
        return cls(lambda _name: False)


def size_of(run: Path, bag: PackedBag) -> tuple[int, int]:
    """Bytes of a run's packed files, and how many of these are evidence."""
    total = evidence = 0
    for path in run.rglob("[!.]*"):
        if not bag.without(path.name) and (stamp := stamp_of(str(path))) is not None:
            total += stamp.size
            evidence += stamp.size if is_evidence(path.name) else 0
    return total, evidence


def evidence_left_out(bags: Mapping[Path, PackedBag], parts: BagParts) -> list[str]:
    """The files that were left out on purpose, in words."""
    words = [] if parts.recording else ["the recording was left out on demand"]
    if parts != WHOLE_BAGS and any(bag.has_evidence for bag in bags.values()):
        words.append("the evidence was left out on demand")
    gone = ((run, evidence_removed(run)) for run in bags)
    return words + [f"{run.name}: its evidence was {removed}" for run, removed in gone if removed]
