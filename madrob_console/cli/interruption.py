"""Ctrl+C ends a command with one line, nothing half made, and exit code 130."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from madrob_console.cli.output import complain
from madrob_console.cli.safe_stream import raw

STOPPED = 128 + signal.SIGINT
"""Exit code after Ctrl+C, as shells have it."""

_AGAIN = 0.02  # s
_CLEANING = 2.0  # s
_IMPORTING = "<frozen importlib._bootstrap>"


def say_stopped() -> int:
    """Print the line; returns the exit code. Another Ctrl+C then ends the process at once."""
    if _is_main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.stderr is not None and sys.stderr.isatty():
        print("\r", end="", file=raw(sys.stderr))  # over the ^C of the terminal
    complain("stopped")
    return STOPPED


class Interruption:
    """The handler of Ctrl+C: raises KeyboardInterrupt at a moment at which it takes effect.

    In the middle of an import, NumPy would turn it into an ImportError with a traceback; in a
    finaliser, Python would print it and go on. The handler waits for the end of both. For two
    seconds, while the command cleans up, it ignores another Ctrl+C.

    Attributes:
        raised: whether it was; whatever fails afterwards fails because of it.
        over: the command has ended, nothing comes again.
    """

    def __init__(self) -> None:
        self.raised = self.over = False
        self._heeded = -_CLEANING

    def __call__(self, _number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, or try again a moment later."""
        now = time.monotonic()
        if now < self._heeded + _CLEANING:
            return
        if _importing(frame):
            self._come_again()
            return
        self.raised, self._heeded = True, now
        raise KeyboardInterrupt

    def unraisable(self, what: sys.UnraisableHookArgs) -> None:
        """Raise again an interrupt that nothing could catch; the error it caused is not printed."""
        if what.exc_type is KeyboardInterrupt:
            self._heeded = -_CLEANING
            self._come_again()
        elif not self.raised:
            sys.__unraisablehook__(what)

    def _come_again(self) -> None:
        _thread.start_new_thread(self._press_again, ())  # without a lock that may be held here

    def _press_again(self) -> None:
        time.sleep(_AGAIN)
        if not self.over:
            os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Let `Interruption` handle Ctrl+C while inside; an ignored Ctrl+C stays ignored."""
    interruption = Interruption()
    if not _is_main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield interruption
        return
    hook = sys.unraisablehook
    signal.signal(signal.SIGINT, interruption)
    sys.unraisablehook = interruption.unraisable
    try:
        yield interruption
    finally:
        interruption.over = True
        sys.unraisablehook = hook
        if signal.getsignal(signal.SIGINT) is interruption:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTING:
            return True
        frame = frame.f_back
    return False


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
