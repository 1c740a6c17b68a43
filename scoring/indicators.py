"""The performance indicators, one function each (protocol sections 6 and 9).

An indicator that cannot be computed has no value but a reason in words. Values are plain
`float` or `int`, always finite.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Event, EventName, Step
from scoring.result import Indicator
from scoring.rows import Rows
from scoring.rulesets import CapabilityRule, ExecutionEnd, Ruleset

Steps = AbstractSet[Step] | tuple[Step, ...]


TIMES = (
    IndicatorName.EXECUTION_TIME,
    IndicatorName.TIME_TO_HANDLE,
    IndicatorName.DOOR_OCCUPATION_TIME,
    IndicatorName.PASSAGE_TIME,
)

SMOOTHNESS_SCALE = 10.0
"""Factor of the smoothness, "to rescale the values in a more comfortable range"."""

_NO_START = "no benchmark start"
_NO_STOP = "no benchmark stop"
_NEVER_TOUCHED = "handle never touched"
_NEVER_OPENED = "door never opened"
_NEVER_CLOSED = "door never closed"
_NEVER_APPROACHED = "robot never approached on the starting side"
_NEVER_THROUGH = "robot never reached the destination side"


def compute_indicators(
    events: Sequence[Event],
    done: Steps,
    rows: Rows,
    condition: Condition,
    ruleset: Ruleset,
    names: Iterable[IndicatorName] = IndicatorName,
) -> dict[IndicatorName, Indicator]:
    """All indicators of a run that is not aborted; `rows` are cut to the run."""
    return {name: _computed(name, events, done, rows, condition, ruleset) for name in names}


def _computed(
    name: IndicatorName,
    events: Sequence[Event],
    done: Steps,
    rows: Rows,
    condition: Condition,
    ruleset: Ruleset,
) -> Indicator:
    match name:
        case IndicatorName.EXECUTION_TIME:
            return execution_time(events, condition, ruleset)
        case IndicatorName.TIME_TO_HANDLE:
            return time_to_handle(events)
        case IndicatorName.DOOR_OCCUPATION_TIME:
            return door_occupation_time(events, condition, ruleset)
        case IndicatorName.PASSAGE_TIME:
            return passage_time(events, done, ruleset)
        case IndicatorName.UNSAFETY_OF_DOOR_OPERATION:
            return unsafety_of_door_operation(rows.low_passed, rows.no_motion or rows.problem)
        case IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION:
            unknown = rows.joint_state.reason if rows.opened else None
            return smoothness_of_door_actuation(rows.jerk, rows.opened, rows.no_motion or unknown)
        case IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION:
            return roughness_of_door_actuation(rows.force)
        case IndicatorName.CAPABILITY_LEVEL:
            return capability_level(events, condition, done, ruleset)


def execution_time(events: Sequence[Event], condition: Condition, ruleset: Ruleset) -> Indicator:
    name = IndicatorName.EXECUTION_TIME
    start = _first(events, EventName.BENCHMARK_START)
    if start is None:
        return Indicator.missing(name, _NO_START)
    if ruleset.execution_end is ExecutionEnd.BENCHMARK_STOP:
        return _duration(name, start, _last(events, EventName.BENCHMARK_STOP), "", _NO_STOP)
    crossed = _last(events, EventName.moves_to(condition.destination_side))
    if crossed is None:
        return Indicator.missing(name, _NEVER_THROUGH)
    closed = _last(events, EventName.DOOR_CLOSES)
    if closed is None:
        return Indicator.missing(name, _NEVER_CLOSED)
    return Indicator.of(name, max(closed, crossed) - start)


def time_to_handle(events: Sequence[Event]) -> Indicator:
    return _duration(
        IndicatorName.TIME_TO_HANDLE,
        _first(events, EventName.BENCHMARK_START),
        _first(events, EventName.HANDLE_IS_TOUCHED),
        _NO_START,
        _NEVER_TOUCHED,
    )


def door_occupation_time(
    events: Sequence[Event], condition: Condition, ruleset: Ruleset
) -> Indicator:
    name = IndicatorName.DOOR_OCCUPATION_TIME
    occupation = _duration(
        name,
        _first(events, EventName.approaches(condition.starting_side)),
        _last(events, EventName.moves_to(condition.destination_side)),
        _NEVER_APPROACHED,
        _NEVER_THROUGH,
    )
    negative = occupation.value is not None and occupation.value <= 0
    if ruleset.occupation_only_if_positive and negative:
        return Indicator.missing(name, "robot left no later than it approached")
    return occupation


def passage_time(events: Sequence[Event], steps_done: Steps, ruleset: Ruleset) -> Indicator:
    name = IndicatorName.PASSAGE_TIME
    if ruleset.passage_needs_steps:
        for step in (Step.TOUCH, Step.OPEN, Step.CROSS, Step.CLOSE):
            if step not in steps_done:
                return Indicator.missing(name, _why_not_done(step, events))
    touched = _first(events, EventName.HANDLE_IS_TOUCHED)
    closed = _last(events, EventName.DOOR_CLOSES)
    if ruleset.passage_needs_steps:  # steps done without an event: the referee confirmed them
        return _duration(name, touched, closed, "touch not detected", "closing not detected")
    return _duration(name, touched, closed, _NEVER_TOUCHED, _NEVER_CLOSED)


def unsafety_of_door_operation(
    low_passed: NDArray[np.float64], problem: str | None = None
) -> Indicator:
    """From the low-passed acceleration of the run's rows, rad/s^2, shape (n,), if finite."""
    name = IndicatorName.UNSAFETY_OF_DOOR_OPERATION
    values = _finite(low_passed)
    if not values.size:
        return Indicator.missing(name, problem or "no acceleration of the door during the run")
    return Indicator.of(name, float(np.max(np.abs(values))))


def smoothness_of_door_actuation(
    jerk: NDArray[np.float64], opened: bool, problem: str | None = None
) -> Indicator:
    """From the jerk of the run's rows with an open door, rad/s^3, shape (n,), if finite."""
    name = IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION
    values = _finite(jerk)
    if not values.size:
        unknown = "no acceleration while the door was open" if opened else _NEVER_OPENED
        return Indicator.missing(name, problem or unknown)
    with np.errstate(over="ignore"):
        mean = float(np.mean(np.abs(values)))
    if mean == 0:
        return Indicator.missing(name, "door stood still while open")
    return Indicator.of(name, SMOOTHNESS_SCALE / mean if math.isfinite(mean) else mean)


def roughness_of_door_actuation(force: NDArray[np.float64]) -> Indicator:
    """From the force of the run's rows, as recorded or less its rest, N, shape (n,), if finite."""
    values = _finite(force)
    if not values.size:
        return Indicator.missing(
            IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION, "no handle force recorded"
        )
    return Indicator.of(IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION, float(np.max(np.abs(values))))


def capability_level(
    events: Sequence[Event], condition: Condition, steps_done: Steps, ruleset: Ruleset
) -> Indicator:
    if ruleset.capability is CapabilityRule.EVENTS_IN_ANY_ORDER:
        level = len(_capability_events(condition) & {event.name for event in events})
    else:
        undone = (step.value for step in Step if step not in steps_done)
        level = min(undone, default=len(Step) + 1) - 1
    return Indicator.of(IndicatorName.CAPABILITY_LEVEL, level)


def _capability_events(condition: Condition) -> frozenset[EventName]:
    """The events that `eurobench-2020` counts."""
    return frozenset(
        {
            EventName.approaches(condition.starting_side),
            EventName.HANDLE_IS_TOUCHED,
            EventName.moves_to(condition.destination_side),
            EventName.DOOR_CLOSES,
        }
    )


def _why_not_done(step: Step, events: Iterable[Event]) -> str:
    if step is Step.CROSS:
        return _NEVER_THROUGH
    event, words = {
        Step.TOUCH: (EventName.HANDLE_IS_TOUCHED, _NEVER_TOUCHED),
        Step.OPEN: (EventName.DOOR_OPENS, _NEVER_OPENED),
        Step.CLOSE: (EventName.DOOR_CLOSES, _NEVER_CLOSED),
    }[step]
    happened = any(e.name is event for e in events)
    return f"step {step.value} not done: {step.text}" if happened else words


def _duration(
    name: IndicatorName,
    since: float | None,
    until: float | None,
    no_since: str,
    no_until: str,
) -> Indicator:
    if since is None:
        return Indicator.missing(name, no_since)
    if until is None:
        return Indicator.missing(name, no_until)
    return Indicator.of(name, until - since)


def _first(events: Iterable[Event], name: EventName) -> float | None:
    return min(_times(events, name), default=None)


def _last(events: Iterable[Event], name: EventName) -> float | None:
    return max(_times(events, name), default=None)


def _times(events: Iterable[Event], name: EventName) -> list[float]:
    times = (float(event.time) for event in events if event.name is name)
    return [time for time in times if math.isfinite(time)]


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[np.isfinite(values)]
