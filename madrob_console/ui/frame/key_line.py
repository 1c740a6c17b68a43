"""The footer: every key, bright where it is possible now, dim where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, width_of
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, LETTER_KEYS, PLAYBACK_KEYS, Key

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot

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
        return [self._functions(self._snapshot, width), self._letters(self._snapshot, width)]

    def _functions(self, snapshot: Snapshot | None, width: int) -> Line:
        row = self._row(FUNCTION_KEYS, snapshot, width)
        if width_of(row) <= width:
            return row
        return self._row(FUNCTION_KEYS, snapshot, width, _ALWAYS_NAMED)

    def _letters(self, snapshot: Snapshot | None, width: int) -> Line:
        if self.typing:
            return line(
                Span("letters type: ", Tone.STRONG),
                Span("Enter, Tab, arrows move on; F keys and ", Tone.DIM),
                Span("^P", Tone.CAP),
                Span(" work"),
            )
        keys: tuple[Key, ...] = LETTER_KEYS
        if snapshot is not None and snapshot.playback is not None:
            played = (key for key in PLAYBACK_KEYS if self.pane in key.where)
            keys = (*played, *(key for key in LETTER_KEYS if not key.act))
        row = self._row(keys, snapshot, width)
        if width_of(row) <= width:
            return row
        here = [key for key in keys if not key.where or self.pane in key.where]
        row = self._row(here, snapshot, width)
        return row if width_of(row) <= width else self._row(here, snapshot, width, _PLAYBACK_NAMES)

    def _row(
        self,
        keys: Sequence[Key],
        snapshot: Snapshot | None,
        width: int,
        named: Sequence[str] | None = None,
    ) -> Line:
        """The keys; only those in `named` with their names, None = all."""
        roomy = width >= _ROOMY
        spans: list[Span] = []
        for key in keys:
            if spans:
                spans.append(Span("  " if roomy else " "))
            label = key.label if named is None or key.name in named else ""
            space = " " if roomy and not label.startswith(" ") else ""
            if snapshot is None or key.refusal(snapshot) is not None:
                spans.append(Span(f"{key.cap}{space}{label}", Tone.DIM))
                continue
            tone = Tone.STRONG if key.pane and key.pane == self.pane else Tone.PLAIN
            spans += [Span(key.cap, Tone.CAP), Span(f"{space}{label}", tone)]
        return tuple(spans)
