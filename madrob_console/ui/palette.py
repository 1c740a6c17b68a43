"""The command palette: every key by name, and the themes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import cast

from textual.command import DiscoveryHit, Hit, Hits, Provider

from madrob_console.kinds import ThemeName
from madrob_console.ui.keys.console_app import ConsoleApp
from madrob_console.ui.keys.key_table import KEYS
from scoring.protocol import Step


class ConsoleCommands(Provider):
    """Searches the console's commands."""

    async def discover(self) -> Hits:
        """All of them, in the order of the keys."""
        for text, command, help_text in _commands(self._console_app):
            yield DiscoveryHit(text, command, help=help_text)

    async def search(self, query: str) -> Hits:
        """Those that match what is typed."""
        matcher = self.matcher(query)
        for text, command, help_text in _commands(self._console_app):
            score = max(matcher.match(text), matcher.match(help_text) / 2)
            if score > 0:
                yield Hit(score, matcher.highlight(text), command, help=help_text)

    @property
    def _console_app(self) -> ConsoleApp:
        return cast("ConsoleApp", self.app)


def _commands(app: ConsoleApp) -> Iterator[tuple[str, Callable[[], object], str]]:
    """Name, what it does, and what that means, with the reason where it is not possible now."""
    for key in KEYS.values():
        if key.name == "menu" or not app.has_key(key):
            continue
        refused = app.key_refusal(key)
        help_text = key.help if refused is None else f"not now: {refused}"
        if key.name == "rule":
            for step in Step:
                press = partial(app.action_press, "rule", str(int(step)))
                yield f"{int(step)}  step {int(step)}: {step.text}", press, help_text
            continue
        press = partial(app.action_press, key.name, key.keys.partition(",")[0])
        yield f"{key.cap}  {key.label.strip()}", press, help_text
    for name in ThemeName:
        yield f"Theme: {name}", partial(app.set_theme, name), "colours of the screens"
    state = "off" if app.rings else "on"
    yield f"Bell: switch {state}", app.toggle_bell, "rings on start, stop and fault"
