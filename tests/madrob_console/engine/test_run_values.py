"""What the core notes of a run, on values: faults, evidence, events, its start and its stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.event_log import KEPT_LINES, EventLog
from madrob_console.engine.core.evidence_notes import EvidenceNotes
from madrob_console.engine.core.run_faults import RunFaults
from madrob_console.engine.core.run_tracker import (
    MOST_FALSE_STARTS,
    MOST_NOTED,
    MOST_ROBOT_WORDS,
    RunTracker,
)
from madrob_console.engine.snapshot import Weight
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    ROBOT_FINISHED_TOPIC,
    ROBOT_STARTED_TOPIC,
)
from madrob_console.referee.evidence_account import EvidenceGap
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import FaultKind
from madrob_console.referee.records import TestbedFault as Noted
from madrob_console.referee.run import Phase, Run, begin_countdown
from recorder.bag import RawMessage
from scoring.protocol import (
    PASSAGE_SENSORS,
    Outcome,
    Side,
    Strip,
)
from scoring.samples import DoorSample
from tests.madrob_console.engine.test_sensor_values import (
    KIND,
    NOW,
    NUMBERS,
    Arrival,
    door,
    handle,
    scan,
)
from tests.madrob_console.referee.test_acts import SETUP

SILENT = {("door angle", KIND.SILENT): "silent for 1.0 s"}

SLOW = {("door angle", KIND.SLOW): "9 of 50 messages/s missing"}

WORSE = {("door angle", KIND.SLOW): "20 of 50 messages/s missing"}

OTHER = {("handle force", KIND.SLOW): "9 of 50 messages/s missing"}

BOTH = SLOW | OTHER

Troubles = dict[tuple[str, FaultKind], str]


@pytest.mark.parametrize(
    ("course", "noted", "faults"),
    [
        ([(0.0, SILENT), (0.4, SILENT), (0.45, {})], {}, []),
        (
            [(0.0, SILENT), (0.5, SILENT), (1.0, SILENT)],
            {0.5: "door angle: silent for 1.0 s"},
            ["door angle: silent for 1.0 s"],
        ),
        (
            [(0.0, SLOW), (0.5, WORSE), (1.0, SLOW)],
            {0.5: "door angle: 20 of 50 messages/s missing, for 0.5 s"},
            ["door angle: 20 of 50 messages/s missing, for 1.0 s"],
        ),
        (
            [(0.0, SLOW), (0.5, SLOW), (0.6, {}), (5.0, SLOW), (5.2, SLOW)],
            {0.5: "door angle: 9 of 50 messages/s missing, for 0.5 s"},
            ["door angle: 9 of 50 messages/s missing, 2 times, for 0.7 s"],
        ),
        (
            [(0.0, BOTH), (0.5, BOTH)],
            {0.5: "door angle, handle force: 9 of 50 messages/s missing, for 0.5 s"},
            ["door angle, handle force: 9 of 50 messages/s missing, for 0.5 s"],
        ),
        (
            [(0.0, SLOW), (0.5, SLOW), (0.6, {}), (5.0, OTHER), (5.5, OTHER)],
            {
                0.5: "door angle: 9 of 50 messages/s missing, for 0.5 s",
                5.5: "handle force: 9 of 50 messages/s missing, for 0.5 s",
            },
            [
                "door angle: 9 of 50 messages/s missing, for 0.5 s",
                "handle force: 9 of 50 messages/s missing, for 0.5 s",
            ],
        ),
        (
            [(0.0, SLOW), (0.5, SLOW), (3.0, BOTH), (3.5, BOTH)],
            {0.5: "door angle: 9 of 50 messages/s missing, for 0.5 s"},
            ["door angle, handle force: 9 of 50 messages/s missing, 2 times, for 1.0 s"],
        ),
    ],
)
def test_a_trouble_is_noted_when_it_lasts_and_counted_up_to_the_end(
    course: list[tuple[float, Troubles]], noted: dict[float, str], faults: list[str]
) -> None:
    notes = RunFaults()
    due = {at: notes.due(troubles, NOW + at) for at, troubles in course}
    texts = {at: "; ".join(fault.text for fault in found) for at, found in due.items() if found}
    assert texts == noted
    assert [fault.text for fault in notes.all()] == faults
    first = [fault for found in due.values() for fault in found][:1]
    assert all(fault == Noted(NOW, fault.text, fault.kind) for fault in first)


def evidence(
    gaps: Sequence[EvidenceGap] = (), silent: float | None = None, problem: str = ""
) -> EvidenceState:
    topics = [
        EvidenceTopic(name, "sensor_msgs/msg/Image", problem=problem, silent_since=silent)
        for name in ("/left", "/right")
    ]
    return EvidenceState(recording=True, recorded=tuple(topics), gaps=tuple(gaps))


GAP = EvidenceGap(NOW + 2.0, None, "its process ended")

OVER = replace(GAP, end=NOW + 3.0)


@pytest.mark.parametrize(
    ("course", "words"),
    [
        ([(0.0, evidence()), (1.0, evidence())], []),
        (
            [(2.5, evidence([GAP])), (2.6, evidence([GAP])), (3.0, evidence([OVER]))],
            [
                "nothing is recorded since +2.0 s: its process ended",
                "recorded again, missing from +2.0 s to +3.0 s",
            ],
        ),
        (
            [(3.0, evidence([OVER])), (3.1, evidence([OVER]))],
            [
                "nothing is recorded since +2.0 s: its process ended",
                "recorded again, missing from +2.0 s to +3.0 s",
            ],
        ),
        (
            [(4.0, evidence(silent=NOW + 3.0)), (5.0, evidence(silent=NOW + 3.0)), (6, evidence())],
            [
                "/left, /right: silent since +3.0 s",
                "/left, /right: comes again, silent since +3.0 s",
            ],
        ),
        (
            [(at, evidence(problem="cannot be read")) for at in (0.0, 0.4, 0.5, 9.0)],
            ["/left, /right: cannot be read"],
        ),
    ],
)
def test_the_journal_says_of_the_evidence_what_begins_and_what_ends_once(
    course: list[tuple[float, EvidenceState]], words: list[str]
) -> None:
    notes = EvidenceNotes()
    assert [line for at, state in course for line in notes.due(state, NOW, NOW + at)] == words


@pytest.mark.parametrize(
    ("what", "details", "text", "weight"),
    [
        (Change.EVENT, {"event": "door_opens"}, "door opens", Weight.PLAIN),
        (Change.FALSE_START, {"event": "door_opens"}, "FALSE START: door opens", Weight.ALARM),
        (Change.WITHDRAWN, {"act": "start"}, "start withdrawn", Weight.NOTICE),
        (Change.WITHDRAWN, {}, "a line withdrawn", Weight.NOTICE),
        (Change.ROBOT_SAYS, {}, "robot says: why", Weight.NOTICE),
        (Change.RUN_STOPS, {"outcome": "timeout"}, "run stops: timeout: why", Weight.PLAIN),
        (Change.COUNTDOWN_HELD, {}, "countdown held: why", Weight.PLAIN),
    ],
)
def test_a_line_of_the_log_has_its_words_time_and_weight(
    what: Change, details: dict[str, object], text: str, weight: Weight
) -> None:
    log = EventLog()
    reason = "why" if text.endswith(": why") else ""
    for number in range(KEPT_LINES + 3):
        entry = Entry(NOW, Origin.SENSOR, what, "", reason, details | {"time": NOW + number})
        log.add_line(entry, NOW if number % 2 else None)
    last = log.lines[-2]
    assert (len(log.lines), last.number) == (KEPT_LINES, KEPT_LINES + 1)
    assert (last.time, last.relative) == (NOW + last.number, float(last.number))
    assert (last.text, last.weight, last.origin) == (text, weight, Origin.SENSOR)
    assert log.lines[-1].relative is None
    log.clear()
    assert log.lines == ()


RUN = begin_countdown(Run(Phase.READY, SETUP), NOW)

START = NOW + SETUP.countdown

RECORD = RunRecord(SETUP, 0.0, NUMBERS, DEFAULT_MAPPINGS, SourceKind.ROS, "", "1")


class Course:
    """A run that a tracker follows; all that is measured has arrived at once."""

    def __init__(self, **changes: object) -> None:
        self.run = RUN
        self.tracker = RunTracker(RECORD, RUN, silence=2.0, **changes)  # type: ignore[arg-type]
        self.told: list[tuple[Change, float | None]] = []

    def feed(self, *arrivals: Arrival) -> None:
        for _, _, sample, _ in arrivals:
            assert sample is not None
            self.tracker.feed(sample)

    def go(self, at: float, fed: float | None = None) -> Run:
        """On to a time, s after NOW."""
        until = NOW + (at if fed is None else fed)
        self.run, happened = self.tracker.advance(self.run, NOW + at, until)
        self.told += [(each.change, each.details.get("time")) for each in happened]
        return self.run

    def changes(self) -> list[Change]:
        return [change for change, _ in self.told]


def test_a_run_starts_at_its_time_and_a_timeout_is_judged_when_all_has_arrived() -> None:
    course = Course()
    assert course.go(4.999).phase is Phase.COUNTDOWN
    assert course.go(5.0).phase is Phase.RUNNING
    assert course.told == [(Change.RUN_STARTS, START)]
    assert course.go(304.9).timeout_at is None
    limit = START + SETUP.timeout
    assert course.go(305.0).timeout_at == limit
    assert course.run.outcome_reason == "300 s elapsed"
    assert course.go(306.0, fed=305.09).phase is Phase.RUNNING
    stopped = course.go(306.0, fed=305.101)
    assert (stopped.phase, stopped.outcome, stopped.stop) == (
        Phase.STOPPED,
        Outcome.TIMEOUT,
        limit,
    )
    assert course.told[1:] == [(Change.TIMEOUT_ELAPSED, limit), (Change.RUN_STOPS, limit)]


def test_a_run_that_may_not_start_yet_waits() -> None:
    course = Course(not_before=NOW + 7.0)
    assert course.go(6.9).phase is Phase.COUNTDOWN
    assert course.go(7.0).phase is Phase.RUNNING


def test_a_false_start_holds_the_countdown_and_what_was_up_before_is_none() -> None:
    course = Course(before=[DoorSample(NOW - 1, NOW - 1, 0.5)])
    course.feed(door(1.0, 0.5), handle(2.0, 50.0))
    assert course.go(2.1).held == NOW + 2.1
    assert course.changes() == [Change.FALSE_START, Change.COUNTDOWN_HELD]
    assert [mark.time for mark in course.run.false_starts] == [NOW + 2.0]
    assert course.go(9.0).phase is Phase.COUNTDOWN  # it is held
    late = Course()
    late.feed(handle(4.9, 50.0))  # it comes with the start
    assert (late.go(5.2).phase, late.run.held) == (Phase.COUNTDOWN, START)
    unjudged = Course(before=None)
    unjudged.feed(handle(2.0, 50.0))
    assert unjudged.go(2.1).false_starts == ()


def test_of_many_false_starts_a_few_are_noted() -> None:
    course = Course()
    flickering = [door(0.01 * n, 0.5 * (n % 2)) for n in range(1, 4 * MOST_FALSE_STARTS)]
    course.feed(*flickering)
    assert len(course.go(4.0).false_starts) == MOST_FALSE_STARTS
    course.feed(door(4.1, 0.5))
    assert len(course.go(4.2).false_starts) == MOST_FALSE_STARTS


def test_of_a_flickering_signal_some_events_are_noted_and_then_that_it_flickers() -> None:
    course = Course()
    course.go(5.0)
    course.feed(*(door(5.0 + 0.01 * n, 0.5 * (n % 2)) for n in range(1, 2 * MOST_NOTED)))
    course.go(30.0)
    course.feed(door(31.0, 0.5), door(31.1, 0.0))
    course.go(31.2)
    assert course.changes().count(Change.EVENT) == MOST_NOTED
    assert course.changes().count(Change.FAULT) == 1


def word(at: float, topic: str = ROBOT_STARTED_TOPIC, data: bytes = b"") -> RawMessage:
    return RawMessage(topic, "std_msgs/msg/Empty", data, 0, round((NOW + at) * 1e9))


def says(at: float, text: str) -> RawMessage:
    size = (len(text) + 1).to_bytes(4, "little")
    return word(at, ROBOT_FINISHED_TOPIC, b"\x00\x01\x00\x00" + size + text.encode() + b"\x00")


def test_a_robot_is_heard_from_the_start_on_each_word_once() -> None:
    course = Course()
    hear = course.tracker.hear_robot
    for message in (word(4.9), says(4.9, "early")):
        hear(message)
    course.go(5.0)
    assert course.changes() == [Change.RUN_STARTS]
    for message in (word(6.0), word(7.0), says(8.0, "done"), says(9.0, "done")):
        hear(message)
    assert course.go(9.1).robot_start == NOW + 6.0
    assert course.run.robot_words == "done"
    assert course.told[1:] == [(Change.ROBOT_STARTS, NOW + 6.0), (Change.ROBOT_SAYS, NOW + 8.0)]
    for unreadable in (b"\x00\x01", b"\x00\x01\x00\x00\xff\xff\xff\xff"):
        hear(word(9.5, ROBOT_FINISHED_TOPIC, unreadable))
    assert course.go(9.6).robot_words == "finished"
    for number in range(2 * MOST_ROBOT_WORDS):
        hear(says(10.0, f"word {number}"))
    course.go(11.0)
    assert course.changes().count(Change.ROBOT_SAYS) == MOST_ROBOT_WORDS


THROUGH = [
    *(door(5.5, 0.0), handle(5.5, 0.0), handle(6.0, 50.0), door(7.0, 0.5)),
    *(scan(7.5, 2.0, 2.0, 2.0, 2.0, strip=strip) for strip in Strip),
]


def passing(at: float, side: Side, there: bool) -> Arrival:
    sensor = next(s for s in PASSAGE_SENSORS if s.side is side and s.index == 2)
    ranges = [2.0] * 4
    if there:
        ranges[sensor.element] = 0.8
    return scan(at, *ranges, strip=sensor.strip)


@pytest.mark.parametrize(
    ("closed", "ends", "outcome", "stop"),
    [
        (100.0, 101.1, Outcome.COMPLETED, 100.0),
        (304.5, 305.6, Outcome.COMPLETED, 304.5),  # the settle time goes beyond the timeout
        (306.0, 307.5, Outcome.TIMEOUT, 305.0),
    ],
)
def test_a_timeout_within_the_settle_time_waits_for_its_end(
    closed: float, ends: float, outcome: Outcome, stop: float
) -> None:
    course = Course()
    course.go(5.0)
    course.feed(*THROUGH, passing(8.0, Side.CCW, there=True), passing(8.5, Side.CW, there=True))
    course.feed(passing(9.0, Side.CCW, there=False), passing(10.0, Side.CW, there=False))
    course.feed(door(closed - 0.1, 0.5), door(closed, 0.0))
    course.go(closed + 0.5)
    course.feed(door(closed + 1.05, 0.0))
    course.go(ends)
    assert (course.run.outcome, course.run.stop) == (outcome, NOW + stop)


def test_a_settle_time_whose_door_goes_silent_is_not_waited_for_without_end() -> None:
    course = Course()
    course.go(5.0)
    course.feed(*THROUGH, passing(8.0, Side.CCW, there=True), passing(8.5, Side.CW, there=True))
    course.feed(passing(9.0, Side.CCW, there=False), passing(10.0, Side.CW, there=False))
    course.feed(door(304.5, 0.5), door(304.9, 0.0))
    patience = NUMBERS.settle_time + 2.0
    assert course.go(305.0 + patience - 0.1).phase is Phase.RUNNING
    stopped = course.go(305.0 + patience)
    assert (stopped.outcome, stopped.stop) == (Outcome.TIMEOUT, NOW + 305.0)


def test_what_came_in_the_countdown_counts_after_it_began_again() -> None:
    course = Course()
    course.feed(handle(2.0, 50.0))
    course.tracker.restart(begin_countdown(course.run, NOW + 3.0), NOW + 3.0)
    course.feed(handle(9.0, 50.0))
    touches = [e.time for e in course.tracker.assessment.events() if "touched" in e.name]
    assert touches == [NOW + 3.0 + SETUP.countdown]
