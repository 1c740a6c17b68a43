"""What a terminal sends, made whole and bounded before Textual reads it.

A slow line tears escape sequences, a paste may hold any bytes, and a file that is sent as keys
must not keep the referee waiting.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping

LONGEST_PASTE = 10_000
"""Characters of a paste that count; no field takes more."""

MOST_KEYS = 200
"""Keys that may wait; when so many wait, only F8 and Escape are accepted."""

PAUSE = 0.02
"""Keys that come without such a pause are no typing, s."""

WHOLE_WITHIN = 2.0
"""The rest of a torn sequence still belongs to it, s."""

PASTE_WITHIN = 5.0
"""A paste whose end does not come is over, s."""

_ESCAPE = "\x1b[27u"
"""The Escape key as a whole sequence: what follows belongs to the next key."""

_PASTE, _PASTE_END = "\x1b[200~", "\x1b[201~"

_TOKEN = re.compile(
    r"\x1b\[\[[A-Z]|\x1b\[M[\s\S]{3}|\x1b\[[0-?]*[ -/]*[@-~]?|\x1bO[A-Za-z]?|[\s\S]"
)
_TORN = re.compile(r"\x1b(?:O|\[(?:\[|M[\s\S]{0,2}|[0-?]*[ -/]*))?\Z")
_KNOWN = re.compile(
    r"[^\x1b]|\x1bO[A-DFHMP-Sa-dj-y]|\x1b\[(?:<\d+;-?\d+;-?\d+[Mm]|[IO]|\[[A-E]|\?[\d;]+\$y"
    r"|48;[\d:;]+t|[\d:;]+u|\d+;\d+R|(?:1(?:;[\d:]+)*)?[A-HPQRSZ]"
    r"|(?:[1-8]|1[1-57-9]|2[0134-689]|3[1-4])(?:;[\d:]*)*~)"
)
"""Textual takes the characters of any other sequence for keys."""

_F8 = re.compile(r"\x1b\[19(?:;[\d:]*)*~")
_URGENT = re.compile(r"\x1b\[19(?:;[\d:]*)*~|\x1b(?![\[O])")
_NO_TEXT = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|O[A-Za-z])?|[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
_LONGEST_SEQUENCE = 64


def escape_patience(environ: Mapping[str, str]) -> float:
    """How long Escape waits for the rest of a sequence, s; `ESCDELAY` (ms) says another time."""
    said = environ.get("ESCDELAY", "")
    if said.isdecimal():
        return int(said) / 1000
    return 0.5 if "SSH_CONNECTION" in environ else 0.1


class InputFilter:
    """Hands on whole sequences, plain text of pastes, and no more keys than can be meant.

    `patience` is how long Escape waits for the rest of a sequence, s. `waiting` counts the keys
    that are not yet handled. `on_flood` is called once when keys are dropped.
    """

    def __init__(
        self, patience: float, waiting: Callable[[], int], on_flood: Callable[[], None]
    ) -> None:
        self._patience = patience
        self._waiting = waiting
        self._on_flood = on_flood
        self._torn = ""
        self._pasted: str | None = None
        self._escaped = self._flooded = self._after_paste = self._behind_f8 = False
        self._last = 0.0
        self._burst = 0

    def feed(self, text: str, now: float) -> str:
        """What to hand on of `text`, which came at `now` (s)."""
        if (paused := now - self._last > PAUSE) and self._pasted is None:
            self._burst, self._flooded, self._after_paste = 0, False, False
            self._behind_f8 = False
        if self._escaped and text[:1] in ("[", "O") and now - self._last < WHOLE_WITHIN:
            text = "\x1b" + text
        self._last, self._escaped = now, False
        if self._pasted is None:
            return "".join(self._keys(self._torn + text))
        if paused and _URGENT.match(text):  # its end has not come
            return self._end_paste() + "".join(self._keys(text))
        return self._paste(text)

    def tick(self, now: float) -> str:
        """What to hand on at `now` (s) though nothing more came."""
        silence = now - self._last
        if self._pasted is not None and silence > PASTE_WITHIN:
            return self._end_paste()
        if self._torn == "\x1b" and silence >= self._patience:
            self._torn, self._escaped = "", True
            return _ESCAPE
        if silence > WHOLE_WITHIN:
            self._torn = ""
        return ""

    def _keys(self, text: str) -> Iterator[str]:
        torn = _TORN.search(text, max(0, len(text) - _LONGEST_SEQUENCE))
        self._torn = torn.group() if torn else ""
        end = torn.start() if torn else len(text)
        room = MOST_KEYS - (0 if self._behind_f8 else self._waiting())
        for match in _TOKEN.finditer(text, 0, end):
            token = match.group()
            if token == _PASTE:
                self._pasted, self._torn = "", ""
                yield self._paste(text[match.end() :])
                return
            self._burst += 1
            if self._burst > room or self._after_paste:
                if not (self._flooded or self._after_paste):
                    self._flooded = True
                    self._on_flood()
                f8 = [*_F8.finditer(text, match.start(), end)][-1:]
                before = f8[0].start() if f8 else end
                yield from map(_whole, dict.fromkeys(_URGENT.findall(text, match.start(), before)))
                if f8:
                    yield f8[0].group()
                if f8 and not self._after_paste:
                    # The app throws away what waits before it: what follows may be its answer.
                    self._burst, self._behind_f8 = 0, True
                    yield from self._keys(text[f8[0].end() :])
                return
            self._behind_f8 |= _F8.fullmatch(token) is not None
            if token == "\x1b" or _KNOWN.fullmatch(token):
                yield _whole(token)

    def _paste(self, text: str) -> str:
        pasted = (self._pasted or "") + text
        end = pasted.find(_PASTE_END)
        if end < 0:  # its end may be torn, too
            self._pasted = pasted[:LONGEST_PASTE] + pasted[LONGEST_PASTE:][-len(_PASTE_END) :]
            return ""
        self._pasted = pasted[:end]
        rest = pasted[end + len(_PASTE_END) :]
        clean = self._end_paste()
        return clean + "".join(self._keys(rest))

    def _end_paste(self) -> str:
        text = _NO_TEXT.sub("", (self._pasted or "")[:LONGEST_PASTE])
        self._pasted, self._after_paste = None, True
        return _PASTE + text + _PASTE_END


def _whole(token: str) -> str:
    return _ESCAPE if token == "\x1b" else token
