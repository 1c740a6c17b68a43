"""The footer: every key, bright where it is possible now, dim where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from textual import events
from textual.keys import _character_to_key

from madrob_console.ui.cells.lines import Line, Span, Target, Tone, View, line, width_of
from madrob_console.ui.keys.key_table import (
    FINDS_BY_ITSELF,
    FUNCTION_KEYS,
    KEYS,
    LETTER_KEYS,
    PLAYBACK_KEYS,
    Key,
)

if TYPE_CHECKING:
    from madrob_console.ui.keys.console_app import ConsoleApp

_ROOMY = 100
_ALWAYS_NAMED = ("start", "abort", "timeout", "leave")
"""Keys that keep their names where there is no room for all."""
_PLAYBACK_NAMES = tuple(key.name for key in PLAYBACK_KEYS)


class KeyLine(View):
    """Two rows; a key with a refusal is dim and not reversed. A spectator sees none of an act.

    Attributes:
        pane: the one that is shown.
        typing: whether a text field takes the letters.
    """

    pane = "setup"
    typing = False

    def on_click(self, event: events.Click) -> None:
        """The mouse presses a key; of several under one name the one under the mouse."""
        if (hit := self.clicked(event)) is None:
            return
        key = KEYS[hit[0]]
        pressed = key.keys.split(",")
        under = _character_to_key(hit[1])
        which = len(pressed) > 1 and all(len(name) == 1 for name in pressed)  # as of the steps
        if under in pressed or not which:
            name = under if under in pressed else pressed[0]
            self.app.call_later(cast("ConsoleApp", self.app).action_press, key.name, name)

    def lines(self, width: int) -> Sequence[Line]:
        """Function keys and letters; all dim before there is an engine."""
        return [self._named(FUNCTION_KEYS, width, _ALWAYS_NAMED), self._letters(width)]

    def _letters(self, width: int) -> Line:
        if self.typing and not (self._snapshot is not None and self._snapshot.pulse.gone):
            return line(
                Span("letters type: ", Tone.STRONG),
                Span("Enter, Tab, arrows move on; F keys and ", Tone.DIM),
                Target("^P", Tone.CAP, KEYS["menu"].name),
                Span(" work"),
            )
        keys: tuple[Key, ...] = LETTER_KEYS
        snapshot = self._snapshot
        if snapshot is not None and snapshot.pulse.gone:
            if snapshot.right.only_watches:
                return line(Span(FINDS_BY_ITSELF, Tone.STRONG))
            again = KEYS["engine"]
            cap = Target(again.cap, Tone.CAP, again.name)
            return line(cap, Target(f" {again.help}", Tone.STRONG, again.name))
        if snapshot is not None and snapshot.playback is not None:
            played = (key for key in PLAYBACK_KEYS if self.pane in key.where)
            keys = (*played, *(key for key in LETTER_KEYS if not key.act))
        row = self._row(keys, width)
        if width_of(row) <= width:
            return row
        here = [key for key in keys if not key.where or self.pane in key.where]
        return self._named(here, width, _PLAYBACK_NAMES)

    def _named(self, keys: Sequence[Key], width: int, most: Sequence[str]) -> Line:
        """The keys with their names; without room the last lose theirs, but for those in `most`."""
        named = [key.name for key in keys]
        losing = [name for name in named if name not in most]
        row = self._row(keys, width)
        while width_of(row) > width and losing:
            named.remove(losing.pop())
            row = self._row(keys, width, named)
        return row

    def _row(self, keys: Sequence[Key], width: int, named: Sequence[str] | None = None) -> Line:
        """The keys; only those in `named` with their names, None = all."""
        roomy = width >= _ROOMY
        spans: list[Span] = []
        watches = self._snapshot is not None and self._snapshot.right.only_watches
        for key in keys:
            if watches and key.act:
                continue  # nobody here can ever act
            if spans:
                spans.append(Span("  " if roomy else " "))
            label = key.label if named is None or key.name in named else ""
            space = " " if roomy and not label.startswith(" ") else ""
            if self._snapshot is None or key.refusal(self._snapshot) is not None:
                spans.append(Target(f"{key.cap}{space}{label}", Tone.DIM, key.name))
                continue
            tone = Tone.STRONG if key.pane and key.pane == self.pane else Tone.PLAIN
            spans.append(Target(key.cap, Tone.CAP, key.name))
            spans.append(Target(f"{space}{label}", tone, key.name))
        return tuple(spans)
