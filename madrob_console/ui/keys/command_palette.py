"""The command palette: every key by name, and the themes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, cast

from textual import events
from textual.await_complete import AwaitComplete
from textual.command import CommandPalette, Hit, Hits, Provider
from textual.content import Content
from textual.css.query import NoMatches
from textual.errors import NoWidget
from textual.worker import Worker

from madrob_console.common.names import ThemeName
from madrob_console.ui.keys.console_app import ConsoleApp
from madrob_console.ui.keys.key_table import KEYS
from scoring.protocol import Step

_TEXT = 22
"""Cells of a command before what it means."""


class ConsolePalette(CommandPalette):
    """Textual's, but it ends no console.

    For each click beside it that is queued Textual closes the topmost screen, the console's too.
    While it opens, closes or is resized, its list or what is under the mouse may be missing.
    """

    def dismiss(self, result: None = None) -> AwaitComplete:
        return super().dismiss(result) if self.is_active else AwaitComplete()

    def run_worker(self, *search: Any, **options: Any) -> Worker[Any]:  # noqa: ANN401
        """As Textual's; a search whose list is missing fails alone."""
        return super().run_worker(*search, **options | {"exit_on_error": False})

    async def on_event(self, event: events.Event) -> None:
        with suppress(NoMatches, NoWidget):
            await super().on_event(event)


class ConsoleCommands(Provider):
    """Searches the console's commands; those that are not possible now come last."""

    def discover(self) -> Hits:
        return self.search("")

    async def search(self, query: str) -> Hits:
        matcher = self.matcher(query)
        for text, command, help_text, possible in _commands(cast("ConsoleApp", self.app)):
            score = matcher.match(text) if query else 1.0
            if score > 0:
                shown = matcher.highlight(text) if query else Content(text)
                blank = max(1, _TEXT - shown.cell_length)
                row = Content.assemble(shown.pad_right(blank), (help_text, "dim"))
                yield Hit(score if possible else score / 4, row, command, text)


_Command = tuple[str, Callable[[], object], str, bool]
"""A command's text, what it does, what that means, whether it is possible."""


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
            yield text, press, help_text, refused is None
    for name in ThemeName:
        yield f"Theme: {name}", partial(app.set_theme, name), "colours of the screens", True
    state = "off" if app.rings else "on"
    yield f"Bell: switch {state}", app.toggle_bell, "rings on start, stop and fault", True
