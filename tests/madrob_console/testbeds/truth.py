"""What truly happens in a simulated run: its plan, looked at every millisecond.

By the protocol's words (sections 4 and 7), with the testbed's measures as numbers. Neither the
detector nor the simulated sensors have a part in it: slow, plain, and of its own mind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from madrob_console.common.clock import seconds
from madrob_console.testbeds.simulated import DoorGeometry, MotionPlan
from madrob_console.testbeds.simulated.testbed import SimulatedTestbed
from scoring.protocol import (
    PASSAGE_SENSORS,
    Event,
    EventName,
    Outcome,
    PassageSensor,
    Side,
    Thresholds,
)

STEP = 0.001
Flags = NDArray[np.bool_]
Times = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Truth:
    """A run as it truly is.

    Attributes:
        events: all of them, in order; times in s, since the start or absolute.
        steps: when each step that was done was done, in order.
        outcome: `COMPLETED` or `TIMEOUT`.
        stop: when the run stops.
    """

    events: tuple[Event, ...]
    steps: tuple[float, ...]
    outcome: Outcome
    stop: float

    @property
    def capability_level(self) -> int:
        """How many steps are done."""
        return len(self.steps)


def truth_of(plan: MotionPlan, geometry: DoorGeometry, timeout: float, start: float = 0.0) -> Truth:
    """The truth of a run of `plan`; a latch sensor decides steps 2 and 6 where there is one.

    Args:
        plan: what the robot does.
        geometry: where.
        timeout: s after which the run ends.
        start: the instant from which `plan` counts, s.
    """
    seen = Sight(plan, geometry)
    completed = seen.completed(timeout)
    stop = timeout if completed is None else completed
    return Truth(
        tuple(Event(start + time, name) for time, name in seen.events(stop)),
        tuple(start + time for time in seen.steps(stop, completed)),
        Outcome.TIMEOUT if completed is None else Outcome.COMPLETED,
        start + stop,
    )


def truth_of_testbed(testbed: SimulatedTestbed, timeout: float = 300.0) -> Truth | None:
    """The truth of the run that a testbed was started with, in s since the epoch; None before."""
    if testbed.plan is None:
        return None
    return truth_of(testbed.plan, testbed.geometry, timeout, seconds(testbed.start_ns))


class Sight:
    """What can be seen of a plan, every millisecond until nothing moves any more."""

    def __init__(self, plan: MotionPlan, geometry: DoorGeometry) -> None:
        self.plan = plan
        self.time: Times = np.arange(0.0, plan.end + 2 * STEP, STEP)
        resolution = 2 * np.pi / geometry.thresholds.encoder_counts
        opening = np.array([plan.opening(t) for t in self.time])
        reading = np.rint(opening / resolution) * resolution
        self.open: Flags = reading >= 0.03
        self.touch: Flags = np.abs([plan.contact(t) for t in self.time]) > 1.96133
        self.latched: Flags = np.array([plan.latched(t) for t in self.time], dtype=bool)
        x = np.array([plan.robot.at(t) for t in self.time])
        self.sensors = {s: self._sensor(s, reading, x, geometry) for s in PASSAGE_SENSORS}
        self.sides = {
            side: np.any([f for s, f in self.sensors.items() if s.side is side], axis=0)
            for side in Side
        }

    def _sensor(self, sensor: PassageSensor, reading: Times, x: Times, g: DoorGeometry) -> Flags:
        thresholds, body = Thresholds(), self.plan.body
        upper = thresholds.mask_to_cw if sensor.side is Side.CW else thresholds.mask_to_ccw
        masked = (
            (sensor.side is self.plan.condition.opening_side)
            & (reading > thresholds.mask_from[sensor.index])
            & (reading < upper[sensor.index])
        )
        # index 0 hangs farthest from the hinge, half a spacing from the jamb
        reach = 0.9375 - 0.125 * sensor.index
        beside = abs(0.5 + body.shift - reach) < body.width / 2 + g.beam_radius
        where = 0.175 if sensor.side is Side.CCW else -0.175
        under = np.abs(x - where) < body.length / 2 + g.beam_radius
        present: Flags = beside & under & np.full(len(self.time), body.height > 0.5)
        last_look = np.maximum.accumulate(np.where(masked, 0, np.arange(len(self.time))))
        state: Flags = present[last_look]
        return state

    def edges(self, flags: Flags, *, rising: bool) -> Times:
        """When flags rise or fall, s."""
        change = np.diff(flags.astype(int), prepend=int(flags[0]))
        found: Times = self.time[change == (1 if rising else -1)]
        return found

    def first(self, flags: Flags, since: float = 0.0) -> float | None:
        """The first instant from `since` on at which a flag is up, s."""
        found = self.time[flags & (self.time >= since - STEP / 2)]
        return float(found[0]) if len(found) else None

    def at(self, flags: Flags, time: float) -> bool:
        return bool(flags[min(round(time / STEP), len(flags) - 1)])

    def through(self) -> Flags:
        """Whether step 4 is done while the run goes on."""
        goal = self.plan.condition.destination_side
        fell = np.zeros(len(self.time), dtype=int)
        for sensor, flags in self.sensors.items():
            falls = np.diff(flags.astype(int), prepend=0) == -1
            fell[falls] = 1 if sensor.side is goal else -1
        last = np.maximum.accumulate(np.where(fell != 0, np.arange(len(fell)), 0))
        result: Flags = ~self.sides[goal.opposite] & (self.sides[goal] | (fell[last] == 1))
        return result

    def early_steps(self) -> list[float]:
        """The times of steps 1 to 3, as far as they come."""
        times: list[float] = []
        touched = self.first(self.touch)
        if touched is None:
            return times
        times.append(touched)
        unlocked = touched
        if self.plan.latch is not None:
            found = self.first(~self.latched, touched)
            if found is None:
                return times
            unlocked = found
            times.append(unlocked)
        opened = self.first(self.open, unlocked)
        if opened is not None:
            times += [opened] if self.plan.latch is not None else [opened, opened]
        return times

    def completed(self, timeout: float) -> float | None:
        """When step 6 is done, if the run completes."""
        early = self.early_steps()
        if len(early) < 3:
            return None
        done_5 = ~self.open & self.through() & (self.time >= early[2])
        starts = self.edges(done_5, rising=True)
        ends = [*self.edges(done_5, rising=False), np.inf]
        for start in starts[starts <= timeout]:
            end = next(e for e in ends if e > start)
            if self.plan.latch is None and end - start >= 1.0:
                return float(start)
            locked = self.first(self.latched, float(start))
            inside = locked is not None and locked <= min(end, timeout)
            if self.plan.latch is not None and inside:
                return locked
        return None

    def steps(self, stop: float, completed: float | None) -> list[float]:
        """When each step is done, as far as they come in order until the stop."""
        done = [time for time in self.early_steps() if time <= stop]
        moves = self.moves(stop)
        arrives = EventName.moves_to(self.plan.condition.destination_side)
        if len(done) < 3 or moves is None or moves[1] is not arrives or moves[0] < done[2]:
            return done
        done.append(moves[0])
        if not self.at(self.open, stop):
            closings = self.edges(self.open, rising=False)
            done.append(max(float(closings[closings <= stop + STEP / 2][-1]), moves[0]))
            done += [] if completed is None else [completed]
        return done

    def moves(self, stop: float) -> tuple[float, EventName] | None:
        """When and to which side the robot leaves."""
        goal = self.plan.condition.destination_side
        there, here = self.at(self.sides[goal], stop), self.at(self.sides[goal.opposite], stop)
        if there and here:
            cleared = self.first(~self.sides[goal.opposite], stop)
            kept = self.first(~self.sides[goal], stop)
            soon = cleared is not None and cleared <= stop + 1.0
            reached = soon and (kept is None or cleared is None or cleared < kept)
            return stop, EventName.moves_to(goal if reached else goal.opposite)
        if there or here:
            return stop, EventName.moves_to(goal if there else goal.opposite)
        falls = [fall for fall in self._edges_of_sensors(rising=False) if fall[0] <= stop]
        if not falls:
            return None
        time, side = max(falls, key=lambda fall: fall[0])
        return time, EventName.moves_to(side)

    def _edges_of_sensors(self, *, rising: bool) -> list[tuple[float, Side]]:
        return [
            (float(time), sensor.side)
            for sensor, flags in self.sensors.items()
            for time in self.edges(flags, rising=rising)
        ]

    def events(self, stop: float) -> list[tuple[float, EventName]]:
        """Every event of a run stopped at `stop`, in order."""
        kinds = [
            (self.open, True, EventName.DOOR_OPENS),
            (self.open, False, EventName.DOOR_CLOSES),
            (self.latched, False, EventName.DOOR_IS_UNLOCKED),
            (self.latched, True, EventName.DOOR_IS_LOCKED),
        ]
        found = [
            (float(time), name)
            for flags, rising, name in kinds
            for time in self.edges(flags, rising=rising)
        ]
        touched = self.first(self.touch)
        if touched is not None:
            found.append((touched, EventName.HANDLE_IS_TOUCHED))
        if rises := self._edges_of_sensors(rising=True):
            time, side = min(rises, key=lambda rise: rise[0])
            found.append((time, EventName.approaches(side)))
        moves = self.moves(stop)
        if moves is not None:
            found.append(moves)
        inside = sorted(event for event in found if event[0] <= stop + STEP / 2)
        return [(0.0, EventName.BENCHMARK_START), *inside, (stop, EventName.BENCHMARK_STOP)]
