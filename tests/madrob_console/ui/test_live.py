from __future__ import annotations

import asyncio
import re
from collections.abc import Sequence
from dataclasses import replace

import pytest

from madrob_console.engine.shown.snapshot import Pulse, RecorderView, RightToAct
from madrob_console.kinds import SourceKind
from madrob_console.referee.acts import Abort
from madrob_console.referee.health import Freshness
from madrob_console.referee.journal import Origin
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.panes.run_clock import clock_span
from scoring.procedure import Ruling
from scoring.protocol import Side, Step
from tests.madrob_console.ui.driver import LARGE, SMALL, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

SIZES = pytest.mark.parametrize("size", [SMALL, LARGE])


@SIZES
def test_the_live_pane_shows_the_whole_run(engine: FakeEngine, size: tuple[int, int]) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            engine.angle, engine.force, engine.maximum = 0.31, 12.3, 15.2
            engine.do_step(Step.TOUCH)
            await driver.let_pass(1.25)
            engine.do_step(Step.UNLOCK)
            engine.do_step(Step.OPEN)
            engine.say("door opens")
            engine.provisional = {"time_to_handle": 1.0}
            for _ in range(3):  # the log waits for every third look
                await driver.settle()
            for text in (
                "RUNNING  4:58 left of 5:00",
                "run 1 of subject 1 Door Bots",
                "condition 1: pull, from CCW to CW, No Force",
                "next: step 4 cross the threshold",
                "✓ 1 touch the handle      1.000  -           1.000",
                "✓ 3 open the door         2.250  -           2.250",
                "> 4 cross the threshold       -  -              no",
                "  6 lock the door             -  -              no",
                "door +0.310 rad  +17.8 deg open",
                "handle raw +12.30 zero +0.00 max 15.2N",
                "touch at 1.96 N",
                "so far  to handle 1.000 s occupation - passage -  6 of 6 fresh",
                "   +2.25 sensor  door opens",
            ):
                assert text in driver.text
            assert "…" not in "".join(driver.rows()[1:])

    asyncio.run(drive())


def test_the_clock_reads_the_time_in_large_digits(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.let_pass(63.0)  # 1:04.0
            rows = [row[10:31].rstrip() for row in driver.rows()[2:5]]
            assert rows == [
                "▀█  ▄ █▀█ █ █   █▀█",
                " █  ▄ █ █ ▀▀█   █ █",
                "▀▀▀   ▀▀▀   ▀ ▀ ▀▀▀",
            ]

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("size", "rows"), [((80, 24), 3), ((120, 36), 5), ((160, 50), 8), ((300, 80), 13)]
)
def test_the_clock_grows_with_the_terminal(
    engine: FakeEngine, size: tuple[int, int], rows: int
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            await driver.let_pass(63.0)
            drawn = [row for row in driver.rows()[2 : 2 + rows + 2] if {"█", "▀"} & set(row[:60])]
            assert len(drawn) == rows
            assert "RUNNING" in driver.text
            assert "run 1 of subject 1" in driver.text

    asyncio.run(drive())


async def _resized(driver: Driver, size: tuple[int, int]) -> Sequence[str]:
    await driver.pilot.resize_terminal(*size)
    await driver.let_pass(1.0)
    return driver.rows()


def test_the_clock_follows_a_terminal_that_is_resized(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine, (120, 36)) as driver:
            await driver.run()
            large = len([row for row in driver.rows()[2:9] if "█" in row])
            small = len([row for row in (await _resized(driver, (120, 30)))[2:9] if "█" in row])
            again = len([row for row in (await _resized(driver, (120, 36)))[2:9] if "█" in row])
            assert small < large == again

    asyncio.run(drive())


@pytest.mark.parametrize("width", [60, 64, 70, 80, 90, 100, 110, 130, 160, 200])
def test_no_column_touches_or_cuts_the_next(engine: FakeEngine, width: int) -> None:
    async def drive() -> None:
        async with driving(engine, (width, 30)) as driver:
            await driver.run()
            seen = engine.steps[0]
            engine.do_step(Step.TOUCH)
            long = "denied by the referee: the robot's arm was pushed, as the video shows"
            denied = Ruling(Step.TOUCH, False, engine.now, "brushed", "Ada")
            first = replace(seen, sensors=engine.now + 122.456, referee=denied, reason=long)
            others = (replace(record, reason=long) for record in engine.steps[2:])
            done = replace(engine.steps[1], final=engine.now + 122.456, referee=denied)
            engine.steps = (first, done, *others)
            await driver.let_pass(1.0)
            rows = driver.rows()
            head = next(i for i, row in enumerate(rows) if "passage sensors" in row)
            begins = rows[head + 2].index("CCW ")
            column = [row.ljust(width)[begins - 1] for row in rows[head : head + 7]]
            assert column == [" "] * 7
            assert "123.456" in rows[head + 2]  # a number is whole or not there

    asyncio.run(drive())


def test_three_columns_tell_sensors_referee_and_what_counts(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.do_step(Step.TOUCH)
            denied = Ruling(Step.TOUCH, False, engine.now, "brushed", "Ada")
            first = replace(engine.steps[0], referee=denied, final=None)
            engine.steps = (first, *engine.steps[1:])
            await driver.settle()
            assert "x 1 touch the handle      1.000  denied         no" in driver.text

    asyncio.run(drive())


@SIZES
def test_a_false_start_says_what_to_do(engine: FakeEngine, size: tuple[int, int]) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.set_up()
            await driver.press("f5")
            await driver.let_pass(1.5)
            assert "COUNTDOWN  starts in 0:04" in driver.text
            engine.false_start()
            await driver.settle()
            shown = " ".join(driver.text.split())
            assert "FALSE START: handle touched at -3.5 s: r restarts the countdown" in shown
            assert "a accepts it with a reason" in shown
            await driver.press("r")
            assert "FALSE START" not in driver.text
            assert "starts in 0:05" in driver.text

    asyncio.run(drive())


def test_a_question_to_the_referee_is_shown(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.ask_referee = "the latch is silent: is the door locked?"
            await driver.settle()
            assert "REFEREE: the latch is silent: is the door locked? (1-6 rules" in driver.text

    asyncio.run(drive())


def test_sensors_show_their_state_by_symbol_in_their_place(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.occupied = {(Side.CCW, 4), (Side.CW, 0), (Side.CCW, 1)}
            await driver.settle()
            ccw, cw = "CCW   O   .   .   O   .", "CW    .   .   .   .   O"
            assert ccw in driver.text
            assert cw in driver.text
            engine.angle = 0.1
            await driver.settle()
            assert "CCW   M   m   m   M   m" in driver.text
            assert cw in driver.text
            engine.freshness = Freshness.STALE
            await driver.settle()
            assert "CCW   s   s   s   s   s" in driver.text
            engine.freshness = Freshness.LOST
            await driver.settle()
            assert "CW    ?   ?   ?   ?   ?" in driver.text

    asyncio.run(drive())


def test_a_value_that_is_lost_is_a_word_and_no_number(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.freshness = Freshness.STALE
            await driver.settle()
            assert "+0.000 rad   +0.0 deg stale" in driver.text
            engine.angle, engine.force, engine.freshness = None, None, Freshness.LOST
            for _ in range(3):
                await driver.settle()
            assert "no angle: lost" in driver.text
            assert "no force: lost" in driver.text
            assert "0 of 6 fresh" in driver.text
            assert "/madrob/door/angle lost" in driver.text
            assert "●" not in driver.text

    asyncio.run(drive())


def test_the_panel_is_where_it_is(engine: FakeEngine) -> None:
    scales = {
        0.0: "CW -------------[●]============= CCW",
        0.029: "CW -------------[●]============= CCW",
        0.031: "CW -------------[|]●============ CCW",
        -0.031: "CW ------------●[|]============= CCW",
        1.5708: "CW -------------[|]============● CCW",
        -3.0: "CW ●------------[|]============= CCW",
    }

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("enter", "f3")
            for angle, scale in scales.items():
                engine.angle = angle
                await driver.settle()
                assert scale in driver.text

    asyncio.run(drive())


def test_the_source_cannot_be_mistaken(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            assert driver.rows()[0].startswith(" ~~ SIMULATED nominal ~~ ")
            engine.kind, engine.label = SourceKind.ROS, "LIVE ros domain 0"
            for _ in range(4):
                await driver.settle()
            assert driver.rows()[0].startswith(" LIVE ros domain 0 ")
            assert "~" not in driver.rows()[0]

    asyncio.run(drive())


@pytest.mark.parametrize("label", ["SIMULATED nominal", f"REPLAY subject_001_{'x' * 60}"])
def test_the_top_line_never_loses_recorder_and_clock(engine: FakeEngine, label: str) -> None:
    engine.label = label
    recorders = (
        RecorderView("recording", 1234567, 987_654_321, 1234),
        RecorderView("finished", 123456, 12_345_678),
        RecorderView("failed", 12, 4_000, 5, "disk full"),
    )

    async def drive() -> None:
        async with driving(engine) as driver:
            assert "rec closed" in driver.rows()[0]
            for engine.recorder in recorders:
                for _ in range(4):
                    await driver.settle()
                top = driver.rows()[0]
                assert label.split(maxsplit=1)[0] in top
                assert f" {engine.recorder.messages} " in top
                assert f" {engine.recorder.dropped} drop" in top
                assert top.endswith(":20")

    asyncio.run(drive())


def test_faults_stay_until_they_are_gone(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            assert "no faults" in driver.rows()[1]
            engine.faults = ("panel at -0.043 rad, against the opening side",)
            await driver.let_pass(60.0)
            assert " FAULT panel at -0.043 rad, against the opening side" in driver.rows()[1]
            engine.faults = tuple(f"fault number {n} of the testbed" for n in range(5))
            await driver.settle()
            assert "fault number 2 of the testbed (and 2 more below)" in driver.rows()[3]
            await driver.press("f8")
            assert "FAULT" in driver.rows()[1]
            await driver.press("escape")
            engine.faults = ()
            await driver.settle()
            assert "no faults" in driver.rows()[1]

    asyncio.run(drive())


MANY_FAULTS = (
    "the journal cannot be written (Read-only file system): 5 lines wait for the disk of the hall",
    "the result is NOT on disk (/home/ref/madrob_runs/subject_001_cond_001_run_001): trying again",
    *(f"fault number {number} of the testbed" for number in range(12)),
)


@pytest.mark.parametrize("size", [(80, 24), (120, 36)])
def test_the_live_pane_has_every_fault_with_all_its_words(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            assert "all faults" not in driver.text
            engine.faults = MANY_FAULTS
            await driver.settle()
            top = " ".join(row.strip() for row in driver.rows()[1:4])
            assert re.search(r"\(and \d+ more below\)", top)
            assert ": F3" not in driver.text
            seen = []
            for _ in range(5):
                seen += [row.strip() for row in driver.rows() if row.strip() not in seen]
                await driver.press("pagedown")
            told = " ".join(seen)
            for fault in MANY_FAULTS:
                assert "".join(fault.split()) in "".join(told.split())
            await driver.press("f2")
            await driver.settle()
            assert re.search(r"\(and \d+ more: F3\)", driver.text)
            await driver.press("f3")
            assert "next: step 1" in driver.text  # it begins at its top again
            engine.faults = ()
            await driver.settle()
            assert "all faults" not in driver.text

    asyncio.run(drive())


def test_a_fault_that_is_cut_ends_with_a_word_and_says_so(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine, (80, 24)) as driver:
            await driver.set_up()
            first = (
                "the journal cannot be written (Read-only file system, since 22:13): 5 lines wait"
            )
            engine.faults = (first, "another thing is wrong with the testbed", *MANY_FAULTS)
            engine.right = RightToAct(holder="bo@tent")  # a row less for faults
            await driver.settle()
            rows = driver.rows()[2:4]
            assert rows[0].endswith("since 22:13): 5")
            assert rows[1] == "       lines wait (and 15 more: F3)"
            engine.faults = (f"{'w' * 72} then {'7 ' * 60}",)
            await driver.settle()
            assert driver.rows()[3].endswith("   then … (more: F3)")

    asyncio.run(drive())


def test_an_engine_that_fails_is_a_fault_and_no_crash(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.failure = "the engine has failed: disk full"
            await driver.settle()
            assert "the engine has failed: disk full: what you see is old" in driver.rows()[1]
            await driver.press("i")
            assert "the engine has failed" in driver.console.status
            assert not driver.console.dialogs

    asyncio.run(drive())


def test_an_engine_that_stands_still_is_called_silent(engine: FakeEngine) -> None:
    async def drive() -> None:
        times = iter([0.0, 0.0, *[10.0] * 1000])
        async with driving(engine, monotonic=lambda: next(times)) as driver:
            await driver.settle()
            assert "the engine is silent for 10 s: what you see is old" in driver.text

    asyncio.run(drive())


def test_a_clock_that_may_have_gone_on_unseen_is_not_shown_as_fresh(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            assert "RUNNING  4:59 left of 5:00" in driver.text
            engine.pulse = Pulse(core=3)
            await driver.settle()
            assert "the engine has not moved for 3 s: what you see is old" in driver.rows()[1]
            assert "RUNNING  as it was 3 s ago" in driver.text
            assert clock_span(engine.snapshot()) == ("0:01.?", Tone.DIM)
            engine.pulse = Pulse()
            await driver.settle()
            assert "RUNNING  4:59 left of 5:00" in driver.text

    asyncio.run(drive())


@SIZES
def test_a_silent_disk_is_named_with_what_still_works(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            engine.pulse = Pulse(disk=7, unwritten=2)
            await driver.settle()
            words = "disk silent for 7 s: nothing new starts; the clock runs, abort works"
            assert words in driver.rows()[1]
            assert "RUNNING  NOT ON DISK YET" in driver.text
            assert engine.act(Abort("robot unsafe")) is None
            await driver.settle()
            assert "ABORTED  NOT ON DISK YET" in driver.text
            assert "abort works" not in driver.text
            engine.pulse = Pulse()
            await driver.settle()
            assert "NOT ON DISK YET" not in driver.text

    asyncio.run(drive())


def test_the_log_shows_its_newest_lines(engine: FakeEngine) -> None:
    for number in range(50):
        engine.say(f"line {number} [bold]x[/]", Origin.SYSTEM)

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("f3")
            assert "system  line 49 [bold]x[/]" in driver.text
            assert "line 40" not in driver.text

    asyncio.run(drive())


@pytest.mark.slow
def test_no_size_of_the_terminal_breaks_the_console(engine: FakeEngine) -> None:
    engine.faults = ("a fault with some words in it",)

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            engine.finish()
            for size in ((1, 1), (10, 4), (40, 12), (60, 18), (200, 60), SMALL):
                await driver.pilot.resize_terminal(*size)
                for key in ("f1", "f2", "f3", "n", "escape", "f4"):
                    await driver.press(key)
            assert "COMPLETED" in driver.text

    asyncio.run(drive())


@SIZES
def test_what_may_still_change_is_rough_and_marked(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            for step in (Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CROSS):
                engine.do_step(step)
            engine.provisional = {"time_to_handle": 1.0, "door_occupation_time": 2.345}
            for _ in range(3):
                await driver.settle()
            for words in (
                "so far",
                "✓ 3 open the door         1.000  -           1.000",
                "✓ 4 cross the threshold    ~1.0  -            ~1.0",
                "to handle 1.000 s occupation ~2.3 s",
            ):
                assert words in driver.text
            engine.provisional_doubts = {"time_to_handle": ("the touch rests on 1 sample",)}
            for _ in range(3):
                await driver.settle()
            assert "to handle 1.000 s? occupation ~2.3 s" in driver.text
            engine.provisional_doubts = {}
            for step in (Step.CLOSE, Step.LOCK):
                engine.do_step(step)
            engine.finish()
            await driver.settle()
            await driver.press("f3")
            for _ in range(3):
                await driver.settle()
            assert "✓ 4 cross the threshold   1.000  -           1.000" in driver.text
            assert "occupation 2.345 s" in driver.text
            assert "~" not in "".join(driver.rows()[1:])

    asyncio.run(drive())
