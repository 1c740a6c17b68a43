"""Carries out the effects of the core; their outcomes are queued as inputs for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any, assert_never

from msgspec.structs import replace as with_fields

from madrob_console.archive.folders import give_out_run_number
from madrob_console.archive.journal_agreement import Details
from madrob_console.archive.unfinished_runs import Unfinished, find_unfinished
from madrob_console.common.clock import Clock, seconds
from madrob_console.engine.core.acting import DURABLE_WITHIN
from madrob_console.engine.core.effects import (
    CloseJournal,
    CloseRecording,
    ConfigureTestbed,
    GiveOutNumber,
    GiveUpRecording,
    KeepJournal,
    KeepRecording,
    LeaveRun,
    ListCutOffRuns,
    MakeReports,
    OpenRecording,
    PlainValue,
    Publish,
    ReopenJournal,
    RetryWriting,
    Score,
    ToPerform,
    WithdrawLine,
    WriteLine,
    WriteResult,
)
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.inputs import (
    CutOffRunsListed,
    Input,
    JournalReopened,
    LineWithdrawn,
    LineWritten,
    NumberGivenOut,
    RecordingClosed,
    RecordingOpened,
    ResultWritten,
    RunScored,
)
from madrob_console.engine.core.now import DiskState, WorkerState
from madrob_console.engine.core.scored_run import RenderedResult, ScoringRequest
from madrob_console.engine.public_state import PublishedState
from madrob_console.engine.runtime.disk import DiskThreads, why_not
from madrob_console.engine.runtime.disk_watch import DiskWatch
from madrob_console.engine.runtime.evidence_process import EvidenceProcess
from madrob_console.engine.runtime.journal_writer import JournalLine, JournalWriter, OpenJournal
from madrob_console.engine.runtime.recording import Recording
from madrob_console.engine.runtime.result_writer import ResultWriter, UnwrittenRun
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.snapshot import RecorderView
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    encode_data,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from madrob_console.testbeds.source import Source
from recorder.bag import RawMessage
from scoring.protocol import StartPose

EVIDENCE_TIME = 0.5
"""The result waits at most this long until the bag of the evidence is finished, s."""


class Performer:
    """Carries out effects in the core's thread; nothing of it waits.

    Attributes:
        inputs: what came of the effects, oldest first.
        on_closing: has the last messages taken and recorded.
    """

    def __init__(
        self,
        source: Source,
        clock: Clock,
        config: EngineConfig,
        types: MessageTypes,
        disk: DiskThreads,
        scorer: Scorer,
        evidence: EvidenceProcess | None,
    ) -> None:
        self.inputs: deque[Input] = deque()
        self.on_closing: Callable[[], None] = lambda: None
        self.journal = JournalWriter(disk.own, disk.monotonic)
        self.results = ResultWriter(disk.own)
        self._source = source
        self._clock = clock
        self._config = config
        self._types = types
        self._type_names = {topic.name: topic.type for topic in referee_topics(types)}
        self._disk = disk
        self._scorer = scorer
        self._evidence = evidence
        self._disk_watch = DiskWatch(config.results, disk.own)
        self._line: JournalLine | None = None  # of the act that waits
        self._job: Future[Any] | None = None  # before its line is written
        self._opened: Recording | None = None  # until the core keeps it or gives it up
        self._reopened: OpenJournal | None = None  # likewise
        self._recording: Recording | None = None
        self._last: Recording | None = None
        self._early: list[RawMessage] = []
        self._lost_before: dict[str, int] = {}

    def deliver(self) -> None:
        """Have the answers that came since added to `inputs`."""
        self._disk.deliver()
        self._scorer.deliver()

    # ------------------------------------------------------------------ what the core is told

    @property
    def recorder_silent(self) -> float:
        """How long the disk has taken nothing of the recording, s. From any thread."""
        last = self._last
        return last.silent if last is not None and last.is_open else 0.0

    def disk_state(self, run: Run | None, now: float) -> DiskState:
        """With a `run` the disk is looked at for it; else what was seen last."""
        watch, journal = self._disk_watch, self.journal
        disk = watch.last if run is None else watch.look(run, now)
        return DiskState(
            disk.free,
            disk.problem,
            self._disk.own.silent,
            journal.problem,
            journal.unwritten[0],
            self.results.is_writing,
            self.results.waiting,
        )

    def worker_state(self, disk: DiskState, now: float, *, recorded_here: bool) -> WorkerState:
        """`recorded_here`: the current run is of this engine."""
        last = self._last
        recorder = RecorderView("closed") if last is None else last.view()
        torn = (last is not None and last.is_open) or recorder.problem or recorder.dropped
        place = "the run is safe on disk"
        if disk.journal_problem or disk.lines or (torn and recorded_here):
            place = "it is in memory alone: do not end the engine"
        return WorkerState(
            recorder,
            recorder_silent=self.recorder_silent,
            dropped={} if self._recording is None else self._recording.dropped(),
            scoring=self._scorer.problem(place) or "",
            hopeless=self._scorer.hopeless,
            evidence=None if self._evidence is None else self._evidence.evidence,
        )

    # ------------------------------------------------------------------ effects

    def carry_out(self, effect: ToPerform) -> None:  # noqa: C901  one case an effect
        match effect:
            case WriteLine(entry, awaited):
                self._write_line(entry, awaited=awaited)
            case WithdrawLine(withdrawal):
                self._withdraw_line(withdrawal)
            case GiveOutNumber():
                self._give_out_number(effect)
            case OpenRecording():
                self._open_recording(effect)
            case KeepRecording():
                self._keep_recording()
            case GiveUpRecording(withdrawal):
                self._give_up_recording(withdrawal)
            case CloseRecording():
                self._close_recording()
            case LeaveRun():
                self._leave_run(effect)
            case ReopenJournal():
                self._reopen_journal(effect)
            case KeepJournal():
                journal = self._reopened_journal()
                self.journal.adopt(journal, journal.lines)
            case CloseJournal():
                self._disk.own.submit_job(self._reopened_journal().close)
            case ListCutOffRuns():
                # behind the journal that was left
                self._disk.own.submit_job(lambda: None, lambda _: self.list_cut_off_runs())
            case Publish(what):
                self._publish(what)
            case ConfigureTestbed(condition):
                self._source.configure(condition)
            case Score(request):
                self._score(request)
            case WriteResult(request, scored, entries):
                self._write_result(request, scored, entries)
            case RetryWriting(results):
                self.journal.catch_up()
                if results:
                    self.results.retry(seconds(self._clock.now_ns()))
            case MakeReports(folder):
                self.results.make_reports(folder)
            case _:
                assert_never(effect)

    # ------------------------------------------------------------------ the journal

    def _write_line(self, entry: Entry, *, awaited: bool) -> None:
        if not awaited:
            self.journal.add_line(JournalLine(entry))
            return

        def written(problem: str | None) -> None:
            self.inputs.append(LineWritten(entry.id, problem))

        self._line, self._job = JournalLine(entry, written), None
        self.journal.add_line(self._line)

    def _withdraw_line(self, withdrawal: Entry) -> None:
        line, job = self._line, self._job
        if line is not None and not line.withdraw(withdrawal):
            return  # it is on disk: its answer comes
        if job is not None:
            job.cancel()  # else it is done when the disk is back
        if line is not None and job is not None:  # a start
            self._clock.release()
        self.inputs.append(LineWithdrawn(withdrawal))

    def _give_out_number(self, wanted: GiveOutNumber) -> None:
        def number_given(answer: Future[int]) -> None:
            problem = why_not(answer)
            number = 0 if problem else answer.result()
            self.inputs.append(NumberGivenOut(wanted.id, number, problem))

        job = partial(give_out_run_number, wanted.results, wanted.subject, wanted.condition.number)
        self._line, self._job = None, self._disk.own.submit_job(job, number_given)

    def _reopen_journal(self, effect: ReopenJournal) -> None:
        request, earlier = effect.request, effect.request.earlier
        if earlier.folder in self.results:
            why = "its result waits for the disk"
            self.inputs.append(JournalReopened(request, why, late=False))
            return
        latest = self._disk.monotonic() + DURABLE_WITHIN

        def reopened(answer: Future[OpenJournal]) -> None:
            problem = why_not(answer)
            self._reopened = None if problem else answer.result()
            late = self._disk.monotonic() >= latest
            self.inputs.append(JournalReopened(request, problem, late))

        job = partial(OpenJournal.reopen, earlier.folder, earlier.entries)
        self._disk.own.submit_job(job, reopened)

    def _reopened_journal(self) -> OpenJournal:
        journal, self._reopened = self._reopened, None
        assert journal is not None
        return journal

    def _leave_run(self, left: LeaveRun) -> None:
        problem, journal = left.problem or self.journal.problem, self.journal
        if problem is None and journal.unwritten[0]:
            problem = "its journal waits for the disk"
        if problem is not None and left.scored is not None and left.folder is not None:
            folder = journal.hand_over_folder()
            self.results.keep(UnwrittenRun(folder, left.scored, left.entries, problem))
        journal.leave_journal()
        self._scorer.forget()
        self._recording = self._last = None
        self._early = []
        self.results.retry(seconds(self._clock.now_ns()))

    def list_cut_off_runs(self) -> None:
        def listed(answer: Future[tuple[Unfinished, ...]]) -> None:
            if answer.exception() is None:  # else it blocks the start: a check says so
                self.inputs.append(CutOffRunsListed(answer.result()))

        self._disk.reading.submit_job(partial(find_unfinished, self._config.results), listed)

    # ------------------------------------------------------------------ the recording

    def record_messages(self, messages: Sequence[RawMessage]) -> None:
        """Record messages of the source; does nothing without an open recording."""
        if self._recording is not None:
            self._recording.add_topics(self._source.topics())
            self._recording.record_messages(messages)

    def _open_recording(self, wanted: OpenRecording) -> None:
        line = self._line = JournalLine(wanted.entries[-1])
        make = partial(
            Recording,
            self._config.results,
            wanted.record,
            wanted.start,
            self._source.topics(),
            wanted.entries,
            lossless=self._config.lossless,
        )

        def opened(answer: Future[Recording | None]) -> None:
            if (problem := why_not(answer)) is not None:
                self._clock.release()
                self.inputs.append(RecordingOpened(line.entry.id, None, problem))
            elif (recording := answer.result()) is not None:  # else it was withdrawn
                self._opened = recording
                self.inputs.append(RecordingOpened(line.entry.id, recording.folder, None))

        self._clock.hold_steady()
        self._job = self._disk.own.submit_job(partial(_open, make, line), opened)

    def _give_up_recording(self, withdrawal: Entry) -> None:
        recording, self._opened = self._opened, None
        assert recording is not None
        self._clock.release()
        self._disk.own.submit_job(partial(recording.give_up, withdrawal))

    def _keep_recording(self) -> None:
        recording, self._opened = self._opened, None
        assert recording is not None
        self.journal.adopt(recording.journal, recording.entries)
        self._recording = self._last = recording
        now_ns = self._clock.now_ns()
        early, self._early = (*self._early, *self._source.announcement.messages), []
        recording.add_topics(self._source.topics())
        recording.record_messages([with_fields(each, receive_ns=now_ns) for each in early])
        self._lost_before = self._lost()
        if self._evidence is not None:
            self._evidence.begin_recording(recording.folder, now_ns)

    def _close_recording(self) -> None:
        self.on_closing()
        recording, self._recording = self._recording, None
        assert recording is not None
        if self._evidence is not None:
            self._evidence.end_recording()
        losses = tuple(self._losses())

        def closed(_answer: Future[None]) -> None:
            recording.is_open = False
            self._clock.release()
            missing = (*recording.remarks(), *losses)
            self.inputs.append(RecordingClosed(missing, recording.unrecorded))

        self._disk.own.submit_job(partial(_close, recording, self._evidence), closed)

    def _losses(self) -> Iterator[str]:
        for topic, count in self._lost().items():
            if lost := count - self._lost_before.get(topic, 0):
                yield f"{topic}: {lost} messages were lost on the way"

    def _lost(self) -> dict[str, int]:
        return {status.topic: status.lost or 0 for status in self._source.status()}

    def _publish(self, what: Entry | PublishedState | StartPose | PlainValue) -> None:
        types, now_ns = self._types, self._clock.now_ns()
        match what:
            case Entry():
                topic, data = REFEREE_EVENT_TOPIC, encode_text(types, what.to_json())
            case PublishedState():
                topic, data = REFEREE_STATE_TOPIC, encode_text(types, what.text)
            case StartPose():
                topic, data = REFEREE_START_POSE_TOPIC, encode_start_pose(types, what, now_ns)
            case PlainValue(topic, value):
                data = encode_data(types, self._type_names[topic], value)
        message = RawMessage(topic, self._type_names[topic], data, now_ns, now_ns)
        self._source.publish(message)
        if self._recording is None:
            self._early.append(message)  # said before the bag is open: recorded when it is
        else:
            self._recording.record_messages([message])

    # ------------------------------------------------------------------ the result

    def _score(self, request: ScoringRequest) -> None:
        def scored(result: RenderedResult) -> None:
            self.inputs.append(RunScored(request, result))

        inside = self.journal.folder.inside
        self._scorer.score(replace(request, inside=inside), scored)

    def _write_result(
        self, request: ScoringRequest, scored: RenderedResult, entries: Sequence[Entry]
    ) -> None:
        def written(details: Details, problem: str | None) -> None:
            self.inputs.append(ResultWritten(request, scored, details, problem))

        self.results.write(self.journal.folder, scored, entries, written)


def _close(recording: Recording, evidence: EvidenceProcess | None) -> None:
    recording.close()
    if evidence is not None:
        evidence.wait_until_ended(EVIDENCE_TIME)


def _open(make: Callable[[], Recording], line: JournalLine) -> Recording | None:
    recording = make()
    if line.keep():
        return recording
    assert line.withdrawal is not None
    recording.give_up(line.withdrawal)
    return None
