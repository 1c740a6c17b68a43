"""Words that pages share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.names import SourceKind, is_rehearsal
from madrob_console.referee.records import TeamWord
from scoring.indicator_table import WITH_THE_START
from scoring.protocol import LockDetection, Outcome

MANUAL_START_NOTE = (
    f"* Robot and clock were started by hand: {WITH_THE_START} include the delay between the two, "
    "which +- allows for."
)

UNCERTAINTY_NOTE = (
    "+-: the value repeats within it, 95 of 100, as far as sampling, encoder, stamps and noise go. "
    "Two results whose intervals overlap are a tie."
)

NO_UNCERTAINTY_NOTE = (
    "Values with four decimals and without +-: no uncertainty is known of them. The result was "
    "made without the recording."
)

BIAS_NOTE = (
    "Not in the uncertainties, because the direction is known: the steps of the encoder look like "
    "jerk, so that the smoothness of a smooth door is too low."
)

INVALID: Mapping[Outcome, str] = {
    Outcome.ABORTED: (
        "INVALID: the referee aborted this run. It has no indicators and does not count."
    ),
    Outcome.INTERRUPTED: (
        "INTERRUPTED: the machine failed during this run. What could be computed is shown and does "
        "not count; the referee decides whether the run is repeated."
    ),
}

VOIDED = "VOID: the referee voided this run. It keeps its indicators and does not count."

UNOFFICIAL: Mapping[SourceKind, str] = {
    SourceKind.SIMULATED: "SIMULATED: not an official result. No real door was opened.",
    SourceKind.REPLAY: "REPLAY: not an official result. A recording was played once more.",
}

PRACTICE = "PRACTICE: not an official result."

REHEARSED = "REHEARSAL: not an official result."


def unofficial_words(record: RunRecord) -> Iterator[str]:
    """Why the result of a run is not an official one; nothing where it is."""
    rehearsal = is_rehearsal(record.competition)
    if rehearsal:
        yield REHEARSED
    if record.source in UNOFFICIAL:
        yield UNOFFICIAL[record.source]
    if record.setup.practice or (record.source is SourceKind.SIMULATED and not rehearsal):
        yield PRACTICE


PRACTICE_STANDINGS = "PRACTICE: not official. Practice runs, and runs of a simulated testbed."

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
