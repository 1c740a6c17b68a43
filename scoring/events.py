"""From samples to events, one sample at a time (protocol section 4).

The same detector serves the live view and the scoring of a recording. Samples of one signal come
in the order of their stamps; signals are joined by their stamps, whichever comes first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from scoring.deciding_edges import (
    DecidingEdge,
    EdgeKind,
    departure,
    door_edges,
    first_rise,
    passage_edge,
)
from scoring.panel_angles import PanelAngles
from scoring.protocol import (
    PASSAGE_SENSORS,
    Condition,
    Event,
    EventName,
    PassageSensor,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.quality import all_in_range, is_reading
from scoring.rulesets import PROTOCOL, Ruleset
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample
from scoring.signals import BinarySignal, Edge


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the sensors say about the six steps (section 7); times in s since the epoch.

    Read it before the next sample is fed: edges are not copied, a flickering signal has thousands.

    Attributes:
        door: opening (True) and closing edges.
        door_seen: time of the newest door sample.
        latch: states from the start on, the one at the start included.
        latch_before_start: whether the latch delivered a value before the start.
        crossed: live, since when the crossing holds; after the stop, the time of
            `humanoid_moves_to_<destination>_side`.
    """

    start: float
    stop: float | None
    touched: float | None
    door: Sequence[Edge]
    door_seen: float | None
    latch: Sequence[Edge]
    latch_before_start: bool
    crossed: float | None


class EventDetector:
    """Finds the events of one run; the (planned) `start` in s since the epoch, `handle_zero` in N.

    Attributes:
        changes: grows with all that changes events or evidence, except for `door_seen`.
        on_passage: called with each passage sample once it counts, and the door angle, rad, by
            which it was masked.
    """

    def __init__(
        self,
        condition: Condition,
        start: float,
        thresholds: Thresholds,
        ruleset: Ruleset = PROTOCOL,
        handle_zero: float = 0.0,
    ) -> None:
        self._starting, self._destination = condition.starting_side, condition.destination_side
        self._start = start
        self._thresholds = thresholds
        self._ruleset = ruleset
        self._zero = handle_zero
        self.changes = 0
        self.on_passage: Callable[[PassageSample, float], None] | None = None
        self._lintel = thresholds.lintel_height
        self._present_height = ruleset.present_height or thresholds.present_height
        masks = thresholds.mask_to_cw + thresholds.mask_to_ccw
        self._masked_angles = min(thresholds.mask_from), max(masks)  # elsewhere none is masked
        self._angle: float | None = None
        self.angles = PanelAngles(self._join_passage)
        self._door_seen: float | None = None
        self._largest_angle = ruleset.largest_angle(thresholds)
        self._largest_force = ruleset.largest_force(thresholds)
        self._door = BinarySignal()
        self._touch = BinarySignal()
        self._sensors = {s: BinarySignal() for s in PASSAGE_SENSORS}
        self._of_strip = {
            strip: tuple((s, self._sensors[s]) for s in PASSAGE_SENSORS if s.strip is strip)
            for strip in Strip
        }
        self._occupied = dict.fromkeys(Side, 0)  # so many sensors of each side have something below
        # a fall: when, and whether on the destination side, whose fall counts of two at one instant
        self._falls: list[tuple[float, bool]] = []
        self._newest_fall: tuple[float, bool] | None = None
        self._crossed_since: float | None = None
        self._newest_change = start
        self._latch: list[Edge] = []
        self._latch_events: list[Event] = []
        self._latch_before_start = False
        self._latch_seen: float | None = None

    @property
    def angle(self) -> float | None:
        """The newest door angle, rad; None before the first."""
        return self._angle

    @property
    def door_is_open(self) -> bool | None:
        return self._door.state

    @property
    def latch_engaged(self) -> bool | None:
        return self._latch[-1].value if self._latch else None

    @property
    def occupied(self) -> dict[PassageSensor, bool | None]:
        """For each used sensor, whether something is under it; None = not known yet."""
        return {sensor: level.state for sensor, level in self._sensors.items()}

    def presences(self) -> dict[PassageSensor, tuple[tuple[float, float], ...]]:
        """Rises and falls since the start, s since the epoch; an unseen fall is inf."""
        return {
            sensor: tuple(
                (rise.time, fall.time if fall else math.inf)
                for rise, fall in zip_longest(level.edges[::2], level.edges[1::2])
            )
            for sensor, level in self._sensors.items()
        }

    def under(self, strip: Strip) -> Iterator[tuple[PassageSensor, bool | None]]:
        return ((sensor, level.state) for sensor, level in self._of_strip[strip])

    def feed(self, sample: Sample) -> None:
        """Take the next sample. Values that are no reading change nothing."""
        self.angles.end_waits(sample.log_time)
        match sample:
            case PassageSample():
                self.angles.add_passage(sample)
            case DoorSample():
                self._feed_door(sample)
            case HandleSample():
                if abs(sample.force) <= self._largest_force:
                    touched = abs(sample.force - self._zero) > self._thresholds.touch_force
                    self.changes += self._touch.update(sample.time, touched, self._start)
            case LatchSample():
                self._feed_latch(sample)

    def _feed_door(self, sample: DoorSample) -> None:
        if not abs(sample.angle) <= self._largest_angle:
            return
        self._angle = sample.angle
        self._door_seen = sample.time
        self.angles.add_door(sample)
        is_open = abs(sample.angle) >= self._thresholds.closed_angle
        self.changes += self._door.update(sample.time, is_open, self._start)

    def finish(self) -> None:
        """The recording has ended: passage samples wait for no later door angle."""
        self.angles.end_waits(math.inf)

    def _join_passage(self, sample: PassageSample, angle: float) -> None:
        nearest, farthest = self._masked_angles
        passing = nearest < abs(angle) < farthest
        in_range, lintel, highest = all_in_range(sample), self._lintel, self._present_height
        for sensor, level in self._of_strip[sample.strip]:
            if passing and self._thresholds.masked(sensor.side, sensor.index, angle):
                if not self._ruleset.masked_is_absent:
                    continue
                present = False
            elif in_range or is_reading(sample, sensor.element):
                present = lintel - sample.ranges[sensor.element] > highest
            else:
                continue
            edges_before, before = len(level.edges), level.state
            if level.update(sample.time, present, self._start):
                self.changes += 1
                self._occupied[sensor.side] += bool(level.state) - bool(before)
                if level.state is not before or len(level.edges) > edges_before:
                    self._follow_sensor(sensor, level.edges[edges_before:], sample.time)
        if self.on_passage is not None:
            self.on_passage(sample, angle)

    def _follow_sensor(self, sensor: PassageSensor, edges: Sequence[Edge], time: float) -> None:
        for edge in edges:
            if not edge.value:
                fall = (edge.time, sensor.side is self._destination)
                self._falls.append(fall)
                if self._newest_fall is None or fall > self._newest_fall:
                    self._newest_fall = fall
        self._newest_change = max(self._newest_change, edges[-1].time if edges else time)
        self._follow_crossing(self._newest_change)

    def _follow_crossing(self, time: float) -> None:
        """Section 7, "while the run goes on": keep since when step 4 holds."""
        fall, occupied = self._newest_fall, self._occupied
        fell_there = fall is not None and fall[1]
        holds = not occupied[self._starting] and (fell_there or occupied[self._destination] > 0)
        if not holds:
            self._crossed_since = None
        elif self._crossed_since is None:
            self._crossed_since = time

    def _feed_latch(self, sample: LatchSample) -> None:
        previous, before = self.latch_engaged, self._latch_seen
        engaged = bool(sample.engaged)
        self._latch_seen = sample.time
        if sample.time < self._start:
            self._latch_before_start = True
            self.changes += 1
            self._latch = [Edge(self._start, engaged)]
            return
        if previous is engaged:
            return
        self.changes += 1
        self._latch.append(Edge(sample.time, engaged, before))
        if previous is not None:
            name = EventName.DOOR_IS_LOCKED if engaged else EventName.DOOR_IS_UNLOCKED
            self._latch_events.append(Event(sample.time, name))

    def evidence(self, stop: float | None = None) -> Evidence:
        """What is known about the steps, live (`stop` None) or for a run stopped at `stop`."""
        if stop is not None:
            self._begin()
        touch = next((e.time for e in self._touch.edges if e.value), None)
        crossed = self._crossed_since
        if stop is not None:
            left = self._leaves(stop)
            reached = left is not None and left[1] is self._destination
            crossed = left[0] if left is not None and reached else None
            touch = touch if touch is not None and touch <= stop else None
        return Evidence(
            start=self._start,
            stop=stop,
            touched=touch,
            door=self._door.edges,
            door_seen=self._door_seen,
            latch=self._latch,
            latch_before_start=self._latch_before_start,
            crossed=crossed,
        )

    def events(self, stop: float | None = None, *, newest: int | None = None) -> tuple[Event, ...]:
        """The events by time, live (`stop` None) or of a run stopped at `stop`, s since the epoch.

        Live, there is no `benchmark_stop`, and the last fall stands as
        `humanoid_moves_to_<side>_side` once nothing is under the sensors. `newest` limits those of
        door and latch for screens: a flickering one has many.
        """
        if stop is not None:
            self._begin()
        end = math.inf if stop is None else stop
        events = [Event(self._start, EventName.BENCHMARK_START)]
        touch = next((e.time for e in self._touch.edges if e.value), None)
        if touch is not None:
            events.append(Event(touch, EventName.HANDLE_IS_TOUCHED))
        since = -newest if newest else 0
        events += [
            Event(e.time, EventName.DOOR_OPENS if e.value else EventName.DOOR_CLOSES)
            for e in self._door.edges[since:]
        ]
        events += self._latch_events[since:]
        passage_end = math.inf if self._ruleset.passage_events_to_end else end
        passage = self._passage_events(stop)
        in_time = [e for e in events if e.time <= end] + [
            e for e in passage if e.time <= passage_end
        ]
        if stop is not None:
            in_time.append(
                Event(stop, EventName.BENCHMARK_STOP)
            )  # after what happens at its instant
        return tuple(sorted(in_time, key=lambda e: e.time))

    def deciding(self, stop: float | None = None) -> tuple[DecidingEdge, ...]:
        """The edges on which the indicators depend (section 11), live or as of the stop."""
        end = math.inf if stop is None else stop
        candidates: list[DecidingEdge | None] = [
            first_rise(EdgeKind.TOUCH, Signal.HANDLE, self._touch, end),
            *door_edges(self._door, self._touch, end),
        ]
        rises = [(v.edges[0].time, s) for s, v in self._sensors.items() if v.edges]
        if rises:
            time, sensor = min(rises, key=lambda rise: rise[0])
            arrival = passage_edge(EdgeKind.ARRIVAL, self._sensors, sensor, time)
            candidates.append(replace(arrival, also=self._ruleset.capability.arrival_decides))
        locked = next((e for e in reversed(self._latch) if e.value and e.time <= end), None)
        if locked is not None and locked.since is not None:
            # a latch that publishes changes only is sampled at the nominal rate in between
            since = max(locked.since, locked.time - 1 / self._thresholds.rate)
            often = self._thresholds.doubt.least_readings
            candidates.append(
                DecidingEdge(EdgeKind.LOCKING, Signal.LATCH, locked.time, since, often)
            )
        edges = [edge for edge in candidates if edge is not None and edge.time <= end]
        left = self._leaves(stop)
        last = None if left is None else departure(self._sensors, *left)
        return tuple(edges) if last is None else (*edges, last)

    def _passage_events(self, stop: float | None) -> list[Event]:
        rises = [
            (level.edges[0].time, sensor.side)
            for sensor, level in self._sensors.items()
            if level.edges  # the first edge of a level is a rise
        ]
        events = []
        if rises:
            time, side = min(rises, key=lambda rise: rise[0])
            events.append(Event(time, EventName.approaches(side)))
        left = self._leaves(stop)
        if left is not None:
            events.append(Event(left[0], EventName.moves_to(left[1])))
        return events

    def _leaves(self, stop: float | None) -> tuple[float, Side] | None:
        """When and on which side the robot left the doorway (section 7, "at the stop")."""
        if self._ruleset.passage_events_to_end:
            return self._left(self._newest_fall)
        if stop is None:
            return None if any(self._occupied.values()) else self._left(self._newest_fall)
        starting, destination = self._starting, self._destination
        at_stop = {side: self._occupied_at(side, stop) for side in Side}
        if all(at_stop.values()):
            cleared = {side: self._cleared_after(side, stop) for side in Side}
            through = cleared[starting] < cleared[destination]
            return (stop, destination if through else starting)
        for side in Side:
            if at_stop[side]:
                return (stop, side)
        return self._left(max((fall for fall in self._falls if fall[0] <= stop), default=None))

    def _left(self, fall: tuple[float, bool] | None) -> tuple[float, Side] | None:
        return fall and (fall[0], self._destination if fall[1] else self._starting)

    def _occupied_at(self, side: Side, time: float) -> bool:
        return any(level.at(time) for s, level in self._sensors.items() if s.side is side)

    def _cleared_after(self, side: Side, time: float) -> float:
        """When `side` is first clear after `time`; inf = not before the recording ends."""
        levels = [level for s, level in self._sensors.items() if s.side is side]
        times = sorted(e.time for level in levels for e in level.edges if e.time > time)
        return next((t for t in times if not any(level.at(t) for level in levels)), math.inf)

    def _begin(self) -> None:
        """Signals that were up at the start rise there, even if they never spoke again."""
        for level in (self._door, self._touch, *self._sensors.values()):
            level.begin_run(self._start)
