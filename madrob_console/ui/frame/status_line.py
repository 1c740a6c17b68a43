"""What was said last, with its time of day; it fades, and goes with the next key."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line, paragraph
from madrob_console.ui.look.words import time_of_day

FRESH = 5.0
"""After this a message is dim, s."""

_GRAVE = (Tone.BAD, Tone.WARN)


class StatusLine(Lines):
    """A message; where there is none, a hint.

    Args:
        hint: what stands there while nothing is said.
        monotonic: a clock for the age of a message, s.
        wall: the time of day, s since the epoch.

    Attributes:
        text: of the message, without its time; of the hint where there is none.
        hint: as given; empty = no more.
        tone: of the message.
    """

    def __init__(
        self, hint: str, monotonic: Callable[[], float], wall: Callable[[], float] = time.time
    ) -> None:
        super().__init__(id="status-line")
        self._monotonic = monotonic
        self._wall = wall
        self._said = ""
        self._at = self._shown_at = 0.0
        self._faded = False
        self.hint = hint
        self.tone = Tone.DIM

    @property
    def text(self) -> str:
        """The message, or the hint."""
        return self._said or self.hint

    @property
    def grave(self) -> bool:
        """Whether the message is a refusal or a warning: only a key ends it."""
        return bool(self._said) and self.tone in _GRAVE

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Show a message; an empty one is none."""
        self._said, self.tone = text, tone if text else Tone.DIM
        self._at, self._shown_at, self._faded = self._wall(), self._monotonic(), False
        self.redraw()

    def age(self) -> None:
        """Fade when it is time."""
        faded = bool(self._said) and self._monotonic() - self._shown_at >= FRESH
        if faded != self._faded:
            self._faded = faded
            self.redraw()

    def go(self) -> None:
        """A key was pressed: what was said is about what was before."""
        if self._said:
            self.say("")

    def pass_on(self) -> None:
        """Something else is shown: only what is grave still matters."""
        if not self.grave:
            self.go()

    def lines(self, width: int) -> Sequence[Line]:
        """The time and the message, wrapped; the hint has no time."""
        if not self._said:
            return paragraph(self.hint, width, Tone.DIM)
        head = line(Span(f"{time_of_day(self._at)} ", Tone.DIM))
        return paragraph(self._said, width, Tone.DIM if self._faded else self.tone, head)
