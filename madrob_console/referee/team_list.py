"""The list of teams: which name a subject number has (protocol section 2).

It comes from the settings and from a file, a line `subject,team` each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import LONGEST_NAME, clean_name, terminal_safe
from madrob_console.referee.lists import ListReader, first_problems, quoted

if TYPE_CHECKING:
    from madrob_console.referee.run_setup import RunSetup


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
