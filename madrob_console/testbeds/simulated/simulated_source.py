"""The simulated testbed as a source: the same bytes on the same topics as a real one."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from random import Random

from madrob_console.common.clock import Clock, nanoseconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.messages.codec import (
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    decode_text,
    describe_topic,
    referee_topics,
)
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.announcement import Announcement
from madrob_console.testbeds.simulated.encoder import Encoder
from madrob_console.testbeds.simulated.sensor_frames import (
    frame_name,
    scan_angles,
)
from madrob_console.testbeds.simulated.testbed import RefereeState, SimulatedTestbed, parse_state
from madrob_console.testbeds.source import Source, TopicStatus
from recorder.bag import RawMessage, Topic
from scoring.protocol import Condition

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
