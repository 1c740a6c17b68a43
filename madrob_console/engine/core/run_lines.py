"""The journal of the current run as values: the lines that stand, in the order of the file."""

from __future__ import annotations

from collections.abc import Iterable

from madrob_console.referee.journal import LARGEST_JOURNAL, MOST_LINES, Entry
from madrob_console.referee.rebuild import GrowingMark
from madrob_console.referee.records import JournalMark


class RunLines:
    """Lines that take effect; the disk may not have them yet."""

    def __init__(self, entries: Iterable[Entry] = ()) -> None:
        self._entries: list[Entry] = []
        self._mark = GrowingMark()
        self._size = 0  # bytes
        for entry in entries:
            self.add(entry)

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def entries(self) -> tuple[Entry, ...]:
        return tuple(self._entries)

    @property
    def mark(self) -> JournalMark:
        return self._mark.mark

    @property
    def is_full(self) -> bool:
        """Whether half of the readable journal size is used; the rest is for the run's end."""
        return 2 * len(self._entries) > MOST_LINES or 2 * self._size > LARGEST_JOURNAL

    def add(self, entry: Entry) -> None:
        self._entries.append(entry)
        self._size += len(entry.to_json()) + 1
        self._mark.add_line(entry)

    def with_line(self, entry: Entry, place: int) -> RunLines:
        """With a line that was handed to the disk when there were `place` lines."""
        return RunLines([*self._entries[:place], entry, *self._entries[place:]])
