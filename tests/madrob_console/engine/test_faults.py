"""Faults of the testbed: seen within 2 s, named, recorded, marked; none raises or blocks a stop."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from madrob_console.referee.acts import Start
from madrob_console.referee.on_record import CheckName
from scoring.protocol import Outcome, Signal
from tests.madrob_console.engine.faulty_source import TIMEOUT, FaultyDrive
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, STRIP, Fault

SIGNALS = {DOOR: Signal.DOOR, HANDLE: Signal.HANDLE, STRIP: Signal.CW_RIGHT}
SLOW = r"only \d+ Hz of 50 Hz|silent for|one message in 2 s"
BACK = r"the stamp repeats or goes back in \d+ of \d+ messages"
OFF = r"stamps 5\.\d+ s (ahead of|behind) their reception"
EMPTY = r"no reading in \d+ of \d+ messages: "
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
DROPPED = r"\d+ duplicate, backward or missing stamps dropped"
STEPPED = r"clock stepped by [+-]5\.000 s, later stamps shifted back"
WITHOUT = r"\d+ values without a reading"
CASES = (
    Case(Fault.DIES, SLOW, r"nothing in the last \d+\.\d s of the recording", BLIND),
    Case(Fault.SLOWS, SLOW, r"\d+ gaps, the longest 0\.2\d+ s"),
    Case(Fault.CRAWLS, SLOW, r"\d+ gaps, the longest 2\.5\d+ s", (STRIP,)),
    Case(Fault.FLOODS, r"\d+ Hz, far above 50 Hz", "uneven intervals of"),
    Case(Fault.REPEATS_STAMPS, BACK, DROPPED, BLIND),
    Case(Fault.STEPS_BACK, BACK, DROPPED),
    Case(Fault.STRAYS_BACK, BACK, "1 " + DROPPED[4:]),
    Case(Fault.STEPS_BACK_FAR, BACK, STEPPED),
    Case(Fault.STEPS_BACK_AGAIN, BACK, DROPPED, (STRIP,)),
    Case(Fault.STEPS_BACK_FAR_AGAIN, BACK, r"clock stepped \d+ times"),
    Case(Fault.JUMPS_TO_AND_FRO, BACK, r"clock stepped \d+ times"),
    Case(Fault.AHEAD, OFF, STEPPED),
    Case(Fault.BEHIND, OFF, STEPPED),
    Case(Fault.ZERO_STAMPS, r"the stamp is missing \(0\) in \d+ of \d+", DROPPED, BLIND),
    Case(Fault.NAN, EMPTY + r".* is NaN", WITHOUT, BLIND),
    Case(Fault.PLUS_INFINITY, EMPTY + r".* is \+inf", WITHOUT, BLIND, (DOOR, HANDLE)),
    Case(Fault.MINUS_INFINITY, EMPTY + r".* is -inf", WITHOUT, BLIND, (DOOR, HANDLE)),
    Case(Fault.EMPTY, EMPTY + r".*(empty|only 0 ranges)", WITHOUT, BLIND, BLIND),
    Case(Fault.OUT_OF_RANGE, EMPTY + r".* outside 0.02 to 4 m", WITHOUT, BLIND, (STRIP,)),
    Case(Fault.OTHER_TYPE, r"it sends std_msgs/msg/String, not ", "it sends std_msgs", BLIND),
    Case(Fault.TWO_PUBLISHERS, "2 publishers: keep one", "uneven intervals of", (DOOR,)),
    Case(Fault.TRUNCATED, JUNK, r"not a .*\(\d+ times\)", BLIND),
    Case(Fault.NOTHING_INSIDE, JUNK, r"not a .*\(\d+ times\)", BLIND),
    Case(Fault.HUGE_LENGTH, JUNK, r"not a .*\(\d+ times\)", BLIND),
    Case(Fault.TOO_LARGE, LARGE, r"40\d+ bytes, not read .*\(\d+ times\)", BLIND, (HANDLE, STRIP)),
    Case(Fault.RANDOM, JUNK, "not a ", BLIND),
)
TABLE = [(topic, case) for case in CASES for topic in case.topics]


def name_of(value: object) -> str:
    return value.fault.name if isinstance(value, Case) else str(value).rpartition("/")[2]


QUICK = (Fault.DIES, Fault.STEPS_BACK_FAR, Fault.BEHIND, Fault.NAN, Fault.TWO_PUBLISHERS)


def slow_but_for_some(topic: str, case: Case) -> object:
    """A whole run takes its time."""
    quick = topic == DOOR and case.fault in QUICK
    return pytest.param(topic, case, marks=() if quick else pytest.mark.slow)


@pytest.mark.parametrize(("topic", "case"), TABLE, ids=name_of)
def test_before_the_start_a_fault_fails_a_check_within_2_s_that_names_it(
    topic: str, case: Case, tmp_path: Path
) -> None:
    drive = FaultyDrive(tmp_path)
    drive.set_up()
    assert drive.check(CheckName.TOPICS) == "ok: all fresh and at rate"
    drive.faulty.spoil(topic, case.fault)
    words = f"^failed: {topic}: .*({case.words})"
    assert drive.seen_after(lambda: drive.check(CheckName.TOPICS), words) <= 2.0
    refusal = drive.engine.perform(Start())
    assert refusal is not None
    assert topic in refusal


@pytest.mark.parametrize(("topic", "case"), [slow_but_for_some(*row) for row in TABLE], ids=name_of)
def test_a_fault_in_a_run_is_named_within_2_s_recorded_marked_and_blocks_no_stop(
    topic: str, case: Case, tmp_path: Path
) -> None:
    drive = FaultyDrive(tmp_path)
    drive.spoilt_run(topic, case.fault)
    assert drive.seen_after(drive.faults, f"{topic}: .*({case.words})") <= 2.0
    result = drive.result()
    run = drive.engine.run
    assert run.start is not None
    if topic in case.stopping:
        assert (run.outcome, run.stop) == (Outcome.TIMEOUT, run.start + TIMEOUT)
    else:
        assert run.outcome is Outcome.COMPLETED
    told = "\n".join(result.quality.remarks)
    assert re.search(f"({SIGNALS[topic].value}|{topic}): .*{case.mark}", told)
    assert re.search(rf"fault at [34]\.\d s: {topic}: .*({case.words})", told)
    assert len(result.quality.remarks) < 35
    if case.fault is Fault.OTHER_TYPE:  # no bag holds two types on one topic
        lost = len(drive.handed(topic)) - len(drive.recorded(topic))
        assert f"{topic}: {lost} messages are not in the recording" in result.quality.remarks
        assert drive.rescored().indicators == result.indicators
        assert drive.rescored().events == result.events
        assert drive.engine.run.unrecorded == 0  # nothing of it was scored
    else:
        assert drive.recorded(topic) == drive.handed(topic)
        assert drive.rescored() == result
