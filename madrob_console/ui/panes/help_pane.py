"""The help pane: keys and symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import VerticalScroll

from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line, paragraph
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS
from madrob_console.ui.panes.passage import LEGEND

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

_TEXT = """\
Set-up (F2): Tab, Enter and arrows go through the fields, left and right change a choice. What \
you see is set up as soon as you leave a field. Then F6 when the robot stands at its start pose, \
and F5.
Live (F3): the steps as the sensors, the referee and the rules have them. An incident is two \
keys: i and its letter. 1-6 confirm or deny a step, now or until the result is final.
Result (F4): the difference to the team's earlier runs stands beside each value. g shows the \
figures: left and right move in time, + and - zoom, 0 shows all, Tab the next figure. f finalises \
with the team's word, u opens a final result again.
History (h): Enter opens an earlier run with all its keys; x sets up the next run of the marked \
team and condition; e packs all runs of the team into a zip; / filters (team:delft cond:5), v \
chooses which, o sorts, O turns the order.
Standings (s): Enter shows the runs behind a row; c changes mean, median, std, smallest, largest; \
b all runs or the best, where the settings say how many; v official or simulated.
A dim key is not possible now: press it and the line above the keys says why.
F8 and F9 ask for a reason and then for y. The clock runs on. Escape closes a question or goes \
back to the pane before, and never does more.
Letters type text while a text field has the focus; function keys and ^P (Ctrl+P) always work. \
^P finds every command by its name, and the themes.
To practise: `madrob console --testbed simulated`. Its runs never count."""


class HelpText(Lines):
    """All keys, then how things hang together, then the symbols.

    Attributes:
        of_replay: whether to show the keys of a replay, too.
    """

    of_replay = False

    def lines(self, width: int) -> Sequence[Line]:
        """The page."""
        rows = [
            line(
                Span(f"{key.cap:>4}", Tone.CAP),
                f"  {key.label.strip():<10}",
                Span(key.help, Tone.DIM),
            )
            for key in (*(PLAYBACK_KEYS if self.of_replay else ()), *FUNCTION_KEYS, *LETTER_KEYS)
        ]
        for text in _TEXT.splitlines():
            rows += [line(), *paragraph(text, width)]
        rows += [line(), line(Span("Passage sensors", Tone.STRONG))]
        rows += [line(Span(f"{mark:>4}  ", Tone.STRONG), meaning) for mark, meaning in LEGEND]
        rows.append(
            line("The hinge is on the left: sensor 4 is next to it, sensor 0 farthest away.")
        )
        return rows


class HelpPane(VerticalScroll):
    """Arrows scroll."""

    def __init__(self) -> None:
        super().__init__(id="help")
        self._text = HelpText()

    def compose(self) -> ComposeResult:
        """One page."""
        yield self._text

    def enter(self) -> None:
        """Arrows scroll."""
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        """Only a replay changes the help."""
        self._text.of_replay = snapshot.playback is not None
        self._text.redraw()
