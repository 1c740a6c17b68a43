"""An engine in a thread of its own, and the client that talks to it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, cast

from madrob_console.archive.folders import parse_folder_name
from madrob_console.archive.scored import open_run
from madrob_console.engine.live.core import Engine
from madrob_console.engine.process.reporting import Reporting
from madrob_console.engine.shown.curves import Curves, curves_of
from madrob_console.engine.shown.playback import PlaybackCommand
from madrob_console.engine.shown.requests import (
    NO_ANSWER,
    ExportTeam,
    GiveCurves,
    NextRunNumber,
    OpenRun,
    Perform,
    Request,
    StopEngine,
    T,
    TakeOver,
)
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import act_named
from scoring.kinematics import load_filters

TAKE_TIMEOUT = 0.02
"""How long the engine waits for messages before it looks at acts and the clock, s."""

SNAPSHOT_PERIOD = 0.05
"""Screens get a new snapshot this often, s."""

_ENDED = "the engine has ended: start the console again"


class LocalEngine:
    """Runs an engine in a thread; an `EngineClient`.

    Nothing that a screen does holds the engine up: calls are queued, snapshots are taken from
    the latest one.

    Args:
        engine: not opened yet.
        reporting: what makes reports and exports, closed by the caller; None = nobody does.

    Raises:
        MadrobError: the testbed cannot be reached.
    """

    def __init__(self, engine: Engine, reporting: Reporting | None = None) -> None:
        self._engine = engine
        self._reporting = reporting
        if reporting is not None:
            engine.on_result = reporting.report
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._stop = threading.Event()
        self._ended = False
        self._failure: BaseException | None = None
        engine.open()
        self._look()
        self._thread = threading.Thread(target=self._work, name="engine")
        self._thread.start()
        threading.Thread(target=load_filters, name="filters", daemon=True).start()

    def _work(self) -> None:
        shown = 0.0
        try:
            while not self._stop.is_set():
                self._engine.step(TAKE_TIMEOUT)
                self._answer_calls()
                if time.monotonic() - shown >= SNAPSHOT_PERIOD:
                    self._look()
                    shown = time.monotonic()
        except BaseException as error:
            self._failure = error
            raise
        finally:
            self._engine.close()
            self._ended = True
            self._answer_calls()

    def _answer_calls(self) -> None:
        with suppress(Empty):
            while True:
                self._calls.get_nowait()()

    def _call(self, question: Callable[[], T], deadline: float) -> T:
        """Ask in the engine's thread; what was given up before its turn never happens."""
        answer: Future[T] = Future()

        def call() -> None:
            if not answer.set_running_or_notify_cancel():
                return
            if self._ended:
                answer.set_exception(MadrobError(_ENDED))
                return
            try:
                result = question()
                self._look()  # before the answer: it shows what was done
            except MadrobError as error:
                answer.set_exception(error)
            except BaseException as error:
                answer.set_exception(MadrobError(f"the engine has failed: {error}"))
                raise
            else:
                answer.set_result(result)

        if self._stop.is_set():
            raise MadrobError(_ENDED)
        self._calls.put(call)
        if self._ended:  # only now: nobody may be there to see it
            self._answer_calls()
        try:
            return answer.result(deadline - time.monotonic())
        except TimeoutError:
            answer.cancel()
            raise MadrobError(NO_ANSWER) from None

    def snapshot(self) -> Snapshot:
        """The latest snapshot.

        Raises:
            MadrobError: the engine has failed.
        """
        if self._failure is not None:
            raise MadrobError(f"the engine has failed: {self._failure}")
        return self._snapshot

    def _look(self) -> None:
        """Make a new snapshot, in the engine's thread."""
        reporting = self._reporting
        self._snapshot = (
            self._engine.snapshot()
            if reporting is None
            else self._engine.snapshot(reporting.exported, reporting.problem)
        )

    def ask(self, request: Request[T], deadline: float = math.inf) -> T:
        """Carry a request out.

        Args:
            request: what is asked.
            deadline: if it comes before the request's timeout, s of the monotonic clock.

        Raises:
            MadrobError: it failed, or the engine has ended or does not answer.
        """
        deadline = min(time.monotonic() + request.timeout, deadline)
        return cast("T", self._carry_out(request, deadline))

    def _carry_out(self, request: Request[Any], deadline: float) -> object:
        """The one place that knows what each request means."""
        engine = self._engine
        match request:
            case Perform(name, details):
                act = act_named(name, details)
                return self._call(lambda: engine.perform(act), deadline)
            case NextRunNumber(subject, condition):
                return self._call(lambda: engine.next_run_number(subject, condition), deadline)
            case OpenRun(folder, invalid):
                return self._open_run(folder, deadline, invalid=invalid)
            case ExportTeam(subject):
                return self._export(subject, deadline)
            case GiveCurves():
                return self._curves()
            case PlaybackCommand():
                return self._call(lambda: engine.control(request), deadline)
            case TakeOver():
                return None  # this screen has it: others are the server's
            case StopEngine(force):
                return self._end(force=force)
            case _:
                raise NotImplementedError(f"nobody carries out {request}")

    def _open_run(self, folder: str, deadline: float, *, invalid: bool) -> str | None:
        """The bag is read here, and the engine goes on meanwhile."""
        if parse_folder_name(folder) is None:
            raise MadrobError(f"{folder!r} is no run folder")
        refused = self._call(self._engine.opening_refusal, deadline)
        if refused is not None:
            return refused
        opened = open_run(self._engine.config.results / folder)
        return self._call(lambda: self._engine.open_run(opened, invalid=invalid), deadline)

    def _export(self, subject: int, deadline: float) -> str | None:
        reporting = self._reporting
        if reporting is None:
            return "nobody packs runs here: use `madrob export`"
        return self._call(lambda: reporting.export(subject), deadline)

    def _curves(self) -> Curves | None:
        scored = self._engine.scored  # immutable: may be read from any thread
        return None if scored is None else curves_of(scored.result, scored.rows)

    def _end(self, *, force: bool) -> str | None:
        if self.busy and not force:
            return "a run is going on"
        self._stop.set()
        return None

    @property
    def results(self) -> Path:
        """Where the runs are kept."""
        return self._engine.config.results

    @property
    def busy(self) -> bool:
        """Whether a run goes on or its result is being written."""
        return self._failure is None and self._engine.busy

    @property
    def ended(self) -> bool:
        """Whether it was told to end."""
        return self._stop.is_set()

    def close(self) -> None:
        """End the engine; a run that goes on is cut off and kept as interrupted."""
        self._stop.set()
        self._thread.join()
