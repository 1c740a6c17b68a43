"""What the core wants done: `engine/runtime/performer.py` carries it out.

Answers are given after all other effects of an input, and what follows from them at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.run_record import RunRecord
from madrob_console.engine.core.inputs import OpenEarlierRun
from madrob_console.engine.core.scored_run import RenderedResult, ScoringRequest
from madrob_console.engine.public_state import PublishedState
from madrob_console.referee.journal import Entry
from scoring.protocol import Condition, StartPose


@dataclass(frozen=True, slots=True)
class Answer:
    """Tell who asked under this number why it was refused, in words; None = it is done."""

    number: int
    refused: str | None


@dataclass(frozen=True, slots=True)
class WriteLine:
    """Add a line to the journal; if the disk refuses it, it waits.

    An `awaited` one is an act's, which takes effect once `LineWritten` comes.
    """

    entry: Entry
    awaited: bool = False


@dataclass(frozen=True, slots=True)
class WithdrawLine:
    """Cancel the line of the act that waits. `LineWithdrawn` follows, unless it is on disk."""

    withdrawal: Entry


@dataclass(frozen=True, slots=True)
class GiveOutNumber:
    """Reserve a run number for the correction with this id: `NumberGivenOut` follows."""

    id: str
    results: Path
    subject: int
    condition: Condition


@dataclass(frozen=True, slots=True)
class OpenRecording:
    """Make folder, bag and journal of a run that starts; the clock is held steady from now on.

    The last of the journal's `entries` is the start's. `RecordingOpened` follows, and is answered
    by `KeepRecording` or `GiveUpRecording`; or `LineWithdrawn`. `start` is the planned one, s
    since the epoch.
    """

    record: RunRecord
    start: float
    entries: tuple[Entry, ...]


@dataclass(frozen=True, slots=True)
class KeepRecording:
    """Record into the files that were opened."""


@dataclass(frozen=True, slots=True)
class GiveUpRecording:
    """Close the files that were opened, with this line: the run does not start."""

    withdrawal: Entry


@dataclass(frozen=True, slots=True)
class CloseRecording:
    """Take and record what is still on its way, then close the bag: `RecordingClosed` follows."""


@dataclass(frozen=True, slots=True)
class LeaveRun:
    """Put the current run away; what is not on disk of it is retried until it is.

    `problem` says why its result is not on disk, in words.
    """

    folder: Path | None
    entries: tuple[Entry, ...]
    scored: RenderedResult | None
    problem: str | None


@dataclass(frozen=True, slots=True)
class ReopenJournal:
    """Open the journal of an earlier run: `JournalReopened` follows.

    Then `KeepJournal` or `CloseJournal`.
    """

    request: OpenEarlierRun


@dataclass(frozen=True, slots=True)
class KeepJournal:
    """Go on in the journal that was reopened."""


@dataclass(frozen=True, slots=True)
class CloseJournal:
    """Close the journal that was reopened."""


@dataclass(frozen=True, slots=True)
class ListCutOffRuns:
    """Search for runs that were cut off, when the journal that was left is closed."""


@dataclass(frozen=True, slots=True)
class PlainValue:
    """One fact of the run, for a topic of a standard type: programs need no JSON for it."""

    topic: str
    value: bool | float


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish what robots hear of the run; an open recording gets it, too."""

    what: Entry | PublishedState | StartPose | PlainValue


@dataclass(frozen=True, slots=True)
class ConfigureTestbed:
    """Set the testbed's sides."""

    condition: Condition


@dataclass(frozen=True, slots=True)
class Score:
    """Score the current run: `RunScored` follows. Replaces the request before."""

    request: ScoringRequest


@dataclass(frozen=True, slots=True)
class WriteResult:
    """Issue a result: `ResultWritten` follows."""

    request: ScoringRequest
    scored: RenderedResult
    entries: tuple[Entry, ...]


@dataclass(frozen=True, slots=True)
class RetryWriting:
    """Write again what the disk refused; results of earlier runs only if `results`."""

    results: bool


@dataclass(frozen=True, slots=True)
class MakeReports:
    """Have the pages of a run made: its result has changed."""

    folder: Path


ToPerform = (
    WriteLine
    | WithdrawLine
    | GiveOutNumber
    | OpenRecording
    | KeepRecording
    | GiveUpRecording
    | CloseRecording
    | LeaveRun
    | ReopenJournal
    | KeepJournal
    | CloseJournal
    | ListCutOffRuns
    | Publish
    | ConfigureTestbed
    | Score
    | WriteResult
    | RetryWriting
    | MakeReports
)

Effect = Answer | ToPerform
