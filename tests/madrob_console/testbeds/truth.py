"""What truly happens in a simulated run, by the protocol's words (sections 4 and 7).

Derived from the plan by way of `Perception`; the detector has no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from madrob_console.common.clock import seconds
from madrob_console.testbeds.simulated.geometry import DoorGeometry, MotionPlan
from madrob_console.testbeds.simulated.sensor_model import Perception, Switch, observe
from madrob_console.testbeds.simulated.testbed import SimulatedTestbed
from scoring.protocol import POST_ROLL, Condition, Event, EventName, Outcome, Side, Step


@dataclass(frozen=True, slots=True)
class Truth:
    """A run as it truly is.

    Attributes:
        condition: under which it went.
        events: all of them, in order; times in s, since the start or absolute.
        steps: (step, time) of every step done, in order.
        outcome: `COMPLETED` or `TIMEOUT`.
        stop: when the run stops.
    """

    condition: Condition
    events: tuple[Event, ...]
    steps: tuple[tuple[Step, float], ...]
    outcome: Outcome
    stop: float

    @property
    def capability_level(self) -> int:
        """How many steps are done."""
        return len(self.steps)

    def since(self, start: float) -> Truth:
        """The same with times counted from another origin: `start` s later."""
        return replace(
            self,
            events=tuple(Event(event.time + start, event.name) for event in self.events),
            steps=tuple((step, time + start) for step, time in self.steps),
            stop=self.stop + start,
        )


def truth_of(
    plan: MotionPlan,
    geometry: DoorGeometry,
    timeout: float = 300.0,
    *,
    latch_decides: bool | None = None,
) -> Truth:
    """The truth of a run of `plan`, in s since its start.

    Args:
        plan: what the robot does.
        geometry: where.
        timeout: s after which the run ends.
        latch_decides: whether the latch sensor decides steps 2 and 6; None = where there is one.
    """
    sensor = plan.latch is not None if latch_decides is None else latch_decides
    return _Truth(plan.condition, observe(plan, geometry), geometry, timeout, sensor).derive()


def truth_of_testbed(testbed: SimulatedTestbed, timeout: float = 300.0) -> Truth | None:
    """The truth of the run that a testbed was started with, in s since the epoch; None before.

    Args:
        testbed: where the robot plays.
        timeout: s after the start at which the run ends.
    """
    if testbed.plan is None:
        return None
    truth = truth_of(testbed.plan, testbed.geometry, timeout)
    return truth.since(seconds(testbed.start_ns))


def _first(switch: Switch, value: bool, since: float) -> float | None:
    """The first instant at or after `since` at which a switch has `value`; None = never."""
    if switch.at(since) is value:
        return since
    return next((t for t, state in switch.changes if t > since and state is value), None)


def _exactly(value: Callable[[float], bool], instants: Iterable[float]) -> Switch:
    """The switch of a function that changes at some of `instants`, and is asked there."""
    state, changes = False, []
    for time in sorted(set(instants)):
        new = value(time)
        if new is not state:
            state = new
            changes.append((time, state))
    return Switch(False, tuple(changes))


def _side_occupied(seen: Perception, side: Side) -> Switch:
    """Whether any used sensor of a side is occupied."""
    switches = [switch for sensor, switch in seen.occupied.items() if sensor.side is side]
    instants = {time for switch in switches for time in switch.instants}
    return _exactly(lambda time: any(s.at(time) for s in switches), instants)


def _edges(seen: Perception, *, rising: bool) -> list[tuple[float, Side]]:
    """Every rise or every fall of a used sensor with its side, in order."""
    return sorted(
        (time, sensor.side)
        for sensor, switch in seen.occupied.items()
        for time, value in switch.changes
        if value is rising
    )


class _Truth:
    """One derivation; its methods are the protocol's sentences."""

    def __init__(
        self,
        condition: Condition,
        seen: Perception,
        geometry: DoorGeometry,
        timeout: float,
        latch_decides: bool,
    ) -> None:
        self.condition = condition
        self.seen = seen
        self.settle = geometry.thresholds.settle_time
        self.timeout = timeout
        self.latch = seen.latched if latch_decides else None
        self.sides = {side: _side_occupied(seen, side) for side in Side}
        self.rises = _edges(seen, rising=True)
        self.falls = _edges(seen, rising=False)

    def derive(self) -> Truth:
        stop = self.completed_at()
        outcome = Outcome.TIMEOUT if stop is None else Outcome.COMPLETED
        if stop is None:
            stop = self.timeout
        moves = self.moves(stop)
        return Truth(
            self.condition,
            tuple(self.events(stop, moves)),
            tuple(self.steps(stop, moves)),
            outcome,
            stop,
        )

    def opened_at(self) -> tuple[float, float, float] | None:
        """The times of steps 1 to 3, whenever they come."""
        touched = self.seen.touched
        if touched is None:
            return None
        unlocked = _first(self.latch, False, touched) if self.latch else touched
        if unlocked is None:
            return None
        opened = _first(self.seen.door_open, True, unlocked)
        if opened is None:
            return None
        return touched, unlocked if self.latch else opened, opened

    def through(self, time: float) -> bool:
        """Whether step 4 is done while the run goes on."""
        if self.sides[self.condition.starting_side].at(time):
            return False
        falls = [side for fall, side in self.falls if fall <= time]
        goal = self.condition.destination_side
        return self.sides[goal].at(time) or (bool(falls) and falls[-1] is goal)

    def completed_at(self) -> float | None:
        """The time of step 6, if the run completes."""
        first = self.opened_at()
        if first is None:
            return None
        instants = [*self.seen.door_open.instants, *(t for t, _ in self.rises + self.falls)]
        done_5 = _exactly(self._closed_and_through, [t for t in instants if t >= first[-1]])
        for start, is_done in done_5.changes:
            if is_done and start <= self.timeout:
                done = self._locked_between(start, _first(done_5, False, start) or math.inf)
                if done is not None:
                    return done
        return None

    def _closed_and_through(self, time: float) -> bool:
        return not self.seen.door_open.at(time) and self.through(time)

    def _locked_between(self, start: float, end: float) -> float | None:
        """When step 6 is done in a stretch in which step 5 stays done."""
        if self.latch is None:
            return start if end - start >= self.settle else None
        locked = _first(self.latch, True, start)
        return locked if locked is not None and locked <= min(end, self.timeout) else None

    def moves(self, stop: float) -> Event | None:
        """The last fall, with what is still occupied at the stop (section 7, last part)."""
        start, goal = self.condition.starting_side, self.condition.destination_side
        if self.sides[start].at(stop) and self.sides[goal].at(stop):
            left = _first(self.sides[start], False, stop)
            kept = _first(self.sides[goal], False, stop)
            reached = (
                left is not None and left <= stop + POST_ROLL and (kept is None or left < kept)
            )
            return Event(stop, EventName.moves_to(goal if reached else start))
        for side in (start, goal):
            if self.sides[side].at(stop):
                return Event(stop, EventName.moves_to(side))
        falls = [(time, side) for time, side in self.falls if time <= stop]
        return Event(falls[-1][0], EventName.moves_to(falls[-1][1])) if falls else None

    def events(self, stop: float, moves: Event | None) -> list[Event]:
        found = []
        if self.seen.touched is not None:
            found.append(Event(self.seen.touched, EventName.HANDLE_IS_TOUCHED))
        for time, is_open in self.seen.door_open.changes:
            found.append(Event(time, EventName.DOOR_OPENS if is_open else EventName.DOOR_CLOSES))
        if self.rises:
            found.append(Event(self.rises[0][0], EventName.approaches(self.rises[0][1])))
        for time, engaged in self.seen.latched.changes if self.seen.latched else ():
            name = EventName.DOOR_IS_LOCKED if engaged else EventName.DOOR_IS_UNLOCKED
            found.append(Event(time, name))
        if moves is not None:
            found.append(moves)
        inside = sorted((event for event in found if event.time <= stop), key=lambda e: e.time)
        return [
            Event(0.0, EventName.BENCHMARK_START),
            *inside,
            Event(stop, EventName.BENCHMARK_STOP),
        ]

    def steps(self, stop: float, moves: Event | None) -> list[tuple[Step, float]]:
        """The steps done, each only after all before it."""
        times = self._step_times(stop, moves)
        done = []
        for step, time in zip(Step, times, strict=True):
            if time is None or time > stop:
                break
            done.append((step, time))
        return done

    def _step_times(self, stop: float, moves: Event | None) -> list[float | None]:
        touched = self.seen.touched
        unlocked = opened = None
        if touched is not None and self.latch is not None:
            unlocked = _first(self.latch, False, touched)
        first = self.opened_at()
        if first is not None:
            touched, unlocked, opened = first
        crossed = closed = locked = None
        arrives = EventName.moves_to(self.condition.destination_side)
        if opened is not None and moves is not None and moves.name is arrives:
            crossed = moves.time if moves.time >= opened else None
        door = [change for change in self.seen.door_open.changes if change[0] <= stop]
        if crossed is not None and door and not door[-1][1]:
            closed = max(door[-1][0], crossed)
            reopened = _first(self.seen.door_open, True, closed)
            locked = self._locked_between(closed, reopened or math.inf)
        return [touched, unlocked, opened, crossed, closed, locked]
