"""The help pane: keys and symbols."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, cast

from textual import events
from textual.containers import VerticalScroll

from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.lines import (
    Line,
    Lines,
    Span,
    Target,
    Tone,
    Unmarked,
    line,
    paragraph,
    plain,
)
from madrob_console.ui.keys.key_table import (
    A_RUN,
    FUNCTION_KEYS,
    KEYS,
    LETTER_KEYS,
    MENU,
    PLAYBACK_KEYS,
)
from madrob_console.ui.panes.list_pane import Filtered
from madrob_console.ui.panes.top_view import LEGEND

if TYPE_CHECKING:
    from madrob_console.ui.keys.console_app import ConsoleApp

_FIRST = f"""\
A run: {A_RUN}
F8 y aborts, F9 declares a timeout: it asks why, then for y; the clock runs.
1-6, then c or d, rules on a step. i marks an incident. z takes it back.
Enter on a result or a run: the menu to sign, correct, void or protest.
x sets up the next run. h lists all runs, p the plan, s the standings.
In lists: < > o sort, / filters (team:delft cond:5); v: other standings.
!! the referee has to decide, ! changes the score, ? is a doubted value.
A key that is not possible now says why, on the line above the keys.
Escape closes a question or goes back, and never does more.
Practice never counts: by `Run is`, or simulated outside a rehearsal."""
"""The most important lines: one row of 76 cells each, beside the scrollbar at 80 columns."""

_MORE = """\
Set-up: Tab and arrows go through the fields, left and right change a choice. / looks for a team \
in the list; another name than the list's needs a reason. "+ More" opens what seldom changes.
Failing checks stand on top, each with the key that helps. Enter on one waives it, with a reason.
Live: the steps as the sensors, the referee and the rules have them. ~ marks a time that may still \
change.
Top line: REC is the recording with its size and what it dropped, saved once it is closed; \
then free space of the disk and the time.
Letters are text in a text field; function keys and Ctrl+P work everywhere. Keys pressed within \
0.3 s of a change are ignored, except F8 and Escape.
The mouse clicks on keys, answers, steps, rows and heads of columns. Shift and drag selects text. \
Copying uses OSC 52: tmux needs `set -g set-clipboard on`."""


class HelpText(Lines):
    """The main lines, the keys of the pane that it was opened from, then all the rest.

    Keys that are possible now come first, the others say why they are not.
    """

    filter = ""
    pane = "setup"
    snapshot: Snapshot | None = None

    def lines(self, width: int) -> Sequence[Line]:
        words = self.filter.casefold().split()
        groups = (
            rows
            for rows in self._entries(width)
            if all(word in plain(rows).casefold() for word in words)
        )
        return [row for rows in groups for row in rows]

    def _entries(self, width: int) -> Iterator[list[Line]]:
        for text in _FIRST.splitlines():
            yield paragraph(text, width)
        yield [line()]
        now = self.snapshot
        replays = now is not None and now.playback is not None
        keys = (*(PLAYBACK_KEYS if replays else ()), *FUNCTION_KEYS, *LETTER_KEYS, *MENU)
        here = [key for key in keys if not key.where or self.pane in key.where]
        refused = {key.name: now and key.refusal(now) for key in here}
        for key in sorted(here, key=lambda key: refused[key.name] is not None):
            why = refused[key.name]
            cap = Target(f"{key.cap if key.keys else f'Enter {key.cap}':>7}", Tone.CAP, key.name)
            words = key.help if why is None else f"not now: {why}"
            yield paragraph(words, width, Tone.DIM, line(cap, f"  {key.label:<14}"))
        for text in _MORE.splitlines():
            yield [line(), *paragraph(text, width)]
        yield [line(), line(Span("Passage sensors", Tone.STRONG))]
        for mark, meaning in LEGEND:
            yield [line(Span(f"{mark:>4}  ", Tone.STRONG), meaning)]
        yield [line("The hinge is on the left: sensor 4 is next to it, sensor 0 farthest away.")]

    def take_click(self, target: str, _event: events.Click) -> None:
        """Presses a key, also one that only the menu has."""
        key = KEYS[target]
        press = cast("ConsoleApp", self.app).action_press
        self.app.call_later(press, key.name, key.keys.partition(",")[0])


class HelpScroll(VerticalScroll, Unmarked):
    """Arrows scroll."""


class HelpPane(Filtered):
    """The keys of the pane before it; `/` looks for some of it."""

    def __init__(self) -> None:
        self._text = HelpText()
        super().__init__(HelpScroll(self._text), id="help")

    def enter(self) -> None:
        self.screen.set_focus(self._listed)

    def narrow(self, text: str) -> None:
        self._text.filter = text
        self._text.redraw()

    def show(self, snapshot: Snapshot) -> None:
        self._text.snapshot = snapshot
        self._text.redraw()

    def take_pane(self, name: str) -> None:
        """From which pane it is opened."""
        self._text.pane = name
