from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from textual.app import App, ComposeResult
from textual.screen import Screen

from madrob_console.ui.cells.lines import TONE_CLASSES
from madrob_console.ui.panes.top_view import SCALES, TopView, top_view
from scoring.protocol import BenchmarkType, Condition, Side, StartPose

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
    *,
    ascii: bool = False,  # noqa: A002 - what it is
) -> list[str]:
    return ["".join(span.text for span in line) for line in top_view(condition, pose, *size, ascii)]


def place(rows: list[str], signs: str) -> tuple[int, int]:
    """Row and column of the one cell that shows one of `signs`."""
    ((y, x),) = [(y, x) for y, row in enumerate(rows) for x, c in enumerate(row) if c in signs]
    return y, x


@given(CONDITIONS, POSES, st.integers(15, 60), st.integers(7, 30), st.booleans())
def test_any_set_up_fills_exactly_the_cells_that_there_are(
    condition: Condition, pose: StartPose | None, width: int, height: int, plain: bool
) -> None:
    rows = drawn(condition, pose, (width, height), ascii=plain)
    assert len(rows) == height
    assert {cell_len(row) for row in rows} == {width}
    assert not plain or all(row.isascii() for row in rows)
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
    rows = drawn(starting(Side.CCW), StartPose(1.5, 0.0, yaw), ascii=True)
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


class Page(Screen[None]):
    COMPONENT_CLASSES = TONE_CLASSES

    def compose(self) -> ComposeResult:
        yield TopView()


class PageApp(App[None]):
    CSS = "TopView { width: 30; height: auto; }"

    def get_default_screen(self) -> Screen[None]:
        return Page()


def test_the_widget_follows_what_is_typed() -> None:
    async def drive() -> None:
        app = PageApp()
        async with app.run_test(size=(40, 20)) as pilot:
            view = app.screen.query_one(TopView)
            for pose, word in ((StartPose(-1.5, 0, 0), "WRONG SIDE"), (None, "no pose")):
                view.show_setup(starting(Side.CCW), pose)
                await pilot.pause()
                rows = [view.render_line(y).text for y in range(view.size.height)]
                assert len(rows) == 13
                assert any(word in row for row in rows)

    asyncio.run(drive())
