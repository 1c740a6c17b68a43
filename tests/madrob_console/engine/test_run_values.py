"""What the core sees of the testbed and notes of a run, on values."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.event_log import KEPT_LINES, EventLog
from madrob_console.engine.core.run_faults import RunFaults
from madrob_console.engine.core.run_tracker import (
    IN_FLIGHT,
    MOST_FALSE_STARTS,
    MOST_NOTED,
    MOST_ROBOT_WORDS,
    RunTracker,
)
from madrob_console.engine.core.sensors import Sensors
from madrob_console.engine.snapshot import DoorView, HandleView, LatchView, Weight
from madrob_console.messages.codec import ROBOT_FINISHED_TOPIC, ROBOT_STARTED_TOPIC
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import FaultKind
from madrob_console.referee.records import TestbedFault as Noted
from madrob_console.referee.run import Phase, Run, begin_countdown
from madrob_console.referee.topic_health import Freshness, SensorLimits
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import RawMessage
from scoring.protocol import (
    PASSAGE_SENSORS,
    Outcome,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample
from tests.madrob_console.referee.test_acts import SETUP
from tests.scoring.clean_run import clean
from tests.scoring.runs import START as CLEAN_START

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
        ((2.0, 2.0, 2.0, 9.0), "range 3: 9.00 m is outside of the message's limits 0..2.5"),
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


def test_a_view_shows_fresh_readings_only_and_no_last_good_one() -> None:
    arrivals = [
        *steady(lambda at: door(at, 0.2), 0.0),
        *steady(handle, 0.0),
        *steady(lambda at: latch(at, engaged=True), 0.0),
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
    spoilt = [door(at / 50, 0.2 if at < -30 else math.nan) for at in range(-50, 1)]
    spoilt += [handle(at / 50, 5.0 if at < -30 else math.inf) for at in range(-50, 1)]
    unread = sensors(spoilt)
    assert (unread.door_view(NOW).angle, unread.door_view(NOW).is_open) == (None, None)
    assert unread.handle_view(NOW, 4.0, 7.0).force is None
    assert fresh.latch_view(old) == LatchView(engaged=True, freshness=Freshness.STALE)
    assert fresh.latch_view(NOW + 2.5) == LatchView(engaged=None, freshness=Freshness.LOST)
    assert sensors([]).latch_view(NOW) == LatchView(engaged=None, freshness=Freshness.NEVER)
    assert {sample.signal for sample in fresh.newest()} == {DOOR, HANDLE, LATCH}


def test_latch_that_speaks_on_change_stays_fresh() -> None:
    changes = sensors([latch(-60.0, engaged=True), latch(-30.0, engaged=False)])
    assert changes.latch_view(NOW) == LatchView(engaged=False, freshness=Freshness.FRESH)


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


def arriving(delays: Mapping[Signal, float], lock_at: float | None) -> list[Sample]:
    """A run without faults in the order of its reception; its latch, if any, speaks twice."""
    samples: list[Sample] = []
    for sample in clean():
        time = sample.time - CLEAN_START + START
        samples.append(changed(sample, time=time, log_time=time + delays[sample.signal]))
    if lock_at is not None:
        for time, engaged in ((NOW, True), (START + 4.0, False), (START + lock_at, True)):
            samples.append(LatchSample(time, time + delays[Signal.LATCH], engaged))
    return sorted(samples, key=lambda sample: sample.log_time)


def tracked(samples: Sequence[Sample], timeout: float) -> tuple[RunTracker, Run]:
    """Follow a run each 20 ms to its stop; what comes later is fed then."""
    run = begin_countdown(Run(Phase.READY, replace(SETUP, timeout=timeout)), NOW)
    tracker, waiting, now = RunTracker(RECORD, run, silence=2.0), deque(samples), NOW
    while run.phase in (Phase.COUNTDOWN, Phase.RUNNING):
        now += 0.02
        while waiting and waiting[0].log_time <= now:
            tracker.feed(waiting.popleft())
        run, _ = tracker.advance(run, now, now)
    for sample in waiting:
        tracker.feed(sample)
    return tracker, run


@given(
    before=st.floats(-0.3, 0.3),
    delays=st.fixed_dictionaries({signal: st.floats(0.0, 0.09) for signal in Signal}),
    lock_at=st.one_of(st.none(), st.floats(11.6, 13.0)),
)
@settings(max_examples=25, deadline=None)
def test_a_run_stops_live_as_in_a_rescoring(
    before: float, delays: dict[Signal, float], lock_at: float | None
) -> None:
    samples = arriving(delays, lock_at)
    again = RECORD.assessment(START)
    for sample in samples:
        again.feed(sample)
    again.release(math.inf)
    completed = again.procedure().completed
    assert completed is not None
    timeout = completed - START + before
    tracker, run = tracked(samples, timeout)
    in_time = completed <= START + timeout
    assert run.outcome is (Outcome.COMPLETED if in_time else Outcome.TIMEOUT)
    assert run.stop == (completed if in_time else START + timeout)
    assert tracker.assessment.result(run.ending)[0] == again.result(run.ending)[0]


def test_a_run_starts_at_its_time_and_a_timeout_is_judged_when_all_has_arrived() -> None:
    course = Course()
    assert course.go(4.999).phase is Phase.COUNTDOWN
    assert course.go(5.0).phase is Phase.RUNNING
    assert course.told == [(Change.RUN_STARTS, START)]
    assert course.go(304.9).timeout_at is None
    limit = START + SETUP.timeout
    assert course.go(305.0).timeout_at == limit
    assert course.run.outcome_reason == "300 s elapsed"
    assert course.go(306.0, fed=304.99 + IN_FLIGHT).phase is Phase.RUNNING
    stopped = course.go(306.0, fed=305.001 + IN_FLIGHT)
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
        (100.0, 101.4, Outcome.COMPLETED, 100.0),
        (304.5, 305.9, Outcome.COMPLETED, 304.5),  # the settle time goes beyond the timeout
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
    course.go(9.5)
    touches = [e.time for e in course.tracker.assessment.events() if "touched" in e.name]
    assert touches == [NOW + 3.0 + SETUP.countdown]


@pytest.mark.parametrize(
    ("start", "answered", "words"),
    [
        (START, START + 0.25, "the robot answered to the start 0.250 s after it"),
        (START, START + 21.0, ""),  # after the stop
        (START, None, ""),
        (None, START, ""),
    ],
)
def test_an_answer_of_the_robot_to_the_start_is_one_before_the_stop(
    start: float | None, answered: float | None, words: str
) -> None:
    run = replace(RUN, start=start, stop=START + 20.0, robot_start=answered)
    assert run.answer == words
