"""Bytes of a message to samples and back, by the configured mapping.

Which topic carries which signal is configuration (`TopicMapping`); nothing but this room knows
about fields.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

from msgspec.structs import replace as with_fields

from madrob_console.common.clock import NS, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.messages.fields import MessageField, find_field, has_header, value_at
from madrob_console.messages.mapping import STRIPS, TopicMapping
from madrob_console.messages.types import Message, MessageError, MessageTypes, standard_types
from recorder.bag import Durability, Qos, RawMessage, Topic
from scoring.protocol import SENSORS_PER_STRIP, Signal, StartPose
from scoring.quality import is_reading
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample


class Decoder:
    """Turns the configured topics' bytes into samples.

    Types registered later are found when a message arrives.

    Attributes:
        absent: the name that the newest message lacks, so that it is no sample; else None.
        doubt: why the newest sample may be wrong, or lacks a reading; None = no reason is known.
        remark: what the newest message is the first of its topic to show, and the signal that it
            casts doubt on; mostly None.
    """

    def __init__(self, mappings: Sequence[TopicMapping], types: MessageTypes) -> None:
        self.absent: str | None = None
        self.doubt: str | None = None
        self.remark: tuple[str, Signal] | None = None
        self._types = types
        self._mappings: dict[str, TopicMapping] = {}
        self._readers: dict[str, _Reader] = {}
        self._parts: dict[str, tuple[list[PassageSample | None], int]] = {}
        """Of a strip of four topics: the newest samples of all, and the place of this topic."""
        for mapping in mappings:
            if mapping.topic in self._mappings:
                raise MadrobError(f"{mapping.topic} is mapped twice: give each signal its topic")
            self._mappings[mapping.topic] = mapping
        for signal in Signal:
            topics = [mapping.topic for mapping in mappings if mapping.signal is signal]
            if signal in STRIPS and len(topics) == SENSORS_PER_STRIP:
                newest: list[PassageSample | None] = [None] * SENSORS_PER_STRIP
                self._parts |= {topic: (newest, place) for place, topic in enumerate(topics)}
            elif len(topics) > 1:
                raise MadrobError(f"{signal.value} is mapped twice: keep one topic")

    def decode(self, message: RawMessage) -> Sample | None:
        """Return the sample in a message.

        None = no mapping names its topic, it lacks the named element, or more of a strip is to
        come. The sample's time is the header's stamp, or the receive time where the type has no
        header.

        Raises:
            MessageError: the message does not match its mapping or its type, or is too large.
        """
        self.absent = None
        self.doubt = None
        self.remark = None
        mapping = self._mappings.get(message.topic)
        if mapping is None:
            return None
        try:
            sample = self._read(message, mapping)
        except MessageError as error:
            raise MessageError(f"{message.topic}: {error}") from None
        if message.topic in self._parts and isinstance(sample, PassageSample):
            return self._join(sample, *self._parts[message.topic])
        return sample

    def _read(self, message: RawMessage, mapping: TopicMapping) -> Sample | None:
        if message.type != mapping.type:
            raise MessageError(f"it sends {message.type}, not {mapping.type}; correct the settings")
        if mapping.largest is not None and len(message.data) > mapping.largest:
            raise MessageError(
                f"{len(message.data)} bytes, not read above {mapping.largest}: stop what sends "
                "that, or set `largest` of its [[topics]]"
            )
        reader = self._readers.get(message.topic)
        if reader is None:
            reader = _Reader(mapping, self._types, one_range=message.topic in self._parts)
            self._readers[message.topic] = reader
        content = self._types.decode(mapping.type, message.data)
        try:
            sample = reader.sample(content, message)
        except ValueError:  # no element has the name
            self.absent = mapping.element_name
            return None
        if reader.names:
            self._look_at_names(content, reader)
        return sample

    def _look_at_names(self, content: Message, reader: _Reader) -> None:
        """Doubt a value by index: publishers do not promise the order of names."""
        mapping = reader.mapping
        array, _, index = mapping.field.rstrip("]").rpartition("[")
        try:
            names = value_at(content, reader.names)
            name = names[int(index)][:_LONGEST_NAME]
        except IndexError:
            return
        reader.first_name = reader.first_name or name
        if len(names) == 1 and name == reader.first_name:
            return

        found = f"was '{terminal_safe(reader.first_name)}', then '{terminal_safe(name)}'"
        if len(names) > 1:
            found = f"is '{terminal_safe(name)}', one of {len(names)} names"
        words = f"{mapping.topic}: {mapping.field} {found}: use {array}[name=...]"
        if len(names) > 1:
            self.doubt = words
        if not reader.is_doubted:
            reader.is_doubted = True
            self.remark = (words, mapping.signal)

    def _join(
        self, part: PassageSample, newest: list[PassageSample | None], place: int
    ) -> PassageSample | None:
        """Return the newest ranges of all four with the last topic's message."""
        newest[place] = part
        if place < SENSORS_PER_STRIP - 1:
            return None
        held = []
        ranges = []
        for element, one in enumerate(newest):
            distance = math.nan
            problem: str | None
            if one is None or part.log_time - one.log_time > _HELD:
                problem = f"range {element} is older than {_HELD:g} s"
            else:
                held.append(one)
                # Its own limits decide: they need not be those of the others.
                problem = range_problem(one, 0, element)
                if problem is None:
                    distance = one.ranges[0]
            ranges.append(distance)
            self.doubt = self.doubt or problem
        return with_fields(
            part,
            ranges=tuple(ranges),
            range_min=min(one.range_min for one in held),
            range_max=max(one.range_max for one in held),
        )


_HELD = 0.5
"""How long the range of one topic stands for its part of the strip, s: as long as it is fresh."""

_LONGEST_NAME = 40


def range_problem(sample: PassageSample, element: int, number: int) -> str | None:
    """Return why the range is no reading, or None if it is one.

    The words call it `number`.
    """
    if is_reading(sample, element):
        return None
    if element >= len(sample.ranges):
        return f"only {len(sample.ranges)} ranges of {SENSORS_PER_STRIP}"
    distance = sample.ranges[element]
    if math.isnan(distance):
        return f"range {number} is NaN"
    limits = f"{sample.range_min:g}..{sample.range_max:g}"
    return f"range {number}: {distance:.2f} m is outside of the message's limits {limits}"


class _Reader:
    """Reads the decoded messages of one topic.

    Attributes:
        names: the way to the names of the elements of which the value is one by index; else empty.
        first_name: that of the value in the first message.
        is_doubted: whether there is a remark on the names.
    """

    def __init__(self, mapping: TopicMapping, types: MessageTypes, *, one_range: bool) -> None:
        self.mapping = mapping
        self._field = find_signal(types, mapping, one_range=one_range)
        self._limits = _find_limits(self._field, types)
        self._has_stamp = has_header(types, mapping.type)
        self.names = self._field.names(types)
        self.first_name = ""
        self.is_doubted = False

    def sample(self, content: Message, message: RawMessage) -> Sample:
        """Return the sample in a message.

        ValueError where no element has the name.
        """
        log_time = seconds(message.receive_ns)
        time = log_time
        if self._has_stamp:
            stamp = content.header.stamp
            time = seconds(stamp.sec * NS + stamp.nanosec)
        signal = self.mapping.signal
        if signal in STRIPS:
            ranges, low, high = self._ranges(content)
            strip = STRIPS[signal]
            return PassageSample(time, log_time, strip, ranges, low, high, message.sequence)
        try:
            number = float(self._field.value(content))
        except IndexError:
            number = math.nan  # an empty array says none
        value = number * self.mapping.scale + self.mapping.offset
        if signal is Signal.DOOR:
            return DoorSample(time, log_time, value, message.sequence)
        if signal is Signal.HANDLE:
            return HandleSample(time, log_time, value, message.sequence)
        if math.isnan(value):
            raise MessageError(f"{self.mapping.field} says nothing about the {signal.value}")
        return LatchSample(time, log_time, value >= 0.5, message.sequence)

    def _ranges(self, content: Message) -> tuple[tuple[float, ...], float, float]:
        """Return the ranges, infinite without echo, and their limits, all scaled."""
        mapping = self.mapping
        try:
            found = self._field.value(content)
            limits = [limit.value(content) for limit in self._limits]
        except IndexError:
            return (), 0.0, math.inf
        if self._field.messages is not None:
            limits = [each[0] for each in limits if each]
        if not self._field.numbers:
            found = [found]
        no_echo = float(mapping.no_echo)
        ranges = []
        for distance in found[:SENSORS_PER_STRIP]:
            value = float(distance)
            if math.isclose(value, no_echo, rel_tol=1e-6) or (
                math.isnan(value) and math.isnan(no_echo)
            ):
                value = math.inf
            ranges.append(value * mapping.scale + mapping.offset)

        if not limits:
            return tuple(ranges), 0.0, math.inf
        scaled = [limit * mapping.scale + mapping.offset for limit in limits]
        if mapping.scale < 0:
            scaled.reverse()
        return tuple(ranges), scaled[0], scaled[1]


def find_signal(
    types: MessageTypes, mapping: TopicMapping, *, one_range: bool = False
) -> MessageField:
    """Find the mapped field, of a strip or `one_range` of it.

    MessageError where it cannot hold that.
    """
    field = find_field(types, mapping.type, mapping.field)
    is_strip = mapping.signal in STRIPS and not one_range
    if field.numbers != is_strip:
        wanted = "an array" if is_strip else "one number"
        raise MessageError(
            f"{mapping.field} of {mapping.type} is not {wanted}; correct the settings"
        )
    return field


def _find_limits(field: MessageField, types: MessageTypes) -> list[MessageField]:
    """Find the limits beside ranges, least first.

    Empty where the type has none.
    """
    for names in (("range_min", "range_max"), ("min_range", "max_range")):  # of a scan, of a Range
        found = [field.sibling(name, types) for name in names]
        limits = [limit for limit in found if limit is not None]
        if len(limits) == len(names):
            return limits
    return []


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


def describe_topic(types: MessageTypes, name: str, type_name: str, qos: Qos | None = None) -> Topic:
    return Topic(
        name,
        type_name,
        types.definition(type_name) or "\n",  # some readers of bags refuse an empty one
        types.type_hash(type_name),
        qos or Qos(),
    )


def referee_topics(types: MessageTypes) -> tuple[Topic, ...]:
    """Describe the console's own topics (protocol section 3)."""
    qos = Qos(durability=Durability.TRANSIENT_LOCAL)
    return tuple(describe_topic(types, name, kind, qos) for name, kind in _REFEREE_TYPES.items())


def encode_data(types: MessageTypes, type_name: str, data: object) -> bytes:
    """Encode a message of `std_msgs` with one field, `data`."""
    return types.encode(type_name, types.make(type_name, data=data))


def encode_text(types: MessageTypes, text: str) -> bytes:
    return encode_data(types, _STRING, text)


def decode_text(types: MessageTypes, data: bytes) -> str:
    return str(types.decode(_STRING, data).data)


def robot_words(data: bytes) -> str:
    """Return what a robot says on `/madrob/robot/finished`, short and safe for a terminal."""
    text = ""
    if len(data) <= LARGEST_WORDS:
        with suppress(MessageError):
            text = terminal_safe(decode_text(standard_types(), data))
    return text[:_MOST_SHOWN].strip() or "finished"


def encode_start_pose(types: MessageTypes, pose: StartPose, time_ns: int) -> bytes:
    """Encode a pose (x, y in m, yaw in degrees) as `PoseStamped` in the frame `madrob_door`."""
    half_yaw = math.radians(pose.yaw) / 2
    message = types.make(_POSE)
    message.header.frame_id = START_POSE_FRAME
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, NS)
    message.pose.position.x = pose.x
    message.pose.position.y = pose.y
    message.pose.orientation.z = math.sin(half_yaw)
    message.pose.orientation.w = math.cos(half_yaw)
    return types.encode(_POSE, message)
