"""The help pane: keys and symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import VerticalScroll

from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line, paragraph
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS
from madrob_console.ui.panes.live_pane import LEGEND

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

_TEXT = """\
Set-up (F2): Tab and arrows go through the fields, left and right change a choice, Enter sets up \
what you see; F6 and F5 do so, too. The line "+ More" opens what seldom changes. / shows the list \
of teams, to look for one; another name than the list's needs a reason. Tab goes to the checks, \
where Enter waives one. Then F6 when the robot stands at its start pose, and F5.
Live (F3): the steps as the sensors, the referee and the rules have them. An incident is two \
keys: i and its letter; after the stop it asks for its time. 1-6 confirm or deny a step, now or \
until the result is final.
Result (F4): the difference to the team's earlier runs stands beside each value. g shows the \
figures: left and right move in time, + and - zoom, 0 shows all, Tab the next figure. f finalises \
with the team's word, u re-issues a final result. P files a protest, which stays open until it is \
decided or withdrawn; R replays the run, paused at the instant that it is about.
History (h): Enter opens an earlier run with all its keys; x sets up the next run of the marked \
team and condition; e packs the team's runs into a zip, official or practice as the marked one, \
E all about the marked run; \
/ filters (team:delft cond:5), v chooses which, o sorts, O turns the order.
Plan (p): a row a team, a column a condition; 1/2 is one attempt done of two, 1!2 the same with \
one that is not valid, +1 one out of plan, L the best level, > what is next. Enter proposes the \
marked run, x sets it up, v changes what a cell says.
Standings (s): Enter shows the runs behind a row; c changes mean, median, std, smallest, largest; \
b all runs or the best, where the settings say how many; v official or practice.
The line on top: the testbed; rec, the recording with its messages, size and what was dropped; \
age, how old the newest message of the most silent topic is; the room on the disk; the time.
A dim key is not possible now: press it and the line above the keys says why.
F8 and F9 ask for a reason and then for y. The clock runs on. Escape closes a question or goes \
back to the pane before, and never does more. Keys typed within 0.3 s of a change that came by \
itself are left out, but for F8 and F10.
Letters type text while a text field has the focus; function keys and ^P (Ctrl+P) always work. \
^P finds every command by its name, and the themes.
Keys, answers, choices, rows and heads of columns can be clicked; a double click opens a row. \
Shift and drag selects as your terminal does. y copies to your own machine (OSC 52); through tmux \
at the other end of SSH that needs `set -g set-clipboard on`.
To practise: `Run is` PRACTICE at the set-up, or `madrob console --testbed simulated`. Such runs \
never count, and lie in a folder of their own."""


class HelpText(Lines):
    """All keys, those of a replay if `of_replay`, then how things hang together, the symbols."""

    of_replay = False

    def lines(self, width: int) -> Sequence[Line]:
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
        yield self._text

    def enter(self) -> None:
        self.screen.set_focus(self)

    def show(self, snapshot: Snapshot) -> None:
        self._text.of_replay = snapshot.playback is not None
        self._text.redraw()
