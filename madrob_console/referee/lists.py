"""A competition's lists: reading them safely, and the teams (protocol section 2).

Commas or semicolons; a first line that begins with `subject` is a header, which may name the
columns in another order, and more of them; empty lines and lines that begin with # say nothing.
What cannot be used is named and the rest counts, so that one broken line does not cost a
competition its morning.
"""

from __future__ import annotations

import csv
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import LONGEST_NAME, clean_name, terminal_safe

if TYPE_CHECKING:
    from madrob_console.referee.records import RunSetup

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


# The list of teams: which name a subject number has (protocol section 2).
#
# It comes from the settings and from a file, a line `subject,team` each.


CORRECT_SETTINGS = "correct teams_file of [competition]"


@dataclass(frozen=True, slots=True)
class TeamList:
    """The teams by subject number; without names there is no list, and names are free.

    `problems` name what cannot be used, `remarks` what is odd and counts.
    """

    names: Mapping[int, str] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    file: str = ""
    unread: int = 0
    remarks: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self.problems, *self.remarks)

    def differs(self, subject: int, name: str) -> bool:
        """Whether the list has another name for the subject; never without a list."""
        return bool(self.names) and name != self.names.get(subject, "")

    def lacks(self, subject: int) -> bool:
        """Whether the list has no such subject; never without a list."""
        return bool(self.names) and subject not in self.names

    def problem(self, setup: RunSetup) -> str | None:
        if setup.team_reason.strip() or not self.differs(setup.subject, setup.team):
            return None
        listed = self.names.get(setup.subject)
        if listed is None:
            return f"subject {setup.subject} is not in the list of teams: a name needs a reason"
        return (
            f"subject {setup.subject} is {quoted(listed)} in the list of teams: another name needs"
            " a reason"
        )


NO_TEAMS = TeamList()


class TeamName(NamedTuple):
    """A team's name (empty = unknown), and other names in its runs, the oldest first."""

    name: str
    others: tuple[str, ...] = ()

    @classmethod
    def of(cls, listed: str, used: Iterable[str]) -> TeamName:
        """The listed name, else the last of `used`, the names in its runs, oldest first."""
        newest_first = [name for name in dict.fromkeys(reversed(list(used))) if name]
        name = listed or next(iter(newest_first), "")
        return cls(name, tuple(other for other in reversed(newest_first) if other != name))


@dataclass(frozen=True, slots=True)
class TeamSource:
    """The sources of the list of teams: settings, which take precedence, and a file."""

    names: Mapping[int, str]
    file: Path | None = None
    remedy: str = CORRECT_SETTINGS

    @property
    def file_words(self) -> str:
        return "" if self.file is None else terminal_safe(str(self.file))

    def read(self, before: TeamList | None = None) -> TeamList:
        """The list now; what cannot be read stays as it was `before`."""
        if self.file is None:
            return TeamList(self.names)
        last = before or NO_TEAMS
        try:
            listed = read_teams(self.file, self.remedy)
        except MadrobError as error:
            return self._as_before(last, str(error))
        if last.names and not listed.names:  # as while it is written
            return self._as_before(last, f"teams file {self.file_words}: it names no team")
        if listed.unread:  # such a line may be that of a team that was known
            listed = replace(listed, names={**last.names, **listed.names})
        return replace(merge_teams(self.names, listed), file=self.file_words)

    def _as_before(self, before: TeamList, problem: str) -> TeamList:
        stays = "; the list stays as it was" if before.names else ""
        return TeamList(before.names or self.names, (f"{problem}{stays}",), self.file_words)


def read_teams(path: Path, remedy: str = CORRECT_SETTINGS) -> TeamList:
    """Reads a teams file; MadrobError, with the `remedy`, where that fails."""
    reader = _Reader(path, "teams file", remedy)
    reader.read()
    problems, remarks = first_problems(reader.problems), first_problems(reader.remarks)
    return TeamList(reader.names, problems, unread=reader.unread, remarks=remarks)


def merge_teams(settings: Mapping[int, str], file: TeamList) -> TeamList:
    """Puts the teams of the settings over those of a file, and reports where the two differ."""
    differing = [
        f"subject {subject} is {quoted(name)} in the settings and {quoted(file.names[subject])} in"
        " the file: the settings count"
        for subject, name in settings.items()
        if file.names.get(subject, name) != name
    ]
    names = {**file.names, **settings}
    return replace(file, names=names, remarks=(*file.remarks, *first_problems(differing)))


class _Reader(ListReader):
    columns = ("subject", "team")

    def __init__(self, path: Path, name: str, remedy: str) -> None:
        super().__init__(path, name, remedy)
        self.names: dict[int, str] = {}
        self._lines: dict[int, int] = {}
        self._subjects: dict[str, int] = {}

    def take_entry(self, number: int, subject: int, entry: Mapping[str, str]) -> Iterator[str]:
        """Takes a team; the first of two for one subject counts."""
        name = _name(entry["team"])
        if not name:
            raise MadrobError(f"subject {subject} has no team: add it")
        if subject in self.names:
            raise MadrobError(
                f"subject {subject} is {quoted(name)} here, {quoted(self.names[subject])} in"
                f" line {self._lines[subject]}, which counts: cut one"
            )
        first = self._subjects.setdefault(name.casefold(), subject)
        self.names[subject] = name
        self._lines[subject] = number
        if first != subject:
            yield (
                f"{quoted(name)} is subject {subject} here and {first} in line"
                f" {self._lines[first]}, both count: correct one"
            )
        if changed := _loss(entry["team"]):
            yield f"{changed}: the team is {quoted(name)}"


def _name(value: str) -> str:
    try:
        return clean_name(value, "team")
    except MadrobError:
        beginning = terminal_safe(value).strip()[: LONGEST_NAME - 1].rstrip()
        return clean_name(f"{beginning}…", "team")


def _loss(value: str) -> str:
    if _name(value).endswith("…") and not value.endswith("…"):
        return f"more than {LONGEST_NAME} characters, cut"
    if any(char in value for char in "/\\"):
        return "/ and \\ become blanks"
    if value.startswith("."):
        return "dots at the beginning are left out"
    if len(terminal_safe(value)) != len(value):
        return "characters that cannot be shown are left out"
    return ""
