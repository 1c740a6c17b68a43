"""Faults of the testbed: seen within 2 s, named, recorded, marked; none raises or blocks a stop."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count, cycle
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import Message
from madrob_console.referee.acts import SetUp, Start, ZeroHandle
from madrob_console.referee.flags import FlagKind, data_remarks, serious, undecided
from madrob_console.referee.records import CheckName, FaultKind
from recorder.bag import Durability, Qos, RawMessage
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome, Signal
from tests.madrob_console.engine.drive import TIMEOUT, FaultyDrive, make_setup
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, STRIP, Fault, edited
from tests.slowly import slow_but_for

SECOND = 1_000_000_000  # ns

SIGNALS = {DOOR: Signal.DOOR, HANDLE: Signal.HANDLE, STRIP: Signal.CW_RIGHT}
SLOW = r"\d+ of 50 messages/s missing|silent for|only one message in 2 s"
BACK = r"the stamp repeats or goes back in \d+ of \d+ messages"
OFF = r"stamps 5\.\d+ s (ahead|late)"
EMPTY = r"no reading in \d+ of \d+ messages: "
OUTSIDE = EMPTY + r"range \d: \S+ m is outside of the message's limits 0\.02\.\.4"
JUNK = r"\d+ of \d+ messages: not a (sensor|geometry)_msgs/msg/"
LARGE = r"\d+ of \d+ messages: 40\d+ bytes, not read above \d+"


class Case(NamedTuple):
    """A fault.

    Attributes:
        fault: which.
        words: a pattern that a line about it matches, behind the topic.
        mark: a pattern that a remark on the data quality matches, behind the signal or the topic.
        stopping: the topics without whose signal no run is completed.
        topics: those that can have the fault.
    """

    fault: Fault
    words: str
    mark: str
    stopping: Sequence[str] = ()
    topics: Sequence[str] = (DOOR, HANDLE, STRIP)


BLIND = (DOOR, STRIP)
DROPPED = r"\d+ duplicate, backward, wrong or missing stamps dropped"
STEPPED = r"clock steps: 1, later stamps shifted back"
WITHOUT = r"\d+ values without a reading"
CASES = (
    Case(Fault.DIES, SLOW, r"nothing in the last \d+\.\d s of the recording", BLIND),
    Case(Fault.SLOWS, SLOW, r"gaps: \d+, the longest 0\.2\d+ s"),
    Case(Fault.CRAWLS, SLOW, r"gaps: \d+, the longest 2\.5\d+ s", BLIND),
    Case(Fault.FLOODS, r"\d+ messages/s, far above 50", "uneven intervals of"),
    Case(Fault.REPEATS_STAMPS, BACK, DROPPED, BLIND),
    Case(Fault.STEPS_BACK, BACK, DROPPED),
    Case(Fault.STRAYS_BACK, BACK, "1 " + DROPPED[4:]),
    Case(Fault.STEPS_BACK_FAR, BACK, STEPPED),
    Case(Fault.STEPS_BACK_AGAIN, BACK, DROPPED, BLIND),
    Case(Fault.STEPS_BACK_FAR_AGAIN, BACK, r"clock steps: \d+"),
    Case(Fault.JUMPS_TO_AND_FRO, BACK, r"clock steps: \d+"),
    Case(Fault.AHEAD, OFF, STEPPED),
    Case(Fault.BEHIND, OFF, STEPPED),
    Case(Fault.ZERO_STAMPS, r"the stamp is missing \(0\) in \d+ of \d+", DROPPED, BLIND),
    Case(Fault.NAN, EMPTY + r".* is NaN", WITHOUT, BLIND),
    Case(Fault.PLUS_INFINITY, EMPTY + r".* is \+inf", WITHOUT, BLIND, (DOOR, HANDLE)),
    Case(Fault.EMPTY, EMPTY + r".*(empty|only 0 ranges)", WITHOUT, BLIND, BLIND),
    Case(Fault.OUT_OF_RANGE, OUTSIDE, WITHOUT, BLIND, (STRIP,)),
    Case(Fault.OTHER_TYPE, r"it sends std_msgs/msg/String, not ", "it sends std_msgs", BLIND),
    Case(Fault.TWO_PUBLISHERS, "2 publishers: keep one", "uneven intervals of", (DOOR,)),
    Case(Fault.TRUNCATED, JUNK, r"not a .*\(\d+ times\)", BLIND),
    Case(Fault.HUGE_LENGTH, JUNK, r"not a .*\(\d+ times\)", BLIND),
    Case(Fault.TOO_LARGE, LARGE, r"40\d+ bytes, not read .*\(\d+ times\)", BLIND, (HANDLE, STRIP)),
    Case(Fault.RANDOM, JUNK, "not a ", BLIND),
)
TABLE = [(topic, case) for case in CASES for topic in case.topics]


def name_of(value: object) -> str:
    return value.fault.name if isinstance(value, Case) else str(value).rpartition("/")[2]


def in_every_run(topic: str, case: Case) -> object:
    """A whole run takes its time: most are slow."""
    quick = (Fault.DIES, Fault.STEPS_BACK_FAR, Fault.BEHIND, Fault.NAN, Fault.TWO_PUBLISHERS)
    marks = () if topic == DOOR and case.fault in quick else pytest.mark.slow
    return pytest.param(topic, case, marks=marks)


@pytest.mark.parametrize(("topic", "case"), TABLE, ids=name_of)
def test_before_the_start_a_fault_fails_a_check_within_2_s_that_names_it(
    hall: FaultyDrive, topic: str, case: Case
) -> None:
    hall.set_up()
    assert hall.check(CheckName.TOPICS) == "ok: all live and at their rates"
    hall.source.spoil(topic, case.fault)
    words = f"^failed: {SIGNALS[topic].value}: .*({case.words})"
    assert hall.seen_after(lambda: hall.check(CheckName.TOPICS), words) <= 2.0
    assert SIGNALS[topic].value in str(hall.engine.perform(Start()))


@pytest.mark.parametrize(("topic", "case"), [in_every_run(*row) for row in TABLE], ids=name_of)
def test_a_fault_in_a_run_is_named_within_2_s_recorded_marked_and_blocks_no_stop(
    hall: FaultyDrive, topic: str, case: Case
) -> None:
    name = SIGNALS[topic].value
    hall.spoilt_run(topic, case.fault)
    assert hall.seen_after(hall.faults, f"{name}: .*({case.words})") <= 2.0
    result, run = hall.scored_result(), hall.engine.run
    if topic in case.stopping:
        assert (run.outcome, run.stop) == (Outcome.TIMEOUT, result.start + TIMEOUT)
    else:
        assert run.outcome is Outcome.COMPLETED
    told = data_remarks(result.quality)
    assert re.search(f"({name}|{topic}): .*{case.mark}", "\n".join(told))
    (fault, *_) = (one for one in run.faults if re.search(case.words, one.text))
    assert 3.0 <= fault.time - result.start < 5.0
    assert fault.text.startswith(f"{name}: ")
    assert len(told) < 35
    if case.fault is Fault.OTHER_TYPE:  # no bag holds two types on one topic
        lost = len(hall.handed(topic)) - len(hall.recorded(topic))
        assert f"{topic}: {lost} messages are not in the recording" in result.quality.lost
        again = hall.rescored()
        assert (again.indicators, again.events) == (result.indicators, result.events)
        assert run.unrecorded == 0  # nothing of it was scored
    else:
        assert hall.recorded(topic) == hall.handed(topic)
        assert hall.rescored() == result


def stutter(hall: FaultyDrive, seed: int) -> None:
    """From now on all comes late at times, or at once after a while; nothing overtakes."""
    chance, begin, newest = Random(seed), hall.clock.now_ns(), 0
    held = [(begin + chance.randrange(12 * SECOND), chance.randrange(SECOND)) for _ in range(3)]
    slow = [begin + chance.randrange(12 * SECOND) for _ in range(2)]

    def come(at: int) -> int:
        nonlocal newest
        late = at + 12 * SECOND // 100 * any(since <= at < since + SECOND for since in slow)
        ends = [since + lasts for since, lasts in held if since <= at < since + lasts]
        newest = max(newest, late, *ends)
        return newest

    hall.source.deliver(come)


@pytest.mark.parametrize("seed", slow_but_for(range(1, 13), 1, 4))
def test_on_a_machine_that_stutters_no_clean_run_is_flagged(hall: FaultyDrive, seed: int) -> None:
    condition = Condition.from_number(1 + 5 * (seed % 4))  # no force
    hall.count_down(make_setup(condition, countdown=1.0))
    stutter(hall, seed)
    result, run = hall.scored_result(), hall.engine.run
    assert result.outcome is Outcome.COMPLETED
    assert serious(hall.engine.snapshot().flags) == (), result.doubts
    kinds = [fault.kind for fault in run.faults]
    assert FaultKind.SKEW in kinds
    assert len(kinds) == len({*kinds})
    assert hall.rescored() == result


@pytest.mark.parametrize(
    ("topic", "begin", "lasts"),
    [
        (DOOR, 4.0, 3.0),  # it opens then
        (HANDLE, 7.0, 2.0),  # its largest force may have come then
        (STRIP, 0.5, 2.0),  # somebody may have come then
    ],
)
def test_a_topic_that_was_silent_is_flagged_once_and_doubted(
    hall: FaultyDrive, topic: str, begin: float, lasts: float
) -> None:
    hall.set_up()
    hall.begin()
    hall.wait(begin)
    hall.source.spoil(topic, Fault.DIES)
    hall.wait(lasts)
    hall.source.heal(topic)
    result, name = hall.scored_result(), SIGNALS[topic].value
    heavy = serious(hall.engine.snapshot().flags)
    assert undecided(heavy)
    (lost,) = [flag.words for flag in heavy if flag.kind is FlagKind.FAULT]
    (fault,) = hall.engine.run.faults
    told = re.sub(r"\.\d s", " s", f"{lost}; {fault.text}")
    assert re.fullmatch(rf"{name}: no sample for {lasts:.0f} s; {name}: silent for [12] s", told)
    assert hall.rescored() == result


@pytest.mark.slow
@pytest.mark.parametrize("topic", [DOOR, HANDLE, STRIP])
def test_numbers_at_the_end_of_what_a_float_holds_break_nothing(
    hall: FaultyDrive, topic: str
) -> None:
    hall.spoilt_run(topic, Fault.ENORMOUS)
    result = hall.scored_result()
    assert hall.recorded(topic) == hall.handed(topic)
    assert hall.rescored() == result
    hall.act(SetUp(make_setup(run_number=2)))
    hall.wait(1.0)
    refused = hall.engine.perform(ZeroHandle())
    assert refused == ("no handle force comes now" if topic == HANDLE else None)


@pytest.mark.slow
@given(st.sampled_from([DOOR, HANDLE, STRIP]), st.lists(st.binary(max_size=200), max_size=20))
def test_whatever_bytes_come_the_engine_goes_on_and_says_so(topic: str, junk: list[bytes]) -> None:
    hall, again = FaultyDrive(Path("no folder is needed before a start")), cycle(junk)
    hall.source.send(topic, lambda m: [structs.replace(m, data=next(again))] if junk else [])
    hall.wait(0.6)
    assert SIGNALS[topic].value in hall.faults()


def joints_before(*names: str) -> Callable[[Message], None]:
    """The door's joint behind others, which rest at 0."""

    def edit(content: Message) -> None:
        content.name = [*names, "door"]
        content.position = np.array([*(0.0 for _ in names), *content.position])

    return edit


ONE_OF_TWO = f"{DOOR}: position[0] is 'lock', one of 2 names: use position[name=...]"


def test_index_among_several_names_fails_the_check(hall: FaultyDrive) -> None:
    hall.set_up()
    hall.source.fake(DOOR, joints_before("lock"))
    words = "^failed: door angle: .*: position.0. is 'lock', one of 2 names"
    assert hall.seen_after(lambda: hall.check(CheckName.TOPICS), words) <= 2.0
    assert "one of 2 names" in str(hall.engine.perform(Start()))


def test_index_among_several_names_doubts_the_signal(hall: FaultyDrive) -> None:
    hall.set_up()
    hall.begin()
    hall.source.fake(DOOR, joints_before("lock"))
    result = hall.scored_result()
    assert result == hall.rescored()
    doubted = {name for name, one in result.indicators.items() if ONE_OF_TWO in one.doubts}
    assert IndicatorName.UNSAFETY_OF_DOOR_OPERATION in doubted
    assert IndicatorName.CAPABILITY_LEVEL in doubted
    assert IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION not in doubted


def test_other_name_behind_an_index_doubts_the_signal(hall: FaultyDrive) -> None:
    hall.set_up()
    hall.begin()
    hall.wait(2.0)
    hall.source.fake(DOOR, lambda content: setattr(content, "name", ["lock"]))
    result = hall.scored_result()
    assert result == hall.rescored()
    changed = f"{DOOR}: position[0] was 'door', then 'lock': use position[name=...]"
    doubted = {name for name, one in result.indicators.items() if changed in one.doubts}
    assert IndicatorName.UNSAFETY_OF_DOOR_OPERATION in doubted
    assert IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION not in doubted


BY_NAME = replace(DEFAULT_MAPPINGS[0], field="position[name=door]")


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[FaultyDrive]:
    """A hall whose door is found by its name, with an arm's joints on its topic."""
    hall = FaultyDrive(tmp_path / "arm", mappings=[BY_NAME, *DEFAULT_MAPPINGS[1:]])
    hall.source.spoil(DOOR, Fault.TWO_PUBLISHERS)  # its status, what comes is replaced
    numbers = count(1)

    def beside(message: RawMessage) -> list[RawMessage]:
        other = edited(message, lambda content: setattr(content, "name", ["elbow"]))
        return [other, structs.replace(message, sequence=next(numbers))]

    hall.source.replace_messages(DOOR, beside)
    yield hall
    hall.engine.close()


def test_joints_of_others_are_no_samples(arm: FaultyDrive, hall: FaultyDrive) -> None:
    for each in (arm, hall):
        each.set_up()
        assert each.check(CheckName.TOPICS).startswith("ok")
        each.begin()

    result, plain = arm.scored_result(), hall.scored_result()

    assert result == arm.rescored()
    assert {name: (one.value, one.doubts) for name, one in result.indicators.items()} == {
        name: (one.value, one.doubts) for name, one in plain.indicators.items()
    }


def test_publishers_of_the_same_joint_are_named(arm: FaultyDrive) -> None:
    arm.source.replace_messages(DOOR, lambda message: [message, message])
    arm.set_up()
    assert "2 publishers: keep one" in arm.check(CheckName.TOPICS)


def test_named_joint_that_never_comes_is_named(arm: FaultyDrive) -> None:
    arm.source.fake(DOOR, lambda content: setattr(content, "name", ["elbow"]))
    arm.wait(3.0)
    assert "door angle: no message names door" in arm.check(CheckName.TOPICS)


def test_range_outside_its_limits_fails_the_check(hall: FaultyDrive) -> None:
    hall.set_up()
    hall.source.fake(STRIP, lambda content: setattr(content, "range_max", 0.0))
    words = "passage cw right: range 3: .* m is outside of the message's limits 0.02..0"
    assert hall.seen_after(lambda: hall.check(CheckName.DOORWAY), f"^no data: .*{words}") <= 2.0


LATCH = "/madrob/door/locked"


@pytest.fixture
def changing(tmp_path: Path) -> Iterator[FaultyDrive]:
    """A hall whose latch speaks only when it changes."""
    hall = FaultyDrive(tmp_path, latch=True)
    said: list[bytes] = [b""]

    def on_change(message: RawMessage) -> list[RawMessage]:
        changed = message.data != said[-1]
        said.append(message.data)
        return [message] if changed else []

    hall.source.send(LATCH, on_change)
    yield hall
    hall.engine.close()


def keep_for_late_joiners(hall: FaultyDrive, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Qos(durability=Durability.TRANSIENT_LOCAL)
    topics = tuple(replace(topic, qos=kept) for topic in hall.source.topics())
    monkeypatch.setattr(hall.source, "topics", lambda: topics)


def test_kept_state_of_a_latch_is_recorded(
    changing: FaultyDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_for_late_joiners(changing, monkeypatch)
    changing.set_up()
    changing.begin()
    result = changing.scored_result()
    assert len(changing.recorded(LATCH)) == 1 + len(changing.handed(LATCH)) == 3
    assert (result.lock_detection, changing.engine.run.outcome) == ("sensor", Outcome.COMPLETED)
    assert result == changing.rescored()


def test_state_that_is_not_kept_is_not_recorded(changing: FaultyDrive) -> None:
    changing.set_up()
    changing.begin()
    result = changing.scored_result()
    assert changing.recorded(LATCH) == changing.handed(LATCH)
    level = result.indicators[IndicatorName.CAPABILITY_LEVEL]
    assert any(words.startswith("the latch s") for words in level.doubts)
    assert result == changing.rescored()
