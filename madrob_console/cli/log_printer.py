"""The event log as plain lines on the terminal."""

from __future__ import annotations

from madrob_console.engine.live.event_log import EventLog


class LogPrinter:
    """Prints every line of a log once.

    Args:
        log: of an engine.
    """

    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._printed = 0

    def print_new(self) -> None:
        """Print what has come since."""
        for line in self._log.lines:
            if line.number < self._printed:
                continue
            self._printed = line.number + 1
            clock = "" if line.relative is None else f"{line.relative:+.3f} s"
            print(f"{clock:>12}  {line.origin:<8}  {line.text}", flush=True)
