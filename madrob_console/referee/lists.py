"""A competition's lists, read safely (protocol section 2).

Commas or semicolons; a first line that begins with `subject` is a header, which may name the
columns in another order, and more of them; empty lines and lines that begin with # are skipped.
A line that cannot be used is named and the rest counts, so that one broken line does not cost a
competition its morning.
"""

from __future__ import annotations

import csv
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

LARGEST_FILE = 1_000_000
"""Bytes; a larger file is rejected."""
MOST_PROBLEMS = 20
"""Problems that are listed one by one; further ones are counted."""

_LINE_END = re.compile(r"\r\n|\r|\n")
_SUBJECT = re.compile(r"0*([1-9][0-9]{0,2})")
_FOREIGN = re.compile("[\udc80-\udcff]")  # bytes that are no UTF-8, as surrogateescape has them
_QUOTED = re.compile(r'"[^"]*"?')
_SHOWN = 20


class ListReader(ABC):
    """Reads a list line by line.

    Attributes:
        problems: a line for each rejected entry, which `unread` counts.
        remarks: a line for each odd entry that counts.
        unusable: the first problem of each subject; 0 = the subject cannot be read.
    """

    columns: ClassVar[tuple[str, ...]]
    """The first is the subject; every line needs a value in the second, too."""

    def __init__(self, path: Path, name: str, remedy: str) -> None:
        self.problems: list[str] = []
        self.remarks: list[str] = []
        self.unusable: dict[int, str] = {}
        self.unread = 0
        self._subject = 0
        self._path, self._name, self._remedy = path, name, remedy
        self._delimiter = ""
        self._columns: Sequence[str] = self.columns

    @abstractmethod
    def take_entry(self, number: int, subject: int, entry: Mapping[str, str]) -> Iterator[str]:
        """Takes a line, its values by column; yields what looks wrong, MadrobError rejects it."""

    def read(self) -> None:
        """Takes all lines; MadrobError where the file is missing, too large or no text."""
        file = terminal_safe(self._path.name)
        for number, text in enumerate(_LINE_END.split(self._text()), start=1):
            self._subject = 0
            try:
                for remark in self._line(number, text.strip()):
                    self.remarks.append(f"{file} line {number}: {remark}")
            except MadrobError as error:
                self.unread += 1
                self.problems.append(f"{file} line {number}: {error}")
                self.unusable.setdefault(self._subject, self.problems[-1])

    def _line(self, number: int, text: str) -> Iterator[str]:
        if not text or text.startswith("#"):
            return
        if _FOREIGN.search(text):
            raise MadrobError("not in UTF-8; save the file as CSV in UTF-8")
        if not self._delimiter:
            self._delimiter = _delimiter(text)
            header = [value.casefold() for value in _fields(text, self._delimiter)]
            if header[0].startswith("subject"):
                named = [next(filter(value.startswith, self.columns), "") for value in header]
                if self.columns[1] in named:
                    self._columns = named
                return
        values = _fields(text, self._delimiter)
        subject = self._subject = subject_number(values[0])
        if len(values) > len(self._columns):
            columns = ", ".join(filter(None, self._columns))
            raise MadrobError(f"{len(values)} values, use {columns}; quote one with a separator")
        entry = dict(zip(self._columns, values, strict=False))
        if not entry.get(self.columns[1]):
            raise MadrobError(f"subject {subject} has no {self.columns[1]}: add it")
        yield from self.take_entry(number, subject, entry)

    def _text(self) -> str:
        """The file's text; single bytes that are no UTF-8 become surrogates."""
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
    """Parses a team's number; MadrobError for anything else."""
    match = _SUBJECT.fullmatch(value)
    if match is None:
        raise MadrobError(f"subject {quoted(value)} is no number from 1 to 999: write one")
    return int(match[1])


def quoted(text: str) -> str:
    safe = terminal_safe(text)
    return repr(safe if len(safe) <= _SHOWN else safe[: _SHOWN - 3] + "...")


def first_problems(problems: list[str]) -> tuple[str, ...]:
    more = len(problems) - MOST_PROBLEMS
    if more <= 0:
        return tuple(problems)
    return (*problems[:MOST_PROBLEMS], f"and {more} more such lines")


def _bytes(path: Path) -> bytes:
    """At most one byte more than allowed; a pipe or a device could block and is not opened."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(0, "no file")
    with path.open("rb") as file:
        return file.read(LARGEST_FILE + 1)


def _delimiter(text: str) -> str:
    return next((char for char in _QUOTED.sub("", text) if char in ",;"), ",")


def _fields(text: str, delimiter: str) -> list[str]:
    """The values of a line, stripped, without empty ones at its end."""
    # an open quote would swallow the second, empty line
    try:
        rows = list(csv.reader((text, ""), delimiter=delimiter, skipinitialspace=True))
    except csv.Error as error:
        raise MadrobError(f"{error}: shorten it") from None
    if len(rows) != 2:
        raise MadrobError('a quote (") is not closed: close it')
    values = [value.strip() for value in rows[0]]
    while len(values) > 1 and not values[-1]:
        values.pop()
    return values
