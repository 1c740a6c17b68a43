"""Requests to score a run, and their results, as the engine holds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from madrob_console.archive.run_record import RunRecord
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from scoring.assessment import Assessment
from scoring.procedure import Procedure
from scoring.result import Result


@dataclass(frozen=True, slots=True)
class PastRun:
    """What screens show of a run that is over, beside its result.

    Attributes:
        procedure: the six steps, as of the stop.
        provisional: the time indicators, by file name, s.
        largest_force: abs, since the start, N; None = none was seen.
        doubts: on the indicators, by file name, as far as known without the result.
    """

    procedure: Procedure
    provisional: Mapping[str, float]
    largest_force: float | None
    doubts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, run: Run, assessment: Assessment, stop: float | None) -> PastRun:
        """From an assessment of the whole run; `stop`, by its result's rules, may be later."""
        procedure = assessment.procedure(run.rulings, stop)
        return cls(
            procedure,
            assessment.provisional(procedure),
            assessment.largest_force,
            assessment.provisional_doubts(),
        )


@dataclass(frozen=True, slots=True, eq=False)
class RenderedResult:
    """A scored run without its data: what is shown, and bytes that are passed on.

    `files` is empty where none was wanted. `curves` are as they cross a socket.
    """

    record: RunRecord
    run: Run
    result: Result
    past: PastRun
    files: Mapping[str, memoryview]
    curves: memoryview

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Points that a decision on the run depends on, the most serious first."""
        result = self.result
        source = self.record.source
        return flags(self.run, result.steps, source, result.quality, result.indicators)


@dataclass(frozen=True, slots=True, eq=False)
class ScoringRequest:
    """A run that is over, to be scored.

    Attributes:
        record: as it was recorded; what was corrected since stands in `run`.
        assessment: has all of its samples and does not change any more; None = they are in its
            recording.
        missing: what its closed recording lacks, in words.
        stored: whether the stored result's remarks on the data are kept, if the bag is read.
        files: whether its files are wanted.
        inside: the folder itself, which the engine has open, whatever has its name.
    """

    record: RunRecord
    run: Run
    folder: Path
    assessment: Assessment | None
    missing: Sequence[str] = ()
    stored: bool = False
    files: bool = True
    inside: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EarlierRun:
    """A run read back from the results folder, scored without files.

    `out_of_date`: the result on disk is missing or differs from the journal.
    """

    folder: Path
    entries: tuple[Entry, ...]
    scored: RenderedResult
    out_of_date: bool
