"""Reads the competition's lists again when their files change."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from madrob_console.common.plain_files import Stamp, stamp_of

L = TypeVar("L")

PERIOD = 1.0
"""How often the files are checked, s."""

FIRST_READING = 2.0
"""An engine waits this long for the first reading, s; then it begins without lists."""


class ListWatch(Generic[L]):
    """Reads a list again when its file has changed.

    `read` gets the list before, `on_list` the first list and each changed one; `on_change` is
    called after each change.
    """

    def __init__(
        self,
        file: Path | None,
        read: Callable[[L | None], L],
        on_list: Callable[[L], None],
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self.file = file
        self._read = read
        self._on_list = on_list
        self._on_change = on_change
        self._list: L | None = None
        self._taken: Stamp | None = None
        self._last_stamp: Stamp | None = None

    def read_if_changed(self) -> None:
        """Read the file if it has changed, and not again since the last look."""
        stamp, before = self._stamp(), self._list
        rests, self._last_stamp = stamp == self._last_stamp, stamp
        if before is not None and (not rests or stamp == self._taken):
            return
        self._list, self._taken = self._read(before), stamp
        if self._list != before:
            self._on_list(self._list)
            if before is not None:
                self._on_change()

    def _stamp(self) -> Stamp | None:
        try:
            return stamp_of(os.path.realpath(self.file or ""))  # it may be a link
        except ValueError:  # a path with a NUL in it
            return None


def follow_lists(watches: Sequence[ListWatch[Any]], period: float = PERIOD) -> Callable[[], None]:
    """Read lists in a thread of their own: a disk that hangs holds nobody up.

    Returns what ends it.
    """
    first_read, closed = threading.Event(), threading.Event()

    def work() -> None:
        for watch in watches:
            watch.read_if_changed()
        first_read.set()
        files = [watch for watch in watches if watch.file is not None]
        while files and not closed.wait(period):
            for watch in files:
                watch.read_if_changed()

    # a daemon: it may hang in the files' disk when the engine ends
    threading.Thread(target=work, name="lists", daemon=True).start()
    first_read.wait(FIRST_READING)
    return closed.set
