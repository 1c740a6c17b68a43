"""`madrob console` in a terminal of its own, with the engine process behind it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change
from tests.terminal import Terminal
from tests.watching import until

ROOT = Path(__file__).parents[2]
ENTER = "\r"
F3, F5, F6, F7, F8, F10 = "\x1bOR", "\x1b[15~", "\x1b[17~", "\x1b[18~", "\x1b[19~", "\x1b[21~"
STARTING = 60.0


class Hall:
    """A results folder, a place for sockets, and the programs that a test runs there.

    Args:
        speed: of the simulated testbed.
    """

    def __init__(self, speed: float = 4.0) -> None:
        # a socket's path has 107 characters at most: pytest's folders are longer
        self.folder = Path(tempfile.mkdtemp(prefix="madrob-"))
        self.results = self.folder / "runs"
        self.speed = speed
        self._settings = self.folder / "madrob.toml"
        self._settings.write_text("[results]\nreports = false\n")  # they have tests of their own
        self._env = {"XDG_STATE_HOME": str(self.folder), "PYTHONPATH": str(ROOT)}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.madrob("engine", "stop", "--force", f"--results={self.results}")
        shutil.rmtree(self.folder, ignore_errors=True)  # a process that was killed may still write

    @property
    def testbed(self) -> list[str]:
        """The options that name the testbed."""
        speed, results = f"--speed={self.speed}", f"--results={self.results}"
        return ["--testbed", "simulated", speed, results, f"--settings={self._settings}"]

    def console(
        self, command: str = "console", *options: str, columns: int = 80, lines: int = 24
    ) -> Terminal:
        """The screens, attached to the engine or starting it."""
        argv = [sys.executable, "-m", "madrob_console.cli.main", command, *self.testbed, *options]
        return Terminal(argv, columns, lines, env=self._env, cwd=ROOT)

    def madrob(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """A command, run to its end."""
        argv = [sys.executable, "-m", "madrob_console.cli.main", *arguments]
        env = {**os.environ, **self._env}
        return subprocess.run(
            argv, env=env, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
        )

    def engine_pid(self) -> int:
        """The process of the one engine."""
        (line,) = self.status()
        return int(line.partition("pid ")[2].partition(",")[0])

    def status(self) -> list[str]:
        """What `madrob engine status` says of the engines of this hall: others may run, too."""
        listed = self.madrob("engine", "status").stdout.splitlines()
        return [line for line in listed if line.endswith(f"runs in {self.results}")]

    def kill_engine(self) -> None:
        """As a machine that fails: kill -9."""
        pid = self.engine_pid()
        os.kill(pid, signal.SIGKILL)
        wait_gone(pid)

    def run_folders(self) -> list[Path]:
        """The runs on disk, oldest first."""
        return sorted(self.results.glob("practice/subject_*"))

    def wait_for_result(self, folder: Path, timeout: float = 60.0) -> dict[str, Any]:
        """The content of a run's `result.json`, once it is there."""
        path = folder / "result.json"
        until(path.exists, timeout)
        document: dict[str, Any] = msgspec.json.decode(path.read_bytes())
        return document

    def journal(self, folder: Path) -> tuple[Entry, ...]:
        """What was said and done in a run."""
        return read_journal(folder / "journal.jsonl")[0]

    def wait_for_running(self, timeout: float = 60.0) -> Path:
        """The folder of the run that goes on."""

        def running() -> Path | None:
            for folder in self.run_folders():
                known = (folder / "journal.jsonl").exists()
                lines = self.journal(folder) if known else ()
                started = any(line.what == Change.RUN_STARTS for line in lines)
                if started and not (folder / "result.json").exists():
                    return folder
            return None

        folder = until(running, timeout)
        assert folder is not None
        return folder


READING = 1.0
"""A person takes so long to read why a key was left out, s: what is typed sooner goes with it."""


def start_a_run(terminal: Terminal) -> None:
    """From the first screen to a countdown, by keys; again from the result of a run."""
    ready, result, done = "2 of 9 in the way", "not final: Enter", "is set up"
    if terminal.wait_for(ready, result, timeout=STARTING) == result:
        terminal.send("x")
        if terminal.wait_for(done, "is left out: ", timeout=STARTING) != done:
            time.sleep(READING)
            terminal.send("x")
    else:
        terminal.send(ENTER)
    terminal.wait_for(done, timeout=STARTING)
    terminal.send(F7)
    terminal.wait_for("Done: zero the handle", timeout=STARTING)
    terminal.send(F6)
    terminal.wait_for("all passed or waived", timeout=STARTING)
    terminal.send(F5)
    terminal.wait_for("COUNTDOWN", timeout=STARTING)


def wait_gone(pid: int) -> None:
    """Until a process that is no child has gone."""

    def gone() -> bool:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return True
        return stat.rpartition(")")[2].split()[0] == "Z"

    until(gone)
