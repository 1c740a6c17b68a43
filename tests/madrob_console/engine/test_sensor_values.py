"""The testbed as the core sees it, on values: faults of topics, and views of sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from madrob_console.engine.core.sensors import Sensors
from madrob_console.engine.snapshot import DoorView, HandleView, LatchView
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
)
from madrob_console.referee.records import FaultKind
from madrob_console.referee.topic_health import Freshness, SensorLimits
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import RawMessage
from scoring.protocol import (
    PASSAGE_SENSORS,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

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


def test_a_view_shows_fresh_readings_only_and_no_last_good_one() -> None:
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
    spoilt = [door(at / 50, 0.2 if at < -30 else math.nan) for at in range(-50, 1)]
    spoilt += [handle(at / 50, 5.0 if at < -30 else math.inf) for at in range(-50, 1)]
    unread = sensors(spoilt)
    assert (unread.door_view(NOW).angle, unread.door_view(NOW).is_open) == (None, None)
    assert unread.handle_view(NOW, 4.0, 7.0).force is None
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
