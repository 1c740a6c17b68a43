"""The door seen from above: the robot at its start pose (protocol section 1), or the live door.

x points up, to the CCW side, and y to the left; the hinge is on the left.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.topic_health import Freshness
from madrob_console.ui.cells.axes import joined
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, View, line
from madrob_console.ui.cells.plot import HIGH, WIDE, put_dot
from scoring.protocol import Condition, Side, StartPose, Step

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import SensorView, Snapshot

SCALES = (2.0, 3.0, 5.0, 10.0, 20.0)
"""How far the drawing may reach on each side of the wall, m."""

DOORWAY = 1.0
"""Width of the doorway as drawn, m; the testbed's may differ."""

LEAST_WIDTH, LEAST_HEIGHT = 15, 7

_ROOM_FOR_Y = 24


_ARROWS = "↑↖←↙↓↘→↗"
"""Counter-clockwise from up."""


class TopView(Lines):
    """Follows the set-up; as many rows as its style gives it."""

    _condition: Condition | None = None
    _pose: StartPose | None = None

    def show_setup(self, condition: Condition, pose: StartPose | None) -> None:
        self._condition, self._pose = condition, pose
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        if self._condition is None:
            return ()
        return top_view(self._condition, self._pose, width, self.room.height)


def top_view(condition: Condition, pose: StartPose | None, width: int, height: int) -> list[Line]:
    """The drawing in `width` x `height` cells, 15 x 7 at least; empty in fewer.

    The starting side must hold `pose`; None = no pose is known.
    """
    if width < LEAST_WIDTH or height < LEAST_HEIGHT:
        return []
    if pose is not None and not all(map(math.isfinite, (pose.x, pose.y, pose.yaw))):
        pose = None
    sheet = _Sheet(width, height, SCALES, pose)
    sheet.draw_door(condition.opening_side)
    sheet.write_labels(condition.starting_side, "start")
    if width >= _ROOM_FOR_Y:
        sheet.write((height - 1) // 2, 0, "+y ", Tone.DIM)
    if pose is None:
        sheet.write_words("no pose", Tone.WARN)
    elif pose.side is not condition.starting_side:
        sheet.put(*sheet.place, Span("x", Tone.BAD))
        sheet.write_words("WRONG SIDE", Tone.BAD)
    else:
        sheet.draw_arrow(pose.yaw)
        if sheet.beyond:
            sheet.write_words(f"beyond {sheet.scale:g} m", Tone.WARN)
    return [joined(row) for row in sheet.cells]


class _Sheet:
    """Cells, and where the metres are on them; a cell is twice as high as it is wide."""

    def __init__(
        self, width: int, height: int, scales: Sequence[float], pose: StartPose | None = None
    ) -> None:
        self.cells = [[Span(" ")] * width for _ in range(height)]
        self._middle, self._centre = (height - 1) // 2, (width - 1) // 2
        at = StartPose(0.0, 0.0, 0.0) if pose is None else pose
        fitting = (scale for scale in scales if self._holds(at, scale))
        self.scale = next(fitting, scales[-1])
        self.beyond = not self._holds(at, self.scale)
        self.place = self._cell(at)

    def _row_length(self, scale: float) -> float:
        """Metres in the height of a row; a cell is half as wide."""
        return scale / self._middle

    def _holds(self, pose: StartPose, scale: float) -> bool:
        row = self._row_length(scale)
        return abs(pose.x) / row <= self._middle - 0.5 and abs(pose.y) / row * 2 <= self._centre

    def _cell(self, pose: StartPose) -> tuple[int, int]:
        """Row and column of a pose: never on the wall unless it is on the threshold."""
        row = self._row_length(self.scale)
        away = min(self._middle - 1, max(1, round(abs(pose.x) / row))) if pose.x else 0
        aside = min(self._centre, round(abs(pose.y) / row * 2))
        return (
            self._middle - int(math.copysign(away, pose.x)),
            self._centre - int(math.copysign(aside, pose.y)),
        )

    def put(self, row: int, column: int, span: Span) -> None:
        if 0 <= row < len(self.cells) and 0 <= column < len(self.cells[0]):
            self.cells[row][column] = span

    def write(self, row: int, column: int, text: str, tone: Tone) -> None:
        for offset, char in enumerate(text):
            self.put(row, column + offset, Span(char, tone))

    @property
    def _half(self) -> int:
        """Half the doorway in cells of half a row."""
        return max(1, round(DOORWAY / self._row_length(self.scale)))

    @property
    def _hinge(self) -> int:
        return self._centre - self._half

    def draw_door(self, opening: Side | None) -> None:
        row, half = self._row_length(self.scale), self._half
        for degrees in range(3, 91, 3):
            angle = math.radians(degrees)
            up = max(1, round(math.sin(angle) * DOORWAY / row))
            right = round(math.cos(angle) * 2 * half)
            if opening is not None:
                self.put(self._middle - opening.sign * up, self._hinge + right, Span("·"))
        wide = len(self.cells[0])
        self.cells[self._middle] = [Span("━")] * wide
        self.write(self._middle, self._hinge + 1, "─" * (2 * half), Tone.DIM)
        self.put(self._middle, self._hinge, Span("●", Tone.STRONG))

    def draw_panel(self, angle: float, tone: Tone) -> None:
        """As it stands, `angle` in rad."""
        rows = DOORWAY / self._row_length(self.scale)
        for step in range(1, 41):
            x = self._hinge + 1 + step / 40 * math.cos(angle) * (2 * self._half - 1)
            y = self._middle + 0.5 - step / 40 * math.sin(angle) * rows
            if 0 <= x < len(self.cells[0]) and 0 <= y < len(self.cells):
                put_dot(self.cells, int(x * WIDE), int(y * HIGH), tone)
        self.put(self._middle, self._hinge, Span("●", Tone.STRONG))

    def draw_sensors(self, sensors: Iterable[SensorView]) -> None:
        """Each in its place along the doorway, on its side of the wall."""
        for sensor in sensors:
            cell = self._hinge + round((5 - sensor.index) / 5 * 2 * self._half)
            self.put(self._middle - sensor.side.sign, cell, symbol(sensor))

    def write_labels(self, marked: Side | None, word: str) -> None:
        """The sides and how far they are drawn; `word` is about the `marked` one."""
        wide = len(self.cells[0])
        for side, row in ((Side.CCW, 0), (Side.CW, len(self.cells) - 1)):
            text = f"{side.upper()} {word}" if side is marked else side.upper()
            self.write(row, 0, text, Tone.STRONG)
            end = f"{side.sign * self.scale:+g} m"
            self.write(row, wide - len(end), end, Tone.DIM)

    def write_words(self, text: str, tone: Tone) -> None:
        row = len(self.cells) - 2 if self.place[0] <= self._middle else 1
        self.write(row, (len(self.cells[0]) - len(text)) // 2, text, tone)

    def draw_arrow(self, yaw: float) -> None:
        """One of eight directions."""
        row, column = self.place
        self.put(row, column, Span(_ARROWS[round(yaw / 45) % 8], Tone.STRONG))


_REACH = 1.2
"""How far the live drawing reaches on each side of the wall, m: the open panel is inside."""

_ROWS_WITH_LEGEND = 13

LEGEND = (
    ("O", "occupied"),
    (".", "clear"),
    ("m", "masked by the panel, clear before"),
    ("M", "masked by the panel, occupied before"),
    ("s", "stale"),
    ("?", "no data"),
)


def symbol(sensor: SensorView) -> Span:
    if sensor.freshness is Freshness.STALE:
        return Span("s", Tone.WARN)
    if sensor.freshness is not Freshness.FRESH or sensor.occupied is None:
        return Span("?", Tone.BAD)
    if sensor.masked:
        return Span("M" if sensor.occupied else "m", Tone.DIM)
    return Span("O", Tone.NOTICE) if sensor.occupied else Span(".")


class Doorway(View):
    """The panel at its measured angle, the passage sensors, and on which side the robot is."""

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        return doorway(snapshot, width, self.room.height)


def doorway(snapshot: Snapshot, width: int, height: int) -> list[Line]:
    """The drawing in `width` x `height` cells, 26 x 10 at least; in few rows without its legend."""
    words = ("O occupied  . clear", "m masked s stale ? no data")
    legend = [line(Span(text, Tone.DIM)) for text in words if height >= _ROWS_WITH_LEGEND]
    sheet = _Sheet(width, min(height - len(legend), width), (_REACH,))
    setup, door = snapshot.run.setup, snapshot.door
    sheet.draw_door(None if setup is None else setup.condition.opening_side)
    side = None
    if setup is not None:
        crossed = snapshot.steps[Step.CROSS - 1].done
        side = setup.condition.destination_side if crossed else setup.condition.starting_side
    sheet.write_labels(side, "robot")
    if door.angle is None or door.freshness is not Freshness.FRESH:
        sheet.write_words(f"no angle: {door.freshness}", Tone.BAD)
    else:
        sheet.draw_panel(door.angle, Tone.WARN if door.is_open else Tone.GOOD)
    sheet.draw_sensors(snapshot.passage)
    return [*(joined(row) for row in sheet.cells), *legend]
