"""What the engine orders the evidence process to do."""

from __future__ import annotations

import msgspec

from madrob_console.engine.runtime.evidence_client import EvidencePlace
from madrob_console.testbeds.evidence_choice import EvidenceChoice


class RecordInto(msgspec.Struct, frozen=True):
    """A new file of evidence; `number` is that of the recording, `file` of its file."""

    number: int
    file: int
    place: EvidencePlace


class EvidenceOrder(msgspec.Struct, frozen=True):
    """What the process does from now on; each order replaces the one before.

    Attributes:
        domain, choice, ros_args: where it listens to which topics; the same in all orders.
        own_topics: those that the engine itself records; likewise.
        recording: the file to record into; None = none, and the last one is finished.
        held: whether scoring waits for the disk: nothing is written meanwhile.
    """

    domain: int
    choice: EvidenceChoice
    own_topics: tuple[str, ...]
    ros_args: tuple[str, ...]
    recording: RecordInto | None = None
    held: bool = False
