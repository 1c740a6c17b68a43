"""What sensors and publishers do wrong, message by message."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from enum import StrEnum
from itertools import count
from random import Random

import numpy as np
from msgspec.structs import replace

from madrob_console.common.clock import NS
from madrob_console.messages.codec import encode_text
from madrob_console.messages.types import Message, MessageTypes
from recorder.bag import RawMessage

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
    EMPTY = "empty arrays"
    OUT_OF_RANGE = "out of range"
    ENORMOUS = "enormous numbers"
    OTHER_TYPE = "another type"
    TWO_PUBLISHERS = "two publishers"
    TRUNCATED = "truncated"
    HUGE_LENGTH = "claims 2 GB"
    TOO_LARGE = "400 kB"
    RANDOM = "random bytes"


def spoiler(topic: str, fault: Fault) -> Spoil:
    """A publisher of `topic` with this fault."""
    if fault in _VALUES:
        return lambda message: [edited(message, lambda c: set_value(c, _VALUES[fault]))]
    if fault in _BYTES:
        return lambda message: [replace(message, data=_BYTES[fault](message.data))]
    if fault in _SHIFTS:
        return _shifted(_SHIFTS[fault])
    return _SPOILERS[fault](topic)


_BYTES: dict[Fault, Callable[[bytes], bytes]] = {
    Fault.TRUNCATED: lambda data: data[: len(data) // 2],
    Fault.HUGE_LENGTH: lambda data: _with_length(data, 2**31 - 1),
    Fault.TOO_LARGE: lambda data: data + bytes(400_000),
}

_VALUES: dict[Fault, float | None] = {
    Fault.NAN: math.nan,
    Fault.PLUS_INFINITY: math.inf,
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


def _shifted(shift: Callable[[int], float]) -> Spoil:
    numbers = count()
    return lambda message: [restamped(message, round(shift(next(numbers)) * NS))]


def _every(n: int) -> Spoil:
    """Only every n-th message is sent."""
    numbers = count(1)
    return lambda message: [message] * (next(numbers) % n == 0)


def _frozen(*stamp: int) -> Spoil:
    """All stamps are the same one: that of the first message, or a given one."""
    kept = list(stamp)

    def freeze(content: Message) -> None:
        now = content.header.stamp
        kept.extend([] if kept else [now.sec, now.nanosec])
        now.sec, now.nanosec = kept

    return lambda message: [edited(message, freeze)]


def _random(_topic: str) -> Spoil:
    """Random bytes of random length, behind the right first four."""
    chance = Random(7)

    def spoil(message: RawMessage) -> list[RawMessage]:
        junk = chance.randbytes(chance.randrange(120))
        return [replace(message, data=message.data[:4] + junk)]

    return spoil


def _flood(message: RawMessage) -> list[RawMessage]:
    step = PERIOD_NS // 30
    return [restamped(message, k * step, late=True) for k in range(30)]


def _other_type(message: RawMessage) -> list[RawMessage]:
    return [replace(message, type=STRING, data=encode_text(TYPES, "not what you expect"))]


def _doubled(topic: str) -> Spoil:
    """A second publisher says something else 7 ms later."""
    value = {DOOR: 0.4, HANDLE: -30.0}.get(topic, 1.0)

    def spoil(message: RawMessage) -> list[RawMessage]:
        later = restamped(message, 7_000_000, late=True)
        return [message, edited(later, lambda content: set_value(content, value))]

    return spoil


_SPOILERS: dict[Fault, Callable[[str], Spoil]] = {
    Fault.DIES: lambda _: lambda _: [],
    Fault.SLOWS: lambda _: _every(10),
    Fault.CRAWLS: lambda _: _every(125),
    Fault.FLOODS: lambda _: _flood,
    Fault.REPEATS_STAMPS: lambda _: _frozen(),
    Fault.ZERO_STAMPS: lambda _: _frozen(0, 0),
    Fault.OTHER_TYPE: lambda _: _other_type,
    Fault.TWO_PUBLISHERS: _doubled,
    Fault.RANDOM: _random,
}


def edited(message: RawMessage, edit: Edit) -> RawMessage:
    """The message with another content."""
    content = TYPES.decode(message.type, message.data)
    edit(content)
    return replace(message, data=TYPES.encode(message.type, content))


def restamped(message: RawMessage, shift_ns: int, *, late: bool = False) -> RawMessage:
    """The message with its stamp shifted; `late` shifts its arrival as well."""
    moved = edited(message, lambda content: shift_stamp(content, shift_ns))
    return replace(moved, receive_ns=moved.receive_ns + shift_ns) if late else moved


def shift_stamp(content: Message, shift_ns: int) -> None:
    stamp = content.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp.sec * NS + stamp.nanosec + shift_ns, NS)


def set_value(content: Message, value: float | None) -> None:
    """Set what a message measures; None = an empty array."""
    if hasattr(content, "position"):
        content.position = np.array([] if value is None else [value], np.float64)
    elif hasattr(content, "ranges"):
        number = 3e38 if value is not None and 3e38 < value < math.inf else value
        content.ranges = np.array([] if number is None else [number] * 4, np.float32)
    else:
        content.wrench.force.x = value


def _with_length(data: bytes, length: int) -> bytes:
    """The bytes of a stamped message whose `frame_id` claims to be so long."""
    encapsulation_and_stamp = 12
    return data[:encapsulation_and_stamp] + struct.pack("<I", length) + data[16:]
