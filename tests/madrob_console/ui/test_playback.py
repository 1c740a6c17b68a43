"""A replay on the screens: what it shows, its keys, and that nobody takes it for a live run."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.comparison import EQUAL
from madrob_console.engine.shown.playback import (
    Faster,
    JumpTo,
    PlaybackView,
    PlayOrPause,
    Skip,
    Slower,
)
from madrob_console.engine.shown.requests import GiveFrames
from madrob_console.kinds import SourceKind
from madrob_console.referee.acts import SetUp
from madrob_console.referee.run_times import seconds_of
from madrob_console.referee.transitions import begin_countdown, begin_run
from madrob_console.ui.cells.lines import width_of
from madrob_console.ui.frame.key_line import KeyLine
from madrob_console.ui.frame.playback_bar import playback_line, position_text, speed_text
from madrob_console.ui.frame.tiny_clock import tiny_lines
from madrob_console.ui.keys.asks import Leave, ask_leave
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS
from madrob_console.ui.panes.result_head import ResultHead
from tests.madrob_console.ui.driver import Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.setups import a_setup

VIEW = PlaybackView(12.34, -5.0, 65.0, 1.0, paused=False, ended=False)


def text(playback: PlaybackView, width: int = 78) -> str:
    return "".join(span.text for span in playback_line(playback, width))


def test_the_bar_says_replay_position_length_and_speed() -> None:
    shown = text(VIEW)
    assert shown.startswith(" REPLAY  playing 1x  0:12.34 / 1:05.00  [==|======●---")
    assert len(shown) == 78


@pytest.mark.parametrize(
    ("playback", "words"),
    [
        (replace(VIEW, paused=True, speed=0.5), "PAUSED 1/2x"),
        (replace(VIEW, jumping_to=61.0), "jumping to 1:01.00"),
        (replace(VIEW, ended=True, position=65.0), "at its end"),
        (replace(VIEW, speed=0.0), "playing max"),
    ],
)
def test_the_bar_tells_playing_from_paused_jumping_and_ended(
    playback: PlaybackView, words: str
) -> None:
    assert words in text(playback)


@given(
    position=st.floats(-600, 90_000),
    length=st.floats(0, 90_000),
    width=st.integers(20, 200),
    paused=st.booleans(),
)
def test_the_bar_never_takes_more_room_than_there_is(
    position: float, length: float, width: int, paused: bool
) -> None:
    view = PlaybackView(position, -5.0, length, 10.0, paused=paused, ended=False)
    line = playback_line(view, width)
    words = f" REPLAY  {'PAUSED' if paused else 'playing'} 10x"
    assert "".join(span.text for span in line).startswith(words)
    assert width_of(line) <= max(width, 50)


def test_a_step_of_one_sample_shows() -> None:
    assert [position_text(t) for t in (-0.02, 0.0, 1.98, 2.0, 60.0)] == [
        "-0:00.02", "0:00.00", "0:01.98", "0:02.00", "1:00.00",
    ]  # fmt: skip
    assert [speed_text(s) for s in (0.0, 0.5, 1.0, 10.0, 2.5)] == [
        "max",
        "1/2x",
        "1x",
        "10x",
        "2.5x",
    ]


@pytest.mark.parametrize(
    ("typed", "seconds"),
    [
        ("12.5", 12.5), ("-3", -3.0), (" 1:05.2 ", 65.2), ("-0:30", -30.0), ("0", 0.0),
        ("6.5 s", 6.5), ("1:05s", 65.0), ("s", None), ("1 ss", None),
        ("", None), ("abc", None), ("1:2:3", None), (":5", None), ("5:", None),
        ("nan", None), ("1:inf", None), ("1" * 400 + ":0", None),
    ],
)  # fmt: skip
def test_a_time_can_be_typed_in_seconds_or_minutes(typed: str, seconds: float | None) -> None:
    assert seconds_of(typed) == (None if seconds is None else pytest.approx(seconds))


def test_no_key_of_a_replay_is_a_key_of_the_console() -> None:
    taken = {name for key in (*FUNCTION_KEYS, *LETTER_KEYS) for name in key.keys.split(",")}
    assert not taken & {name for key in PLAYBACK_KEYS for name in key.keys.split(",")}


def replaying() -> FakeEngine:
    engine = FakeEngine(kind=SourceKind.REPLAY, label="REPLAY of the morning")
    engine.playback = VIEW
    return engine


def footer(engine: FakeEngine, pane: str, width: int = 80) -> str:
    keys = KeyLine()
    keys.pane, keys._snapshot = pane, engine.snapshot()
    return "".join(span.text for span in keys.lines(width)[1])


def test_the_footer_has_the_keys_of_a_replay_only_on_one() -> None:
    assert footer(replaying(), "live").startswith("Spc Pause ,. 20ms <> 1s +- Speed j Jump")
    assert "j Jump" in footer(replaying(), "results")
    assert "Jump" not in footer(FakeEngine(), "live", 200)
    for pane in ("figures", "setup", "history"):
        assert "Jump" not in footer(replaying(), pane, 200)


def test_a_replay_is_left_without_a_question() -> None:
    engine = replaying()
    setup = SetUp(a_setup()).apply(engine._situation(), engine.now)
    engine.run = begin_run(begin_countdown(setup, engine.now))
    assert ask_leave(engine.snapshot()) == Leave()


def test_the_smallest_screen_says_that_it_is_a_replay() -> None:
    lines = ["".join(s.text for s in line) for line in tiny_lines(replaying().snapshot(), 20, 4)]
    assert "REPLAY playing 1x" in lines
    assert not any("F8" in line for line in lines)


@pytest.mark.parametrize(
    "words", [EQUAL, "differs from the stored result: execution time 12.30, stored 12.32"]
)
def test_the_result_says_how_it_compares_with_the_stored_one(words: str) -> None:
    engine = replaying()
    setup = SetUp(a_setup()).apply(engine._situation(), engine.now)
    engine.run = begin_run(begin_countdown(setup, engine.now))
    engine.tick(20.0)
    engine.finish()
    engine.playback = replace(VIEW, ended=True, comparison=words)
    rows = ["".join(s.text for s in line) for line in ResultHead().draw(engine.snapshot(), 80)]
    assert words in rows
    assert any("REPLAY: not an official result" in row for row in rows)
    assert not any("f finalises" in row for row in rows)


def run(engine: FakeEngine, what: Callable[[Driver], Awaitable[None]]) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await what(driver)

    asyncio.run(drive())


def test_the_keys_move_a_replay_and_nothing_else() -> None:
    engine = replaying()

    async def drive(driver: Driver) -> None:
        await driver.press("f3")
        assert "REPLAY  playing 1x" in driver.text
        await driver.press("space", "full_stop", "comma", "less_than_sign", "plus", "minus")
        assert engine.commands == [
            PlayOrPause(), Skip(0.02), Skip(-0.02), Skip(-1.0), Faster(), Slower(),
        ]  # fmt: skip
        await driver.press("j")
        await driver.type("1:05")
        await driver.press("enter")
        assert engine.commands[-1] == JumpTo(65.0)
        await driver.press("j", "x", "enter")
        assert "'x' is no time" in driver.text
        await driver.press("escape")
        await driver.press("f1")
        assert "to a time of the run" in driver.text
        await driver.press("g", "plus")  # zooms
        assert engine.commands[-1] == JumpTo(65.0)
        engine.playback = None
        await driver.press("f3", "space", "full_stop", "plus", "j")
        assert engine.commands[-1] == JumpTo(65.0)
        assert driver.console.dialogs == []
        assert "REPLAY  " not in driver.text

    run(engine, drive)


def test_o_has_the_cameras_frames_of_the_shown_instant_written_and_y_copies_where() -> None:
    engine = replaying()

    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("f3", "o")
            assert engine.commands == [GiveFrames()]
            assert "it holds no evidence" in driver.console.status
            engine.frames = "/tmp/madrob_frames_1/run_12.340_s"
            await driver.press("o")
            assert f"y copies where they are: {engine.frames}" in driver.console.status
            asked = driver.console.ask_copy("ada")
            assert not isinstance(asked, str)
            offered = asked.make("f"), asked.make("g")
            assert [copy.text for copy in offered] == [
                engine.frames,
                f"scp -r ada@:{engine.frames} .",
            ]

    asyncio.run(drive())
