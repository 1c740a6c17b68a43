"""One recording of evidence through all processes that recorded it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.formatting import counted, listed
from madrob_console.engine.runtime.evidence_client import EvidencePlace
from madrob_console.engine.runtime.evidence_order import RecordInto
from madrob_console.referee.evidence_account import EvidenceGap
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic

QUIET = 1.5
"""A process without a report for this long is shown as silent, s."""

COMES_BACK = 4.0
"""Time for a new process to receive all earlier topics again, s."""

_MOST_GAPS = 20

_NO_REPORT = EvidenceState(recording=True)


class EvidenceRecording:
    """Merges the reports of one recording over restarts of its process.

    Times are s of a monotonic clock.

    Attributes:
        ended: when the recording was ended.
        gaps: when nothing was recorded, s since the epoch.
        written: set once all that was recorded is in its file, as far as its process reports.
    """

    def __init__(self, number: int, place: EvidencePlace) -> None:
        self.ended: float | None = None
        self.written = threading.Event()
        self.gaps: tuple[EvidenceGap, ...] = ()
        self._number = number
        self._place = place
        self._report = _NO_REPORT
        self._reported: float | None = None
        self._topics: dict[str, EvidenceTopic] = {}
        self._earlier: dict[str, EvidenceTopic] = {}
        self._problems_before_end: tuple[str, ...] = ()
        self._restarts: list[str] = []
        self._returned: float | None = None
        self._incomplete = False

    @property
    def goes_on(self) -> bool:
        return self.ended is None

    @property
    def _is_counted(self) -> bool:
        """Whether its process has reported what it received up to the end of the recording."""
        return not (self.goes_on or self._report.recording)

    @property
    def is_written(self) -> bool:
        return self._is_counted and self._report.unwritten == 0

    @property
    def _finishing(self) -> bool:
        complete = self._is_counted and not self._report.finishing
        return not (self.goes_on or complete or self._incomplete) and self._reported is not None

    @property
    def order(self) -> RecordInto | None:
        """The file of its present process, as long as it goes on."""
        if not self.goes_on:
            return None
        used = sum(topic.bytes or 0 for topic in self._earlier.values())
        place = msgspec.structs.replace(self._place, most_bytes=self._place.most_bytes - used)
        return RecordInto(self._number, len(self._restarts), place)

    def add_report(self, report: EvidenceState, now: float) -> None:
        """Take a report of its present process; later ones do not mention this recording."""
        if report.number != self._number:
            return
        if not self._is_counted:
            earlier = self._earlier
            self._topics |= {t.topic: t.after(earlier.get(t.topic)) for t in report.topics}
        if self.goes_on:
            self._problems_before_end = report.problems
        self._report, self._reported = report, now
        self._close_gap(now)

    def lose_process(self, why: str) -> None:
        if not (self.goes_on or self._finishing):
            return
        if not self.is_written:
            self.open_gap(why)
        self._restarts.append(why)
        self._earlier = dict(self._topics)
        self._report = _NO_REPORT
        self._incomplete = not self.goes_on

    def open_gap(self, why: str) -> None:
        self._returned = None
        if self._gap_is_open:
            return
        earlier = self.gaps
        since = (earlier[-1].end or 0.0) if earlier else self._place.steady_ns / NS
        begin = max(self._report.saved or 0.0, since)
        if len(earlier) == _MOST_GAPS:  # the last one includes all later ones
            begin, earlier = earlier[-1].begin, earlier[:-1]
        self.gaps = *earlier, EvidenceGap(begin, None, why)

    @property
    def _gap_is_open(self) -> bool:
        return bool(self.gaps) and self.gaps[-1].end is None

    def _close_gap(self, now: float) -> None:
        """Close the gap once all earlier topics are back, or their time to come back is over."""
        if not self._gap_is_open:
            return
        self._returned = now if self._returned is None else self._returned
        first = {t.topic: t.first for t in self._report.topics if t.first is not None}
        awaited = {t.topic for t in self._earlier.values() if t.rate and not t.durable}
        if now - self._returned <= COMES_BACK and not (first and awaited <= first.keys()):
            return
        times = [first[topic] for topic in awaited & first.keys()] or first.values()
        end = max(times, default=self._steady(now))
        self.gaps = *self.gaps[:-1], replace(self.gaps[-1], end=end)

    def _steady(self, at: float) -> float:
        """Monotonic time as s since the epoch."""
        return (self._place.steady_ns + round(at * NS) - self._place.monotonic_ns) / NS

    def merged_into(self, live: EvidenceState) -> EvidenceState:
        """What its process reports now, with all of this recording."""
        topics, problem = live.topics, live.problem
        if self.goes_on:
            topics = tuple(self._topics.get(topic.topic, topic) for topic in topics)
        elif not self._finishing and problem in self._problems_before_end:
            problem = None  # it ended this recording alone
        is_known = not self._restarts and (self.goes_on or self._is_counted)
        return replace(
            live,
            topics=topics,
            problem=problem,
            recording=self.goes_on,
            finishing=self._finishing,
            recorded=tuple(self._topics[name] for name in sorted(self._topics)),
            problems=tuple(self._problems()),
            gaps=self.gaps,
            unwritten=self._report.unwritten if is_known else None,
        )

    def _problems(self) -> Iterator[str]:
        """What was wrong with all of it, in words."""
        if number := len(self._restarts):
            times = f" {counted(number, 'time')}" if number > 1 else ""
            reasons = listed([*dict.fromkeys(self._restarts)])
            yield f"the evidence process had to be started again{times}: {reasons}"
        if self._incomplete:
            yield "its last file is not complete: `madrob recover` repairs it"
        yield from self._report.problems
        if self._reported is None:
            yield "no process was there to record it"
        elif self.ended is not None and self._finishing and not self._is_counted:
            silent = self.ended - self._reported
            if silent > QUIET:
                yield (
                    f"the evidence process said nothing in the last {silent:.0f} s of the "
                    "recording: what came then may be missing"
                )
        if self._report.ready:
            yield from self._report.missing
