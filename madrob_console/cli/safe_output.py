"""Nothing that a command says reaches the terminal raw, whoever printed it.

Names, reasons, exceptions and what argparse repeats of the command line may hold escape sequences.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO, cast

from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe


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
