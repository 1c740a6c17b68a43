"""What libraries write past Python to the terminal, caught."""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from madrob_console.names import terminal_safe

MOST_LINES = 5
"""Different lines that are kept."""

_LARGEST = 1 << 20
_STREAMS = (1, 2)  # standard output and error output
_DATE = re.compile(r"^[0-9-]{10} [0-9:.]+ ")
_PLACE = re.compile(r" -> Function \w+$")


@contextmanager
def overheard() -> Iterator[list[str]]:
    """While inside, nothing of it reaches the terminal.

    Yields:
        A list that has the lines afterwards, each once, without their times: what a library says
        ten times a second is one line. Empty where nothing can be caught.
    """
    lines: list[str] = []
    try:
        file = os.fdopen(os.memfd_create("overheard"), "w+b")
    except OSError:
        yield lines
        return
    with file:
        kept = _redirected(file)
        try:
            yield lines
        finally:
            _flush()
            for stream, copy in kept.items():
                os.dup2(copy, stream)
                os.close(copy)
        file.seek(0)
        said = file.read(_LARGEST).decode(errors="replace").splitlines()
        lines += [line for line in dict.fromkeys(map(_plain, said)) if line][:MOST_LINES]


def _redirected(file: BinaryIO) -> dict[int, int]:
    """Let the streams end in a file; copies of what they were."""
    _flush()
    kept: dict[int, int] = {}
    for stream in _STREAMS:
        try:
            kept[stream] = os.dup(stream)
        except OSError:  # closed, or no file handles
            continue
        os.dup2(file.fileno(), stream)
    return kept


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    ctypes.CDLL(None).fflush(None)  # and what C has not written yet


def _plain(line: str) -> str:
    return _PLACE.sub("", _DATE.sub("", terminal_safe(line))).strip()
