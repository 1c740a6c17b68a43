"""A replay on the screens, and the doorway from above."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from madrob_console.archive.appeal import EQUAL
from madrob_console.common.formatting import seconds_of
from madrob_console.common.names import SourceKind
from madrob_console.engine.playback import (
    Faster,
    JumpTo,
    PlaybackCommand,
    PlaybackView,
    PlayOrPause,
    Skip,
    Slower,
)
from madrob_console.engine.requests import GiveFrames
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.topic_health import Freshness
from madrob_console.ui.cells.lines import plain
from madrob_console.ui.frame.frame_lines import playback_line, tiny_lines
from madrob_console.ui.frame.key_line import KeyLine
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS
from madrob_console.ui.panes.result_pane import ResultHead
from madrob_console.ui.panes.top_view import doorway, top_view
from scoring.protocol import BenchmarkType, Condition, Side, StartPose, Step
from scoring.stamps import REORDERED
from tests.madrob_console.referee.test_acts import RUNNING
from tests.madrob_console.ui.driver import (
    Driver,
    Stories,
    has,
    no,
    no_question,
    on_engine,
    play,
    says,
    sets,
)
from tests.madrob_console.ui.inline_engine import HandEngine, at_rest, finished, start

ARROWS = "↑↖←↙↓↘→↗"
SMALL, ROOMY = (15, 7), (30, 13)
ROOMS = SMALL, (24, 10), ROOMY, (41, 18), (60, 21)
CONDITIONS = st.integers(1, 20).map(Condition.from_number)
METRES = st.floats(-30, 30)
POSES = st.none() | st.builds(StartPose, METRES, METRES, st.floats(-720, 720))


def starting(side: Side, opening: Side = Side.CCW) -> Condition:
    return Condition(BenchmarkType.NO_FORCE, opening, side)


def drawn(condition: Condition, pose: StartPose | None, size: tuple[int, int] = ROOMY) -> list[str]:
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


@given(
    st.sampled_from(list(Side)),
    st.sampled_from(ROOMS),
    st.just(0.0) | st.floats(-16, 16),  # farther it is beyond the smallest drawing
    st.floats(-15, 15),
)
def test_the_robot_stands_where_it_is_in_metres(
    side: Side, size: tuple[int, int], x: float, y: float
) -> None:
    """A cell is twice as high as it is wide; on the wall stands only what is on the threshold."""
    rows = drawn(starting(side), StartPose(x, y, 180.0), size)
    right_side = x * side.sign > 0
    row, column = place(rows, "↓" if right_side else "x")
    wall, centre = (size[1] - 1) // 2, (size[0] - 1) // 2
    rows_a_metre = wall / float(rows[0].rpartition("+")[2].removesuffix(" m"))
    up = (wall - row) * math.copysign(1, x)
    assert abs(up - max(abs(x) * rows_a_metre, float(x != 0))) <= 0.5 + 1e-9
    assert abs((centre - column) - 2 * y * rows_a_metre) <= 0.5 + 1e-9
    assert any("WRONG SIDE" in row for row in rows) is not right_side


@pytest.mark.parametrize("eighth", range(8))
def test_the_arrow_follows_the_yaw(eighth: int) -> None:
    for yaw in (45 * eighth, 45 * eighth + 20, 45 * eighth - 20, 45 * eighth - 360):
        rows = drawn(starting(Side.CCW), StartPose(1.5, 0.0, yaw))
        y, x = place(rows, ARROWS)
        assert rows[y][x] == ARROWS[eighth]


@pytest.mark.parametrize("side", Side)
@pytest.mark.parametrize("size", ROOMS)
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
    ("pose", "words"),
    [
        (StartPose(1.5, 0.0, 0.0), " +2 m"),
        (StartPose(2.2, 0.0, 0.0), " +3 m"),
        (StartPose(1.5, 4.5, 0.0), " +5 m"),
        (StartPose(9.0, 0.0, 0.0), " +10 m"),
        (StartPose(3.0, -18.0, 0.0), " +20 m"),
        (StartPose(400.0, 0.0, 0.0), "beyond 20 m"),
        (StartPose(1.5, -1e9, 0.0), "beyond 20 m"),
    ],
)
def test_the_scale_grows_with_the_pose_until_the_robot_is_out_of_sight(
    pose: StartPose, words: str
) -> None:
    rows = drawn(starting(Side.CCW), pose)
    assert any(words in row for row in rows)
    place(rows, ARROWS)


def test_a_pose_that_is_no_number_is_no_pose() -> None:
    for pose in (StartPose(math.nan, 0, 0), StartPose(1, math.inf, 0), StartPose(1, 0, math.nan)):
        assert any("no pose" in row for row in drawn(starting(Side.CCW), pose))


def live(state: Snapshot, size: tuple[int, int] = (30, 17)) -> list[str]:
    return ["".join(span.text for span in line) for line in doorway(state, *size)]


def panel_at(angle: float, freshness: Freshness = Freshness.FRESH) -> Snapshot:
    state = at_rest()
    return replace(state, door=replace(state.door, angle=angle, freshness=freshness))


def panel(rows: list[str]) -> list[tuple[int, int]]:
    """The cells of the panel: how far up and right of the hinge, in columns."""
    hinge = place(rows, "●")
    dotted = (
        (y, x) for y, row in enumerate(rows) for x, c in enumerate(row) if "\u2800" < c <= "\u28ff"
    )
    return [(2 * (hinge[0] - y), x - hinge[1]) for y, x in dotted]


@given(st.floats(-1.6, 1.6), st.sampled_from([(28, 10), (30, 17), (30, 24), (40, 40)]))
def test_the_live_panel_stands_at_its_measured_angle(angle: float, size: tuple[int, int]) -> None:
    """A cell is twice as high as it is wide; the sensors may hide a part of the panel."""
    rows = live(panel_at(angle), size)
    assert len(rows) == min(size[1], size[0] + 2)
    assert {cell_len(row) for row in rows[:10]} == {size[0]}
    for up, right in panel(rows):
        off = math.remainder(math.atan2(up, right) - angle, math.tau)
        assert abs(off) * math.hypot(up, right) <= 2.5
    wide = max(row.count("─") for row in live(panel_at(1.5), size))
    assert max(math.hypot(*cell) for cell in panel(rows)) >= 0.8 * wide - 2  # as long as that


@pytest.mark.parametrize("freshness", [Freshness.STALE, Freshness.LOST, Freshness.NEVER])
def test_a_panel_that_is_not_measured_now_is_not_drawn(freshness: Freshness) -> None:
    rows = live(panel_at(0.4, freshness))
    assert panel(rows) == []
    assert any(f"no angle: {freshness}" in row for row in rows)


def test_the_live_door_shows_what_the_sensors_see_and_on_which_side_the_robot_is() -> None:
    engine = start(HandEngine(), 6.0)
    engine.put(occupied={(Side.CCW, 0), (Side.CW, 4)})
    rows = live(engine.snapshot())
    wall = next(y for y, row in enumerate(rows) if "━" in row)
    assert [char for char in rows[wall - 1] if char in "O."] == [*"....O"]
    assert [char for char in rows[wall + 1] if char in "O."] == [*"O...."]
    assert rows[0].startswith("CCW robot")
    engine.do_step(Step.CROSS)
    engine.tick(REORDERED)
    rows = live(engine.snapshot())
    engine.end()
    assert [row.split()[:2] for row in (rows[0], rows[-3])] == [["CCW", "+1.2"], ["CW", "robot"]]


VIEW = PlaybackView(12.34, -5.0, 65.0, 1.0, paused=False, ended=False)


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
    bar = plain([playback_line(playback, 78)])
    assert words in bar
    assert len(bar) == 78


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
    bar = plain([playback_line(view, width)])
    assert bar.startswith(f" REPLAY  {'PAUSED' if paused else 'playing'} 10x")
    assert cell_len(bar) <= max(width, 50)


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


def replaying(state: Snapshot, view: PlaybackView = VIEW) -> Snapshot:
    kind, label = SourceKind.REPLAY, "REPLAY of the morning"
    result_source = state.result_source and kind
    return replace(
        state, source_kind=kind, source_label=label, result_source=result_source, playback=view
    )


@pytest.mark.parametrize(
    ("replays", "pane", "there"),
    [
        (True, "live", True),
        (True, "results", True),
        (False, "live", False),
        *((True, pane, False) for pane in ("figures", "setup", "history")),
    ],
)
def test_the_footer_has_the_keys_of_a_replay_only_on_one(
    pane: str, *, replays: bool, there: bool
) -> None:
    keys = KeyLine()
    keys.pane, keys._snapshot = pane, replaying(at_rest()) if replays else at_rest()
    assert ("j Jump" in plain(keys.lines(80 if there else 200))) is there


def test_the_smallest_screen_says_that_it_is_a_replay() -> None:
    lines = plain(tiny_lines(replaying(at_rest()), 20))
    assert "REPLAY playing 1x" in lines.splitlines()
    assert "F8" not in lines


@pytest.mark.parametrize(
    "words", [EQUAL, "differs from the stored result: execution time 12.30, stored 12.32"]
)
def test_the_result_says_how_it_compares_with_the_stored_one(words: str) -> None:
    state = replaying(finished(), replace(VIEW, ended=True, comparison=words))
    head = plain(ResultHead().draw_lines(state, 80))
    assert words in head.splitlines()
    assert "REPLAY: not an official result" in head
    assert "f finalises" not in head


def commanded(command: PlaybackCommand | GiveFrames) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.sent(PlaybackCommand, GiveFrames)[-1] == command


FRAMES = "/tmp/madrob_frames_1/run_12.340_s"
STORIES: Stories = {
    "o has the cameras frames of the shown instant written and y copies where": [
        (on_engine(kind=SourceKind.REPLAY, playback=VIEW),),
        ("f3 o", commanded(GiveFrames()), says("it holds no evidence")),
        (sets(frames=FRAMES),),
        ("o", says(f"y copies where they are: {FRAMES}")),
        ("enter y f", lambda d: d.copies[-1] == FRAMES),
        ("enter y g", lambda d: re.fullmatch(rf"scp -r \w+@\w*:{FRAMES} \.", d.copies[-1])),
    ],
    "the keys move a replay and nothing else": [
        (on_engine(kind=SourceKind.REPLAY, playback=VIEW),),
        ("f3", "REPLAY  playing 1x"),
        (has(run=RUNNING), lambda d: "GOES ON" not in d.console.status),  # it is of the recording
        (
            "space full_stop comma less_than_sign plus minus",
            lambda d: (
                d.engine.sent(PlaybackCommand)
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
    await play(HandEngine, STORIES[story])
