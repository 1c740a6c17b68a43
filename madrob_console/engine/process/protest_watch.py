"""Protests that wait for a decision, of all runs of the results folder: told until it is made."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import TypeAlias

from madrob_console.archive.history import RunSummary, time_words
from madrob_console.referee.protests import deadline_words, due_words

LOOKING_PERIOD = 60.0
"""Another console, or another machine, may have filed or decided one, s."""

Read: TypeAlias = Callable[[Callable[[], Sequence[RunSummary]]], Future[Sequence[RunSummary]]]
"""Has the runs read, beside the engine."""


class ProtestWatch:
    """Knows the runs with an open protest, as they were read last.

    Args:
        history: reads all runs.
        read: has that done; it must not wait.
        monotonic: s.
    """

    def __init__(
        self,
        history: Callable[[], Sequence[RunSummary]],
        read: Read,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._history = history
        self._read = read
        self._monotonic = monotonic
        self._protested: Sequence[RunSummary] = ()
        self._reading: Future[Sequence[RunSummary]] | None = None
        self._seen: object = None
        self._read_at = 0.0

    def look(self, seen: object) -> None:
        """Read again where something has changed, or a while has passed. Never waits.

        Args:
            seen: differs when a result has come or changed.
        """
        now = self._monotonic()
        if self._reading is not None:
            if not self._reading.done():
                return
            if self._reading.exception() is None:  # else it is read again after a while
                runs = (run for run in self._reading.result() if run.protest_due is not None)
                self._protested = tuple(sorted(runs, key=lambda run: run.protest_due or 0.0))
            self._reading = None
        if seen == self._seen and now - self._read_at < LOOKING_PERIOD:
            return
        self._seen, self._read_at = seen, now
        self._reading = self._read(self._history)

    def overdue(self, now: float, at_hand: str) -> Iterator[str]:
        """Protests that should have been decided, in words that stay the same.

        Args:
            now: s since the epoch.
            at_hand: folder of the run at hand, which tells its own.
        """
        for run in self._protested:
            if run.protest_due is not None and run.protest_due < now and run.folder != at_hand:
                late = deadline_words(run.protest_due, now, time_words)
                yield f"{_which(run)}: {late}; h opens it, P decides it"

    def open(self, now: float) -> Iterator[str]:
        """All that are open, in words; `now` in s since the epoch."""
        protested = ((run, run.protest_due or now) for run in self._protested)
        return (f"{_which(run)}: {due_words(due, now)}" for run, due in protested)


def _which(run: RunSummary) -> str:
    which = f"run {run.run_number} of subject {run.subject} in condition {run.condition}"
    return f"protest against {which}"
