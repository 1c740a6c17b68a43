"""Acts that take effect once their line is on disk: one at a time, each at most once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from madrob_console.archive.run_journal import Unfinished, find_unfinished
from madrob_console.engine.disk import DiskThreads, why_not
from madrob_console.engine.journal_writer import JournalLine, OpenJournal, Recording
from madrob_console.engine.replay import EngineContext
from madrob_console.engine.run_recorder import EventPublisher, RunRecorder
from madrob_console.engine.scorer import EarlierRun
from madrob_console.referee.acts import Act, Consequence, Finalise, Situation
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change

# Answers of acts, so that an act that comes twice is carried out once.


MOST_KNOWN = 1000

Told = Callable[[str | None], None]
"""Called once with the outcome of an act: why it was refused, in words, or None."""


class _Known:
    def __init__(self) -> None:
        self.answered = False
        self.refused: str | None = None
        self.waiting: list[Told] = []

    def tell(self, refused: str | None) -> None:
        self.answered, self.refused = True, refused
        for done in self.waiting:
            done(refused)


class Answers:
    """Remembers acts by the ids that their screens made."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def expect(self, name: str, done: Told) -> Told | None:
        """Register who is told the outcome of the act with this id; empty = it has none.

        Returns what is to be called once; None for a known act: then `done` gets its first answer.
        """
        if not name:
            return done
        new = name not in self._known
        known = self._known.setdefault(name, _Known())
        if known.answered:
            done(known.refused)
        else:
            known.waiting.append(done)
        while len(self._known) > MOST_KNOWN:
            self._known.popitem(last=False)
        return known.tell if new else None


DURABLE_WITHIN = 2.0
"""A line that is not on disk after this is withdrawn, s."""

SILENT = 1.0
"""A disk without an answer for this long gets nothing new, s."""

TakeEffect = Callable[[Act, Entry, Recording | None], None]
"""Carries out an act whose line is on disk; a start also gets the files of its run."""


@dataclass(eq=False)
class _Pending:
    """An act that waits for the disk until its `deadline`, s of the monotonic clock.

    Its `job` makes the files of a run that starts, or completes the act; a line has none.
    """

    act: Act
    line: JournalLine
    answer: Told
    deadline: float
    job: Future[Any] | None = None
    then: Callable[[], None] | None = None

    @property
    def starts(self) -> bool:
        return Consequence.RECORDING in self.act.consequences

    def tell(self, refused: str | None) -> None:
        self.answer(refused)
        if self.then is not None:
            self.then()

    def withdrawal(self, now: float, why: str) -> Entry:
        details = {"id": self.line.entry.id, "act": self.act.name}
        return Entry(now, Origin.SYSTEM, Change.WITHDRAWN, reason=why, details=details)


class DurableActs:
    """Has the lines of acts written, and then the acts carried out.

    The clock is held from a start on, until it is withdrawn.
    """

    def __init__(
        self,
        engine_context: EngineContext,
        event_publisher: EventPublisher,
        recorder: RunRecorder,
        situation: Callable[[], Situation],
        take_effect: TakeEffect,
    ) -> None:
        self._engine_context = engine_context
        self._clock = engine_context.clock
        self._keepers = engine_context.keepers
        self._event_publisher = event_publisher
        self._recorder = recorder
        self._situation = situation
        self._take_effect = take_effect
        self._pending: _Pending | None = None

    @property
    def waiting(self) -> type[Act] | None:
        """From any thread."""
        pending = self._pending
        return None if pending is None else type(pending.act)

    def refusal(self, act: Act | type[Act], *, active: bool) -> str | None:
        """Why the disk allows no such act now, in words; `active`: a run goes on."""
        ends = act.urgent or act.name == Finalise.name or Consequence.NEW_RUN in act.consequences
        if self._event_publisher.journal.full and not ends:
            return "the journal of this run is full: sign it, then set up the next run"
        silent = self._keepers.own.silent
        if self.waiting is not None and not (act.at_once and active):
            return f"the disk has not taken the {self.waiting.name} yet: wait for it"
        if not act.at_once and silent > SILENT:
            return f"the disk has not answered for {silent:.0f} s: nothing new until it does"
        return None

    def submit(
        self,
        act: Act,
        line_of: Callable[[Act], Entry],
        answer: Told,
        prepare: Callable[[], Act] | None = None,
    ) -> None:
        """Have an act carried out when its line is on disk; it is judged again then.

        `line_of` makes its journal line, with an id. `answer` is called once: why the act was
        refused, in words, or None. `prepare` first completes the act, in the disk's thread.
        """
        deadline = self._keepers.monotonic() + DURABLE_WITHIN
        pending = self._pending = _Pending(act, JournalLine(line_of(act)), answer, deadline)
        if pending.starts:
            self._clock.hold_steady()
            run, opened = self._situation().run, partial(self._opened, pending)
            pending.job = self._recorder.start(run, pending.line, opened)
        elif prepare is not None:
            prepared = partial(self._prepared, pending, line_of)
            pending.job = self._keepers.own.submit_job(prepare, prepared)
        else:
            self._write(pending, pending.line.entry)

    def _prepared(
        self, pending: _Pending, line_of: Callable[[Act], Entry], complete: Future[Act]
    ) -> None:
        if pending is not self._pending:
            return  # it was withdrawn
        if (refused := why_not(complete)) is not None:
            self._decide(pending, refused)
            return
        pending.act, pending.job = complete.result(), None
        self._write(pending, line_of(pending.act))

    def _write(self, pending: _Pending, entry: Entry) -> None:
        """To the journal alone; the rest is told when it takes effect."""
        pending.line = JournalLine(entry, partial(self._decide, pending))
        self._event_publisher.journal.add_line(pending.line)

    def withdraw_overdue(self) -> None:
        pending = self._pending
        if pending is None:
            return
        if self._keepers.monotonic() >= pending.deadline:
            self.withdraw(f"the disk did not take it within {DURABLE_WITHIN:g} s")
        elif pending.job is None and (why := pending.act.refusal(self._situation())):
            self.withdraw(why)

    def withdraw(self, why: str) -> bool:
        """Withdraw the waiting act; False if it is on disk already, and will take effect."""
        pending = self._pending
        assert pending is not None
        withdrawal = pending.withdrawal(self._engine_context.now(), why)
        if not pending.line.withdraw(withdrawal):
            return False
        self._pending = None
        if pending.job is not None:
            pending.job.cancel()  # else the folder of a start gets the line when the disk is back
        if pending.starts:
            self._clock.release()
            self._event_publisher.log.add_line(withdrawal, None)
        elif pending.job is None:
            self._event_publisher.write(withdrawal, self._situation().run.fixed_start)
        pending.tell(f"{why}: it is withdrawn")
        return True

    def withdraw_or(self, why: str, then: Callable[[], None]) -> bool:
        """Withdraw the waiting act; if that is too late, call `then` when it is done."""
        assert self._pending is not None
        if self.withdraw(why):
            return True
        self._pending.then = then
        return False

    def _opened(self, pending: _Pending, opened: Future[Recording | None]) -> None:
        if pending is self._pending:  # else it was withdrawn
            refused = why_not(opened)
            self._decide(pending, refused, None if refused else opened.result())

    def _decide(
        self, pending: _Pending, refused: str | None, made: Recording | None = None
    ) -> None:
        """The disk has answered: carry the act out, if it is still possible."""
        self._pending = None
        situation = self._situation()
        if refused is None and (refused := pending.act.refusal(situation)) is not None:
            withdrawal = pending.withdrawal(self._engine_context.now(), refused)
            if made is None:
                self._event_publisher.write(withdrawal, situation.run.fixed_start)
            else:
                self._keepers.own.submit_job(partial(made.give_up, withdrawal))
        if refused is None:
            self._take_effect(pending.act, pending.line.entry, made)
        elif pending.starts:
            self._clock.release()
        pending.tell(refused)


# Runs that were cut off, and how one is taken up again.


class EarlierRuns:
    """Knows runs that were cut off, and opens the journals of earlier runs to go on with them."""

    def __init__(self, results: Path, keepers: DiskThreads) -> None:
        self.unfinished: tuple[Unfinished, ...] = ()
        self._results = results
        self._keepers = keepers

    def find_cut_off_runs(self) -> None:
        self._keepers.reading.submit_job(partial(find_unfinished, self._results), self._found)

    def look_again(self) -> None:
        """Search again once the current run, which is left, has closed its journal."""
        self._keepers.own.submit_job(lambda: None, lambda _: self.find_cut_off_runs())

    def _found(self, unfinished: Future[tuple[Unfinished, ...]]) -> None:
        if unfinished.exception() is None:  # else it blocks the start: a check says so
            self.unfinished = unfinished.result()

    def reopen(
        self,
        opened: EarlierRun,
        refusal: Callable[[], str | None],
        take_up: Callable[[OpenJournal], None],
        done: Told,
    ) -> None:
        """Open the journal of an earlier run, in time or not at all.

        `refusal` says why it cannot be opened now; `take_up` goes on with the open journal;
        `done` is called once.
        """
        job = partial(OpenJournal.reopen, opened.folder, opened.entries)
        latest = self._keepers.monotonic() + DURABLE_WITHIN

        def reopened(journal: Future[OpenJournal]) -> None:
            refused = why_not(journal)
            if refused is None:
                refused = refusal()
                if self._keepers.monotonic() >= latest:
                    refused = f"the disk took more than {DURABLE_WITHIN:g} s: try again"
                if refused is not None:
                    self._keepers.own.submit_job(journal.result().close)
            if refused is None:
                take_up(journal.result())
                self.unfinished = tuple(
                    run for run in self.unfinished if self._results / run.folder != opened.folder
                )
            done(refused)

        self._keepers.own.submit_job(job, reopened)
