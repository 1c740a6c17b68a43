"""The simulated testbed as a source: the same bytes on the same topics as a real one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import attrgetter
from random import Random
from types import MappingProxyType

import numpy as np

from madrob_console.common.clock import NS, Clock, nanoseconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    START_POSE_FRAME,
    STRIPS,
    TopicMapping,
    decode_text,
    describe_topic,
    find_signal,
    referee_topics,
)
from madrob_console.messages.message_fields import MessageField, attribute, find_stamp
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.messages.topic_mapping import NamedElement
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from madrob_console.testbeds.simulated.sensor_model import RANGE_MAX, RANGE_MIN, Reading
from madrob_console.testbeds.simulated.testbed import RefereeState, SimulatedTestbed, parse_state
from madrob_console.testbeds.source import Announcement, Source, TopicStatus
from recorder.bag import Durability, Qos, RawMessage, Topic
from scoring.protocol import SENSORS_PER_STRIP, Condition, Signal, Strip

# Readings as messages: the way back through a configured mapping.
#
# Whatever types and units a testbed is configured with, its simulation publishes the same.


class Encoder:
    """Encodes the messages of one topic, reusing one message object.

    In a scan, `scan` sets the fields beside the ranges. Where the type is unknown, or its field
    cannot hold the signal, it raises MadrobError.
    """

    def __init__(
        self,
        mapping: TopicMapping,
        types: MessageTypes,
        frame: str = "",
        scan: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self._mapping = mapping
        self._types = types
        field = find_signal(types, mapping)
        self._message = types.make(mapping.type)
        stamp = find_stamp(types, mapping.type)
        self._stamp = None if stamp is None else stamp(self._message)
        if stamp is not None:
            self._message.header.frame_id = frame
        self._holder, self._name, self._index = self._place(field)
        self._base = field.base
        if field.numbers:
            size = len(getattr(self._holder, self._name))
            if size not in (0, SENSORS_PER_STRIP):
                raise self._error(f"{mapping.field} holds {size} ranges, not 4")
            self._set_limits(field)
            self._set_beside(field, scan)
        if mapping.type == "sensor_msgs/msg/JointState":
            self._message.name = ["door"]
        if isinstance(named := field.steps[-1], NamedElement):
            setattr(self._holder, named.names, [named.value])

    def encode(self, stamp_ns: int, reading: Reading) -> bytes:
        if self._stamp is not None:
            self._stamp.sec, self._stamp.nanosec = divmod(stamp_ns, NS)
        if isinstance(reading, tuple):
            published = [self._published(number) for number in reading]
            dtype = getattr(self._holder, self._name).dtype
            setattr(self._holder, self._name, np.array(published, dtype))
        elif self._index is None:
            setattr(self._holder, self._name, self._published(reading))
        else:
            getattr(self._holder, self._name)[self._index] = self._published(reading)
        return self._types.encode(self._mapping.type, self._message)

    def _published(self, value: float) -> float:
        raw = (value - self._mapping.offset) / self._mapping.scale
        if self._base.startswith("float"):
            return raw
        return raw >= 0.5 if self._base == "bool" else round(raw)

    def _place(self, field: MessageField) -> tuple[Message, str, int | None]:
        *way, last = field.steps
        index = None
        if not isinstance(last, str):
            index = last if isinstance(last, int) else 0
            *way, last = way
        names = [attribute(step) for step in (*way, last) if isinstance(step, str)]
        if len(names) <= len(way) or field.each is not None:
            raise self._error(f"{self._mapping.field} leads through an array of messages")
        holder = reduce(getattr, names[:-1], self._message)
        if index is not None:
            array = getattr(holder, names[-1])
            if len(array) <= index:
                setattr(holder, names[-1], np.zeros(index + 1, array.dtype))
        return holder, names[-1], index

    def _set_limits(self, field: MessageField) -> None:
        scale, offset = self._mapping.scale, self._mapping.offset
        limits = sorted((limit - offset) / scale for limit in (RANGE_MIN, RANGE_MAX))
        self._set_beside(field, dict(zip(("range_min", "range_max"), limits, strict=True)))

    def _set_beside(self, field: MessageField, numbers: Mapping[str, float]) -> None:
        for name, number in numbers.items():
            if field.sibling(name, self._types) is not None:
                setattr(self._holder, name, number)

    def _error(self, reason: str) -> MadrobError:
        return MadrobError(
            f"{self._mapping.topic} cannot be simulated ({reason}); simulate the default topics"
        )


# Where the simulated sensors are, as ROS tells it: frames in headers, and `/tf_static`.
#
# All frames hang on `madrob_door` (protocol section 1), so that Foxglove and RViz can show scans
# and start pose together. The testbed's interface does not need them, and a real one may name
# others.


FRAMES_TOPIC = "/tf_static"
FRAMES_TYPE = "tf2_msgs/msg/TFMessage"

_HALF = math.sqrt(0.5)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_DOWN_TO_LEFT = (0.0, _HALF, 0.0, _HALF)
_DOWN_TO_RIGHT = (_HALF, 0.0, -_HALF, 0.0)
"""Turned so that x points down and y along the wall, to the left or right when looking to CCW."""

_TRANSFORM = "geometry_msgs/msg/TransformStamped"


@dataclass(frozen=True, slots=True)
class StandingFrame:
    """A static frame in `madrob_door`: origin x, y, z in m, and a quaternion x, y, z, w."""

    name: str
    place: tuple[float, float, float]
    turn: tuple[float, float, float, float]


def frame_name(signal: Signal) -> str:
    if signal is Signal.HANDLE:
        return "madrob_handle"
    strip = STRIPS.get(signal)
    return START_POSE_FRAME if strip is None else f"madrob_passage_{strip}"


def frames(geometry: DoorGeometry) -> tuple[StandingFrame, ...]:
    """The frames of handle and strips.

    The handle's is where the handle is while the door is closed: x is the direction of a positive
    force, which turns with the panel in truth. A strip's has x down, and y towards its last sensor.
    """
    free_end = _along_wall(geometry, geometry.panel_length)
    handle = StandingFrame(
        frame_name(Signal.HANDLE), (0.0, free_end, geometry.panel_height / 2), _UPRIGHT
    )
    return (handle, *(_strip_frame(geometry, strip) for strip in Strip))


def scan_angles(geometry: DoorGeometry) -> dict[str, float]:
    """The angles of a strip's `LaserScan`, by field, rad.

    A scan has rays from one point, although the sensors look straight down, side by side. The rays
    are spread so that each meets the ground below its sensor.
    """
    between = geometry.sensor_spacing / geometry.lintel_height
    most = between * (SENSORS_PER_STRIP - 1) / 2
    return {"angle_min": -most, "angle_max": most, "angle_increment": between}


def encode_frames(types: MessageTypes, geometry: DoorGeometry, time_ns: int) -> RawMessage:
    transforms = []
    for frame in frames(geometry):
        stamped = types.make(_TRANSFORM, child_frame_id=frame.name)
        stamped.header.frame_id = START_POSE_FRAME
        stamped.header.stamp.sec, stamped.header.stamp.nanosec = divmod(time_ns, NS)
        place, turn = stamped.transform.translation, stamped.transform.rotation
        place.x, place.y, place.z = frame.place
        turn.x, turn.y, turn.z, turn.w = frame.turn
        transforms.append(stamped)
    data = types.encode(FRAMES_TYPE, types.make(FRAMES_TYPE, transforms=transforms))
    return RawMessage(FRAMES_TOPIC, FRAMES_TYPE, data, time_ns, time_ns)


def _strip_frame(geometry: DoorGeometry, strip: Strip) -> StandingFrame:
    mounts = {mount.element: mount for mount in geometry.mounts if mount.strip is strip}
    first, last = mounts[0], mounts[SENSORS_PER_STRIP - 1]
    begin, end = (_along_wall(geometry, mount.reach) for mount in (first, last))
    place = (first.x, (begin + end) / 2, geometry.lintel_height)
    turn = _DOWN_TO_LEFT if end > begin else _DOWN_TO_RIGHT
    return StandingFrame(frame_name(Signal.of_strip(strip)), place, turn)


def _along_wall(geometry: DoorGeometry, reach: float) -> float:
    return geometry.doorway_width / 2 - reach


_KEPT = Qos(durability=Durability.TRANSIENT_LOCAL)
_LARGEST_JITTER = 0.2
"""As a fraction of the period between two readings."""
_PUBLISHING_NS = 50_000
"""ns from a reading to its publication."""
_LEAST_LATENCY = 0.0003
_MEAN_EXTRA_LATENCY = 0.0002
_LARGEST_EXTRA_LATENCY = 0.003
_LONGEST_BACKLOG = 60.0
"""s of messages to catch up with; after a longer sleep of the machine they are lost."""


class SimulatedSource(Source):
    """A simulated testbed on the engine's clock.

    The robot sets out when a run starts: a published state with the phase `countdown` or `running`
    names the instant, `idle` or `ready` sends it back for the next run. A mapping that cannot be
    simulated raises MadrobError.
    """

    kind = SourceKind.SIMULATED

    def __init__(
        self,
        testbed: SimulatedTestbed | None,
        clock: Clock,
        types: MessageTypes,
        mappings: Sequence[TopicMapping] = DEFAULT_MAPPINGS,
    ) -> None:
        self.testbed = testbed or SimulatedTestbed()
        self._clock = clock
        signals = self.testbed.signals
        self._mappings = tuple(m for m in mappings if m.signal in signals)
        if len({mapping.signal for mapping in self._mappings}) < len(self._mappings):
            raise MadrobError(
                "four topics a strip cannot be simulated; simulate the default topics"
            )
        self._streams = tuple(_Stream(m, types, self.testbed) for m in self._mappings)
        self._topics = (
            *(describe_topic(types, m.topic, m.type) for m in self._mappings),
            describe_topic(types, FRAMES_TOPIC, FRAMES_TYPE, _KEPT),
            *referee_topics(types),
        )
        self._types = types
        self._announcement = Announcement(str(self.testbed.scenario))
        self._opened = False
        self._closed = False

    @property
    def label(self) -> str:
        return f"SIMULATED {self.testbed.scenario}"

    def open(self) -> None:
        if not self._opened:
            self._opened = True
            now, geometry = self._clock.now_ns(), self.testbed.geometry
            frames = encode_frames(self._types, geometry, now)
            self._announcement = replace(self._announcement, messages=(frames,))
            self._switch_on()

    def take_messages(self, timeout: float) -> list[RawMessage]:
        self._clock.sleep(timeout)
        if not self._opened or self._closed:
            return []
        now = self._clock.now_ns()
        if not self._in_step(now):
            self._switch_on()
        sent = (message for stream in self._streams for message in stream.until(now))
        return sorted(sent, key=attrgetter("receive_ns"))

    def topics(self) -> Sequence[Topic]:
        return self._topics

    def status(self) -> Sequence[TopicStatus]:
        publishers = int(self._opened and not self._closed)
        return tuple(TopicStatus(m.topic, m.type, publishers) for m in self._mappings)

    def configure(self, condition: Condition) -> None:
        self.testbed.condition = condition

    @property
    def announcement(self) -> Announcement:
        return self._announcement

    def publish(self, message: RawMessage) -> None:
        if message.topic == REFEREE_STATE_TOPIC:
            self.heed(parse_state(decode_text(self._types, message.data)))
        elif message.topic == REFEREE_START_POSE_TOPIC:
            pose = self._types.decode(message.type, message.data).pose
            self.testbed.start_distance = abs(pose.position.x)

    def heed(self, state: RefereeState) -> None:
        if state.phase in ("idle", "ready") or state.held:
            self.testbed.reset()
        if state.condition is not None:
            self.testbed.condition = state.condition
        if state.phase in ("countdown", "running") and state.start_time is not None:
            self.testbed.start(nanoseconds(state.start_time))

    def close(self) -> None:
        self._closed = True

    def _switch_on(self) -> None:
        now = self._clock.now_ns()
        for stream in self._streams:
            stream.begin(now)

    def _in_step(self, now: int) -> bool:
        """Whether the clock has not been stepped away from the next message."""
        due = min((stream.due_ns for stream in self._streams), default=now)
        return now - nanoseconds(_LONGEST_BACKLOG) < due < now + nanoseconds(1.0)


class _Stream:
    def __init__(
        self, mapping: TopicMapping, types: MessageTypes, testbed: SimulatedTestbed
    ) -> None:
        self._mapping = mapping
        rate = testbed.sensors.rate
        scan = scan_angles(testbed.geometry) | {"scan_time": 1 / rate}
        self._encoder = Encoder(mapping, types, frame_name(mapping.signal), scan)
        self._testbed = testbed
        self._rng = Random(f"{testbed.seed}/timing/{mapping.signal.name}")
        # One of its own, so that what is lost changes no reading and no stamp.
        self._loss_rng = Random(f"{testbed.seed}/network/{mapping.signal.name}")
        self._period = nanoseconds(1 / rate)
        self._phase = self._rng.randrange(self._period)
        self._nominal = 0
        self._stamp_ns = 0
        self.due_ns = 0

    def begin(self, now: int) -> None:
        self._nominal, self.due_ns = now + self._phase, now
        self._draw()

    def until(self, now: int) -> list[RawMessage]:
        messages = []
        while self.due_ns <= now:
            message = self._message()
            if self._loss_rng.random() >= self._testbed.loss:
                messages.append(message)
            self._nominal += self._period
            self._draw()
        return messages

    def _message(self) -> RawMessage:
        signal = self._mapping.signal
        reading = self._testbed.read(signal, self._stamp_ns)
        return RawMessage(
            self._mapping.topic,
            self._mapping.type,
            self._encoder.encode(self._stamp_ns, reading),
            self._stamp_ns + _PUBLISHING_NS,
            self.due_ns,
        )

    def _draw(self) -> None:
        largest = round(_LARGEST_JITTER * self._period)
        jitter = nanoseconds(self._rng.gauss(0.0, self._testbed.sensors.jitter))
        extra = min(_LARGEST_EXTRA_LATENCY, self._rng.expovariate(1 / _MEAN_EXTRA_LATENCY))
        self._stamp_ns = self._nominal + max(-largest, min(largest, jitter))
        received = self._stamp_ns + nanoseconds(_LEAST_LATENCY + extra)
        self.due_ns = max(received, self.due_ns + 1)
