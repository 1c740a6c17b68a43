"""What is on record of a run: set-up, identity, marks, decisions, faults, protests."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated
from uuid import UUID

from msgspec import Meta

from madrob_console.common.formatting import counted, listed, relative_text
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, EventName, LockDetection, Signal, StartPose
from scoring.rulesets import RulesetName

# What a run is called among all runs of all testbeds (protocol section 2).


Randomness = Callable[[int], bytes]

_MILLISECOND = 1_000_000  # ns


def new_run_id(now_ns: int, random: Randomness) -> str:
    """The identity of a new run: a UUID of version 7 (RFC 9562), sorted by time."""
    time = (now_ns // _MILLISECOND) % 2**48
    chance = int.from_bytes(random(10), "big") % 2**74
    number = time << 80 | 7 << 76 | (chance >> 62) << 64 | 0b10 << 62 | chance % 2**62
    return str(UUID(int=number))


# What is set for a run before its start (protocol section 2).


_OF_SETTINGS = {
    "timeout": "timeout",
    "countdown": "countdown",
    "ruleset": "ruleset",
    "lock_detection": "lock by",
    "start_pose": "start pose",
}
"""What the settings say of every set-up, in words."""


def _setting(value: float | StrEnum | StartPose) -> str:
    match value:
        case StartPose(x, y, yaw):
            return f"{x:g} {y:g} {yaw:g}"
        case float():
            return f"{value:g} s"
    return str(value)


StoredRuleset = Annotated[str, Meta(pattern="^[a-z0-9-]{1,40}$(?!\n)")]
"""A name of rules, maybe of such as have gone."""


@dataclass(frozen=True, slots=True)
class RunSetup:
    """Everything set for a run before its start.

    Attributes:
        subject: the robot's number, 1 to 999.
        team: the team's name, cleaned.
        run_number: the repetition, 1 to 999.
        condition: what the robot has to do.
        start_pose: where the robot stands; on the starting side.
        referee: the referee's name, cleaned.
        timeout: s from the start.
        countdown: s before the start; the recording needs at least 1 s.
        ruleset: which rules make the indicators; of a stored run maybe one that has gone.
        lock_detection: what decides step 6 (protocol section 7).
        team_reason: why the team has another name than in the list of teams; empty = it has not.
        practice: it counts for nothing and stands apart from official runs (protocol section 2).
        out_of_plan: it was set up beyond the competition's plan.
        run_id: which run of all testbeds it is, a UUID. Set-ups that differ in nothing but
            this, `testbed` and `competition` are equal.
        testbed: the name of the testbed; likewise.
        competition: the name of the competition; likewise.
    """

    subject: int
    team: str
    run_number: int
    condition: Condition
    start_pose: StartPose
    referee: str
    timeout: float
    countdown: float
    ruleset: StoredRuleset
    lock_detection: LockDetection
    team_reason: str = ""
    practice: bool = False
    out_of_plan: bool = False
    run_id: str = field(default="", compare=False)
    testbed: str = field(default="", compare=False)
    competition: str = field(default="", compare=False)

    def differences(self, usual: RunSetup) -> Iterator[str]:
        """What differs from `usual`, a set-up as the settings have it."""
        for name, words in _OF_SETTINGS.items():
            here, there = getattr(self, name), getattr(usual, name)
            if here != there:
                yield f"{words} {_setting(here)}, the settings say {_setting(there)}"

    def problem(self) -> str | None:
        """Why a run cannot be set up like this, naming the field; None when it can."""
        if not 1 <= self.subject <= 999:
            return f"subject {self.subject}: use a number from 1 to 999"
        if not 1 <= self.run_number <= 999:
            return f"run number {self.run_number}: use a number from 1 to 999"
        pose = self.start_pose
        if not all(math.isfinite(value) for value in (pose.x, pose.y, pose.yaw)):
            return "start pose: x, y and yaw must be numbers"
        side = pose.side
        if side is not self.condition.starting_side:
            where = "on the threshold" if side is None else f"on the {side.upper()} side"
            wanted = self.condition.starting_side
            sign = "x > 0" if wanted.sign > 0 else "x < 0"
            return f"start pose lies {where}: it must lie on the {wanted.upper()} side ({sign})"
        if not 1.0 <= self.timeout <= 86400.0:
            return f"timeout {self.timeout:g} s: use 1 to 86400 s"
        if not 0.0 <= self.countdown <= 600.0:
            return f"countdown {self.countdown:g} s: use 0 to 600 s"
        if self.ruleset not in [*RulesetName]:
            return f"ruleset {self.ruleset}: use {' or '.join(RulesetName)}"
        return None


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
    EVIDENCE = "evidence"
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
    """Kinds of faults of a testbed; other versions may have noted unknown ones."""

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
    EVIDENCE = "evidence that is lost"
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
class RemovedEvidence:
    """Evidence of the run that was removed to make room; no score hangs on it.

    Attributes:
        time: s since the epoch.
        files: how many.
        bytes: their size.
    """

    time: float
    files: int
    bytes: int

    @property
    def words(self) -> str:
        return f"{counted(self.files, 'file')}, {self.bytes / 1e6:.1f} MB"


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


# One cause, one line.


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


# Protests of a team against a result: open until they are decided or withdrawn (section 2).


class ProtestEnd(StrEnum):
    """How a protest ends."""

    UPHELD = "upheld"
    PARTLY = "partly upheld"
    REJECTED = "rejected"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True, slots=True)
class ProtestAnswer:
    """What closed a protest.

    Attributes:
        time: s since the epoch.
        end: how it ended.
        reason: the referee's words; of a withdrawal the team's.
        referee: who decided, or heard of the withdrawal.
    """

    time: float
    end: ProtestEnd
    reason: str
    referee: str


@dataclass(frozen=True, slots=True)
class Protest:
    """A team protests against a result.

    Attributes:
        number: of the run's protests, from 1.
        time: when it was filed, s since the epoch.
        team: who protests.
        text: what the team says.
        about: what it is about: a step, an indicator, a time, or the whole run.
        at: the instant in question, s since the epoch; null = none was named.
        referee: who took it.
        answer: what closed it; null = it is open.
    """

    number: int
    time: float
    team: str
    text: str
    about: str
    at: float | None
    referee: str
    answer: ProtestAnswer | None = None

    @property
    def open(self) -> bool:
        return self.answer is None

    def about_words(self, start: float | None) -> str:
        """Subject and instant: `step 4, 12.500 s from the start`; `start` in s since the epoch."""
        if self.at is None or start is None:
            return self.about
        instant = f"{relative_text(self.at, start)} s"
        named = "" if self.about == instant else f"{self.about}, "
        return f"{named}{instant} from the start"

    @property
    def title(self) -> str:
        return f"protest {self.number} ({self.about})"


def open_protests(protests: Iterable[Protest]) -> tuple[Protest, ...]:
    """Those that wait for a decision, the first filed at the beginning."""
    return tuple(protest for protest in protests if protest.open)
