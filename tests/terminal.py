"""A program in a terminal of its own, seen as a person sees it."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import pyte

from tests.watching import PATIENCE

CLEARED = (
    "COLORTERM",
    "COLUMNS",
    "LINES",
    "NO_COLOR",
    "TEXTUAL_COLOR_SYSTEM",
    "TEXTUAL_THEME",
    # the ROS wheels set this once they have found their libraries; each Python finds its own
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)
BETWEEN_LOOKS = 0.05  # s
FIXED = {"LC_ALL": "C.UTF-8", "TERM": "xterm-256color", "TEXTUAL_ANIMATIONS": "none"}

# a session of its own has no terminal until it asks for one; without it nothing hangs up
_TAKE_TERMINAL = """\
import fcntl, os, signal, sys, termios
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it would be ignored
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""
_UNKNOWN_TO_PYTE = re.compile(rb"\x1b\[[<=>][0-9;]*u")  # keyboard protocol; it would show the u


class Screen:
    """What a program shows, looked at until it is what a test waits for."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the program."""
        raise NotImplementedError

    def screen(self) -> list[str]:
        """The screen now, a line each, without blanks at the ends."""
        raise NotImplementedError

    def exit_code(self) -> int | None:
        """None while the program runs."""
        raise NotImplementedError

    def pause(self) -> None:
        """Before the next look."""
        time.sleep(BETWEEN_LOOKS)

    def find(self, look: Callable[[list[str]], str | None], wanted: str, timeout: float) -> str:
        """Wait until something is on the screen.

        Raises:
            AssertionError: it does not come within `timeout` s, or the program ends.
        """
        deadline = time.monotonic() + timeout
        while True:
            ended = self.exit_code() is not None
            screen = self.screen()
            if (found := look(screen)) is not None:
                return found
            shown = "\n".join(screen).rstrip()
            assert not ended, f"the program ended before {wanted}:\n{shown}"
            late = time.monotonic() > deadline
            assert not late, f"{wanted} did not come in {timeout:g} s:\n{shown}"
            self.pause()

    def wait_exit(self, timeout: float = PATIENCE) -> int:
        """Wait for the program's end; its exit code.

        Raises:
            AssertionError: it goes on for more than `timeout` s.
        """
        deadline = time.monotonic() + timeout
        while (code := self.exit_code()) is None:
            shown = "\n".join(self.screen()).rstrip()
            assert time.monotonic() < deadline, f"still running after {timeout:g} s:\n{shown}"
            self.pause()
        self.screen()  # what it wrote last
        return code


class Terminal(Screen):
    """Runs a program in a pty and keeps the screen that it draws.

    What the program writes is read only inside of the methods: between them its terminal stalls,
    as it does on a dead link.

    Args:
        argv: the program and its arguments.
        columns, lines: size of the screen.
        env: added to this process's environment, from which what steers colours is cleared.
        cwd: where the program runs.
    """

    def __init__(
        self,
        argv: Sequence[str],
        columns: int = 80,
        lines: int = 24,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
    ) -> None:
        self.output = bytearray()
        """Everything that the program has written, as far as it was read."""
        self._screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self._screen)
        self._fd, slave = pty.openpty()
        termios.tcsetwinsize(slave, (lines, columns))
        environment = {k: v for k, v in os.environ.items() if k not in CLEARED}
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _TAKE_TERMINAL, *argv],
                stdin=slave,
                stdout=slave,
                stderr=slave,
                env={**environment, **FIXED, **(env or {})},
                cwd=cwd,
                start_new_session=True,
            )
        finally:
            os.close(slave)

    @property
    def pid(self) -> int:
        """The program's process."""
        return self._process.pid

    def screen(self) -> list[str]:
        """The screen now, a line each, without blanks at the ends."""
        while self._read(0.0):
            pass
        return [line.rstrip() for line in self._screen.display]

    def send(self, keys: str) -> None:
        """Type."""
        os.write(self._fd, keys.encode())

    def send_bytes(self, data: bytes) -> None:
        """What no keyboard sends, too."""
        os.write(self._fd, data)

    def resize(self, columns: int, lines: int) -> None:
        """The program has another size; what pyte shows then is not looked at."""
        termios.tcsetwinsize(self._fd, (lines, columns))

    def wait_for(self, *texts: str, timeout: float = PATIENCE) -> str:
        """Wait until one of `texts` stands on the screen, within one line; returns it.

        Raises:
            AssertionError: none comes within `timeout` s, or the program ends.
        """

        def look(screen: list[str]) -> str | None:
            return next((text for text in texts if any(text in line for line in screen)), None)

        return self.find(look, " or ".join(map(repr, texts)), timeout)

    def pause(self) -> None:
        """Until something is written, or for a while."""
        self._read(0.1)

    def exit_code(self) -> int | None:
        """None while the program runs; negative for a signal."""
        return self._process.poll()

    def wait_exit_unread(self, timeout: float) -> int:
        """Wait for the program's end without taking what it writes; its exit code.

        Raises:
            subprocess.TimeoutExpired: it goes on for more than `timeout` s.
        """
        return self._process.wait(timeout)

    def hang_up(self) -> None:
        """Take the terminal away, as a lost connection does: the program gets SIGHUP."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def close(self) -> None:
        """Take the terminal away and end the program if it stays."""
        self.hang_up()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read(self, timeout: float) -> bool:
        """Take what the program has written; False if there is nothing within `timeout` s."""
        if self._fd < 0 or not select.select([self._fd], [], [], timeout)[0]:
            return False
        data = b""
        with suppress(OSError):  # the other end is closed
            data = os.read(self._fd, 65536)
        self.output += data
        self._stream.feed(_UNKNOWN_TO_PYTE.sub(b"", data))
        return bool(data)
