"""The pre-start checks that want the referee's eye."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message

from madrob_console.common.formatting import time_of_day
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.acts import Waive
from madrob_console.referee.checks import Check, CheckState, causes
from madrob_console.referee.records import CheckName
from madrob_console.ui.cells.lines import (
    Line,
    Span,
    Target,
    Tone,
    View,
    line,
    paragraph,
    width_of,
    with_keys,
)
from madrob_console.ui.keys.key_table import with_caps
from madrob_console.ui.look.words import shortened

_MARKS = {
    CheckState.WARNING: ("!", Tone.DIM),
    CheckState.FAILED: ("x", Tone.BAD),
    CheckState.NO_DATA: ("?", Tone.BAD),
    CheckState.WAIVED: ("~", Tone.WARN),
}


class CheckList(View, can_focus=True):
    """What does not pass, a row each, first what is in the way of a start; how many pass.

    With the focus, up and down mark a check, which shows all its words; Enter waives it.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("enter", "choose", show=False),
    ]

    @dataclass
    class Chosen(Message):
        """The referee wants to waive a check."""

        check: CheckName

    _marked: CheckName | None = None

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        title, open_checks, checks = (
            Span("Checks  ", Tone.STRONG),
            self._open_checks,
            snapshot.checks,
        )
        if snapshot.playback is not None:
            return [line(title, "made on the day; F4 shows the waivers")]
        if snapshot.pulse.stale:
            return [line(title, Span(f"old: of {time_of_day(snapshot.time)}", Tone.WARN))]
        verdict, how = Span("all passed or waived", Tone.GOOD), ""
        if blocking := sum(check.blocks for check in checks):
            verdict = Span(f"{blocking} of {len(checks)} checks fail", Tone.BAD)
            how = "" if snapshot.refusal(Waive.name) else "   Tab, then Enter on one waives it"
        rows = [line(title, verdict, Span(how, Tone.DIM))]
        for check in open_checks:
            rows += _rows(check, width, marked=self.has_focus and check is self._at(0))
        passed = sum(check.state is CheckState.OK for check in checks)
        silent = len(checks) - len(open_checks) - passed
        without = f", {silent} without data for that reason" if silent else ""
        rows.append(line(Span("  ✓ ", Tone.GOOD), f"{passed} ok{without}"))
        sides, teams = snapshot.sides_problem, snapshot.teams.problems
        notes = [] if snapshot.right.only_watches else [sides and f"sides: {sides}", *teams[:1]]
        for note in filter(None, notes):
            rows += paragraph(note, width, head=line(Span("  ! ", Tone.WARN)))
        return rows

    def action_move(self, step: int) -> None:
        """Marks the next or previous check; above the first the focus goes back."""
        moved = self._at(step)
        if step < 0 and moved is self._at(0):
            self.screen.focus_previous()
        self._marked = None if moved is None else moved.name
        self.redraw()

    def action_choose(self) -> None:
        if (check := self._at(0)) is not None:
            self.post_message(self.Chosen(check.name))

    def take_click(self, target: str, event: events.Click) -> None:
        """Marks the check under the mouse; a double click waives it. A key is pressed."""
        if target not in [*CheckName]:
            super().take_click(target, event)
            return
        self._marked = CheckName(target)
        self.redraw()
        if event.chain == 2:
            self.action_choose()

    @property
    def _open_checks(self) -> list[Check]:
        checks = () if self._snapshot is None else self._snapshot.checks
        others = (
            check for check in checks if check.state is not CheckState.OK and not check.blocks
        )
        return [*causes(checks), *others]

    def _at(self, step: int) -> Check | None:
        """The check so many rows below the marked one, or the nearest to that."""
        open_checks = self._open_checks
        marked = next((i for i, check in enumerate(open_checks) if check.name is self._marked), 0)
        return (
            open_checks[min(max(0, marked + step), len(open_checks) - 1)] if open_checks else None
        )


def _rows(check: Check, width: int, *, marked: bool) -> list[Line]:
    sign, tone = _MARKS[check.state]
    head = line(Span("> " if marked else "  ", Tone.STRONG), Span(f"{sign} ", tone))
    reason = with_caps(check.reason)
    text = reason if check.blocks else f"{check.name}: {reason}"
    plain = tone if tone is Tone.DIM else Tone.PLAIN
    row = (*head, Span(shortened(text, width - width_of(head)), plain))
    rows = paragraph(text, width, Tone.CURSOR, head) if marked else [row]
    return [
        tuple(span if isinstance(span, Target) else Target(*span, check.name) for span in row)
        for row in with_keys(rows)
    ]
