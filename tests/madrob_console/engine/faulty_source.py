"""A testbed whose topics can be spoiled while it runs: what sensors and publishers do wrong."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum

import numpy as np

from madrob_console.clock import NS, Clock
from madrob_console.testbeds.message_types import Message
from madrob_console.testbeds.messages import MessageTypes, encode_text
from madrob_console.testbeds.simulated import SimulatedSource
from madrob_console.testbeds.source import RefereeState, SourceKind, TopicStatus
from recorder.bag import Topic
from recorder.message import RawMessage
from scoring.protocol import Condition, StartPose

DOOR = "/madrob/door/angle"
HANDLE = "/madrob/handle/force"
STRIP = "/madrob/passage/cw_right"
PERIOD_NS = 20_000_000
"""Between two messages of a simulated topic."""

Spoil = Callable[[RawMessage], list[RawMessage]]
"""What a publisher sends instead of a message; it may lie in the future."""
Edit = Callable[[Message], None]

STRING = "std_msgs/msg/String"
TYPES = MessageTypes()


class Fault(StrEnum):
    """What can be wrong with a topic."""

    DIES = "dies"
    SLOWS = "slows to 5 Hz"
    CRAWLS = "slows to 0.4 Hz"
    FLOODS = "floods with 1500 Hz"
    REPEATS_STAMPS = "repeats one stamp"
    STEPS_BACK = "steps back by 0.3 s, once"
    STRAYS_BACK = "one stamp is 0.3 s old"
    STEPS_BACK_FAR = "steps back by 5 s, once"
    STEPS_BACK_AGAIN = "steps back by 0.3 s, every second"
    STEPS_BACK_FAR_AGAIN = "steps back by 5 s, every second"
    JUMPS_TO_AND_FRO = "every other stamp is 5 s ahead"
    AHEAD = "stamps 5 s ahead"
    BEHIND = "stamps 5 s behind"
    ZERO_STAMPS = "stamps zero"
    NAN = "NaN"
    PLUS_INFINITY = "+inf"
    MINUS_INFINITY = "-inf"
    EMPTY = "empty arrays"
    OUT_OF_RANGE = "out of range"
    ENORMOUS = "enormous numbers"
    OTHER_TYPE = "another type"
    TWO_PUBLISHERS = "two publishers"
    TRUNCATED = "truncated"
    NOTHING_INSIDE = "no bytes"
    HUGE_LENGTH = "claims 2 GB"


class FaultySource:
    """A simulated testbed, honest until told otherwise.

    Attributes:
        handed: every message handed to the engine, in order.
    """

    def __init__(self, source: SimulatedSource, clock: Clock) -> None:
        self.handed: list[RawMessage] = []
        self._source = source
        self._clock = clock
        self._spoils: dict[str, Spoil] = {}
        self._publishers: dict[str, int] = {}
        self._coming: list[RawMessage] = []

    def spoil(self, topic: str, fault: Fault) -> None:
        """From now on `topic` is faulty."""
        self._publishers[topic] = 2 if fault is Fault.TWO_PUBLISHERS else 1
        self._spoils[topic] = spoiler(topic, fault)

    def fake(self, topic: str, edit: Edit) -> None:
        """From now on `topic` says something else."""
        self._spoils[topic] = lambda message: [edited(message, edit)]

    def heal(self, topic: str) -> None:
        """From now on `topic` is honest again."""
        self._spoils.pop(topic, None)
        self._publishers.pop(topic, None)

    def take(self, timeout: float) -> list[RawMessage]:
        for message in self._source.take(timeout):
            spoil = self._spoils.get(message.topic)
            self._coming += [message] if spoil is None else spoil(message)
        self._coming.sort(key=lambda message: message.receive_ns)
        now = self._clock.now_ns()
        taken = [m for m in self._coming if m.receive_ns <= now]
        self._coming = self._coming[len(taken) :]
        self.handed += taken
        return taken

    def status(self) -> Sequence[TopicStatus]:
        return tuple(self._spoiled_status(s) for s in self._source.status())

    def _spoiled_status(self, status: TopicStatus) -> TopicStatus:
        publishers = self._publishers.get(status.topic, status.publishers)
        return replace(status, publishers=publishers, lost=None if publishers > 1 else 0)

    @property
    def kind(self) -> SourceKind:
        return self._source.kind

    @property
    def label(self) -> str:
        return self._source.label

    @property
    def ended(self) -> bool:
        return self._source.ended

    @property
    def sides_problem(self) -> str | None:
        return self._source.sides_problem

    def open(self) -> None:
        self._source.open()

    def topics(self) -> Sequence[Topic]:
        return self._source.topics()

    def configure(self, condition: Condition) -> None:
        self._source.configure(condition)

    def announce_state(self, state: RefereeState) -> list[RawMessage]:
        return self._source.announce_state(state)

    def announce_event(self, text: str) -> list[RawMessage]:
        return self._source.announce_event(text)

    def announce_start_pose(self, pose: StartPose) -> list[RawMessage]:
        return self._source.announce_start_pose(pose)

    def close(self) -> None:
        self._source.close()


def spoiler(topic: str, fault: Fault) -> Spoil:
    """A publisher of `topic` with this fault."""
    match fault:
        case Fault.DIES:
            return lambda _: []
        case Fault.SLOWS:
            return _Every(10)
        case Fault.CRAWLS:
            return _Every(125)
        case Fault.FLOODS:
            return lambda message: [
                restamped(message, k * PERIOD_NS // 30, late=True) for k in range(30)
            ]
        case Fault.TWO_PUBLISHERS:
            return lambda message: [message, another(message, topic)]
        case Fault.OTHER_TYPE:
            other = encode_text(TYPES, "not what you expect")
            return lambda message: [replace(message, type=STRING, data=other)]
        case Fault.TRUNCATED:
            return lambda message: [replace(message, data=message.data[: len(message.data) // 2])]
        case Fault.NOTHING_INSIDE:
            return lambda message: [replace(message, data=b"")]
        case Fault.HUGE_LENGTH:
            return lambda message: [replace(message, data=with_length(message.data, 2**31 - 1))]
        case Fault.NAN | Fault.PLUS_INFINITY | Fault.MINUS_INFINITY | Fault.EMPTY:
            return _edit_with(_VALUES[fault])
        case Fault.OUT_OF_RANGE | Fault.ENORMOUS:
            return _edit_with(_VALUES[fault])
        case _:
            return _Stamps(_SHIFTS[fault]) if fault in _SHIFTS else _FrozenStamp(fault)


_VALUES: dict[Fault, float | None] = {
    Fault.NAN: math.nan,
    Fault.PLUS_INFINITY: math.inf,
    Fault.MINUS_INFINITY: -math.inf,
    Fault.EMPTY: None,
    Fault.OUT_OF_RANGE: 9.0,
    Fault.ENORMOUS: 1.7e308,
}

_SHIFTS: dict[Fault, Callable[[int], float]] = {
    Fault.STEPS_BACK: lambda _: -0.3,
    Fault.STRAYS_BACK: lambda number: -0.3 if number == 0 else 0.0,
    Fault.STEPS_BACK_FAR: lambda _: -5.0,
    Fault.STEPS_BACK_AGAIN: lambda number: -0.3 * (1 + number // 50),
    Fault.STEPS_BACK_FAR_AGAIN: lambda number: -5.0 * (1 + number // 50),
    Fault.JUMPS_TO_AND_FRO: lambda number: 5.0 * (number % 2),
    Fault.AHEAD: lambda _: 5.0,
    Fault.BEHIND: lambda _: -5.0,
}
"""By how many seconds the stamp of message number n is off, from the fault on."""


class _Every:
    """Only every n-th message is sent."""

    def __init__(self, n: int) -> None:
        self._n = n
        self._count = 0

    def __call__(self, message: RawMessage) -> list[RawMessage]:
        self._count += 1
        return [message] if self._count % self._n == 0 else []


class _Stamps:
    """Stamps are off."""

    def __init__(self, shift: Callable[[int], float]) -> None:
        self._shift = shift
        self._count = 0

    def __call__(self, message: RawMessage) -> list[RawMessage]:
        shift = self._shift(self._count)
        self._count += 1
        return [restamped(message, round(shift * NS))]


class _FrozenStamp:
    """All stamps are the same one: that of the first message, or zero."""

    def __init__(self, fault: Fault) -> None:
        self._stamp = (0, 0) if fault is Fault.ZERO_STAMPS else None

    def __call__(self, message: RawMessage) -> list[RawMessage]:
        def freeze(content: Message) -> None:
            stamp = content.header.stamp
            if self._stamp is None:
                self._stamp = (stamp.sec, stamp.nanosec)
            stamp.sec, stamp.nanosec = self._stamp

        return [edited(message, freeze)]


def edited(message: RawMessage, edit: Edit) -> RawMessage:
    """The message with another content."""
    content = TYPES.decode(message.type, message.data)
    edit(content)
    return replace(message, data=TYPES.encode(message.type, content))


def restamped(message: RawMessage, shift_ns: int, *, late: bool = False) -> RawMessage:
    """The message with its stamp shifted; `late` shifts its arrival as well."""

    def shift(content: Message) -> None:
        stamp = content.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp.sec * NS + stamp.nanosec + shift_ns, NS)

    moved = edited(message, shift)
    return replace(moved, receive_ns=moved.receive_ns + shift_ns) if late else moved


def another(message: RawMessage, topic: str) -> RawMessage:
    """What a second publisher says 7 ms later: something else."""
    later = restamped(message, 7_000_000, late=True)
    value = {DOOR: 0.4, HANDLE: -30.0}.get(topic, 1.0)
    return edited(later, lambda content: set_value(content, value))


def set_value(content: Message, value: float | None) -> None:
    """Set what a message measures; None = an empty array."""
    if hasattr(content, "position"):
        content.position = np.array([] if value is None else [value], np.float64)
    elif hasattr(content, "ranges"):
        number = value if value is None or abs(value) < 1e30 or math.isinf(value) else 3e38
        content.ranges = np.array([] if number is None else [number] * 4, np.float32)
    else:
        content.wrench.force.x = value


def _edit_with(value: float | None) -> Spoil:
    return lambda message: [edited(message, lambda content: set_value(content, value))]


def with_length(data: bytes, length: int) -> bytes:
    """The bytes of a stamped message whose `frame_id` claims to be so long."""
    encapsulation_and_stamp = 12
    return data[:encapsulation_and_stamp] + struct.pack("<I", length) + data[16:]
