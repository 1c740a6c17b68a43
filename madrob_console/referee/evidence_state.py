"""The state of the evidence recording: its process reports it, the core and the screens read it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from madrob_console.common.formatting import time_of_day
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    RecordedTopic,
)
from madrob_console.referee.records import FaultKind


@dataclass(frozen=True, slots=True)
class EvidenceTopic(RecordedTopic):
    """One topic of the evidence, live. Times are s since the epoch.

    Its counts are those of the current or last recording.

    Attributes:
        rate, byte_rate: messages and bytes a second of what is recorded.
        publishers: how many there are.
        durable: whether late joiners get earlier messages, so that silence is no fault.
        silent_since: the last message of a steady topic on which nothing comes now; else null.
        first: its first message in the file.
    """

    rate: float = 0.0
    byte_rate: float = 0.0
    publishers: int = 1
    durable: bool = False
    silent_since: float | None = None
    first: float | None = None

    @property
    def silent(self) -> bool:
        return not self.publishers or not (self.rate or self.durable)

    def words_since(self, start: float | None) -> str:
        """What is wrong with it, in words, live and afterwards.

        Without a `start` of the run, in s since the epoch, it has the time of day.
        """
        since, silent = self.silent_since, ""
        if since is not None:
            at = time_of_day(since) if start is None else f"{since - start:+.1f} s"
            silent = f"silent since {at}"
        return ", ".join(filter(None, (silent, self.problem)))

    def recorded(self, start: float) -> RecordedTopic:
        """What stands in the account; `start` of the run is in s since the epoch."""
        problem = self.words_since(start)
        counts = self.messages, self.bytes, self.left_out, self.lost
        return RecordedTopic(self.topic, self.type, *counts, problem)

    def after(self, before: EvidenceTopic | None) -> EvidenceTopic:
        """With the counts of an earlier process of the same recording, if there was one."""
        if before is None:
            return self
        lost = {
            why: number
            for why in EvidenceLoss
            if (number := before.lost.get(why, 0) + self.lost.get(why, 0))
        }
        earlier = before.silent_since if self.first is None else None
        return replace(
            self,
            messages=before.messages + self.messages,
            bytes=(before.bytes or 0) + (self.bytes or 0),
            left_out=before.left_out + self.left_out,
            lost=lost,
            problem=self.problem or before.problem,
            silent_since=self.silent_since or earlier,
        )


@dataclass(frozen=True, slots=True)
class EvidenceState:
    """State of the evidence; the recording is the current or last one.

    Its process reports it. The engine merges the reports of all processes of a recording, and adds
    `recorded`, `gaps`, `room` and `lasts`. Times are s since the epoch: the start of a run may
    still move.

    Attributes:
        ready: whether a process listens, and has had the time to discover all topics.
        topics: what comes now; empty where the process has not reported lately.
        missing: topics of the settings that are not recorded, in words.
        problem: why nothing is recorded now, in words.
        stuck: that the disk takes nothing now, in words.
        number: of the recording; 0 = there was none.
        recording, finishing: whether it goes on; whether it is over and not complete on disk.
        recorded: its topics.
        problems: what was wrong with all of it, in words.
        gaps: when nothing was recorded.
        unwritten: see `EvidenceAccount`.
        saved: the last message in the file.
        room: bytes that can still be recorded; None = unknown.
        lasts: how long that is at the recent rate, s; None = unknown, or nothing comes.
    """

    ready: bool = False
    topics: tuple[EvidenceTopic, ...] = ()
    missing: tuple[str, ...] = ()
    problem: str | None = None
    stuck: str = ""
    number: int = 0
    recording: bool = False
    finishing: bool = False
    recorded: tuple[EvidenceTopic, ...] = ()
    problems: tuple[str, ...] = ()
    gaps: tuple[EvidenceGap, ...] = ()
    unwritten: int | None = 0
    saved: float | None = None
    room: int | None = None
    lasts: float | None = None

    @property
    def byte_rate(self) -> float:
        """Bytes a second of all that is recorded."""
        return sum(topic.byte_rate for topic in self.topics)

    @property
    def gap(self) -> EvidenceGap | None:
        """The gap that goes on."""
        last = self.gaps[-1] if self.recording and self.gaps else None
        return None if last is None or last.end is not None else last

    def trouble(self, start: float | None) -> str | None:
        """Faults of the whole recording, in words; `start` of the run is in s since the epoch."""
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
        for topic in self.topics:
            if topic.silent and topic.messages and (words := self._words_of(topic, start)):
                yield f"{topic.topic}: {words}"

    def _words_of(self, topic: EvidenceTopic, start: float | None) -> str:
        return topic.words_since(start if self.recording else None)

    def missing_words(self, start: float | None) -> str:
        """When nothing was recorded in the current recording, in words."""
        over = [gap for gap in self.gaps if self.recording and gap.end is not None]
        if len(over) == 1 and start is not None:
            return f"missing {over[0].since(start).words}"
        return f"missing {len(over)} times" if over else ""

    def worst(self, start: float | None) -> str:
        """The topic that lacks most, a silent one before others, and how many more there are."""
        poor = [
            (not (wrong := self._words_of(topic, start)), -topic.lost_count, topic.topic, wrong)
            for topic in self.topics
        ]
        poor = sorted(each for each in poor if each[1] or each[3])
        if not poor:
            return ""
        _, lost, name, wrong = poor[0]
        least = "+" if self.recording and self.gaps else ""  # what comes in a gap is not counted
        words = ", ".join(filter(None, (wrong, f"{-lost}{least} lost" if lost else "")))
        more = f" and {len(poor) - 1} more" if len(poor) > 1 else ""
        return f"{name} {words}{more}"

    @property
    def silences(self) -> dict[str, float]:
        """Since when recorded topics are silent."""
        topics = self.recorded
        return {t.topic: t.silent_since for t in topics if t.silent_since is not None}

    @property
    def troubles(self) -> dict[tuple[str, FaultKind], str]:
        """What the journal notes of it, in words, by topic."""
        troubles = {
            (topic.topic, FaultKind.EVIDENCE): words
            for topic in self.recorded
            if (words := topic.troubles)
        }
        if self.problem is not None and self.gap is None:
            troubles["recording", FaultKind.EVIDENCE] = self.problem
        return troubles

    def account_since(self, start: float) -> EvidenceAccount:
        """The account of the recording; `start` of the run is in s since the epoch."""
        topics = tuple(topic.recorded(start) for topic in self.recorded)
        gaps = tuple(gap.since(start) for gap in self.gaps)
        return EvidenceAccount(topics, self.problems, self.unwritten, gaps)
