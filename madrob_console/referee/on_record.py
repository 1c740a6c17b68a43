"""What is on record of a run: marks, decisions, faults, and how its result came to be."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from madrob_console.referee.run_setup import RunSetup
from scoring.indicator_table import IndicatorName
from scoring.protocol import EventName
from scoring.rulesets import RulesetName

Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
"""A digest as `sha256sum` prints it."""


class CheckName(StrEnum):
    """The pre-start checks, in the order in which they are listed."""

    TEAM = "team"
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
        withdrawn: why it was taken back; null = it stands.
    """

    time: float
    kind: IncidentKind
    note: str = ""
    withdrawn: str | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """A note of the referee.

    Attributes:
        time: s since the epoch.
        text: as it was written.
    """

    time: float
    text: str


@dataclass(frozen=True, slots=True)
class TestbedFault:
    """Something wrong with the testbed while the run was recorded, in words, with its time."""

    time: float
    text: str


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
    ruleset: RulesetName | None = None


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
        """How much it was."""
        return f"{self.files} file{'' if self.files == 1 else 's'}, {self.bytes / 1e6:.1f} MB"


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
