"""What screens ask of the app around them; palette, terminal, keys typed ahead."""

from __future__ import annotations

import os
import time
from codecs import getincrementaldecoder
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from selectors import EVENT_READ, DefaultSelector
from threading import Thread
from typing import TYPE_CHECKING, Protocol, cast

from textual import events
from textual.command import Hit, Hits, Provider
from textual.content import Content
from textual.drivers.linux_driver import LinuxDriver
from textual.message import Message

from madrob_console.ui.keys.key_table import CALLED, KEYS
from madrob_console.ui.keys.terminal_input import InputFilter, escape_patience
from scoring.protocol import Step

if TYPE_CHECKING:
    from textual.app import App

    from madrob_console.ui.keys.key_table import Key


class ConsoleApp(Protocol):
    """The app around the screens."""

    rings: bool

    def ring(self) -> None: ...

    def toggle_bell(self) -> None: ...

    @property
    def theme_names(self) -> Iterable[str]: ...

    def set_theme(self, name: str) -> None: ...

    def has_key(self, key: Key) -> bool:
        """Whether the key exists now: keys of a replay do so on a replay only."""
        ...

    def key_refusal(self, key: Key) -> str | None: ...

    def action_press(self, name: str, pressed: str) -> Awaitable[None]: ...

    def withdraw(self) -> bool:
        """Withdraws what waits for the disk; False if nothing does."""
        ...


# What comes from the terminal: whole keys, and clicks and drags of the mouse.


_MOVES, _DRAGS = "\x1b[?1003", "\x1b[?1002"

_LOOK = 0.05
"""Between two looks for what the terminal does not finish, s."""


class KeysDropped(Message):
    """So many keys came at once that most were dropped."""


class ConsoleDriver(LinuxDriver):
    """Textual reads what `InputFilter` hands on.

    Moves of the mouse are not reported: each would cross the line and wake the screens.
    """

    def __init__(
        self,
        app: App[object],
        *,
        debug: bool = False,
        mouse: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        """As any driver."""
        super().__init__(app, debug=debug, mouse=mouse, size=size)
        self._filter = InputFilter(
            escape_patience(os.environ),
            lambda: app.message_queue_size,
            lambda: self.send_message(KeysDropped()),
        )

    def run_input_thread(self) -> None:
        """Textual's, on a pipe."""
        terminal, (reading, writing) = self.fileno, os.pipe()
        feeding = Thread(target=self._feed, args=(terminal, writing), name="terminal-input")
        feeding.start()
        self.fileno = reading
        try:
            super().run_input_thread()
        finally:
            self.fileno = terminal
            self.exit_event.set()
            feeding.join()
            os.close(reading)
            os.close(writing)

    def _feed(self, terminal: int, writing: int) -> None:
        decode = getincrementaldecoder("utf-8")("replace").decode
        with DefaultSelector() as selector:
            selector.register(terminal, EVENT_READ)
            while not self.exit_event.is_set():
                came = b""
                if selector.select(_LOOK):
                    with suppress(OSError):
                        came = os.read(terminal, 1 << 16)
                    if not came:  # a terminal that has gone: the hang-up ends the console
                        selector.unregister(terminal)
                now = time.monotonic()
                text = self._filter.feed(decode(came), now) if came else self._filter.tick(now)
                os.write(writing, text.encode())

    def write(self, data: str) -> None:
        super().write(data.replace(_MOVES, _DRAGS) if data.startswith(_MOVES) else data)


# Keys that were typed for an earlier screen: they are ignored, and the screen says so.


UNSEEN = 0.3
"""What is typed so soon after a change was typed before the change could be seen, s."""

MISTYPED = 0.5
"""After a letter that answers nothing: what comes without such a pause is the rest of a text, s."""

QUIET = 2.0
"""The same after a key whose question did not come, s."""

_ALWAYS = frozenset({"f8", "f10", "ctrl+q", "ctrl+c", "escape"})
"""They mean the same whatever is shown, and none does harm before it is answered."""


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
    """Decides which keys are left out.

    What a key of the referee brings about is foreseen and takes the next keys at once: `F8 1 y`
    as fast as they can be typed. What comes by itself is not foreseen, nor what did not come.
    `typed` tells when a key was typed, by the clock `now`, s.
    """

    def __init__(
        self,
        now: Callable[[], float] = time.monotonic,
        typed: Callable[[events.Event], float] = lambda event: event.time,
    ) -> None:
        self._now = now
        self._typed = typed
        self._hold: _Hold | None = None

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


# The command palette: every key by name, and the themes.


_TEXT = 22
"""Cells of a command before what it means."""


class ConsoleCommands(Provider):
    """Searches the console's commands; those that are not possible now come last."""

    def discover(self) -> Hits:
        return self.search("")

    async def search(self, query: str) -> Hits:
        matcher = self.matcher(query)
        for text, command, help_text, words, possible in _commands(cast("ConsoleApp", self.app)):
            score = max(matcher.match(text), matcher.match(words) / 2) if query else 1.0
            if score > 0:
                shown = matcher.highlight(text) if query else Content(text)
                blank = max(1, _TEXT - shown.cell_length)
                row = Content.assemble(shown.pad_right(blank), (help_text, "dim"))
                yield Hit(score if possible else score / 4, row, command, text)


_Command = tuple[str, Callable[[], object], str, str, bool]
"""A command's text, what it does, what that means, what people call it, whether it is possible."""


def _commands(app: ConsoleApp) -> Iterator[_Command]:
    for key in KEYS.values():
        if key.name in ("menu", "palette", "open") or not app.has_key(key):
            continue
        refused = app.key_refusal(key)
        help_text = key.help if refused is None else f"not now: {refused}"
        cap = key.cap if key.keys else f"Enter {key.cap}"
        texts = {key.keys.partition(",")[0]: f"{cap}  {key.label}"}
        if key.name == "rule":
            texts = {str(int(step)): f"{int(step)}  step {int(step)}: {step.text}" for step in Step}
        for each, text in texts.items():
            press = partial(app.action_press, key.name, each)
            yield text, press, help_text, f"{CALLED.get(key.name)} {key.help}", refused is None
    for name in app.theme_names:
        look = "colours of the screens"
        yield f"Theme: {name}", partial(app.set_theme, name), look, look, True
    state = "off" if app.rings else "on"
    rings = "rings on start, stop and fault"
    yield f"Bell: switch {state}", app.toggle_bell, rings, rings, True
