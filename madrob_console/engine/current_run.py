"""The current run: its state, the referee's acts on it, and the side effects of each change."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path

from madrob_console.archive.evidence import account_entry, settled_account
from madrob_console.archive.folders import give_out_run_number
from madrob_console.archive.run_journal import Details
from madrob_console.archive.run_record import RunRecord
from madrob_console.engine.durable_acts import Answers, DurableActs, EarlierRuns, Told
from madrob_console.engine.evidence_client import EvidenceNotes
from madrob_console.engine.journal_writer import OpenJournal, Recording
from madrob_console.engine.observation import Happening, Observation, RunTracker
from madrob_console.engine.public_state import PublishedState
from madrob_console.engine.replay import DECIDED_ANEW, EngineContext
from madrob_console.engine.result_writer import CurrentResult
from madrob_console.engine.run_faults import RunFaults
from madrob_console.engine.run_recorder import EventPublisher, RunRecorder
from madrob_console.engine.scorer import EarlierRun, RenderedResult, ToScore
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    Act,
    Consequence,
    Correct,
    Situation,
    act_details,
    refusals,
)
from madrob_console.referee.evidence_account import EvidenceAccount, EvidenceStatus
from madrob_console.referee.flags import unrecorded_words
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change, after
from madrob_console.referee.records import FaultKind, TestbedFault
from madrob_console.referee.run import Phase, Run, note_fault, stop
from scoring.protocol import Outcome

SETTLING_PERIOD = 1.0
"""How often evidence that is still being written is checked, s."""


class CurrentRun:
    """The current run, one after the other: set up, going on or over, or an earlier one.

    Attributes:
        generation: changes with each run that replaces the one before.
        record, folder: None before its start.
        opened: the earlier run that it is; None = it is of this engine.
        decided: when it was found to be over, s since the epoch; None = it is not.
        over: whether its post-roll is over, too: nothing more is recorded.
        kept: a clean run with the handle zero of runs to come, while an earlier one is opened.
    """

    def __init__(
        self,
        engine_context: EngineContext,
        observation: Observation,
        earlier: EarlierRuns,
        tell: Callable[[Path], None],
    ) -> None:
        self.generation = 0
        self.run = Run()
        self.record: RunRecord | None = None
        self.folder: Path | None = None
        self.opened: EarlierRun | None = None
        self.decided: float | None = None
        self.over = False
        self.kept = Run()
        self.event_publisher = EventPublisher(engine_context)
        self.recorder = RunRecorder(engine_context, self.event_publisher)
        self.result = CurrentResult(
            engine_context.scorer,
            engine_context.keepers,
            self.event_publisher,
            again=self.score,
            written=self._written,
            shown=self._shown,
            tell=tell,
        )
        self._engine_context = engine_context
        self._observation = observation
        self._earlier = earlier
        self._replay = replay = engine_context.replay
        self._missing: tuple[str, ...] = ()
        self._settling = -math.inf
        self._drift: tuple[RunRecord, float] | None = None
        self._fault_notes = RunFaults()
        self._evidence_notes = EvidenceNotes()
        if replay is not None:
            self.record, self.folder = replay.recorded.recorded_as, replay.source.path
            zero, samples = self.record.handle_zero, self.record.zero_samples
            self.run = Run(handle_zero=zero, zero_samples=samples)

    # ------------------------------------------------------------------ one after the other

    @property
    def came_words(self) -> str:
        """Why the current run cannot be replaced by the requested one."""
        setup = self.run.setup
        if self.opened is not None or setup is None:
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
        fresh = self.run.cleared if self.opened is None else self.kept
        self._leave()
        self.run = fresh  # the zero of an opened run is of its day

    def take_up(self, opened: EarlierRun, journal: OpenJournal, *, invalid: bool) -> None:
        """Replace it by an earlier run, as if that had stopped just now.

        `invalid` stops a run that was cut off as aborted: it does not count.
        """
        if self.opened is None:
            self.kept = self.run.cleared
        self._leave()
        self.event_publisher.journal.adopt(journal, opened.entries)
        self.opened, self.record = opened, opened.scored.record
        stood = replace(opened.scored.run, journal=None)
        self.folder, self.run = opened.folder, stood
        self._observation.look_back(opened.scored.past)
        if self.run.active:
            outcome = Outcome.ABORTED if invalid else Outcome.INTERRUPTED
            reason = "the program or the machine failed"
            self.interrupt(reason, opened.entries[-1].time, outcome)
            self.decided = None
        self.run = replace(self.run, issue=max(1, self.run.issue))
        if self.run == stood and not opened.out_of_date:
            self.result.scored = opened.scored
        else:
            cut_off = self.run.outcome is not stood.outcome
            self.score(write=opened.out_of_date or cut_off)

    @property
    def place(self) -> str:
        """Where all that was recorded and decided is, in words."""
        journal, recorder = self.event_publisher.journal, self.recorder.view()
        torn = self.recorder.open or recorder.problem or recorder.dropped
        if journal.problem or journal.unwritten[0] or (torn and self.opened is None):
            return "it is in memory alone: do not end the engine"
        return "the run is safe on disk"

    def _leave(self) -> None:
        self.generation += 1
        self.result.leave(self.folder)
        self.event_publisher.begin_run()
        if self.result.missing:
            self._earlier.look_again()
        self.record = self.folder = self.opened = self.decided = None
        self.over = False
        self.result.clear()
        self._missing = ()
        self._observation.look_back()
        self._fault_notes = RunFaults()
        self._evidence_notes = EvidenceNotes()
        self.recorder.clear()

    def adopt(self, made: Recording) -> None:
        self.record, self.folder = made.record, made.folder
        self.recorder.adopt(made, self._engine_context.clock.now_ns())

    # ------------------------------------------------------------------ what becomes of it

    def go_on(self, run: Run, happened: Sequence[Happening] = ()) -> None:
        before, self.run = self.run, run
        for one in happened:
            if self._replay is None or one.change in DECIDED_ANEW:
                self.note(one)
        if run.start != before.start:
            self._count_down(run)
        if before.active and run.phase is Phase.STOPPED:
            self.decided = self._engine_context.now()
            self._observation.judge(run)
        if run is not before and PublishedState.of(run) != PublishedState.of(before):
            self.event_publisher.announce_state(run)

    def _count_down(self, run: Run) -> None:
        observation = self._observation
        if observation.course is not None:
            observation.course.restart(run, self._engine_context.now())
            observation.follow(observation.course)
        if observation.course is not None or run.phase is not Phase.COUNTDOWN:
            return
        assert self.record is not None
        replayed = None if self._replay is None else self._replay.recorded.run
        before = observation.sensors.newest() if replayed is None else None
        silence = self._engine_context.config.limits.lost
        start = -math.inf if replayed is None else replayed.start or -math.inf
        observation.follow(RunTracker(self.record, run, silence, before, start))

    def interrupt(
        self, reason: str, at: float | None = None, outcome: Outcome = Outcome.INTERRUPTED
    ) -> None:
        """Cut the run off `at` its end (s since the epoch), by no sensor, clock or referee."""
        at = at or self._engine_context.now()
        details = {"outcome": outcome, "time": at}
        stopped = Happening(Origin.SYSTEM, Change.RUN_STOPS, reason, details)
        self.go_on(stop(self.run, outcome, at, reason), [stopped])

    def note(self, happened: Happening) -> Entry:
        """Write a line that takes effect whatever the disk says."""
        if happened.change is Change.FAULT:
            at, kind = happened.details["time"], happened.details["kind"]
            self.run = note_fault(self.run, TestbedFault(at, happened.reason, kind))
        entry = Entry(
            self._engine_context.now(),
            happened.origin,
            happened.change.value,
            reason=happened.reason,
            details=happened.details,
        )
        self.write(entry)
        return entry

    def note_faults(self, faults: Mapping[tuple[str, FaultKind], str], now: float) -> None:
        """Note each lasting fault of the testbed once; `now` is s since the epoch."""
        self._write_faults(self._fault_notes.due(faults, now))

    def _write_faults(self, faults: Iterable[TestbedFault]) -> None:
        for fault in faults:
            details = {"time": fault.time, "kind": fault.kind}
            self.note(Happening(Origin.SYSTEM, Change.FAULT, fault.text, details))

    def note_evidence(self, status: EvidenceStatus, now: float) -> None:
        for words in self._evidence_notes.due(status, self._start, now):
            self.note(Happening(Origin.SYSTEM, Change.EVIDENCE, words, {"time": now}))

    @property
    def _start(self) -> float:
        """In s since the epoch."""
        assert self.run.start is not None
        return self.run.start

    def write(self, entry: Entry) -> None:
        self.event_publisher.write(entry, self.run.fixed_start)

    # ------------------------------------------------------------------ its end

    def finish(self) -> None:
        """Nothing more is recorded: have the bag closed, and the run scored."""
        self._write_faults(self._fault_notes.all())
        self.recorder.finish(self._recorded)

    def _recorded(self, missing: tuple[str, ...], unrecorded: int) -> None:
        self._missing = missing
        self._engine_context.clock.release()
        if (account := self.recorder.evidence(self._start)) is not None:
            self._note_account(account)
        if unrecorded:
            words, details = unrecorded_words(unrecorded), {"messages": unrecorded}
            self.run = replace(self.run, unrecorded=unrecorded)
            self.note(Happening(Origin.SYSTEM, Change.UNRECORDED, words, details))
        self.run = replace(self.run, issue=1)
        self.score()

    def _note_account(self, account: EvidenceAccount) -> None:
        """Note what was recorded of the evidence: its file gets complete by itself."""
        self.run = replace(self.run, evidence=account)
        self.write(account_entry(account, self._engine_context.now()))

    def settle_evidence(self, now: float, *, ending: bool = False) -> None:
        """Once its evidence is in the files, note how much is there; nothing waits for that.

        `ending`: the engine ends, this is the last call.
        """
        told, generation = self.run.evidence, self.generation
        idle = self.result.settled and self.folder is not None and self._replay is None
        rests = not ending and 0 <= now - self._settling < SETTLING_PERIOD
        if told is None or told.unwritten == 0 or not idle or rests:
            return
        assert self.folder is not None
        self._settling = now

        def heard(answer: Future[EvidenceAccount | None]) -> None:
            account = None if answer.exception() else answer.result()
            same = generation == self.generation and told == self.run.evidence
            if account is None or not same or not self.result.settled:
                return  # it is looked for again
            self._note_account(account)
            if self.run.closure is None:
                self.score()

        keepers = self._engine_context.keepers
        disk = keepers.own if ending else keepers.reading
        inside = self.event_publisher.journal.folder.inside
        disk.submit_job(partial(settled_account, inside, told), heard)

    def score(self, *, write: bool = True) -> None:
        """Ask for its result, and have it written unless `write` says no."""
        self._observation.judge(self.run)
        assert self.record is not None
        assert self.folder is not None
        course, stored = self._observation.course, self.opened is not None
        samples = None if course is None else course.assessment
        inside = self.folder if self._replay else self.event_publisher.journal.folder.inside
        self.result.request_result(
            ToScore(
                self.record, self.run, self.folder, inside, samples, self._missing, stored, write
            )
        )

    def _written(self, details: Details) -> None:
        self.note(Happening(Origin.SYSTEM, Change.RESULT_WRITTEN, details=details))

    def _shown(self, scored: RenderedResult) -> None:
        rest = scored.result.rest
        if self.opened is None and rest is not None and rest.drift is not None:
            drifted = rest.drifted(scored.record.thresholds.touch_force)
            self._drift = (scored.record, rest.drift) if drifted else None
        if self._observation.course is None or self.run.corrections:  # it followed something else
            self._observation.look_back(scored.past)


# Acts of the referee: judged against the situation and carried out at most once.


class Acting:
    """Does the referee's acts to the current run; `durable` has those that wait for the disk.

    `advance` is called after an act: it judges at once what follows.
    """

    def __init__(
        self,
        engine_context: EngineContext,
        at_hand: CurrentRun,
        situation: Callable[[], Situation],
        advance: Callable[[], None],
    ) -> None:
        self._engine_context = engine_context
        self._at_hand = at_hand
        self._situation = situation
        self._advance = advance
        self._answers = Answers()
        self.durable = DurableActs(
            engine_context, at_hand.event_publisher, at_hand.recorder, situation, self._take_effect
        )

    def refusals(self, situation: Situation) -> dict[str, str]:
        """Act name -> why no such act is possible now; those that are possible are missing."""
        found, active = refusals(situation), situation.run.active
        for act in ACTS:
            if act.name not in found and (why := self.durable.refusal(act, active=active)):
                found[act.name] = why
        if self.durable.waiting is not None and not active:
            found.pop(Abort.name, None)
        return found

    def submit(self, act: Act, done: Told, name: str, origin: Origin = Origin.REFEREE) -> None:
        """Do an act, if it is possible: at once, or when its line is on disk.

        `done` is called once: why it was refused, in words, or None. A known `name` (its id) is
        answered again, not done twice.
        """
        answer = self._answers.expect(name, done)
        if answer is not None:
            self._judge(act, answer, name, origin)

    def _judge(self, act: Act, answer: Told, name: str, origin: Origin) -> None:
        durable, run = self.durable, self._at_hand.run
        if durable.waiting is not None and isinstance(act, Abort) and not run.active:
            starts = Consequence.COUNTDOWN in durable.waiting.consequences
            who = "the referee" if origin is Origin.REFEREE else "an abort over ROS"
            why = "aborted before the countdown began" if starts else f"taken back by {who}"
            why = f"{why}: {act.reason}".rstrip(": ")
            if durable.withdraw_or(why, then=lambda: self._judge(act, answer, name, origin)):
                answer(None)
        elif refused := act.refusal(self._situation()) or durable.refusal(act, active=run.active):
            answer(refused)
        elif act.at_once or self._waits_for_start(act):
            self._do(act, origin)
            answer(None)
        else:
            at = self._engine_context.now()
            name = name or f"{self._engine_context.clock.now_ns():x}"
            act, prepare = self._completed(act)
            durable.submit(act, lambda act: _line_of(act, run, at, origin, name), answer, prepare)

    def _waits_for_start(self, act: Act) -> bool:
        """Whether its line waits for the start, before which a run has no journal on disk."""
        return self._at_hand.folder is None and Consequence.RECORDING not in act.consequences

    def _completed(self, act: Act) -> tuple[Act, Callable[[], Act] | None]:
        """The act with what only the engine knows, and what completes it on the disk, if any."""
        if not isinstance(act, Correct):
            return act.settled(self._situation()), None
        at_hand, act = self._at_hand, act.named(self._situation())
        number = at_hand.run.number_in(act.subject, act.condition)
        if number is not None:
            return act.numbered(number), None
        assert at_hand.folder is not None
        return act, partial(_numbered, act, at_hand.folder.parent)

    def _do(self, act: Act, origin: Origin) -> None:
        brings, at, situation = act.consequences, self._engine_context.now(), self._situation()
        at_hand, act = self._at_hand, act.settled(situation)
        if Consequence.NEW_RUN in brings:
            at_hand.begin_next()
            situation = replace(situation, run=at_hand.run)
        run = act.apply(situation, at)
        at_hand.write(_line_of(act, run, at, origin))
        if Consequence.HANDLE_ZERO in brings:
            at_hand.kept = run.cleared
        if Consequence.NEW_RUN in brings:
            assert run.setup is not None
            self._engine_context.source.configure(run.setup.condition)
            at_hand.event_publisher.announce_start_pose(run.setup.start_pose)
        self._done(run)

    def _take_effect(self, act: Act, entry: Entry, made: Recording | None) -> None:
        at_hand = self._at_hand
        if made is not None:
            at_hand.adopt(made)
        at_hand.event_publisher.say(entry, at_hand.run.fixed_start)
        if Consequence.COUNTDOWN in act.consequences:
            details = {"time": self._engine_context.now()}
            begins = at_hand.note(Happening(Origin.CLOCK, Change.COUNTDOWN_BEGINS, details=details))
            self._done(after(at_hand.run, begins))
        else:
            self._done(act.apply(self._situation(), entry.time))

    def _done(self, run: Run) -> None:
        at_hand = self._at_hand
        before = at_hand.run.phase
        at_hand.go_on(run)
        if at_hand.result.wanted and Phase.STOPPED in (before, run.phase):
            at_hand.score()  # but what was final stays as it was signed
        self._advance()


def _numbered(act: Correct, results: Path) -> Act:
    """A correction with a run number that was never used; waits for the disk."""
    number = give_out_run_number(results, act.subject, act.condition.number)
    return act.numbered(number)


def _line_of(act: Act, run: Run, at: float, origin: Origin, name: str = "") -> Entry:
    referee = run.referee if origin is Origin.REFEREE else ""
    return Entry(at, origin, act.name, referee, act.reason_given, act_details(act), name)
