"""The event log that people read: the last lines, numbered."""

from __future__ import annotations

from collections import deque

from madrob_console.engine.shown.snapshot import LogLine
from madrob_console.names import terminal_safe
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import Change, act_of

KEPT_LINES = 200


class EventLog:
    """Numbers lines from 0 over the life of the engine and keeps the last 200."""

    def __init__(self) -> None:
        self._lines: deque[LogLine] = deque(maxlen=KEPT_LINES)
        self._number = 0

    @property
    def lines(self) -> tuple[LogLine, ...]:
        """What is kept, oldest first."""
        return tuple(self._lines)

    def clear(self) -> None:
        """Forget the lines of the run before; the numbers go on."""
        self._lines.clear()

    def add(self, entry: Entry, start: float | None) -> None:
        """Add a line for a journal entry; `start` of the run, s since the epoch."""
        time = float(entry.details.get("time", entry.time))
        relative = None if start is None else time - start
        text = terminal_safe(_in_words(entry))
        self._lines.append(LogLine(self._number, time, relative, entry.origin, text))
        self._number += 1


def _in_words(entry: Entry) -> str:
    details, reason = entry.details, entry.reason
    ending = f": {reason}" if reason else ""
    match entry.what:
        case Change.EVENT:
            return str(details["event"])
        case Change.FALSE_START:
            return f"FALSE START: {details['event']}"
        case Change.RUN_STOPS:
            return f"run stops: {details['outcome']}{ending}"
        case _:
            act = act_of(entry)
            return f"{entry.what if act is None else act.logged}{ending}"
