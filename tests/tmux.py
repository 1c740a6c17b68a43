"""A program in a real tmux: keys go in by name, the screen comes out as text."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.terminal import BETWEEN_LOOKS, CLEARED, FIXED, Screen
from tests.watching import PATIENCE

TERM = "tmux-256color"
ANSWERING = 20.0
"""Longest time that tmux itself may take for a command, s."""
LEAVING = 10.0
"""Time that the program has to leave after a hang-up, s."""

_PANE = "it:0.0"


class Tmux(Screen):
    """A tmux server of its own with one window, in which a program runs.

    It reads no settings of the user, and ends in `close` with all that runs in it.

    Args:
        argv: the program and its arguments.
        columns, lines: size of the window; no line of it is tmux's own.
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
        self._folder = tempfile.TemporaryDirectory(prefix="madrob-")
        environment = {k: v for k, v in os.environ.items() if k not in CLEARED}
        environment.pop("TMUX", None)
        self._env = {**environment, **FIXED, **(env or {})}
        self._env["TMUX_TMPDIR"] = self._folder.name  # where the server's socket lies
        # tmux has an exit code of its own, but loses it now and then
        self._code = Path(self._folder.name, "exit_code")
        command = f"{shlex.join(argv)}; echo $? >{shlex.quote(str(self._code))}"
        self._group = 0
        try:
            self._tell(
                "start-server", ";",
                "set-option", "-g", "default-terminal", TERM, ";",
                "set-option", "-g", "status", "off", ";",
                "set-option", "-g", "remain-on-exit", "on", ";",
                "set-option", "-g", "remain-on-exit-format", "", ";",
                "set-option", "-g", "exit-empty", "off", ";",
                "new-session", "-d", "-s", "it", "-x", str(columns), "-y", str(lines),
                "-c", str(cwd or Path.cwd()), command,
            )  # fmt: skip
            self._group = int(self._tell("display-message", "-p", "-t", _PANE, "#{pane_pid}"))
        except BaseException:
            self.close()
            raise

    def screen(self) -> list[str]:
        """The screen now, a line each, without blanks at the ends."""
        shown = self._tell("capture-pane", "-p", "-t", _PANE)
        return [line.rstrip() for line in shown.split("\n")[:-1]]

    def press(self, *keys: str) -> None:
        """Press keys by tmux's names: `F5`, `Enter`, `Tab`, `x`."""
        self._tell("send-keys", "-t", _PANE, *keys)

    def write(self, text: str) -> None:
        """Type a text, letter by letter."""
        self._tell("send-keys", "-t", _PANE, "-l", text)

    def send_bytes(self, data: bytes) -> None:
        """What no keyboard sends, too."""
        self._tell("send-keys", "-t", _PANE, "-H", *(f"{byte:02x}" for byte in data))

    def resize(self, columns: int, lines: int) -> None:
        """Of the window."""
        self._tell("resize-window", "-t", _PANE, "-x", str(columns), "-y", str(lines))

    def set_option(self, name: str, value: str) -> None:
        """A setting of this tmux."""
        self._tell("set-option", "-g", name, value)

    def buffer(self) -> str:
        """What was copied last into this tmux."""
        return self._tell("show-buffer")

    def line_with(self, text: str) -> str:
        """The first line of the screen that has `text`, blanks as in `wait_for`; empty = none."""
        rows = (" ".join(row.split()) for row in self.screen())
        return next((row for row in rows if text in row), "")

    def wait_for(
        self,
        text: str,
        timeout: float = PATIENCE,
        *,
        instead: str | None = None,
        before: str = "",
    ) -> str:
        """Wait until `text` stands on the screen, within one line; the line.

        Several blanks count as one, so that columns may move. What may come `instead` of the text
        ends the waiting, too, unless it is the line that stood there `before`.

        Raises:
            AssertionError: it does not come within `timeout` s, or the program ends.
        """

        def look(screen: list[str]) -> str | None:
            for line in (" ".join(row.split()) for row in screen):
                if text in line or (instead is not None and instead in line and line != before):
                    return line
            return None

        return self.find(look, repr(text), timeout)

    def close(self) -> None:
        """End the server and everything in it."""
        self._run("kill-server")
        end = time.monotonic() + LEAVING
        while self._group:
            try:
                # the program got a hang-up and may need a moment to leave
                os.killpg(self._group, 0 if time.monotonic() < end else signal.SIGKILL)
            except ProcessLookupError:
                break
            time.sleep(BETWEEN_LOOKS)
        self._folder.cleanup()

    def exit_code(self) -> int | None:
        """None while the program runs; 128 + number after a signal."""
        written = self._code.read_text() if self._code.exists() else ""
        return int(written) if written.endswith("\n") else None

    def _tell(self, *command: str) -> str:
        """What tmux answers.

        Raises:
            AssertionError: it refuses.
        """
        done = self._run(*command)
        assert done.returncode == 0, f"tmux {shlex.join(command)}: {done.stderr.strip()}"
        return done.stdout

    def _run(self, *command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["tmux", "-u", "-L", "madrob", "-f", "/dev/null", *command],
            env=self._env,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=ANSWERING,
            check=False,
        )
