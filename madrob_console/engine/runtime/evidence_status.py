"""Messages of the evidence process, and what becomes of a recording through all its processes."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.formatting import counted, format_size, listed
from madrob_console.engine.runtime.evidence_client import EvidencePlace
from madrob_console.referee.evidence_account import (
    EvidenceGap,
    EvidenceStatus,
    EvidenceTopic,
    unseen_words,
)
from madrob_console.testbeds.evidence_choice import EvidenceChoice


class ListenFor(msgspec.Struct, frozen=True, tag=True):
    """Order to listen to topics from now on; the engine itself records `own_topics`."""

    domain: int
    choice: EvidenceChoice
    own_topics: tuple[str, ...]
    ros_args: tuple[str, ...]


class RecordInto(msgspec.Struct, frozen=True, tag=True):
    """Order to record into a new file; `number` is that of the recording, `file` of its file."""

    number: int
    file: int
    place: EvidencePlace


class FinishFile(msgspec.Struct, frozen=True, tag=True):
    """Order to finish the file: the recording is over."""


class LeaveDisk(msgspec.Struct, frozen=True, tag=True):
    """Whether scoring waits for the disk: nothing is written meanwhile."""

    held: bool


class EvidenceNews(msgspec.Struct, frozen=True):
    """Status report of the process, sent twice a second and when something changes.

    Attributes:
        settled: whether all topics are connected, as far as can be told.
        left_over, unseen: see `EvidenceIntakes`.
        problem: why nothing can be recorded at all, in words.
        number: of the current or last recording, to which the rest belongs.
        failed: what has ended it, in words.
        size: of its file, bytes.
        queued: bytes of memory that wait for the disk.
        unsynced: since when the disk has not had everything, or was left to scoring, s.
        unwritten: messages not in the file yet; None = unknown, the file cannot be finished.
        saved: time of the last message in the file, s since the epoch.
        ended: whether nothing more comes: all messages are counted.
        finished: whether the file is complete, or given up.
    """

    settled: bool = False
    topics: tuple[EvidenceTopic, ...] = ()
    left_over: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    problem: str = ""
    number: int = 0
    failed: str = ""
    size: int = 0
    queued: int = 0
    unsynced: float = 0.0
    unwritten: int | None = 0
    saved: float | None = None
    ended: bool = False
    finished: bool = False


ToEvidence = ListenFor | RecordInto | FinishFile | LeaveDisk


QUIET = 1.5
"""A process or a disk without activity for this long is reported as silent, s."""

SLOW_END = 5.0
"""A recording that is incomplete this long after its end is reported, s."""

COMES_BACK = 4.0
"""Time for a new process to receive all earlier topics again, s."""

_MOST_REASONS = 3
_MOST_GAPS = 20

NOTHING = EvidenceNews()


class EvidenceRecording:
    """One recording, through any number of processes. Times are s of a monotonic clock."""

    def __init__(self, number: int, place: EvidencePlace) -> None:
        self.ended: float | None = None
        self.topics: dict[str, EvidenceTopic] = {}
        self.gaps: tuple[EvidenceGap, ...] = ()
        self._number = number
        self._place = place
        self._files = 0
        self._news = NOTHING
        self._heard: float | None = None
        self._failed = ""
        self._former: dict[str, EvidenceTopic] = {}
        self._former_size = 0
        self._ends: Counter[str] = Counter()
        self._awaited: set[str] = set()
        self._back: float | None = None
        self._given_up = False

    @property
    def goes_on(self) -> bool:
        return self.ended is None

    @property
    def finishing(self) -> bool:
        return not (self.goes_on or self._news.finished or self._given_up)

    @property
    def counted(self) -> bool:
        """Whether its process has reported what it received up to the end of the recording."""
        return not self.goes_on and self._news.ended

    @property
    def unwritten(self) -> int | None:
        """Messages not in the files yet; None = unknown."""
        if self._ends or not (self.goes_on or self.counted):
            return None
        return self._news.unwritten

    def next_file(self) -> RecordInto:
        left = max(0, self._place.most_bytes - self._former_size)
        self._files += 1
        place = msgspec.structs.replace(self._place, most_bytes=left)
        return RecordInto(self._number, self._files - 1, place)

    def hear(self, news: EvidenceNews, now: float) -> None:
        """Take a report of its own process; reports of later ones do not mention this recording."""
        if news.number != self._number:
            return
        if not self.counted:
            self.topics |= {topic.topic: self._merged(topic) for topic in news.topics}
        if self.goes_on:
            self._failed = news.failed
        self._news, self._heard = news, now
        self._close_gap(now)

    def _merged(self, told: EvidenceTopic) -> EvidenceTopic:
        before = self._former.get(told.topic)
        return told if before is None else told.after(before)

    def lose_process(self, why: str) -> None:
        if not (self.goes_on or self.finishing):
            return
        if not self.counted or self.unwritten != 0:
            self.open_gap(why)
        self._ends[why] += 1
        self._former = dict(self.topics)
        self._former_size += self._news.size
        self._news = NOTHING
        self._given_up = not self.goes_on

    def open_gap(self, why: str) -> None:
        self._back = None
        if self._gap_is_open:
            return
        begin = self._news.saved or self._place.steady_ns / NS
        if self.gaps:
            begin = max(begin, self.gaps[-1].end or 0.0)
        self._awaited = {one.topic for one in self._news.topics if one.rate and not one.kept}
        earlier = self.gaps
        if len(earlier) == _MOST_GAPS:  # the last one takes in all later ones
            begin, earlier = earlier[-1].begin, earlier[:-1]
        self.gaps = *earlier, EvidenceGap(begin, None, why)

    @property
    def _gap_is_open(self) -> bool:
        return bool(self.gaps) and self.gaps[-1].end is None

    def _close_gap(self, now: float) -> None:
        """Close the gap once all earlier topics are back, or their time to come back is over."""
        if not self._gap_is_open:
            return
        self._back = now if self._back is None else self._back
        first = {one.topic: one.first for one in self._news.topics if one.first is not None}
        if now - self._back <= COMES_BACK and not (first and self._awaited <= first.keys()):
            return
        times = [first[topic] for topic in self._awaited & first.keys()] or [*first.values()]
        end = max(times) if times else self._steady(now)
        self.gaps = *self.gaps[:-1], replace(self.gaps[-1], end=end)

    def _steady(self, at: float) -> float:
        """Monotonic time as s since the epoch."""
        return (self._place.steady_ns + round(at * NS) - self._place.monotonic_ns) / NS

    @property
    def problems(self) -> tuple[str, ...]:
        """What was wrong with all of it, in words."""
        news, problems = self._news, []
        if self._ends:
            reasons = ", ".join(list(self._ends)[:_MOST_REASONS])
            more = ", and others" if len(self._ends) > _MOST_REASONS else ""
            times = f" {number} times" if (number := self._ends.total()) > 1 else ""
            problems.append(f"the evidence process had to be started again{times}: {reasons}{more}")
        if self._given_up and self._ends:
            problems.append("its last file is not complete: `madrob recover` repairs it")
        if news.failed:
            problems.append(news.failed)
        if (silent := self._silent_at_end) > QUIET:
            problems.append(
                f"the evidence process said nothing in the last {silent:.0f} s of the recording: "
                "what came then may be missing"
            )
        if left := news.left_over:
            too_many = counted(len(left), "topic")
            problems.append(f"{too_many} too many, {listed(left)}: not recorded")
        if news.settled and news.unseen:
            problems.append(unseen_words(news.unseen))
        if self._heard is None:
            problems.append("no process was there to record it")
        return tuple(problems)

    @property
    def _silent_at_end(self) -> float:
        """How long its process had been silent at the end, if it stayed silent, s."""
        if self.ended is None or self._heard is None or self.counted or self._given_up:
            return 0.0
        return self.ended - self._heard

    def problem(self, now: float) -> str:
        """What is wrong now. What ended a finished recording is in its account instead."""
        if failed := self._news.failed:
            over = not self.goes_on and self._news.finished
            return "" if over and failed == self._failed else failed
        if self.ended is not None and self.finishing and now - self.ended > SLOW_END:
            return f"not complete on disk {now - self.ended:.0f} s after the end of the recording"
        return ""

    @property
    def stuck(self) -> str:
        news = self._news
        if not self.goes_on or news.failed or news.unsynced <= QUIET:
            return ""
        waits = f", {format_size(news.queued)} wait in memory" if news.queued else ""
        return f"the disk has taken nothing for {news.unsynced:.0f} s{waits}"


def status_of(
    now: float,
    news: EvidenceNews | None,
    heard: float,
    trouble: str,
    recording: EvidenceRecording | None,
) -> EvidenceStatus:
    """Status from the last report, the process and the recording.

    `now` and `heard` are s of a monotonic clock; `trouble` says why there is no process.
    """
    problem = trouble or (news.problem if news else "")
    if news is not None and now - heard > QUIET:
        problem = f"the evidence process is silent for {now - heard:.0f} s"
        news = None  # what came then says nothing of what comes now
    news = news or NOTHING
    status = EvidenceStatus(
        ready=news.settled,
        topics=news.topics,
        problem=problem or None,
        unseen=news.unseen,
    )
    if recording is None:
        return status
    topics = recording.topics
    if recording.goes_on:
        status = replace(status, topics=tuple(topics.get(t.topic, t) for t in news.topics))
    return replace(
        status,
        recorded=tuple(topics[name] for name in sorted(topics)),
        problems=recording.problems,
        unwritten=recording.unwritten,
        gaps=recording.gaps,
        recording=recording.goes_on,
        finishing=recording.finishing,
        problem=status.problem or recording.problem(now) or None,
        stuck=recording.stuck,
    )
