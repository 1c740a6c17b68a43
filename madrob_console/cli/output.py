"""What commands print and ask: problems, progress, questions, Ctrl+C, safe text."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Self, TextIO, TypeAlias, cast

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

BAD_INPUT = 2
"""Exit code of bad input and of refusals; also argparse's."""

MOST_ALIKE = 3
"""So many problems of one kind are told one by one; the others are counted."""


class StoppedError(MadrobError):
    """A signal stopped the command before anything was begun.

    Args:
        what: in words.
        number: of the signal.

    Attributes:
        exit_code: as shells have it.
    """

    def __init__(self, what: str, number: int) -> None:
        super().__init__(what)
        self.exit_code = 128 + number


def complain(problem: object) -> None:
    """Name a problem on a line of the error output.

    Args:
        problem: a text, or the error whose message names the cause and the remedy.
    """
    print(f"madrob: {terminal_safe(str(problem))}", file=sys.stderr, flush=True)


def name_twins(pairs: Sequence[tuple[str, str]]) -> None:
    """Name runs that are there several times; of many the first.

    Args:
        pairs: of each two places.
    """
    for place, other in pairs[:MOST_ALIKE]:
        complain(f"note: {place} is the same run as {other}")
    if len(pairs) > MOST_ALIKE:
        complain(f"note: and {len(pairs) - MOST_ALIKE} more runs that are there twice")


class Complaints:
    """Names the problems of many things; what is the same of all of them is counted at the end.

    Attributes:
        count: how many there were.
    """

    def __init__(self) -> None:
        self.count = 0
        self._alike: Counter[str] = Counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _error: object, _trace: TracebackType | None
    ) -> None:
        for words, count in self._alike.items():
            if count > MOST_ALIKE:
                complain(f"and {count - MOST_ALIKE} more like it: {words}")

    def add(self, problem: object, of: object) -> None:
        """Name a problem.

        Args:
            problem: as for `complain`.
            of: what it is a problem of, as the problem names it.
        """
        self.count += 1
        words = str(problem).replace(str(of), "").strip(": ")
        self._alike[words] += 1
        if self._alike[words] <= MOST_ALIKE:
            complain(problem)

    def add_each(self, problems: Iterable[tuple[str, str]]) -> None:
        """Name problems.

        Args:
            problems: of each, what it is a problem of, and the problem.
        """
        for of, problem in problems:
            self.add(f"{of}: {problem}", of)


# What a command asks whoever sits at the terminal.


def somebody_there() -> bool:
    """Whether there is somebody to ask."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def says_yes(question: str) -> bool:
    """Whether somebody at a terminal says yes."""
    if not somebody_there():
        return False
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False


# Nothing that a command says reaches the terminal raw, whoever printed it.
#
# Names, reasons, exceptions and what argparse repeats of the command line may hold escape
# sequences.


class SafeStream:
    """A text stream that keeps line breaks and nothing else that a terminal would obey.

    Bytes that are written to its `buffer` are data for a program, and stay as they are.

    Args:
        stream: where everything goes.

    Attributes:
        raw_stream: the same stream as it was, for what draws on a terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self.raw_stream = stream

    def write(self, text: str) -> int:
        """Write a text; returns its length, as streams do.

        Raises:
            MadrobError: it cannot be written.
            BrokenPipeError: nobody reads it any more.
        """
        with _told(self.raw_stream):
            self.raw_stream.write("\n".join(map(terminal_safe, text.split("\n"))))
        return len(text)

    def flush(self) -> None:
        """Bring it to whoever reads it.

        Raises:
            MadrobError: it cannot be written.
            BrokenPipeError: nobody reads it any more.
        """
        with _told(self.raw_stream):
            self.raw_stream.flush()

    def __getattr__(self, name: str) -> object:
        return getattr(self.raw_stream, name)


@contextmanager
def safe_output() -> Iterator[None]:
    """While inside, standard output and error output are safe."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _safe(sys.stdout), _safe(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def put_bytes(data: bytes) -> None:
    """Write data for a program to the standard output, as they are.

    Raises:
        MadrobError: they cannot be written.
        BrokenPipeError: nobody reads them any more.
    """
    with _told(sys.stdout):
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()


def forget(stream: TextIO) -> None:
    """What has not been written yet never is; Python would complain of it at its end."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


@contextmanager
def _told(stream: TextIO) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        forget(stream)
        raise MadrobError(
            f"the output cannot be written ({error.strerror}): choose another place for it"
        ) from None


def raw(stream: TextIO) -> TextIO:
    """The stream behind a safe one, for what draws on a terminal itself."""
    return stream.raw_stream if isinstance(stream, SafeStream) else stream


def _safe(stream: TextIO | None) -> TextIO:
    """It is None where the program was started without."""
    return cast("TextIO", stream and SafeStream(raw(stream)))


# Ctrl+C: one line, nothing half made, exit code 130.


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


# A bar that tells how far a command is, on a terminal only.


Tell: TypeAlias = Callable[[int, int], None]
"""Is told how many are done, and of how many."""


@contextmanager
def progress(what: str) -> Iterator[Tell]:
    """While inside, a bar below what is printed; nothing where the error output is no terminal.

    Args:
        what: is counted: `runs`.

    Yields:
        What is told how many are done; until it is, and where there is only one, the bar says
        that work goes on.
    """
    if not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    from rich import progress as rich
    from rich.console import Console

    bar = rich.Progress(
        what,
        rich.BarColumn(bar_width=24),
        rich.MofNCompleteColumn(),
        rich.TimeElapsedColumn(),
        "left",
        rich.TimeRemainingColumn(),
        console=Console(file=raw(sys.stderr)),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),
    )
    with bar, safe_output():
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(
            task, completed=done, total=total if total > 1 else None
        )
