"""The performance indicators, one function each (protocol section 6).

An indicator that cannot be computed has no value but a reason in words. Values are plain
`float` or `int`, always finite.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from collections.abc import Set as AbstractSet

import numpy as np

from scoring.indicator_table import IndicatorName
from scoring.kinematics import Array
from scoring.protocol import Condition, Event, EventName, Step
from scoring.result import Indicator
from scoring.rows import Rows

SMOOTHNESS_SCALE = 10.0
"""Factor of the smoothness, "to rescale the values in a more comfortable range"."""

NEVER_TOUCHED = "handle never touched"
NEVER_CLOSED = "door never closed"
NEVER_THROUGH = "robot never reached the destination side"
_NEVER_OPENED = "door never opened"


def compute_indicators(
    events: Sequence[Event], done: AbstractSet[Step], rows: Rows, condition: Condition
) -> dict[IndicatorName, Indicator]:
    """Compute all indicators of a run that is not aborted.

    `rows` are cut to the run.
    """
    return {
        IndicatorName.EXECUTION_TIME: execution_time(events),
        IndicatorName.TIME_TO_HANDLE: time_to_handle(events),
        IndicatorName.DOOR_OCCUPATION_TIME: door_occupation_time(events, condition),
        IndicatorName.PASSAGE_TIME: passage_time(events, done),
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION: unsafety_of_door_operation(rows),
        IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: smoothness_of_door_actuation(rows),
        IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: roughness_of_door_actuation(rows.force),
        IndicatorName.CAPABILITY_LEVEL: capability_level(done),
    }


def execution_time(events: Sequence[Event]) -> Indicator:
    start = first_time(events, EventName.BENCHMARK_START)
    stop = last_time(events, EventName.BENCHMARK_STOP)
    return duration(
        IndicatorName.EXECUTION_TIME, start, stop, "no benchmark start", "no benchmark stop"
    )


def time_to_handle(events: Sequence[Event]) -> Indicator:
    start = first_time(events, EventName.BENCHMARK_START)
    touch = first_time(events, EventName.HANDLE_IS_TOUCHED)
    return duration(IndicatorName.TIME_TO_HANDLE, start, touch, "no benchmark start", NEVER_TOUCHED)


def door_occupation_time(events: Sequence[Event], condition: Condition) -> Indicator:
    return duration(
        IndicatorName.DOOR_OCCUPATION_TIME,
        first_time(events, EventName.approaches(condition.starting_side)),
        last_time(events, EventName.moves_to(condition.destination_side)),
        "robot never approached on the starting side",
        NEVER_THROUGH,
    )


def passage_time(events: Sequence[Event], done: AbstractSet[Step]) -> Indicator:
    name = IndicatorName.PASSAGE_TIME
    for step in (Step.TOUCH, Step.OPEN, Step.CROSS, Step.CLOSE):
        if step not in done:
            return Indicator.missing(name, _why_not_done(step, events))
    # steps done without an event: the referee confirmed them
    return duration(
        name,
        first_time(events, EventName.HANDLE_IS_TOUCHED),
        last_time(events, EventName.DOOR_CLOSES),
        "touch not detected",
        "closing not detected",
    )


def unsafety_of_door_operation(rows: Rows) -> Indicator:
    name = IndicatorName.UNSAFETY_OF_DOOR_OPERATION
    values = _finite(rows.low_passed)
    if not values.size:
        why = rows.no_motion or rows.problem or "no acceleration of the door during the run"
        return Indicator.missing(name, why)
    return Indicator.of(name, float(np.max(np.abs(values))))


def smoothness_of_door_actuation(rows: Rows) -> Indicator:
    name = IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION
    values = _finite(rows.jerk)
    if not values.size:
        why = _NEVER_OPENED
        if rows.opened:
            why = rows.joint_state.reason or "no acceleration while the door was open"
        return Indicator.missing(name, rows.no_motion or why)
    with np.errstate(over="ignore"):
        mean = float(np.mean(np.abs(values)))
    if mean == 0:
        return Indicator.missing(name, "door stood still while open")
    return Indicator.of(name, SMOOTHNESS_SCALE / mean if math.isfinite(mean) else mean)


def roughness_of_door_actuation(force: Array) -> Indicator:
    """Return the largest abs(force) of a run's rows, N, shape (n,)."""
    name = IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION
    values = _finite(force)
    if not values.size:
        return Indicator.missing(name, "no handle force recorded")
    return Indicator.of(name, float(np.max(np.abs(values))))


def capability_level(done: AbstractSet[Step]) -> Indicator:
    level = 0
    while level < len(Step) and Step(level + 1) in done:
        level += 1
    return Indicator.of(IndicatorName.CAPABILITY_LEVEL, level)


def duration(
    name: IndicatorName, since: float | None, until: float | None, no_since: str, no_until: str
) -> Indicator:
    """Return the time between two instants, s, or why one of them is missing."""
    if since is None:
        return Indicator.missing(name, no_since)
    if until is None:
        return Indicator.missing(name, no_until)
    return Indicator.of(name, until - since)


def first_time(events: Iterable[Event], name: EventName) -> float | None:
    return min((event.time for event in events if event.name is name), default=None)


def last_time(events: Iterable[Event], name: EventName) -> float | None:
    return max((event.time for event in events if event.name is name), default=None)


def _why_not_done(step: Step, events: Iterable[Event]) -> str:
    if step is Step.CROSS:
        return NEVER_THROUGH
    event, words = {
        Step.TOUCH: (EventName.HANDLE_IS_TOUCHED, NEVER_TOUCHED),
        Step.OPEN: (EventName.DOOR_OPENS, _NEVER_OPENED),
        Step.CLOSE: (EventName.DOOR_CLOSES, NEVER_CLOSED),
    }[step]
    happened = any(e.name is event for e in events)
    return f"step {step.value} not done: {step.text}" if happened else words


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]
