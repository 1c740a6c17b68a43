"""Keys that were typed for an earlier screen: they are ignored, and the screen says so."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from textual import events

UNSEEN = 0.3
"""Keys within this time after a change were typed before the change could be seen, s."""

MISTYPED = 0.5
"""After a letter that is no answer, keys without such a pause are the rest of a text, s."""

QUIET = 2.0
"""The same after a key whose question did not come, s."""

_ALWAYS = frozenset({"f8", "f10", "ctrl+q", "ctrl+c", "escape"})
"""Safe keys, never ignored: each means the same on every screen, and asks before it does harm."""


@dataclass(frozen=True, slots=True)
class _Hold:
    """What is left out, and `why`; keys typed before `until`, s.

    Each key that is left out adds `pause`, s: the rest of a word goes with it. `letters` leaves
    out text only, and all else ends it; `enter` leaves out Enter as well.
    """

    why: str
    until: float
    pause: float
    letters: bool = False
    enter: bool = True


class TypeAhead:
    """Decides which keys are ignored: those typed before an unexpected change could be seen.

    The question that a key opens is expected and takes the next keys at once: `F8 1 y` as fast as
    they can be typed. `typed` gives the time at which a key was typed, by the clock `now`, s.
    """

    def __init__(
        self,
        now: Callable[[], float] = time.monotonic,
        typed: Callable[[events.Event], float] = lambda event: event.time,
    ) -> None:
        self._now = now
        self._typed = typed
        self._hold: _Hold | None = None

    def of_one_question(self) -> TypeAhead:
        """One that knows only what happens to a question of its own."""
        return TypeAhead(self._now, self._typed)

    def replaced(self, why: str) -> None:
        """Something else is shown by itself: no key was typed for it yet."""
        self._hold = _Hold(why, self._now() + UNSEEN, UNSEEN)

    def closed(self) -> None:
        """A question is answered: the rest of a word that was typed into it is left out."""
        self._take_letters("typed before the question was gone", UNSEEN)

    def asked(self) -> None:
        """The next question takes a text: the rest of the word just typed is left out."""
        self._take_letters("typed before the field was there", UNSEEN, enter=False)

    def mistyped(self, letter: str) -> None:
        """A letter answered nothing: it may begin a text."""
        self._take_letters(f"it follows {letter}, which is not possible here", MISTYPED)

    def refused(self, cap: str, why: str, *, answered: bool) -> None:
        """A key was refused; its question would have been `answered` by letters."""
        pause = QUIET if answered else UNSEEN
        more = "; Escape, or a pause, and letters are keys again" if answered else ""
        self._take_letters(f"{cap} was refused: {why}{more}", pause)

    def leaves_out(self, event: events.Key | events.Paste | events.MouseEvent) -> str | None:
        """Why a key is left out, in words; None: it counts."""
        hold, at = self._hold, self._typed(event)
        if hold is None:
            return None
        if at >= hold.until or not _holds(hold, event):
            self._hold = None
            return None
        self._hold = _Hold(
            hold.why, max(hold.until, at + hold.pause), hold.pause, hold.letters, hold.enter
        )
        return f"{_name(event)} is left out: {hold.why}"

    def _take_letters(self, why: str, pause: float, *, enter: bool = True) -> None:
        now, before = self._now(), self._hold
        if before is None or before.letters or now >= before.until:
            self._hold = _Hold(why, now + pause, pause, letters=True, enter=enter)


def _holds(hold: _Hold, event: events.Event) -> bool:
    match event:
        case events.Key() if event.key in _ALWAYS:
            return False
        case events.Key() if hold.letters:
            return event.is_printable or (hold.enter and event.key == "enter")
        case events.Paste():
            return True
    return not hold.letters


def _name(event: events.Event) -> str:
    match event:
        case events.Key():
            char = event.character
            return f"'{char}'" if event.is_printable and char else event.key.capitalize()
        case events.Paste():
            return "what was pasted"
    return "the click"
