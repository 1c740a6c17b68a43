"""A program in a pseudo terminal, whose screen pyte draws."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Self, TypeVar

import pyte

PATIENCE = 60.0
"""Each wait lasts at most so long, s. A busy machine is no failure."""
_LOOKING = 0.02  # s between two looks
_CODES = ("OP", "OQ", "OR", "OS", "[15~", "[17~", "[18~", "[19~", "[20~", "[21~")
KEYS = {f"F{number}": f"\x1b{code}" for number, code in enumerate(_CODES, start=1)} | {
    "Enter": "\r",
    "Space": " ",
    "Tab": "\t",
    "Escape": "\x1b",
    "Down": "\x1b[B",
    "Ctrl+R": "\x12",
}
"""What a terminal sends for the keys that are no letters."""
# The program needs the terminal as its own, so that it is told when the terminal goes.
_TAKE_TERMINAL = """\
import fcntl, os, signal, sys, termios
signal.signal(signal.SIGHUP, signal.SIG_DFL)
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""
_UNKNOWN_TO_PYTE = re.compile(rb"\x1b\[[<=>][0-9;]*u")
_Seen = TypeVar("_Seen")


def wait_until(look: Callable[[], _Seen], what: str, timeout: float = PATIENCE) -> _Seen:
    """Look again and again until something true is seen, and return it.

    Raises:
        AssertionError: nothing true was seen within `timeout` s.
    """
    deadline = time.monotonic() + timeout
    while not (seen := look()):
        assert time.monotonic() < deadline, f"{what} did not come within {timeout:g} s"
        time.sleep(_LOOKING)
    return seen


class Terminal:
    """Runs a program in a pseudo terminal until it is closed.

    A thread reads all that the program writes, so that the program never waits for its reader.
    """

    def __init__(
        self, argv: Sequence[str], env: Mapping[str, str], columns: int = 120, lines: int = 40
    ) -> None:
        self._screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self._screen)
        self._lock = threading.Lock()
        self._fd, inner = pty.openpty()
        termios.tcsetwinsize(inner, (lines, columns))
        command = [sys.executable, "-I", "-S", "-c", _TAKE_TERMINAL, *argv]
        self.process = subprocess.Popen(
            command, stdin=inner, stdout=inner, stderr=inner, env=env, start_new_session=True
        )
        os.close(inner)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        """Draw what the program writes until nothing comes any more."""
        with contextlib.suppress(OSError):  # the other end is closed
            while data := os.read(self._fd, 65536):
                with self._lock:
                    self._stream.feed(_UNKNOWN_TO_PYTE.sub(b"", data))

    def lines(self) -> list[str]:
        """The screen now, one text a line."""
        with self._lock:
            return [line.rstrip() for line in self._screen.display]

    def screen(self) -> str:
        """The words on the screen now, with one blank between them wherever they stand."""
        return " ".join(" ".join(self.lines()).split())

    def shows(self, *words: str) -> bool:
        """Whether all of these words stand on the screen now."""
        screen = self.screen()
        return all(each in screen for each in words)

    def wait_for(self, *words: str, timeout: float = PATIENCE) -> None:
        """Wait until all of these words stand on the screen at once."""
        self.wait_for_one(words, timeout=timeout)

    def wait_for_one(self, *choices: Sequence[str], timeout: float = PATIENCE) -> int:
        """Wait until all words of one choice stand on the screen, and return its index."""

        def look() -> list[int]:
            return [index for index, words in enumerate(choices) if self.shows(*words)]

        return self.wait_until(look, " or ".join(map(str, choices)), timeout)[0]

    def wait_until(self, look: Callable[[], _Seen], what: str, timeout: float = PATIENCE) -> _Seen:
        """Look again and again until something true is seen, and return it.

        Raises:
            AssertionError: nothing true was seen, or the program ended before it.
        """

        def look_on() -> _Seen:
            ended = self.process.poll() is not None
            seen = look()
            assert seen or not ended, f"the program ended before {what}"
            return seen

        try:
            return wait_until(look_on, what, timeout)
        except AssertionError as error:
            raise AssertionError("\n".join([str(error), *self.lines()])) from None

    def send(self, text: str) -> None:
        """Type a text."""
        os.write(self._fd, text.encode())

    def press(self, *keys: str) -> None:
        """Press keys by their names, one right after the other."""
        self.send("".join(KEYS.get(key, key) for key in keys))

    def click(self, words: str) -> None:
        """Click with the mouse into the first line on the screen that has these words."""
        places = [(line.find(words), row) for row, line in enumerate(self.lines(), start=1)]
        column, row = next(place for place in places if place[0] >= 0)
        place = f"{column + 1 + len(words) // 2};{row}"
        self.send(f"\x1b[<0;{place}M\x1b[<0;{place}m")

    def wait_exit(self, timeout: float = PATIENCE) -> int:
        """Wait for the end of the program and return its exit code."""
        return self.process.wait(timeout)

    def hang_up(self) -> int:
        """Take the terminal away, as a lost connection does, and return the exit code."""
        self._close_terminal()
        return self.wait_exit()

    def _close_terminal(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def kill(self) -> None:
        """End the program as kill -9 does."""
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        """End the program and take its terminal away."""
        self.kill()
        self._reader.join(1.0)
        self._close_terminal()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
