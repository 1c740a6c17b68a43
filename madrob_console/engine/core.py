"""The engine: joins source, recorder, detector and the referee's domain.

It decides everything and waits for nobody. It is single-threaded: whoever owns it calls
`step` again and again; `madrob_console.engine.engine_thread` does so in a thread of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import next_run_number
from madrob_console.common.clock import Clock
from madrob_console.engine.current_run import Acting, CurrentRun
from madrob_console.engine.disk import DiskThreads, T
from madrob_console.engine.durable_acts import EarlierRuns, Told
from madrob_console.engine.engine_config import EngineConfig, EvidenceRoom
from madrob_console.engine.evidence_client import EvidenceClient
from madrob_console.engine.observation import Backlog, Interrupt, Observation
from madrob_console.engine.replay import NO_ACTS, OWN_RUN, EngineContext, Replay
from madrob_console.engine.requests import NO_REPLAY, PlaybackCommand
from madrob_console.engine.run_recorder import EventLog
from madrob_console.engine.scorer import EarlierRun, RenderedResult, Scorer
from madrob_console.engine.snapshot import ExportView, Snapshot
from madrob_console.engine.start_checks import PreStart
from madrob_console.engine.supervisor import Worker
from madrob_console.engine.view import StateView, testbed_problem
from madrob_console.messages.codec import REFEREE_STATE_TOPIC, ROBOT_STARTED_TOPIC
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import Act, Situation
from madrob_console.referee.competition_plan import NO_PLAN, Plan
from madrob_console.referee.journal import Origin
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.rebuild import after
from madrob_console.referee.records import FaultKind, new_run_id
from madrob_console.referee.run import Phase, Run
from madrob_console.testbeds.source import INFO_TOPIC, Source
from recorder.bag import RawMessage
from scoring.protocol import POST_ROLL

CLOSING_TIME = 30.0
"""At the engine's end, the wait for a disk that does not answer, s."""

STEP = 0.02
"""Wait for messages while an act waits for the disk, s."""

DISK_WAITS = 0.6
"""Evidence yields the disk when scoring has waited for it this long, s."""

WATCH_PERIOD = 0.1
"""Between two checks of the topics in a run, s."""


class Engine:
    """One testbed, one run after the other; or the replay of one recorded run.

    `keepers` and `evidence_client` are closed with the engine. Without `keepers` and
    `scorer` files and results are made at once, in the engine's thread; without `evidence_client`
    no evidence is recorded.

    Attributes:
        on_result: called with the run's folder when its result is on disk; must not wait.
    """

    def __init__(  # noqa: PLR0913, PLR0917  what it works with
        self,
        source: Source,
        clock: Clock,
        config: EngineConfig,
        types: MessageTypes,
        replay: Replay | None = None,
        keepers: DiskThreads | None = None,
        scorer: Scorer | None = None,
        evidence_client: EvidenceClient | None = None,
    ) -> None:
        self.source = source
        # a recording says itself what was read of it
        self.config = config.limited() if replay is None else config
        self.on_result: Callable[[Path], None] | None = None
        self.replay = replay
        keepers = keepers or DiskThreads.inline()
        self._teams = NO_TEAMS
        self._plan = NO_PLAN
        self._engine_context = EngineContext(
            source,
            clock,
            self.config,
            types,
            replay,
            keepers,
            scorer or Scorer(),
            evidence_client or EvidenceClient(),
            EvidenceRoom(self.config, keepers.reading),
        )
        self._begin()

    @classmethod
    def of_recording(cls, replay: Replay, config: EngineConfig, types: MessageTypes) -> Engine:
        source = replay.source
        return cls(source, source.clock, replay.config(config), types, replay)

    def _begin(self) -> None:
        config, engine_context = self.config, self._engine_context
        if self.replay is not None:
            self.replay.begin_replay()
        self._looked: float | None = None
        self._stepped = math.inf
        self._watched = 0.0
        self._observation = observation = Observation(
            config.mappings, config.thresholds, config.limits, engine_context.types
        )
        self._backlog = backlog = Backlog(observation.receive)
        self._pre_start = pre_start = PreStart(engine_context, observation.sensors)
        self._earlier = EarlierRuns(config.results, engine_context.keepers)
        self.current_run = at_hand = CurrentRun(
            engine_context, observation, self._earlier, self._tell
        )
        self._acting = acting = Acting(engine_context, at_hand, self.situation, self._advance)
        self._view = StateView(engine_context, observation, backlog, pre_start, at_hand, acting)

    # ------------------------------------------------------------------ for the owner

    @property
    def log(self) -> EventLog:
        return self.current_run.event_publisher.log

    @property
    def run(self) -> Run:
        return self.current_run.run

    @property
    def scored(self) -> RenderedResult | None:
        return self.current_run.result.scored

    @property
    def folder(self) -> Path | None:
        return self.current_run.folder

    @property
    def unwritten(self) -> tuple[int, float]:
        """How many lines of the journal are not on disk, and for how long, s. From any thread."""
        return self.current_run.event_publisher.journal.unwritten

    @property
    def refused(self) -> str:
        """What of the current run is in memory alone and retried. From any thread."""
        journal = self.current_run.event_publisher.journal
        return self.current_run.result.problem or journal.problem or ""

    @property
    def waiting(self) -> tuple[str, ...]:
        """Earlier runs that are in memory alone, and why. From any thread."""
        return self.current_run.result.waiting

    @property
    def writing(self) -> str:
        """The act that takes effect when it is on disk; empty = none. From any thread."""
        waiting = self._acting.durable.waiting
        return "" if waiting is None else waiting.name

    @property
    def workers(self) -> tuple[Worker, ...]:
        """Its child processes, for a supervisor to keep running."""
        context = self._engine_context
        parts = (context.scorer, context.evidence_client)
        return tuple(one for one in parts if isinstance(one, Worker))

    @property
    def busy(self) -> bool:
        """Whether a run goes on or its files are being written; never for a replay."""
        if self.replay is not None:
            return False
        files = self.current_run.recorder.open or self.current_run.result.writing
        return self._acting.durable.waiting is not None or self.run.active or files

    @property
    def disk_silence(self) -> float:
        """How long the disk has not answered, s; 0 while nothing waits for it. From any thread."""
        return max(self._engine_context.keepers.own.silent, self.current_run.recorder.silent)

    def now(self) -> float:
        return self._engine_context.now()

    def open(self) -> None:
        self.source.open()
        if self.replay is not None:
            self._repeat_decisions(self.replay)  # before the first message
            self.step(0.0)
            return
        self.current_run.event_publisher.announce_state(self.run)
        self._earlier.find_cut_off_runs()
        self._pre_start.free_disk(self.now())  # known before the first start

    def step(self, timeout: float, interrupt: Interrupt | None = None) -> None:
        """Take the testbed's messages within `timeout` s of clock time, and decide.

        `interrupt` is asked between two messages whether the owner wants a turn; without it, and in
        virtual time and replays, a step ends only after all messages were processed.
        """
        self._engine_context.keepers.deliver()
        self._engine_context.scorer.deliver()
        self._looked = now = self.now()
        if self.current_run.recorder.recording:
            self._backlog.note_pause(now - self._stepped)
        self._stepped = now
        if self.replay is not None or self.config.lossless:
            interrupt = None
        if not self._backlog.full:
            self._receive(self.source.take_messages(0.0 if self._backlog else timeout))
        self._backlog.work_off(interrupt)
        self._looked = self._backlog.seen(self._looked)
        if self.replay is not None:
            self._repeat_decisions(self.replay)
        self._advance()

    def close(self) -> None:
        """Disconnect; a current run is cut off, scored as interrupted and kept."""
        acts = self._acting.durable
        if acts.waiting is not None and not acts.withdraw("the engine ended"):
            self._engine_context.keepers.own.wait_until_idle(CLOSING_TIME)  # it takes effect
        if self.busy and self.run.active:
            self.current_run.interrupt("the console was closed during the run")
        if self.current_run.recorder.recording:
            self._finish()
        answers = self._settle()
        self._engine_context.evidence_client.close()
        if answers:
            self.current_run.settle_evidence(self.now(), ending=True)
            self._settle()
        if answers:
            self.current_run.result.end(self.folder, self.now())
        self.current_run.event_publisher.journal.close()
        self.source.close()
        self._engine_context.keepers.close(CLOSING_TIME if answers else 0.0)

    def _settle(self) -> bool:
        own, scorer = self._engine_context.keepers.own, self._engine_context.scorer
        bag_is_closed = own.wait_until_idle(CLOSING_TIME)
        if bag_is_closed and scorer.wait_until_idle(CLOSING_TIME):
            return own.wait_until_idle(CLOSING_TIME)  # the result is written
        return bag_is_closed

    def read(self, job: Callable[[], T], *, first: bool = True) -> Future[T]:
        """Have something read that the run does not need. From any thread; see `DiskJobs`."""
        return self._engine_context.keepers.reading.submit_job(job, first=first)

    def next_run_number(
        self,
        subject: int,
        condition_number: int,
        *,
        practice: bool = False,
        first: bool = True,
    ) -> Future[int]:
        """The next run number never used, official or practice. From any thread.

        Fails with a `MadrobError` if the folder cannot be read or all numbers are used.
        """
        results = self.config.results
        look = partial(next_run_number, results, subject, condition_number, practice=practice)
        return self.read(look, first=first)

    def _tell(self, folder: Path) -> None:
        if self.on_result is not None:
            self.on_result(folder)

    # ------------------------------------------------------------------ earlier runs

    def opening_refusal(self, instead_of: int | None = None) -> str | None:
        """Why no earlier run can be opened now, in words; `instead_of`: see `open_run`."""
        if self.replay is not None:
            return OWN_RUN
        if self.run.active or self._acting.durable.waiting is not None:
            return "a run is going on"
        if self.run.phase in (Phase.STOPPED, Phase.FINAL) and not (
            self.current_run.result.settled or self.current_run.result.hopeless
        ):
            return "the result of the last run is being written"
        if instead_of not in (None, self.current_run.generation):
            return self.current_run.came_words
        return None

    def hear_of_teams(self, teams: TeamList) -> None:
        """Check set-ups against this list of teams from now on. From any thread."""
        self._teams = teams

    def hear_of_plan(self, plan: Plan) -> None:
        """From any thread."""
        self._plan = plan

    def warm(self) -> None:
        self._engine_context.scorer.warm()
        self._engine_context.evidence_client.warm()

    def read_run(self, folder: Path) -> Future[EarlierRun]:
        """Read an earlier run, to open it. From any thread."""
        return self._engine_context.scorer.read(folder)

    def open_run(
        self,
        opened: EarlierRun,
        done: Told,
        *,
        invalid: bool = False,
        instead_of: int | None = None,
    ) -> None:
        """Show a run of the results folder as if it had stopped just now: rule, note, finalise.

        A run that was cut off is stopped as interrupted, with `invalid` as aborted, and scored.
        Reading took a while: a run set up since the `generation` `instead_of` stays. `done` is
        called once, in this thread: why that is not possible, in words, or None.
        """
        asked = self.current_run.generation if instead_of is None else instead_of
        refusal = partial(self.opening_refusal, asked)
        refused = refusal()
        if refused is not None or opened.folder == self.folder:
            done(refused)
        elif opened.folder in self.current_run.result:
            done("its result waits for the disk")
        else:
            take_up = partial(self.current_run.take_up, opened, invalid=invalid)
            self._earlier.reopen(opened, refusal, take_up, done)

    # ------------------------------------------------------------------ acts

    def situation(self) -> Situation:
        now = self._sensors_now
        return Situation(
            run=self.run,
            scored=self.current_run.result.settled,
            hopeless=self.current_run.result.hopeless,
            simulated=self.source.announcement.simulated,
            indicators=self.current_run.result.indicators,
            refused=self.refused,
            look=lambda: self._pre_start.checks(
                self.run, self.source, now, self.current_run.drift, self._teams, self._plan
            ),
            measure=lambda: self._observation.sensors.handle_rest(now),
            rest_force=self.config.thresholds.touch_force / 2,
            teams=self._teams,
            steps=self._observation.steps,
            testbed=self.config.testbed,
            competition=self.config.competition,
            new_id=lambda: new_run_id(self._engine_context.clock.now_ns(), self.config.random),
        )

    @property
    def _sensors_now(self) -> float:
        """Time up to which all messages were taken: a program held up makes no topic silent."""
        return self.now() if self._looked is None or self.replay is not None else self._looked

    def submit(
        self,
        act: Act,
        done: Told,
        *,
        id: str = "",  # noqa: A002
        origin: Origin = Origin.REFEREE,
    ) -> None:
        """Do an act, if it is possible: at once, or when its line is on disk.

        `done` is called once, in this thread: why the act was refused, in words, or None when
        it took effect. A refused act never takes effect later. A known `id` is answered again,
        not done twice.
        """
        if self.replay is not None:
            done(NO_ACTS)
        else:
            self._acting.submit(act, done, id, origin)

    def perform(self, act: Act) -> str | None:
        """Do an act as `submit` does, and step until it is answered; returns why it was refused."""
        told: list[str | None] = []
        self.submit(act, told.append)
        while not told:
            self.step(STEP)
        return told[0]

    # ------------------------------------------------------------------ what time brings

    def _receive(self, messages: Sequence[RawMessage]) -> None:
        recording = self.current_run.recorder.recording and not self.current_run.over
        if recording:
            self.current_run.recorder.record_messages(messages)
        self._backlog.add_messages(messages, recorded=recording or self.replay is not None)

    def _advance(self) -> None:
        now, at_hand = self.now(), self.current_run
        self._acting.durable.withdraw_overdue()
        if not 0 <= now - self._watched < WATCH_PERIOD:
            self._watched = now
            self._watch(now)
        at_hand.go_on(*self._observation.advance(at_hand.run, now, self._backlog.seen(now)))
        over = at_hand.decided is not None and now >= at_hand.decided + POST_ROLL
        if over and self.current_run.recorder.recording:
            # nothing more is recorded; what is, is judged
            at_hand.over |= self._backlog.recorded > 0
            if not self._backlog.recorded:
                self._finish()
        self.current_run.result.retry_writing(now, busy=at_hand.run.active)

    def _watch(self, now: float) -> None:
        # also while a bag is closed and then: evidence that was held is let go again
        evidence_client = self._engine_context.evidence_client
        evidence_client.hold_writing(held=self.current_run.recorder.silent > DISK_WAITS)
        if not self.current_run.recorder.recording:
            self.current_run.settle_evidence(now)
            return
        self.current_run.recorder.record_late_topics()
        faults: dict[tuple[str, FaultKind], str] = dict(
            self._observation.sensors.faults(self.source.status(), self._sensors_now)
        )
        if (other := self.source.other_referee) is not None:
            faults[REFEREE_STATE_TOPIC, FaultKind.SEVERAL_PUBLISHERS] = other
        if (told := testbed_problem(self.source.announcement, self.run)) is not None:
            faults[INFO_TOPIC, FaultKind.ANNOUNCEMENT] = told
        if (told := self.source.robot_problem) is not None:
            faults[ROBOT_STARTED_TOPIC, FaultKind.SOURCE] = told
        if (behind := self._backlog.problem) is not None:
            faults["engine", FaultKind.BEHIND] = behind
        self.current_run.note_faults(faults, now)
        if (status := evidence_client.status) is not None:
            self.current_run.note_evidence(status, now)

    def _finish(self) -> None:
        self._receive(self.source.take_messages(0.0))  # what is still on its way
        self._backlog.work_off()
        self.current_run.finish()

    # ------------------------------------------------------------------ a recorded run

    def control(self, command: PlaybackCommand) -> str | None:
        """Control a replay; returns in words why that is not possible.

        Going back begins the run anew and goes on to the requested time, so that the screen
        always shows what the data up to then say.
        """
        if self.replay is None:
            return NO_REPLAY
        before = self.now()
        refused = self.replay.control(command)
        if self.now() < before:
            self._begin()
            self.open()
        return refused

    def _repeat_decisions(self, replay: Replay) -> None:
        at_hand = self.current_run
        for entry in replay.due():
            self._advance()
            run = after(at_hand.run, entry)
            at_hand.write(entry)
            at_hand.go_on(run)
        if replay.ended and self.scored is None:
            self._advance()
            at_hand.go_on(replay.ending(at_hand.run))
            assert self._observation.course is not None
            replay.report(self._observation.course.assessment, at_hand.run)
            at_hand.score(write=False)

    # ------------------------------------------------------------------ what it shows

    def snapshot(
        self, export: ExportView | None = None, others: Iterable[str | None] = ()
    ) -> Snapshot:
        """Everything that a screen shows; `others` is what is wrong around the engine, in words."""
        return self._view.snapshot(
            self.now(),
            self._sensors_now,
            self.situation(),
            self._earlier.unfinished,
            self._plan,
            export,
            others,
        )
