"""Ctrl+C: one line, nothing half made, exit code 130."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from madrob_console.cli.problems import complain
from madrob_console.cli.safe_output import raw

STOPPED = 128 + signal.SIGINT
"""Exit code after Ctrl+C, as shells have it."""

_AGAIN = 0.02  # s
_CLEANING = 2.0  # s
_IMPORTING = "<frozen importlib._bootstrap>"


def say_stopped() -> int:
    """The line, and the exit code; from here on another Ctrl+C ends the process at once."""
    if _is_main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.stderr is not None and sys.stderr.isatty():
        print("\r", end="", file=raw(sys.stderr))  # over the ^C of the terminal
    complain("stopped")
    return STOPPED


class Interruption:
    """The handler of Ctrl+C: a KeyboardInterrupt, at a moment at which it is heeded.

    Raised in the middle of an import, NumPy makes an ImportError of it and prints a traceback;
    raised while an object is finalised, Python prints it and goes on. Both are waited for. While
    what was begun is put away, for two seconds, another one is none. An alarm that the caller has
    set is the caller's, as before.

    Attributes:
        raised: whether it was; whatever fails afterwards fails because of it.
    """

    def __init__(self) -> None:
        self.raised = False
        self._heeded = -_CLEANING
        self._comes_again = False
        self._alarm = signal.getsignal(signal.SIGALRM)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Raise, or come back by a timer.

        Raises:
            KeyboardInterrupt: it is heeded.
        """
        if number == signal.SIGALRM and not self._comes_again:
            if callable(self._alarm):
                self._alarm(number, frame)
            return
        self._comes_again = False
        now = time.monotonic()
        if now < self._heeded + _CLEANING:
            return
        if _importing(frame):
            self._come_again()
            return
        self.raised, self._heeded = True, now
        raise KeyboardInterrupt

    def unraisable(self, what: sys.UnraisableHookArgs) -> None:
        """One that was raised where nothing could take it comes again; what it broke is silent."""
        if what.exc_type is KeyboardInterrupt:
            self._heeded = -_CLEANING
            self._come_again()
        elif not self.raised:
            sys.__unraisablehook__(what)

    def _come_again(self) -> None:
        self._comes_again = True
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """While inside, Ctrl+C is what `Interruption` says; where it is ignored it stays so."""
    interruption = Interruption()
    if not _is_main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield interruption
        return
    hook = sys.unraisablehook
    signal.signal(signal.SIGINT, interruption)
    alarm = signal.signal(signal.SIGALRM, interruption)
    left, began = signal.getitimer(signal.ITIMER_REAL)[0], time.monotonic()
    sys.unraisablehook = interruption.unraisable
    try:
        yield interruption
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, alarm)
        if (still := left - time.monotonic() + began) > 0:
            signal.setitimer(signal.ITIMER_REAL, still)
        sys.unraisablehook = hook
        if signal.getsignal(signal.SIGINT) is interruption:
            signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def children_spared() -> Iterator[None]:
    """Processes that are started while inside never hear of Ctrl+C; here it is heeded afterwards.

    A terminal sends it to all processes, and each of them would print a traceback of its own.
    """
    interruption = signal.getsignal(signal.SIGINT)
    if not (_is_main_thread() and isinstance(interruption, Interruption)):
        yield
        return
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # what comes meanwhile waits
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # they inherit it
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, interruption)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTING:
            return True
        frame = frame.f_back
    return False


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
