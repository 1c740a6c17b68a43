"""The footer: every key, bright where it is possible now, dim where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS, Key

if TYPE_CHECKING:
    pass

_ROOMY = 100
_ALWAYS_NAMED = ("start", "abort", "timeout", "leave")
"""Keys that keep their names where there is no room for all."""
_PLAYBACK_NAMES = tuple(key.name for key in PLAYBACK_KEYS)


class KeyLine(View):
    """Two rows; a key with a refusal is dim and not reversed.

    Attributes:
        pane: the one that is shown.
        typing: whether a text field takes the letters.
    """

    pane = "setup"
    typing = False

    def lines(self, width: int) -> Sequence[Line]:
        """Function keys and letters; all dim before there is an engine."""
        return [self._named(FUNCTION_KEYS, width, _ALWAYS_NAMED), self._letters(width)]

    def _letters(self, width: int) -> Line:
        if self.typing:
            return line(
                Span("letters type: ", Tone.STRONG),
                Span("Enter, Tab, arrows move on; F keys and ", Tone.DIM),
                Span("^P", Tone.CAP),
                Span(" work"),
            )
        keys: tuple[Key, ...] = LETTER_KEYS
        snapshot = self._snapshot
        if snapshot is not None and snapshot.playback is not None:
            played = (key for key in PLAYBACK_KEYS if self.pane in key.where)
            keys = (*played, *(key for key in LETTER_KEYS if not key.act))
        row = self._row(keys, width)
        if width_of(row) <= width:
            return row
        here = [key for key in keys if not key.where or self.pane in key.where]
        return self._named(here, width, _PLAYBACK_NAMES)

    def _named(self, keys: Sequence[Key], width: int, most: Sequence[str]) -> Line:
        """The keys with their names; only those in `most` where there is no room for all."""
        row = self._row(keys, width)
        return row if width_of(row) <= width else self._row(keys, width, most)

    def _row(self, keys: Sequence[Key], width: int, named: Sequence[str] | None = None) -> Line:
        """The keys; only those in `named` with their names, None = all."""
        roomy = width >= _ROOMY
        spans: list[Span] = []
        for key in keys:
            if spans:
                spans.append(Span("  " if roomy else " "))
            label = key.label if named is None or key.name in named else ""
            space = " " if roomy and not label.startswith(" ") else ""
            if self._snapshot is None or key.refusal(self._snapshot) is not None:
                spans.append(Span(f"{key.cap}{space}{label}", Tone.DIM))
                continue
            tone = Tone.STRONG if key.pane and key.pane == self.pane else Tone.PLAIN
            spans += [Span(key.cap, Tone.CAP), Span(f"{space}{label}", tone)]
        return tuple(spans)
