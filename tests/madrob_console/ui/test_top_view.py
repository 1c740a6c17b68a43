"""A replay on the screens, and the doorway from above."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from madrob_console.archive.check import EQUAL
from madrob_console.common.formatting import seconds_of
from madrob_console.common.names import SourceKind
from madrob_console.engine.requests import (
    Faster,
    GiveFrames,
    JumpTo,
    PlaybackCommand,
    PlaybackView,
    PlayOrPause,
    Skip,
    Slower,
)
from madrob_console.referee.acts import SetUp
from madrob_console.referee.run import begin_countdown, begin_run
from madrob_console.ui.cells.lines import width_of
from madrob_console.ui.frame.frame_lines import (
    KeyLine,
    playback_line,
    speed_text,
    tiny_lines,
)
from madrob_console.ui.keys.dialogs import Leave, ask_leave
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS
from madrob_console.ui.look.themes import to_ascii
from madrob_console.ui.look.words import clock_text
from madrob_console.ui.panes.result_pane import ResultHead
from madrob_console.ui.panes.top_view import SCALES, TopView, top_view
from scoring.protocol import BenchmarkType, Condition, Side, StartPose
from tests.madrob_console.ui.driver import (
    Driver,
    PaneApp,
    Stories,
    driving,
    no,
    no_question,
    on_engine,
    play,
    sets,
)
from tests.madrob_console.ui.fake_engine import FakeEngine, a_setup

ARROWS = "↑↖←↙↓↘→↗"
SMALL, ROOMY = (15, 7), (30, 13)
SIZES = pytest.mark.parametrize("size", [SMALL, (24, 10), ROOMY, (41, 18)])
SIDES = pytest.mark.parametrize("side", list(Side))
CONDITIONS = st.integers(1, 20).map(Condition.from_number)
METRES = st.floats(-30, 30)
POSES = st.none() | st.builds(StartPose, METRES, METRES, st.floats(-720, 720))


def starting(side: Side, opening: Side = Side.CCW) -> Condition:
    return Condition(BenchmarkType.NO_FORCE, opening, side)


def drawn(
    condition: Condition,
    pose: StartPose | None,
    size: tuple[int, int] = ROOMY,
) -> list[str]:
    return ["".join(span.text for span in line) for line in top_view(condition, pose, *size)]


def place(rows: list[str], signs: str) -> tuple[int, int]:
    """Row and column of the one cell that shows one of `signs`."""
    ((y, x),) = [(y, x) for y, row in enumerate(rows) for x, c in enumerate(row) if c in signs]
    return y, x


@given(CONDITIONS, POSES, st.integers(15, 60), st.integers(7, 30))
def test_any_set_up_fills_exactly_the_cells_that_there_are(
    condition: Condition, pose: StartPose | None, width: int, height: int
) -> None:
    rows = drawn(condition, pose, (width, height))
    assert len(rows) == height
    assert {cell_len(row) for row in rows} == {width}
    text = "\n".join(rows)
    assert ("no pose" in text) == (pose is None)
    wrong = pose is not None and pose.side is not condition.starting_side
    assert ("WRONG SIDE" in text) == wrong


@pytest.mark.parametrize("size", [(14, 7), (15, 6), (0, 0), (80, 1)])
def test_without_room_nothing_is_drawn(size: tuple[int, int]) -> None:
    assert top_view(starting(Side.CCW), None, *size) == []


@SIDES
@SIZES
def test_the_robot_stands_on_its_side_and_looks_at_the_door(
    side: Side, size: tuple[int, int]
) -> None:
    yaw = 180.0 if side is Side.CCW else 0.0
    rows = drawn(starting(side), StartPose(1.5 * side.sign, 0.0, yaw), size)
    wall = next(y for y, row in enumerate(rows) if "━" in row)
    y, x = place(rows, ARROWS)
    assert (wall - y) * side.sign > 0
    assert x == (size[0] - 1) // 2
    assert rows[y][x] == ("↓" if side is Side.CCW else "↑")


def test_sides_start_and_scale_are_written() -> None:
    rows = drawn(starting(Side.CW), StartPose(-1.5, 0.0, 0.0), SMALL)
    assert rows[0] == "CCW        +2 m"
    assert rows[-1] == "CW start   -2 m"


@pytest.mark.parametrize("eighth", range(8))
def test_the_arrow_follows_the_yaw(eighth: int) -> None:
    for yaw in (45 * eighth, 45 * eighth + 20, 45 * eighth - 20, 45 * eighth - 360):
        rows = drawn(starting(Side.CCW), StartPose(1.5, 0.0, yaw))
        y, x = place(rows, ARROWS)
        assert rows[y][x] == ARROWS[eighth]


@pytest.mark.parametrize(
    ("yaw", "sign"),
    [
        (0, " ^ "),
        (45, " \\o"),
        (90, " < "),
        (135, " /o"),
        (180, " v "),
        (225, "o\\ "),
        (270, " > "),
        (315, "o/ "),
    ],
)
def test_in_ascii_every_direction_reads_differently(yaw: float, sign: str) -> None:
    rows = [to_ascii(row) for row in drawn(starting(Side.CCW), StartPose(1.5, 0.0, yaw))]
    y, x = place(rows, sign.replace("o", "").strip())
    assert rows[y][x - 1 : x + 2] == sign


def test_y_is_left_of_x() -> None:
    left = place(drawn(starting(Side.CCW), StartPose(1.5, 1.0, 180.0)), ARROWS)
    right = place(drawn(starting(Side.CCW), StartPose(1.5, -1.0, 180.0)), ARROWS)
    assert left[1] < right[1]
    assert left[0] == right[0]


@pytest.mark.parametrize("size", [SMALL, ROOMY, (60, 21)])
def test_a_metre_up_is_as_long_as_a_metre_aside(size: tuple[int, int]) -> None:
    """A cell is twice as high as it is wide."""
    scale = 2.0
    along = drawn(starting(Side.CCW), StartPose(1.5, 1.0, 0.0), size)
    assert f"+{scale:g} m" in along[0]
    y, x = place(along, ARROWS)
    wall, centre = (size[1] - 1) // 2, (size[0] - 1) // 2
    rows_a_metre = wall / scale
    assert abs((wall - y) - 1.5 * rows_a_metre) <= 0.5
    assert abs((centre - x) - 2 * rows_a_metre) <= 0.5


@SIDES
@SIZES
def test_the_panel_swings_on_the_opening_side_and_hangs_on_the_left(
    side: Side, size: tuple[int, int]
) -> None:
    rows = drawn(starting(Side.CCW, opening=side), None, size)
    wall = next(y for y, row in enumerate(rows) if "━" in row)
    swing = [y for y, row in enumerate(rows) if "·" in row]
    assert swing
    assert all((wall - y) * side.sign > 0 for y in swing)
    assert rows[wall].index("●") < rows[wall].index("─") < size[0] - 1


@pytest.mark.parametrize(
    ("pose", "scale"),
    [
        (StartPose(1.5, 0.0, 0.0), 2.0),
        (StartPose(2.2, 0.0, 0.0), 3.0),
        (StartPose(1.5, 4.5, 0.0), 5.0),
        (StartPose(9.0, 0.0, 0.0), 10.0),
        (StartPose(3.0, -18.0, 0.0), 20.0),
    ],
)
def test_the_scale_grows_with_the_pose(pose: StartPose, scale: float) -> None:
    rows = drawn(starting(Side.CCW), pose)
    assert scale in SCALES
    assert rows[0].endswith(f" +{scale:g} m")
    place(rows, ARROWS)


def test_a_robot_out_of_sight_is_drawn_at_the_edge_and_told() -> None:
    for pose in (StartPose(400.0, 0.0, 0.0), StartPose(1.5, -1e9, 0.0)):
        rows = drawn(starting(Side.CCW), pose)
        place(rows, ARROWS)
        assert any("beyond 20 m" in row for row in rows)


@pytest.mark.parametrize("size", [SMALL, ROOMY])
def test_a_pose_on_the_wrong_side_or_on_the_threshold_is_drawn_as_such(
    size: tuple[int, int],
) -> None:
    middle = (size[1] - 1) // 2
    for x, rows_above in ((-1.5, -1), (0.0, 0)):
        rows = drawn(starting(Side.CCW), StartPose(x, 0.0, 180.0), size)
        y, _ = place(rows, "x")
        assert math.copysign(1, middle - y) * (middle != y) == rows_above
        assert any("WRONG SIDE" in row for row in rows)


def test_a_robot_close_to_the_wall_stays_on_its_side() -> None:
    for side in Side:
        rows = drawn(starting(side), StartPose(0.01 * side.sign, 0.0, 0.0), SMALL)
        y, _ = place(rows, ARROWS)
        assert y == 3 - side.sign


def test_a_pose_that_is_no_number_is_no_pose() -> None:
    for pose in (StartPose(math.nan, 0, 0), StartPose(1, math.inf, 0), StartPose(1, 0, math.nan)):
        assert any("no pose" in row for row in drawn(starting(Side.CCW), pose))


async def test_the_widget_follows_what_is_typed() -> None:
    view = TopView()
    view.styles.width, view.styles.height = 30, 13
    async with PaneApp(view).run_test(size=(40, 20)) as pilot:
        for pose, word in ((StartPose(-1.5, 0, 0), "WRONG SIDE"), (None, "no pose")):
            view.show_setup(starting(Side.CCW), pose)
            await pilot.pause()
            rows = [view.render_line(y).text for y in range(view.size.height)]
            assert len(rows) == 13
            assert any(word in row for row in rows)


VIEW = PlaybackView(12.34, -5.0, 65.0, 1.0, paused=False, ended=False)


def text(playback: PlaybackView, width: int = 78) -> str:
    return "".join(span.text for span in playback_line(playback, width))


@pytest.mark.parametrize(
    ("playback", "words"),
    [
        (VIEW, " REPLAY  playing 1x  0:12.34 / 1:05.00  [==|======●---"),
        (replace(VIEW, paused=True, speed=0.5), "PAUSED 1/2x"),
        (replace(VIEW, jumping_to=61.0), "jumping to 1:01.00"),
        (replace(VIEW, ended=True, position=65.0), "at its end"),
        (replace(VIEW, speed=0.0), "playing max"),
    ],
)
def test_the_bar_says_position_length_and_speed_and_whether_it_plays(
    playback: PlaybackView, words: str
) -> None:
    assert words in text(playback)
    assert len(text(playback)) == 78


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
    assert [clock_text(t, 2) for t in (-0.02, 0.0, 1.98, 2.0, 60.0)] == [
        "-0:00.02", "0:00.00", "0:01.98", "0:02.00", "1:00.00",
    ]  # fmt: skip
    speeds = {0.0: "max", 0.5: "1/2x", 1.0: "1x", 10.0: "10x", 2.5: "2.5x"}
    assert {speed: speed_text(speed) for speed in speeds} == speeds


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
    return "".join(span.text for span in keys.lines(width)[0])


def test_the_footer_has_the_keys_of_a_replay_only_on_one() -> None:
    assert footer(replaying(), "live").startswith("Spc Pause  ,. 20ms  <> 1s  +- Speed  j Jump")
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
    lines = ["".join(s.text for s in line) for line in tiny_lines(replaying().snapshot(), 20)]
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
    rows = [
        "".join(s.text for s in line) for line in ResultHead().draw_lines(engine.snapshot(), 80)
    ]
    assert words in rows
    assert any("REPLAY: not an official result" in row for row in rows)
    assert not any("f finalises" in row for row in rows)


def commanded(command: PlaybackCommand) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.commands[-1] == command


STORIES: Stories = {
    "the keys move a replay and nothing else": [
        (on_engine(kind=SourceKind.REPLAY, playback=VIEW),),
        ("f3", "REPLAY  playing 1x"),
        (
            "space full_stop comma less_than_sign plus minus",
            lambda d: (
                d.engine.commands
                == [PlayOrPause(), Skip(0.02), Skip(-0.02), Skip(-1.0), Faster(), Slower()]
            ),
        ),
        ("j =1:05 enter", commanded(JumpTo(65.0))),
        ("j x enter", "'x' is no time"),
        ("escape f1", "j  Jump"),
        (lambda d: d.console.show_pane("figures"),),
        ("plus", commanded(JumpTo(65.0))),  # it zooms
        (sets(playback=None),),
        ("f3 space full_stop plus j", commanded(JumpTo(65.0)), no_question, no("REPLAY  ")),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(FakeEngine, STORIES[story])


async def test_o_has_the_cameras_frames_of_the_shown_instant_written_and_y_copies_where() -> None:
    engine = replaying()

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
