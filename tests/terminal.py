"""A program in a terminal of its own, or in a tmux in one, seen as a person sees it."""

from __future__ import annotations

import os
import pty
import re
import select
import shlex
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import pyte

from tests.watching import PATIENCE, Closing, until, wait_gone

CLEARED = (
    "COLORTERM",
    "COLUMNS",
    "LINES",
    "NO_COLOR",
    "TEXTUAL_COLOR_SYSTEM",
    "TEXTUAL_THEME",
    "TMUX",
    # the ROS wheels set this once they have found their libraries; each Python finds its own
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)
FIXED = {"LC_ALL": "C.UTF-8", "TERM": "xterm-256color", "TEXTUAL_ANIMATIONS": "none"}
KEYS = {
    **{f"F{n}": f"\x1b{code}" for n, code in enumerate(("OP", "OQ", "OR", "OS", "[15~"), start=1)},
    **{f"F{n}": f"\x1b[{n + 11}~" for n in range(6, 11)},
    "Enter": "\r",
    "Tab": "\t",
    "Escape": "\x1b",
    "Right": "\x1b[C",
    "Ctrl+R": "\x12",
}
"""What a terminal sends for keys that are no letters."""

# a session of its own has no terminal until it asks for one; without it nothing hangs up
_TAKE_TERMINAL = """\
import fcntl, os, signal, sys, termios
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it would be ignored
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""
_UNKNOWN_TO_PYTE = re.compile(rb"\x1b\[[<=>][0-9;]*u")  # keyboard protocol; it would show the u


class Terminal(Closing):
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
        self._env = {**environment, **FIXED, **(env or {})}
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _TAKE_TERMINAL, *argv],
                stdin=slave,
                stdout=slave,
                stderr=slave,
                env=self._env,
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

    def shows(self, *texts: str) -> str:
        """Which of `texts` stands on the screen, within one line; empty = none.

        Several blanks may be one, so that columns can move.
        """
        lines = self.screen()
        lines += [" ".join(line.split()) for line in lines]
        return next((text for text in texts if any(text in line for line in lines)), "")

    def send(self, keys: str | bytes) -> None:
        """Type, or send what no keyboard does."""
        os.write(self._fd, keys.encode() if isinstance(keys, str) else keys)

    def press(self, *keys: str) -> None:
        """Press keys by their names, all at once: `F5`, `Enter`, `Tab`, `x`."""
        self.send("".join(KEYS.get(key, key) for key in keys))

    def resize(self, columns: int, lines: int) -> None:
        """The program has another size; what pyte shows then is not looked at."""
        termios.tcsetwinsize(self._fd, (lines, columns))

    def wait_until(self, look: Callable[[], str], wanted: str, timeout: float = PATIENCE) -> str:
        """Look again and again until there are words to return.

        Raises:
            AssertionError: there are none within `timeout` s, or the program ends.
        """
        deadline = time.monotonic() + timeout
        while True:
            ended, late = self._process.poll() is not None, time.monotonic() > deadline
            if words := look():
                return words
            assert not ended, f"the program ended before {wanted}:\n{self._shown}"
            assert not late, f"{wanted} did not come in {timeout:g} s:\n{self._shown}"
            self._read(0.1)

    def wait_for(self, *texts: str, timeout: float = PATIENCE) -> str:
        """Wait until one of `texts` stands on the screen, as `shows` looks for it; returns it."""
        wanted = " or ".join(map(repr, texts))
        return self.wait_until(lambda: self.shows(*texts), wanted, timeout)

    def wait_exit(self, timeout: float = PATIENCE) -> int:
        """Wait for the program's end; its exit code, negative for a signal.

        Raises:
            AssertionError: it goes on for more than `timeout` s.
        """
        deadline = time.monotonic() + timeout
        while (code := self._process.poll()) is None:
            late = time.monotonic() > deadline
            assert not late, f"still running after {timeout:g} s:\n{self._shown}"
            self._read(0.1)
        self.screen()  # what it wrote last
        return code

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

    @property
    def _shown(self) -> str:
        return "\n".join(self.screen()).rstrip()

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


_TMUX = """\
set -g default-terminal tmux-256color
set -g status off
set -s escape-time 10
"""


class Tmux(Terminal):
    """A program in a tmux server of its own, which reads no settings of the user; as `Terminal`."""

    def __init__(
        self,
        argv: Sequence[str],
        columns: int = 80,
        lines: int = 24,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="madrob-")
        settings = Path(self._folder.name, "tmux.conf")
        settings.write_text(_TMUX)
        self._tmux = ["tmux", "-u", "-L", "madrob", "-f", str(settings)]
        own = {**(env or {}), "TMUX_TMPDIR": self._folder.name}  # where the server's socket lies
        super().__init__([*self._tmux, "new-session", shlex.join(argv)], columns, lines, own, cwd)
        until(lambda: self._tell("list-panes"))  # the server is there

    def set_option(self, name: str, value: str) -> None:
        """A setting of this tmux."""
        self._tell("set-option", "-g", name, value)

    def buffer(self) -> str:
        """What was copied last into this tmux."""
        return self._tell("show-buffer")

    def _tell(self, *command: str) -> str:
        done = subprocess.run(
            [*self._tmux, *command], env=self._env, capture_output=True, text=True, check=False
        )
        return done.stdout

    def close(self) -> None:
        """End the server and what runs in it."""
        inside = self._tell("list-panes", "-a", "-F", "#{pane_pid}").split()
        self._tell("kill-server")
        super().close()
        for pid in inside:
            wait_gone(int(pid))
        self._folder.cleanup()
