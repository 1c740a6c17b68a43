"""What a report says in words that need no protocol at hand."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

from madrob_console.kinds import SourceKind
from madrob_console.referee.on_record import TeamWord
from scoring.indicator_table import WITH_THE_START
from scoring.protocol import Condition, LockDetection, Outcome

NONE = "-"
"""Where there is nothing to say."""

MANUAL_START_NOTE = (
    f"* Robot and clock were started by hand: {WITH_THE_START} include the delay between the two."
)

UNCERTAINTY_NOTE = (
    "+-: the value lies within it of what happened 95 times in 100, as far as sampling, encoder, "
    "stamps and noise go. Two results whose intervals overlap are not distinguishable."
)
"""What stands below the values of a report, once an uncertainty is known."""

NO_UNCERTAINTY_NOTE = (
    "Values with four decimals and without +-: no uncertainty is known of them. The result was "
    "made by an earlier version, or without the recording."
)
"""What stands there in its place."""

BIAS_NOTE = (
    "Not in the uncertainties, because the direction is known: the steps of the encoder look like "
    "jerk, so that the smoothness of a smooth door is too low."
)
"""What stands among the explanations."""

DOUBTS_NOTE = "? marks a value that is doubted, and says of no value that it is wrong:"

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

VOIDED = (
    "VOID: the referee voided this run. It keeps its indicators, counts for nothing and stays on "
    "record."
)
"""What stands on top of a run that was voided."""

UNOFFICIAL: Mapping[SourceKind, str] = {
    SourceKind.SIMULATED: "SIMULATED: not an official result. No real door was opened.",
    SourceKind.REPLAY: "REPLAY: not an official result. A recording was played once more.",
}
"""What stands on top of a run that was on no real testbed."""

PRACTICE = "PRACTICE: not an official result."
"""What stands on top of a practice run on a real one."""

PRACTICE_STANDINGS = "PRACTICE: not official. Rehearsals, and runs of a simulated testbed."
"""What stands on top of the standings of practice runs."""

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


def plain(name: str) -> str:
    """A name from a file, with blanks."""
    return name.replace("_", " ")


def since(time: float | None, start: float) -> str:
    """A time from the start, s with two decimals, as sampling has it; a dash for none."""
    return NONE if time is None else f"{time - start:.2f}"


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
