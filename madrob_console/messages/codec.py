"""Bytes of a message to samples and back, by the configured mapping.

Which topic carries which signal is configuration (`TopicMapping`); nothing but this module knows
about fields.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import chain
from typing import NamedTuple

from msgspec.structs import replace as with_fields
from rosbags.interfaces import Nodetype

from madrob_console.common.clock import NS, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.messages.cdr_layout import Layout, Numbers, Wanted
from madrob_console.messages.message_fields import Getter, MessageField, find_field, find_stamp
from madrob_console.messages.message_types import (
    Message,
    MessageError,
    MessageTypes,
    standard_types,
)
from madrob_console.messages.topic_mapping import DEFAULT_MAPPINGS, STRIPS, TopicMapping
from recorder.bag import Durability, Qos, RawMessage, Topic
from scoring.protocol import SENSORS_PER_STRIP, Signal, StartPose
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

HEAD = 12
"""Size of the stamp in bytes: four of encapsulation, then seconds and nanoseconds."""

_CODES = {b"\x00\x00": struct.Struct(">iI"), b"\x00\x01": struct.Struct("<iI")}


def begins_with_header(types: MessageTypes, type_name: str) -> bool:
    first = next(iter(types.fields(type_name).values()), None)
    return first is not None and first == (Nodetype.NAME, "std_msgs/msg/Header")


def header_stamp(data: bytes) -> float | None:
    """The header's stamp in s since the epoch, from the first `HEAD` bytes; None = no stamp."""
    code = _CODES.get(data[:2])
    if code is None or len(data) < HEAD:
        return None
    sec, nanosec = code.unpack_from(data, 4)
    if nanosec >= NS or sec < 0 or (sec == 0 and nanosec == 0):  # the last: never set
        return None
    return float(sec + nanosec / NS)


__all__ = [
    "DEFAULT_MAPPINGS",
    "REFEREE_ELAPSED_TOPIC",
    "REFEREE_EVENT_TOPIC",
    "REFEREE_LEVEL_TOPIC",
    "REFEREE_RUNNING_TOPIC",
    "REFEREE_START_POSE_TOPIC",
    "REFEREE_STATE_TOPIC",
    "ROBOT_FINISHED_TOPIC",
    "ROBOT_STARTED_TOPIC",
    "ROBOT_TYPES",
    "START_POSE_FRAME",
    "STRIPS",
    "Decoder",
    "Message",
    "MessageError",
    "MessageTypes",
    "TopicMapping",
    "decode_text",
    "describe_topic",
    "encode_data",
    "encode_start_pose",
    "encode_text",
    "referee_topics",
    "robot_words",
]

REFEREE_STATE_TOPIC = "/madrob/referee/state"
REFEREE_EVENT_TOPIC = "/madrob/referee/event"
REFEREE_START_POSE_TOPIC = "/madrob/referee/start_pose"
START_POSE_FRAME = "madrob_door"
REFEREE_RUNNING_TOPIC = "/madrob/referee/running"
REFEREE_ELAPSED_TOPIC = "/madrob/referee/elapsed"
REFEREE_LEVEL_TOPIC = "/madrob/referee/level"
ROBOT_STARTED_TOPIC = "/madrob/robot/started"
ROBOT_FINISHED_TOPIC = "/madrob/robot/finished"

_STRING = "std_msgs/msg/String"
_POSE = "geometry_msgs/msg/PoseStamped"
_REFEREE_TYPES = {
    REFEREE_STATE_TOPIC: _STRING,
    REFEREE_EVENT_TOPIC: _STRING,
    REFEREE_START_POSE_TOPIC: _POSE,
    REFEREE_RUNNING_TOPIC: "std_msgs/msg/Bool",
    REFEREE_ELAPSED_TOPIC: "std_msgs/msg/Float64",
    REFEREE_LEVEL_TOPIC: "std_msgs/msg/Int32",
}
ROBOT_TYPES = {ROBOT_STARTED_TOPIC: "std_msgs/msg/Empty", ROBOT_FINISHED_TOPIC: _STRING}

LARGEST_WORDS = 4096
"""Bytes of a robot's message; a larger one is neither recorded nor read."""

_MOST_SHOWN = 60
_MEASURED: dict[Signal, Callable[[float, float, float, int], Sample]] = {
    Signal.DOOR: DoorSample,
    Signal.HANDLE: HandleSample,
}
"""(time, log time, value, sequence) -> sample."""
_STAMP = (Wanted(("header", "stamp", "sec")), Wanted(("header", "stamp", "nanosec")))
_LONGEST_NAME = 40
_MOST_MISSES = 20
"""After so many layout misses in a row, no new layout is tried."""


class Remark(NamedTuple):
    """What to know of what was read, and the signal that it casts doubt on."""

    words: str
    doubts: Signal | None = None


_Build = Callable[[float, float, int, Sequence[Numbers]], Sample]
"""(time, log time, the numbers of the value and of its limits) -> sample."""


class Decoder:
    """Turns the configured topics' bytes into samples.

    Types registered later are found when a message arrives.
    """

    def __init__(self, mappings: Sequence[TopicMapping], types: MessageTypes) -> None:
        self._types = types
        self._mappings: dict[str, TopicMapping] = {}
        for mapping in mappings:
            if mapping.topic in self._mappings:
                raise MadrobError(f"{mapping.topic} is mapped twice: give each signal its topic")
            self._mappings[mapping.topic] = mapping
        self._parts: dict[str, tuple[_Parts, int]] = {}
        for signal in Signal:
            topics = [mapping.topic for mapping in mappings if mapping.signal is signal]
            if signal in STRIPS and len(topics) == SENSORS_PER_STRIP:
                parts = _Parts()
                self._parts |= {topic: (parts, place) for place, topic in enumerate(topics)}
            elif len(topics) > 1:
                raise MadrobError(f"{signal.value} is mapped twice: keep one topic")
        self._readers: dict[str, _Reader] = {}
        self.remarks: list[Remark] = []

    def decode(self, message: RawMessage) -> Sample | None:
        """The sample in a message; None if no mapping names its topic, or more is to come.

        Its time is the header's stamp, or the receive time where the type has no header.

        Raises:
            MessageError: the message does not match its mapping or its type, or is too large.
        """
        mapping = self._mappings.get(message.topic)
        if mapping is None:
            return None
        try:
            sample = self._sample(message, mapping)
        except MessageError as error:
            raise MessageError(f"{message.topic}: {error}") from None
        if message.topic not in self._parts:
            return sample
        parts, place = self._parts[message.topic]
        assert isinstance(sample, PassageSample)
        return parts.joined(place, sample)

    def ambiguity(self, topic: str) -> str | None:
        """Why the topic's newest sample may be of another joint; None = it is not."""
        reader = self._readers.get(topic)
        return None if reader is None or reader.watch is None else reader.watch.ambiguity

    def take_remarks(self) -> tuple[Remark, ...]:
        """The remarks since the last call."""
        remarks = tuple(self.remarks)
        self.remarks.clear()
        return remarks

    def _sample(self, message: RawMessage, mapping: TopicMapping) -> Sample:
        if message.type != mapping.type:
            raise MessageError(f"it sends {message.type}, not {mapping.type}; correct the settings")
        if mapping.largest is not None and len(message.data) > mapping.largest:
            raise MessageError(
                f"{len(message.data)} bytes, not read above {mapping.largest}: stop what sends "
                "that, or set `largest` of its [[topics]]"
            )
        reader = self._readers.get(message.topic) or self._reader(mapping)
        return reader.sample(message)

    def _reader(self, mapping: TopicMapping) -> _Reader:
        field = find_signal(self._types, mapping, one_range=mapping.topic in self._parts)
        reader = _Reader(mapping, field, self._types, self.remarks)
        self._readers[mapping.topic] = reader
        return reader


_HELD = 0.5
"""How long the range of one topic stands for its part of the strip, s: as long as it is fresh."""


class _Parts:
    """Four topics of one range each, which are one strip."""

    def __init__(self) -> None:
        self._newest: list[PassageSample | None] = [None] * SENSORS_PER_STRIP

    def joined(self, place: int, part: PassageSample) -> PassageSample | None:
        """The newest ranges of all four with the last topic's message; None with the others'."""
        self._newest[place] = part
        if place < SENSORS_PER_STRIP - 1:
            return None
        held = [
            each if each is not None and part.log_time - each.log_time <= _HELD else None
            for each in self._newest
        ]
        return with_fields(
            part,
            ranges=tuple(math.nan if each is None else _within_limits(each) for each in held),
            range_min=min(each.range_min for each in held if each is not None),
            range_max=max(each.range_max for each in held if each is not None),
        )


def _within_limits(part: PassageSample) -> float:
    """Its range, NaN outside of its own limits: they need not be those of the others."""
    (distance,) = part.ranges
    inside = part.range_min <= distance <= part.range_max or math.isinf(distance)
    return distance if inside else math.nan


class _NameWatch:
    """Looks at what a fixed index rests on: publishers do not promise the order of names.

    Attributes:
        ambiguity: why the newest message's value may be another joint's; None = it has one name.
    """

    def __init__(self, mapping: TopicMapping, names: Getter, remarks: list[Remark]) -> None:
        self.ambiguity: str | None = None
        self._signal = mapping.signal
        self._array, _, index = mapping.field.rstrip("]").rpartition("[")
        self._index = int(index)
        self._field = f"{mapping.topic}: {mapping.field}"
        self._names = names
        self._remarks = remarks
        self._first: str | None = None
        self._doubted = False

    def look(self, message: Message) -> None:
        names = self._names(message)
        self.ambiguity = None
        if self._index >= len(names):
            return
        name = terminal_safe(names[self._index][:_LONGEST_NAME])
        self._first = self._first or name
        remedy = f"use {self._array}[name=...]"
        words = ""
        if len(names) > 1:
            words = f"{self._field} is '{name}', one of {len(names)} names: {remedy}"
            self.ambiguity = words
        elif name != self._first:
            words = f"{self._field} was '{self._first}', then '{name}': {remedy}"
        if words and not self._doubted:
            self._doubted = True
            self._remarks.append(Remark(words, self._signal))


class _Reader:
    def __init__(
        self,
        mapping: TopicMapping,
        field: MessageField,
        types: MessageTypes,
        remarks: list[Remark],
    ) -> None:
        self._types = types
        self._type = mapping.type
        self._stamped = find_stamp(types, mapping.type) is not None
        self._wanted = (
            *(_STAMP if self._stamped else ()),
            *(Wanted(steps, SENSORS_PER_STRIP) for steps in field.elements(SENSORS_PER_STRIP)),
            *_limits(mapping, field, types),
        )
        self._build = _builder(mapping, field)
        names = field.names(types)
        self.watch = None if names is None else _NameWatch(mapping, names, remarks)
        self._layout: Layout | None = None
        self._misses = 0

    def sample(self, message: RawMessage) -> Sample:
        numbers = None if self._layout is None else self._layout.read(message.data)
        if numbers is None:
            numbers = self._read_whole(message.data)
        else:
            self._misses = 0
        log_time = seconds(message.receive_ns)
        if not self._stamped:
            return self._build(log_time, log_time, message.sequence, numbers)
        time = seconds(int(numbers[0][0]) * NS + int(numbers[1][0]))
        return self._build(time, log_time, message.sequence, numbers[2:])

    def _read_whole(self, data: bytes) -> tuple[Numbers, ...]:
        message = self._types.decode(self._type, data)
        if self.watch is not None:
            self.watch.look(message)
        wanted = [one.at(message) for one in self._wanted]
        if self._misses < _MOST_MISSES:  # else no message is laid out like the one before
            self._misses += 1
            with suppress(ValueError, struct.error):
                self._layout = Layout(self._types, self._type, data, wanted)
        return tuple(one.getter()(message) for one in wanted)


def find_signal(
    types: MessageTypes, mapping: TopicMapping, *, one_range: bool = False
) -> MessageField:
    """The mapped field, of a strip or `one_range` of it; MessageError where it cannot hold that."""
    field = find_field(types, mapping.type, mapping.field)
    if field.numbers != (array := mapping.signal in STRIPS and not one_range):
        wanted = "an array" if array else "one number"
        raise MessageError(
            f"{mapping.field} of {mapping.type} is not {wanted}; correct the settings"
        )
    return field


def _limits(mapping: TopicMapping, field: MessageField, types: MessageTypes) -> tuple[Wanted, ...]:
    if mapping.signal not in STRIPS:
        return ()
    for names in (("range_min", "range_max"), ("min_range", "max_range")):  # of a scan, of a Range
        found = [one for name in names if (one := field.sibling(name, types)) is not None]
        if len(found) == len(names):
            return tuple(Wanted(one.elements(1)[0]) for one in found)
    return ()


def _builder(mapping: TopicMapping, field: MessageField) -> _Build:
    if mapping.signal in STRIPS:
        passage = _passage_builder(mapping)
        return passage if field.each is None else _gathered(passage)
    scale, offset = mapping.scale, mapping.offset

    def number(numbers: Sequence[Numbers]) -> float:
        (value,) = numbers
        return float(value[0]) * scale + offset if value else math.nan  # an empty array says none

    if mapping.signal is not Signal.LATCH:
        sample = _MEASURED[mapping.signal]
        return lambda time, log, sequence, numbers: sample(time, log, number(numbers), sequence)

    def latch(time: float, log_time: float, sequence: int, numbers: Sequence[Numbers]) -> Sample:
        state = number(numbers)
        if math.isnan(state):
            raise MessageError(f"{mapping.field} says nothing about the {mapping.signal.value}")
        return LatchSample(time, log_time, state >= 0.5, sequence)

    return latch


def _gathered(passage: _Build) -> _Build:
    """For ranges that are a field of each message in an array."""

    def gathered(time: float, log_time: float, sequence: int, numbers: Sequence[Numbers]) -> Sample:
        ranges = tuple(chain.from_iterable(numbers[:SENSORS_PER_STRIP]))
        return passage(time, log_time, sequence, (ranges, *numbers[SENSORS_PER_STRIP:]))

    return gathered


def _passage_builder(mapping: TopicMapping) -> _Build:
    strip = STRIPS[mapping.signal]
    scale, offset, no_echo = mapping.scale, mapping.offset, float(mapping.no_echo)
    as_is = scale == 1.0 and offset == 0.0
    unnumbered = math.isnan(no_echo)

    def passage(time: float, log_time: float, sequence: int, numbers: Sequence[Numbers]) -> Sample:
        ranges, low, high = numbers[0], 0.0, math.inf
        if limited := len(numbers) > 1:
            low, high = numbers[1][0], numbers[2][0]
        if unnumbered:
            ranges = tuple(math.inf if math.isnan(r) else r for r in ranges)
        elif no_echo < math.inf:
            ranges = tuple(
                math.inf if math.isclose(r, no_echo, rel_tol=1e-6) else r for r in ranges
            )
        if not as_is:
            ranges = tuple(r * scale + offset for r in ranges)
            if limited:
                low, high = sorted((low * scale + offset, high * scale + offset))
        return PassageSample(time, log_time, strip, ranges, low, high, sequence)

    return passage


def describe_topic(types: MessageTypes, name: str, type_name: str, qos: Qos | None = None) -> Topic:
    definition = types.definition(type_name) or "\n"  # some readers of bags refuse an empty one
    return Topic(name, type_name, definition, types.type_hash(type_name), qos or Qos())


def referee_topics(types: MessageTypes) -> tuple[Topic, ...]:
    """The console's own topics (protocol section 3)."""
    qos = Qos(durability=Durability.TRANSIENT_LOCAL)
    return tuple(describe_topic(types, name, kind, qos) for name, kind in _REFEREE_TYPES.items())


def encode_data(types: MessageTypes, type_name: str, data: object) -> bytes:
    """Encodes a message of `std_msgs` with one field, `data`."""
    return types.encode(type_name, types.make(type_name, data=data))


def encode_text(types: MessageTypes, text: str) -> bytes:
    return encode_data(types, _STRING, text)


def decode_text(types: MessageTypes, data: bytes) -> str:
    return str(types.decode(_STRING, data).data)


def robot_words(data: bytes) -> str:
    """What a robot says on `/madrob/robot/finished`, short and safe for a terminal."""
    text = ""
    if len(data) <= LARGEST_WORDS:
        with suppress(MessageError):
            text = terminal_safe(decode_text(standard_types(), data))
    return text[:_MOST_SHOWN].strip() or "finished"


def encode_start_pose(types: MessageTypes, pose: StartPose, time_ns: int) -> bytes:
    """Encodes a pose (x, y in m, yaw in degrees) as `PoseStamped` in the frame `madrob_door`."""
    half_yaw = math.radians(pose.yaw) / 2
    message = types.make(_POSE)
    message.header.frame_id = START_POSE_FRAME
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, NS)
    message.pose.position.x, message.pose.position.y = pose.x, pose.y
    message.pose.orientation.z = math.sin(half_yaw)
    message.pose.orientation.w = math.cos(half_yaw)
    return types.encode(_POSE, message)
