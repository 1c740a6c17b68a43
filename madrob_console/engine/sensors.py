"""The testbed as it is now: newest values, freshness, rates, clock skew."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from madrob_console.engine.snapshot import DoorView, HandleView, LatchView, SensorView, TopicView
from madrob_console.referee.health import Freshness, Health
from madrob_console.testbeds.messages import TopicMapping
from madrob_console.testbeds.source import TopicStatus
from recorder.message import RawMessage
from scoring.events import EventDetector
from scoring.protocol import (
    PASSAGE_SENSORS,
    BenchmarkType,
    Condition,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

_ANY_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)


@dataclass(frozen=True, slots=True)
class SensorLimits:
    """What counts as healthy.

    Attributes:
        fresh: up to this age a topic is fresh, s.
        lost: above this age it is lost, s.
        rate: the testbed's rate, Hz.
        least_rate, most_rate: healthy fractions of it.
        skew: largest abs(stamp - log time), s.
        averaging: the handle zero is the mean over this long, s.
    """

    fresh: float = 0.5
    lost: float = 2.0
    rate: float = 50.0
    least_rate: float = 0.8
    most_rate: float = 3.0
    skew: float = 0.1
    averaging: float = 1.0


class Sensors:
    """Follows every sample of the testbed, in a run or not.

    Args:
        mappings: the configured topics.
        thresholds: the testbed's numbers.
        limits: what counts as healthy.
    """

    def __init__(
        self, mappings: Sequence[TopicMapping], thresholds: Thresholds, limits: SensorLimits
    ) -> None:
        self.limits = limits
        self._mappings = tuple(mappings)
        self._thresholds = thresholds
        self._health = {m.topic: Health(limits.fresh, limits.lost) for m in mappings}
        self._topic_of = {m.signal: m.topic for m in mappings}
        self._received: Counter[str] = Counter()
        self._errors: dict[str, str] = {}
        self._force: float | None = None
        self._forces: deque[tuple[float, float]] = deque()
        self._skews: deque[tuple[float, float]] = deque()
        self._newest: dict[Signal, Sample] = {}
        self._heights: dict[tuple[Strip, int], float | None] = {}
        # A start that never comes: this detector only keeps states.
        self._states = EventDetector(_ANY_CONDITION, math.inf, thresholds)

    def receive(self, message: RawMessage, sample: Sample | None, error: str | None) -> None:
        """A message arrived; `sample` is what it says, `error` why it cannot be decoded."""
        health = self._health.get(message.topic)
        if health is None:
            return
        now = message.receive_ns / 1e9
        self._received[message.topic] += 1
        health.seen(now)
        if error is not None:
            self._errors[message.topic] = error
            return
        self._errors.pop(message.topic, None)
        if sample is None:
            return
        self._states.feed(sample)
        self._newest[sample.signal] = sample
        self._keep(self._skews, now, abs(sample.time - sample.log_time))
        match sample:
            case HandleSample() if math.isfinite(sample.force):
                self._force = sample.force
                self._keep(self._forces, now, sample.force)
            case PassageSample():
                for element, distance in enumerate(sample.ranges):
                    height = self._thresholds.lintel_height - distance
                    usable = sample.range_min <= distance <= sample.range_max
                    self._heights[sample.strip, element] = height if usable else None
            case DoorSample() | LatchSample() | HandleSample():
                pass

    def _keep(self, values: deque[tuple[float, float]], now: float, value: float) -> None:
        if values and now < values[-1][0]:
            values.clear()  # the clock was stepped back
        values.append((now, value))
        while values[0][0] < now - self.limits.averaging:
            values.popleft()

    def newest(self) -> tuple[Sample, ...]:
        """The newest sample of each signal."""
        return tuple(self._newest.values())

    def freshness(self, signal: Signal, now: float) -> Freshness:
        """State of the topic that delivers a signal."""
        topic = self._topic_of.get(signal)
        return self._health[topic].freshness(now) if topic else Freshness.NEVER

    def _fresh(self, signal: Signal, now: float) -> bool:
        return self.freshness(signal, now) is Freshness.FRESH

    def angle(self, now: float) -> float | None:
        """Door angle, rad; None unless fresh."""
        return self._states.angle if self._fresh(Signal.DOOR, now) else None

    def force(self, now: float) -> float | None:
        """Raw handle force, N; None unless fresh."""
        return self._force if self._fresh(Signal.HANDLE, now) else None

    def handle_mean(self, now: float) -> float | None:
        """Mean raw handle force of the last second, N; None unless fresh."""
        recent = [force for time, force in self._forces if time >= now - self.limits.averaging]
        if not recent or not self._fresh(Signal.HANDLE, now):
            return None
        return math.fsum(recent) / len(recent)

    def skew(self, now: float) -> float | None:
        """Largest abs(stamp - log time) of the last second, s; None without samples."""
        recent = [skew for time, skew in self._skews if time >= now - self.limits.averaging]
        return max(recent, default=None)

    def occupied(self, now: float) -> tuple[str, ...] | None:
        """Names of the used sensors that see something; None if one of them says nothing."""
        if any(not self._fresh(Signal.of_strip(s), now) for s in Strip):
            return None
        states = self._states.occupied
        if None in states.values():
            return None
        return tuple(f"{s.side} {s.index}" for s, state in states.items() if state)

    def topic_problems(self, statuses: Sequence[TopicStatus], now: float) -> tuple[str, ...]:
        """One line per topic that is missing, stale, off its rate or not decodable."""
        views = self.topics(statuses, {}, now)
        return tuple(f"{v.topic}: {v.problem}" for v in views if v.problem)

    def topics(
        self, statuses: Sequence[TopicStatus], dropped: dict[str, int], now: float
    ) -> tuple[TopicView, ...]:
        """Every configured topic; `dropped` counts what the recorder had to drop."""
        by_topic = {status.topic: status for status in statuses}
        return tuple(
            self._topic(m, by_topic.get(m.topic), dropped.get(m.topic, 0), now)
            for m in self._mappings
        )

    def _topic(
        self, mapping: TopicMapping, status: TopicStatus | None, dropped: int, now: float
    ) -> TopicView:
        health = self._health[mapping.topic]
        optional = mapping.signal is Signal.LATCH
        view = TopicView(
            topic=mapping.topic,
            type=status.type if status else mapping.type,
            publishers=status.publishers if status else 0,
            freshness=health.freshness(now),
            age=health.age(now),
            rate=health.rate(now),
            received=self._received[mapping.topic],
            lost=status.lost if status else None,
            dropped=dropped,
            optional=optional,
            problem=None,
        )
        problem = status.problem if status else None
        problem = problem or self._errors.get(mapping.topic) or self._trouble(view)
        return replace(view, problem=problem)

    def _trouble(self, view: TopicView) -> str | None:
        if view.freshness is Freshness.NEVER:
            if view.optional:
                return None
            return "nothing received: no publisher" if not view.publishers else "nothing received"
        if view.publishers > 1:
            return f"{view.publishers} publishers: keep one"
        if view.freshness is not Freshness.FRESH:
            return None if view.optional else f"{view.freshness}, silent for {view.age:.1f} s"
        if view.optional or view.rate is None:
            return None
        if view.rate < self.limits.least_rate * self.limits.rate:
            return f"only {view.rate:.0f} Hz of {self.limits.rate:.0f} Hz"
        if view.rate > self.limits.most_rate * self.limits.rate:
            return f"{view.rate:.0f} Hz, far above {self.limits.rate:.0f} Hz"
        return None

    def door_view(self, now: float) -> DoorView:
        """The panel."""
        fresh = self._fresh(Signal.DOOR, now)
        return DoorView(
            angle=self.angle(now),
            is_open=self._states.door_is_open if fresh else None,
            freshness=self.freshness(Signal.DOOR, now),
            closed_angle=self._thresholds.closed_angle,
        )

    def handle_view(self, now: float, zero: float, maximum: float | None) -> HandleView:
        """The handle; `maximum` is the largest abs(force) of the run so far, N."""
        freshness = self.freshness(Signal.HANDLE, now)
        force = self.force(now)
        return HandleView(force, zero, self._thresholds.touch_force, maximum, freshness)

    def latch_view(self, now: float) -> LatchView:
        """The latch."""
        freshness = self.freshness(Signal.LATCH, now)
        known = freshness in (Freshness.FRESH, Freshness.STALE)
        return LatchView(self._states.latch_engaged if known else None, freshness)

    def passage_view(self, now: float) -> tuple[SensorView, ...]:
        """The ten used passage sensors."""
        angle = self._states.angle
        states = self._states.occupied
        views = []
        for sensor in PASSAGE_SENSORS:
            freshness = self.freshness(Signal.of_strip(sensor.strip), now)
            masked = angle is not None and self._thresholds.masked(sensor.side, sensor.index, angle)
            known = freshness is Freshness.FRESH
            views.append(
                SensorView(
                    side=sensor.side,
                    index=sensor.index,
                    occupied=states[sensor] if known else None,
                    masked=masked,
                    height=self._heights.get((sensor.strip, sensor.element)) if known else None,
                    freshness=freshness,
                )
            )
        return tuple(views)
