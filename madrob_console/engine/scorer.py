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
from madrob_console.engine.disk import InlineKeeper
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
        doubts: on the indicators, by file name, as far as they are known without the result.
    """

    procedure: Procedure
    provisional: Mapping[str, float]
    largest_force: float | None
    doubts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, run: Run, assessment: LiveAssessment, stop: float | None) -> PastRun:
        """Of a run that is over, and what follows it.

        Args:
            run: its state.
            assessment: fed with all of its samples.
            stop: as its result has it; other rules may stop a run later than it was stopped.
        """
        procedure = assessment.procedure(run.rulings, stop)
        return cls(
            procedure,
            assessment.provisional(procedure),
            assessment.largest_force,
            assessment.provisional_doubts(),
        )


@dataclass(frozen=True, slots=True, eq=False)
class RenderedResult:
    """A scored run without the data behind it: what is shown, and bytes that are passed on.

    Attributes:
        record: what was set.
        run: its state, with what the referee said.
        result: what the sensors and the referee make of it.
        past: what else is shown of it.
        files: every file of the result; empty where none was wanted.
        curves: the `Curves` of the run, as they cross a socket.
        report: the `Scored` run pickled, for its report.
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
        """What the journal's line says once the result is on disk."""
        return written_details(self.files[RESULT_FILE], self.run.issue)

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What a decision on the run hangs on, the heaviest first."""
        result = self.result
        source, remarks = self.record.source, result.quality.remarks
        return flags(self.run, result.steps, source, remarks, result.indicators)

    @classmethod
    def of(
        cls, record: RunRecord, run: Run, assessment: Assessment, folder: Path | None
    ) -> RenderedResult:
        """Score a run that is over.

        Args:
            record: what was set.
            run: its state after everything that was said of it.
            assessment: fed with all of its samples.
            folder: where its files will be written; None = no files are wanted.

        Raises:
            MadrobError: something that was set for the run cannot be written down.
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

    Attributes:
        run: its state after everything that was said of it.
        folder: holds its recording, which is closed.
        missing: what its recording lacks, in words, the same each time.
        files: whether its files are wanted.
    """

    run: Run
    folder: Path
    missing: Sequence[str] = ()
    files: bool = True


class ScorableRun:
    """The data of a run, from which it is scored as often as is wanted.

    Args:
        record: what was set.
        assessment: fed with its samples.
        stored: keep what its stored result says of the data, if they are read once more.
    """

    def __init__(self, record: RunRecord, assessment: Assessment, *, stored: bool = False) -> None:
        self.assessment = assessment
        self._record = record
        self._stored = stored
        self._reported = 0

    def score(self, wanted: ToScore) -> RenderedResult:
        """Score it; where its condition was corrected, by its recording once more.

        Raises:
            MadrobError: something that was set for the run cannot be written down, or its
                recording cannot be read.
        """
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
    """A run of the results folder, read back: where it stands.

    Attributes:
        folder: where it lies.
        entries: its journal.
        scored: it, as it stands, without files.
        key: by which its scorer finds the data again.
        out_of_date: there is no result on disk, or it is not what the journal says.
    """

    folder: Path
    entries: tuple[Entry, ...]
    scored: RenderedResult
    key: int
    out_of_date: bool


def read_earlier(folder: Path, key: int) -> tuple[EarlierRun, ScorableRun]:
    """Read an earlier run back, and its data.

    Args:
        folder: where it lies.
        key: by which the data will be found again.

    Raises:
        MadrobError, OSError: it cannot be read.
    """
    opened = open_run(folder)
    recorded = opened.recorded
    data = ScorableRun(recorded.record, opened.assessment, stored=True)
    run = replace(recorded.run, evidence=evidence_told(folder, recorded.run))
    scored = data.score(ToScore(run, folder, files=False))
    return EarlierRun(folder, recorded.entries, scored, key, opened.out_of_date), data


class Scorer(Protocol):
    """Makes the results of one run after the other. Nothing here waits.

    Attributes:
        problem: why there is no result where one is wanted, in words, with the remedy; or that
            something goes on anew. None = all is well. From any thread.
    """

    @property
    def problem(self) -> str | None:
        """See above."""
        ...

    @property
    def hopeless(self) -> bool:
        """Whether several tries were in vain: what comes next need not wait for the result."""
        ...

    def warm(self) -> None:
        """Get ready beside the caller: the first result shall not wait."""
        ...

    def follow(self, record: RunRecord, start: float) -> LiveAssessment:
        """A run begins; again when its countdown begins anew.

        Args:
            record: what is set for it.
            start: its (planned) start, s since the epoch.

        Returns:
            What is to be fed with its samples.
        """
        ...

    def read(self, folder: Path) -> Future[EarlierRun]:
        """Read an earlier run; a `MadrobError` says why it cannot be. From any thread."""
        ...

    def look_back(self, earlier: EarlierRun) -> None:
        """An earlier run that was read is at hand."""
        ...

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        """Score the run at hand; it takes the place of what was asked before.

        Args:
            wanted: its state, and what is wanted.
            done: called with its result, in the thread that calls `deliver`; not for a run that is
                not at hand any more.
        """
        ...

    def deliver(self) -> None:
        """Give what has come."""
        ...

    def settle(self, limit: float) -> bool:
        """Wait `limit` s at most until there is what was asked for; returns whether it is."""
        ...

    def close(self) -> None:
        """End what was begun."""
        ...


class InlineScorer:
    """Scores at once, where it is asked; a `Scorer`."""

    problem = None
    hopeless = False

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._at_hand: ScorableRun | None = None
        self._read: dict[int, ScorableRun] = {}

    def warm(self) -> None:
        """Import what is large."""
        threading.Thread(target=load_filters, name="filters", daemon=True).start()

    def follow(self, record: RunRecord, start: float) -> Assessment:
        """See `Scorer`."""
        assessment = record.assessment(start)
        self._at_hand = ScorableRun(record, assessment)
        return assessment

    def read(self, folder: Path) -> Future[EarlierRun]:
        """See `Scorer`."""
        return InlineKeeper().ask(partial(self._read_now, folder))

    def _read_now(self, folder: Path) -> EarlierRun:
        earlier, data = read_earlier(folder, next(self._numbers))
        self._read = {earlier.key: data}  # the one before was not wanted after all
        return earlier

    def look_back(self, earlier: EarlierRun) -> None:
        """See `Scorer`."""
        self._at_hand = self._read.pop(earlier.key)

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        """See `Scorer`."""
        assert self._at_hand is not None
        done(self._at_hand.score(wanted))

    def deliver(self) -> None:
        """Nothing is left to be told."""

    def settle(self, limit: float) -> bool:
        """Nothing is left to be done."""
        return True

    def close(self) -> None:
        """Nothing was begun."""
