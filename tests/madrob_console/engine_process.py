"""`madrob` as a process of its own; an engine among them, with a client that acts as the referee.

With `clock` the process sees a wall clock of its own (Debian's faketime); the machine's is not
touched.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import msgspec

from madrob_console.engine.ipc.client import NotYetError, RemoteEngine
from madrob_console.engine.ipc.discovery import running_engines
from madrob_console.engine.requests import Perform, Role
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.acts import Act, ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.checks import blocking
from madrob_console.referee.records import CheckName, RunSetup
from madrob_console.referee.run import Phase
from tests.watching import Stutter, until

ROOT = Path(__file__).parents[2]
STARTING = 60.0
ZERO_NEEDS = 1.1  # s: the handle's zero is the mean of a second
BY_HAND = (CheckName.HANDLE, CheckName.POSE)
LATE = 0.02  # s; a machine that has a processor free wakes a thread sooner
NO_REPORTS = "[results]\nreports = false\n"
"""Settings: another process makes reports, from what is there; they have tests of their own."""

_MAIN = "import sys; from madrob_console.cli.main import main; sys.exit(main())"
# libfaketime 0.9.10 breaks `time.sleep`, which sleeps until a time that it does not know.
_SLEEP_WITHOUT_CLOCK = """
import select, time
time.sleep = lambda duration: select.select([], [], [], duration) and None
"""


def remarks_of(result: Mapping[str, Any], stutter: Stutter) -> list[str]:
    """What a result remarks on its data, but for what a late machine alone brings."""
    if stutter.worst <= LATE:
        return [*result["quality"]["remarks"]]
    # an engine that gets no processor is behind, as its simulation is silent, and has to say so
    return [
        one
        for one in result["quality"]["remarks"]
        if not any(words in one for words in (" behind: ", " silent for ", " stood still for "))
    ]


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


class WallClock:
    """The wall clock of a process, to be stepped while it runs; needs faketime.

    Monotonic time goes on as it is.

    Args:
        folder: for the file that the process reads it from.
    """

    def __init__(self, folder: Path) -> None:
        library = min(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"))
        self._file = folder / "wall_clock"
        self.step(0)
        self.environment = {
            "LD_PRELOAD": str(library),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_CACHE_DURATION": "1",  # s; to look each time takes longer than the engine has
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "NO_FAKE_STAT": "1",
        }

    def step(self, offset: int) -> None:
        """Let it be `offset` s ahead of the machine's."""
        part = self._file.with_suffix(".part")
        part.write_text(f"{offset:+d}s\n")
        part.replace(self._file)


class EngineProcess:
    """One engine, one referee.

    Args:
        results: the results folder.
        scenario: of the simulated testbed; None = the live one of `ROS_DOMAIN_ID`.
        clock: the process's wall clock; None = the machine's.
        speed: of the simulated testbed.
        environment: of its own.
        settings: what its settings file says besides.
    """

    def __init__(
        self,
        results: Path,
        scenario: str | None,
        clock: WallClock | None = None,
        *,
        speed: float = 1.0,
        environment: Mapping[str, str] = MappingProxyType({}),
        settings: str = "",
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
        own = {**environment, **({} if clock is None else clock.environment)}
        before = "" if clock is None else _SLEEP_WITHOUT_CLOCK
        self.process = start_madrob(*arguments, output=self.log, before=before, environment=own)
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
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

    def start(self, setup: RunSetup) -> None:
        """From the set-up to the running phase."""
        self.act(SetUp(setup))
        self.wait_for(lambda s: all(c.name in BY_HAND for c in blocking(s.checks)))
        fresh = self.snapshot().time
        self.wait_for(lambda s: s.time > fresh + ZERO_NEEDS)
        # on a busy machine the force may be old for a moment: a referee presses again
        self.wait_for(lambda _: self.client.send_request(Perform.of(ZeroHandle())) is None)
        self.act(ConfirmPose())
        self.wait_for(lambda s: not blocking(s.checks))
        self.act(Start())
        self.wait_for(lambda s: s.run.phase is Phase.RUNNING)

    def result(self, timeout: float = STARTING) -> dict[str, Any]:
        """The content of `result.json`, once it is there."""
        self.wait_for(lambda s: s.result is not None, timeout)
        document: dict[str, Any] = msgspec.json.decode((self.folder / "result.json").read_bytes())
        return document

    @property
    def folder(self) -> Path:
        """Of the run at hand."""
        folder = self.snapshot().folder
        assert folder is not None
        return Path(folder)
