"""What a report says in words that need no protocol at hand."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

from madrob_console.kinds import SourceKind
from madrob_console.referee.run import TeamWord
from scoring.protocol import Condition, LockDetection, Outcome
from scoring.result import IndicatorName
from scoring.rulesets import RulesetName

NONE = "-"
"""Where there is nothing to say."""

FROM_THE_START = frozenset({IndicatorName.EXECUTION_TIME, IndicatorName.TIME_TO_HANDLE})
"""They include the delay of a start made by hand."""

MANUAL_START = (
    "* Robot and clock were started by hand: execution time and time to handle include the delay "
    "between the two."
)

EXPLANATIONS: Mapping[IndicatorName, str] = {
    IndicatorName.EXECUTION_TIME: "From the start of the run to its end.",
    IndicatorName.TIME_TO_HANDLE: "From the start of the run until the handle was first touched.",
    IndicatorName.DOOR_OCCUPATION_TIME: (
        "From the robot's arrival at the doorway until it had left on the other side."
    ),
    IndicatorName.PASSAGE_TIME: "From the touch of the handle until the door was closed again.",
    IndicatorName.UNSAFETY_OF_DOOR_OPERATION: (
        "How hard the panel was swung: its largest angular acceleration. Lower is safer."
    ),
    IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: (
        "How free of jolts the open door moved: 10 divided by the mean jerk. Higher is smoother."
    ),
    IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: (
        "The largest force on the handle, in either direction. Lower is gentler."
    ),
    IndicatorName.CAPABILITY_LEVEL: (
        "How many of the six steps were done, each after all the ones before it."
    ),
}

_OF_EUROBENCH: Mapping[IndicatorName, str] = {
    IndicatorName.EXECUTION_TIME: (
        "From the start of the run until the door was closed and the robot through, whichever "
        "came later."
    ),
    IndicatorName.CAPABILITY_LEVEL: (
        "How many of four things happened, in any order: arrival, touch, passage, closing."
    ),
}

OUTCOMES: Mapping[Outcome, str] = {
    Outcome.COMPLETED: "COMPLETED",
    Outcome.TIMEOUT: "TIMEOUT",
    Outcome.ABORTED: "INVALID",
    Outcome.INTERRUPTED: "INTERRUPTED",
}

INVALID: Mapping[Outcome, str] = {
    Outcome.ABORTED: (
        "INVALID: the referee aborted this run. It has no indicators and counts for nothing; it "
        "stays on record."
    ),
    Outcome.INTERRUPTED: (
        "INTERRUPTED: the machine failed during this run. What could be computed is shown, and "
        "left out of every mean and ranking; the referee decides whether the run is repeated."
    ),
}
"""What stands on top of a run that does not count."""

UNOFFICIAL: Mapping[SourceKind, str] = {
    SourceKind.SIMULATED: "SIMULATED: not an official result. No real door was opened.",
    SourceKind.REPLAY: "REPLAY: not an official result. A recording was played once more.",
}
"""What stands on top of a run that was on no real testbed."""

TEAM_WORDS: Mapping[TeamWord, str] = {
    TeamWord.ACKNOWLEDGED: "The team acknowledged the result.",
    TeamWord.PROTESTED: "The team PROTESTED against the result.",
    TeamWord.ABSENT: "Nobody of the team was there.",
}

SOURCES: Mapping[SourceKind, str] = {
    SourceKind.ROS: "a real testbed, over ROS",
    SourceKind.SIMULATED: "the simulated testbed",
    SourceKind.REPLAY: "a recording",
}

LOCKED_BY: Mapping[LockDetection, str] = {
    LockDetection.AUTO: "latch sensor if there is one",
    LockDetection.SETTLE: "a door that stays closed",
    LockDetection.SENSOR: "the latch sensor",
    LockDetection.REFEREE: "the referee",
}

RULED: Mapping[bool | None, str] = {
    True: "confirmed",
    False: "denied",
    None: "as the sensors say",
}


def explanation(name: IndicatorName, rules: RulesetName) -> str:
    """What an indicator means, in a line."""
    if rules is RulesetName.EUROBENCH_2020:
        return _OF_EUROBENCH.get(name, EXPLANATIONS[name])
    return EXPLANATIONS[name]


def plain(name: str) -> str:
    """A name from a file, with blanks."""
    return name.replace("_", " ")


def unit_text(unit: str) -> str:
    """A unit as people write it: `rad/s²`."""
    return unit.replace("^2", "²").replace("^3", "³")


def since(time: float | None, start: float) -> str:
    """A time from the start, s with three decimals; a dash for none."""
    return NONE if time is None else f"{time - start:.3f}"


def task_text(condition: Condition) -> str:
    """What a condition asks of the robot."""
    way = "pull" if condition.must_pull else "push"
    start, destination = condition.starting_side.upper(), condition.destination_side.upper()
    return f"{way} the door, from side {start} to side {destination}"


def date_text(epoch: float) -> str:
    """Local date and time with its distance from UTC."""
    try:
        local = datetime.fromtimestamp(epoch, tz=UTC).astimezone()
    except (OverflowError, OSError, ValueError):
        return f"{epoch:.3f} s since 1970"
    return f"{local:%Y-%m-%d %H:%M:%S} (UTC{local:%z})"
