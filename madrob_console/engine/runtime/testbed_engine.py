"""One engine: joins source, core and performer, and does one step after the other.

It is single-threaded: whoever owns it calls `step` again and again;
`madrob_console.engine.runtime.engine_thread` does so in a thread of its own.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from msgspec.structs import replace as with_fields

from madrob_console.archive.folders import next_run_number
from madrob_console.common.clock import Clock, seconds
from madrob_console.engine.core.acting import OWN_RUN
from madrob_console.engine.core.current_run import CurrentRun
from madrob_console.engine.core.effects import Answer, Publish
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.engine_core import Core
from madrob_console.engine.core.event_log import EventLog
from madrob_console.engine.core.inputs import (
    CutOff,
    DoAct,
    EngineEnds,
    Input,
    OpenEarlierRun,
    ReplayedLine,
    ReplayEnds,
    Tick,
)
from madrob_console.engine.core.now import Now, TestbedState
from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult
from madrob_console.engine.core.state_view import NO_ACTS
from madrob_console.engine.playback import NO_REPLAY, PlaybackCommand
from madrob_console.engine.public_state import PublishedState
from madrob_console.engine.runtime.backlog import Backlog, Interrupt
from madrob_console.engine.runtime.disk import DiskThreads, T
from madrob_console.engine.runtime.evidence_process import EvidenceProcess
from madrob_console.engine.runtime.performer import Performer
from madrob_console.engine.runtime.replay import Replay, ReplayPerformer
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.supervisor import Worker
from madrob_console.engine.snapshot import ExportView, Snapshot
from madrob_console.messages.fields import begins_with_header
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import Act, Situation
from madrob_console.referee.competition_plan import NO_PLAN, Plan
from madrob_console.referee.run import Run
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.testbeds.source import Source
from recorder.bag import Durability, RawMessage
from scoring.protocol import Signal

CLOSING_TIME = 30.0
"""Timeout for a disk that does not answer when the engine ends, s."""

STEP = 0.02
"""Wait for messages while an act waits for the disk, s."""

MOST_ANSWERS = 1000
"""Answers that are kept, so that an act that comes twice is carried out once."""

_BEFORE_OTHERS = 1000
"""How long before the first message of a recording the kept state of its latch stands, ns."""

OnAnswer = Callable[[str | None], None]
"""Called once with the outcome of a request: why it was refused, in words, or None."""


@dataclass(eq=False)
class _Request:
    """One request, and all who asked for it by the same id."""

    waiting: list[OnAnswer]
    answered: bool = False
    refused: str | None = None

    def answer(self, refused: str | None) -> None:
        self.answered, self.refused = True, refused
        for on_answer in self.waiting:
            on_answer(refused)


class _Requests:
    """Remembers requests by number and, if they have one, by the id that their screen made."""

    def __init__(self) -> None:
        self._by_number: dict[int, _Request] = {}
        self._by_id: OrderedDict[str, _Request] = OrderedDict()
        self._number = 0

    def add(self, on_answer: OnAnswer, id: str = "") -> int | None:  # noqa: A002
        """The number of a new request; None for a known one: then it gets the first answer."""
        if id in self._by_id:
            request = self._by_id[id]
            if request.answered:
                on_answer(request.refused)
            else:
                request.waiting.append(on_answer)
            return None
        self._number += 1
        self._by_number[self._number] = request = _Request([on_answer])
        if id:
            self._by_id[id] = request
        while len(self._by_id) > MOST_ANSWERS:
            self._by_id.popitem(last=False)
        return self._number

    def answer(self, number: int, refused: str | None) -> None:
        self._by_number.pop(number).answer(refused)


class Engine:
    """One testbed, one run after the other; or the replay of one recorded run.

    `disk` is closed with the engine. Without `disk` and `scorer` files and results are made at
    once, in the engine's thread; without `evidence` nothing is recorded beside the testbed.

    Attributes:
        make_reports: called with the run's folder when its result is on disk; must not wait.
    """

    def __init__(  # noqa: PLR0913, PLR0917  what it works with
        self,
        source: Source,
        clock: Clock,
        config: EngineConfig,
        types: MessageTypes,
        replay: Replay | None = None,
        disk: DiskThreads | None = None,
        scorer: Scorer | None = None,
        evidence: EvidenceProcess | None = None,
    ) -> None:
        self.source = source
        # a recording says itself what was read of it
        self.config = config.limited() if replay is None else config
        self.make_reports: Callable[[Path], None] = lambda _folder: None
        self.replay = replay
        self._clock = clock
        self._types = types
        self._disk = disk or DiskThreads.inline()
        self._scorer = scorer or Scorer()
        self._evidence = evidence
        self._lists: tuple[TeamList, Plan] = NO_TEAMS, NO_PLAN
        self._requests = _Requests()
        self._records = False
        self._latch: RawMessage | None = None
        if replay is None:
            self._live = Performer(
                source, clock, self.config, types, self._disk, self._scorer, self._evidence
            )
            self._live.results.make_reports = lambda folder: self.make_reports(folder)  # noqa: PLW0108  set later
            self._live.on_closing = self._take_last_messages
        self._begin()

    @classmethod
    def of_recording(cls, replay: Replay, config: EngineConfig, types: MessageTypes) -> Engine:
        source = replay.source
        return cls(source, source.clock, replay.config(config), types, replay)

    def _begin(self) -> None:
        replay = self.replay
        self._performer: Performer | ReplayPerformer = (
            self._live if replay is None else ReplayPerformer(replay, self._scorer)
        )
        if replay is not None:
            replay.begin_replay()
        recorded = None if replay is None else replay.recorded_run
        self._core = Core(self.config, self._types, recorded)
        self._backlog = Backlog(self._core.observe)
        self._looked: float | None = None
        self._stepped = math.inf

    # ------------------------------------------------------------------ for the owner

    @property
    def current_run(self) -> CurrentRun:
        return self._core.current_run

    @property
    def run(self) -> Run:
        return self.current_run.run

    @property
    def log(self) -> EventLog:
        return self.current_run.log

    @property
    def scored(self) -> RenderedResult | None:
        return self.current_run.state.result.scored

    @property
    def folder(self) -> Path | None:
        return self.current_run.state.folder

    @property
    def unwritten(self) -> tuple[int, float]:
        """How many lines of the journal are not on disk, and for how long, s. From any thread."""
        return (0, 0.0) if self.replay is not None else self._live.journal.unwritten

    @property
    def refused(self) -> str:
        """What of the current run is in memory alone and retried. From any thread."""
        journal = None if self.replay is not None else self._live.journal.problem
        return self.current_run.state.result.problem or journal or ""

    @property
    def waiting(self) -> tuple[str, ...]:
        """Earlier runs that are in memory alone, and why. From any thread."""
        return () if self.replay is not None else self._live.results.waiting

    @property
    def writing(self) -> str:
        """The act that takes effect when it is on disk; empty = none. From any thread."""
        waiting = self._core.waiting
        return "" if waiting is None else waiting.name

    @property
    def workers(self) -> tuple[Worker, ...]:
        """Its child processes, for a supervisor to keep running."""
        return tuple(one for one in (self._scorer, self._evidence) if isinstance(one, Worker))

    @property
    def busy(self) -> bool:
        """Whether a run goes on or its files are being written; never for a replay."""
        if self.replay is not None:
            return False
        state = self.current_run.state
        files = state.recording or state.closing or self._live.results.is_writing
        return self._core.waiting is not None or self.run.active or files

    @property
    def disk_silence(self) -> float:
        """How long the disk has not answered, s; 0 while nothing waits for it. From any thread."""
        recorder = 0.0 if self.replay is not None else self._live.recorder_silent
        return max(self._disk.own.silent, recorder)

    def now(self) -> float:
        """Steady time, s since the epoch."""
        return seconds(self._clock.now_ns())

    def open(self) -> None:
        self.source.open()
        if self.replay is not None:
            self._repeat_decisions(self.replay)  # before the first message
            self.step(0.0)
            return
        self._live.carry_out(Publish(PublishedState.of(self.run)))
        self._live.list_cut_off_runs()
        self._live.disk_state(self.run, self.now())  # known before the first start

    def step(self, timeout: float, interrupt: Interrupt | None = None) -> None:
        """Take the testbed's messages within `timeout` s of clock time, and decide.

        `interrupt` is asked between two messages whether the owner wants a turn; without it, and in
        virtual time and replays, a step ends only after all messages were judged.
        """
        if self.replay is None:
            self._live.deliver()
            self._drain()
        self._looked = now = self.now()
        if self.current_run.state.recording:
            self._backlog.note_pause(now - self._stepped)
        self._stepped = now
        if self.replay is not None or self.config.lossless:
            interrupt = None
        if not self._backlog.full:
            self._receive(self.source.take_messages(0.0 if self._backlog else timeout))
        self._backlog.work_off(interrupt)
        self._looked = self._backlog.judged_until(self._looked)
        if self.replay is not None:
            self._repeat_decisions(self.replay)
        self._feed(Tick())

    def _receive(self, messages: Sequence[RawMessage]) -> None:
        begins = self._core.records and not self._records
        self._records = self._core.records
        if begins and (state := self._kept_state(messages)):
            messages = [state, *messages]
        self._note_latch(messages)
        if self._core.records:
            self._live.record_messages(messages)
        recorded = self._core.records or self.replay is not None
        self._backlog.add_messages(messages, recorded=recorded)

    def _kept_state(self, messages: Sequence[RawMessage]) -> RawMessage | None:
        """The latch's last state before the recording, where its topic keeps it for late joiners.

        One with a stamp is left out: its old stamp would look like a step of the clock.
        """
        latch = self._latch
        if latch is None or begins_with_header(self._types, latch.type):
            return None
        lives = any(one.publishers for one in self.source.status() if one.topic == latch.topic)
        qualities = [topic.qos for topic in self.source.topics() if topic.name == latch.topic]
        kept = any(qos.durability is Durability.TRANSIENT_LOCAL for qos in qualities)
        if not (lives and kept):
            return None
        at = messages[0].receive_ns if messages else self._clock.now_ns()
        return with_fields(latch, receive_ns=at - _BEFORE_OTHERS)

    def _note_latch(self, messages: Sequence[RawMessage]) -> None:
        topics = [each.topic for each in self.config.mappings if each.signal is Signal.LATCH]
        for message in messages:
            if message.topic in topics:
                self._latch = message

    def _take_last_messages(self) -> None:
        messages = self.source.take_messages(0.0)  # what is still on its way
        self._note_latch(messages)
        recorded = not self.current_run.state.over
        if recorded:
            self._live.record_messages(messages)
        self._backlog.add_messages(messages, recorded=recorded)
        self._backlog.work_off()

    # ------------------------------------------------------------------ inputs and effects

    def _feed(self, happened: Input) -> None:
        """Have the core decide, carry its effects out, and go on with what came of them."""
        moment = self._moment(looks=not isinstance(happened, Tick))
        effects = self._core.step(happened, moment)
        for effect in effects:
            if not isinstance(effect, Answer):
                self._performer.carry_out(effect)
        self._drain()
        for effect in effects:
            if isinstance(effect, Answer):
                self._requests.answer(effect.number, effect.refused)

    def _drain(self) -> None:
        inputs = self._performer.inputs
        while inputs:
            self._feed(inputs.popleft())

    def _moment(self, *, looks: bool = True) -> Now:
        """The current state; with `looks` the disk is checked if the last check is old."""
        now = self.now()
        # a program that is held up makes no topic silent
        taken = now if self._looked is None or self.replay is not None else self._looked
        moment = Now(
            time=now,
            monotonic=self._disk.monotonic(),
            taken=taken,
            judged=self._backlog.judged_until(now),
            testbed=TestbedState.of(self.source),
            unjudged=self._backlog.recorded,
            behind=self._backlog.problem,
            teams=self._lists[0],
            plan=self._lists[1],
        )
        if self.replay is not None:
            return moment
        disk = self._live.disk_state(self.run if looks else None, taken)
        here = self.current_run.state.opened is None
        workers = self._live.worker_state(disk, taken, recorded_here=here)
        return replace(moment, disk=disk, workers=workers)

    # ------------------------------------------------------------------ its end

    def close(self) -> None:
        """Disconnect; a current run is cut off, scored as interrupted and kept."""
        if self.replay is None:
            self._close_runs(self._live)
        self.source.close()

    def _close_runs(self, live: Performer) -> None:
        self._feed(EngineEnds())
        if self._core.waiting is not None:  # it is on disk, and takes effect
            self._disk.own.wait_until_idle(CLOSING_TIME)
            self._drain()
        self._feed(CutOff("the console was closed during the run"))
        answers = self._settle()
        if answers:
            live.journal.catch_up()
            live.carry_out(self.current_run.left)
        live.journal.close()
        self._disk.close(CLOSING_TIME if answers else 0.0)

    def _settle(self) -> bool:
        """Wait until the bag is closed and the result written; returns whether the disk answers."""
        while True:
            idle = self._disk.own.wait_until_idle(CLOSING_TIME)
            scored = idle and self._scorer.wait_until_idle(CLOSING_TIME)
            if not self._performer.inputs or not scored:
                self._drain()
                return idle
            self._drain()

    # ------------------------------------------------------------------ what is read beside it

    def read(self, job: Callable[[], T], *, first: bool = True) -> Future[T]:
        """Have something read that the run does not need. From any thread; see `DiskJobs`."""
        return self._disk.reading.submit_job(job, first=first)

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

    def set_teams(self, teams: TeamList) -> None:
        """Check set-ups against this list of teams from now on. From any thread."""
        self._lists = teams, self._lists[1]

    def set_plan(self, plan: Plan) -> None:
        """From any thread."""
        self._lists = self._lists[0], plan

    def warm(self) -> None:
        self._scorer.warm()

    # ------------------------------------------------------------------ requests

    def submit(
        self,
        act: Act,
        on_answer: OnAnswer,
        *,
        id: str = "",  # noqa: A002
    ) -> None:
        """Do an act, if it is possible: at once, or when its line is on disk.

        A refused act never takes effect later. A known `id` is answered again, not done twice.
        """
        if self.replay is not None:
            on_answer(NO_ACTS)
        elif (number := self._requests.add(on_answer, id)) is not None:
            self._feed(DoAct(number, act, id))

    def perform(self, act: Act) -> str | None:
        """Do an act as `submit` does, and step until it is answered; returns why it was refused."""
        answers: list[str | None] = []
        self.submit(act, answers.append)
        while not answers:
            self.step(STEP)
        return answers[0]

    def situation(self) -> Situation:
        return self._core.situation(self._moment())

    def opening_refusal(self) -> str | None:
        """Why no earlier run can be opened now, in words."""
        return OWN_RUN if self.replay is not None else self._core.opening_refusal(self._moment())

    def read_run(self, folder: Path, deadline: float = math.inf) -> Future[EarlierRun]:
        """Read an earlier run, to open it, or not after the deadline. From any thread."""
        return self._scorer.read(folder, deadline)

    def open_run(
        self,
        earlier: EarlierRun,
        on_answer: OnAnswer,
        *,
        invalid: bool = False,
        instead_of: int | None = None,
    ) -> None:
        """Show a run of the results folder as if it had stopped just now; see `OpenEarlierRun`."""
        if self.replay is not None:
            on_answer(OWN_RUN)
            return
        generation = self.current_run.generation if instead_of is None else instead_of
        number = self._requests.add(on_answer)
        assert number is not None
        self._feed(OpenEarlierRun(number, earlier, invalid, generation))

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
        for entry in replay.due():
            self._feed(ReplayedLine(entry))
        if replay.ended and self.scored is None:
            self._feed(ReplayEnds())

    # ------------------------------------------------------------------ what it shows

    def snapshot(
        self, export: ExportView | None = None, others: Iterable[str | None] = ()
    ) -> Snapshot:
        """Everything that a screen shows; `others` is what is wrong around the engine, in words."""
        self._drain()
        moment, replay = self._moment(), self.replay
        if replay is None:
            return self._core.snapshot(moment, export, others)
        result = None if self.scored is None else self.scored.result
        problems = (*replay.problems, *others)
        return self._core.snapshot(moment, export, problems, replay.view(result))
