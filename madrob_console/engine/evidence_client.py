"""Evidence as the core sees it, and which faults enter the journal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from madrob_console.common.formatting import listed, time_of_day
from madrob_console.engine.snapshot import EvidenceTopicView
from madrob_console.referee.evidence_account import (
    NO_EVIDENCE,
    EvidenceAccount,
    EvidenceGap,
    gaps_words,
    unseen_words,
)
from madrob_console.referee.records import FaultKind, TestbedFault, merged, numbers_in


@dataclass(frozen=True, slots=True)
class EvidencePlan:
    """Most bytes of evidence in the results folder; what must fit before a start, in s."""

    budget: int
    least_room: float


@dataclass(frozen=True, slots=True)
class EvidencePlace:
    """Where the evidence of a run goes.

    Attributes:
        folder_fd: handle of the bag's folder; whoever gets it closes it.
        name: of the folder, as it was made.
        steady_ns: steady time now (protocol section 8).
        monotonic_ns: the machine's monotonic time at the same moment.
        most_bytes: what is left of the budget.
        least_free: bytes that stay free on the disk, for scoring.
    """

    folder_fd: int
    name: str
    steady_ns: int
    monotonic_ns: int
    most_bytes: int
    least_free: int


@dataclass(frozen=True, slots=True)
class WitnessStatus:
    """Status of the evidence; the recording is the current or last one.

    Attributes:
        ready: whether a process listens, and has had the time to find all topics.
        topics: what comes; incomplete where the process has not reported lately.
        silent: topics on which nothing comes now, and nothing is kept for late joiners.
        unseen: patterns of the settings for which nobody publishes anything.
        scored: patterns that match only what is recorded with the score.
        gaps: when nothing was recorded, s since the epoch: the start of a run may still move.
        finishing: whether one is over and not complete on disk.
        size: bytes on disk.
        stuck: that the disk takes nothing now, in words.
        unrepaired: damaged files of the last run, and what their repair waits for, in words.
        pauses: silences of steady topics in the recording, by topic, s since the epoch.
        pauses_now: the current silences, also without a recording.
        appeared: first message of each topic that nobody had when the recording began, s since
            the epoch.
    """

    ready: bool = False
    topics: tuple[EvidenceTopicView, ...] = ()
    account: EvidenceAccount = NO_EVIDENCE
    recording: bool = False
    finishing: bool = False
    size: int = 0
    problem: str | None = None
    silent: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    scored: tuple[str, ...] = ()
    gaps: tuple[EvidenceGap, ...] = ()
    stuck: str = ""
    unrepaired: tuple[str, ...] = ()
    pauses: Mapping[str, tuple[EvidenceGap, ...]] = field(default_factory=dict)
    pauses_now: Mapping[str, EvidenceGap] = field(default_factory=dict)
    appeared: Mapping[str, float] = field(default_factory=dict)

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

    def faults(self, start: float | None) -> tuple[str, ...]:
        if (trouble := self.trouble(start)) is not None:
            return (trouble, *self.unrepaired)
        unseen = (unseen_words(self.unseen),) if self.ready and self.unseen else ()
        lines = (
            f"{topic.topic}: {topic.problem}"
            for topic in self.topics_since(start)
            if topic.problem and topic.topic in self.silent
        )
        return (*unseen, *lines, *self.unrepaired)

    def topics_since(self, start: float | None) -> tuple[EvidenceTopicView, ...]:
        return tuple(
            replace(one, problem=_together(one.problem, self._silence(one.topic, start)))
            for one in self.topics
        )

    def _silence(self, topic: str, start: float | None) -> str:
        if (now := self.pauses_now.get(topic)) is not None:
            return silent_since(now, start)
        pauses = self.pauses.get(topic) if self.recording else None
        return _silent(pauses, start) if pauses and start is not None else ""

    def account_since(self, start: float) -> EvidenceAccount:
        topics = (
            replace(
                one,
                problem=_together(
                    first_words(self.appeared.get(one.topic), start),
                    _silent(self.pauses.get(one.topic, ()), start),
                    one.problem,
                ),
            )
            for one in self.account.topics
        )
        gaps = tuple(gap.since(start) for gap in self.gaps)
        return replace(self.account, topics=tuple(topics), gaps=gaps)

    @property
    def troubles(self) -> dict[tuple[str, FaultKind], str]:
        troubles = {
            (topic.topic, FaultKind.EVIDENCE): words
            for topic in self.account.topics
            if (words := topic.troubles)
        }
        if self.problem is not None and self.gap is None:
            troubles["recording", FaultKind.EVIDENCE] = self.problem
        return troubles


def silent_since(pause: EvidenceGap, start: float | None) -> str:
    """That nothing comes any more, in words; without a `start`, by the time of day."""
    if start is None:
        return f"silent since {time_of_day(pause.begin)}"
    return f"silent since {pause.since(start).begin:+.1f} s"


def first_words(first: float | None, start: float) -> str:
    """When a topic came first, in words; empty = before the start. Times: s since the epoch."""
    return "" if first is None or first <= start else f"first message at {first - start:+.1f} s"


def _silent(pauses: Sequence[EvidenceGap], start: float) -> str:
    words = gaps_words([pause.since(start) for pause in pauses])
    return f"silent {words}" if words else ""


def _together(*words: str) -> str:
    return ", ".join(filter(None, words))


class EvidenceClient(Protocol):
    """Records evidence beside the engine. Nothing here waits; calls are the core's."""

    @property
    def status(self) -> WitnessStatus | None:
        """None = no evidence is wanted, or there can be none."""
        ...

    def warm(self) -> None:
        """Get ready: topics shall be found before the first start."""
        ...

    def begin_recording(self, place: EvidencePlace) -> None: ...

    def end(self) -> None: ...

    def await_account(self, limit: float) -> None:
        """Wait until the account has all up to the `end`, `limit` s at most; not for the core."""
        ...

    def hold_writing(self, *, held: bool) -> None: ...

    def close(self) -> None:
        """End it; the recording gets complete by itself."""
        ...


class NoEvidence:
    """An `EvidenceClient` that records nothing."""

    status = None

    def warm(self) -> None:
        """Nothing is needed."""

    def begin_recording(self, place: EvidencePlace) -> None:
        raise AssertionError(f"no evidence is wanted for {place.name}")

    def end(self) -> None:
        """Nothing was begun."""

    def await_account(self, limit: float) -> None:
        """Nothing is counted."""

    def hold_writing(self, *, held: bool) -> None:
        """Nothing is written."""

    def close(self) -> None:
        """Nothing was begun."""


# Faults of the testbed that enter a run's journal and its data quality.


LASTING = 0.5
"""A trouble that lasts this long is noted, s: not the wobble of a rate that is just beginning."""


class FaultNotes:
    """Notes each trouble of each topic once a run."""

    def __init__(self) -> None:
        self._since: dict[tuple[str, FaultKind], float] = {}
        self._noted: set[tuple[str, FaultKind]] = set()

    def due(
        self, troubles: Mapping[tuple[str, FaultKind], str], now: float
    ) -> list[tuple[str, FaultKind]]:
        """Which of the troubles are to be noted now; `now` is s since the epoch."""
        self._since = {key: self._since.get(key, now) for key in troubles}
        due = [
            key
            for key, since in self._since.items()
            if key not in self._noted and abs(now - since) >= LASTING
        ]
        self._noted.update(due)
        return due


_PASSING = (
    FaultKind.SLOW,
    FaultKind.FLOOD,
    FaultKind.UNREADABLE,
    FaultKind.NO_READING,
    FaultKind.STAMPS,
    FaultKind.SKEW,
)
"""Troubles whose words do not say how long they lasted."""


@dataclass(slots=True, eq=False)
class _Cause:
    """A trouble that came over some topics at the same time.

    Attributes:
        begin, seen: when it came first and when it was seen last, s since the epoch.
        worst: the words with the largest numbers, by topic.
        times, lasted: how often it came, and how long that was in all, s.
    """

    kind: FaultKind
    begin: float
    seen: float
    worst: dict[str, str] = field(default_factory=dict)
    times: int = 1
    lasted: float = LASTING

    def goes_on(self, now: float) -> bool:
        return now - self.seen <= LASTING

    def see(self, name: str, words: str, now: float) -> None:
        if self.goes_on(now):
            self.lasted += now - self.seen
        else:
            self.times += 1
        self.seen = now
        self.worst[name] = max(self.worst.get(name, words), words, key=numbers_in)

    def fault(self) -> TestbedFault:
        again = f", {self.times} times" if self.times > 1 else ""
        lasted = f", for {self.lasted:.1f} s" if self.kind in _PASSING else ""
        text = "; ".join(merged(self.worst.items()))
        return TestbedFault(self.begin, f"{text}{again}{lasted}", self.kind)


class RunFaults:
    """The faults of the testbed in one run: one for each cause.

    A fault is noted when its trouble has lasted for a while, and again when the recording ends:
    then it says on which topics it was, how often and how long.
    """

    def __init__(self) -> None:
        self._notes = FaultNotes()
        self._causes: dict[tuple[str, FaultKind], _Cause] = {}

    def due(self, troubles: Mapping[tuple[str, FaultKind], str], now: float) -> list[TestbedFault]:
        """The faults that are new; `now` is s since the epoch."""
        known = list(self._causes.values())
        new = {kind: self._cause(kind, now) for _, kind in self._notes.due(troubles, now)}
        for key, words in troubles.items():
            if key[1] in new:
                self._causes.setdefault(key, new[key[1]])
            if (cause := self._causes.get(key)) is not None:
                cause.see(key[0], words, now)
        return [cause.fault() for cause in new.values() if cause not in known]

    def _cause(self, kind: FaultKind, now: float) -> _Cause:
        """The cause that goes on now, else a new one."""
        known = (one for one in self._causes.values() if one.kind is kind and one.goes_on(now))
        return next(known, _Cause(kind, now - LASTING, now))

    def all(self) -> list[TestbedFault]:
        """All faults of the run, with what is known of them by now."""
        return [cause.fault() for cause in dict.fromkeys(self._causes.values())]


# Faults of the evidence that enter a run's journal.


PERIOD = 5.0
"""Topic faults are noted at most this often, s: many topics fail one after the other, and must not
hide the sensors' events.
"""


class EvidenceNotes:
    """What the journal says of one run's evidence.

    Gaps, and silences of topics, when they begin and when they end; the first message of a
    topic that appears late; each trouble of a topic once.
    """

    def __init__(self) -> None:
        self._faults = FaultNotes()
        self._told = -math.inf
        self._begun = self._over = 0
        self._silences: Counter[str] = Counter()
        self._back: Counter[str] = Counter()
        self._appeared: set[str] = set()

    def due(self, status: WitnessStatus, start: float, now: float) -> list[str]:
        """What is to be noted now, in words; `start` of the run and `now` are s since the epoch."""
        return [
            *self._of_gaps(status, start),
            *self._of_silences(status, start),
            *self._of_topics(status, now),
        ]

    def _of_gaps(self, status: WitnessStatus, start: float) -> Iterator[str]:
        for gap in status.gaps[self._begun :]:
            self._begun += 1
            yield f"nothing is recorded since {gap.since(start).begin:+.1f} s: {gap.why}"
        for gap in status.gaps[self._over :]:
            if gap.end is None:
                return
            self._over += 1
            yield f"recorded again, missing {gap.since(start).words}"

    def _of_silences(self, status: WitnessStatus, start: float) -> Iterator[str]:
        late = [topic for topic in status.appeared if topic not in self._appeared]
        self._appeared.update(late)
        told = {topic: first_words(status.appeared[topic], start) for topic in late}
        yield from _in_a_line({topic: words for topic, words in told.items() if words})
        silent: dict[str, str] = {}
        back: dict[str, str] = {}
        for topic, pauses in status.pauses.items():
            over = sum(pause.end is not None for pause in pauses)
            if over > self._back[topic]:
                back[topic] = f"comes again, silent {pauses[over - 1].since(start).words}"
            elif len(pauses) > max(over, self._silences[topic]):
                silent[topic] = silent_since(pauses[-1], start)
            self._silences[topic], self._back[topic] = len(pauses), max(over, self._back[topic])
        yield from _in_a_line(silent)
        yield from _in_a_line(back)

    def _of_topics(self, status: WitnessStatus, now: float) -> Iterator[str]:
        if 0 <= now - self._told < PERIOD:
            return
        topics: dict[str, list[str]] = {}
        for key in self._faults.due(status.troubles, now):
            topics.setdefault(status.troubles[key], []).append(key[0])
        if topics:
            self._told = now
        for words, names in topics.items():
            yield f"{listed(names)}: {words}"


def _in_a_line(words: Mapping[str, str]) -> Iterator[str]:
    """One line for several topics, in the words of the first; none where there is none."""
    if words:
        yield f"{listed(list(words))}: {next(iter(words.values()))}"
