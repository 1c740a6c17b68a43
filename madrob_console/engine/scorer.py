"""What makes the results of an engine's runs, and the result as the engine holds it."""

from __future__ import annotations

import itertools
import pickle
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import msgspec

from madrob_console.archive.evidence import evidence_told
from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.result_files import ResultFiles, result_files
from madrob_console.archive.run_journal import Details, written_details
from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import Scored, assess_recording, open_run
from madrob_console.engine.disk import InlineDisk
from madrob_console.engine.requests import curves_of
from madrob_console.referee.flags import Flag, flags
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from scoring.evaluate import Assessment, LiveAssessment
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
    def of(cls, run: Run, assessment: LiveAssessment, stop: float | None) -> PastRun:
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

    `files` is empty where none was wanted. `curves` are as they cross a socket; `report` is
    the `Scored` run pickled.
    """

    record: RunRecord
    run: Run
    result: Result
    past: PastRun
    files: ResultFiles
    curves: bytes | memoryview
    report: bytes | memoryview

    @property
    def written_details(self) -> Details:
        return written_details(self.files[RESULT_FILE], self.run.issue)

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Points that a decision on the run depends on, the most serious first."""
        result = self.result
        source = self.record.source
        return flags(self.run, result.steps, source, result.quality, result.indicators)

    @classmethod
    def of(
        cls, record: RunRecord, run: Run, assessment: Assessment, folder: Path | None
    ) -> RenderedResult:
        """Score a run that is over, from an assessment of all its samples.

        Without a `folder` no files are made.
        """
        scored = Scored.of(record, run, assessment)
        return cls(
            record=record,
            run=run,
            result=scored.result,
            past=PastRun.of(run, assessment, scored.result.stop),
            files={} if folder is None else result_files(folder, scored),
            curves=msgspec.msgpack.encode(curves_of(scored.result, scored.rows)),
            report=pickle.dumps(scored, pickle.HIGHEST_PROTOCOL),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ToScore:
    """A run that is over, to be scored.

    `missing` says what its closed recording lacks, the same each time; `files` asks for its
    files.
    """

    run: Run
    folder: Path
    missing: Sequence[str] = ()
    files: bool = True


class ScorableRun:
    """The data of a run, which can be scored any number of times.

    `stored` keeps the stored result's remarks on the data when they are read again.
    """

    def __init__(self, record: RunRecord, assessment: Assessment, *, stored: bool = False) -> None:
        self.assessment = assessment
        self._record = record
        self._stored = stored
        self._reported = 0

    def score(self, wanted: ToScore) -> RenderedResult:
        """Score the run; if its condition was corrected, from its recording once more."""
        record = self._record.corrected(wanted.run)
        if record.setup.condition != self.assessment.condition:
            folder, run = wanted.folder, wanted.run
            self.assessment = assess_recording(folder, record, run, stored=self._stored)
            self._reported = 0
        for remark in wanted.missing[self._reported :]:
            self.assessment.report_problem(remark)
        self._reported = len(wanted.missing)
        place = wanted.folder if wanted.files else None
        return RenderedResult.of(record, wanted.run, self.assessment, place)


@dataclass(frozen=True, slots=True, eq=False)
class EarlierRun:
    """A run read back from the results folder, scored without files.

    `key` finds its data in the scorer again. `out_of_date`: the result on disk is missing
    or differs from the journal.
    """

    folder: Path
    entries: tuple[Entry, ...]
    scored: RenderedResult
    key: int
    out_of_date: bool


def read_earlier(folder: Path, key: int) -> tuple[EarlierRun, ScorableRun]:
    opened = open_run(folder)
    recorded = opened.recorded
    data = ScorableRun(recorded.record, opened.assessment, stored=True)
    run = replace(recorded.run, evidence=evidence_told(folder, recorded.run))
    scored = data.score(ToScore(run, folder, files=False))
    return EarlierRun(folder, recorded.entries, scored, key, opened.out_of_date), data


class Scorer(Protocol):
    """Makes the results of one run after the other. Nothing here waits."""

    @property
    def problem(self) -> str | None:
        """Why a result is missing, or that it is retried; None = all well. From any thread."""
        ...

    @property
    def hopeless(self) -> bool:
        """Whether several tries failed: what comes next need not wait for the result."""
        ...

    def warm(self) -> None:
        """Get ready in the background, so that the first result is not delayed."""
        ...

    def follow(self, record: RunRecord, start: float) -> LiveAssessment:
        """Follow a run that begins, or whose countdown begins anew; feed its samples to the answer.

        `start` is the (planned) start, s since the epoch.
        """
        ...

    def read(self, folder: Path) -> Future[EarlierRun]:
        """From any thread."""
        ...

    def look_back(self, earlier: EarlierRun) -> None: ...

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        """Score the current run; replaces an earlier request.

        `done` gets its result in the thread that calls `deliver`, unless another run is current.
        """
        ...

    def deliver(self) -> None: ...

    def wait_until_idle(self, limit: float) -> bool:
        """Wait `limit` s at most; returns whether the result is there."""
        ...

    def close(self) -> None: ...


class InlineScorer:
    """Scores at once, where it is asked; a `Scorer`."""

    problem = None
    hopeless = False

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._at_hand: ScorableRun | None = None
        self._read: dict[int, ScorableRun] = {}

    def warm(self) -> None:
        threading.Thread(target=load_filters, name="filters", daemon=True).start()

    def follow(self, record: RunRecord, start: float) -> Assessment:
        assessment = record.assessment(start)
        self._at_hand = ScorableRun(record, assessment)
        return assessment

    def read(self, folder: Path) -> Future[EarlierRun]:
        return InlineDisk().submit_job(partial(self._read_now, folder))

    def _read_now(self, folder: Path) -> EarlierRun:
        earlier, data = read_earlier(folder, next(self._numbers))
        self._read = {earlier.key: data}  # the one before was not wanted after all
        return earlier

    def look_back(self, earlier: EarlierRun) -> None:
        self._at_hand = self._read.pop(earlier.key)

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        assert self._at_hand is not None
        done(self._at_hand.score(wanted))

    def deliver(self) -> None:
        """Nothing is left to be told."""

    def wait_until_idle(self, limit: float) -> bool:
        return True

    def close(self) -> None:
        """Nothing was begun."""
