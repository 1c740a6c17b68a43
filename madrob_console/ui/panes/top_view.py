"""The door seen from above, with the robot at its start pose (protocol section 1).

x points up, to the CCW side, and y to the left; the hinge is on the left, as in the live view
of the passage sensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, joined
from scoring.protocol import Condition, Side, StartPose

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
    sheet = _Sheet(width, height, pose)
    sheet.draw_door(condition.opening_side)
    sheet.write_labels(condition.starting_side)
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

    def __init__(self, width: int, height: int, pose: StartPose | None) -> None:
        self.cells = [[Span(" ")] * width for _ in range(height)]
        self._middle, self._centre = (height - 1) // 2, (width - 1) // 2
        at = StartPose(0.0, 0.0, 0.0) if pose is None else pose
        fitting = (scale for scale in SCALES if self._holds(at, scale))
        self.scale = next(fitting, SCALES[-1])
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

    def draw_door(self, opening: Side) -> None:
        row = self._row_length(self.scale)
        half = max(1, round(DOORWAY / row))  # half the doorway in cells of half a row
        hinge = self._centre - half
        for degrees in range(3, 91, 3):
            angle = math.radians(degrees)
            up = round(math.sin(angle) * DOORWAY / row)
            right = round(math.cos(angle) * 2 * half)
            dot = Span("·")
            self.put(self._middle - opening.sign * max(1, up), hinge + right, dot)
        wide = len(self.cells[0])
        self.cells[self._middle] = [Span("━")] * wide
        self.write(self._middle, hinge + 1, "─" * (2 * half), Tone.DIM)
        self.put(self._middle, hinge, Span("●", Tone.STRONG))

    def write_labels(self, starting: Side) -> None:
        wide = len(self.cells[0])
        for side, row in ((Side.CCW, 0), (Side.CW, len(self.cells) - 1)):
            start = " start" if side is starting else ""
            self.write(row, 0, side.upper() + start, Tone.STRONG)
            end = f"{side.sign * self.scale:+g} m"
            self.write(row, wide - len(end), end, Tone.DIM)
        if wide >= _ROOM_FOR_Y:
            self.write(self._middle, 0, "+y ", Tone.DIM)

    def write_words(self, text: str, tone: Tone) -> None:
        row = len(self.cells) - 2 if self.place[0] <= self._middle else 1
        self.write(row, (len(self.cells[0]) - len(text)) // 2, text, tone)

    def draw_arrow(self, yaw: float) -> None:
        """One of eight directions; the body beside a slash says which of its ends is ahead."""
        row, column = self.place
        eighth = round(yaw / 45) % 8
        if eighth % 2:
            self.put(row, column + (1 if eighth in (1, 3) else -1), Span("o", Tone.STRONG))
        self.put(row, column, Span(_ARROWS[eighth], Tone.STRONG))
