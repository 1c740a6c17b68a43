"""The life of an engine that serves screens: until it is over, has failed, or lost a thread."""

from __future__ import annotations

import threading
from contextlib import suppress
from queue import Empty, SimpleQueue

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.engine_interface import EngineClient

_PERIOD = 1.0
_LAST_WORDS = 0.5
"""Time to tell the screens that the engine has failed, s."""


def wait_for_end(engine: EngineClient, over: SimpleQueue[None]) -> None:
    """Return when the engine is over, or has failed and could tell its screens."""
    patience = _PERIOD
    while True:
        try:
            engine.snapshot()
        except MadrobError:
            patience = _LAST_WORDS
        with suppress(Empty):
            over.get(timeout=patience)
            return
        if patience == _LAST_WORDS:
            return


class FallenThreads:
    """Threads that ended with an unforeseen error: their work is missing from then on."""

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
