"""The pre-start checks with their reasons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import Check, CheckState
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import Line, Span, Target, Tone, View, line, paragraph, width_of
from madrob_console.ui.look.words import fitted, shortened, time_of_day

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_MARKS = {
    CheckState.OK: ("✓", Tone.GOOD),
    CheckState.WARNING: ("!", Tone.WARN),
    CheckState.FAILED: ("x", Tone.BAD),
    CheckState.NO_DATA: ("?", Tone.BAD),
    CheckState.WAIVED: ("~", Tone.WARN),
}
_WAIVES = "w waives one (Escape leaves a field)"


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
        if snapshot.pulse.stale:
            head = line(Span("Checks  ", Tone.STRONG))
            lines = [line(*head, Span(f"old: of {time_of_day(snapshot.time)}", Tone.WARN))]
            return [*lines, *(_faded(check, width) for check in snapshot.checks)]
        over = snapshot.run.phase in (Phase.STOPPED, Phase.FINAL)
        watches = snapshot.right.only_watches
        how = "Enter waives the marked one" if self.has_focus else _WAIVES
        lines = [_header(snapshot.checks, "" if watches else how, over=over)]
        for number, check in enumerate(snapshot.checks):
            at_cursor = self.has_focus and number == self._cursor
            lines += _entry(check, width, str(number), at_cursor=at_cursor)
        if snapshot.sides_problem is not None:
            head = line(Span("  ! sides  ", Tone.WARN))  # no check: its words need the room
            lines += paragraph(snapshot.sides_problem, width, head=head)
        if snapshot.teams.problems and not watches:
            first, *more = snapshot.teams.problems
            rest = f" (and {len(more)} more: / shows them)" if more else ""
            head = line(Span("  ! teams  ", Tone.WARN))
            lines += paragraph(first + rest, width, head=head)
        return lines

    def action_move(self, step: int) -> None:
        """Choose the next or previous check; above the first the focus goes back."""
        checks = () if self._snapshot is None else self._snapshot.checks
        if self._cursor + step < 0:
            self.post_message(self.Left())
            return
        self._cursor = min(max(0, len(checks) - 1), self._cursor + step)
        self.redraw()

    def on_click(self, event: events.Click) -> None:
        """Mark the check under the mouse; a double click waives it."""
        if (hit := self.clicked(event)) is not None:
            self._cursor = int(hit[0])
            self.redraw()
            if event.chain == 2:
                self.action_choose()

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


def _header(checks: Sequence[Check], how: str, *, over: bool) -> Line:
    """What stands in the way, and how it is waived; of a run that is `over` nothing can be."""
    blocking = sum(check.blocks for check in checks)
    verdict = (
        Span(f"{blocking} of {len(checks)} in the way of a start", Tone.BAD)
        if blocking
        else Span("all passed or waived", Tone.GOOD)
    )
    if over:
        return line(Span("Checks for the next run  ", Tone.STRONG), verdict)
    return line(
        Span("Checks  ", Tone.STRONG), verdict, Span(f"   {how}" if blocking else "", Tone.DIM)
    )


def _faded(check: Check, width: int) -> Line:
    """One that nobody knows of any more."""
    return line(Span(shortened(f"  ? {check.name:<15} was {check.state}", width), Tone.DIM))


def _entry(check: Check, width: int, click: str, *, at_cursor: bool) -> list[Line]:
    mark, tone = _MARKS[check.state]
    head = line(
        Target("> " if at_cursor else "  ", Tone.STRONG, click),
        Target(f"{mark} ", tone, click),
        Target(f"{check.name:<15} ", Tone.CURSOR if at_cursor else Tone.PLAIN, click),
        Target(f"{check.state:<6} ", tone, click),
    )
    if check.state is CheckState.OK:
        return [(*head, Span(fitted(check.reason, max(10, width - width_of(head))), Tone.DIM))]
    return paragraph(check.reason, width, head=head)
