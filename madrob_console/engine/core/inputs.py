"""What happens to the core: acts, answers of the disk and the workers, and the time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.journal_agreement import Details
from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult, ScoringRequest
from madrob_console.referee.acts import Act
from madrob_console.referee.journal import Entry


@dataclass(frozen=True, slots=True)
class Tick:
    """Time has passed, and messages were judged."""


@dataclass(frozen=True, slots=True)
class DoAct:
    """An act to be done, if it is possible; `number` is that of its `Answer`.

    `id` is its screen's; empty = it has none.
    """

    number: int
    act: Act
    id: str


@dataclass(frozen=True, slots=True)
class OpenEarlierRun:
    """An earlier run to be shown as if it had stopped just now.

    A run that was cut off is stopped as interrupted, with `invalid` as aborted. A run that was set
    up since the generation `instead_of` stays.
    """

    number: int
    earlier: EarlierRun
    invalid: bool
    instead_of: int


@dataclass(frozen=True, slots=True)
class LineWritten:
    """The line of the act that waits is on disk, or the disk refused it, in words."""

    id: str
    problem: str | None


@dataclass(frozen=True, slots=True)
class LineWithdrawn:
    """The line of the act that waited never takes effect."""

    withdrawal: Entry


@dataclass(frozen=True, slots=True)
class NumberGivenOut:
    """A run number that was never used, for the correction with this id; or why there is none."""

    id: str
    number: int
    problem: str | None


@dataclass(frozen=True, slots=True)
class RecordingOpened:
    """The files of the run that starts are there, or the disk refused them, in words."""

    id: str
    folder: Path | None
    problem: str | None


@dataclass(frozen=True, slots=True)
class RecordingClosed:
    """The bag is complete.

    `missing` says in words what it lacks, `unrecorded` how many scored messages.
    """

    missing: tuple[str, ...]
    unrecorded: int


@dataclass(frozen=True, slots=True)
class JournalReopened:
    """The journal of an earlier run is open, or why not, in words; `late`: it took too long."""

    request: OpenEarlierRun
    problem: str | None
    late: bool


@dataclass(frozen=True, slots=True)
class CutOffRunsListed:
    """The runs of the results folder that were cut off."""

    runs: tuple[Unfinished, ...]


@dataclass(frozen=True, slots=True)
class RunScored:
    """A requested result is there."""

    request: ScoringRequest
    scored: RenderedResult


@dataclass(frozen=True, slots=True)
class ResultWritten:
    """A result is on disk, with the details of its journal line; or why not, in words."""

    request: ScoringRequest
    scored: RenderedResult
    details: Details
    problem: str | None


@dataclass(frozen=True, slots=True)
class EngineEnds:
    """The engine begins to end: the act that waits is withdrawn."""


@dataclass(frozen=True, slots=True)
class CutOff:
    """The run that goes on is cut off, and nothing more is recorded."""

    reason: str


@dataclass(frozen=True, slots=True)
class ReplayedLine:
    """A line of a recorded run's journal: its decision is taken again."""

    entry: Entry


@dataclass(frozen=True, slots=True)
class ReplayEnds:
    """A replay is at its end."""


Input = (
    Tick
    | DoAct
    | OpenEarlierRun
    | LineWritten
    | LineWithdrawn
    | NumberGivenOut
    | RecordingOpened
    | RecordingClosed
    | JournalReopened
    | CutOffRunsListed
    | RunScored
    | ResultWritten
    | EngineEnds
    | CutOff
    | ReplayedLine
    | ReplayEnds
)
