"""Status of the evidence recording, and the messages of its process."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.formatting import counted, format_size, listed
from madrob_console.engine.evidence_client import EvidencePlace, WitnessStatus
from madrob_console.engine.evidence_recorder import EvidenceWritten
from madrob_console.engine.snapshot import EvidenceTopicView
from madrob_console.engine.wire import decoded
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    RecordedTopic,
    unseen_words,
)
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicFlow
from recorder.bag import evidence_file_name

# Messages between an engine and its evidence process.
#
# The frames are those of screens (`engine/wire.py`). The handle of a folder comes with
# `RecordInto`.


class ListenFor(msgspec.Struct, frozen=True, tag=True):
    """Order to listen to topics from now on; the engine itself records `own_topics`."""

    domain: int
    choice: EvidenceChoice
    own_topics: tuple[str, ...]
    ros_args: tuple[str, ...]


class RecordInto(msgspec.Struct, frozen=True, tag=True):
    """Order to record into a new file of the folder whose handle comes with the order.

    `monotonic_ns` is the machine's monotonic time at the engine's `steady_ns`. For
    `most_bytes` and `least_free` see `EvidenceRecorder`.
    """

    number: int
    file_name: str
    steady_ns: int
    monotonic_ns: int
    most_bytes: int
    least_free: int


class FinishFile(msgspec.Struct, frozen=True, tag=True):
    """Order to finish the file: the recording is over."""

    number: int


class LeaveDisk(msgspec.Struct, frozen=True, tag=True):
    """Whether scoring waits for the disk: nothing is written meanwhile."""

    held: bool


class EvidenceNews(msgspec.Struct, frozen=True, tag=True):
    """Status report of the process, sent twice a second and when a recording ends.

    Attributes:
        settled: whether all topics are connected, as far as can be told.
        left_over, unseen, scored: see `EvidenceIntakes`.
        recordings: by number: the current one and those that are or were being finished.
        left_out, too_large, lost: messages by topic, of the current or last recording:
            left out on purpose, too large to be recorded, lost on the way.
    """

    settled: bool = False
    flows: tuple[TopicFlow, ...] = ()
    left_over: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    scored: tuple[str, ...] = ()
    recordings: dict[int, EvidenceWritten] = {}
    left_out: dict[str, int] = {}
    too_large: dict[str, int] = {}
    lost: dict[str, int] = {}
    problem: str = ""


ToEvidence = ListenFor | RecordInto | FinishFile | LeaveDisk

_orders: msgspec.msgpack.Decoder[ToEvidence] = msgspec.msgpack.Decoder(ToEvidence)
_told: msgspec.msgpack.Decoder[EvidenceNews] = msgspec.msgpack.Decoder(EvidenceNews)


def order_of(data: bytes) -> ToEvidence:
    return _orders.decode(data)


def news_of(data: bytes) -> EvidenceNews:
    return decoded(_told, data, "a message of the process that records evidence")


QUIET = 1.5
"""A process or a disk without activity for this long is reported as silent, s."""

SLOW_END = 5.0
"""A recording that is incomplete this long after its end is reported, s."""

COMES_BACK = 4.0
"""Time for a new process to receive all earlier topics again, s."""

MOST_GAPS = 20
"""Gaps of a recording that are listed one by one."""

_MOST_REASONS = 3

_NOTHING = EvidenceNews()


class EvidenceRecording:
    """One recording, through any number of processes. Times are s of a monotonic clock."""

    def __init__(self, number: int, place: EvidencePlace) -> None:
        self.number = number
        self.place = place
        self.ended: float | None = None
        self._files = 0
        self._former: list[tuple[RecordedTopic, ...]] = []
        self._former_size = 0
        self._cut_off = False
        self._heard_at: float | None = None
        self._ends: Counter[str] = Counter()
        self._gaps: list[EvidenceGap] = []
        self._awaited: set[str] = set()
        self._back: float | None = None
        self._heard = _NOTHING
        self._written: EvidenceWritten | None = None
        self._given_up = self._torn = False
        self._in_account = ""
        self._there: set[str] | None = None
        self._first: dict[str, float] = {}
        self._former_pauses: dict[str, tuple[EvidenceGap, ...]] = {}

    @property
    def goes_on(self) -> bool:
        return self.ended is None

    @property
    def finishing(self) -> bool:
        finished = self._written is not None and self._written.finished
        return not (self.goes_on or finished or self._given_up)

    @property
    def size(self) -> int:
        """Bytes of all its files."""
        return self._former_size + (self._written.size if self._written else 0)

    @property
    def counted(self) -> bool:
        """Whether its process has reported what it received up to the end of the recording."""
        return not self.goes_on and self._written is not None and self._written.ended

    @property
    def unwritten(self) -> int | None:
        """Messages not in the files yet; None = unknown."""
        written = self._written
        if self._cut_off or (written is not None and not (self.goes_on or self.counted)):
            return None
        return 0 if written is None else written.unwritten

    def next_file(self) -> RecordInto:
        place, number = self.place, self._files
        self._files += 1
        return RecordInto(
            self.number,
            evidence_file_name(place.name, number),
            place.steady_ns,
            place.monotonic_ns,
            max(0, place.most_bytes - self._former_size),
            place.least_free,
        )

    def hear(self, heard: EvidenceNews, now: float) -> None:
        """Take a report of its own process; reports of later ones do not mention this recording."""
        written = heard.recordings.get(self.number)
        if written is not None and (self.goes_on or self.finishing):
            self._heard, self._written, self._heard_at = heard, written, now
            if self.goes_on:
                self._in_account = written.problem
            self._close_gap(written, now)
            if self._there is None and heard.settled:
                self._there = {flow.topic for flow in heard.flows}
            for topic, at_ns in written.first_ns.items():
                self._first.setdefault(topic, at_ns / NS)
        elif self.ended is not None and now - self.ended > SLOW_END:
            self._given_up = True

    def lose_process(self, why: str) -> None:
        if not (self.goes_on or self.finishing):
            return
        self._open_gap(why)
        self._ends[why] += 1
        self._former.append(_topics(self._heard, self._written))
        self._former_size = self.size
        self._cut_off |= self._files > 0
        self._former_pauses = self.pauses
        self._heard, self._written = _NOTHING, None
        self._given_up = self._torn = not self.goes_on

    def wait_for_process(self) -> None:
        self._open_gap("its process was only being started")

    @property
    def appeared(self) -> dict[str, float]:
        """First messages of topics that appeared after its begin, s since the epoch."""
        there = self._there
        return {} if there is None else {t: at for t, at in self._first.items() if t not in there}

    @property
    def pauses(self) -> dict[str, tuple[EvidenceGap, ...]]:
        """Silences of steady topics, s since the epoch; the last may still be open."""
        found = dict(self._former_pauses)
        first = {} if self._written is None else self._written.first_ns
        for topic, (*before, last) in self._former_pauses.items():
            if last.end is None and topic in first:
                found[topic] = *before, replace(last, end=first[topic] / NS)
        end = math.inf if self.ended is None else self._steady(self.ended)
        for topic, pauses in pauses_of(self._heard).items():
            in_it = (pause for pause in pauses if pause.begin < end)
            if both := (*found.get(topic, ()), *in_it):
                found[topic] = both
        return found

    def _steady(self, at: float) -> float:
        """Monotonic time as s since the epoch."""
        return (self.place.steady_ns + round(at * NS) - self.place.monotonic_ns) / NS

    @property
    def gaps(self) -> tuple[EvidenceGap, ...]:
        """When nothing was recorded, s since the epoch; the last may still be open."""
        return tuple(self._gaps)

    @property
    def _gap(self) -> EvidenceGap | None:
        return self._gaps[-1] if self._gaps and self._gaps[-1].end is None else None

    def _open_gap(self, why: str) -> None:
        written = self._written
        self._back = None
        all_there = self.counted and self.unwritten == 0
        if self._gap is not None or all_there:
            return
        saved = None if written is None else written.saved_ns
        begin = self._gaps[-1].end if self._gaps else None
        begin = max(begin or 0.0, (saved or self.place.steady_ns) / NS)
        steady = {flow.topic for flow in self._heard.flows if flow.rate and not flow.kept}
        self._awaited = steady if written is not None else set()
        if len(self._gaps) < MOST_GAPS:
            self._gaps.append(EvidenceGap(begin, None, why))
        else:
            last = self._gaps[-1]
            self._gaps[-1] = replace(last, end=None, why=why, number=last.number + 1)

    def _close_gap(self, written: EvidenceWritten, now: float) -> None:
        """Close the gap once all earlier topics are back, or their time to come back is over."""
        if self._gap is None:
            return
        self._back = now if self._back is None else self._back
        first = written.first_ns
        if now - self._back <= COMES_BACK and not (first and self._awaited <= first.keys()):
            return
        times = [first[topic] for topic in self._awaited & first.keys()] or [*first.values()]
        end = max(times) / NS if times else self._steady(now)
        self._gaps[-1] = replace(self._gap, end=end)

    def _problems(self) -> list[str]:
        if not self._ends:
            return []
        reasons = ", ".join(list(self._ends)[:_MOST_REASONS])
        more = ", and others" if len(self._ends) > _MOST_REASONS else ""
        times = f" {number} times" if (number := self._ends.total()) > 1 else ""
        problems = [f"the evidence process had to be started again{times}: {reasons}{more}"]
        if self._torn:
            problems.append("its last file is not complete: `madrob recover` repairs it")
        return problems

    def account(self) -> EvidenceAccount:
        problems = self._problems()
        if self._written is not None and self._written.problem:
            problems.append(self._written.problem)
        if (silent := self._silent_at_end) > QUIET:
            problems.append(
                f"the evidence process said nothing in the last {silent:.0f} s of the recording: "
                "what came then may be missing"
            )
        if left := self._heard.left_over:
            too_many = counted(len(left), "topic")
            problems.append(f"{too_many} too many, {listed(left)}: not recorded")
        if self._heard.settled and (unseen := self._heard.unseen):
            problems.append(unseen_words(unseen))
        if not self._files or (self._files and not self._former and self._written is None):
            problems.append("no process was there to record it")
        topics = _merged([*self._former, _topics(self._heard, self._written)])
        return EvidenceAccount(topics, tuple(problems), self.unwritten)

    @property
    def _silent_at_end(self) -> float:
        """How long its process had been silent at the end, if it stayed silent, s."""
        if self.ended is None or self._heard_at is None or self.counted or self._given_up:
            return 0.0
        return self.ended - self._heard_at

    @property
    def stuck(self) -> str:
        written = self._written
        if not self.goes_on or written is None or written.problem or written.silent <= QUIET:
            return ""
        waits = f", {format_size(written.queued)} wait in memory" if written.queued else ""
        return f"the disk has taken nothing for {written.silent:.0f} s{waits}"

    def problem(self, now: float) -> str:
        """What is wrong now. What ended a finished recording is in its account instead."""
        written = self._written
        if written is not None and written.problem:
            over = not self.goes_on and written.finished
            return "" if over and written.problem == self._in_account else written.problem
        if self.ended is not None and self.finishing and now - self.ended > SLOW_END:
            return f"not complete on disk {now - self.ended:.0f} s after the end of the recording"
        return ""


def standing(
    now: float,
    heard: EvidenceNews | None,
    heard_at: float,
    trouble: str,
    recording: EvidenceRecording | None,
) -> WitnessStatus:
    """Status from the last report, the process and the recording.

    `now` and `heard_at` are s of a monotonic clock; `trouble` says why there is no process.
    """
    problem = trouble or (heard.problem if heard else "")
    if heard is not None and now - heard_at > QUIET:
        problem = f"the evidence process is silent for {now - heard_at:.0f} s"
        heard = None  # what came then says nothing of what comes now
    if recording is not None:
        problem = problem or recording.problem(now)
    account = EvidenceAccount() if recording is None else recording.account()
    lost = {topic.topic: sum(topic.lost.values()) for topic in account.topics}
    return WitnessStatus(
        ready=heard is not None and heard.settled,
        topics=tuple(
            EvidenceTopicView(
                flow.topic,
                flow.type,
                round(flow.rate, 1),
                float(f"{flow.byte_rate:.2g}"),
                lost.get(flow.topic, 0),
                flow.problem,
            )
            for flow in (heard.flows if heard else ())
        ),
        account=account,
        recording=recording is not None and recording.goes_on,
        finishing=recording is not None and recording.finishing,
        size=0 if recording is None else recording.size,
        problem=problem or None,
        stuck="" if recording is None else recording.stuck,
        pauses={} if recording is None else recording.pauses,
        pauses_now={
            topic: pauses[-1]
            for topic, pauses in pauses_of(heard or _NOTHING).items()
            if pauses[-1].end is None
        },
        appeared={} if recording is None else recording.appeared,
        unrepaired=tuple(
            one.unrepaired for one in (heard.recordings.values() if heard else ()) if one.unrepaired
        ),
        silent=tuple(flow.topic for flow in (heard.flows if heard else ()) if flow.silent),
        unseen=heard.unseen if heard else (),
        scored=heard.scored if heard else (),
        gaps=() if recording is None else recording.gaps,
    )


def pauses_of(heard: EvidenceNews) -> dict[str, tuple[EvidenceGap, ...]]:
    """Silences of steady topics, by topic, s since the epoch."""
    return {
        flow.topic: tuple(
            EvidenceGap(
                pause.begin_ns / NS,
                None if pause.end_ns is None else pause.end_ns / NS,
                "nothing came",
                pause.number,
            )
            for pause in flow.pauses
        )
        for flow in heard.flows
        if flow.pauses
    }


def _topics(heard: EvidenceNews, written: EvidenceWritten | None) -> tuple[RecordedTopic, ...]:
    if written is None:
        return ()
    flows = {flow.topic: flow for flow in heard.flows}
    counts: Mapping[EvidenceLoss, Mapping[str, int]] = {
        EvidenceLoss.ON_THE_WAY: heard.lost,
        EvidenceLoss.BEHIND: written.gave_way,
        EvidenceLoss.TOO_LARGE: heard.too_large,
        EvidenceLoss.DISK: written.refused,
    }
    names = {*flows, *written.messages, *itertools.chain.from_iterable(counts.values())}
    return tuple(
        RecordedTopic(
            name,
            flows[name].type if name in flows else "",
            written.messages.get(name, 0),
            written.bytes.get(name, 0),
            heard.left_out.get(name, 0),
            {why: count[name] for why, count in counts.items() if count.get(name)},
            flows[name].problem if name in flows else "",
        )
        for name in sorted(names)
    )


def _merged(parts: Sequence[Sequence[RecordedTopic]]) -> tuple[RecordedTopic, ...]:
    found: dict[str, RecordedTopic] = {}
    for one in itertools.chain.from_iterable(parts):
        other = found.get(one.topic)
        if other is None:
            found[one.topic] = one
            continue
        lost = Counter(other.lost)
        lost.update(one.lost)
        found[one.topic] = RecordedTopic(
            one.topic,
            one.type or other.type,
            one.messages + other.messages,
            (one.bytes or 0) + (other.bytes or 0),
            one.left_out + other.left_out,
            dict(lost),
            one.problem or other.problem,
        )
    return tuple(found[name] for name in sorted(found))
