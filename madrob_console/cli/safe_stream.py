"""Makes output safe: no escape sequence reaches the terminal.

Names, reasons, exceptions and the arguments that argparse repeats may hold some.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TextIO, cast

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe


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
