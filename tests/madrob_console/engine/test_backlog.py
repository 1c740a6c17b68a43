from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.clock import NS
from madrob_console.engine.live.backlog import CAPACITY, LATEST, Backlog
from madrob_console.engine.live.core import Engine
from madrob_console.messages.codec import MessageTypes
from madrob_console.referee.acts import Abort, DeclareTimeout
from madrob_console.referee.run import Phase
from recorder.message import RawMessage
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import STEP
from tests.madrob_console.engine.faulty_source import TIMEOUT, FaultyDrive


class HandClock:
    """A monotonic clock that each message moves on by what it takes to look at it."""

    def __init__(self, cost: float = 0.0) -> None:
        self.now = 100.0
        self.cost = cost
        self.seen: list[tuple[int, bool, bool]] = []

    def __call__(self) -> float:
        return self.now

    def observe(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        self.now += self.cost
        self.seen.append((message.receive_ns, recorded, shown))


def messages(count: int, first: int = 0, size: int = 1) -> list[RawMessage]:
    return [RawMessage("/t", "t", bytes(size), n, n) for n in range(first, first + count)]


def never() -> bool:
    return False


def test_between_two_messages_its_owner_may_have_a_turn() -> None:
    clock = HandClock()
    backlog = Backlog(clock.observe, clock)
    backlog.add(messages(3), recorded=True)
    backlog.work_off(lambda: True)
    assert clock.seen == [(0, True, True)]
    assert len(backlog) == backlog.recorded == 2
    backlog.work_off(never)
    assert [number for number, *_ in clock.seen] == [0, 1, 2]
    assert len(backlog) == backlog.recorded == 0


def test_its_owner_has_a_turn_anyway_when_messages_take_long() -> None:
    clock = HandClock(cost=0.015)
    backlog = Backlog(clock.observe, clock)
    backlog.add(messages(9), recorded=False)
    backlog.work_off(never)
    assert len(clock.seen) == 2


def test_what_is_late_is_judged_but_not_shown_and_that_is_said_for_a_while() -> None:
    clock = HandClock(cost=0.1)
    backlog = Backlog(clock.observe, clock)
    backlog.add(messages(10), recorded=True)
    while len(backlog):
        backlog.work_off(never)
    shown = [shown for _, _, shown in clock.seen]
    assert [recorded for _, recorded, _ in clock.seen] == [True] * 10
    assert shown == [True] * 6 + [False] * 4
    assert backlog.problem is not None
    assert "4 messages are not shown" in backlog.problem
    clock.now += 2.1
    assert backlog.problem is None


def test_who_is_behind_says_how_far_and_up_to_when_all_was_seen() -> None:
    clock = HandClock()
    backlog = Backlog(clock.observe, clock)
    assert (backlog.behind, backlog.seen(50.0), backlog.problem) == (0.0, 50.0, None)
    backlog.add(messages(2, first=20 * NS), recorded=False)
    clock.now += LATEST + 0.3
    assert backlog.seen(50.0) == 20.0
    assert backlog.behind == pytest.approx(0.8)
    assert str(backlog.problem).startswith("more comes than can be looked at: 0.8 s behind")


def test_to_the_end_nothing_is_late() -> None:
    clock = HandClock(cost=1.0)
    backlog = Backlog(clock.observe, clock)
    backlog.add(messages(5), recorded=True)
    backlog.work_off()
    assert [shown for _, _, shown in clock.seen] == [True] * 5


def test_what_waits_is_bounded_in_bytes() -> None:
    clock = HandClock()
    backlog = Backlog(clock.observe, clock)
    backlog.add(messages(8, size=CAPACITY // 8), recorded=False)
    assert backlog.full
    backlog.work_off(lambda: True)
    assert not backlog.full


# ---------------------------------------------------------------------- the engine


class HeldUp(FaultyDrive):
    """An engine that somebody wants something of after each message, from `hold_up` on."""

    def __init__(self, results: Path) -> None:
        super().__init__(results)
        config = self.engine.config
        real = type(config)(results, config.mappings, config.disk_needed)
        self.engine = Engine(self.faulty, self.clock, real, MessageTypes())
        self.engine.open()

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
    result = drive.result()
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
    result = drive.result()
    assert drive.engine.run.outcome is Outcome.COMPLETED
    assert drive.rescored() == result
    for topic in drive.topics():
        assert drive.recorded(topic) == drive.handed(topic)[: len(drive.recorded(topic))]
