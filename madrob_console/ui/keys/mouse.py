"""What the terminal tells of the mouse."""

from __future__ import annotations

import sys
from io import TextIOWrapper
from typing import TYPE_CHECKING

from textual.drivers.linux_driver import LinuxDriver

if TYPE_CHECKING:
    from textual.app import App

_MOVES, _DRAGS = "\x1b[?1003", "\x1b[?1002"


class ButtonsDriver(LinuxDriver):
    """A terminal that tells of clicks and drags: nothing here cares where the mouse hovers.

    Each move would be sent over the line, and wake the screens.
    """

    def __init__(
        self,
        app: App[object],
        *,
        debug: bool = False,
        mouse: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        """As any driver; where the error output goes elsewhere, the screen is drawn on the output.

        Args:
            app: whose screen it is.
            debug: as textual has it.
            mouse: whether the terminal is asked for the mouse.
            size: of the terminal; None = it is asked.
        """
        super().__init__(app, debug=debug, mouse=mouse, size=size)
        error, output = sys.__stderr__, sys.__stdout__
        if output is not None and not (error is not None and error.isatty()):
            if isinstance(output, TextIOWrapper):
                output.reconfigure(errors="backslashreplace")  # as the error output has it
            self._file = output

    def write(self, data: str) -> None:
        """What is drawn, and what is asked of the terminal."""
        super().write(data.replace(_MOVES, _DRAGS) if data.startswith(_MOVES) else data)
