"""The footer: the keys that are possible now, the most important first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from textual.keys import key_to_character

from madrob_console.ui.cells.lines import Line, Span, Target, Tone, View, line, width_of
from madrob_console.ui.keys.key_table import (
    FINDS_BY_ITSELF,
    FUNCTION_KEYS,
    KEYS,
    PLAYBACK_KEYS,
    Key,
)

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot


MOST_KEYS = 7

_FOOTER = (
    *("start", "abort", "timeout", "restart", "accept", "pose", "zero", "menu", "next", "rule"),
    *("incident", "take_back", "history", "plan", "standings", "setup", "live", "results"),
    "leave",
)
_ENTER = {"setup": "Set up", "plan": "Set up", "standings": "Runs"} | dict.fromkeys(
    ("figures", "help"), ""
)
"""What Enter does where it opens no menu."""


class KeyLine(View):
    """One row: at most seven keys that are possible now, then F1. A click on one presses it."""

    pane = "setup"
    typing = False
    asks = False
    """Whether a question is open: few keys work then."""

    def lines(self, width: int) -> Sequence[Line]:
        if self._snapshot is not None and self._snapshot.pulse.gone:
            return [_without_engine(self._snapshot)]
        keys = self._possible(self._snapshot)[:MOST_KEYS]
        state = "typing; Esc: keys" if self.typing else "a question is open" if self.asks else ""
        head = line(Span(state, Tone.STRONG), "  ") if state else ()
        tail = () if self.asks else (KEYS["help"],)
        while width_of(row := (*head, *self._row((*keys, *tail)))) > width and keys:
            keys.pop()
        return [row]

    def _possible(self, snapshot: Snapshot | None) -> list[Key]:
        if snapshot is None:
            return [KEYS["leave"]]
        keys = [KEYS[name] for name in _FOOTER]
        if snapshot.playback is not None:
            keys = [*PLAYBACK_KEYS, *(key for key in keys if not key.act)]
        return [key for key in keys if self._is_possible(key, snapshot)]

    def _is_possible(self, key: Key, snapshot: Snapshot) -> bool:
        if (key.where and self.pane not in key.where) or (self.asks and not key.over):
            return False
        if self.typing and key not in FUNCTION_KEYS and key is not KEYS["menu"]:
            return False
        run = snapshot.run
        match key.name:
            case "menu":
                able = not snapshot.right.only_watches or self.pane not in ("live", "setup")
                return able and self._label(key) != ""
            case "next" if self.pane == "setup":
                return False  # Enter does it
            case "restart" if run.held is None:
                return False
            case "setup" if run.active:
                return False
            case "live" if run.setup is None:
                return False
            case "results" if snapshot.result is None:
                return False
        if key.act and snapshot.right.only_watches:
            return False
        return key.pane != self.pane and key.refusal(snapshot) is None

    def _label(self, key: Key) -> str:
        return _ENTER.get(self.pane, key.label) if key is KEYS["menu"] else key.label

    def _row(self, keys: Iterable[Key]) -> Line:
        spans: list[Span] = []
        for key in keys:
            spans += [Span("  ")] if spans else []
            first = key.keys.partition(",")[0]
            caps = {key_to_character(name): name for name in key.keys.split(",")}
            each = [caps.get(char, "") for char in key.cap]  # of `1-6` and the like, a key each
            several = sum(map(bool, each)) > 1
            targets = zip(key.cap, each, strict=True) if several else [(key.cap, first)]
            spans += [Target(cap, Tone.CAP, name or first) for cap, name in targets]
            spans.append(Target(f" {self._label(key)}", Tone.PLAIN, first))
        return tuple(spans)


def _without_engine(snapshot: Snapshot) -> Line:
    if snapshot.right.only_watches:
        return line(Span(FINDS_BY_ITSELF, Tone.STRONG))
    again = KEYS["engine"]
    cap = Target(again.cap, Tone.CAP, again.keys)
    return line(cap, Target(f" {again.help}", Tone.STRONG, again.keys))
