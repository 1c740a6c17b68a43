from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence

import pytest

from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.on_record import CheckName, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.transitions import stop
from madrob_console.ui.keys.key_table import KEYS
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.setups import a_setup


async def before_set_up(driver: Driver) -> None:
    await driver.press("f3")


async def after_set_up(driver: Driver) -> None:
    driver.engine.run = SetUp(a_setup()).apply(driver.engine._situation(), driver.engine.now)
    await driver.press("f3")


async def pose_confirmed(driver: Driver) -> None:
    await driver.set_up()
    await driver.press("f3")


async def door_open(driver: Driver) -> None:
    driver.engine.angle = 0.4
    await after_set_up(driver)


async def countdown(driver: Driver) -> None:
    await driver.set_up()
    await driver.press("f5")


async def false_start(driver: Driver) -> None:
    await countdown(driver)
    driver.engine.false_start()


async def running(driver: Driver) -> None:
    await driver.run()


async def stopped(driver: Driver) -> None:
    await driver.run()
    driver.engine.finish()
    await driver.settle()


async def final(driver: Driver) -> None:
    await stopped(driver)
    await driver.press("f", "a", "enter")


Situation = Callable[[Driver], Awaitable[None]]


@pytest.mark.parametrize(
    ("situation", "cases"),
    [
        (pose_confirmed, [(["f5"], Start())]),
        (
            after_set_up,
            [
                (["f6"], ConfirmPose()),
                (["f7"], ZeroHandle()),
                (["w", "1"], Waive(CheckName.POSE, "checked by hand")),
            ],
        ),
        (door_open, [(["w", "2", "2"], Waive(CheckName.POSE, "known testbed fault"))]),
        (
            false_start,
            [
                (["r"], RestartCountdown()),
                (["a", "2"], AcceptFalseStart("sensor false alarm")),
                (["f8", "2", "y"], Abort("testbed fault")),
            ],
        ),
        (
            running,
            [
                (["f8", "1", "y"], Abort("robot unsafe")),
                (["f9", "1", "y"], DeclareTimeout("the team gives up")),
                (
                    ["3", "c", "1", "y"],
                    Rule(Step.OPEN, confirmed=True, reason="seen by the referee"),
                ),
                (["i", "h"], MarkIncident(IncidentKind.HUMAN_INTERVENTION)),
                (["i", "c"], MarkIncident(IncidentKind.COLLISION)),
                (["i", "f"], MarkIncident(IncidentKind.FALL)),
                (
                    ["i", "o", "v", "x", "f", "enter"],
                    MarkIncident(IncidentKind.OTHER, "vxf", 1.0),
                ),
                (["3", "s", "1", "y"], Rule(Step.OPEN, None, "seen by the referee")),
                (["n", "o", "k", "enter"], AddNote("ok")),
            ],
        ),
        (
            stopped,
            [
                (
                    ["6", "d", "3", "y"],
                    Rule(Step.LOCK, confirmed=False, reason="sensor false alarm"),
                ),
                (["f", "p", "n", "o", "enter"], Finalise(TeamWord.PROTESTED, "Ada", "no")),
                (["x", "y"], SetUp(a_setup(run_number=2))),
            ],
        ),
        (
            final,
            [(["u", "1", "y"], Reissue("a step was ruled wrongly")), (["x"], SetUp(a_setup(2)))],
        ),
    ],
)
def test_a_key_hands_in_its_act(
    engine: FakeEngine, situation: Situation, cases: Sequence[tuple[Sequence[str], Act]]
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await situation(driver)
            run, result = engine.run, engine.result
            for keys, act in cases:
                engine.run, engine.result = run, result
                await driver.press(*keys)
                assert engine.acts[-1] == act
                assert driver.console.status.startswith("Done: ")

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("situation", "reasons"),
    [
        (before_set_up, dict.fromkeys(("f5", "f6", "f8", "n"), "no run is set up yet")),
        (
            after_set_up,
            {
                "f5": "start pose: not confirmed",
                "f8": "the run has not started",
                "f9": "the run has not started",
                "f": "the run has not started",
            },
        ),
        (
            countdown,
            {
                "f5": "the countdown is running",
                "f9": "the countdown is running",
                "x": "the countdown is running",
                "a": "there is no false start to accept",
            },
        ),
        (running, dict.fromkeys(("f5", "f6", "f7", "r", "x"), "a run is going on")),
        (stopped, {"f8": "the run has stopped", "u": "only a final result is re-issued"}),
        (final, dict.fromkeys(("1", "i", "f8", "f"), "the result is final")),
    ],
)
def test_a_key_that_is_not_possible_says_why_and_does_nothing(
    engine: FakeEngine, situation: Situation, reasons: Mapping[str, str]
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await situation(driver)
            before, done = engine.run, list(engine.acts)
            for key, reason in reasons.items():
                await driver.press(key)
                assert reason in driver.console.status
                assert not driver.console.dialogs
                assert (engine.run, engine.acts) == (before, done)

    asyncio.run(drive())


def test_a_check_is_waived_only_where_one_fails(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await pose_confirmed(driver)
            await driver.press("w")
            assert "no check fails" in driver.console.status

    asyncio.run(drive())


def test_no_handle_data_no_zero(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await after_set_up(driver)
            engine.force = None
            await driver.press("f7")
            assert "no fresh handle force" in driver.console.status

    asyncio.run(drive())


def test_panes_have_keys_that_work_while_a_text_is_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            for key, pane in (("f3", "live"), ("f4", "results"), ("f2", "setup"), ("f1", "help")):
                await driver.press(key)
                assert driver.console.pane == pane
            await driver.press("f1")
            assert driver.console.pane == "setup"

    asyncio.run(drive())


def test_start_and_abort_are_separate_keys_and_no_two_keys_are_the_same() -> None:
    pressed = [key for entry in KEYS.values() for key in entry.keys.split(",")]
    assert len(pressed) == len(set(pressed))
    assert KEYS["start"].keys == "f5"
    assert KEYS["abort"].keys == "f8"


def test_no_key_is_one_that_tmux_or_screen_keep_for_themselves() -> None:
    pressed = {key for entry in KEYS.values() for key in entry.keys.split(",")}
    assert not pressed & {"ctrl+b", "ctrl+a", "escape", "enter"}


def test_a_run_that_starts_shows_live_and_a_result_shows_itself(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.set_up()
            assert driver.console.pane == "setup"
            await driver.press("f5")
            assert driver.console.pane == "live"
            await driver.let_pass(6.0)
            assert engine.run.phase is Phase.RUNNING
            engine.finish()
            await driver.settle()
            assert driver.console.pane == "results"

    asyncio.run(drive())


def test_a_result_waits_until_the_referee_has_typed(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.press("n", "a")
            engine.finish()
            await driver.settle()
            assert driver.console.pane == "live"
            await driver.press("b", "enter")
            assert engine.acts[-1] == AddNote("ab")
            assert driver.console.pane == "results"

    asyncio.run(drive())


def test_keys_faster_than_the_screen_are_taken_in_their_order(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            await driver.pilot.press("i", "c", "n", *"late", "enter", "f8", "4", "y")
            await driver.settle()
            assert engine.acts[-3:] == [
                MarkIncident(IncidentKind.COLLISION),
                AddNote("late"),
                Abort("the team asks for it"),
            ]

    asyncio.run(drive())


def test_a_console_that_comes_back_to_a_run_shows_it(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
        async with driving(engine) as driver:
            assert driver.console.pane == "live"
            assert "RUNNING" in driver.text
        engine.run = stop(engine.run, Outcome.COMPLETED, engine.now, "step 6 is done")
        async with driving(engine) as driver:
            assert driver.console.pane == "live"
            engine.score()
            await driver.settle()
            assert driver.console.pane == "results"

    asyncio.run(drive())
