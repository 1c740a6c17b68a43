"""The figures pane: the curves behind a result, and the passage seen from above."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.geometry import Size
from textual.message import Message

from madrob_console.common.errors import MadrobError
from madrob_console.engine.requests import Curves
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, joined, line, paragraph
from madrob_console.ui.cells.plot import ASCII, BRAILLE, LARGEST, Frame, Ink, Mark, Plot, Window
from madrob_console.ui.look.words import fitted
from madrob_console.ui.panes.run_status import what_text
from scoring.indicator_table import (
    EventMark,
    FigureName,
    FigurePart,
    PanelSpec,
    Quantity,
    marked_events,
)
from scoring.protocol import Condition, Outcome, Side, StartPose
from scoring.result import value_text

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

# The figures of the protocol document, drawn into cells (protocol section 6).


KEYS = "left right: in time   up down: zoom   0: all   Tab: next figure"

_LEAST_ROWS = 3
_ROWS_WITH_LEGEND = 15
_ROWS_WITH_KEYS = 17


FIGURES = tuple(name.spec for name in FigureName if name.spec.part is FigurePart.WHOLE)
"""In the document's order, without its parts of a run: those are zoomed to."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One figure of one run, ready to be drawn; `number` is an index into `FIGURES`."""

    number: int
    curves: Curves
    snapshot: Snapshot
    window: Window

    def lines(self, width: int, height: int, ink: Ink = BRAILLE) -> list[Line]:
        """Title, plots, time axis and legend; words give way if rows are few, 13 for two plots."""
        figure = FIGURES[self.number]
        events = marked_events(self.curves.events, self._condition)
        run = line(Span(what_text(self.snapshot.run), Tone.DIM))
        head = [self._title(width), run, self._finding()]
        foot = [_legend(events)] if height >= _ROWS_WITH_LEGEND else []
        if height >= _ROWS_WITH_KEYS:
            foot.append(line(Span(KEYS, Tone.DIM)))
        axis_rows = 2
        rows = height - len(head) - len(foot) - len(figure.panels) - axis_rows
        heights = _shares(rows, len(figure.panels))
        plots = [self._plot(quantity) for quantity in figure.panels]
        gutter = max(plot.axis(h).gutter for plot, h in zip(plots, heights, strict=True))
        marks = [Mark(time, mark.letter) for mark, times in events.items() for time in times]
        frame = Frame(self.window, width, gutter, marks, ink)
        body: list[Line] = []
        for quantity, plot, h in zip(figure.panels, plots, heights, strict=True):
            body += [self._heading(quantity.spec, plot), *frame.plot(plot, h)]
        return [*head, *body, *frame.time_axis(), *foot]

    @property
    def _condition(self) -> Condition | None:
        setup = self.snapshot.run.setup
        return None if self.snapshot.result is None or setup is None else setup.condition

    def _plot(self, quantity: Quantity) -> Plot:
        spec = quantity.spec
        return Plot(
            self.curves.curves_of(quantity),
            spec.least,
            absolute=spec.clip is not None,
            clip=spec.clip or LARGEST,
            zone=self.snapshot.door.closed_angle if spec.closed_zone else None,
        )

    def _title(self, width: int) -> Line:
        first, last = self.curves.extent
        whole = self.window.start <= first and self.window.end >= last
        text = f"figure {self.number + 1} of {len(FIGURES)}: {FIGURES[self.number].title}"
        part = "all" if whole else "part"
        right = f"  {self.window.start:.2f} to {self.window.end:.2f} s, {part}"
        return line(Span(fitted(text, width - len(right)) + right, Tone.STRONG))

    def _finding(self) -> Line:
        figure, result = FIGURES[self.number], self.snapshot.result
        name = figure.indicator.words
        if result is None:
            return line(name)
        indicator = result.indicators[figure.indicator]
        begin = f"{result.ruleset}: {name} "
        if indicator.value is None:
            return line(begin, Span(indicator.text, Tone.WARN))
        return line(begin, Span(indicator.text, Tone.STRONG), f" = {figure.meaning}")

    def _heading(self, panel: PanelSpec, plot: Plot) -> Line:
        top = plot.extreme()
        name = Span(f"{panel.filtered} {panel.label}, {panel.unit}".lstrip(), Tone.STRONG)
        if top is None:
            return line(name, Span("   no data", Tone.WARN))
        largest = "max" if plot.absolute else "max abs"
        where = "" if top.time in self.window else ", not in this part"
        return line(
            name,
            Span(_remark(panel), Tone.DIM),
            f"   {largest} {value_text(abs(top.value))} at {top.time:.2f} s{where}",
        )


def _remark(panel: PanelSpec) -> str:
    clipped = f"clipped at {panel.clip:g}" if panel.clip is not None else ""
    remark = panel.remark or clipped or ("closed zone dotted" if panel.closed_zone else "")
    return f" ({remark})" if remark else ""


def _legend(events: Mapping[EventMark, Sequence[float]]) -> Line:
    if not events:
        return line(Span("no touch, no opening", Tone.DIM))
    spans: list[str | Span] = []
    for mark, times in events.items():
        spans += [Span(mark.letter, Tone.STRONG), f" {mark} {_times(times)}  "]
    return line(*spans, "s")


def _times(times: Sequence[float]) -> str:
    between = f" .. ({len(times)}) .. " if len(times) > 2 else " "
    return between.join(f"{time:.2f}" for time in dict.fromkeys((times[0], times[-1])))


def _shares(rows: int, parts: int) -> Iterable[int]:
    share, more = divmod(max(rows, parts * _LEAST_ROWS), parts)
    return [share + (part < more) for part in range(parts)]


SHORTEST_WINDOW = 0.2
"""The least time that is shown, s."""

READING = "reading the curves ..."
NO_RESULT = "no result yet: the figures come with it"

_ZOOM = 1.5
_STEP = 0.25


class FigureView(Lines):
    """One figure, or a message, in all the room there is."""

    content: Sheet | tuple[str, Tone] = (READING, Tone.DIM)

    def lines(self, width: int) -> Sequence[Line]:
        if isinstance(self.content, Sheet):
            ink = ASCII if self.ascii_only else BRAILLE
            return self.content.lines(width, self.room.height, ink)
        text, tone = self.content
        return paragraph(text, width, tone)


class FiguresPane(Vertical, can_focus=True):
    """One figure at a time, zoomable in time; `load`, called in a thread, may take a while."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "move(-1)", show=False),
        Binding("right", "move(1)", show=False),
        Binding("up,plus,equals_sign", "zoom(1)", show=False),
        Binding("down,minus", "zoom(-1)", show=False),
        Binding("0,home", "show_all", show=False),
        Binding("tab,space,right_square_bracket", "turn(1)", show=False),
        Binding("shift+tab,left_square_bracket", "turn(-1)", show=False),
    ]

    @dataclass
    class Loaded(Message):
        """What the thread has read; `number` says for which request."""

        number: int
        curves: Curves | None
        trouble: str = ""

    def __init__(self, load: Callable[[], Curves | None]) -> None:
        super().__init__(id="figures")
        self._load = load
        self._view = FigureView()
        self._snapshot: Snapshot | None = None
        self._shown: tuple[float | None, int] | None = None
        self._loaded: FiguresPane.Loaded | None = None
        self._requests = 0
        self._figure = 0
        self._window: Window | None = None

    def compose(self) -> ComposeResult:
        yield self._view

    def enter(self) -> None:
        self.focus()
        self._request()

    def show(self, snapshot: Snapshot) -> None:
        shown = (snapshot.run.start, snapshot.run.issue)
        if shown == self._shown:
            return
        if self._shown is None or shown[0] != self._shown[0]:
            self._window = self._loaded = None
        self._snapshot, self._shown = snapshot, shown
        self._request()

    def _request(self) -> None:
        self._requests += 1
        number = self._requests
        self.run_worker(lambda: self._read(number), thread=True)
        self._redraw()

    def _read(self, number: int) -> None:
        """In the thread: it must not wait for the screens."""
        try:
            loaded = self.Loaded(number, self._load())
        except (MadrobError, OSError, MemoryError) as error:
            loaded = self.Loaded(number, None, str(error) or "no memory")
        self.post_message(loaded)

    def on_figures_pane_loaded(self, event: Loaded) -> None:
        if event.number == self._requests:
            self._loaded = event
            self._redraw()

    def action_move(self, way: int) -> None:
        if (window := self._window) is not None:
            self._look(window.middle + way * _STEP * window.width, window.width)

    def action_zoom(self, way: int) -> None:
        window = self._window or self._whole()
        self._look(window.middle, window.width / _ZOOM**way)

    def action_show_all(self) -> None:
        self._window = None
        self._redraw()

    def action_turn(self, way: int) -> None:
        self._figure = (self._figure + way) % len(FIGURES)
        self._redraw()

    def _whole(self) -> Window:
        curves = None if self._loaded is None else self._loaded.curves
        first, last = (0.0, 0.0) if curves is None else curves.extent
        return Window(first, max(last, first + SHORTEST_WINDOW))

    def _look(self, middle: float, width: float) -> None:
        """Shows `width` s around `middle`, as far as there is that much."""
        whole = self._whole()
        width = max(SHORTEST_WINDOW, width)
        if width >= whole.width:
            self._window = None
        else:
            start = min(max(middle - width / 2, whole.start), whole.end - width)
            self._window = Window(start, start + width)
        self._redraw()

    def _redraw(self) -> None:
        self._view.content = self._content()
        self._view.redraw()

    def _content(self) -> Sheet | tuple[str, Tone]:
        loaded, snapshot = self._loaded, self._snapshot
        if loaded is None or snapshot is None:
            return READING, Tone.DIM
        if loaded.trouble:
            return loaded.trouble, Tone.BAD
        if loaded.curves is None:
            return NO_RESULT, Tone.DIM
        if loaded.curves.empty:
            return _nothing(snapshot), Tone.WARN
        return Sheet(self._figure, loaded.curves, snapshot, self._window or self._whole())


def _nothing(snapshot: Snapshot) -> str:
    if snapshot.run.outcome is Outcome.ABORTED:
        return "no figures: the run was aborted and is invalid"
    return "no figures: nothing was recorded of door and handle during the run"


# The door seen from above, with the robot at its start pose (protocol section 1).
#
# x points up, to the CCW side, and y to the left; the hinge is on the left, as in the live view
# of the passage sensors.


SCALES = (2.0, 3.0, 5.0, 10.0, 20.0)
"""How far the drawing may reach on each side of the wall, m."""

DOORWAY = 1.0
"""Width of the doorway as drawn, m; the testbed's may differ."""

LEAST_WIDTH, LEAST_HEIGHT = 15, 7
GOOD_HEIGHT = 13

_ROOM_FOR_Y = 24


@dataclass(frozen=True, slots=True)
class _Ink:
    """Wall, hinge, closed panel, swing, and arrows counter-clockwise from up."""

    wall: str
    hinge: str
    panel: str
    swing: str
    arrows: str


_LINES = _Ink("━", "●", "─", "·", "↑↖←↙↓↘→↗")
_ASCII = _Ink("#", "+", "-", ".", "^\\</v\\>/")


class TopView(Lines):
    """Follows the set-up; as many rows as its style gives it, 13 if that is `auto`."""

    _condition: Condition | None = None
    _pose: StartPose | None = None

    def show_setup(self, condition: Condition, pose: StartPose | None) -> None:
        self._condition, self._pose = condition, pose
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        if self._condition is None:
            return ()
        height = self.room.height
        return top_view(self._condition, self._pose, width, height, self.ascii_only)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        return GOOD_HEIGHT


def top_view(
    condition: Condition,
    pose: StartPose | None,
    width: int,
    height: int,
    ascii: bool = False,  # noqa: A002 - what it is
) -> list[Line]:
    """The drawing in `width` x `height` cells, 15 x 7 at least; empty in fewer.

    The starting side must hold `pose`; None = no pose is known.
    """
    if width < LEAST_WIDTH or height < LEAST_HEIGHT:
        return []
    if pose is not None and not all(map(math.isfinite, (pose.x, pose.y, pose.yaw))):
        pose = None
    sheet = _Sheet(width, height, pose, _ASCII if ascii else _LINES)
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

    def __init__(self, width: int, height: int, pose: StartPose | None, ink: _Ink) -> None:
        self.cells = [[Span(" ")] * width for _ in range(height)]
        self._ink = ink
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
        ink, row = self._ink, self._row_length(self.scale)
        half = max(1, round(DOORWAY / row))  # half the doorway in cells of half a row
        hinge = self._centre - half
        for degrees in range(3, 91, 3):
            angle = math.radians(degrees)
            up = round(math.sin(angle) * DOORWAY / row)
            right = round(math.cos(angle) * 2 * half)
            dot = Span(ink.swing)
            self.put(self._middle - opening.sign * max(1, up), hinge + right, dot)
        wide = len(self.cells[0])
        self.cells[self._middle] = [Span(ink.wall)] * wide
        self.write(self._middle, hinge + 1, ink.panel * (2 * half), Tone.DIM)
        self.put(self._middle, hinge, Span(ink.hinge, Tone.STRONG))

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
        """The robot, in one of eight directions; in ASCII a body beside a slash says which way."""
        row, column = self.place
        eighth = round(yaw / 45) % 8
        if self._ink is _ASCII and eighth % 2:
            self.put(row, column + (1 if eighth in (1, 3) else -1), Span("o", Tone.STRONG))
        self.put(row, column, Span(self._ink.arrows[eighth], Tone.STRONG))
