"""An engine in its own thread, and its local client."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.folders import parse_folder_name
from madrob_console.archive.history import History
from madrob_console.common.errors import MadrobError
from madrob_console.engine.core.scored_run import EarlierRun
from madrob_console.engine.curves import Curves
from madrob_console.engine.ipc.engine_interface import awaited, begun, fail
from madrob_console.engine.playback import NO_REPLAY, PlaybackCommand
from madrob_console.engine.priority_queue import PriorityQueue
from madrob_console.engine.requests import (
    NO_ANSWER,
    ExportDossier,
    ExportTeam,
    GiveCurves,
    GiveFrames,
    GivePlan,
    NextRunNumber,
    OpenRun,
    Perform,
    Request,
    T,
    TakeOver,
)
from madrob_console.engine.runtime.reports import Reporting
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import Pulse, Snapshot
from madrob_console.referee.acts import act_named
from madrob_console.referee.competition_plan import PlanProgress, plan_progress

Done = Callable[[Any], None]


@dataclass(frozen=True, slots=True, eq=False)
class QueuedRequest:
    """A question that waits for its turn; cancelled before that, it never happens.

    What has not begun by the `deadline` (s of the monotonic clock) never happens either.
    """

    question: Callable[[Done], None]
    deadline: float
    answer: Future[Any]

    def start_turn(self) -> bool:
        """After this it cannot be cancelled; False where it must not happen any more."""
        if time.monotonic() > self.deadline:
            fail(self.answer, NO_ANSWER)
        return begun(self.answer)


TAKE_TIMEOUT = 0.02
"""The engine's wait for messages before it checks acts and the clock, s."""

SNAPSHOT_PERIOD = 0.05
"""How often screens get a new snapshot, s."""

USUAL_WRITING = 0.5
"""Screens do not mention an act that waits for the disk no longer than this, s."""

_ENDED = "the engine has ended: start the console again"


class LocalEngine:
    """Runs an engine, not opened yet, in a thread; an `EngineClient`.

    No screen holds the engine up: requests wait for their turn, the urgent ones before all
    others; what only reads runs beside the engine; snapshots are taken from the latest one.
    The caller closes `reporting`. `fallen` tells which part of this process has ended, in
    words.
    """

    def __init__(
        self,
        engine: Engine,
        reporting: Reporting,
        fallen: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._engine = engine
        self._fallen = fallen
        self._reporting = reporting
        engine.make_reports = reporting.report
        self._turns: PriorityQueue[QueuedRequest] = PriorityQueue()
        self._begun: set[QueuedRequest] = set()
        self._history = History(engine.config.results)
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        self._writing = "", 0.0
        engine.open()
        self._look()
        self._stepped = time.monotonic()
        self._thread = threading.Thread(target=self._work, name="engine")
        self._thread.start()
        engine.warm()

    def _work(self) -> None:
        shown = 0.0
        try:
            while not self._stop.is_set():
                self._stepped = time.monotonic()
                self._engine.step(TAKE_TIMEOUT, self._is_wanted)
                for turn in self._turns.waiting():
                    self._take(turn)
                if time.monotonic() - shown >= SNAPSHOT_PERIOD:
                    self._look()
                    shown = time.monotonic()
        except BaseException as error:
            self._failure = error
            raise
        finally:
            self._engine.close()
            for turn in (*self._begun, *self._turns.close()):
                fail(turn.answer, self._gone)

    def _is_wanted(self) -> bool:
        return self._turns.count(first=True) > 0 or self._stop.is_set()

    @property
    def _gone(self) -> str:
        return _ENDED if self._failure is None else f"the engine has failed: {self._failure}"

    def _take(self, turn: QueuedRequest) -> None:
        if not turn.start_turn():
            return
        self._begun.add(turn)

        def done(answer: object) -> None:
            self._begun.discard(turn)
            self._look()  # before the answer: it shows what was done
            turn.answer.set_result(answer)

        try:
            turn.question(done)
        except MadrobError as error:
            self._begun.discard(turn)
            fail(turn.answer, error)

    def _put(self, turn: QueuedRequest, *, urgent: bool = False) -> Future[Any]:
        if self._stop.is_set() or not self._turns.put_item(turn, first=urgent):
            fail(turn.answer, self._gone)
        return turn.answer

    def snapshot(self) -> Snapshot:
        """The latest snapshot, with the current pulse: the engine's thread may stand still."""
        if self._failure is not None:
            raise MadrobError(f"the engine has failed: {self._failure}")
        latest, pulse = self._snapshot, self._pulse()
        return latest if pulse == latest.pulse else replace(latest, pulse=pulse)

    def _pulse(self) -> Pulse:
        engine, now = self._engine, time.monotonic()
        (lines, age), disk = engine.unwritten, int(engine.disk_silence)
        if engine.writing != self._writing[0]:
            self._writing = engine.writing, now
        writing, since = self._writing
        return Pulse(
            core=int(now - self._stepped),
            disk=disk,
            unwritten=lines if age >= 1 or disk else 0,
            refused=engine.refused,
            waiting=len(engine.waiting),
            writing=writing if now - since >= USUAL_WRITING else "",
        )

    def _look(self) -> None:
        others = [self._fallen(), self._reporting.problem]
        self._reporting.hold(held=self._engine.busy)
        self._snapshot = self._engine.snapshot(self._reporting.exported, others)

    def begin_request(
        self,
        request: Request[T],
        deadline: float | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        """Have a request carried out; never waits.

        What has not begun by the `deadline` (s of the monotonic clock) never takes effect.
        `first` reads go before the others.
        """
        if deadline is None:
            deadline = time.monotonic() + request.latest_begin
        try:
            return self._carry_out(request, deadline, first=first)
        except MadrobError as error:
            answer: Future[T] = Future()
            answer.set_exception(error)
            return answer

    def send_request(self, request: Request[T]) -> T:
        return awaited(self.begin_request(request), request.timeout)

    def _carry_out(self, request: Request[Any], deadline: float, *, first: bool) -> Future[Any]:
        """The one place that knows what each request means."""
        engine = self._engine

        def core(question: Callable[[Done], None]) -> Future[Any]:
            return self._put(QueuedRequest(question, deadline, Future()), urgent=request.urgent)

        match request:
            case Perform(name, details, number):
                act = act_named(name, details)
                return core(lambda done: engine.submit(act, done, id=number))
            case NextRunNumber(subject, condition, practice):
                return engine.next_run_number(subject, condition, practice=practice, first=first)
            case OpenRun(folder, invalid):
                return self._open_run(folder, deadline, invalid=invalid)
            case ExportTeam() | ExportDossier():
                return core(lambda done: done(self._export(request)))
            case GiveCurves() | GivePlan():
                curves = isinstance(request, GiveCurves)
                return engine.read(self._curves if curves else self._progress, first=first)
            case GiveFrames():
                return self._frames()
            case PlaybackCommand():
                return core(lambda done: done(engine.control(request)))
            case TakeOver():
                return _answered(None)  # this screen has it: others are the server's
            case _:
                raise NotImplementedError(f"nobody carries out {request}")

    def _open_run(self, folder: str, deadline: float, *, invalid: bool) -> Future[str | None]:
        if parse_folder_name(folder) is None:
            raise MadrobError(f"{folder!r} is no run folder")
        engine = self._engine
        generation = engine.current_run.generation
        if (refused := engine.opening_refusal()) is not None:
            return _answered(refused)
        answer: Future[str | None] = Future()

        def show(read: Future[EarlierRun]) -> None:
            if isinstance(error := read.exception(), MadrobError):
                fail(answer, error)
                return

            def question(done: Done) -> None:
                engine.open_run(read.result(), done, invalid=invalid, instead_of=generation)

            self._put(QueuedRequest(question, deadline, answer))

        def read() -> None:
            engine.read_run(self.results / folder, deadline).add_done_callback(show)

        # reading a bag takes long: a thread of its own keeps listings and scoring going
        threading.Thread(target=read, name="opening", daemon=True).start()
        return answer

    def _export(self, request: ExportTeam | ExportDossier) -> str | None:
        match request:
            case ExportTeam(subject, practice, competition):
                self._reporting.export(subject, competition, practice=practice)
            case ExportDossier(folder):
                if parse_folder_name(folder) is None:
                    return f"{folder!r} is no run folder"
                self._reporting.export_dossier(self.results / folder, folder)
        return None

    def _frames(self) -> Future[str]:
        replay, shown = self._engine.replay, self.snapshot().playback
        if replay is None or shown is None:
            raise MadrobError(f"{NO_REPLAY}: replay the run")
        return self._reporting.frames(replay.source.path, shown.position)

    def _curves(self) -> Curves | None:
        scored = self._engine.scored  # immutable: may be read from any thread
        return None if scored is None else msgspec.msgpack.decode(scored.curves, type=Curves)

    def _progress(self) -> PlanProgress:
        plan = self.snapshot().plan
        runs = self._history.refresh() if plan.lines else ()
        return plan_progress(plan, runs, self._engine.config.competition)

    def repair(self) -> None:
        """Have results made again that differ from their journals. Never waits."""
        if self._engine.replay is None:
            self._reporting.repair()

    @property
    def results(self) -> Path:
        return self._engine.config.results

    @property
    def busy(self) -> bool:
        return self._failure is None and self._engine.busy

    @property
    def unsaved(self) -> bool:
        """Whether anything of a run is in memory alone: the disk refuses it, or is silent."""
        unsaved = self._engine.unwritten[0] or self.not_on_disk
        return self._failure is None and bool(unsaved)

    @property
    def not_on_disk(self) -> Sequence[str]:
        return tuple(filter(None, (self._engine.refused, *self._engine.waiting)))

    @property
    def failed(self) -> bool:
        return self._failure is not None

    def close(self) -> None:
        """End the engine; a current run is cut off and kept as interrupted."""
        self._stop.set()
        self._thread.join()


def _answered(answer: T) -> Future[T]:
    future: Future[T] = Future()
    future.set_result(answer)
    return future
