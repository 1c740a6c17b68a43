"""Many callers, run as a program of its own: they read, ask for too much, or are deaf.

Usage: `crowd.py STEM WATCHING FLOOD DEAF`: so many screens that watch, requests that one of them
sends at once, and screens that ask and never read. It says `there` when all are attached.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from madrob_console.engine.ipc import greeting, wire
from madrob_console.engine.ipc.engine_sockets import connect_to
from madrob_console.engine.requests import NextRunNumber, Role

ROOT = Path(__file__).parents[2]
THERE = "there"


@contextmanager
def crowd(stem: str, watching: int = 0, flood: int = 0, deaf: int = 0) -> Iterator[None]:
    """They are attached while inside; the flood goes on from the beginning."""
    sizes = map(str, (watching, flood, deaf))
    module = "tests.madrob_console.crowd"
    with subprocess.Popen(
        [sys.executable, "-m", module, stem, *sizes],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline().strip() == THERE
            yield
        finally:
            process.kill()


def _attached(stem: str, role: Role) -> socket.socket:
    screen = connect_to(stem, 10.0)
    screen.settimeout(None)
    screen.sendall(wire.frame(greeting.Hello(wire.VERSION, role, "one of many")))
    return screen


def _asking(count: int) -> bytes:
    asked = wire.raw(NextRunNumber(3, 1))
    deadline = time.monotonic() + 600.0
    return b"".join(wire.frame(wire.Call(n, deadline, asked)) for n in range(count))


def _read(screen: socket.socket) -> None:
    while screen.recv(1 << 20):
        pass


def main() -> None:
    """Attach, ask, and read until the end."""
    stem, watching, flood, deaf = sys.argv[1], *map(int, sys.argv[2:])
    screens = [_attached(stem, Role.WATCH) for _ in range(watching)]
    never_read = [_attached(stem, Role.REFEREE) for _ in range(deaf)]
    asked = _asking(flood)
    for screen in (*screens[:1], *never_read):
        threading.Thread(target=screen.sendall, args=(asked,), daemon=True).start()
    for screen in screens:
        threading.Thread(target=_read, args=(screen,), daemon=True).start()
    print(THERE, flush=True)
    signal.pause()


if __name__ == "__main__":
    main()
