"""A competition's lists are read again whenever their files change, beside the engine."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from madrob_console.files.bounded import Stamp, stamp_of

L = TypeVar("L")
"""A list: of teams, or a plan."""

PERIOD = 1.0
"""Between two looks at the file, s."""

FIRST_READING = 2.0
"""An engine waits so long for the first reading: then it begins without a list, s."""


class ListSource(Protocol[L]):
    """Where a list comes from."""

    @property
    def file(self) -> Path | None:
        """The file; None = there is none."""
        ...

    def read(self, before: L | None = None) -> L:
        """The list as it is now; `before` as it was, None = it is read for the first time."""
        ...


class ListWatch(Generic[L]):
    """Reads a list in a thread of its own: a file on a disk that hangs holds nobody up.

    Args:
        source: where the list comes from.
        told: called with the list, and with each that differs from the one before.
        period: between two looks, s.
        changed: called after each that differs.
    """

    def __init__(
        self,
        source: ListSource[L],
        told: Callable[[L], None],
        period: float = PERIOD,
        changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._source = source
        self._told = told
        self._changed = changed
        self._period = period
        self._list: L | None = None
        self._taken: Stamp | None = None
        self._seen: Stamp | None = None
        self._read = threading.Event()
        self._closed = threading.Event()
        # a daemon: it may hang in the file's disk when the engine ends
        self._thread = threading.Thread(target=self._work, name="lists", daemon=True)
        self._thread.start()
        self._read.wait(FIRST_READING)

    def close(self) -> None:
        """Look no more."""
        self._closed.set()

    def look(self) -> None:
        """Read the file if it has changed; while it still changes, only the next time."""
        stamp = self._stamp()
        still, self._seen = stamp == self._seen, stamp
        if not still or stamp == self._taken:
            return
        self._take(stamp)

    def _stamp(self) -> Stamp | None:
        try:
            return stamp_of(os.path.realpath(self._source.file or ""))  # it may be a link
        except ValueError:  # a path with a NUL in it
            return None

    def _take(self, stamp: Stamp | None) -> None:
        listed, self._taken = self._source.read(self._list), stamp
        if listed != self._list:
            first, self._list = self._list is None, listed
            self._told(listed)
            if not first:
                self._changed()

    def _work(self) -> None:
        self._seen = self._stamp()
        self._take(self._seen)
        self._read.set()
        while self._source.file is not None and not self._closed.wait(self._period):
            self.look()
