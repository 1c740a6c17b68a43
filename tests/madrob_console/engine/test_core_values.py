"""The parts of the core on values: what comes, and what is shown, noted and decided of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.archive.run_journal import Unfinished
from madrob_console.archive.run_record import RunRecord
from madrob_console.common.names import SourceKind
from madrob_console.engine.core import state_view
from madrob_console.engine.core.effects import (
    Answer,
    CloseJournal,
    CloseRecording,
    Effect,
    HoldEvidence,
    KeepJournal,
    LeaveRun,
    MakeReports,
    PlainValue,
    Publish,
    ReopenJournal,
    RetryWriting,
    Score,
    WriteLine,
    WriteResult,
)
from madrob_console.engine.core.engine_config import EngineConfig, EvidencePlan
from madrob_console.engine.core.engine_core import Core
from madrob_console.engine.core.event_log import KEPT_LINES, EventLog
from madrob_console.engine.core.evidence_notes import EvidenceNotes
from madrob_console.engine.core.inputs import (
    CutOff,
    CutOffRunsListed,
    JournalReopened,
    LineWritten,
    OpenEarlierRun,
    RecordingClosed,
    RecordingOpened,
    ResultWritten,
    RunScored,
    Tick,
)
from madrob_console.engine.core.now import DiskState, TestbedState, WorkerState
from madrob_console.engine.core.run_faults import RunFaults
from madrob_console.engine.core.run_tracker import (
    MOST_FALSE_STARTS,
    MOST_NOTED,
    MOST_ROBOT_WORDS,
    RunTracker,
)
from madrob_console.engine.core.scored_run import (
    EarlierRun,
    PastRun,
    RenderedResult,
    ScoringRequest,
)
from madrob_console.engine.core.sensors import Sensors
from madrob_console.engine.core.state_view import elapsed, panel_fault, question, remaining
from madrob_console.engine.snapshot import DoorView, HandleView, LatchView, Weight
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    REFEREE_ELAPSED_TOPIC,
    REFEREE_LEVEL_TOPIC,
    REFEREE_RUNNING_TOPIC,
    ROBOT_FINISHED_TOPIC,
    ROBOT_STARTED_TOPIC,
)
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import Abort, DeclareTimeout, SetUp
from madrob_console.referee.checks import CheckState, Freshness, SensorLimits
from madrob_console.referee.evidence_account import EvidenceGap
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.lists import TeamList
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import CheckName, FaultKind
from madrob_console.referee.records import TestbedFault as Noted
from madrob_console.referee.run import Phase, Run, begin_countdown
from madrob_console.testbeds.source import Announcement, TopicStatus
from recorder.bag import RawMessage
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import (
    PASSAGE_SENSORS,
    LockDetection,
    Outcome,
    Side,
    Signal,
    Step,
    Strip,
    Thresholds,
)
from scoring.result import Ending
from scoring.signals import DoorSample, HandleSample, LatchSample, PassageSample, Sample
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.test_core import FOLDER, Values, kinds
from tests.madrob_console.referee.test_acts import SETUP


@pytest.fixture
def values() -> Values:
    return Values()


NOW = 1_700_000_000.0
NUMBERS, LIMITS = Thresholds(), SensorLimits()
TOPICS = {mapping.signal: mapping.topic for mapping in DEFAULT_MAPPINGS}
TYPES = {mapping.topic: mapping.type for mapping in DEFAULT_MAPPINGS}
DOOR, HANDLE, LATCH = Signal.DOOR, Signal.HANDLE, Signal.LATCH
CW_RIGHT = Signal.of_strip(Strip.CW_RIGHT)
Arrival = tuple[Signal, float, Sample | None, str | None]
"""Signal, time of reception in s after NOW, sample, and why it cannot be read."""


def arrives(sample: Sample, at: float) -> Arrival:
    return sample.signal, at, sample, None


def door(at: float, angle: float = 0.1, *, stamp: float | None = None) -> Arrival:
    received = NOW + at
    return arrives(DoorSample(received if stamp is None else stamp, received, angle), at)


def handle(at: float, force: float = 5.0) -> Arrival:
    return arrives(HandleSample(NOW + at, NOW + at, force), at)


def latch(at: float, engaged: bool) -> Arrival:
    return arrives(LatchSample(NOW + at, NOW + at, engaged), at)


def scan(at: float, *ranges: float, strip: Strip = Strip.CW_RIGHT) -> Arrival:
    return arrives(PassageSample(NOW + at, NOW + at, strip, ranges, 0.0, 2.5), at)


def unreadable(at: float, words: str) -> Arrival:
    return DOOR, at, None, f"{TOPICS[DOOR]}: {words}"


def steady(make: Callable[[float], Arrival], until: float, rate: float = 50.0) -> list[Arrival]:
    """Three seconds of a topic at its rate, up to a time."""
    return [make(until - number / rate) for number in range(round(3 * rate), -1, -1)]


def sensors(arrivals: Sequence[Arrival]) -> Sensors:
    watching = Sensors(DEFAULT_MAPPINGS, NUMBERS, LIMITS)
    for signal, at, sample, error in arrivals:
        topic = TOPICS[signal]
        message = RawMessage(topic, TYPES[topic], b"", 0, round((NOW + at) * 1e9))
        watching.receive(message, sample, error)
    return watching


def status(signal: Signal = DOOR, **changes: object) -> TopicStatus:
    plain = TopicStatus(TOPICS[signal], TYPES[TOPICS[signal]], 1)
    return replace(plain, **changes)  # type: ignore[arg-type]


def skewed(seconds: float) -> list[Arrival]:
    return steady(lambda at: door(at, stamp=NOW + at + seconds), 0.0)


KIND = FaultKind
MIXED = [door(at, math.nan if number % 3 else 0.1) for number, (_, at, _, _) in
         enumerate(steady(door, 0.0))]  # fmt: skip


@pytest.mark.parametrize(
    ("arrivals", "statuses", "faults"),
    [
        pytest.param([], [], {KIND.NEVER_SEEN: "silent, no publisher"}, id="nobody"),
        pytest.param([], [status()], {KIND.NEVER_SEEN: "silent"}, id="it says nothing"),
        pytest.param(
            [],
            [status(publishers=0)],
            {KIND.NEVER_SEEN: "silent, no publisher"},
            id="its publisher has gone",
        ),
        pytest.param(
            [], [status(problem="other type")], {KIND.SOURCE: "other type"}, id="it is known why"
        ),
        pytest.param(
            steady(door, 0.0),
            [status(publishers=2, problem="other type")],
            {KIND.SOURCE: "other type", KIND.SEVERAL_PUBLISHERS: "2 publishers: keep one"},
            id="two publishers",
        ),
        pytest.param(steady(door, 0.0), [status()], {}, id="as it should be"),
        pytest.param(steady(door, -0.3), [], {}, id="a little old"),
        pytest.param(steady(door, -0.75), [], {KIND.SILENT: "silent for 0.8 s"}, id="silent"),
        pytest.param([door(0.0)], [], {}, id="the first message"),
        pytest.param(
            [door(-3.0), door(0.0)], [], {KIND.SLOW: "only one message in 2 s"}, id="one in 2 s"
        ),
        pytest.param(
            steady(door, 0.0, 25), [], {KIND.SLOW: "25 of 50 messages/s missing"}, id="half"
        ),
        pytest.param(steady(door, 0.0, 42), [], {}, id="nearly all"),
        pytest.param(steady(door, 0.0, 140), [], {}, id="many"),
        pytest.param(
            steady(door, 0.0, 160), [], {KIND.FLOOD: "160 messages/s, far above 50"}, id="a flood"
        ),
        pytest.param(
            [*steady(door, -0.02), unreadable(0.0, "too short " + "x " * 200)],
            [],
            {KIND.UNREADABLE: "1 of 101 messages: too short " + "x " * 53 + "..."},
            id="cannot be read",
        ),
        pytest.param(
            MIXED,
            [],
            {KIND.NO_READING: "no reading in 67 of 101 messages: angle is NaN or empty"},
            id="NaN",
        ),
        pytest.param([*steady(door, -0.02), door(0.0, math.nan)], [], {}, id="one NaN"),
        pytest.param(
            steady(lambda at: door(at, -2.5), 0.0),
            [],
            {
                KIND.NO_READING: "no reading in 101 of 101 messages: "
                "angle -2.5 rad is impossible, beyond +-1.75 rad"
            },
            id="impossible",
        ),
        pytest.param(
            steady(lambda at: door(at, -math.inf), 0.0),
            [],
            {KIND.NO_READING: "no reading in 101 of 101 messages: angle is -inf"},
            id="infinite",
        ),
        pytest.param(
            [*steady(door, -0.02), door(0.0, stamp=0.0)],
            [],
            {KIND.STAMPS: "the stamp is missing (0) in 1 of 101 messages"},
            id="no stamp",
        ),
        pytest.param(
            [*steady(door, -0.02), door(0.0, stamp=NOW - 0.02)],
            [],
            {KIND.STAMPS: "the stamp repeats or goes back in 1 of 101 messages"},
            id="a stamp twice",
        ),
        pytest.param(
            [*steady(lambda at: door(at + 100.0), 0.0), *steady(door, 0.0)],
            [],
            {},
            id="the clock was stepped back",
        ),
        pytest.param(skewed(0.09), [], {}, id="a little ahead"),
        pytest.param(skewed(0.2), [], {KIND.SKEW: "stamps 0.20 s ahead"}, id="ahead"),
        pytest.param(skewed(-0.2), [], {KIND.SKEW: "stamps 0.20 s late"}, id="late"),
    ],
)
def test_what_is_wrong_with_a_topic_is_named_with_its_numbers(
    arrivals: list[Arrival], statuses: list[TopicStatus], faults: dict[FaultKind, str]
) -> None:
    watching = sensors(arrivals)
    found = watching.faults(statuses, NOW)
    of_door = {kind: words for (name, kind), words in found.items() if name == DOOR.value}
    assert of_door == faults
    assert (LATCH.value, KIND.NEVER_SEEN) not in found  # it is optional
    shown = next(v for v in watching.topics(statuses, {TOPICS[DOOR]: 3}, NOW))
    assert shown.topic == TOPICS[DOOR]
    assert shown.problem == ("; ".join(faults.values()) or None)
    assert (shown.received, shown.dropped, shown.optional) == (len(arrivals), 3, False)
    assert shown.publishers == (statuses[0].publishers if statuses else 0)
    assert shown.lost == (0 if statuses else None)
    lines = watching.topic_faults(statuses, NOW)
    assert all(any(words in line for line in lines) for words in faults.values())


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ((2.0,) * 4, None),
        ((2.0, 2.0, 2.0, math.inf), None),
        ((2.0, 2.0, 2.0, math.nan), "range 3 is NaN"),
        ((2.0, 2.0, 2.0, 9.0), "range 3 is 9 m, outside 0 to 2.5 m"),
        ((2.0, 2.0), "only 2 ranges of 4"),
    ],
)
def test_of_a_strip_only_the_ranges_that_are_used_must_be_readings(
    ranges: tuple[float, ...], words: str | None
) -> None:
    watching = sensors(steady(lambda at: scan(at, *ranges), 0.0))
    found = watching.faults((), NOW).get((CW_RIGHT.value, KIND.NO_READING))
    assert found == (words and f"no reading in 101 of 101 messages: {words}")


def test_a_sensor_under_the_panel_needs_no_reading() -> None:
    angle = -0.2
    under = [s for s in PASSAGE_SENSORS if NUMBERS.masked(s.side, s.index, angle)]
    assert under
    strip = under[0].strip
    ranges = [2.0] * 4
    for sensor in under:
        if sensor.strip is strip:
            ranges[sensor.element] = math.nan
    plain = steady(lambda at: scan(at, *ranges, strip=strip), 0.0)
    name = Signal.of_strip(strip).value
    open_door = sensors([*steady(lambda at: door(at, angle), 0.0), *plain])
    assert (name, KIND.NO_READING) not in open_door.faults((), NOW)
    assert (name, KIND.NO_READING) in sensors(plain).faults((), NOW)


def test_a_view_shows_fresh_values_only() -> None:
    arrivals = [
        *steady(lambda at: door(at, 0.2), 0.0),
        *steady(handle, 0.0),
        *(latch(at, engaged=True) for at in (-1.0, 0.0)),
    ]
    fresh, old = sensors(arrivals), NOW + 1.0
    door_view, handle_view = fresh.door_view(NOW), fresh.handle_view(NOW, 4.0, 7.0)
    assert replace(door_view, recent=()) == DoorView(
        0.2, is_open=True, freshness=Freshness.FRESH, closed_angle=NUMBERS.closed_angle
    )
    assert door_view.recent
    assert replace(handle_view, recent=()) == HandleView(
        5.0, 4.0, NUMBERS.touch_force, 7.0, Freshness.FRESH
    )
    assert handle_view.recent
    assert fresh.latch_view(NOW) == LatchView(engaged=True, freshness=Freshness.FRESH)
    stale = fresh.door_view(old)
    assert (stale.angle, stale.is_open, stale.freshness) == (None, None, Freshness.STALE)
    assert fresh.handle_view(old, 4.0, None).force is None
    assert fresh.latch_view(old) == LatchView(engaged=True, freshness=Freshness.STALE)
    assert fresh.latch_view(NOW + 2.5) == LatchView(engaged=None, freshness=Freshness.LOST)
    assert sensors([]).latch_view(NOW) == LatchView(engaged=None, freshness=Freshness.NEVER)
    assert {sample.signal for sample in fresh.newest()} == {DOOR, HANDLE, LATCH}


def test_what_is_under_a_sensor_is_shown_with_its_height() -> None:
    used = next(s for s in PASSAGE_SENSORS if s.strip is Strip.CW_RIGHT)
    ranges = [2.0] * 4
    ranges[used.element] = 0.8
    shut = [door(-0.02, 0.0), door(0.01, 0.0)]  # a reading waits for the angle at its time
    whole = [scan(-0.01, *(2.0,) * 4, strip=strip) for strip in Strip]
    seen = sensors([shut[0], *whole, scan(0.0, *ranges), shut[1]])
    view = {(v.side, v.index): v for v in seen.passage_view(NOW)}
    shown = view[used.side, used.index]
    assert (shown.occupied, shown.masked) == (True, False)
    assert shown.height == pytest.approx(NUMBERS.lintel_height - 0.8)
    other = view[Side.CCW, used.index]
    assert (other.occupied, other.freshness) == (False, Freshness.FRESH)
    assert seen.occupied(NOW) == (f"{used.side} {used.index}",)
    assert sensors([shut[0], *whole, shut[1]]).occupied(NOW) == ()
    assert sensors([shut[0], *whole[1:], shut[1]]).occupied(NOW) is None
    for late in seen.passage_view(NOW + 1.0):
        assert (late.occupied, late.height) == (None, None)
    assert seen.occupied(NOW + 1.0) is None


@pytest.mark.parametrize(
    ("arrivals", "samples"),
    [
        ([], None),
        (steady(handle, 0.0), 51),
        (steady(handle, -0.6), None),
        ([handle(-0.3), handle(-0.1), handle(0.0)], None),  # it has just begun
        (steady(lambda at: handle(at, 1e9), 0.0), None),  # no reading
        ([*steady(lambda at: handle(at + 50.0), 0.0), *steady(handle, 0.0)], 51),
    ],
)
def test_the_handle_rests_by_the_readings_of_the_last_second(
    arrivals: list[Arrival], samples: int | None
) -> None:
    rest = sensors(arrivals).handle_rest(NOW)
    assert (rest and rest.number) == samples
    assert rest is None or (rest.mean, rest.span) == (5.0, 0.0)


def test_the_skew_is_that_of_the_topic_that_is_farthest_off_with_its_sign() -> None:
    both = [*skewed(0.05), *steady(handle, 0.0)]
    both += [arrives(HandleSample(NOW - 0.3, NOW, 5.0), 0.0)]
    watching = sensors(both)
    assert watching.skew(NOW) == pytest.approx(-0.3)
    assert watching.skew(NOW, min) == pytest.approx(0.05)  # no stray stamp decides
    assert sensors([]).skew(NOW) is None


# ---------------------------------------------------------------- faults of a run


SILENT = {("door angle", KIND.SILENT): "silent for 1.0 s"}
SLOW = {("door angle", KIND.SLOW): "9 of 50 messages/s missing"}
WORSE = {("door angle", KIND.SLOW): "20 of 50 messages/s missing"}
BOTH = SLOW | {("handle force", KIND.SLOW): "9 of 50 messages/s missing"}
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


# ---------------------------------------------------------------- a run, sample by sample


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


# ---------------------------------------------------------------- what is shown of a run


COUNTING, RUNNING = RUN, replace(RUN, phase=Phase.RUNNING)
HELD = replace(RUN, held=NOW + 2.0)
DONE = replace(RUN, phase=Phase.STOPPED, stop=START + 20.0)


@pytest.mark.parametrize(
    ("run", "at", "since", "left"),
    [
        (Run(), 3.0, None, None),
        (COUNTING, 3.0, -2.0, 2.0),
        (COUNTING, 6.0, 1.0, 0.0),
        (HELD, 4.0, -3.0, 3.0),
        (RUNNING, 15.0, 10.0, 290.0),
        (RUNNING, 400.0, 395.0, 0.0),
        (DONE, 400.0, 20.0, None),
    ],
)
def test_the_clock_of_a_run_goes_stands_and_stops_with_it(
    run: Run, at: float, since: float | None, left: float | None
) -> None:
    assert (elapsed(run, NOW + at), remaining(run, NOW + at)) == (since, left)


def judged(lock: LockDetection, closed: bool) -> Procedure:
    steps = tuple(
        StepRecord(step, step.text, final=NOW if closed and step <= Step.CLOSE else None)
        for step in Step
    )
    return Procedure(steps, settling=False, lock_detection=lock)


SILENT_LATCH = "the latch sensor is silent: confirm or deny steps 2 and 6"
CLOSED = "the door is closed: confirm step 6 once it is locked"
HEARD = LatchView(engaged=True, freshness=Freshness.FRESH)


@pytest.mark.parametrize(
    ("run", "lock", "closed", "latch_view", "words"),
    [
        (RUNNING, LockDetection.SENSOR, False, replace(HEARD, freshness=LOST), SILENT_LATCH)
        for LOST in (Freshness.LOST, Freshness.NEVER)
    ]
    + [
        (RUNNING, LockDetection.SENSOR, True, HEARD, None),
        (RUNNING, LockDetection.REFEREE, True, HEARD, CLOSED),
        (RUNNING, LockDetection.REFEREE, False, HEARD, None),
        (RUNNING, LockDetection.SETTLE, True, HEARD, None),
        (DONE, LockDetection.REFEREE, True, HEARD, None),
    ],
)
def test_the_referee_is_asked_what_no_sensor_can_tell(
    run: Run, lock: LockDetection, closed: bool, latch_view: LatchView, words: str | None
) -> None:
    assert question(run, judged(lock, closed), latch_view) == words
    assert question(run, None, latch_view) is None


@pytest.mark.parametrize(
    ("side", "angle", "words"),
    [
        (Side.CCW, -0.04, "panel at -0.040 rad, against the opening side"),
        (Side.CCW, 0.04, None),
        (Side.CCW, -0.02, None),
        (Side.CW, 0.04, "panel at +0.040 rad, against the opening side"),
        (Side.CW, -0.04, None),
        (Side.CW, None, None),
    ],
)
def test_a_panel_against_the_opening_side_is_a_fault(
    side: Side, angle: float | None, words: str | None
) -> None:
    setup = replace(SETUP, condition=replace(SETUP.condition, opening_side=side))
    view = DoorView(angle, True, Freshness.FRESH, NUMBERS.closed_angle)
    assert panel_fault(view, replace(RUN, setup=setup)) == words
    assert panel_fault(view, Run()) is None


SIMULATED = Announcement("by a node", "two announce it")


@pytest.mark.parametrize(
    ("run", "announced", "words"),
    [
        (
            RUNNING,
            SIMULATED,
            "the testbed is simulated (by a node): void this run after its stop",
        ),
        (RUNNING, replace(SIMULATED, simulated=None), "two announce it"),
        (replace(RUNNING, setup=replace(SETUP, practice=True)), SIMULATED, "two announce it"),
        (
            replace(RUNNING, setup=replace(SETUP, competition="REHEARSAL Cup")),
            SIMULATED,
            "two announce it",
        ),
        (Run(), SIMULATED, "two announce it"),
        (DONE, SIMULATED, "two announce it"),
    ],
)
def test_an_official_run_on_a_simulated_testbed_is_to_be_voided(
    run: Run, announced: Announcement, words: str
) -> None:
    assert state_view.testbed_problem(announced, run) == words


def test_evidence_waits_while_the_disk_does_and_what_was_refused_is_tried_again(
    values: Values,
) -> None:
    def kinds_after(seconds: float, silent: float) -> list[Effect]:
        values.now = replace(
            values.now,
            time=values.now.time + seconds,
            workers=replace(values.now.workers, recorder_silent=silent),
        )
        return [*values.core.step(Tick(), values.now)]

    values.ready()
    kinds_after(10.0, 0.0)
    assert kinds_after(0.2, 0.6) == []
    assert kinds_after(0.2, 0.61) == [HoldEvidence(True)]
    assert kinds_after(0.2, 0.7) == []
    assert kinds_after(0.2, 0.0) == [HoldEvidence(False)]
    assert kinds_after(0.65, 0.0) == []
    assert kinds_after(0.1, 0.0) == [RetryWriting(results=True)]
    assert kinds_after(1.4, 0.0) == []
    assert kinds_after(-5.0, 0.0) == [RetryWriting(results=True)]  # the clock was stepped back
    assert kinds_after(0.05, 0.7) == []  # looked at ten times a second


def test_what_robots_read_is_published_when_it_changes_and_for_each_run(values: Values) -> None:
    def published(effects: Sequence[Effect]) -> list[tuple[str, bool | float]]:
        plain = [e.what for e in effects if isinstance(e, Publish)]
        return [(p.topic, p.value) for p in plain if isinstance(p, PlainValue)]

    first = values.do(SetUp(make_setup()))
    assert published(first) == [(REFEREE_RUNNING_TOPIC, False), (REFEREE_LEVEL_TOPIC, 0)]
    assert published(values.take(Tick(), 0.5)) == []
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    countdown = make_setup().countdown
    assert published(values.take(Tick(), countdown - 0.1)) == []
    assert published(values.take(Tick(), 0.1)) == [
        (REFEREE_RUNNING_TOPIC, True),
        (REFEREE_ELAPSED_TOPIC, 0.0),
    ]
    assert published(values.take(Tick(), 0.05)) == []
    assert published(values.take(Tick(), 0.1)) == [(REFEREE_ELAPSED_TOPIC, 0.1)]
    assert published(values.do(Abort("stop"))) == [(REFEREE_RUNNING_TOPIC, False)]


# ---------------------------------------------------------------- a whole run, effect by effect


def stopped_by_timeout(values: Values) -> Run:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    values.take(Tick(), make_setup().countdown)
    declared = [e for e in values.do(DeclareTimeout("gave up")) if isinstance(e, WriteLine)]
    values.take(LineWritten(declared[0].entry.id, None))
    values.take(Tick(), 0.2)
    run = values.core.current_run.run
    assert (run.phase, run.outcome) == (Phase.STOPPED, Outcome.TIMEOUT)
    return run


def rendered(request: ScoringRequest) -> RenderedResult:
    run, assessment = request.run, request.assessment
    assert run.outcome is not None
    assert assessment is not None
    result, _ = assessment.result(Ending(run.outcome, run.outcome_reason, run.stop), run.rulings)
    past = PastRun.of(run, assessment, run.stop)
    return RenderedResult(request.record, run, result, past, {}, memoryview(b""))


def carried_out(effects: Sequence[Effect]) -> list[Effect]:
    """Without lines and what is published: the silent testbed has faults."""
    return [e for e in effects if not isinstance(e, WriteLine | Publish)]


def scoring(effects: Sequence[Effect]) -> ScoringRequest:
    (wanted,) = (effect for effect in effects if isinstance(effect, Score))
    return wanted.request


def test_after_a_stop_each_step_waits_for_the_one_before_it(values: Values) -> None:
    stopped_by_timeout(values)
    core, state = values.core, values.core.current_run.state
    assert core.records
    assert carried_out(values.take(Tick(), 0.9)) == []
    values.now = replace(values.now, unjudged=1)
    assert carried_out(values.take(Tick(), 0.1)) == []  # what is recorded is judged first
    assert not core.records
    values.now = replace(values.now, unjudged=0)
    assert carried_out(values.take(Tick())) == [CloseRecording()]
    assert (state.recording, state.closing) == (False, True)
    effects = values.take(RecordingClosed(("evidence",), 0))
    request = scoring(effects)
    assert (request.folder, request.missing, request.stored) == (FOLDER, ("evidence",), False)
    assert request.run.issue == 1
    assert (state.closing, state.result.is_missing, state.result.is_settled) == (False, True, False)
    assert core.situation(values.now).scored is False

    scored = rendered(request)
    assert values.take(RunScored(replace(request), scored)) == []  # not what is awaited
    (writing,) = values.take(RunScored(request, scored))
    assert writing == WriteResult(request, scored, state.lines.entries)
    assert values.take(ResultWritten(replace(request, folder=Path("x")), scored, {}, None)) == []
    written = values.take(ResultWritten(request, scored, {"issue": 1}, None))
    assert kinds(written) == ["WriteLine", "Entry", "MakeReports"]
    assert MakeReports(FOLDER) in written
    assert state.result.is_settled
    assert state.result.indicators == scored.result.indicators
    assert core.situation(values.now).scored is True
    left = [e for e in values.do(SetUp(make_setup())) if isinstance(e, LeaveRun)]
    assert [(e.folder, e.scored, e.problem) for e in left] == [(FOLDER, scored, None)]
    assert core.current_run.state.result.scored is None


def test_a_result_that_the_disk_refuses_is_shown_and_said_to_be_in_memory_only(
    values: Values,
) -> None:
    stopped_by_timeout(values)
    values.take(Tick(), 1.0)
    effects = values.take(RecordingClosed((), 3))
    told = [e.entry for e in effects if isinstance(e, WriteLine)]
    assert [(e.what, e.details) for e in told] == [(Change.UNRECORDED, {"messages": 3})]
    assert values.core.current_run.run.unrecorded == 3
    request = scoring(effects)
    scored = rendered(request)
    values.take(RunScored(request, scored))
    assert values.take(ResultWritten(request, scored, {}, "no room")) == []
    shown = values.core.snapshot(values.now)
    assert "the result is NOT on disk: no room" in shown.faults
    assert (shown.result, shown.rescoring) == (scored.result, False)
    assert (shown.folder, shown.opened) == (str(FOLDER), False)
    again = values.core.step(Tick(), replace(values.now, time=values.now.time + 2))
    assert RetryWriting(results=True) in again
    wanted = scoring(again)  # files that could not be read may be readable now
    assert not values.core.snapshot(values.now).rescoring
    late = replace(values.now, monotonic=values.now.monotonic + 0.31)
    assert values.core.snapshot(late).rescoring
    (writing,) = values.take(RunScored(wanted, scored))
    assert isinstance(writing, WriteResult)


def test_a_run_that_is_cut_off_is_closed_at_once_and_says_why(values: Values) -> None:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    effects = values.take(CutOff("the engine ended"))
    run = values.core.current_run.run
    assert (run.outcome, run.outcome_reason) == (Outcome.INTERRUPTED, "the engine ended")
    assert run.stop == values.now.time
    assert CloseRecording() in effects
    assert not values.core.records
    assert values.take(CutOff("again")) == []


def earlier_run(run: Run, *, out_of_date: bool = False) -> EarlierRun:
    assessment = RECORD.assessment(START)
    ending = run.ending if run.outcome else Ending(Outcome.INTERRUPTED, "cut off", None)
    result, _ = assessment.result(ending)
    past = PastRun.of(run, assessment, run.stop)
    scored = RenderedResult(RECORD, run, result, past, {}, memoryview(b""))
    lines = (Entry(NOW, Origin.REFEREE, "start"), Entry(NOW + 50.0, Origin.SYSTEM, "line"))
    return EarlierRun(Path("results/earlier"), lines, scored, out_of_date)


TIMED_OUT = replace(RUNNING, timeout_at=NOW + 40.0, outcome_reason="gave up")
COMPLETED = replace(DONE, outcome=Outcome.COMPLETED, outcome_reason="done", issue=2)
FAILED = "the program or the machine failed"


@pytest.mark.parametrize(
    ("run", "out_of_date", "invalid", "outcome", "files"),
    [
        (COMPLETED, False, False, (Outcome.COMPLETED, DONE.stop, "done", 2), None),
        (COMPLETED, True, False, (Outcome.COMPLETED, DONE.stop, "done", 2), True),
        (
            replace(COMPLETED, issue=0),
            *(False, False, (Outcome.COMPLETED, DONE.stop, "done", 1), False),
        ),
        (RUNNING, False, False, (Outcome.INTERRUPTED, NOW + 50.0, FAILED, 1), True),
        (RUNNING, False, True, (Outcome.ABORTED, NOW + 50.0, FAILED, 1), True),
        (TIMED_OUT, False, False, (Outcome.TIMEOUT, NOW + 40.0, "gave up", 1), True),
        (TIMED_OUT, False, True, (Outcome.ABORTED, NOW + 50.0, FAILED, 1), True),
    ],
)
def test_an_earlier_run_is_opened_as_it_was_and_a_cut_off_one_is_ended(
    values: Values,
    run: Run,
    out_of_date: bool,
    invalid: bool,
    outcome: tuple[Outcome, float, str, int],
    files: bool | None,
) -> None:
    earlier = earlier_run(run, out_of_date=out_of_date)
    request = OpenEarlierRun(7, earlier, invalid, values.core.current_run.generation)
    assert carried_out(values.take(request)) == [ReopenJournal(request)]
    effects = carried_out(values.take(JournalReopened(request, None, late=False)))
    opened, state = values.core.current_run.run, values.core.current_run.state
    assert (opened.outcome, opened.stop, opened.outcome_reason, opened.issue) == outcome
    assert (state.folder, state.opened, state.recording) == (earlier.folder, earlier, False)
    assert [type(e) for e in effects][:2] == [LeaveRun, KeepJournal]
    assert Answer(7, None) in effects
    if files is None:
        assert state.result.scored is earlier.scored
        assert not any(isinstance(e, Score) for e in effects)
    else:
        wanted = scoring(effects)
        assert (wanted.files, wanted.stored, wanted.folder) == (files, True, earlier.folder)
    assert values.core.snapshot(values.now).opened


@pytest.mark.parametrize(
    ("problem", "late", "generations", "answer", "closes"),
    [
        ("it is open elsewhere", False, 0, "it is open elsewhere", []),
        (None, True, 0, "the disk took more than 2 s: try again", [CloseJournal]),
        (None, False, 1, "was set up meanwhile, and stays", [CloseJournal]),
    ],
)
def test_an_earlier_run_that_cannot_be_opened_any_more_replaces_nothing(
    values: Values,
    problem: str | None,
    late: bool,
    generations: int,
    answer: str,
    closes: list[type[Effect]],
) -> None:
    generation = values.core.current_run.generation
    request = OpenEarlierRun(7, earlier_run(COMPLETED), False, generation)
    values.take(request)
    for _ in range(generations):
        values.ready()
    before = values.core.current_run.run
    effects = values.take(JournalReopened(request, problem, late))
    assert [type(e) for e in carried_out(effects)] == [*closes, Answer]
    assert answer in str(effects[-1])
    assert values.core.current_run.run == before


def test_what_came_in_the_countdown_counts_after_it_began_again() -> None:
    course = Course()
    course.feed(handle(2.0, 50.0))
    course.tracker.restart(begin_countdown(course.run, NOW + 3.0), NOW + 3.0)
    course.feed(handle(9.0, 50.0))
    touches = [e.time for e in course.tracker.assessment.events() if "touched" in e.name]
    assert touches == [NOW + 3.0 + SETUP.countdown]


def test_what_is_shown_and_checked_is_what_is_known(values: Values) -> None:
    plan = EvidencePlan(10**9, 60.0)
    config = EngineConfig(
        *(Path("results"), DEFAULT_MAPPINGS, 5),
        competition="Autumn Cup",
        testbed="Hall A",
        evidence=plan,
    )
    values.core = core = Core(config, MessageTypes())
    arrivals = [*skewed(-0.2), *steady(lambda at: handle(at, 3.0), 0.0)]
    for signal, at, sample, error in arrivals:
        message = RawMessage(TOPICS[signal], "", b"", 0, round((NOW + at) * 1e9))
        core.observation.sensors.receive(message, sample, error)
    seen = evidence(problem="cannot be read")
    testbed = TestbedState(
        SourceKind.ROS,
        "hall",
        (status(publishers=2),),
        Announcement(simulated_time=1.0),
        other_referee="node b",
        robot_problems={"/robot": "two robots"},
    )
    cut_off = Unfinished("x", 3, "", 1, 1, Phase.RUNNING, None, None, "", 0)
    values.now = now = replace(
        values.now,
        time=NOW,
        taken=NOW,
        judged=NOW,
        testbed=testbed,
        workers=WorkerState(evidence=seen, scoring="it is late", dropped={TOPICS[DOOR]: 4}),
        disk=DiskState(free=3, problem="", journal_problem="no room", late_runs=("run 1",)),
        behind="the engine is behind",
        teams=TeamList({3: "Delft"}),
    )
    values.take(CutOffRunsListed((cut_off,)))
    shown = core.snapshot(now, others=["a", None])
    assert (shown.source_kind, shown.source_label, shown.time) == (SourceKind.ROS, "hall", NOW)
    assert (shown.competition, shown.testbed, shown.evidence) == ("Autumn Cup", "Hall A", seen)
    assert (shown.teams, shown.unfinished, shown.disk_free) == (now.teams, (cut_off,), 3)
    assert (shown.folder, shown.opened, shown.result, shown.result_source) == (
        *(None, False, None, None),
    )
    view = next(v for v in shown.topics if v.topic == TOPICS[DOOR])
    assert (view.publishers, view.dropped) == (2, 4)
    assert list(shown.faults)[:3] == ["no room", "it is late", "run 1"]
    assert {"another referee: node b", "the engine is behind", "/robot: two robots", "a"} < set(
        shown.faults
    )
    checks = {check.name: check for check in shown.checks}
    assert checks[CheckName.DISK].reason == "make room on the disk: 3 B free, 5 B needed"
    assert checks[CheckName.EVIDENCE].state is CheckState.NO_DATA
    assert checks[CheckName.HANDLE].finding == "not yet done since the engine started"
    assert checks[CheckName.CLOCK].state is CheckState.FAILED
    assert checks[CheckName.REFEREE].finding == "node b"
    assert core.situation(now).rest_force == NUMBERS.touch_force / 2
    assert core.situation(now).refused == "no room"
