"""The pre-start checks with their reasons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.referee.preflight import Check, CheckState
from madrob_console.referee.run import CheckName
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line
from madrob_console.ui.look.words import fitted, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_MARKS = {
    CheckState.OK: ("✓", Tone.GOOD),
    CheckState.FAILED: ("x", Tone.BAD),
    CheckState.NO_DATA: ("?", Tone.BAD),
    CheckState.WAIVED: ("~", Tone.WARN),
}
_INDENT = 27


class CheckList(View, can_focus=True):
    """One check a line; with the focus, up and down choose one and Enter waives it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("enter", "choose", show=False),
    ]

    class Chosen(Message):
        """The referee wants to waive a check."""

        def __init__(self, check: CheckName) -> None:
            super().__init__()
            self.check = check

    class Left(Message):
        """Up on the first check."""

    _cursor = 0

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """A header, the checks, and the testbed's sides where they need a hand."""
        if snapshot.playback is not None:
            return [line(Span("Checks  ", Tone.STRONG), "made on the day; F4 shows the waivers")]
        lines = [_header(snapshot.checks, focused=self.has_focus)]
        for number, check in enumerate(snapshot.checks):
            at_cursor = self.has_focus and number == self._cursor
            mark, tone = _MARKS[check.state]
            lines += _entry(mark, tone, check, width, at_cursor=at_cursor)
        if snapshot.sides_problem is not None:
            texts = wrapped(snapshot.sides_problem, max(10, width - _INDENT))
            lines.append(line(Span(f"  ! {'sides':<16}{'note':<6} ", Tone.WARN), texts[0]))
            lines += [line(" " * _INDENT, text) for text in texts[1:]]
        return lines

    def action_move(self, step: int) -> None:
        """Choose the next or previous check; above the first the focus goes back."""
        checks = () if self._snapshot is None else self._snapshot.checks
        if self._cursor + step < 0:
            self.post_message(self.Left())
            return
        self._cursor = min(max(0, len(checks) - 1), self._cursor + step)
        self.redraw()

    def action_choose(self) -> None:
        """Ask to waive the chosen check."""
        checks = () if self._snapshot is None else self._snapshot.checks
        if self._cursor < len(checks):
            self.post_message(self.Chosen(checks[self._cursor].name))

    def on_focus(self) -> None:
        """Start at the first check that blocks."""
        checks = () if self._snapshot is None else self._snapshot.checks
        self._cursor = next((i for i, check in enumerate(checks) if check.blocks), 0)
        self.redraw()


def _header(checks: Sequence[Check], *, focused: bool) -> Line:
    blocking = sum(check.blocks for check in checks)
    verdict = (
        Span(f"{blocking} of {len(checks)} in the way of a start", Tone.BAD)
        if blocking
        else Span("all passed or waived", Tone.GOOD)
    )
    how = "Enter waives the marked one" if focused else "w waives one (Escape leaves a field)"
    return line(
        Span("Checks  ", Tone.STRONG), verdict, Span(f"   {how}" if blocking else "", Tone.DIM)
    )


def _entry(mark: str, tone: Tone, check: Check, width: int, *, at_cursor: bool) -> list[Line]:
    ok = check.state is CheckState.OK
    room = max(10, width - _INDENT)
    texts = [fitted(check.reason, room)] if ok else wrapped(check.reason, room)
    first = line(
        Span("> " if at_cursor else "  ", Tone.STRONG),
        Span(f"{mark} ", tone),
        Span(f"{check.name:<15} ", Tone.CURSOR if at_cursor else Tone.PLAIN),
        Span(f"{check.state:<6}", tone),
        Span(f" {texts[0]}", Tone.DIM if ok else Tone.PLAIN),
    )
    return [first, *(line(" " * _INDENT, text) for text in texts[1:])]
