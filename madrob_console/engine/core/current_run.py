"""The current run: its state, and the effects of each change of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec

from madrob_console.archive.run_record import RunRecord
from madrob_console.engine.core.effects import (
    CloseRecording,
    Effect,
    KeepJournal,
    LeaveRun,
    ListCutOffRuns,
    MakeReports,
    Publish,
    WriteLine,
    WriteResult,
)
from madrob_console.engine.core.event_log import EventLog
from madrob_console.engine.core.inputs import (
    OpenEarlierRun,
    RecordingClosed,
    ResultWritten,
    RunScored,
)
from madrob_console.engine.core.now import Now
from madrob_console.engine.core.observation import Observation
from madrob_console.engine.core.result_state import ResultState
from madrob_console.engine.core.run_faults import RunFaults
from madrob_console.engine.core.run_lines import RunLines
from madrob_console.engine.core.run_tracker import Happening, RunTracker
from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult, ScoringRequest
from madrob_console.engine.public_state import PublishedState
from madrob_console.referee.evidence import Evidence
from madrob_console.referee.flags import unrecorded_words
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import FaultKind, TestbedFault
from madrob_console.referee.run import Phase, Run, note_fault, stop
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome

DECIDED_ANEW = (Change.RUN_STARTS, Change.EVENT, Change.TIMEOUT_ELAPSED, Change.RUN_STOPS)
"""A replay decides these anew from sensors and clock. The rest is taken from the journal: the
referee's acts, a failure of the machine, and what the bag cannot tell because it happened before or
beside it (false starts, faults of the testbed).
"""


@dataclass(frozen=True, slots=True)
class ReplayedRun:
    """The run that a replay goes through again."""

    record: RunRecord
    folder: Path
    official: Run

    def begin(self) -> Run:
        record = self.record
        return Run(handle_zero=record.handle_zero, zero_samples=record.zero_samples)


@dataclass(eq=False)
class _State:
    """What belongs to one run, and is new with the next one.

    Attributes:
        record, folder: None before its start.
        opened: the earlier run that it is; None = it is of this engine.
        decided: when it was found to be over, s since the epoch; None = it is not.
        over: whether its post-roll is over, too: nothing more is recorded.
        recording, closing: whether its recording is open, or being closed.
        missing: what its closed recording lacks, in words.
        evidence_problem: what was said last of the evidence.
    """

    record: RunRecord | None = None
    folder: Path | None = None
    opened: EarlierRun | None = None
    decided: float | None = None
    over: bool = False
    recording: bool = False
    closing: bool = False
    missing: tuple[str, ...] = ()
    lines: RunLines = field(default_factory=RunLines)
    result: ResultState = field(default_factory=ResultState)
    faults: RunFaults = field(default_factory=RunFaults)
    evidence_problem: str = ""


class CurrentRun:
    """One run after the other: set up, going on or over, or an earlier one.

    What it wants done is added to `effects`.

    Attributes:
        generation: changes with each run that replaces the one before.
        state: what belongs to this run alone.
        zeroed: a clean run with the handle zero of runs to come, while an earlier one is opened.
    """

    def __init__(
        self,
        observation: Observation,
        silence: float,
        effects: list[Effect],
        recorded: ReplayedRun | None = None,
    ) -> None:
        self.generation = 0
        self.run = Run()
        self.state = _State()
        self.zeroed = Run()
        self.log = EventLog()
        self._observation = observation
        self._silence = silence
        self._effects = effects
        self._recorded = recorded
        self._drift: tuple[RunRecord, float] | None = None
        if recorded is not None:
            self.run = recorded.begin()
            self.state = _State(recorded.record, recorded.folder)

    # ------------------------------------------------------------------ one after the other

    @property
    def level(self) -> int:
        """Capability level: of the result, or before there is one of the steps done; else 0."""
        scored, procedure = self.state.result.scored, self._observation.procedure
        if scored is not None:
            return int(scored.result.indicators[IndicatorName.CAPABILITY_LEVEL].value or 0)
        return 0 if procedure is None else procedure.level

    @property
    def replaced_words(self) -> str:
        """Why the current run cannot be replaced by the requested one."""
        setup = self.run.setup
        if self.state.opened is not None or setup is None:
            return "another run was opened meanwhile"
        which = f"run {setup.run_number} of subject {setup.subject}"
        return f"{which} was set up meanwhile, and stays: the history (h) opens the other one"

    @property
    def drift(self) -> float | None:
        """Offset of the handle at rest from its zero after the last run of this engine, N.

        None up to half the touch threshold, where it is unknown, and where the handle was
        zeroed since.
        """
        if self._drift is None:
            return None
        record, drift = self._drift
        zero = (record.handle_zero, record.zero_samples)
        return drift if zero == (self.run.handle_zero, self.run.zero_samples) else None

    def begin_next(self) -> None:
        """Replace it by a clean next run, with the handle zero that was set last."""
        fresh = self.run.cleared if self.state.opened is None else self.zeroed
        self._leave()
        self.run = fresh  # the zero of an opened run is of its day

    def open_earlier(self, request: OpenEarlierRun, now: Now) -> None:
        """Replace it by an earlier run, as if that had stopped just now."""
        earlier = request.earlier
        if self.state.opened is None:
            self.zeroed = self.run.cleared
        self._leave()
        self._effects.append(KeepJournal())
        scored = earlier.scored
        self.state = _State(scored.record, earlier.folder, earlier, lines=RunLines(earlier.entries))
        self.run = before = replace(scored.run, journal=None)
        self._observation.look_back(scored.past)
        if self.run.active:
            self._end_cut_off(request, now)
        self.run = replace(self.run, issue=max(1, self.run.issue))
        if self.run == before and not earlier.out_of_date:
            self.state.result.scored = scored
        else:
            cut_off = self.run.outcome is not before.outcome
            self.score(now, write=earlier.out_of_date or cut_off)

    def _end_cut_off(self, request: OpenEarlierRun, now: Now) -> None:
        """Stop it as interrupted, as its request says, or by a timeout that was declared."""
        timeout_at, reason = self.run.timeout_at, "the program or the machine failed"
        if request.invalid:
            self.interrupt(reason, now, request.earlier.entries[-1].time, Outcome.ABORTED)
        elif timeout_at is not None:
            self.interrupt(self.run.outcome_reason, now, timeout_at, Outcome.TIMEOUT)
        else:
            self.interrupt(reason, now, request.earlier.entries[-1].time)
        self.state.decided = None

    @property
    def left(self) -> LeaveRun:
        """The effect of leaving it."""
        state, result = self.state, self.state.result
        return LeaveRun(state.folder, state.lines.entries, result.scored, result.problem)

    def _leave(self) -> None:
        self.generation += 1
        self._effects.append(self.left)
        if self.state.result.is_missing:
            self._effects.append(ListCutOffRuns())
        self.state = _State()
        self.log.clear()
        self._observation.look_back()

    # ------------------------------------------------------------------ what becomes of it

    def advance(self, now: Now) -> None:
        """Advance the run by sensors and clock."""
        self.change(*self._observation.advance(self.run, now.time, now.judged), now)

    def change(self, run: Run, happened: Sequence[Happening], now: Now) -> None:
        """Put it into its new state, and note what happened."""
        before, self.run = self.run, run
        for each in happened:
            if self._recorded is None or each.change in DECIDED_ANEW:
                self.note(each, now)
        if run.start != before.start:
            self._count_down(run, now)
        if before.active and run.phase is Phase.STOPPED:
            self.state.decided = now.time
            self._observation.judge(run)
        if run is not before and PublishedState.of(run) != PublishedState.of(before):
            self._effects.append(Publish(PublishedState.of(run)))

    def _count_down(self, run: Run, now: Now) -> None:
        observation = self._observation
        if observation.tracker is not None:
            observation.tracker.restart(run, now.time)
            observation.follow(observation.tracker)
        if observation.tracker is not None or run.phase is not Phase.COUNTDOWN:
            return
        assert self.state.record is not None
        official = None if self._recorded is None else self._recorded.official
        before = observation.sensors.newest() if official is None else None
        start = -math.inf if official is None else official.start or -math.inf
        observation.follow(RunTracker(self.state.record, run, self._silence, before, start))

    def interrupt(
        self,
        reason: str,
        now: Now,
        at: float | None = None,
        outcome: Outcome = Outcome.INTERRUPTED,
    ) -> None:
        """Cut the run off `at` its end (s since the epoch), by no sensor, clock or referee."""
        at = at or now.time
        details = {"outcome": outcome, "time": at}
        stopped = Happening(Origin.SYSTEM, Change.RUN_STOPS, reason, details)
        self.change(stop(self.run, outcome, at, reason), [stopped], now)

    def note(self, happened: Happening, now: Now) -> Entry:
        """Write a line that takes effect whatever the disk says."""
        if happened.change is Change.FAULT:
            at, kind = happened.details["time"], happened.details["kind"]
            self.run = note_fault(self.run, TestbedFault(at, happened.reason, kind))
        entry = Entry(
            now.time,
            happened.origin,
            happened.change.value,
            reason=happened.reason,
            details=happened.details,
        )
        self.write(entry)
        return entry

    def write(self, entry: Entry) -> None:
        """Write a line to journal, log, topic and bag; if the disk refuses it, it waits."""
        self.state.lines.add(entry)
        self._effects.append(WriteLine(entry))
        self.publish(entry)

    def publish(self, entry: Entry) -> None:
        self.log.add_line(entry, self.run.fixed_start)
        self._effects.append(Publish(entry))

    def note_faults(self, faults: Mapping[tuple[str, FaultKind], str], now: Now) -> None:
        """Note each lasting fault of the testbed once."""
        self._write_faults(self.state.faults.due(faults, now.time), now)

    def _write_faults(self, faults: Iterable[TestbedFault], now: Now) -> None:
        for fault in faults:
            details = {"time": fault.time, "kind": fault.kind}
            self.note(Happening(Origin.SYSTEM, Change.FAULT, fault.text, details), now)

    def note_evidence(self, evidence: Evidence, now: Now) -> None:
        """Note each new problem of what is recorded beside the run."""
        words = evidence.problem
        if words and words != self.state.evidence_problem:
            self.note(Happening(Origin.SYSTEM, Change.EVIDENCE, words, {"time": now.time}), now)
        self.state.evidence_problem = words

    # ------------------------------------------------------------------ its end

    def finish(self, now: Now) -> None:
        """Nothing more is recorded: have the bag closed, and the run scored."""
        self._write_faults(self.state.faults.all(), now)
        self.state.recording, self.state.closing = False, True
        self._effects.append(CloseRecording())

    def note_recording(self, closed: RecordingClosed, now: Now) -> None:
        self.state.missing, self.state.closing = closed.missing, False
        if (evidence := now.workers.evidence) is not None:
            self.run = replace(self.run, evidence=evidence)
            details = msgspec.to_builtins(evidence)
            what = Change.EVIDENCE_RECORDED.value
            self.write(Entry(now.time, Origin.SYSTEM, what, reason=evidence.words, details=details))
        if closed.unrecorded:
            words = unrecorded_words(closed.unrecorded)
            details = {"messages": closed.unrecorded}
            self.run = replace(self.run, unrecorded=closed.unrecorded)
            self.note(Happening(Origin.SYSTEM, Change.UNRECORDED, words, details), now)
        self.run = replace(self.run, issue=1)
        self.score(now)

    def score(self, now: Now, *, write: bool = True) -> None:
        """Ask for its result, and have it written unless `write` says no."""
        self._observation.judge(self.run)
        state = self.state
        assert state.record is not None
        assert state.folder is not None
        tracker, stored = self._observation.tracker, state.opened is not None
        samples = None
        if tracker is not None and tracker.assessment.is_in_order:
            samples = tracker.assessment  # else the recording is read
        wanted = ScoringRequest(
            state.record, self.run, state.folder, samples, state.missing, stored, write
        )
        self._effects.append(state.result.request(wanted, state.lines.mark, now.monotonic))

    def take_result(self, scored: RunScored) -> None:
        """Have a result written that is still wanted; without files it is shown at once."""
        if scored.request is not self.state.result.awaited:
            return
        if scored.request.files:
            self._effects.append(
                WriteResult(scored.request, scored.scored, self.state.lines.entries)
            )
        else:
            self._show(scored.request, scored.scored)

    def note_result(self, written: ResultWritten, now: Now) -> None:
        """Show a result: it is on disk, or the disk has refused it."""
        request, result = written.request, self.state.result
        if request.folder != self.state.folder:  # it was left meanwhile, and is retried as such
            return
        result.problem = written.problem and f"the result is NOT on disk: {written.problem}"
        if result.problem is None:
            details = written.details
            self.note(Happening(Origin.SYSTEM, Change.RESULT_WRITTEN, details=details), now)
            self._effects.append(MakeReports(request.folder))
        self._show(request, written.scored)

    def _show(self, request: ScoringRequest, scored: RenderedResult) -> None:
        if not self.state.result.show(request, scored):
            return
        rest = scored.result.rest
        if self.state.opened is None and rest is not None and rest.drift is not None:
            drifted = rest.drifted(scored.record.thresholds.touch_force)
            self._drift = (scored.record, rest.drift) if drifted else None
        if self._observation.tracker is None or self.run.corrections:  # it followed something else
            self._observation.look_back(scored.past)

    # ------------------------------------------------------------------ a replay

    def end_replay(self, now: Now) -> None:
        """Stop it and score it; where the recording ends before the run, as the journal says."""
        assert self._recorded is not None
        run, official = self.run, self._recorded.official
        if official.outcome is None:
            run = stop(run, Outcome.INTERRUPTED, now.time, official.ending.reason)
        elif run.outcome is None:
            run = replace(
                run,
                phase=official.phase,
                outcome=official.outcome,
                outcome_reason=official.outcome_reason,
                stop=official.stop,
                timeout_at=None,
            )
        self.change(run, (), now)
        self.score(now, write=False)
