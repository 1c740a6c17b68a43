"""From samples to events, one sample at a time (protocol section 4).

The same detector serves the live view and the scoring of a recording. Samples come in the order of
their stamps.
"""

from __future__ import annotations

import math
from itertools import zip_longest

from scoring.edges import BinarySignal, DecidingEdge, Edge, EdgeKind, edges_until
from scoring.procedure import Evidence
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
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample


class EventDetector:
    """Finds the events of one run; the (planned) `start` in s since the epoch, `handle_zero` in N.

    Attributes:
        changes: grows with all that changes events or evidence, except for `door_seen`.
        angle: the newest door angle, rad; None before the first.
    """

    def __init__(
        self,
        condition: Condition,
        start: float,
        thresholds: Thresholds,
        handle_zero: float = 0.0,
    ) -> None:
        self._condition = condition
        self._start = start
        self._thresholds = thresholds
        self._zero = handle_zero
        self.changes = 0
        self.angle: float | None = None
        self._door_seen: float | None = None
        self._door = BinarySignal()
        self._touch = BinarySignal()
        self._sensors = {sensor: BinarySignal() for sensor in PASSAGE_SENSORS}
        self._of_strip = {
            strip: tuple((s, self._sensors[s]) for s in PASSAGE_SENSORS if s.strip is strip)
            for strip in Strip
        }
        masks = thresholds.mask_to_cw + thresholds.mask_to_ccw
        self._masked_angles = min(thresholds.mask_from), max(masks)  # elsewhere none is masked
        self._newest_fall: tuple[float, bool] | None = None  # and whether on the destination side
        self._crossed_since: float | None = None
        self._latch: list[Edge] = []
        self._latch_before_start = False

    @property
    def door_is_open(self) -> bool | None:
        return self._door.state

    @property
    def latch_engaged(self) -> bool | None:
        return self._latch[-1].value if self._latch else None

    @property
    def occupied(self) -> dict[PassageSensor, bool | None]:
        """Whether something is under each used sensor, or None where not known yet."""
        return {sensor: level.state for sensor, level in self._sensors.items()}

    def presences(self) -> dict[PassageSensor, tuple[tuple[float, float], ...]]:
        """Rises and falls since the start, s since the epoch.

        An unseen fall is inf.
        """
        return {
            sensor: tuple(
                (rise.time, fall.time if fall else math.inf)
                for rise, fall in zip_longest(level.edges[::2], level.edges[1::2])
            )
            for sensor, level in self._sensors.items()
        }

    def feed(self, sample: Sample) -> None:
        """Take the next sample. Values that are no reading change nothing."""
        match sample:
            case DoorSample():
                self._feed_door(sample)
            case HandleSample():
                if abs(sample.force) <= self._thresholds.impossible_force:
                    touched = abs(sample.force - self._zero) > self._thresholds.touch_force
                    self.changes += self._touch.update(sample.time, touched, self._start)
            case PassageSample():
                self._feed_passage(sample)
            case LatchSample():
                self._feed_latch(sample)

    def _feed_door(self, sample: DoorSample) -> None:
        if abs(sample.angle) <= self._thresholds.largest_angle:
            self.angle = sample.angle
            self._door_seen = sample.time
            is_open = abs(sample.angle) >= self._thresholds.closed_angle
            self.changes += self._door.update(sample.time, is_open, self._start)

    def _feed_passage(self, sample: PassageSample) -> None:
        angle = self.angle or 0.0
        nearest, farthest = self._masked_angles
        passing = nearest < abs(angle) < farthest
        in_range, thresholds = all_in_range(sample), self._thresholds
        for sensor, level in self._of_strip[sample.strip]:
            if passing and thresholds.masked(sensor.side, sensor.index, angle):
                continue
            if not (in_range or is_reading(sample, sensor.element)):
                continue
            height = thresholds.lintel_height - sample.ranges[sensor.element]
            if level.update(sample.time, height > thresholds.present_height, self._start):
                self.changes += 1
                if level.edges and level.edges[-1] == (sample.time, False):
                    fall = (sample.time, sensor.side is self._condition.destination_side)
                    self._newest_fall = max(fall, self._newest_fall or fall)
                self._follow_crossing(sample.time)

    def _follow_crossing(self, time: float) -> None:
        """Section 7, "while the run goes on": keep since when step 4 holds."""
        occupied = {sensor.side for sensor, level in self._sensors.items() if level.state}
        fell_there = self._newest_fall is not None and self._newest_fall[1]
        if self._condition.starting_side in occupied or not (occupied or fell_there):
            self._crossed_since = None
        elif self._crossed_since is None:
            self._crossed_since = max(time, self._start)

    def _feed_latch(self, sample: LatchSample) -> None:
        if sample.time < self._start:
            self._latch_before_start = True
            self.changes += 1
            self._latch = [Edge(self._start, sample.engaged)]
        elif self.latch_engaged is not sample.engaged:
            self.changes += 1
            self._latch.append(Edge(sample.time, sample.engaged))

    def evidence(self, stop: float | None = None) -> Evidence:
        """Return what is known of the steps, live (`stop` None) or of a run stopped at `stop`."""
        crossed = self._crossed_since
        if stop is not None:
            self._begin(stop)
            left = self._leaves(stop)
            reached = left is not None and left[1] is self._condition.destination_side
            crossed = left[0] if left is not None and reached else None
        return Evidence(
            start=self._start,
            stop=stop,
            touched=self._first_touch(stop),
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
            self._begin(stop)
        events = [Event(self._start, EventName.BENCHMARK_START)]
        touch = self._first_touch(stop)
        if touch is not None:
            events.append(Event(touch, EventName.HANDLE_IS_TOUCHED))
        since = -newest if newest else 0
        for edge in self._door.edges[since:]:
            name = EventName.DOOR_OPENS if edge.value else EventName.DOOR_CLOSES
            events.append(Event(edge.time, name))
        events += self.latch_events(since)
        if (rise := self._first_rise()) is not None:
            events.append(Event(rise[0], EventName.approaches(rise[1].side)))
        if (left := self._leaves(stop)) is not None:
            events.append(Event(left[0], EventName.moves_to(left[1])))
        if stop is not None:
            events = [event for event in events if event.time <= stop]
            events.append(
                Event(stop, EventName.BENCHMARK_STOP)
            )  # after what happens at its instant
        return tuple(sorted(events, key=lambda event: event.time))

    def latch_events(self, since: int = 0) -> list[Event]:
        """Return what the latch did from `since` on, after the first state that it told."""
        names = {True: EventName.DOOR_IS_LOCKED, False: EventName.DOOR_IS_UNLOCKED}
        return [Event(edge.time, names[edge.value]) for edge in self._latch[1:][since:]]

    def deciding(self, stop: float | None = None) -> tuple[DecidingEdge, ...]:
        """The edges on which the indicators depend (section 11), live or as of the stop."""
        end = math.inf if stop is None else stop
        found = []
        touch = self._first_touch(end)
        if touch is not None:
            found.append(DecidingEdge(EdgeKind.TOUCH, Signal.HANDLE, touch))
        if (opening := self._opening(touch)) is not None:
            found.append(DecidingEdge(EdgeKind.OPENING, Signal.DOOR, opening))
        count = edges_until(self._door.edges, end)
        if count > 1 and not self._door.edges[count - 1].value:
            time = self._door.edges[count - 1].time
            found.append(DecidingEdge(EdgeKind.CLOSING, Signal.DOOR, time))
        if (rise := self._first_rise()) is not None:
            signal = Signal.of_strip(rise[1].strip)
            found.append(DecidingEdge(EdgeKind.ARRIVAL, signal, rise[0]))
        if (left := self._leaves(stop)) is not None:
            found.append(DecidingEdge(EdgeKind.DEPARTURE, self._seen_by(*left), left[0]))
        locked = [edge.time for edge in self._latch[1:] if edge.value and edge.time <= end]
        if locked:
            found.append(DecidingEdge(EdgeKind.LOCKING, Signal.LATCH, locked[-1]))
        return tuple(edge for edge in found if edge.time <= end)

    def _first_touch(self, end: float | None) -> float | None:
        if not self._touch.edges:
            return None
        time = self._touch.edges[0].time  # the first edge of a level is a rise
        return None if end is not None and time > end else time

    def _opening(self, touch: float | None) -> float | None:
        """The opening by which the door was open after the touch."""
        edges = self._door.edges
        count = 0 if touch is None else edges_until(edges, touch)
        since = count - 1 if count and edges[count - 1].value else count
        return next((edge.time for edge in edges[since : since + 2] if edge.value), None)

    def _first_rise(self) -> tuple[float, PassageSensor] | None:
        rises = [(v.edges[0].time, sensor) for sensor, v in self._sensors.items() if v.edges]
        return min(rises, key=lambda rise: rise[0], default=None)

    def _last_fall(self, end: float) -> tuple[float, Side] | None:
        """Return the last fall, of two at one instant that on the destination side."""
        falls = []
        for sensor, level in self._sensors.items():
            count = edges_until(level.edges, end)
            if count and level.edges[count - 1].value:
                count -= 1
            if count:
                on_destination = sensor.side is self._condition.destination_side
                falls.append((level.edges[count - 1].time, on_destination))
        if not falls:
            return None
        time, reached = max(falls)
        condition = self._condition
        return time, condition.destination_side if reached else condition.starting_side

    def _leaves(self, stop: float | None) -> tuple[float, Side] | None:
        """Return when and on which side the robot left the doorway (section 7, "at the stop")."""
        if stop is None:
            occupied = any(level.state for level in self._sensors.values())
            return None if occupied else self._last_fall(math.inf)
        present = [side for side in Side if self._clear_time(side, stop) > stop]
        if not present:
            return self._last_fall(stop)
        if len(present) == 1:
            return stop, present[0]
        # Both are occupied: the robot leaves on the side that it clears last.
        starting, destination = self._condition.starting_side, self._condition.destination_side
        if self._clear_time(starting, stop) < self._clear_time(destination, stop):
            return stop, destination
        return stop, starting

    def _clear_time(self, side: Side, time: float) -> float:
        """Return when `side` is first clear from `time` on.

        inf = not before the recording ends.
        """
        levels = [level for sensor, level in self._sensors.items() if sensor.side is side]
        times = [e.time for level in levels for e in level.edges if e.time > time]
        for instant in (time, *sorted(times)):
            if not any(level.at(instant) for level in levels):
                return instant
        return math.inf

    def _seen_by(self, time: float, side: Side) -> Signal:
        """The strip that saw the robot leave: one whose sensor fell then, else one under it."""
        by_side = sorted(self._sensors.items(), key=lambda item: item[0].side is not side)
        for sensor, level in by_side:
            if Edge(time, False) in level.edges:
                return Signal.of_strip(sensor.strip)
        under = (sensor for sensor, level in by_side if level.at(time))
        return Signal.of_strip(next(under).strip)

    def _begin(self, stop: float) -> None:
        """Signals that were up at the start rise there, even if they never spoke again."""
        if stop >= self._start:  # else it ended in the countdown
            for level in (self._door, self._touch, *self._sensors.values()):
                level.begin_run(self._start)
