"""What is recorded of the evidence of a run, and what is lost of it: live, and its account."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from madrob_console.common.formatting import counted, listed, time_of_day
from madrob_console.referee.records import FaultKind


class EvidenceLoss(StrEnum):
    """Why a message of the evidence is not in the recording."""

    ON_THE_WAY = "on the way"
    """ROS did not deliver it."""
    BEHIND = "behind"
    """More came than disk or processor took."""
    TOO_LARGE = "too large"
    """Larger than the settings allow."""
    DISK = "disk"
    """The disk refused it or had no room left for evidence, or its process ended before."""


@dataclass(frozen=True, slots=True)
class EvidenceGap:
    """A time without any evidence.

    Attributes:
        begin: the last message before it, s since the start of the run; while it is recorded, s
            since the epoch.
        end: likewise, the first message after it; null = it went on to the end.
        why: in words.
    """

    begin: float
    end: float | None
    why: str

    def since(self, start: float) -> EvidenceGap:
        """The gap in s since the run's start, given as s since the epoch."""
        end = None if self.end is None else round(self.end - start, 2)
        return replace(self, begin=round(self.begin - start, 2), end=end)

    @property
    def words(self) -> str:
        end = "the end" if self.end is None else f"{self.end:+.1f} s"
        return f"from {self.begin:+.1f} s to {end}"


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """One topic of the evidence of a run.

    Attributes:
        topic, type: its names.
        messages, bytes: recorded; bytes are null where nobody has told them.
        left_out: messages that the settings leave out on purpose, by their rate.
        lost: messages that were lost, by reason.
        problem: what was wrong with it, in words; empty = nothing.
    """

    topic: str
    type: str
    messages: int = 0
    bytes: int | None = 0
    left_out: int = 0
    lost: dict[EvidenceLoss, int] = field(default_factory=dict)
    problem: str = ""

    @property
    def lost_count(self) -> int:
        return sum(self.lost.values())

    @property
    def lost_words(self) -> str:
        reasons = ", ".join(f"{number} {why}" for why, number in self.lost.items() if number)
        return f"{self.lost_count} lost ({reasons})" if reasons else ""

    @property
    def left_out_words(self) -> str:
        return f"{self.left_out} left out by `recording.limits`" if self.left_out else ""

    @property
    def troubles(self) -> str:
        reasons = ", ".join(why for why, number in self.lost.items() if number)
        lost = f"messages are lost ({reasons})" if reasons else ""
        return ", ".join(filter(None, (lost, self.problem)))


@dataclass(frozen=True, slots=True)
class EvidenceTopic(RecordedTopic):
    """One topic of the evidence, live. Times are s since the epoch.

    Its counts are those of the current or last recording.

    Attributes:
        rate, byte_rate: messages and bytes a second of what is recorded.
        publishers: how many there are.
        kept: whether they keep messages for late joiners, so that silence is no fault.
        silent_since: the last message of a steady topic on which nothing comes now; else null.
        first: its first message in the file.
    """

    rate: float = 0.0
    byte_rate: float = 0.0
    publishers: int = 1
    kept: bool = False
    silent_since: float | None = None
    first: float | None = None

    @property
    def silent(self) -> bool:
        return not self.publishers or not (self.rate or self.kept)

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
        return RecordedTopic(
            self.topic,
            self.type,
            self.messages,
            self.bytes,
            self.left_out,
            self.lost,
            self.words_since(start),
        )

    def after(self, before: EvidenceTopic) -> EvidenceTopic:
        """With what an earlier process of the same recording counted."""
        earlier = before.silent_since if self.first is None else None
        lost = {
            why: number
            for why in EvidenceLoss
            if (number := before.lost.get(why, 0) + self.lost.get(why, 0))
        }
        return replace(
            self,
            messages=before.messages + self.messages,
            bytes=(before.bytes or 0) + (self.bytes or 0),
            left_out=before.left_out + self.left_out,
            lost=lost,
            problem=self.problem or before.problem,
            silent_since=self.silent_since or earlier,
        )


def _as_found(told: RecordedTopic, found: int) -> RecordedTopic:
    """The topic with so many messages in the files; the others are lost, and the bytes unknown."""
    if found == told.messages:
        return told
    lost = dict(told.lost)
    if found < told.messages:
        lost[EvidenceLoss.DISK] = lost.get(EvidenceLoss.DISK, 0) + told.messages - found
    size = told.bytes and told.bytes * found // max(1, told.messages)
    return replace(told, messages=found, bytes=size, lost=lost)


@dataclass(frozen=True, slots=True)
class EvidenceAccount:
    """The evidence of a run, as of the end of its recording. Nothing is scored from it.

    Attributes:
        topics: by name.
        problems: what was wrong with all of it, in words.
        unwritten: how many of the messages were not in the file yet; null = nobody knows, their
            process was ended; 0 = all are there.
        gaps: when nothing was recorded; what came then is counted nowhere.
        file_bytes: size of the files, where nobody has told what the topics have of it.
    """

    topics: tuple[RecordedTopic, ...] = ()
    problems: tuple[str, ...] = ()
    unwritten: int | None = 0
    gaps: tuple[EvidenceGap, ...] = ()
    file_bytes: int | None = None

    @property
    def words(self) -> str:
        messages = sum(one.messages for one in self.topics)
        size = (self.file_bytes or sum(one.bytes or 0 for one in self.topics)) / 1e6
        lost = sum(one.lost_count for one in self.topics)
        missing = f", {self._at_least}{lost} lost" if lost else ""
        if self.gaps:
            missing += f", missing {self.gap_words}"
        topics, came = counted(len(self.topics), "topic"), counted(messages, "message")
        return f"{topics}, {came}, {size:.1f} MB{missing}{self._rest}"

    @property
    def gap_words(self) -> str:
        more = f" and {counted(len(self.gaps) - 1, 'time')} more" if len(self.gaps) > 1 else ""
        return f"{self.gaps[0].words}{more}" if self.gaps else ""

    @property
    def _at_least(self) -> str:
        """A prefix of losses: messages during a gap are not counted."""
        return "at least " if self.gaps else ""

    @property
    def _rest(self) -> str:
        if self.unwritten is None:
            return ", not known how many of them are on disk"
        return f", {self.unwritten} of them still being written" if self.unwritten else ""

    def settled(
        self,
        counts: Mapping[str, tuple[str, int]],
        problems: Iterable[str] = (),
        file_bytes: int | None = None,
    ) -> EvidenceAccount:
        """The account of the messages in the files; others did not reach the disk.

        `counts` has type and number of messages by topic, in all files together.
        """
        told = {one.topic: one for one in self.topics}
        for topic, (type_name, _) in counts.items():
            told.setdefault(topic, RecordedTopic(topic, type_name, bytes=None))
        topics = tuple(_as_found(told[name], counts.get(name, ("", 0))[1]) for name in sorted(told))
        if all(one.bytes is not None for one in topics):
            file_bytes = None
        return EvidenceAccount(topics, (*self.problems, *problems), 0, self.gaps, file_bytes)

    def remarks(self) -> list[str]:
        remarks = list(self.problems)
        if len(self.gaps) > 1:  # of one the words tell
            remarks.append(f"missing {', '.join(gap.words for gap in self.gaps)}")
        for one in self.topics:
            lost = one.lost_words and self._at_least + one.lost_words
            words = ", ".join(filter(None, (lost, one.left_out_words, one.problem)))
            if words:
                remarks.append(f"{one.topic}: {words}")
        return remarks


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

    def worst(self, start: float | None) -> str:
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


def unseen_words(patterns: Sequence[str]) -> str:
    return f"nobody publishes {listed(patterns)}"


CUT_OFF = EvidenceAccount(
    problems=("the engine was ended before it could tell: what was lost is not known",),
    unwritten=None,
)
"""For a run with evidence files but no account."""
