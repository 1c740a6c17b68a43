"""The simulated testbed as a source: the same bytes on the same topics as a real one."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from random import Random

from madrob_console.clock import Clock, nanoseconds
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    MessageTypes,
    TopicMapping,
    decode_text,
    describe_topic,
    referee_topics,
)
from madrob_console.testbeds.announcement import Announcement
from madrob_console.testbeds.outside import Outside
from madrob_console.testbeds.simulated.encoding import Encoder
from madrob_console.testbeds.simulated.frames import (
    FRAMES_TOPIC,
    FRAMES_TYPE,
    encode_frames,
    frame_name,
    scan_angles,
)
from madrob_console.testbeds.simulated.referee_state import RefereeState, parse_state
from madrob_console.testbeds.simulated.testbed import SimulatedTestbed
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import Durability, Qos, Topic
from recorder.message import RawMessage
from scoring.protocol import Condition

_KEPT = Qos(durability=Durability.TRANSIENT_LOCAL)
_LARGEST_JITTER = 0.2
"""Of the period between two readings."""
_PUBLISHING_NS = 50_000
"""From a reading to its publication."""
_LEAST_LATENCY = 0.0003
_MEAN_EXTRA_LATENCY = 0.0002
_LARGEST_EXTRA_LATENCY = 0.003
_LONGEST_BACKLOG = 60.0
"""s of messages to catch up with; after a longer sleep of the machine they are lost."""


class SimulatedSource:
    """A simulated testbed that lives on the engine's clock.

    The robot sets out when a run starts: a published state with the phase `countdown` or
    `running` names the instant, `idle` or `ready` sends it back for the next run.

    Args:
        testbed: the model; None = a nominal one.
        clock: real, scaled or virtual.
        types: the types known.
        mappings: topics, types and units; those of the protocol by default.

    Raises:
        MadrobError: a mapping names a type or a field that cannot be simulated.
    """

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
        self._streams = tuple(_Stream(m, types, self.testbed) for m in self._mappings)
        self._topics = (
            *(describe_topic(types, m.topic, m.type) for m in self._mappings),
            describe_topic(types, FRAMES_TOPIC, FRAMES_TYPE, _KEPT),
            *referee_topics(types),
        )
        self._types = types
        self._in_flight: list[RawMessage] = []
        self._problem: str | None = None
        self._announcement = Announcement(str(self.testbed.scenario))
        self._opened = False
        self._closed = False

    @property
    def kind(self) -> SourceKind:
        """Where the messages come from."""
        return SourceKind.SIMULATED

    @property
    def label(self) -> str:
        """For people: `SIMULATED nominal`."""
        return f"SIMULATED {self.testbed.scenario}"

    def open(self) -> None:
        """Switch the sensors on."""
        if not self._opened:
            self._opened = True
            now, geometry = self._clock.now_ns(), self.testbed.geometry
            frames = encode_frames(self._types, geometry, now)
            self._announcement = replace(self._announcement, messages=(frames,))
            self._switch_on()

    def take(self, timeout: float) -> list[RawMessage]:
        """Messages since the last call, by receive time; `timeout` s of clock time pass."""
        self._clock.sleep(timeout)
        if not self._opened or self._closed:
            return []
        now = self._clock.now_ns()
        if not self._in_step(now):
            self._switch_on()
        sent = [message for stream in self._streams for message in stream.until(now)]
        messages = sorted((*self._in_flight, *sent), key=_receive_ns)
        arrived = bisect_right(messages, now, key=_receive_ns)
        self._in_flight = messages[arrived:]
        return messages[:arrived]

    def topics(self) -> Sequence[Topic]:
        """The testbed's topics and the console's own."""
        return self._topics

    def status(self) -> Sequence[TopicStatus]:
        """The state of every topic."""
        publishers = int(self._opened and not self._closed)
        return tuple(
            TopicStatus(m.topic, m.type, publishers, problem=self._problem) for m in self._mappings
        )

    def configure(self, condition: Condition) -> None:
        """Set the testbed for a condition."""
        self.testbed.set_condition(condition)

    @property
    def sides_problem(self) -> str | None:
        """Nothing has to be set by hand."""
        return None

    @property
    def announcement(self) -> Announcement:
        """Its scenario, and where its sensors are."""
        return self._announcement

    @property
    def other_referee(self) -> str | None:
        """Nobody: it belongs to its engine."""
        return None

    def publish(self, message: RawMessage) -> None:
        """Nobody listens but the testbed and its robot, who heed state and start pose."""
        if message.topic == REFEREE_STATE_TOPIC:
            self.heed(parse_state(decode_text(self._types, message.data)))
        elif message.topic == REFEREE_START_POSE_TOPIC:
            pose = self._types.decode(message.type, message.data).pose
            self.testbed.set_start_distance(abs(pose.position.x))

    def attend(self, outside: Outside) -> None:
        """Nobody asks: it belongs to its engine."""

    def heed(self, state: RefereeState) -> None:
        """Do what testbed and robot do in a state of the run."""
        if state.phase in ("idle", "ready"):
            self.testbed.reset()
        if state.condition is not None:
            self.testbed.set_condition(state.condition)
        if state.phase in ("countdown", "running") and state.start_time is not None:
            self._start(nanoseconds(state.start_time))

    def close(self) -> None:
        """Switch the sensors off; safe to call twice."""
        self._closed = True

    def _start(self, start_ns: int) -> None:
        try:
            self.testbed.start(start_ns)
            self._problem = None
        except MadrobError as error:
            self._problem = str(error)

    def _switch_on(self) -> None:
        now = self._clock.now_ns()
        self._in_flight = []
        for stream in self._streams:
            stream.begin(now)

    def _in_step(self, now: int) -> bool:
        """Whether the clock has not been stepped away from what comes next."""
        due = min((stream.due_ns for stream in self._streams), default=now)
        return now - nanoseconds(_LONGEST_BACKLOG) < due < now + nanoseconds(1.0)


class _Stream:
    """The messages of one topic, one after the other."""

    def __init__(
        self, mapping: TopicMapping, types: MessageTypes, testbed: SimulatedTestbed
    ) -> None:
        self._mapping = mapping
        rate = testbed.sensors.rate
        scan = scan_angles(testbed.geometry) | {"scan_time": 1 / rate}
        self._encoder = Encoder(mapping, types, frame_name(mapping.signal), scan)
        self._testbed = testbed
        self._rng = Random(f"{testbed.seed}/timing/{mapping.signal.name}")
        # One of its own, so that a slow network changes no reading and no stamp.
        self._network_rng = Random(f"{testbed.seed}/network/{mapping.signal.name}")
        self._period = nanoseconds(1 / rate)
        self._phase = self._rng.randrange(self._period)
        self._nominal = 0
        self._stamp_ns = 0
        self._receive_ns = 0
        self.due_ns = 0

    def begin(self, now: int) -> None:
        """Start, or start anew, at `now`."""
        self._nominal, self.due_ns, self._receive_ns = now + self._phase, now, now
        self._draw()

    def until(self, now: int) -> list[RawMessage]:
        """What has been sent by `now` since the last call; a slow network delivers it later."""
        messages = []
        while self.due_ns <= now:
            messages.append(self._message())
            self._nominal += self._period
            self._draw()
        return messages

    def _message(self) -> RawMessage:
        signal = self._mapping.signal
        reading = self._testbed.read(signal, self._stamp_ns)
        delay = nanoseconds(self._testbed.network.delay(signal, self._network_rng))
        self._receive_ns = max(self.due_ns + delay, self._receive_ns + 1)
        return RawMessage(
            self._mapping.topic,
            self._mapping.type,
            self._encoder.encode(self._stamp_ns, reading),
            self._stamp_ns + _PUBLISHING_NS,
            self._receive_ns,
        )

    def _draw(self) -> None:
        """Draw when the next reading is taken, and received where the network is not slow."""
        largest = round(_LARGEST_JITTER * self._period)
        jitter = nanoseconds(self._rng.gauss(0.0, self._testbed.sensors.jitter))
        extra = min(_LARGEST_EXTRA_LATENCY, self._rng.expovariate(1 / _MEAN_EXTRA_LATENCY))
        self._stamp_ns = self._nominal + max(-largest, min(largest, jitter))
        received = self._stamp_ns + nanoseconds(_LEAST_LATENCY + extra)
        self.due_ns = max(received, self.due_ns + 1)


def _receive_ns(message: RawMessage) -> int:
    return message.receive_ns
