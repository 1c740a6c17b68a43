"""The help pane: keys and symbols."""

from __future__ import annotations

from collections.abc import Sequence

from textual.containers import VerticalScroll

from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, Unmarked, line, paragraph
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, MENU, PLAYBACK_KEYS
from madrob_console.ui.panes.top_view import LEGEND

_FIRST = """\
A run: Enter sets up, F7 zeroes the handle, F6 confirms the pose, F5 starts.
F8 y aborts, F9 declares a timeout: it asks why, then for y; the clock runs.
1-6, then c or d, rules on a step. i marks an incident. z takes it back.
Enter on a result or a run: the menu to sign, correct, void or protest.
x sets up the next run. h lists all runs, p the plan, s the standings.
In lists: v the other view, o sorts, / filters (team:delft cond:5).
!! the referee has to decide, ! changes the score, ? is a doubted value.
A key that is not possible now says why, on the line above the keys.
Escape closes a question or goes back, and never does more.
Practice never counts: `Run is` at the set-up, or a simulated testbed."""
"""The most important lines: one row of 76 cells each, beside the scrollbar at 80 columns."""

_MORE = """\
Set-up: Tab and arrows go through the fields, left and right change a choice. / looks for a team \
in the list; another name than the list's needs a reason. "+ More" opens what seldom changes.
Failing checks stand on top, each with the key that helps. Enter on one waives it, with a reason.
Live: the steps as the sensors, the referee and the rules have them. ~ marks a time that may still \
change.
Figures: left and right move in time, + and - zoom, 0 shows all, Space goes to the next figure.
Top line: REC is the recording with its size and what it dropped, saved once it is closed; age is \
that of the newest message of the most silent topic; then free space of the disk and the time.
Letters are text in a text field; function keys and Ctrl+P work everywhere. Keys pressed within \
0.3 s of a change are ignored, except F8 and Escape.
The mouse clicks on keys, answers, rows and heads of columns. Shift and drag selects text. Copying \
uses OSC 52: tmux needs `set -g set-clipboard on`."""

_KEY_WIDTH = 25


class HelpText(Lines):
    """All keys, those of a replay if `of_replay`, and the main lines; then all the rest."""

    of_replay = False

    def lines(self, width: int) -> Sequence[Line]:
        keys = (PLAYBACK_KEYS if self.of_replay else ()) + FUNCTION_KEYS + LETTER_KEYS
        cells = [
            span
            for key in keys
            for span in (Span(f"{key.cap:>5} ", Tone.CAP), Span(f" {key.label:<{_KEY_WIDTH - 7}}"))
        ]
        across = 2 * max(1, width // _KEY_WIDTH)
        rows = [line(*cells[at : at + across]) for at in range(0, len(cells), across)]
        for text in _FIRST.splitlines():
            rows += paragraph(text, width)
        rows.append(line())
        for key in keys + MENU:
            cap = Span(f"{key.cap if key.keys else f'Enter {key.cap}':>7}", Tone.CAP)
            rows.append(line(cap, f"  {key.label:<13}", Span(key.help, Tone.DIM)))
        for text in _MORE.splitlines():
            rows += [line(), *paragraph(text, width)]
        rows += [line(), line(Span("Passage sensors", Tone.STRONG))]
        rows += [line(Span(f"{mark:>4}  ", Tone.STRONG), meaning) for mark, meaning in LEGEND]
        rows.append(
            line("The hinge is on the left: sensor 4 is next to it, sensor 0 farthest away.")
        )
        return rows


class HelpPane(VerticalScroll, Unmarked):
    """Arrows scroll."""

    def __init__(self) -> None:
        self._text = HelpText()
        super().__init__(self._text, id="help")

    def enter(self) -> None:
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        self._text.of_replay = snapshot.playback is not None
        self._text.redraw()
