"""Running the console in a terminal, and leaving it cleanly when the terminal goes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from types import FrameType
from typing import TextIO

from madrob_console.common.errors import MadrobError
from madrob_console.config.tables import ConsoleSettings
from madrob_console.ui.app import MadrobApp
from madrob_console.ui.link import ConsoleDefaults, OpenClient, OpenReplay

EXIT_PATIENCE = 3.0
"""A signal ends the console within this time even if its terminal is stalled, s."""

_SIGNALS = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)


def run_console(
    open_client: OpenClient,
    defaults: ConsoleDefaults,
    look: ConsoleSettings | None = None,
    *,
    wall: bool = False,
    open_replay: OpenReplay | None = None,
) -> int:
    """Shows the screens until the referee leaves; returns the exit code.

    `open_client` is called once the screens can be seen; its client is closed at the end.
    `wall` shows the wall display instead of the referee's screens. `open_replay` connects to a
    replay that is opened from them.

    Raises:
        MadrobError: the terminal cannot show screens, or there is no engine to be had.
    """
    check_terminal(os.environ)
    for name in ("COLUMNS", "LINES"):  # textual believes them, and the window has its own size
        os.environ.pop(name, None)

    look = look or ConsoleSettings()
    error, output = sys.__stderr__, sys.__stdout__
    if output is not None and not (error is not None and error.isatty()):
        output.reconfigure(errors="backslashreplace")  # as the error output has it
        vars(sys)["__stderr__"] = output  # textual draws on it
    app = MadrobApp(open_client, defaults, look, open_replay=open_replay)
    if wall:
        from madrob_console.ui.wall import WallApp

        app = WallApp(open_client, defaults, look)
    try:
        with leaving_on_signals(app):
            app.run(mouse=look.mouse)
    finally:
        app.close_link()
    if app.return_code == 128 + signal.SIGHUP:
        _let_go_of_terminal()
    if app.failure is not None:
        raise app.failure
    return app.return_code or 0


def _let_go_of_terminal() -> None:
    """Drops unwritten output of a terminal that is gone: Python would exit with 120."""
    with suppress(OSError):
        sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)


def check_terminal(
    environ: Mapping[str, str], streams: Iterable[TextIO | None] = (), instead: str = "run"
) -> None:
    """Check that screens can be shown; `instead` is the command that prints lines.

    Raises:
        MadrobError: TERM is `dumb` or not set, or a stream is a file or a pipe.
    """
    if not all(stream is not None and stream.isatty() for stream in streams):
        raise MadrobError(f"no terminal: `madrob {instead}` prints plain lines, here or in a pipe")
    term = environ.get("TERM", "")
    if term in ("", "dumb", "unknown"):
        raise MadrobError(f"TERM is '{term}', no screens: `madrob {instead}` prints plain lines")


def _ignore(_number: int, _frame: FrameType | None) -> None:
    """Nothing."""


@contextmanager
def leaving_on_signals(app: MadrobApp) -> Iterator[None]:
    """Within the block, HUP, INT and TERM leave the app with exit code 128 + number.

    Without it they kill the process at once: no unmount, no `finally`, a broken terminal.
    """

    def leave(number: int, _frame: FrameType | None) -> None:
        # a hang-up sends CONT, too, for which textual would set up the lost terminal again
        signal.signal(signal.SIGCONT, _ignore)
        app.exit(return_code=128 + number)
        arrived.put(number)  # takes no lock: another signal comes while this one is handled

    def give_up_later() -> None:
        # a terminal that takes nothing more holds up the loop, and with it the exit
        number = arrived.get()
        if number is not None and not left.wait(EXIT_PATIENCE):
            app.close_link()
            os._exit(128 + number)

    arrived: SimpleQueue[int | None] = SimpleQueue()
    left = threading.Event()
    threading.Thread(target=give_up_later, daemon=True).start()
    before = {number: signal.signal(number, leave) for number in _SIGNALS}
    try:
        yield
    finally:
        left.set()
        arrived.put(None)
        for number, handler in before.items():
            signal.signal(number, handler)
