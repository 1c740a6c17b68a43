"""`madrob console` in a terminal of its own, with the engine process behind it."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from subprocess import CompletedProcess
from types import TracebackType
from typing import Any, Self

import msgspec

from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change
from tests.madrob_console.engine_process import NO_REPORTS, ROOT, STARTING, start_madrob
from tests.terminal import Terminal
from tests.watching import Stutter, until

ENTER = "\r"
F5, F6, F7, F8, F10 = "\x1b[15~", "\x1b[17~", "\x1b[18~", "\x1b[19~", "\x1b[21~"


class Hall:
    """A results folder, a place for sockets, and the programs that a test runs there.

    Args:
        speed: of the simulated testbed.
        results: the results folder; None = beside the sockets.
    """

    def __init__(self, speed: float = 4.0, results: Path | None = None) -> None:
        # a socket's path has 107 characters at most: pytest's folders are longer
        self.folder = Path(tempfile.mkdtemp(prefix="madrob-"))
        self.results = results or self.folder / "runs"
        self.speed = speed
        self.scenario = "nominal"
        self.stutter = Stutter()
        self._settings = self.folder / "madrob.toml"
        self._settings.write_text(f"{NO_REPORTS}[checks]\ndisk_space = 0\n")
        self._env = {"XDG_STATE_HOME": str(self.folder), "PYTHONPATH": str(ROOT)}

    def __enter__(self) -> Self:
        self.stutter.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stutter.__exit__(kind, error, traceback)
        self.madrob("engine", "stop", "--force", f"--results={self.results}")
        shutil.rmtree(self.folder, ignore_errors=True)  # a process that was killed may still write

    @property
    def testbed(self) -> list[str]:
        """The options that name the testbed."""
        simulated = ["--testbed", "simulated", f"--scenario={self.scenario}"]
        own = [f"--results={self.results}", f"--settings={self._settings}"]
        return [*simulated, f"--speed={self.speed}", *own]

    def console(
        self, command: str = "console", *options: str, columns: int = 80, lines: int = 24
    ) -> Terminal:
        """The screens, attached to the engine or starting it."""
        argv = [sys.executable, "-m", "madrob_console.cli.main", command, *self.testbed, *options]
        return Terminal(argv, columns, lines, env=self._env, cwd=ROOT)

    def madrob(self, *arguments: str) -> CompletedProcess[str]:
        """A command, run to its end; what it complains of is among what it says."""
        with start_madrob(*arguments, environment=self._env) as process:
            said = process.communicate(timeout=120)[0]
        return CompletedProcess(process.args, process.returncode, said)

    def engine_pid(self) -> int:
        """The process of the one engine."""
        (line,) = self.status()
        return int(line.partition("pid ")[2].partition(",")[0])

    def status(self) -> list[str]:
        """What `madrob engine status` says of the engines of this hall: others may run, too."""
        listed = self.madrob("engine", "status").stdout.splitlines()
        return [line for line in listed if line.endswith(f"runs in {self.results}")]

    def kill_engine(self) -> int:
        """As a machine that fails: kill -9; when, ns since the epoch."""
        pid = self.engine_pid()
        os.kill(pid, signal.SIGKILL)
        killed = time.time_ns()
        wait_gone(pid)
        return killed

    def run_folders(self) -> list[Path]:
        """The runs on disk, oldest first."""
        return sorted(self.results.glob("practice/subject_*"))

    def wait_for_result(self, folder: Path, timeout: float = STARTING) -> dict[str, Any]:
        """The content of a run's `result.json`, once it is there."""
        path = folder / "result.json"
        until(path.exists, timeout)
        document: dict[str, Any] = msgspec.json.decode(path.read_bytes())
        return document

    def journal(self, folder: Path) -> tuple[Entry, ...]:
        """What was said and done in a run; nothing before it has a journal."""
        path = folder / "journal.jsonl"
        return read_journal(path)[0] if path.exists() else ()

    def wait_for_running(self) -> Path:
        """The folder of the run that goes on."""

        def running() -> list[Path]:
            return [
                folder
                for folder in self.run_folders()
                if any(line.what == Change.RUN_STARTS for line in self.journal(folder))
                and not (folder / "result.json").exists()
            ]

        return until(running, STARTING)[0]


READING = 1.0
"""A person takes so long to read why a key was left out, s: what is typed sooner goes with it."""


def make_ready(terminal: Terminal) -> None:
    """From the first screen, or the result of a run, to all that a start needs, by keys."""
    ready, done = "2 of 9 checks fail", "is set up"
    ended = "not final. Enter", "x is the next run"
    if terminal.wait_for(ready, *ended, timeout=STARTING) in ended:
        terminal.send("x")
        if terminal.wait_for(done, "is left out: ", timeout=STARTING) != done:
            time.sleep(READING)
            terminal.send("x")
    else:
        terminal.send(ENTER)
    terminal.wait_for(done, timeout=STARTING)
    if terminal.wait_for(ready, "1 of 9 checks fail", timeout=STARTING) == ready:
        terminal.send(F7)
        terminal.wait_for("Done: handle zeroed", timeout=STARTING)
    terminal.send(F6)
    terminal.wait_for("all passed or waived", timeout=STARTING)


def start_a_run(terminal: Terminal) -> None:
    """From there to a countdown."""
    make_ready(terminal)
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
