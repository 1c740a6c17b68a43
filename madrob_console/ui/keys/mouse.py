"""What the terminal tells of the mouse."""

from __future__ import annotations

from textual.drivers.linux_driver import LinuxDriver

_MOVES, _DRAGS = "\x1b[?1003", "\x1b[?1002"


class ButtonsDriver(LinuxDriver):
    """A terminal that tells of clicks and drags: nothing here cares where the mouse hovers.

    Each move would be sent over the line, and wake the screens.
    """

    def write(self, data: str) -> None:
        """What is drawn, and what is asked of the terminal."""
        super().write(data.replace(_MOVES, _DRAGS) if data.startswith(_MOVES) else data)
