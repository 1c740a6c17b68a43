"""Text of few bytes: lines that write changed cells only.

A screen over SSH must stay small (a full repaint at 10 Hz is over 100 kB/s), so the live widgets
draw lines of spans, compare them with what is on screen and refresh the cells between the first
and the last difference. A span carries a tone, not markup: text from outside shows as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple, Self

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.color import Color
from textual.geometry import Region, Size
from textual.strip import Strip
from textual.widget import Widget

from madrob_console.common.names import terminal_safe
from madrob_console.ui.look.words import wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot


class Tone(StrEnum):
    """What a span means; `console_screen.tcss` says how it looks. Never the only carrier of it."""

    PLAIN = "plain"
    DIM = "dim"
    STRONG = "strong"
    GOOD = "good"
    WARN = "warn"
    BAD = "bad"
    CAP = "cap"
    LIVE = "live"
    NOTICE = "notice"
    ALARM = "alarm"
    CURSOR = "cursor"


TONE_CLASSES = {f"tone--{tone}" for tone in Tone}
"""Component classes of every screen that holds lines."""


class Span(NamedTuple):
    """A stretch of text in one tone."""

    text: str
    tone: Tone = Tone.PLAIN


class Target(Span):
    """A span that can be clicked: a key's name, unless its widget takes `click` otherwise."""

    click: str

    def __new__(cls, text: str, tone: Tone, click: str) -> Self:
        target = super().__new__(cls, text, tone)
        target.click = click
        return target


Line = tuple[Span, ...]


def line(*parts: str | Span) -> Line:
    return tuple(part if isinstance(part, Span) else Span(part) for part in parts if part)


def width_of(spans: Line) -> int:
    """Width of a line, cells."""
    return sum(_width(span.text) for span in spans)


@lru_cache(4096)
def _width(text: str) -> int:
    return cell_len(terminal_safe(text))


def plain(lines: Iterable[Line]) -> str:
    rows = ("".join(terminal_safe(span.text) for span in spans).rstrip() for spans in lines)
    return "\n".join(rows)


def paragraph(text: str, width: int, tone: Tone = Tone.PLAIN, head: Line = ()) -> list[Line]:
    """A text on as many rows of `width` cells as it needs; with a head, all of it beside that."""
    indent = width_of(head)
    first, *more = wrapped(text, max(10, width - indent) if head else width)
    return [(*head, Span(first, tone)), *(line(" " * indent, Span(row, tone)) for row in more)]


NAMED_KEYS = {
    **{f"F{number}": f"f{number}" for number in range(10, 0, -1)},
    "Enter": "enter",
    "Escape": "escape",
    "Ctrl+P": "ctrl+p",
    "Ctrl+R": "ctrl+r",
}
"""Keys that any text may name."""


def with_keys(rows: Iterable[Line], keys: Mapping[str, str] = NAMED_KEYS) -> list[Line]:
    """Makes the words clickable that name a key; `keys` has Textual's names of those."""
    named = re.compile(f"({'|'.join(map(re.escape, keys))})")
    return [
        tuple(
            Target(text, span.tone, keys[text]) if text in keys else Span(text, span.tone)
            for span in row
            for text in named.split(span.text)
            if text
        )
        for row in rows
    ]


class Unmarked(Widget):
    """Looks alike with and without the focus: Textual would style it and all in it anew."""

    def watch_has_focus(self, _has_focus: bool) -> None:
        """Nothing is seen of it."""


class Lines(Widget):
    """A widget made of lines of spans."""

    ALLOW_SELECT = False

    _drawn: tuple[Line, ...] = ()
    _for: int = 0
    _base: tuple[Style, Color] | None = None
    _tones: dict[Tone, Style] = {}  # noqa: RUF012  each widget makes its own with its first style

    def lines(self, width: int) -> Sequence[Line]:
        raise NotImplementedError

    def on_click(self, event: events.Click) -> None:
        """Takes the target under the mouse, if there is one."""
        if (offset := event.get_content_offset(self)) is None:
            return
        right = 0
        for span in chain(*self._drawn[offset.y : offset.y + 1]):
            left, right = right, right + _width(span.text)
            if left <= offset.x < right and isinstance(span, Target):
                self.take_click(span.click, event)

    def take_click(self, target: str, _event: events.Click) -> None:
        """A target was clicked: by default it is the key of that name."""
        self.app.simulate_key(target)

    @property
    def room(self) -> Size:
        """Columns and rows at the last layout, also while the widget is out of view.

        Textual's `content_size` looks into a map of the screen, which is made anew for a widget
        that is not on it.
        """
        gutter = self.styles.gutter
        width, height = self.outer_size
        return Size(max(0, width - gutter.width), max(0, height - gutter.height))

    def redraw(self) -> None:
        width, height = self.room
        if not width:
            return
        old, new = self._drawn, tuple(self.lines(width))
        self._for = width
        if new == old:
            return
        self._drawn = new
        auto = self.styles.height is not None and self.styles.height.is_auto
        if auto and len(new) not in (len(old), height):
            self.refresh(layout=True)
            return
        blank: Line = ()
        for y in range(min(max(len(old), len(new)), height)):
            before = old[y] if y < len(old) else blank
            after = new[y] if y < len(new) else blank
            if before != after:
                self.refresh(changed_cells(before, after, y, width))

    def on_resize(self, _event: events.Resize) -> None:
        self.redraw()

    def watch_has_focus(self, _has_focus: bool) -> None:
        """The focus is a tone, no style."""
        self.redraw()

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        return len(self.lines(width))

    def render_lines(self, crop: Region) -> list[Strip]:
        """The rows in view; what was never laid out in this width is drawn only now."""
        room = self.room
        if self._for != room.width:
            self._for, self._drawn = room.width, tuple(self.lines(room.width))
        if room != self.outer_size:
            return super().render_lines(crop)
        filters, (_, background) = self.get_line_filters(), self._based
        strips = []
        for y in crop.line_range:  # nothing around them: what Textual would add is half the time
            strip = self.render_line(y)
            for line_filter in filters:
                strip = strip.apply_filter(line_filter, background)
            strips.append(strip.crop(crop.x, crop.right))
        return strips

    def render_line(self, y: int) -> Strip:
        (base, _), width = self._based, self._for
        if y >= len(self._drawn):
            return Strip.blank(width, base)
        strip = Strip(
            Segment(terminal_safe(span.text), self._toned(span.tone, base))
            for span in self._drawn[y]
        )
        if strip.cell_length > width:
            strip = Strip([*strip.crop(0, width - 1), Segment("…", base)])
        return strip.adjust_cell_length(width, base)

    @property
    def _based(self) -> tuple[Style, Color]:
        """Style and background of what has no tone."""
        if self._base is None:
            self._base = self.rich_style, self.background_colors[1]
        return self._base

    def notify_style_update(self) -> None:
        super().notify_style_update()
        self._base = None
        self._tones = {}

    def _toned(self, tone: Tone, base: Style) -> Style:
        style = self._tones.get(tone)
        if style is None:
            style = self._tones[tone] = base + self._style(tone, self._based[1])
        return style

    def _style(self, tone: Tone, background: Color) -> Style:
        """How a tone looks here.

        The tones are component classes of the screen, styled once: a set of them in each widget
        would take a third of the start.
        """
        if not self.is_attached:  # removed, and still on the screen until the next layout
            return Style()
        styles = self.screen.get_component_styles(f"tone--{tone}")
        color = styles.color
        if styles.auto_color:
            color = background.get_contrast_text(color.a)
        return styles.text_style + Style.from_color((background + color).rich_color)


class View(Lines):
    """Lines that show a snapshot."""

    _snapshot: Snapshot | None = None

    def show(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot
        self.redraw()

    def forget(self) -> None:
        """Shows nothing until the next snapshot: what is out of view grows old."""
        if self._snapshot is not None:
            self._snapshot, self._drawn, self._for = None, (), 0
            self.refresh()

    def lines(self, width: int) -> Sequence[Line]:
        return () if self._snapshot is None else self.draw_lines(self._snapshot, width)

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        raise NotImplementedError


def changed_cells(before: Line, after: Line, y: int, width: int) -> Region:
    """The cells between the first and the last that differ; the whole row if any may be wide."""
    same = 0
    while before[same : same + 1] == after[same : same + 1] != ():
        same += 1
    old, new = _characters(before[same:]), _characters(after[same:])
    first = width_of(before[:same])
    end = first + max(len(old), len(new))
    if end > width or not all(_is_narrow(char) for char, _ in (*old, *new)):
        return Region(0, y, width, 1)
    if len(old) == len(new):
        while old and old[-1] == new[-1]:
            old.pop()
            new.pop()
            end -= 1
    pairs = zip(old, new, strict=False)
    first += next((i for i, (a, b) in enumerate(pairs) if a != b), min(len(old), len(new)))
    return Region(first, y, max(1, end - first), 1)


def _characters(spans: Line) -> list[tuple[str, Tone]]:
    return [(char, span.tone) for span in spans for char in terminal_safe(span.text)]


def _is_narrow(char: str) -> bool:
    return char.isascii() or cell_len(char) == 1
