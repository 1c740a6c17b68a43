"""Textual's driver on our filter: whole keys, and clicks and drags of the mouse."""

from __future__ import annotations

import os
import time
from codecs import getincrementaldecoder
from contextlib import suppress
from selectors import EVENT_READ, DefaultSelector
from threading import Thread
from typing import TYPE_CHECKING

from textual.drivers.linux_driver import LinuxDriver
from textual.message import Message

from madrob_console.ui.keys.terminal_input import InputFilter, escape_patience

if TYPE_CHECKING:
    from textual.app import App


_MOVES, _DRAGS = "\x1b[?1003", "\x1b[?1002"

_LOOK = 0.05
"""Between two looks for what the terminal does not finish, s."""


class KeysDropped(Message):
    """So many keys came at once that most were dropped."""


class ConsoleDriver(LinuxDriver):
    """Textual reads what `InputFilter` hands on.

    Moves of the mouse are not reported: each would cross the line and wake the screens.
    """

    def __init__(
        self,
        app: App[object],
        *,
        debug: bool = False,
        mouse: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        """As any driver."""
        super().__init__(app, debug=debug, mouse=mouse, size=size)
        self._filter = InputFilter(
            escape_patience(os.environ),
            lambda: app.message_queue_size,
            lambda: self.send_message(KeysDropped()),
        )

    def run_input_thread(self) -> None:
        """Textual's, on a pipe."""
        terminal, (reading, writing) = self.fileno, os.pipe()
        feeding = Thread(target=self._feed, args=(terminal, writing), name="terminal-input")
        feeding.start()
        self.fileno = reading
        try:
            super().run_input_thread()
        finally:
            self.fileno = terminal
            self.exit_event.set()
            feeding.join()
            os.close(reading)
            os.close(writing)

    def _feed(self, terminal: int, writing: int) -> None:
        decode = getincrementaldecoder("utf-8")("replace").decode
        with DefaultSelector() as selector:
            selector.register(terminal, EVENT_READ)
            while not self.exit_event.is_set():
                came = b""
                if selector.select(_LOOK):
                    with suppress(OSError):
                        came = os.read(terminal, 1 << 16)
                    if not came:  # a terminal that has gone: the hang-up ends the console
                        selector.unregister(terminal)
                now = time.monotonic()
                text = self._filter.feed(decode(came), now) if came else self._filter.tick(now)
                os.write(writing, text.encode())

    def write(self, data: str) -> None:
        super().write(data.replace(_MOVES, _DRAGS) if data.startswith(_MOVES) else data)
