"""The event log that people read: the last lines, numbered."""

from __future__ import annotations

from collections import deque

from madrob_console.common.names import terminal_safe
from madrob_console.engine.snapshot import LogLine, Weight
from madrob_console.referee.acts import Act
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import Change, act_of
from scoring.protocol import event_words

KEPT_LINES = 200


class EventLog:
    """Numbers lines from 0 over the life of the engine and keeps the last 200."""

    def __init__(self) -> None:
        self._lines: deque[LogLine] = deque(maxlen=KEPT_LINES)
        self._number = 0

    @property
    def lines(self) -> tuple[LogLine, ...]:
        """Oldest first."""
        return tuple(self._lines)

    def clear(self) -> None:
        self._lines.clear()

    def add_line(self, entry: Entry, start: float | None) -> None:
        """`start` of the run is in s since the epoch."""
        time = float(entry.details.get("time", entry.time))
        relative = None if start is None else time - start
        act = act_of(entry)
        words, weight = _said(entry) if act is None else _done(act)
        text = terminal_safe(f"{words}: {entry.reason}" if entry.reason else words)
        self._lines.append(LogLine(self._number, time, relative, entry.origin, text, weight))
        self._number += 1


def _said(entry: Entry) -> tuple[str, Weight]:
    match entry.what:
        case Change.EVENT:
            return event_words(str(entry.details["event"])), Weight.PLAIN
        case Change.FALSE_START:
            return f"FALSE START: {event_words(str(entry.details['event']))}", Weight.ALARM
        case Change.WITHDRAWN:
            return f"{entry.details.get('act', 'a line')} withdrawn", Weight.NOTICE
        case Change.ROBOT_SAYS:
            return entry.what, Weight.NOTICE
        case Change.RUN_STOPS:
            return f"run stops: {entry.details['outcome']}", Weight.PLAIN
    return entry.what, Weight.PLAIN


def _done(act: Act) -> tuple[str, Weight]:
    return act.logged, Weight.NOTICE if act.stands_out else Weight.PLAIN
