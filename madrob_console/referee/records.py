"""What is on record of a run: identity, marks, decisions, faults."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from madrob_console.common.formatting import listed
from madrob_console.referee.run_setup import RunSetup, StoredRuleset
from scoring.indicator_table import IndicatorName
from scoring.protocol import EventName, Signal

Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A SHA-256 checksum as `sha256sum` prints it."""


class CheckName(StrEnum):
    """The pre-start checks, in the order in which they are listed."""

    TEAM = "team"
    PLAN = "plan"
    SETTINGS = "settings"
    TOPICS = "topics"
    DOOR = "door closed"
    HANDLE = "handle at rest"
    HANDLE_ZERO = "handle zero"
    DOORWAY = "doorway clear"
    CLOCK = "clock skew"
    DISK = "disk space"
    RECORDER = "recorder"
    REFEREE = "another referee"
    POSE = "start pose"


class IncidentKind(StrEnum):
    """Things that a referee marks; they change no indicator (section 7)."""

    HUMAN_INTERVENTION = "human intervention"
    COLLISION = "collision"
    FALL = "fall"
    OTHER = "other"


class DecisionKind(StrEnum):
    """What the referee decides of a run and can take back."""

    RULING = "ruling"
    INCIDENT = "incident"
    WAIVER = "waiver"
    VOID = "void"
    CORRECTION = "correction"
    DOUBTS = "accepted doubts"
    PROTEST = "decision on a protest"


class TeamWord(StrEnum):
    """What the team says of a final result."""

    ACKNOWLEDGED = "acknowledged"
    PROTESTED = "protested"
    ABSENT = "absent"

    @property
    def words(self) -> str:
        """In words that follow `final`: `acknowledged by the team`."""
        return "the team was absent" if self is TeamWord.ABSENT else f"{self} by the team"


@dataclass(frozen=True, slots=True)
class Waiver:
    """A failing pre-start check that the referee let pass for this run.

    Attributes:
        check: which.
        reason: why.
        referee: the referee's name.
        time: s since the epoch.
    """

    check: CheckName
    reason: str
    referee: str
    time: float


@dataclass(frozen=True, slots=True)
class FalseStart:
    """Touch, opening or approach during the countdown (protocol section 7).

    Attributes:
        time: s since the epoch.
        event: what happened.
        accepted: the referee's reason for letting it pass; null = not decided.
    """

    time: float
    event: EventName
    accepted: str | None = None


@dataclass(frozen=True, slots=True)
class Incident:
    """A mark of the referee; it changes no indicator (protocol section 7).

    Attributes:
        time: s since the epoch.
        kind: what happened.
        note: of the referee.
    """

    time: float
    kind: IncidentKind
    note: str = ""


@dataclass(frozen=True, slots=True)
class Note:
    """A note of the referee.

    Attributes:
        time: s since the epoch.
        text: as it was written.
    """

    time: float
    text: str


class FaultKind(StrEnum):
    """Kinds of faults of a testbed; later versions may note unknown ones."""

    UNKNOWN = ""
    SOURCE = "its source says so"
    SEVERAL_PUBLISHERS = "several publishers"
    NEVER_SEEN = "nothing received"
    SILENT = "silent"
    SLOW = "too slow"
    FLOOD = "too fast"
    UNREADABLE = "messages that cannot be read"
    NO_READING = "messages without a reading"
    STAMPS = "stamps that are missing, repeat or go back"
    SKEW = "stamps off the time of reception"
    BEHIND = "the engine is behind"
    FLICKERS = "a signal that flickers"
    ANNOUNCEMENT = "a testbed that may be simulated"

    @classmethod
    def _missing_(cls, value: object) -> FaultKind:
        return cls.UNKNOWN


@dataclass(frozen=True, slots=True)
class TestbedFault:
    """Something wrong with the testbed while the run was recorded.

    Attributes:
        time: when it began, s since the epoch.
        text: which topics have it, and what it is.
        kind: two faults of one kind and time are one; the later words count.
    """

    time: float
    text: str
    kind: FaultKind = FaultKind.UNKNOWN


@dataclass(frozen=True, slots=True)
class Closure:
    """How a result was finalised.

    Attributes:
        time: s since the epoch.
        referee: the referee's name.
        team_word: what the team says of the result.
        note: of the team or the referee.
    """

    time: float
    referee: str
    team_word: TeamWord
    note: str = ""


@dataclass(frozen=True, slots=True)
class Voiding:
    """The referee says that a valid run counts nowhere (protocol section 2).

    Attributes:
        time: s since the epoch.
        reason: why.
        referee: the referee's name.
    """

    time: float
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class Correction:
    """What was set up wrongly was put right after the stop (protocol section 2).

    Attributes:
        time: s since the epoch.
        reason: why.
        referee: the referee's name.
        words: what was corrected.
        before: what was set until then; the folder is named after the first.
    """

    time: float
    reason: str
    referee: str
    words: str
    before: RunSetup


@dataclass(frozen=True, slots=True)
class AcceptedDoubts:
    """What is doubted of a result, and the referee lets stand (protocol section 11).

    Attributes:
        time: s since the epoch.
        reason: why.
        referee: the referee's name.
        doubts: the sentences, by indicator; others that come with a later issue are not among them.
    """

    time: float
    reason: str
    referee: str
    doubts: dict[IndicatorName, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class TakenBack:
    """A decision that the referee took back: it counts no more and stays on record.

    Attributes:
        time: s since the epoch.
        kind: what it was.
        made: when it was made, s since the epoch.
        words: what it said.
        reason: why it was taken back.
        referee: the referee's name.
    """

    time: float
    kind: DecisionKind
    made: float
    words: str
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class Reissuing:
    """Why a result was issued again; the issue before stays (protocol section 2).

    Attributes:
        time: s since the epoch.
        issue: number of the issue that came of it.
        what: which act did it, or the rule change, in the journal's word.
        reason: why, in the words of who did it; of a protest, what the team says.
        referee: the referee's name; empty where none is known.
        ruleset: by which rules the result is made from then on; null = as before.
    """

    time: float
    issue: int
    what: str
    reason: str
    referee: str
    ruleset: StoredRuleset | None = None


@dataclass(frozen=True, slots=True)
class JournalMark:
    """The lines of a run's journal that its result depends on.

    Those are its acts and changes; not events, which the recording has, not what was withdrawn, and
    not what was said beside a final result.

    Attributes:
        lines: how many there are.
        sha256: of them one after the other, each with its line end.
    """

    lines: int
    sha256: Sha256


_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_NEEDED = frozenset(signal.value for signal in Signal if not signal.optional)

SILENT = "silent"
"""Begins the words on a topic from which nothing comes."""


def cause_of(words: str) -> str:
    """Equal for words that differ in nothing but numbers."""
    return _NUMBER.sub("", words)


def numbers_in(words: str) -> tuple[float, ...]:
    return tuple(map(float, _NUMBER.findall(words)))


def merged(remarks: Iterable[tuple[str, str]]) -> list[str]:
    """A line for each cause, from names of topics, each with words on it.

    Words that differ in nothing but numbers have one cause; the largest numbers are told. So all
    words count what is bad. What is on the same topics stands in one line.
    """
    causes: dict[str, dict[str, str]] = {}
    for name, words in remarks:
        causes.setdefault(cause_of(words), {})[name] = words
    lines: dict[tuple[str, ...], list[str]] = {}
    for of in causes.values():
        lines.setdefault(tuple(of), []).append(max(of.values(), key=numbers_in))
    return [_line(names, "; ".join(words)) for names, words in lines.items()]


def _line(names: Sequence[str], words: str) -> str:
    if not _NEEDED.issubset(names):
        return f"{listed(names)}: {words}"
    topics = f"all {len(names)} topics"
    return f"no testbed: {topics} {words}" if words.startswith(SILENT) else f"{topics}: {words}"
