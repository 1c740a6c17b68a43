"""`madrob` as a process of its own: an engine with a client as the referee, or consoles."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import CompletedProcess
from types import MappingProxyType
from typing import Any

import msgspec

from madrob_console.engine.ipc.client import NotYetError, RemoteEngine
from madrob_console.engine.ipc.discovery import running_engines
from madrob_console.engine.requests import Perform, Role
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.acts import Act, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from tests.terminal import Terminal
from tests.watching import PATIENCE, Closing, until, wait_gone

ROOT = Path(__file__).parents[2]
MADROB = [sys.executable, "-m", "madrob_console.cli.main"]
STARTING = 60.0
ZERO_NEEDS = 1.1  # s: the handle's zero is the mean of a second
BY_HAND = (CheckName.HANDLE, CheckName.POSE)
NO_REPORTS = "[results]\nreports = false\n"
"""Settings: another process makes reports, from what is there; they have tests of their own."""

_MAIN = "import sys; from madrob_console.cli.main import main; sys.exit(main())"


def start_madrob(
    *arguments: object,
    output: Path | None = None,
    before: str = "",
    environment: Mapping[str, str] = MappingProxyType({}),
) -> subprocess.Popen[str]:
    """Start `madrob` of this tree.

    Args:
        arguments: after `madrob`.
        output: gets what it says; None = the test reads it.
        before: Python code that its process runs first.
        environment: added to that of this process.
    """
    file = None if output is None else output.open("wb")
    try:
        return subprocess.Popen(
            [sys.executable, "-c", before + _MAIN, *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
            cwd=ROOT,
            text=True,
            stdout=file or subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # it can be killed with all that it started
        )
    finally:
        if file is not None:
            file.close()


@contextmanager
def madrob_beside(
    *arguments: object, output: Path | None = None, before: str = ""
) -> Iterator[subprocess.Popen[str]]:
    """`madrob` of this tree while inside, as `start_madrob` starts it."""
    with start_madrob(*arguments, output=output, before=before) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


class EngineProcess(Closing):
    """One engine, one referee.

    Args:
        results: the results folder.
        scenario: of the simulated testbed; None = the live one of `ROS_DOMAIN_ID`.
        speed: of the simulated testbed.
        environment: of its own.
        settings: what its settings file says besides.
        before: as for `start_madrob`.
    """

    def __init__(
        self,
        results: Path,
        scenario: str | None,
        *,
        speed: float = 1.0,
        environment: Mapping[str, str] = MappingProxyType({}),
        settings: str = "",
        before: str = "",
    ) -> None:
        self._own = tempfile.TemporaryDirectory(prefix="madrob-")
        self.results = results
        self.log = Path(self._own.name) / "engine.log"
        file = Path(self._own.name) / "settings.toml"
        file.write_text(f"[checks]\ndisk_space = 0\n{settings}")
        testbed = ["--testbed", "simulated", f"--scenario={scenario}", f"--speed={speed:g}"]
        if scenario is None:
            testbed = ["--testbed", "ros"]
        arguments = ["engine", "serve", *testbed, f"--results={results}", f"--settings={file}"]
        self.process = start_madrob(
            *arguments, output=self.log, before=before, environment=environment
        )
        attached: list[RemoteEngine] = []

        def attach() -> bool:
            assert self.process.poll() is None, self.log.read_text()
            with suppress(OSError, StopIteration, NotYetError):
                attached.append(RemoteEngine(self.stem, Role.REFEREE, "a test"))
            return bool(attached)

        try:
            until(attach, STARTING)
        except BaseException:
            self._kill()
            raise
        (self.client,) = attached

    @property
    def stem(self) -> str:
        """By which it is found."""
        return next(one.stem for one in running_engines() if one.pid == self.process.pid)

    def close(self) -> None:
        """End it, by force where it does not."""
        with suppress(AssertionError):
            self.end()
        self._kill()

    def end(self, patience: float = STARTING) -> None:
        """Let it end as `systemctl stop` would, and wait; what it said stays in `log`.

        Args:
            patience: it may write for so long what is still to be written, s.

        Raises:
            AssertionError: it has not ended by then.
        """
        self.client.close()
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"did not end within {patience:g} s of SIGTERM") from None

    def _kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._own.cleanup()

    def snapshot(self) -> Snapshot:
        """What a screen would show now."""
        return self.client.snapshot()

    def wait_for(self, done: Callable[[Snapshot], bool], timeout: float = STARTING) -> Snapshot:
        """The first snapshot of which `done` holds."""

        snapshot = self.snapshot()

        def seen() -> bool:
            nonlocal snapshot
            snapshot = self.snapshot()
            return done(snapshot)

        try:
            until(seen, timeout)
        except AssertionError as error:
            raise AssertionError(f"{error}: {snapshot.log} {snapshot.all_faults}") from None
        return snapshot

    def act(self, *acts: Act) -> None:
        """Acts that are possible."""
        for act in acts:
            refused = self.client.send_request(Perform.of(act))
            assert refused is None, refused

    def start(self, setup: RunSetup, waived: Collection[CheckName] = ()) -> None:
        """From the set-up to the running phase; what then fails of `waived` is waived."""
        self.act(SetUp(setup))
        mendable = {*BY_HAND, *waived}
        self.wait_for(lambda s: mendable.issuperset(c.name for c in blocking(s.checks)))
        fresh = self.snapshot().time
        self.wait_for(lambda s: s.time > fresh + ZERO_NEEDS)
        now = self.snapshot()
        if "SIMULATED" in now.label and now.run.setup is not None and not now.run.setup.practice:
            self.act(SetUp(setup))  # that it is simulated was heard only now
        # on a busy machine the force may be old for a moment: a referee presses again
        self.wait_for(lambda _: self.client.send_request(Perform.of(ZeroHandle())) is None)
        self.act(ConfirmPose())
        for name in waived:  # it may pass by now
            self.client.send_request(Perform.of(Waive(name, "a proof")))
        self.wait_for(lambda s: not blocking(s.checks))
        self.act(Start())
        self.wait_for(lambda s: s.run.phase is Phase.RUNNING)

    def result(self, timeout: float = STARTING) -> dict[str, Any]:
        """The content of `result.json`, once it is there."""
        self.wait_for(lambda s: s.result is not None, timeout)
        return result_of(self.folder)

    @property
    def folder(self) -> Path:
        """Of the run at hand."""
        folder = self.snapshot().folder
        assert folder is not None
        return Path(folder)


def result_of(folder: Path, timeout: float = 0.0) -> dict[str, Any]:
    """The content of a run's `result.json`, once it is there."""
    path = folder / "result.json"
    until(path.exists, timeout)
    document: dict[str, Any] = msgspec.json.decode(path.read_bytes())
    return document


def journal_of(folder: Path) -> tuple[Entry, ...]:
    """What was said and done in a run; nothing before it has a journal."""
    path = folder / "journal.jsonl"
    return read_journal(path)[0] if path.exists() else ()


READING = 1.0
"""A person takes so long to read why a key was left out, s: what is typed sooner goes with it."""

_AGAIN = (" is left out: ", "Refused: ")


class Console(Terminal):
    """The screens, and what a referee does before them."""

    def answer(self, key: str, *texts: str, later: tuple[str, ...] = ()) -> None:
        """Press a key until all of `texts` are on the screen, or what comes `later`.

        A key that comes before a person could have read what is new is left out, and on a busy
        machine the testbed is silent for a moment: both are said, and who reads it presses again.
        """
        first, *others = texts
        for _ in range(5):
            before = self._refusals()
            self.press(key)

            def said(before: set[str] = before) -> str:
                return self.shows(first, *later) or "".join(self._refusals() - before)

            if self.wait_until(said, repr(first), STARTING) in (first, *later):
                break
            time.sleep(READING)
        else:
            raise AssertionError(f"{key} was refused again and again:\n{self.screen()}")
        for text in others:
            self.wait_for(text, timeout=STARTING)

    def _refusals(self) -> set[str]:
        return {row for row in self.screen() if any(word in row for word in _AGAIN)}

    def make_ready(self) -> None:
        """From the first screen, or the result of a run, to all that a start needs."""
        ready, done = "2 of 9 checks fail", "is set up"
        first = self.wait_for(ready, "not final. Enter", "x is the next run", timeout=STARTING)
        self.answer("Enter" if first == ready else "x", done)
        if self.wait_for(ready, "1 of 9 checks fail", timeout=STARTING) == ready:
            self.answer("F7", "Done: handle zeroed")
        self.answer("F6", "all passed or waived")

    def start_a_run(self) -> None:
        """From there to a countdown, which a busy machine may not draw."""
        self.make_ready()
        self.answer("F5", "COUNTDOWN", later=("RUNNING", "COMPLETED"))


class Hall(Closing):
    """A results folder, a place for sockets, and the programs that a test runs there.

    Args:
        speed: of the simulated testbed.
        results: the results folder; None = beside the sockets.
        settings: what its settings file says.
    """

    def __init__(
        self,
        speed: float = 4.0,
        results: Path | None = None,
        settings: str = f"{NO_REPORTS}[checks]\ndisk_space = 0\n",
    ) -> None:
        # a socket's path has 107 characters at most: pytest's folders are longer
        self.folder = Path(tempfile.mkdtemp(prefix="madrob-"))
        self.results = results or self.folder / "runs"
        self.speed, self.scenario = speed, "nominal"
        self.environment = {"XDG_STATE_HOME": str(self.folder), "PYTHONPATH": str(ROOT)}
        self._settings = self.folder / "madrob.toml"
        self._settings.write_text(settings)

    def close(self) -> None:
        """End its engine."""
        self.madrob("engine", "stop", "--force", f"--results={self.results}")
        shutil.rmtree(self.folder, ignore_errors=True)  # a process that was killed may still write

    def command(self, command: str = "console", *options: str) -> list[str]:
        """What starts the screens, attached to the engine or starting it."""
        simulated = ["--testbed=simulated", f"--scenario={self.scenario}", f"--speed={self.speed}"]
        own = [f"--results={self.results}", f"--settings={self._settings}"]
        return [*MADROB, command, *simulated, *own, *options]

    def console(
        self, command: str = "console", *options: str, columns: int = 80, lines: int = 24
    ) -> Console:
        """The screens in a terminal."""
        argv = self.command(command, *options)
        return Console(argv, columns, lines, env=self.environment, cwd=ROOT)

    def madrob(self, *arguments: str) -> CompletedProcess[str]:
        """A command, run to its end; what it complains of is among what it says."""
        with start_madrob(*arguments, environment=self.environment) as process:
            said = process.communicate(timeout=120)[0]
        return CompletedProcess(process.args, process.returncode, said)

    def status(self) -> list[str]:
        """What `madrob engine status` says of the engines of this hall: others may run, too."""
        listed = self.madrob("engine", "status").stdout.splitlines()
        return [line for line in listed if line.endswith(f"runs in {self.results}")]

    def kill_engine(self) -> int:
        """As a machine that fails: kill -9; when, ns since the epoch."""
        (line,) = self.status()
        pid = int(line.partition("pid ")[2].partition(",")[0])
        os.kill(pid, signal.SIGKILL)
        killed = time.time_ns()
        wait_gone(pid)
        return killed

    def wait_for_running(self) -> Path:
        """The folder of the newest run, once it goes on."""
        folder = max(self.results.glob("practice/subject_*"))
        until(lambda: any(line.what == Change.RUN_STARTS for line in journal_of(folder)), STARTING)
        return folder
