"""An engine in a thread of its own, and the client that talks to it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TypeVar

from madrob_console.archive.folders import parse_folder_name
from madrob_console.archive.rescore import open_run
from madrob_console.engine.live.core import Engine
from madrob_console.engine.process.reporting import Papers
from madrob_console.engine.shown.curves import Curves, curves_of
from madrob_console.engine.shown.playback import AnyCommand
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.engine.shown.wire import ALONE
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Act
from scoring.kinematics import load_filters

TAKE_TIMEOUT = 0.02
"""How long the engine waits for messages before it looks at acts and the clock, s."""

SNAPSHOT_PERIOD = 0.05
"""Screens get a new snapshot this often, s."""

ANSWER_TIMEOUT = 5.0
"""A screen waits this long for the answer to an act, s."""

_T = TypeVar("_T")


class LocalEngine:
    """Runs an engine in a thread; an `EngineClient`.

    Nothing that a screen does holds the engine up: calls are queued, snapshots are taken from
    the latest one.

    Args:
        engine: not opened yet.
        papers: what makes reports and exports, closed by the caller; None = nobody does.

    Raises:
        MadrobError: the testbed cannot be reached.
    """

    def __init__(self, engine: Engine, papers: Papers | None = None) -> None:
        self._engine = engine
        self._papers = papers
        if papers is not None:
            engine.on_result = papers.report
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        engine.open()
        self._snapshot = engine.snapshot()
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
                    self._snapshot = self._engine.snapshot()
                    shown = time.monotonic()
        except BaseException as error:
            self._failure = error
            raise
        finally:
            self._engine.close()
            self._answer_calls()

    def _answer_calls(self) -> None:
        while True:
            try:
                call = self._calls.get_nowait()
            except Empty:
                return
            call()

    def _ask(self, question: Callable[[], _T]) -> _T:
        answer: Future[_T] = Future()

        def call() -> None:
            try:
                result = question()
            except MadrobError as error:
                answer.set_exception(error)
                return
            self._snapshot = self._engine.snapshot()  # before the answer: it shows what was done
            answer.set_result(result)

        if self._failure is not None or self._stop.is_set():
            raise MadrobError("the engine has ended: start the console again")
        self._calls.put(call)
        try:
            return answer.result(ANSWER_TIMEOUT)
        except TimeoutError:
            raise MadrobError("the engine does not answer: look at the disk") from None

    def snapshot(self) -> Snapshot:
        """The latest snapshot.

        Raises:
            MadrobError: the engine has failed.
        """
        if self._failure is not None:
            raise MadrobError(f"the engine has failed: {self._failure}")
        snapshot, papers = self._snapshot, self._papers
        if papers is None or (papers.problem, papers.exported) == (None, None):
            return snapshot
        problems = [] if papers.problem is None else [papers.problem]
        return replace(snapshot, faults=(*snapshot.faults, *problems), export=papers.exported)

    def act(self, act: Act) -> str | None:
        """Hand in an act; returns the refusal in words, None when it took effect.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(lambda: self._engine.perform(act))

    def next_run_number(self, subject: int, condition_number: int) -> int:
        """The next run number that was never used for this subject and condition.

        Raises:
            MadrobError: the results folder cannot be read, or all numbers are used.
        """
        return self._ask(lambda: self._engine.next_run_number(subject, condition_number))

    def open_run(self, folder: str, *, invalid: bool = False) -> str | None:
        """Show an earlier run; it is read here, and the engine goes on meanwhile.

        Raises:
            MadrobError: it cannot be read, or the engine has ended.
        """
        if parse_folder_name(folder) is None:
            raise MadrobError(f"{folder!r} is no run folder")
        refused = self._ask(self._engine.opening_refusal)
        if refused is not None:
            return refused
        opened = open_run(self._engine.config.results / folder)
        return self._ask(lambda: self._engine.open_run(opened, invalid=invalid))

    def export_team(self, subject: int) -> str | None:
        """Pack a team's runs in the background; returns why not, None when it is on its way."""
        if self._papers is None:
            return "nobody packs runs here: use `madrob export`"
        self._papers.export(subject)
        return None

    @property
    def results(self) -> Path:
        """Where the runs are kept."""
        return self._engine.config.results

    @property
    def busy(self) -> bool:
        """Whether a run goes on or its result is being written."""
        return self._failure is None and self._engine.busy

    def control(self, command: AnyCommand) -> str | None:
        """Pause, step or move a replay; returns why not, None when it is done or on its way.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(lambda: self._engine.control(command))

    def take_over(self) -> str | None:
        """Nobody else is there to take the right to act from."""
        return ALONE

    def curves(self) -> Curves | None:
        """What the figures show of the run with a result; None without one."""
        scored = self._engine.scored  # immutable: may be read from any thread
        return None if scored is None else curves_of(scored.result, scored.rows)

    def close(self) -> None:
        """End the engine; a run that goes on is cut off and kept as interrupted."""
        self._stop.set()
        self._thread.join()
