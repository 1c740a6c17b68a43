from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.common.clock import NS
from madrob_console.engine.runtime.backlog import CAPACITY, LATEST, Backlog
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.acts import Abort, DeclareTimeout, Start
from madrob_console.referee.run import Phase
from recorder.bag import RawMessage
from scoring.protocol import Outcome, Signal
from tests.madrob_console.engine.drive import STEP, TIMEOUT, Drive, FaultyDrive, make_setup


class Looking:
    """Who looks at messages, and a monotonic clock that each of them moves on by what it takes."""

    def __init__(self, cost: float = 0.0) -> None:
        self.now = 100.0
        self.cost = cost
        self.seen: list[tuple[int, bool, bool]] = []
        self.backlog = Backlog(self.observe, lambda: self.now)

    def observe(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        self.now += self.cost
        self.seen.append((message.receive_ns, recorded, shown))

    def add(self, count: int, first: int = 0, size: int = 1, *, recorded: bool = False) -> None:
        numbers = range(first, first + count)
        messages = [RawMessage("/t", "t", bytes(size), n, n) for n in numbers]
        self.backlog.add_messages(messages, recorded=recorded)


@pytest.mark.parametrize(
    ("cost", "waits", "seen"),
    [(0.0, True, 1), (0.0, False, 9), (0.015, False, 2)],
    ids=[
        "its owner has a turn when it wants one",
        "else it goes on",
        "but for no longer than this",
    ],
)
def test_between_two_messages_its_owner_may_have_a_turn(
    cost: float, waits: bool, seen: int
) -> None:
    looking = Looking(cost)
    looking.add(9, recorded=True)
    looking.backlog.work_off(lambda: waits)
    assert looking.seen == [(number, True, True) for number in range(seen)]
    assert len(looking.backlog) == looking.backlog.recorded == 9 - seen


def test_what_is_late_is_judged_but_not_shown_and_that_is_said_for_a_while() -> None:
    looking = Looking(cost=0.1)
    backlog = looking.backlog
    looking.add(10, recorded=True)
    while len(backlog):
        backlog.work_off(lambda: False)
    assert looking.seen == [(number, True, number < 6) for number in range(10)]
    assert "4 messages are recorded but not shown" in str(backlog.problem)
    looking.now += 2.1
    assert backlog.problem is None
    looking.cost = 1.0
    looking.add(5)
    backlog.work_off()
    assert [shown for *_, shown in looking.seen[10:]] == [True] * 5  # to the end nothing is late


def test_who_is_behind_says_how_far_and_up_to_when_all_was_seen() -> None:
    looking = Looking()
    backlog = looking.backlog
    assert (backlog.behind, backlog.judged_until(50.0), backlog.problem) == (0.0, 50.0, None)
    looking.add(2, first=20 * NS)
    looking.now += LATEST + 0.3
    assert backlog.judged_until(50.0) == 20.0
    assert backlog.behind == pytest.approx(0.8)
    assert str(backlog.problem).startswith("the engine is 0.8 s behind")
    backlog.note_pause(3.54)
    assert backlog.problem == "the engine stood still for 3.5 s"


def test_what_waits_is_bounded_in_bytes() -> None:
    looking = Looking()
    looking.add(8, size=CAPACITY // 8)
    assert looking.backlog.full
    looking.backlog.work_off(lambda: True)
    assert not looking.backlog.full


# ---------------------------------------------------------------------- the engine


class HeldUp(FaultyDrive):
    """An engine that somebody wants something of after each message, from `hold_up` on."""

    def __init__(self, results: Path) -> None:
        super().__init__(results, lossless=False)

    def hold_up(self, duration: float) -> None:
        """Six messages come in a step, one is looked at."""
        end = self.engine.now() + duration
        while self.engine.now() < end:
            self.engine.step(STEP, lambda: True)
            self.clock.sleep(STEP)


def test_an_abort_takes_effect_though_hundreds_of_messages_wait_and_all_are_judged(
    tmp_path: Path,
) -> None:
    drive = HeldUp(tmp_path)
    drive.set_up()
    drive.begin()
    drive.wait(4.0)
    drive.hold_up(3.0)
    said = drive.engine.now()
    drive.act(Abort("enough"))
    assert (drive.engine.run.phase, drive.engine.run.stop) == (Phase.STOPPED, said)
    drive.hold_up(1.5)  # the post-roll is over, and what it recorded waits
    assert drive.engine.scored is None
    result = drive.scored_result()
    assert drive.rescored() == result


@pytest.mark.parametrize("declared", [False, True])
def test_a_timeout_is_judged_by_all_that_was_measured_before_it(
    declared: bool, tmp_path: Path
) -> None:
    drive = HeldUp(tmp_path)
    drive.set_up()
    drive.begin()
    drive.wait(13.5)  # the robot is done 13.85 s after the start, which is 1 s after that
    drive.hold_up(1.6 if declared else TIMEOUT - 12.5)
    if declared:
        drive.act(DeclareTimeout("it was done, was it not?"))
    drive.hold_up(0.5)
    run = drive.engine.run
    assert (run.phase, run.timeout_at is not None) == (Phase.RUNNING, True)
    result = drive.scored_result()
    assert drive.engine.run.outcome is Outcome.COMPLETED
    assert drive.rescored() == result
    for topic in drive.topics():
        assert drive.recorded(topic) == drive.handed(topic)[: len(drive.recorded(topic))]


def test_what_waited_when_the_recording_began_is_judged_in_a_replay_too(tmp_path: Path) -> None:
    headerless = [
        TopicMapping(m.signal, m.topic, "std_msgs/msg/Float64", "data")
        if m.signal in (Signal.DOOR, Signal.HANDLE)
        else m
        for m in DEFAULT_MAPPINGS
    ]
    drive = Drive(tmp_path, mappings=headerless)
    drive.prepare(make_setup())
    drive.clock.sleep(0.24)  # so long nothing is taken by a busy machine: twelve samples
    drive.act(Start())
    drive.same_everywhere()
