"""Running the console in a terminal, and leaving it cleanly when the terminal goes."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

from madrob_console.errors import MadrobError
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.defaults import ConsoleDefaults

if TYPE_CHECKING:
    from textual.app import App

    from madrob_console.engine.client import EngineClient

_SIGNALS = (signal.SIGHUP, signal.SIGTERM)


def run_console(client: EngineClient, defaults: ConsoleDefaults, *, mouse: bool = False) -> int:
    """Show the screens until the referee leaves; returns the exit code.

    The client stays open: who opened it closes it.

    Args:
        client: the engine.
        defaults: what the first run's set-up proposes.
        mouse: let the terminal report the mouse; without it, the terminal's own selection works.

    Raises:
        MadrobError: the terminal cannot show screens.
    """
    check_terminal(os.environ)
    app = MadrobApp(client, defaults)
    with leaving_on_signals(app):
        app.run(mouse=mouse)
    return app.return_code or 0


def check_terminal(environ: Mapping[str, str]) -> None:
    """Refuse a terminal that cannot move its cursor.

    Raises:
        MadrobError: TERM is `dumb` or not set.
    """
    term = environ.get("TERM", "")
    if term in ("", "dumb", "unknown"):
        raise MadrobError(
            f"TERM is '{term}': this terminal cannot show screens; use `madrob run`, which prints"
            " plain lines"
        )


@contextmanager
def leaving_on_signals(app: App[Any]) -> Iterator[None]:
    """While inside, HUP and TERM leave the app with exit code 128 + number.

    Without it either kills the process at once: no unmount, no `finally`, a broken terminal.
    """

    def leave(number: int, _frame: FrameType | None) -> None:
        app.exit(return_code=128 + number)

    before = {number: signal.signal(number, leave) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
