"""What crosses the line between an engine and the process that records evidence.

Frames as those of screens (`engine/shown/wire.py`); with `RecordInto` comes the handle of a folder.
"""

from __future__ import annotations

import msgspec

from madrob_console.engine.process.evidence_recorder import EvidenceWritten
from madrob_console.engine.shown.wire import decoded
from madrob_console.testbeds.evidence_choice import EvidenceChoice
from madrob_console.testbeds.evidence_flow import TopicFlow


class ListenFor(msgspec.Struct, frozen=True, tag=True):
    """Listen from now on.

    Attributes:
        domain: ROS domain.
        choice: to which topics.
        own_topics: those that the engine records, as the settings name them.
        ros_args: what a launch file says of their names.
    """

    domain: int
    choice: EvidenceChoice
    own_topics: tuple[str, ...]
    ros_args: tuple[str, ...]


class RecordInto(msgspec.Struct, frozen=True, tag=True):
    """RecordInto from now on into a new file of the folder whose handle comes with it.

    Attributes:
        number: of the recording.
        file_name: in the folder.
        steady_ns: steady time, as the engine has it.
        monotonic_ns: the machine's monotonic time at that moment.
        most_bytes, least_free: see `EvidenceRecorder`.
    """

    number: int
    file_name: str
    steady_ns: int
    monotonic_ns: int
    most_bytes: int
    least_free: int


class FinishFile(msgspec.Struct, frozen=True, tag=True):
    """The recording is over; finish the file."""

    number: int


class LeaveDisk(msgspec.Struct, frozen=True, tag=True):
    """Whether the score waits for the disk: nothing is written then."""

    held: bool


class EvidenceNews(msgspec.Struct, frozen=True, tag=True):
    """How things stand, told twice a second and when a recording ends.

    Attributes:
        settled: whether all topics are connected, as far as can be told.
        flows: what comes.
        left_over, unseen, scored: see `EvidenceIntakes`.
        recordings: by their numbers: what is being recorded, and what was and is being finished.
        left_out, too_large, lost: by topic, of the recording that is going on or was last:
            messages left out on purpose, larger than is recorded, lost on the way.
        problem: why nothing is heard, in words; empty = it is.
    """

    settled: bool = False
    flows: tuple[TopicFlow, ...] = ()
    left_over: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    scored: tuple[str, ...] = ()
    recordings: dict[int, EvidenceWritten] = {}
    left_out: dict[str, int] = {}
    too_large: dict[str, int] = {}
    lost: dict[str, int] = {}
    problem: str = ""


ToEvidence = ListenFor | RecordInto | FinishFile | LeaveDisk

_orders: msgspec.msgpack.Decoder[ToEvidence] = msgspec.msgpack.Decoder(ToEvidence)
_told: msgspec.msgpack.Decoder[EvidenceNews] = msgspec.msgpack.Decoder(EvidenceNews)


def order_of(data: bytes) -> ToEvidence:
    """A message of the engine."""
    return _orders.decode(data)


def news_of(data: bytes) -> EvidenceNews:
    """A message of the process.

    Raises:
        MadrobError: it is something else.
    """
    return decoded(_told, data, "a message of the process that records evidence")
