"""The list of teams: which name a subject number has (protocol section 2).

It comes from the settings and from a file, a line `subject,team` each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from madrob_console.errors import MadrobError
from madrob_console.names import LONGEST_NAME, clean_name, terminal_safe
from madrob_console.referee.list_file import ListReader, quoted, subject_number, told

if TYPE_CHECKING:
    from madrob_console.referee.run_setup import RunSetup

CORRECT_SETTINGS = "correct teams_file of [competition]"
"""What to do about a teams file that cannot be read, where the settings name it."""


@dataclass(frozen=True, slots=True)
class TeamList:
    """The teams by subject number; without a name in it there is no list, and names are free.

    Attributes:
        names: subject -> team; clean names.
        problems: what was not taken or looks wrong, a line each.
        file: where it is read from, for people; empty = no file.
        unread: lines of the file that could not be used.
    """

    names: Mapping[int, str] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    file: str = ""
    unread: int = 0

    def differs(self, subject: int, name: str) -> bool:
        """Whether a name is another one than the list has; never where there is no list."""
        return bool(self.names) and name != self.names.get(subject, "")

    def lacks(self, subject: int) -> bool:
        """Whether a subject is not in the list; never where there is no list."""
        return bool(self.names) and subject not in self.names

    def problem(self, setup: RunSetup) -> str | None:
        """Why a run cannot be set up for a team of this name; None when it can."""
        if setup.team_reason.strip() or not self.differs(setup.subject, setup.team):
            return None
        known = self.names.get(setup.subject)
        if known is None:
            return f"subject {setup.subject} is not in the list of teams: a name needs a reason"
        return (
            f"subject {setup.subject} is {quoted(known)} in the list of teams: another name needs"
            " a reason"
        )


NO_TEAMS = TeamList()
"""No list: names are free."""


class TeamName(NamedTuple):
    """What a team is called, whatever its runs say.

    Attributes:
        name: empty = it has none.
        others: the other names that runs of it carry, each once, the oldest first.
    """

    name: str
    others: tuple[str, ...] = ()

    @classmethod
    def of(cls, listed: str, used: Iterable[str]) -> TeamName:
        """The name of a team.

        Args:
            listed: what the list says; empty = nothing: then the last name that was used counts.
            used: the names that its runs carry, oldest first.
        """
        newest_first = [name for name in dict.fromkeys(reversed(list(used))) if name]
        name = listed or next(iter(newest_first), "")
        return cls(name, tuple(other for other in reversed(newest_first) if other != name))


@dataclass(frozen=True, slots=True)
class TeamSource:
    """Where the list of teams comes from.

    Attributes:
        names: subject -> team, from the settings; they count, whatever the file says.
        file: the teams file; None = there is none.
        remedy: what to do about a file that cannot be read, for people.
    """

    names: Mapping[int, str]
    file: Path | None = None
    remedy: str = CORRECT_SETTINGS

    @property
    def file_words(self) -> str:
        """The path of the file, for people; empty = there is none."""
        return "" if self.file is None else terminal_safe(str(self.file))

    def read(self, before: TeamList | None = None) -> TeamList:
        """The list as it is now.

        Args:
            before: the list as it was: what cannot be read now stays as it was; None = the file is
                read for the first time.
        """
        if self.file is None:
            return TeamList(self.names)
        kept = before or NO_TEAMS
        try:
            listed = read_teams(self.file, self.remedy)
        except MadrobError as error:
            return self._kept(kept, str(error))
        if kept.names and not listed.names:  # as while it is written
            return self._kept(kept, f"teams file {self.file_words}: it names no team")
        if listed.unread:  # such a line may be that of a team that was known
            listed = TeamList({**kept.names, **listed.names}, listed.problems, "", listed.unread)
        merged = merge_teams(self.names, listed)
        return TeamList(merged.names, merged.problems, self.file_words, merged.unread)

    def _kept(self, before: TeamList, problem: str) -> TeamList:
        stays = "; the list stays as it was" if before.names else ""
        return TeamList(before.names or self.names, (f"{problem}{stays}",), self.file_words)


def read_teams(path: Path, remedy: str = CORRECT_SETTINGS) -> TeamList:
    """Read a teams file.

    Args:
        path: the file.
        remedy: what to do if that is in vain.

    Raises:
        MadrobError: it is not there, is no file of text, or is too large.
    """
    reader = _Reader(path, "teams file", remedy)
    reader.read()
    return TeamList(reader.names, told(reader.problems), unread=reader.unread)


def merge_teams(settings: Mapping[int, str], file: TeamList) -> TeamList:
    """Put the teams of the settings over those of a file, and say where the two differ."""
    differing = [
        f"subject {subject} is {quoted(name)} in the settings and {quoted(file.names[subject])} in"
        " the file: the settings count"
        for subject, name in settings.items()
        if file.names.get(subject, name) != name
    ]
    names = {**file.names, **settings}
    return TeamList(names, (*file.problems, *told(differing)), file.file, file.unread)


class _Reader(ListReader):
    """Takes team after team."""

    def __init__(self, path: Path, name: str, remedy: str) -> None:
        super().__init__(path, name, remedy)
        self.names: dict[int, str] = {}
        self._lines: dict[int, int] = {}
        self._subjects: dict[str, int] = {}

    def take(self, number: int, values: list[str]) -> Iterator[str]:
        """A team; the first of two for one subject counts."""
        subject, name = _entry(values)
        if subject in self.names:
            raise MadrobError(
                f"subject {subject} is {quoted(name)} here and {quoted(self.names[subject])} in"
                f" line {self._lines[subject]}: line {self._lines[subject]} counts"
            )
        known = self._subjects.setdefault(name.casefold(), subject)
        self.names[subject] = name
        self._lines[subject] = number
        if known != subject:
            yield (
                f"{quoted(name)} is subject {subject} here and subject {known} in line"
                f" {self._lines[known]}: both count"
            )
        if changed := _loss(values[1]):
            yield f"{changed}: the team is {quoted(name)}"


def _entry(values: list[str]) -> tuple[int, str]:
    """The subject number and the clean name.

    Raises:
        MadrobError: the values are no such thing.
    """
    subject = subject_number(values[0])
    if len(values) > 2:
        raise MadrobError(
            f"{len(values)} values, use subject and team; put a team with a separator into quotes"
        )
    name = _name(values[1]) if len(values) == 2 else ""
    if not name:
        raise MadrobError(f"subject {subject} has no team")
    return subject, name


def _name(value: str) -> str:
    """A clean name; of one that is too long the beginning, because a team needs a name."""
    try:
        return clean_name(value, "team")
    except MadrobError:
        beginning = terminal_safe(value).strip()[: LONGEST_NAME - 1].rstrip()
        return clean_name(f"{beginning}…", "team")


def _loss(value: str) -> str:
    """What is taken from a name, beyond blanks."""
    if _name(value).endswith("…") and not value.endswith("…"):
        return f"more than {LONGEST_NAME} characters, cut"
    if any(char in value for char in "/\\"):
        return "/ and \\ become blanks"
    if value.startswith("."):
        return "dots at the beginning are left out"
    if len(terminal_safe(value)) != len(value):
        return "characters that cannot be shown are left out"
    return ""
