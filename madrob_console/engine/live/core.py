"""The engine: joins source, recorder, detector and the referee's domain.

It decides everything and waits for nobody. It is single-threaded: whoever owns it calls
`step` again and again; `madrob_console.engine.process.local` does so in a thread of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from madrob_console.archive.folders import next_run_number
from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import OpenedRun, Scored
from madrob_console.archive.unfinished import Unfinished, find_unfinished
from madrob_console.clock import Clock, seconds
from madrob_console.engine.live.chronicle import Chronicle
from madrob_console.engine.live.course import Course, Happening
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.event_log import EventLog
from madrob_console.engine.live.fault_notes import FaultNotes
from madrob_console.engine.live.observation import Observation
from madrob_console.engine.live.pre_start import PreStart
from madrob_console.engine.live.replay import DECIDED_ANEW, NO_ACTS, OWN_RUN, Replay
from madrob_console.engine.live.result_keeper import ResultKeeper, Unwritten
from madrob_console.engine.live.run_recorder import RunRecorder
from madrob_console.engine.live.view import NO_STEPS, elapsed, faults, question, remaining
from madrob_console.engine.shown.playback import NO_REPLAY, PlaybackCommand
from madrob_console.engine.shown.snapshot import ExportView, Snapshot
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import MessageTypes
from madrob_console.referee.acts import ACTS, Act, Consequence, Situation, act_details, refusals
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change, after
from madrob_console.referee.run import Phase, Run, TestbedFault
from madrob_console.referee.transitions import stop
from madrob_console.testbeds.source import Source
from recorder.message import RawMessage
from scoring.protocol import POST_ROLL, Outcome

WATCH_PERIOD = 0.1
"""Between two looks at the topics in a run, s."""


class Engine:
    """One testbed, one run after the other; or one recorded run once more.

    Args:
        source: the testbed; opened with `open`.
        clock: steady time.
        config: what it needs to know.
        types: the message types, shared with the source.
        replay: the recorded run that `source` and `clock` belong to; None = a live testbed.

    Attributes:
        on_result: called with the run's folder and result when that is on disk; must not wait.
    """

    def __init__(
        self,
        source: Source,
        clock: Clock,
        config: EngineConfig,
        types: MessageTypes,
        replay: Replay | None = None,
    ) -> None:
        self.source = source
        self.config = config
        self._clock = clock
        self._types = types
        self._replay = replay
        self._chronicle = Chronicle(source, clock, types)
        self._fault_notes = FaultNotes()
        self._recorder = RunRecorder(source, config, self._chronicle)
        self._record: RunRecord | None = None
        self._folder: Path | None = None
        self._opened: OpenedRun | None = None
        self._unfinished: tuple[Unfinished, ...] = ()
        self._kept_zero = 0.0
        self._decided: float | None = None
        self._scored: Scored | None = None
        self.on_result: Callable[[Path, Scored], None] | None = None
        self._keeper = ResultKeeper(self._written, self._tell)
        self._looked: float | None = None
        self._watched = 0.0
        self._begin()

    @classmethod
    def of_recording(cls, replay: Replay, config: EngineConfig, types: MessageTypes) -> Engine:
        """An engine that goes through a recorded run once more, with the recording's numbers."""
        source = replay.source
        return cls(source, source.clock, replay.config(config), types, replay)

    def _begin(self) -> None:
        """Nothing was seen and nothing done; a replay begins anew."""
        config = self.config
        self._observation = Observation(
            config.mappings, config.thresholds, config.limits, self._types
        )
        self._sensors = self._observation.sensors
        self._pre_start = PreStart(config, self._sensors)
        self._chronicle.begin()
        self._clear()
        self._run = Run()
        if self._replay is not None:
            self._replay.begin()
            self._record, self._folder = self._replay.recorded.record, self._replay.source.path
            self._run = Run(handle_zero=self._record.handle_zero)

    # ------------------------------------------------------------------ for the owner

    @property
    def log(self) -> EventLog:
        """The event log."""
        return self._chronicle.log

    @property
    def run(self) -> Run:
        """The state of the run."""
        return self._run

    @property
    def scored(self) -> Scored | None:
        """The run's result, once it was computed."""
        return self._scored

    @property
    def result_problem(self) -> str | None:
        """Why the result is not on disk, in words; None when it is."""
        return self._keeper.problem

    @property
    def folder(self) -> Path | None:
        """The run's folder, once there is one."""
        return self._folder

    @property
    def busy(self) -> bool:
        """Whether a run goes on or is still being recorded; nothing is lost with a replay."""
        return self._replay is None and (self._run.active or self._recorder.recording)

    @property
    def replay(self) -> Replay | None:
        """The recorded run that is gone through; None for a live testbed."""
        return self._replay

    def now(self) -> float:
        """Steady time, s since the epoch."""
        return seconds(self._clock.now_ns())

    def open(self) -> None:
        """Connect to the testbed.

        Raises:
            MadrobError: it cannot be reached.
        """
        self.source.open()
        if self._replay is not None:
            self.step(0.0)
            return
        self._chronicle.announce_state(self._run)
        with suppress(
            MadrobError
        ):  # a folder that cannot be read blocks the start: a check says so
            self._unfinished = find_unfinished(self.config.results)

    def step(self, timeout: float) -> None:
        """Take what the testbed sends within `timeout` s of clock time, and decide."""
        self._looked = self.now()
        self._receive(self.source.take(timeout))
        if self._replay is not None:
            self._repeat_decisions(self._replay)
        self._advance()

    def close(self) -> None:
        """Disconnect; a run that goes on is cut off, scored as interrupted and kept."""
        if self.busy and self._run.active:
            self._interrupt("the console was closed during the run")
        if self._recorder.recording:
            self._finish()
        self._try_again(self.now())
        self._chronicle.close()
        self.source.close()

    def next_run_number(self, subject: int, condition_number: int) -> int:
        """The next run number that was never used for this subject and condition.

        Raises:
            MadrobError: the results folder cannot be read, or all numbers are used.
        """
        return next_run_number(self.config.results, subject, condition_number)

    def opening_refusal(self) -> str | None:
        """Why no earlier run can be opened now, in words; None when one can."""
        if self._replay is not None:
            return OWN_RUN
        if self._run.active:
            return "a run is going on"
        if self._run.phase is Phase.STOPPED and self._scored is None:
            return "the result of the last run is being written"
        return None

    def open_run(self, opened: OpenedRun, *, invalid: bool = False) -> str | None:
        """Show a run of the results folder as if it had stopped just now: rule, note, finalise.

        A run that was cut off is stopped as interrupted, and scored.

        Args:
            opened: the run.
            invalid: stop a run that was cut off as aborted: it does not count.

        Returns:
            Why that is not possible now, in words; None when it is done.

        Raises:
            MadrobError: another console works on it, or its folder refuses.
        """
        if (refused := self.opening_refusal()) is not None or opened.folder == self._folder:
            return refused
        if opened.folder in self._keeper:
            return "its result waits for the disk"
        recorded, unwritten = opened.recorded, self._unwritten()
        self._chronicle.reopen(opened.folder, recorded.entries)
        self._keeper.leave(unwritten)
        if self._opened is None:
            self._kept_zero = self._run.handle_zero
        self._clear()
        self._opened, self._record, self._folder = opened, recorded.record, opened.folder
        self._observation.look_back(opened.assessment)
        self._run = recorded.run
        if self._run.active:
            outcome = Outcome.ABORTED if invalid else Outcome.INTERRUPTED
            reason = "the program or the machine failed"
            self._interrupt(reason, recorded.entries[-1].time, outcome)
            self._decided = None
        left = (run for run in self._unfinished if run.folder != opened.folder.name)
        self._unfinished = tuple(left)
        written = self._run.issue > 0
        self._run = replace(self._run, issue=max(1, self._run.issue))
        self._score(write=not written)
        return None

    # ------------------------------------------------------------------ messages

    def _receive(self, messages: Sequence[RawMessage]) -> None:
        recorded = self._recorder.recording or self._replay is not None
        for message in messages:
            self._recorder.put(message)
            self._observation.receive(message, recorded=recorded)

    # ------------------------------------------------------------------ acts

    def situation(self) -> Situation:
        """What acts are judged against."""
        now = self._sensors_now
        return Situation(
            run=self._run,
            scored=self._scored is not None,
            look=lambda: self._pre_start.checks(self._run, self.source.status(), now),
            measure=lambda: self._sensors.handle_mean(now),
        )

    @property
    def _sensors_now(self) -> float:
        """Up to when messages were surely taken: a program held up makes no topic silent."""
        return self.now() if self._looked is None or self._replay is not None else self._looked

    def perform(self, act: Act) -> str | None:
        """Do an act of the referee, if it is possible.

        Args:
            act: what to do.

        Returns:
            Why it was refused, in words; None when it took effect.
        """
        if self._replay is not None:
            return NO_ACTS
        situation = self.situation()
        if refused := act.refusal(situation):
            return refused
        if Consequence.RECORDING in act.consequences:
            self._clock.hold()
        try:
            self._take_effect(act, situation, self.now())
        except MadrobError as error:
            return str(error)
        return None

    def _take_effect(self, act: Act, situation: Situation, at: float) -> None:
        brings = act.consequences
        if Consequence.NEW_RUN in brings:
            zero = self._run.handle_zero if self._opened is None else self._kept_zero
            self._keeper.leave(self._unwritten())
            self._chronicle.begin()
            self._clear()
            self._run = Run(handle_zero=zero)  # that of an opened run is of its day
            situation = replace(situation, run=self._run)
        before, run = self._run, act.apply(situation, at)
        try:
            if Consequence.RECORDING in brings:
                self._record, self._folder = self._recorder.start(run)
            self._write_act(act, run, at)
        except MadrobError:
            if Consequence.RECORDING in brings:
                self._recorder.discard()
                self._record = self._folder = None
                self._clock.release()
            raise
        if Consequence.HANDLE_ZERO in brings:
            self._kept_zero = run.handle_zero
        if Consequence.NEW_RUN in brings:
            assert run.setup is not None
            self.source.configure(run.setup.condition)
            self._chronicle.announce_start_pose(run.setup.start_pose)
        self._go_on(run)
        if self._scored is not None and Phase.STOPPED in (before.phase, run.phase):
            self._score()  # but what was final stays as it was signed
        self._advance()

    def _write_act(self, act: Act, run: Run, at: float) -> None:
        reason, details = act.reason_given, act_details(act)
        entry = Entry(at, Origin.REFEREE, act.name, run.referee, reason, details)
        self._chronicle.write(entry, self._run.start, must_take_effect=act.at_once)

    def _clear(self) -> None:
        """A clean next run: nothing of the one before stays."""
        self._record = None
        self._folder = None
        self._observation.look_back()
        self._opened = None
        self._scored = None
        self._decided = None
        self._fault_notes.clear()
        self._recorder.clear()

    # ------------------------------------------------------------------ what time brings

    def _advance(self) -> None:
        now = self.now()
        if self._recorder.recording:
            self._watch(now)
        self._go_on(*self._observation.advance(self._run, now))
        over = self._decided is not None and now >= self._decided + POST_ROLL
        if over and self._recorder.recording:
            self._finish()
        if self._keeper.due(now):
            self._try_again(now)

    def _watch(self, now: float) -> None:
        """Look at the topics, ten times a second."""
        if 0 <= now - self._watched < WATCH_PERIOD:
            return
        self._watched = now
        self._recorder.look()
        troubles = self._sensors.troubles(self.source.status(), self._sensors_now)
        for words in self._fault_notes.due(troubles, now):
            self._note(_fault(words, now))

    def _try_again(self, now: float) -> None:
        """Write what the disk refused before."""
        self._chronicle.catch_up()
        self._keeper.try_again(now, busy=self._run.active)

    def _unwritten(self) -> Unwritten | None:
        """The run at hand, if its result or its journal is not on disk."""
        problem = self._keeper.problem or self._chronicle.problem
        if problem is None or self._scored is None or self._folder is None:
            return None
        return Unwritten(self._folder, self._scored, self._chronicle.entries, problem)

    def _go_on(self, run: Run, happened: Sequence[Happening] = ()) -> None:
        """The run is another: by an act, the sensors or the clock."""
        before, self._run = self._run, run
        for one in happened:
            if self._replay is None or one.change in DECIDED_ANEW:
                self._note(one)
        counts_anew = run.phase is Phase.COUNTDOWN and run.countdown_began != before.countdown_began
        if counts_anew:
            self._count_down(run)
        if before.active and run.phase is Phase.STOPPED:
            self._decided = self.now()
            self._observation.judge(run)
        if counts_anew or run.phase is not before.phase:
            self._chronicle.announce_state(run)

    def _count_down(self, run: Run) -> None:
        """The countdown begins, for the first time or anew."""
        if self._observation.course is not None:
            self._observation.course.restart(run)
            return
        assert self._record is not None
        before = self._sensors.newest() if self._replay is None else None
        silence = self.config.limits.lost
        self._observation.course = Course(self._record, run, silence, before)

    def _interrupt(
        self, reason: str, at: float | None = None, outcome: Outcome = Outcome.INTERRUPTED
    ) -> None:
        """The run is cut off by no decision of sensors, clock or referee; `at` = None: now."""
        at = at or self.now()
        details = {"outcome": outcome, "time": at}
        stopped = Happening(Origin.SYSTEM, Change.RUN_STOPS, reason, details)
        self._go_on(stop(self._run, outcome, at, reason), [stopped])

    def _finish(self) -> None:
        """The post-roll is over: close the bag, score, write."""
        self._receive(self.source.take(0.0))  # what is still on its way
        missing = self._recorder.finish()
        self._clock.release()
        self._run = replace(self._run, issue=1)
        self._score(missing)

    def _score(self, missing: Sequence[str] = (), *, write: bool = True) -> None:
        run, record, assessment = self._run, self._record, self._observation.assessment
        assert record is not None
        assert assessment is not None
        for remark in missing:
            assessment.report_problem(remark)
        scored = self._observation.score(record, run)
        if write:
            assert self._folder is not None
            self._keeper.write(self._folder, scored)
        self._scored = scored

    def _written(self, _folder: Path, scored: Scored) -> None:
        details = {"issue": scored.run.issue}
        self._note(Happening(Origin.SYSTEM, Change.RESULT_WRITTEN, details=details))

    def _tell(self, folder: Path, scored: Scored) -> None:
        if self.on_result is not None:
            self.on_result(folder, scored)

    def _note(self, happened: Happening) -> None:
        """Write a line that takes effect whatever the disk says."""
        if happened.change is Change.FAULT:
            fault = TestbedFault(float(happened.details["time"]), happened.reason)
            self._run = replace(self._run, faults=(*self._run.faults, fault))
        entry = Entry(
            self.now(),
            happened.origin,
            happened.change.value,
            reason=happened.reason,
            details=happened.details,
        )
        self._chronicle.write(entry, self._run.start, must_take_effect=True)

    # ------------------------------------------------------------------ a recorded run

    def control(self, command: PlaybackCommand) -> str | None:
        """Pause, step, jump, change the speed of a replay.

        Going back begins the run anew and goes on to the time that was asked for, so that what is
        shown is always what the data up to then say.

        Returns:
            Why that is not possible, in words; None when it is done or on its way.
        """
        if self._replay is None:
            return NO_REPLAY
        before = self.now()
        refused = self._replay.control(command)
        if self.now() < before:
            self._begin()
            self.open()
        return refused

    def _repeat_decisions(self, replay: Replay) -> None:
        """What was decided then is decided again, at its time; at the end the result is made."""
        for entry in replay.due():
            self._advance()
            assert self._record is not None
            run = after(self._run, entry, self._record.handle_zero)
            self._chronicle.write(entry, self._run.start, must_take_effect=True)
            self._go_on(run)
        if replay.ended and self._scored is None:
            self._advance()
            self._go_on(replay.ending(self._run))
            assert self._observation.assessment is not None
            replay.report(self._observation.assessment, self._run)
            self._score(write=False)

    # ------------------------------------------------------------------ what it shows

    def snapshot(self, export: ExportView | None = None, problem: str | None = None) -> Snapshot:
        """Everything that a screen shows, now.

        Args:
            export: the last export of a team's runs.
            problem: why there is no report of the last result, in words.
        """
        now, seen, run = self.now(), self._sensors_now, self._run
        sensors, replay = self._sensors, self._replay
        procedure, assessment = self._observation.procedure, self._observation.assessment
        recorder = self._recorder.view()
        topics = sensors.topics(self.source.status(), self._recorder.dropped(), seen)
        door, latch = sensors.door_view(seen), sensors.latch_view(seen)
        scored, situation = self._scored, None if replay else self.situation()
        result = scored.result if scored else None
        source = scored.record.source if scored and not replay else self.source.kind
        problems = (
            self._chronicle.problem,
            self._keeper.problem,
            *self._keeper.problems,
            *(replay.problems if replay else ()),
        )
        return Snapshot(
            time=now,
            source_kind=self.source.kind,
            source_label=self.source.label,
            sides_problem=self.source.sides_problem,
            run=run,
            elapsed=elapsed(run, now),
            remaining=remaining(run, now),
            settling=procedure is not None and procedure.settling and run.active,
            checks=situation.checks if situation else (),
            refusals=refusals(situation) if situation else {act.name: NO_ACTS for act in ACTS},
            steps=procedure.steps if procedure else NO_STEPS,
            ask_referee=question(run, procedure, latch),
            door=door,
            handle=sensors.handle_view(
                seen, run.handle_zero, assessment.largest_force if assessment else None
            ),
            latch=latch,
            passage=sensors.passage_view(seen),
            topics=topics,
            recorder=recorder,
            disk_free=None if replay else self._pre_start.free_disk(seen),
            faults=(*faults(topics, recorder, door, run, problems), *filter(None, [problem])),
            provisional=assessment.provisional(procedure) if assessment and procedure else {},
            log=self.log.lines,
            result=result,
            result_source=source if scored else None,
            unfinished=self._unfinished,
            opened=self._opened is not None,
            folder=str(self._folder) if self._folder else None,
            playback=replay.view(result) if replay else None,
            export=export,
        )


def _fault(words: str, now: float) -> Happening:
    return Happening(Origin.SYSTEM, Change.FAULT, words, {"time": now})
