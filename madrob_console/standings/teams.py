"""The teams file: which team a subject number belongs to.

A line `subject,team` each, with commas or semicolons. A first line that begins with `subject` is
a header; empty lines and lines that begin with # say nothing. What cannot be used is named and
the rest counts, so that one broken line does not cost a competition its morning.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from madrob_console.errors import MadrobError
from madrob_console.names import clean_name, terminal_safe

LARGEST_FILE = 1_000_000
"""Bytes in a teams file; what is larger is something else."""
MOST_PROBLEMS = 20
"""Problems that are told one by one; the others are counted."""

_LINE_END = re.compile(r"\r\n|\r|\n")
_SUBJECT = re.compile(r"0*([1-9][0-9]{0,2})")
_FOREIGN = re.compile("[\udc80-\udcff]")  # bytes that are no UTF-8, as surrogateescape has them
_QUOTED = re.compile(r'"[^"]*"?')
_SHOWN = 20


@dataclass(frozen=True, slots=True)
class TeamList:
    """The teams by subject number.

    Attributes:
        names: subject -> team; clean names.
        problems: what was not taken or looks wrong, a line each.
    """

    names: Mapping[int, str]
    problems: tuple[str, ...] = ()


def read_teams(path: Path) -> TeamList:
    """Read a teams file.

    Raises:
        MadrobError: it is not there, is no file of text, or is too large.
    """
    reader = _Reader(terminal_safe(path.name))
    for number, text in enumerate(_LINE_END.split(_text(path)), start=1):
        reader.take(number, text.strip())
    return TeamList(reader.names, _told(reader.problems))


def merge_teams(settings: Mapping[int, str], file: TeamList) -> TeamList:
    """Put the teams of the settings over those of a file, and say where the two differ."""
    differing = [
        f"subject {subject} is {_short(name)} in the settings and {_short(file.names[subject])} in"
        " the file: the settings count"
        for subject, name in settings.items()
        if file.names.get(subject, name) != name
    ]
    return TeamList({**file.names, **settings}, (*file.problems, *_told(differing)))


class _Reader:
    """Takes line after line."""

    def __init__(self, file: str) -> None:
        self.names: dict[int, str] = {}
        self.problems: list[str] = []
        self._file = file
        self._lines: dict[int, int] = {}
        self._subjects: dict[str, int] = {}
        self._delimiter = ""

    def take(self, number: int, text: str) -> None:
        """Read a line; what is wrong with it is written down."""
        if not text or text.startswith("#"):
            return
        try:
            self._take(number, text)
        except (MadrobError, csv.Error) as error:
            self._tell(number, str(error))

    def _take(self, number: int, text: str) -> None:
        if _FOREIGN.search(text):
            raise MadrobError("not in UTF-8; save the file as CSV in UTF-8")
        if not self._delimiter:
            self._delimiter = _delimiter(text)
            if _fields(text, self._delimiter)[0].casefold().startswith("subject"):
                return
        values = _fields(text, self._delimiter)
        subject, name = _entry(values)
        if subject in self.names:
            raise MadrobError(
                f"subject {subject} is {_short(name)} here and {_short(self.names[subject])} in"
                f" line {self._lines[subject]}: line {self._lines[subject]} counts"
            )
        known = self._subjects.setdefault(name.casefold(), subject)
        if known != subject:
            self._tell(
                number,
                f"{_short(name)} is subject {subject} here and subject {known} in line"
                f" {self._lines[known]}: both count",
            )
        if changed := _loss(values[1]):
            self._tell(number, f"{changed}: the team is {_short(name)}")
        self.names[subject] = name
        self._lines[subject] = number

    def _tell(self, number: int, what: str) -> None:
        self.problems.append(f"{self._file} line {number}: {what}")


def _text(path: Path) -> str:
    """What the file says; single bytes that are no UTF-8 become surrogates.

    Raises:
        MadrobError: it is not there, is no file of text, or is too large.
    """
    try:
        data = _bytes(path)
        problem = "" if len(data) <= LARGEST_FILE else f"over {LARGEST_FILE // 10**6} MB, no list"
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        problem = f"cannot be read ({error.strerror if isinstance(error, OSError) else error})"
    if not problem:
        text = data.decode("utf-8-sig", errors="surrogateescape")
        if b"\0" not in data or not _FOREIGN.search(text):
            return text
        problem = "no text; save it as CSV in UTF-8"
    raise MadrobError(
        f"teams file {terminal_safe(str(path))}: {problem}; correct teams_file of [competition]"
    )


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


def _entry(values: list[str]) -> tuple[int, str]:
    """The subject number and the clean name.

    Raises:
        MadrobError: the values are no such thing.
    """
    found = _SUBJECT.fullmatch(values[0])
    if found is None:
        raise MadrobError(f"subject {_short(values[0])} is no number from 1 to 999")
    if len(values) > 2:
        raise MadrobError(
            f"{len(values)} values, use subject and team; put a team with a separator into quotes"
        )
    name = clean_name(values[1], "team") if len(values) == 2 else ""
    if not name:
        raise MadrobError(f"subject {found[1]} has no team")
    return int(found[1]), name


def _loss(value: str) -> str:
    """What cleaning takes from a name, beyond blanks."""
    if any(char in value for char in "/\\"):
        return "/ and \\ become blanks"
    if value.startswith("."):
        return "dots at the beginning are left out"
    if len(terminal_safe(value)) != len(value):
        return "characters that cannot be shown are left out"
    return ""


def _short(text: str) -> str:
    """Some of a text, in quotes."""
    safe = terminal_safe(text)
    return repr(safe if len(safe) <= _SHOWN else safe[: _SHOWN - 3] + "...")


def _told(problems: list[str]) -> tuple[str, ...]:
    more = len(problems) - MOST_PROBLEMS
    if more <= 0:
        return tuple(problems)
    return (*problems[:MOST_PROBLEMS], f"and {more} more such lines")
