"""Lists that people keep in a csv file: an entry a line.

Commas or semicolons; a first line that begins with `subject` is a header; empty lines and lines
that begin with # say nothing. What cannot be used is named and the rest counts, so that one broken
line does not cost a competition its morning.
"""

from __future__ import annotations

import csv
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe

LARGEST_FILE = 1_000_000
"""Bytes in such a file; what is larger is something else."""
MOST_PROBLEMS = 20
"""Problems that are told one by one; the others are counted."""

_LINE_END = re.compile(r"\r\n|\r|\n")
_SUBJECT = re.compile(r"0*([1-9][0-9]{0,2})")
_FOREIGN = re.compile("[\udc80-\udcff]")  # bytes that are no UTF-8, as surrogateescape has them
_QUOTED = re.compile(r'"[^"]*"?')
_SHOWN = 20


class ListReader(ABC):
    """Takes line after line of a list.

    Args:
        path: of the file.
        name: what it is: `teams file`.
        remedy: what to do if it cannot be read: `correct teams_file of [competition]`.

    Attributes:
        problems: what was not taken or looks wrong, a line each.
        unread: how many lines were not taken.
    """

    def __init__(self, path: Path, name: str, remedy: str) -> None:
        self.problems: list[str] = []
        self.unread = 0
        self._path, self._name, self._remedy = path, name, remedy
        self._delimiter = ""

    @abstractmethod
    def take(self, number: int, values: list[str]) -> Iterator[str]:
        """Take an entry; says what looks wrong with it.

        Args:
            number: of its line, from 1.
            values: at least one.

        Raises:
            MadrobError: it cannot be taken.
        """

    def read(self) -> None:
        """Take all lines.

        Raises:
            MadrobError: the file is not there, is no file of text, or is too large.
        """
        file = terminal_safe(self._path.name)
        for number, text in enumerate(_LINE_END.split(self._text()), start=1):
            try:
                for problem in self._line(number, text.strip()):
                    self.problems.append(f"{file} line {number}: {problem}")
            except (MadrobError, csv.Error) as error:
                self.unread += 1
                self.problems.append(f"{file} line {number}: {error}")

    def _line(self, number: int, text: str) -> Iterator[str]:
        if not text or text.startswith("#"):
            return
        if _FOREIGN.search(text):
            raise MadrobError("not in UTF-8; save the file as CSV in UTF-8")
        if not self._delimiter:
            self._delimiter = _delimiter(text)
            if _fields(text, self._delimiter)[0].casefold().startswith("subject"):
                return
        yield from self.take(number, _fields(text, self._delimiter))

    def _text(self) -> str:
        """What the file says; single bytes that are no UTF-8 become surrogates."""
        try:
            data = _bytes(self._path)
            problem = (
                "" if len(data) <= LARGEST_FILE else f"over {LARGEST_FILE // 10**6} MB, no list"
            )
        except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
            problem = f"cannot be read ({error.strerror if isinstance(error, OSError) else error})"
        if not problem:
            text = data.decode("utf-8-sig", errors="surrogateescape")
            if b"\0" not in data or not _FOREIGN.search(text):
                return text
            problem = "no text; save it as CSV in UTF-8"
        where = terminal_safe(str(self._path))
        raise MadrobError(f"{self._name} {where}: {problem}; {self._remedy}")


def subject_number(value: str) -> int:
    """The number of a team.

    Raises:
        MadrobError: it is none.
    """
    found = _SUBJECT.fullmatch(value)
    if found is None:
        raise MadrobError(f"subject {quoted(value)} is no number from 1 to 999")
    return int(found[1])


def quoted(text: str) -> str:
    """Some of a text, in quotes."""
    safe = terminal_safe(text)
    return repr(safe if len(safe) <= _SHOWN else safe[: _SHOWN - 3] + "...")


def told(problems: list[str]) -> tuple[str, ...]:
    """The first of many problems, and how many more there are."""
    more = len(problems) - MOST_PROBLEMS
    if more <= 0:
        return tuple(problems)
    return (*problems[:MOST_PROBLEMS], f"and {more} more such lines")


def _bytes(path: Path) -> bytes:
    """The file, or one byte more than it may have.

    A pipe or a device is not opened: that may wait for ever.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(0, "no file")
    with path.open("rb") as file:
        return file.read(LARGEST_FILE + 1)


def _delimiter(text: str) -> str:
    """What separates the values of a file: the first of its characters that may."""
    return next((char for char in _QUOTED.sub("", text) if char in ",;"), ",")


def _fields(text: str, delimiter: str) -> list[str]:
    """The values of a line, without blanks around them and without empty ones at its end.

    Raises:
        MadrobError: a quote is not closed.
        csv.Error: a value is absurdly long.
    """
    # an open quote would swallow the second, empty line
    rows = list(csv.reader((text, ""), delimiter=delimiter, skipinitialspace=True))
    if len(rows) != 2:
        raise MadrobError('a quote (") is not closed')
    values = [value.strip() for value in rows[0]]
    while len(values) > 1 and not values[-1]:
        values.pop()
    return values
