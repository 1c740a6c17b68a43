"""What makes the results of an engine's runs, and the result as the engine holds it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import msgspec

from madrob_console.archive.evidence import evidence_told
from madrob_console.archive.result_files import result_files
from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import Scored, assess_recording, open_run
from madrob_console.common.files import naming_folder
from madrob_console.engine.disk import DiskJobs
from madrob_console.engine.requests import curves_of
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from scoring.assessment import Assessment
from scoring.kinematics import load_filters
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

    @classmethod
    def of(
        cls, scored: Scored, assessment: Assessment, files: Mapping[str, bytes]
    ) -> RenderedResult:
        """From a scored run, its samples and the result's files, if any were wanted."""
        return cls(
            record=scored.record,
            run=scored.run,
            result=scored.result,
            past=PastRun.of(scored.run, assessment, scored.result.stop),
            files={name: memoryview(content) for name, content in files.items()},
            curves=memoryview(msgspec.msgpack.encode(curves_of(scored.result, scored.rows))),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ToScore:
    """A run that is over, to be scored.

    Attributes:
        record: as it was recorded; what was corrected since stands in `run`.
        inside: the folder itself, which the engine has open, whatever has its name.
        assessment: has all of its samples and does not change any more; None = they are in its
            recording.
        missing: what its closed recording lacks, in words.
        stored: whether a run from its recording keeps the stored result's remarks on its data.
        files: whether its files are wanted.
    """

    record: RunRecord
    run: Run
    folder: Path
    inside: Path
    assessment: Assessment | None
    missing: Sequence[str] = ()
    stored: bool = False
    files: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class EarlierRun:
    """A run read back from the results folder, scored without files.

    `out_of_date`: the result on disk is missing or differs from the journal.
    """

    folder: Path
    entries: tuple[Entry, ...]
    scored: RenderedResult
    out_of_date: bool


_KEPT = 2
"""The current run, and one that is read meanwhile to be opened."""


class ScoringDesk:
    """Scores runs one after the other; keeps the samples of the last ones for corrections."""

    def __init__(self) -> None:
        self._kept: dict[Path, Assessment] = {}

    def read(self, folder: Path) -> EarlierRun:
        opened = open_run(folder)
        recorded, data = opened.recorded, opened.assessment
        run = replace(recorded.run, evidence=evidence_told(folder, recorded.run))
        scored = RenderedResult.of(Scored.of(recorded.record, run, data), data, {})
        self._keep(folder, data)
        return EarlierRun(folder, recorded.entries, scored, opened.out_of_date)

    def score(self, wanted: ToScore) -> RenderedResult:
        """Score a run from the samples it comes with, else from those kept or recorded."""
        run, folder, record = wanted.run, wanted.folder, wanted.record.corrected(wanted.run)
        data = wanted.assessment or self._kept.pop(folder, None)
        with naming_folder(folder, wanted.inside):
            if data is None or data.condition != record.setup.condition:
                data = assess_recording(wanted.inside, record, run, stored=wanted.stored)
            scored = Scored.of(record, run, data, wanted.missing)
            files = result_files(folder, scored, wanted.inside) if wanted.files else {}
        rendered = RenderedResult.of(scored, data, files)
        self._keep(folder, data)  # not after an error: then the recording is read
        return rendered

    def _keep(self, folder: Path, data: Assessment) -> None:
        others = [(other, kept) for other, kept in self._kept.items() if other != folder]
        self._kept = dict([*others, (folder, data)][-_KEPT:])


class Scorer:
    """Makes the results of one run after the other: this one at once, where it is asked.

    Nothing else here waits.
    """

    def __init__(self) -> None:
        self._desk = ScoringDesk()

    def problem(self, place: str) -> str | None:
        """Why a result is missing, or that it is retried; None = all well.

        `place` says where its run is meanwhile.
        """
        return None

    @property
    def hopeless(self) -> bool:
        """Whether several tries failed: what comes next need not wait for the result."""
        return False

    def warm(self) -> None:
        """Get ready in the background, so that the first result is not delayed."""
        threading.Thread(target=load_filters, name="filters", daemon=True).start()

    def read(self, folder: Path) -> Future[EarlierRun]:
        """From any thread."""
        return DiskJobs().submit_job(partial(self._desk.read, folder))

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        """Score the current run; replaces an earlier request.

        `done` gets its result in the thread that calls `deliver`.
        """
        done(self._desk.score(wanted))

    def forget(self) -> None:
        """The requested result is not wanted any more."""

    def deliver(self) -> None:
        """Tell the result that came since."""

    def wait_until_idle(self, limit: float) -> bool:
        """Wait `limit` s at most; returns whether the result is there."""
        return True
