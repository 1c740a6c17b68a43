"""Runs of the results folder: which of them were cut off, and how one is taken up again."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.unfinished import Unfinished, find_unfinished
from madrob_console.engine.live.answers import Told
from madrob_console.engine.live.durable import DURABLE_WITHIN
from madrob_console.engine.live.journal_keeper import OpenJournal
from madrob_console.engine.live.keeper import Keepers, why_not
from madrob_console.engine.live.scorer import EarlierRun


class EarlierRuns:
    """Knows runs that were cut off, and opens the journals of earlier runs to go on with them.

    Args:
        results: the results folder.
        keepers: touch the files.

    Attributes:
        unfinished: those that were cut off, as they were found last.
    """

    def __init__(self, results: Path, keepers: Keepers) -> None:
        self.unfinished: tuple[Unfinished, ...] = ()
        self._results = results
        self._keepers = keepers

    def look(self) -> None:
        """Look for runs that were cut off."""
        self._keepers.reading.ask(partial(find_unfinished, self._results), self._found)

    def look_again(self) -> None:
        """Look for them once the run at hand, which is left, has closed its journal."""
        self._keepers.own.ask(lambda: None, lambda _: self.look())

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

        Args:
            opened: the run.
            refusal: why it cannot be opened now, in words; None = it can.
            take_up: goes on with it, now that its journal is open.
            done: told once: why that is not possible, in words, or None when it is done.
        """
        job = partial(OpenJournal.reopen, opened.folder / JOURNAL_FILE, opened.entries)
        latest = self._keepers.monotonic() + DURABLE_WITHIN

        def reopened(journal: Future[OpenJournal]) -> None:
            refused = why_not(journal)
            if refused is None:
                refused = refusal()
                if self._keepers.monotonic() >= latest:
                    refused = f"the disk took more than {DURABLE_WITHIN:g} s: try again"
                if refused is not None:
                    self._keepers.own.ask(journal.result().close)
            if refused is None:
                take_up(journal.result())
                self.unfinished = tuple(
                    run for run in self.unfinished if self._results / run.folder != opened.folder
                )
            done(refused)

        self._keepers.own.ask(job, reopened)
