"""The footer: every key, bright where it is possible now, dim where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.ui.keys import FUNCTION_KEYS, LETTER_KEYS, Key
from madrob_console.ui.widgets.lines import Line, Span, Tone, View

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

_ROOMY = 100


class KeyLine(View):
    """Two rows of keys that never move; a key with a refusal is dim and not reversed."""

    pane = ""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Function keys and letters."""
        gap = "  " if width >= _ROOMY else " "
        return [
            self._row(FUNCTION_KEYS, snapshot, gap, " " if width >= _ROOMY else ""),
            self._row(LETTER_KEYS, snapshot, gap, ""),
        ]

    def _row(self, keys: Sequence[Key], snapshot: Snapshot, gap: str, space: str) -> Line:
        spans: list[Span] = []
        for key in keys:
            if spans:
                spans.append(Span(gap))
            if key.refusal(snapshot) is not None:
                spans.append(Span(f"{key.cap}{space}{key.label}", Tone.DIM))
                continue
            tone = Tone.STRONG if key.pane and key.pane == self.pane else Tone.PLAIN
            spans += [Span(key.cap, Tone.CAP), Span(f"{space}{key.label}", tone)]
        return tuple(spans)
