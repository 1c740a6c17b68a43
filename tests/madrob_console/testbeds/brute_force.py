"""The truth of a plan by looking at it every millisecond: slow, plain, and of its own mind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from madrob_console.testbeds.simulated import DoorGeometry, MotionPlan
from scoring.protocol import PASSAGE_SENSORS, EventName, PassageSensor, Side, Thresholds

STEP = 0.001
Flags = NDArray[np.bool_]


class BruteForce:
    """What can be seen of a plan, every millisecond up to `horizon` (s)."""

    def __init__(self, plan: MotionPlan, geometry: DoorGeometry, horizon: float) -> None:
        self.plan = plan
        self.time = np.arange(0.0, horizon, STEP)
        resolution = 2 * np.pi / geometry.encoder_counts
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

    def _sensor(
        self, sensor: PassageSensor, reading: NDArray[np.float64], x: object, g: DoorGeometry
    ) -> Flags:
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
        under = np.abs(np.asarray(x) - where) < body.length / 2 + g.beam_radius
        present: Flags = beside & under & np.full(len(self.time), body.height > 0.5)
        last_look = np.maximum.accumulate(np.where(masked, 0, np.arange(len(self.time))))
        state: Flags = present[last_look]
        return state

    def edges(self, flags: Flags, *, rising: bool) -> NDArray[np.float64]:
        """When flags rise or fall, s."""
        change = np.diff(flags.astype(int), prepend=int(flags[0]))
        found: NDArray[np.float64] = self.time[change == (1 if rising else -1)]
        return found

    def first(self, flags: Flags, since: float = 0.0) -> float | None:
        """The first instant from `since` on at which a flag is up, s."""
        found = self.time[flags & (self.time >= since - STEP / 2)]
        return float(found[0]) if len(found) else None

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

    def moves(self, stop: float) -> tuple[float, EventName] | None:
        """When and to which side the robot leaves."""
        goal = self.plan.condition.destination_side
        now = round(stop / STEP)
        there, here = bool(self.sides[goal][now]), bool(self.sides[goal.opposite][now])
        if there and here:
            cleared = self.first(~self.sides[goal.opposite], stop)
            kept = self.first(~self.sides[goal], stop)
            soon = cleared is not None and cleared <= stop + 1.0
            reached = soon and (kept is None or cleared is None or cleared < kept)
            return stop, EventName.moves_to(goal if reached else goal.opposite)
        if there or here:
            return stop, EventName.moves_to(goal if there else goal.opposite)
        falls = [
            (float(t), sensor.side)
            for sensor, flags in self.sensors.items()
            for t in self.edges(flags, rising=False)
            if t <= stop
        ]
        if not falls:
            return None
        time, side = max(falls, key=lambda fall: fall[0])
        return time, EventName.moves_to(side)

    def events(self, stop: float) -> list[tuple[float, EventName]]:
        """Every event of a run stopped at `stop`."""
        found = [(0.0, EventName.BENCHMARK_START), (stop, EventName.BENCHMARK_STOP)]
        touched = self.first(self.touch)
        if touched is not None:
            found.append((touched, EventName.HANDLE_IS_TOUCHED))
        kinds = [
            (self.open, True, EventName.DOOR_OPENS),
            (self.open, False, EventName.DOOR_CLOSES),
            (self.latched, False, EventName.DOOR_IS_UNLOCKED),
            (self.latched, True, EventName.DOOR_IS_LOCKED),
        ]
        for flags, rising, name in kinds:
            found += [(float(t), name) for t in self.edges(flags, rising=rising)]
        rises = [
            (float(t), sensor.side)
            for sensor, flags in self.sensors.items()
            for t in self.edges(flags, rising=True)
        ]
        if rises:
            time, side = min(rises, key=lambda rise: rise[0])
            found.append((time, EventName.approaches(side)))
        moves = self.moves(stop)
        if moves is not None:
            found.append(moves)
        return sorted(event for event in found if event[0] <= stop + STEP)
