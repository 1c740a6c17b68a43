"""What commands print and ask: problems, progress, questions, Ctrl+C, safe text."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Self, TextIO, TypeAlias, TypeVar, cast

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

_Item = TypeVar("_Item")

BAD_INPUT = 2
"""Exit code of bad input and of refusals; also argparse's."""

MOST_ALIKE = 3
"""Problems of one kind that are printed one by one; the others are counted."""


class StoppedError(MadrobError):
    """A signal stopped the command before anything was begun; `exit_code` is that of shells."""

    def __init__(self, what: str, number: int) -> None:
        super().__init__(what)
        self.exit_code = 128 + number


def complain(problem: object) -> None:
    print(f"madrob: {terminal_safe(str(problem))}", file=sys.stderr, flush=True)


def name_some(notes: Sequence[str], more: str) -> None:
    """Print the first notes; `more` says what the others are, which are counted."""
    for note in notes[:MOST_ALIKE]:
        complain(f"note: {note}")
    if len(notes) > MOST_ALIKE:
        complain(f"note: and {len(notes) - MOST_ALIKE} more {more}")


def name_twins(pairs: Sequence[tuple[str, str]]) -> None:
    notes = [f"{place} is the same run as {other}" for place, other in pairs]
    name_some(notes, "runs that are there twice")


class Complaints:
    """Prints the problems of many things; counts repeated ones and prints the number at the end."""

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

    def add_complaint(self, problem: object, of: object) -> None:
        """Print a problem, as `complain` does; `of` is the thing as the problem names it."""
        self.count += 1
        words = str(problem).replace(str(of), "").strip(": ")
        self._alike[words] += 1
        if self._alike[words] <= MOST_ALIKE:
            complain(problem)

    @contextmanager
    def complaining(self, of: object) -> Iterator[None]:
        """Print the MadrobError of the block, and go on."""
        try:
            yield
        except MadrobError as error:
            self.add_complaint(error, of)

    def add_each(self, problems: Iterable[tuple[str, str]]) -> None:
        for of, problem in problems:
            self.add_complaint(f"{of}: {problem}", of)


# Questions to the person at the terminal.


def somebody_there() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def says_yes(question: str) -> bool:
    if not somebody_there():
        return False
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False


# Output made safe: no escape sequence reaches the terminal.
#
# Names, reasons, exceptions and the arguments that argparse repeats may hold some.


class SafeStream:
    """A text stream that removes what a terminal would obey, except line breaks.

    Bytes written to its `buffer` are data for a program and stay as they are. `raw_stream` is the
    original stream, for code that draws on a terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self.raw_stream = stream

    def write(self, text: str) -> int:
        """Write a text; returns its length, as streams do.

        Raises:
            BrokenPipeError: the reader has gone.
        """
        with _one_line_of_failure(self.raw_stream):
            self.raw_stream.write("\n".join(map(terminal_safe, text.split("\n"))))
        return len(text)

    def flush(self) -> None:
        with _one_line_of_failure(self.raw_stream):
            self.raw_stream.flush()

    def __getattr__(self, name: str) -> object:
        return getattr(self.raw_stream, name)


@contextmanager
def safe_output() -> Iterator[None]:
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _safe(sys.stdout), _safe(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def put_bytes(data: bytes) -> None:
    """Write data for a program to the standard output, unchanged; raises as `SafeStream.write`."""
    with _one_line_of_failure(sys.stdout):
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()


def print_json(document: Mapping[str, object]) -> None:
    """Print a document for programs, in ASCII, with the version of the software that made it."""
    import json

    from madrob_console.common.version import software_version

    print(json.dumps({"software": software_version(), **document}, indent=2))


def forget(stream: TextIO) -> None:
    """Discard what is not written yet; Python would complain of it when it exits."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


@contextmanager
def _one_line_of_failure(stream: TextIO) -> Iterator[None]:
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
    return stream.raw_stream if isinstance(stream, SafeStream) else stream


def _safe(stream: TextIO | None) -> TextIO:
    """Wrap a stream, which is None where the program was started without one."""
    return cast("TextIO", stream and SafeStream(raw(stream)))


# Ctrl+C: one line, nothing half made, exit code 130.


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


# A progress bar on a terminal.


Tell: TypeAlias = Callable[[int, int], None]
"""Takes how many are done, and of how many."""


@contextmanager
def progress(what: str) -> Iterator[Tell]:
    """Show a progress bar below the output while inside, if the error output is a terminal.

    `what` names what is counted: `runs`. Until the first count, and where there is only one, the
    bar shows that work goes on.
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


def counted_off(items: Sequence[_Item], what: str) -> Generator[_Item, None, None]:
    """Yield the items one by one, with a progress bar."""
    with progress(what) as tell:
        for number, item in enumerate(items):
            tell(number, len(items))
            yield item
        tell(len(items), len(items))
