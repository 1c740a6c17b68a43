"""The command palette: every key by name, and the themes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, cast

from textual.command import DiscoveryHit, Hit, Hits, Provider
from textual.content import Content

from madrob_console.kinds import ThemeName
from madrob_console.ui.keys.console_app import ConsoleApp
from madrob_console.ui.keys.key_table import KEYS
from scoring.protocol import Step

_TEXT = 22
"""Cells of a command before what it means."""


class ConsoleCommands(Provider):
    """Searches the console's commands."""

    async def discover(self) -> Hits:
        """All of them, in the order of the keys; those that are not possible now come last."""
        for text, command, help_text, _possible in _commands(self._console_app):
            yield DiscoveryHit(_row(Content(text), help_text), command, text)

    async def search(self, query: str) -> Hits:
        """Those that match what is typed."""
        matcher = self.matcher(query)
        for text, command, help_text, possible in _commands(self._console_app):
            score = max(matcher.match(text), matcher.match(help_text) / 2)
            if score > 0:
                row = _row(matcher.highlight(text), help_text)
                yield Hit(score if possible else score / 4, row, command, text)

    @property
    def _console_app(self) -> ConsoleApp:
        return cast("ConsoleApp", self.app)


class _Command(NamedTuple):
    """One line of the palette: its text, what it does, what that means, whether it is possible."""

    text: str
    command: Callable[[], object]
    help: str
    possible: bool = True


def _row(text: Content, help_text: str) -> Content:
    """A command and what it means on one row, as many of them as the terminal has rows."""
    return Content.assemble(text.pad_right(max(1, _TEXT - text.cell_length)), (help_text, "dim"))


def _commands(app: ConsoleApp) -> list[_Command]:
    """All, with the reason where one is not possible now: those are the last."""
    return sorted(_in_order(app), key=lambda command: not command.possible)


def _in_order(app: ConsoleApp) -> Iterator[_Command]:
    for key in KEYS.values():
        if key.name == "menu" or not app.has_key(key):
            continue
        refused = app.key_refusal(key)
        help_text = key.help if refused is None else f"not now: {refused}"
        if key.name == "rule":
            for step in Step:
                press = partial(app.action_press, "rule", str(int(step)))
                text = f"{int(step)}  step {int(step)}: {step.text}"
                yield _Command(text, press, help_text, refused is None)
            continue
        press = partial(app.action_press, key.name, key.keys.partition(",")[0])
        yield _Command(f"{key.cap}  {key.label.strip()}", press, help_text, refused is None)
    for name in ThemeName:
        yield _Command(f"Theme: {name}", partial(app.set_theme, name), "colours of the screens")
    state = "off" if app.rings else "on"
    yield _Command(f"Bell: switch {state}", app.toggle_bell, "rings on start, stop and fault")
