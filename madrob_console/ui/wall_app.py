"""`madrob watch --big`: the app that is nothing but the wall display."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, ClassVar

from textual.binding import BindingType

from madrob_console.archive.history import History, of_competition
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.frame.wall_screen import WallScreen

if TYPE_CHECKING:
    from collections.abc import Callable

    from textual.screen import Screen

    from madrob_console.config.tables import ConsoleSettings
    from madrob_console.engine.shown.client import EngineClient
    from madrob_console.ui.defaults import ConsoleDefaults


class WallApp(MadrobApp, inherit_bindings=False):
    """The console's look and its link to the engine, with another screen and none of its keys.

    Args:
        open_client: connects to the engine as a spectator.
        defaults: where the runs lie.
        look: theme, characters.
        monotonic: a clock for the engine's silence and the pages, s.
    """

    BINDINGS: ClassVar[list[BindingType]] = []
    COMMANDS = set()  # noqa: RUF012  textual's declaration
    ENABLE_COMMAND_PALETTE = False

    def __init__(
        self,
        open_client: Callable[[], EngineClient],
        defaults: ConsoleDefaults,
        look: ConsoleSettings | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(open_client, defaults, look, monotonic)
        history = History(defaults.results)
        self._wall = WallScreen(
            self._link,
            lambda: of_competition(history.refresh(), defaults.competition),
            self._monotonic,
        )

    def get_default_screen(self) -> Screen[None]:
        """The wall display."""
        return self._wall

    async def begin(self) -> None:
        """There is an engine to show."""
        self._wall.begin()
