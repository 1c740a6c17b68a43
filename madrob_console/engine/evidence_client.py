"""Evidence as the core sees it, and which faults enter the journal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec

from madrob_console.common.formatting import listed
from madrob_console.engine.run_faults import FaultNotes
from madrob_console.engine.snapshot import EvidenceView
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceTopic,
)
from madrob_console.referee.records import FaultKind


@dataclass(frozen=True, slots=True)
class EvidencePlan:
    """Most bytes of evidence in the results folder; what must fit before a start, in s."""

    budget: int
    least_room: float


class EvidencePlace(msgspec.Struct, frozen=True):
    """Where the evidence of a run goes.

    Attributes:
        folder: of the bag.
        steady_ns: steady time now (protocol section 8).
        monotonic_ns: the machine's monotonic time at the same moment.
        most_bytes: what is left of the budget.
        least_free: bytes that stay free on the disk, for scoring.
    """

    folder: str
    steady_ns: int
    monotonic_ns: int
    most_bytes: int
    least_free: int


@dataclass(frozen=True, slots=True)
class EvidenceStatus:
    """Status of the evidence; the recording is the current or last one.

    Attributes:
        ready: whether a process listens, and has had the time to find all topics.
        topics: what comes; empty where the process has not reported lately.
        recorded: the topics of the recording.
        problems: what was wrong with all of the recording, in words.
        unwritten: see `EvidenceAccount`.
        gaps: when nothing was recorded, s since the epoch: the start of a run may still move.
        finishing: whether one is over and not complete on disk.
        stuck: that the disk takes nothing now, in words.
        unseen: patterns of the settings for which nobody publishes anything.
        scored: patterns that match only what is recorded with the score.
    """

    ready: bool = False
    topics: tuple[EvidenceTopic, ...] = ()
    recorded: tuple[EvidenceTopic, ...] = ()
    problems: tuple[str, ...] = ()
    unwritten: int | None = 0
    gaps: tuple[EvidenceGap, ...] = ()
    recording: bool = False
    finishing: bool = False
    problem: str | None = None
    stuck: str = ""
    unseen: tuple[str, ...] = ()
    scored: tuple[str, ...] = ()

    @property
    def byte_rate(self) -> float:
        """Bytes a second of all that is recorded."""
        return sum(topic.byte_rate for topic in self.topics)

    @property
    def gap(self) -> EvidenceGap | None:
        last = self.gaps[-1] if self.recording and self.gaps else None
        return None if last is None or last.end is not None else last

    def trouble(self, start: float | None) -> str | None:
        """What is wrong with all of it, in words; `start` of the run is in s since the epoch."""
        if self.gap is None:
            return self.problem or self.stuck or None
        since = "" if start is None else f" since {self.gap.since(start).begin:+.1f} s"
        return f"nothing is recorded{since}, it is starting again: {self.gap.why}"

    def faults(self, start: float | None) -> Iterator[str]:
        """What a run loses now, in words; `start` of the run is in s since the epoch.

        What is missing before a run, or was never there, is a matter of the check.
        """
        if not (self.recording or self.finishing):
            return
        if (trouble := self.trouble(start)) is not None:
            yield trouble
            return
        for one in self.topics:
            if one.silent and one.messages and (words := self._words_of(one, start)):
                yield f"{one.topic}: {words}"

    def _words_of(self, topic: EvidenceTopic, start: float | None) -> str:
        return topic.words_since(start if self.recording else None)

    def view(self, start: float | None, room: float | None) -> EvidenceView:
        """What screens show; `start` of the run is in s since the epoch, `room` in s."""
        over = [gap for gap in self.gaps if self.recording and gap.end is not None]
        missing = f"missing {len(over)} times" if over else ""
        if len(over) == 1 and start is not None:
            missing = f"missing {over[0].since(start).words}"
        return EvidenceView(
            len(self.topics),
            float(f"{self.byte_rate:.2g}"),
            self.recording,
            sum(one.bytes or 0 for one in self.recorded),
            sum(one.messages for one in self.recorded),
            room,
            self.trouble(start),
            missing,
            self._worst(start),
        )

    def _worst(self, start: float | None) -> str:
        """The topic that lacks most, a silent one before others, and how many more there are."""
        poor = [
            (not (wrong := self._words_of(one, start)), -one.lost_count, one.topic, wrong)
            for one in self.topics
        ]
        poor = sorted(each for each in poor if each[1] or each[3])
        if not poor:
            return ""
        _, lost, topic, wrong = poor[0]
        least = "+" if self.recording and self.gaps else ""  # what comes in a gap is not counted
        words = ", ".join(filter(None, (wrong, f"{-lost}{least} lost" if lost else "")))
        more = f" and {len(poor) - 1} more" if len(poor) > 1 else ""
        return f"{topic} {words}{more}"

    def account_since(self, start: float) -> EvidenceAccount:
        topics = tuple(one.recorded(start) for one in self.recorded)
        gaps = tuple(gap.since(start) for gap in self.gaps)
        return EvidenceAccount(topics, self.problems, self.unwritten, gaps)

    @property
    def troubles(self) -> dict[tuple[str, FaultKind], str]:
        troubles = {
            (topic.topic, FaultKind.EVIDENCE): words
            for topic in self.recorded
            if (words := topic.troubles)
        }
        if self.problem is not None and self.gap is None:
            troubles["recording", FaultKind.EVIDENCE] = self.problem
        return troubles


class EvidenceClient:
    """Records evidence beside the engine: this one none. Nothing waits; calls are the core's."""

    @property
    def status(self) -> EvidenceStatus | None:
        """None = no evidence is wanted, or there can be none."""
        return None

    def warm(self) -> None:
        """Get ready: topics shall be found before the first start."""

    def begin_recording(self, place: EvidencePlace) -> None:
        """It goes on until `end_recording`."""

    def end_recording(self) -> None:
        """Nothing more is recorded."""

    def await_account(self, limit: float) -> None:
        """Wait until all that was recorded is counted, `limit` s at most; not for the core."""

    def hold_writing(self, *, held: bool) -> None:
        """Leave the disk to scoring."""

    def close(self) -> None:
        """End it; the recording gets complete by itself."""


# Faults of the evidence that enter a run's journal.


PERIOD = 5.0
"""Topic faults are noted at most this often, s: many topics fail one after the other, and must not
hide the sensors' events.
"""


class EvidenceNotes:
    """What the journal says of one run's evidence.

    Gaps, and silences of topics, when they begin and when they end; each trouble of a topic once.
    """

    def __init__(self) -> None:
        self._faults = FaultNotes()
        self._told = -math.inf
        self._gaps: list[EvidenceGap] = []
        self._silent: dict[str, float] = {}

    def due(self, status: EvidenceStatus, start: float, now: float) -> list[str]:
        """What is to be noted now, in words; `start` of the run and `now` are s since the epoch."""
        return [
            *self._of_gaps(status, start),
            *self._of_silences(status, start),
            *self._of_topics(status, now),
        ]

    def _of_gaps(self, status: EvidenceStatus, start: float) -> Iterator[str]:
        known, self._gaps = self._gaps, list(status.gaps)
        for number, gap in enumerate(status.gaps):
            since = gap.since(start)
            if number >= len(known):
                yield f"nothing is recorded since {since.begin:+.1f} s: {gap.why}"
            if gap.end is not None and (number >= len(known) or known[number].end is None):
                yield f"recorded again, missing {since.words}"

    def _of_silences(self, status: EvidenceStatus, start: float) -> Iterator[str]:
        known, silent = self._silent, dict[str, float]()
        for one in status.recorded:
            if one.silent_since is not None:
                silent[one.topic] = one.silent_since
        if begun := [topic for topic in silent if topic not in known]:
            yield f"{listed(begun)}: silent since {silent[begun[0]] - start:+.1f} s"
        if back := [topic for topic in known if topic not in silent]:
            yield f"{listed(back)}: comes again, silent since {known[back[0]] - start:+.1f} s"
        self._silent = silent

    def _of_topics(self, status: EvidenceStatus, now: float) -> Iterator[str]:
        if 0 <= now - self._told < PERIOD:
            return
        topics: dict[str, list[str]] = {}
        for key in self._faults.due(status.troubles, now):
            topics.setdefault(status.troubles[key], []).append(key[0])
        if topics:
            self._told = now
        for words, names in topics.items():
            yield f"{listed(names)}: {words}"
