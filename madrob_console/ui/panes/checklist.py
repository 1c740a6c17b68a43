"""The pre-start checks with their reasons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.referee.preflight import Check, CheckState
from madrob_console.referee.run import CheckName
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph, width_of
from madrob_console.ui.look.words import fitted

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_MARKS = {
    CheckState.OK: ("✓", Tone.GOOD),
    CheckState.FAILED: ("x", Tone.BAD),
    CheckState.NO_DATA: ("?", Tone.BAD),
    CheckState.WAIVED: ("~", Tone.WARN),
}


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
            lines += _entry(check, width, at_cursor=at_cursor)
        if snapshot.sides_problem is not None:
            head = line(Span(f"  ! {'sides':<16}{'note':<6} ", Tone.WARN))
            lines += paragraph(snapshot.sides_problem, width, head=head)
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


def _entry(check: Check, width: int, *, at_cursor: bool) -> list[Line]:
    mark, tone = _MARKS[check.state]
    head = line(
        Span("> " if at_cursor else "  ", Tone.STRONG),
        Span(f"{mark} ", tone),
        Span(f"{check.name:<15} ", Tone.CURSOR if at_cursor else Tone.PLAIN),
        Span(f"{check.state:<6} ", tone),
    )
    if check.state is CheckState.OK:
        return [(*head, Span(fitted(check.reason, max(10, width - width_of(head))), Tone.DIM))]
    return paragraph(check.reason, width, head=head)
