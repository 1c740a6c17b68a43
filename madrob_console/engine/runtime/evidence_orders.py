"""What the engine orders the evidence process to do."""

from __future__ import annotations

import msgspec

from madrob_console.engine.runtime.evidence_client import EvidencePlace
from madrob_console.testbeds.evidence_choice import EvidenceChoice


class ListenFor(msgspec.Struct, frozen=True, tag=True):
    """Order to listen to topics from now on; the engine itself records `own_topics`."""

    domain: int
    choice: EvidenceChoice
    own_topics: tuple[str, ...]
    ros_args: tuple[str, ...]


class RecordInto(msgspec.Struct, frozen=True, tag=True):
    """Order to record into a new file; `number` is that of the recording, `file` of its file."""

    number: int
    file: int
    place: EvidencePlace


class FinishFile(msgspec.Struct, frozen=True, tag=True):
    """Order to finish the file: the recording is over."""


class LeaveDisk(msgspec.Struct, frozen=True, tag=True):
    """Whether scoring waits for the disk: nothing is written meanwhile."""

    held: bool


EvidenceOrder = ListenFor | RecordInto | FinishFile | LeaveDisk
