"""What went wrong around the engine and ends nothing: a line in its log, once for each kind."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from typing import Any

from madrob_console.names import terminal_safe

AGAIN = 600.0
"""The same is said again after so long, s: a log in memory must not grow with every screen."""

_MOST_KINDS = 50
_PAUSE = 1.0


class FallenThreads:
    """Threads that an error ended which nobody foresaw: what they did is wanting from then on.

    Attributes:
        problem: what screens show of the last one, in words; None while there is none.
    """

    def __init__(self) -> None:
        self.problem: str | None = None

    def note(self, fallen: threading.ExceptHookArgs) -> None:
        """A hook for `threading.excepthook`; the log has the traceback."""
        name = "?" if fallen.thread is None else fallen.thread.name
        why = str(fallen.exc_value or "") or fallen.exc_type.__name__
        self.problem = terminal_safe(
            f"a part of the engine has ended ({name}: {why}): start it again after the run"
        )
        threading.__excepthook__(fallen)


class Troubles:
    """Says each kind of trouble once in a while, in one line.

    Args:
        monotonic: a clock, s.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._said: dict[tuple[str, str], float] = {}

    def tell(self, what: str, error: BaseException | None = None) -> None:
        """Say what happened, and why."""
        why = "" if error is None else f" ({str(error) or type(error).__name__})"
        kind = (what, type(error).__name__)
        now = self._monotonic()
        if now - self._said.get(kind, -AGAIN) < AGAIN or len(self._said) >= _MOST_KINDS:
            return
        self._said[kind] = now
        with suppress(OSError):  # a log that is full
            sys.stderr.write(f"madrob: {terminal_safe(what + why)}\n")
            sys.stderr.flush()

    def of_loop(self, _loop: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
        """An exception handler for an event loop: no traceback for each connection."""
        self.tell(str(context.get("message", "the engine's socket")), context.get("exception"))

    async def lasting(self, work: Callable[[], Awaitable[None]]) -> None:
        """Do what must go on as long as the engine does, again after whatever ends it early."""
        while True:
            try:
                return await work()
            except Exception as error:  # noqa: BLE001 - whatever it is, screens wait for it
                self.tell("screens had to wait", error)
                await asyncio.sleep(_PAUSE)
