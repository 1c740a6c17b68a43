"""The testbed as it is now: newest values, freshness, rates, clock skew, faults."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from madrob_console.engine.core.topic_watch import TopicWatch
from madrob_console.engine.snapshot import (
    DoorView,
    HandleView,
    LatchView,
    Recent,
    SensorView,
    TopicView,
)
from madrob_console.messages.mapping import STRIPS, TopicMapping
from madrob_console.referee.records import FaultKind, merged
from madrob_console.referee.topic_health import Freshness, SensorLimits
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import RawMessage
from scoring.events import EventDetector
from scoring.protocol import (
    PASSAGE_SENSORS,
    BenchmarkType,
    Condition,
    PassageSensor,
    Side,
    Signal,
    Thresholds,
)
from scoring.rest import FEWEST_SAMPLES, HandleRest, rest_of
from scoring.samples import HandleSample, PassageSample, Sample

_ANY_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)


class Sensors:
    """Follows every sample of the testbed, in a run or not."""

    def __init__(
        self, mappings: Sequence[TopicMapping], thresholds: Thresholds, limits: SensorLimits
    ) -> None:
        self.limits = limits
        self._mappings = tuple(mappings)
        self._thresholds = thresholds
        self._watches = {m.topic: TopicWatch(m, limits, thresholds) for m in mappings}
        self._of_signal = {watch.signal: watch for watch in self._watches.values()}
        self._forces: deque[tuple[float, float]] = deque()
        self._newest: dict[Signal, Sample] = {}
        # A start that never comes: this detector only keeps states.
        self._states = EventDetector(_ANY_CONDITION, math.inf, thresholds)

    def note_arrival(self, message: RawMessage) -> None:
        if (watch := self._watches.get(message.topic)) is not None:
            watch.note_arrival(message.receive_ns / 1e9)

    def note_absence(self, message: RawMessage, name: str) -> None:
        """Note a message that lacks the named element: it is another sensor's."""
        if (watch := self._watches.get(message.topic)) is not None:
            watch.absent = name

    def receive(self, message: RawMessage, sample: Sample | None, problem: str | None) -> None:
        """Take a message, its sample, and why that is missing, to be doubted or without reading."""
        watch = self._watches.get(message.topic)
        if watch is None:
            return
        now = message.receive_ns / 1e9
        if problem is not None:
            problem = problem.removeprefix(f"{message.topic}: ")
        watch.receive(now, sample, problem, self._states.angle or 0.0)
        if sample is None:
            return
        self._states.feed(sample)
        self._newest[watch.signal] = sample
        if (
            isinstance(sample, HandleSample)
            and abs(sample.force) <= self._thresholds.impossible_force
        ):
            if self._forces and now < self._forces[-1][0]:
                self._forces.clear()  # the clock was stepped back
            self._forces.append((now, sample.force))
            while self._forces[0][0] < now - self.limits.averaging:
                self._forces.popleft()

    def newest(self) -> tuple[Sample, ...]:
        return tuple(self._newest.values())

    def freshness(self, signal: Signal, now: float) -> Freshness:
        """State of a signal, by its newest reading: a message without a reading does not count.

        What a latch said stays fresh if it speaks only when it changes.
        """
        watch = self._of_signal.get(signal)
        if signal is Signal.LATCH and watch and watch.received and not watch.is_regular:
            return Freshness.FRESH
        return watch.readings.freshness(now) if watch else Freshness.NEVER

    def _fresh(self, signal: Signal, now: float) -> bool:
        return self.freshness(signal, now) is Freshness.FRESH

    def _sensor_freshness(self, sensor: PassageSensor, masked: bool, now: float) -> Freshness:
        watch = self._of_signal.get(Signal.of_strip(sensor.strip))
        if watch is None:
            return Freshness.NEVER
        return (watch.messages if masked else watch.sensors[sensor]).freshness(now)

    def _masked(self, sensor: PassageSensor) -> bool:
        return self._thresholds.masked(sensor.side, sensor.index, self._states.angle or 0.0)

    def angle(self, now: float) -> float | None:
        """Door angle, rad; None unless fresh."""
        return self._states.angle if self._fresh(Signal.DOOR, now) else None

    def force(self, now: float) -> float | None:
        """Raw handle force, N; None unless fresh."""
        return self._forces[-1][1] if self._fresh(Signal.HANDLE, now) else None

    def handle_rest(self, now: float) -> HandleRest | None:
        """Raw handle force of the last second, by the time of reception; None unless fresh."""
        recent = [each for each in self._forces if each[0] >= now - self.limits.averaging]
        if not recent or not self._fresh(Signal.HANDLE, now):
            return None
        began = recent[-1][0] - recent[0][0] < self.limits.averaging / 2
        if began and len(recent) < FEWEST_SAMPLES:
            return None
        return rest_of(*zip(*recent, strict=True))

    def skew(self, now: float, of_topic: Callable[..., float] = max) -> float | None:
        """The largest of the topics' `TopicWatch.skew`, s, with its sign; None without samples."""
        skews = (watch.skew(now, of_topic) for watch in self._watches.values())
        return max((skew for skew in skews if skew is not None), key=abs, default=None)

    def occupied(self, now: float) -> tuple[str, ...] | None:
        """Names of the used sensors that detect something; None if one of them has no reading."""
        states = self._states.occupied
        for sensor, state in states.items():
            freshness = self._sensor_freshness(sensor, self._masked(sensor), now)
            if freshness is not Freshness.FRESH or state is None:
                return None
        return tuple(f"{s.side} {s.index}" for s, state in states.items() if state)

    def unread_range(self, now: float) -> str | None:
        """Why a used passage sensor has no reading now; None = it is not known, or all have one."""
        for signal in STRIPS:
            watch = self._of_signal.get(signal)
            if watch is not None and (words := watch.missing(now)) is not None:
                return f"{signal.value}: {words}"
        return None

    def _recent(self, signal: Signal, now: float) -> Recent:
        watch = self._of_signal.get(signal)
        return watch.recent(now) if watch else ()

    def topic_faults(self, statuses: Sequence[TopicStatus], now: float) -> tuple[str, ...]:
        """What is wrong with the topics now, one line for each cause."""
        faults = self.faults(statuses, now)
        return tuple(merged((name, words) for (name, _), words in faults.items()))

    def topics(
        self, statuses: Sequence[TopicStatus], dropped: Mapping[str, int], now: float
    ) -> tuple[TopicView, ...]:
        by_topic = {status.topic: status for status in statuses}
        shown = []
        for mapping in self._mappings:
            topic, watch = mapping.topic, self._watches[mapping.topic]
            status = by_topic.get(topic) or TopicStatus(topic, mapping.type, 0, lost=None)
            shown.append(
                TopicView(
                    topic=topic,
                    type=status.type,
                    publishers=status.publishers,
                    freshness=watch.messages.freshness(now),
                    age=watch.messages.age(now),
                    rate=watch.messages.rate(now),
                    received=watch.received,
                    lost=status.lost,
                    dropped=dropped.get(topic, 0),
                    optional=mapping.signal.optional,
                    problem="; ".join(watch.faults(status, now).values()) or None,
                )
            )
        return tuple(shown)

    def faults(
        self, statuses: Sequence[TopicStatus], now: float
    ) -> dict[tuple[str, FaultKind], str]:
        by_topic = {status.topic: status for status in statuses}
        return {
            (watch.signal.value, fault): words
            for topic, watch in self._watches.items()
            for fault, words in watch.faults(by_topic.get(topic), now).items()
        }

    def door_view(self, now: float) -> DoorView:
        fresh = self._fresh(Signal.DOOR, now)
        return DoorView(
            angle=self.angle(now),
            is_open=self._states.door_is_open if fresh else None,
            freshness=self.freshness(Signal.DOOR, now),
            closed_angle=self._thresholds.closed_angle,
            recent=self._recent(Signal.DOOR, now),
        )

    def handle_view(self, now: float, zero: float, maximum: float | None) -> HandleView:
        """`maximum` is the largest abs(force) of the run so far, N."""
        touch, freshness = self._thresholds.touch_force, self.freshness(Signal.HANDLE, now)
        recent = self._recent(Signal.HANDLE, now)
        return HandleView(self.force(now), zero, touch, maximum, freshness, recent)

    def latch_view(self, now: float) -> LatchView:
        freshness = self.freshness(Signal.LATCH, now)
        is_known = freshness in (Freshness.FRESH, Freshness.STALE)
        return LatchView(self._states.latch_engaged if is_known else None, freshness)

    def passage_view(self, now: float) -> tuple[SensorView, ...]:
        states = self._states.occupied
        views = []
        for sensor in PASSAGE_SENSORS:
            masked = self._masked(sensor)
            freshness = self._sensor_freshness(sensor, masked, now)
            is_known = freshness is Freshness.FRESH
            views.append(
                SensorView(
                    side=sensor.side,
                    index=sensor.index,
                    occupied=states[sensor] if is_known else None,
                    masked=masked,
                    height=self._height(sensor) if is_known else None,
                    freshness=freshness,
                )
            )
        return tuple(views)

    def _height(self, sensor: PassageSensor) -> float | None:
        """Height of what is under a sensor, m above the ground; None where it measured none."""
        sample = self._newest.get(Signal.of_strip(sensor.strip))
        if not isinstance(sample, PassageSample) or sensor.element >= len(sample.ranges):
            return None
        distance = sample.ranges[sensor.element]
        usable = sample.range_min <= distance <= sample.range_max
        return self._thresholds.lintel_height - distance if usable else None
