"""The hands of the stories: one function an act.

This file alone knows keys, options of commands and names of files in a run.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import Any, Self

from tests.stories.terminal import PATIENCE, Terminal, wait_until

MADROB = str(Path(sys.executable).with_name("madrob"))
_PRACTICE = "practice"
_RUN_FOLDERS = "subject_*"
_HALLS = count()
_READING = 0.5  # s that a person takes to read why a key was left out
_LEFT_OUT = (" is left out: ", "Refused: ")
_DEFAULTS: Mapping[str, Mapping[str, object]] = {
    "competition": {"name": "Euro Door Cup", "referee": "R. Eferee"},
    "run": {"countdown": 1.0},
    "checks": {"disk_space": 0},
    "results": {"reports": False},
}
_NOT_INHERITED = (
    "COLORTERM",
    "COLUMNS",
    "LINES",
    "NO_COLOR",
    "TMUX",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)


def _own_domain() -> int:
    """A ROS domain that no other worker of this session has."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return 1 + (33 * worker + next(_HALLS)) % 100


@dataclass(frozen=True)
class Done:
    """A command that has run to its end, with all that it printed."""

    code: int
    output: str
    errors: str


class Hall:
    """One machine of a competition: a home, settings, results, and the programs that run there.

    Args:
        folder: an empty folder for all of it.
    """

    def __init__(self, folder: Path) -> None:
        self.home = folder
        self.results = folder / "madrob_runs"
        # The path of a socket is short, and the folders of pytest are long.
        self.state = Path(tempfile.mkdtemp(prefix="madrob-"))
        self.settings_file = folder / ".config" / "madrob" / "madrob.toml"
        self.domain = _own_domain()
        inherited = {k: v for k, v in os.environ.items() if k not in _NOT_INHERITED}
        self.environment = inherited | {
            "HOME": str(folder),
            "XDG_CONFIG_HOME": str(folder / ".config"),
            "XDG_STATE_HOME": str(self.state),
            "XDG_CACHE_HOME": str(folder / ".cache"),
            "XDG_DATA_HOME": str(folder / ".local"),
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "LC_ALL": "C.UTF-8",
            "TERM": "xterm-256color",
            "TEXTUAL_ANIMATIONS": "none",
        }
        self._programs: list[subprocess.Popen[bytes]] = []
        self._terminals: list[Terminal] = []
        self.set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End everything that was started here, whatever state it is in."""
        for terminal in self._terminals:
            terminal.close()
        wait_until(self._kill_all, "the end of all programs of this hall")
        for program in self._programs:
            program.wait()
        shutil.rmtree(self.state, ignore_errors=True)

    # --- settings, teams, plan

    def set(self, more: str = "", **tables: Mapping[str, object]) -> None:
        """Write the settings: what stories need, over it these tables, then this TOML text."""
        lines: list[str] = []
        for name in {**_DEFAULTS, **tables}:
            values = {**_DEFAULTS.get(name, {}), **tables.get(name, {})}
            lines += [f"[{name}]", *(f"{key} = {json.dumps(v)}" for key, v in values.items())]
        self.settings_file.parent.mkdir(parents=True, exist_ok=True)
        self.settings_file.write_text("\n".join([*lines, more]), encoding="utf-8")

    def write_teams(self, teams: Mapping[int, str]) -> Path:
        """Write a list of teams; the setting `competition.teams_file` has to name it."""
        file = self.home / "teams.csv"
        rows = [f"{subject},{team}" for subject, team in teams.items()]
        file.write_text("\n".join(["subject,team", *rows, ""]), encoding="utf-8")
        return file

    # --- programs

    def madrob(self, *arguments: object, timeout: float = PATIENCE) -> Done:
        """Run a command of `madrob` to its end."""
        argv = [MADROB, *map(str, arguments)]
        done = subprocess.run(
            argv,
            env=self.environment,
            cwd=self.home,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=timeout,
            check=False,
        )
        return Done(done.returncode, done.stdout.decode(), done.stderr.decode())

    def begin(self, *arguments: object, output: Path | None = None) -> subprocess.Popen[bytes]:
        """Start a command of `madrob` in the background; what it prints goes into a file."""
        with (output or self.home / "output.txt").open("wb") as file:
            program = subprocess.Popen(
                [MADROB, *map(str, arguments)],
                env=self.environment,
                cwd=self.home,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._programs.append(program)
        return program

    def console(
        self,
        *options: str,
        command: str = "console",
        scenario: str = "nominal",
        speed: float = 4.0,
        columns: int = 120,
        lines: int = 40,
    ) -> Console:
        """Open the referee's screens on a simulated testbed, as a person at a terminal does."""
        argv = [MADROB, command, "--testbed", "simulated", "--scenario", scenario]
        argv += ["--speed", str(speed), *options]
        console = Console(argv, self.environment, columns, lines)
        self._terminals.append(console)
        return console

    def engines(self) -> list[int]:
        """The processes of the engines of this hall."""
        words = self.madrob("engine", "status").output.replace(",", " ").split()
        return [int(pid) for word, pid in pairwise(words) if word == "pid"]

    def kill_engine(self) -> None:
        """End the engine as kill -9 does."""
        (pid,) = wait_until(self.engines, "an engine")
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: pid not in self.pids(), "the end of the engine")

    def pids(self) -> dict[int, str]:
        """The command lines of all processes that were started here, also by others."""
        mark = f"XDG_STATE_HOME={self.state}\0".encode()
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if mark in (folder / "environ").read_bytes():
                    words = (folder / "cmdline").read_text(errors="replace").replace("\0", " ")
                    found[int(folder.name)] = words
        return found

    def _kill_all(self) -> bool:
        left = self.pids()
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for program in self._programs:
            program.poll()
        return not left

    # --- runs and their files

    def runs(self, *, rehearsal: bool = False) -> list[Run]:
        """All runs, official ones, practice and those of the rehearsal, the oldest first."""
        results = self.results.with_name("madrob_runs_rehearsal") if rehearsal else self.results
        folders = [*results.glob(_RUN_FOLDERS), *results.glob(f"{_PRACTICE}/{_RUN_FOLDERS}")]
        return [Run(folder) for folder in sorted(folders, key=lambda each: each.stat().st_ctime)]

    def run(self, *, rehearsal: bool = False) -> Run:
        """The only run there is, once it is there."""
        (run,) = wait_until(lambda: self.runs(rehearsal=rehearsal), "a run")
        return run


@dataclass(frozen=True)
class Run:
    """A folder with one run."""

    folder: Path

    @property
    def bag(self) -> Path:
        """The recording."""
        return self.folder / f"{self.folder.name}_0.mcap"

    def has_result(self) -> bool:
        return (self.folder / "result.json").exists()

    def result(self, timeout: float = PATIENCE) -> dict[str, Any]:
        """The result as it is on the disk, once it is there."""
        wait_until(self.has_result, f"a result of {self.folder.name}", timeout)
        content: dict[str, Any] = json.loads((self.folder / "result.json").read_bytes())
        return content

    def outcome(self) -> str:
        return str(self.result()["outcome"])

    def level(self) -> int:
        """The capability level."""
        return int(self.result()["indicators"]["capability_level"]["value"])

    def journal(self) -> list[dict[str, Any]]:
        """What was done and what happened, in order; a line that is being written is left out."""
        file = self.folder / "journal.jsonl"
        lines = file.read_bytes().split(b"\n")[:-1] if file.exists() else []
        return [json.loads(line) for line in lines]


class Console(Terminal):
    """The screens of a referee in a terminal, and what a referee does there."""

    def do(self, keys: str, *words: str) -> None:
        """Press a key until these words stand on the screen.

        A key that comes before a person could have read what is new is left out. The screen says
        so, and a person presses it again.
        """
        for _ in range(10):
            said = self._left_out()
            self.press(keys)
            wait_until(lambda s=said: self.shows(*words) or self._left_out() - s, f"{words}")  # type: ignore[misc]
            if self.shows(*words):
                return
            time.sleep(_READING)
        raise AssertionError("\n".join([f"{keys} was left out again and again", *self.lines()]))

    def _left_out(self) -> set[str]:
        """The lines that say that a key was not taken."""
        return {line for line in self.lines() for words in _LEFT_OUT if words in line}

    # --- before a run

    def set_up(self, subject: int | None = None) -> None:
        """Set up a run: of this subject, or the one that the form proposes."""
        self.wait_for(" checks fail")
        if subject is not None:
            self.do("F2", "Set up this run")
            self.send(str(subject))
            self.wait_for(f"Subject {subject}")
        self.do("Enter", "is set up")

    def zero(self) -> None:
        self.do("F7", "handle zeroed")

    def confirm_pose(self) -> None:
        self.do("F6", "all passed or waived")

    def start(self) -> None:
        """Start, and wait until the robot may move."""
        self.do("F5", "REC")

    def open_run(self) -> None:
        """From the first screen to a run that goes on."""
        self.set_up()
        self.zero()
        self.confirm_pose()
        self.start()

    # --- in a run

    def abort(self) -> None:
        self.press("F8")
        self.wait_for("ABORT")
        self.press("y")
        self.wait_for("ABORTED")

    # --- after a run

    def sign(self) -> None:
        """Sign the result. The team acknowledges it."""
        self.do("Enter", "What do you want to do")
        self.do("f", "Sign the result")
        self.do("a", "Note")
        self.do("Enter", "signed by")

    def leave(self) -> int:
        """Leave while no run goes on; the exit code."""
        self.press("F10")
        return self.wait_exit()
