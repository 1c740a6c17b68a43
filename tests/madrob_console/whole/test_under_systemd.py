"""A real engine as systemd would run it: what it tells, what it logs, what its unit says."""

from __future__ import annotations

import os
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from madrob_console.cli.main import main
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import ROOT, STARTING, EngineProcess
from tests.madrob_console.small_disk import disk_image
from tests.watching import until

WATCHDOG = 4.0
"""s; the service manager of a competition waits longer."""

FROZEN = 6.0
"""A disk does not answer for so long, s: longer than the watchdog waits."""

HANGS_ON_REQUEST = """
import os, sys, time
from madrob_console.engine.core import Engine
step, asked = Engine.step, sys.argv.pop(1)

def hanging(self, *arguments):
    while os.path.exists(asked):
        time.sleep(0.05)
    return step(self, *arguments)

Engine.step = hanging
from madrob_console.cli.main import main
sys.exit(main())
"""
"""An engine whose core hangs while a file is there."""


class Manager:
    """What a service manager hears of one service.

    Attributes:
        environment: of the service.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="madrob-")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(Path(self._folder.name) / "notify"))
        self._socket.setblocking(False)
        self._told: list[tuple[float, str]] = []
        self.environment = {
            "NOTIFY_SOCKET": str(self._socket.getsockname()),
            "WATCHDOG_USEC": str(round(WATCHDOG * 1e6)),
        }

    def close(self) -> None:
        self._socket.close()
        self._folder.cleanup()

    def hears(self, words: str, since: float = 0.0) -> bool:
        """Whether the engine has told this since a moment."""
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                break
            self._told += [(time.monotonic(), line) for line in data.decode().split("\n")]
        return any(at > since and words in line for at, line in self._told)

    def longest_silence(self, duration: float) -> float:
        """Of the watchdog's signs of life, s."""
        longest, last = 0.0, time.monotonic()
        end = last + duration

        def over() -> bool:
            nonlocal longest, last
            if self.hears("WATCHDOG=1", last):
                last = time.monotonic()
            longest = max(longest, time.monotonic() - last)
            return time.monotonic() > end

        until(over, duration + STARTING)
        return longest


class Service:
    """An engine that a service manager started: this test.

    Args:
        command: what `ExecStart` says.

    Attributes:
        manager: hears of it.
        journal: its log.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="madrob-")
        self.state = Path(self._folder.name) / "state"
        self.manager = Manager()
        self.journal = Path(self._folder.name) / "journal"
        with self.journal.open("wb") as journal:
            found = os.fstat(journal.fileno())
            own = {
                "XDG_STATE_HOME": str(self.state),
                "JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}",
                "PYTHONPATH": str(ROOT),
            }
            self.environment = {**os.environ, **self.manager.environment, **own}
            self.process = subprocess.Popen(
                command, env=self.environment, stdout=journal, stderr=journal, cwd=ROOT
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.process.kill()
        self.process.wait()
        self.manager.close()
        self._folder.cleanup()

    def wait_for(self, assignment: str, since: float = 0.0, patience: float = STARTING) -> None:
        def heard() -> bool:
            alive = self.process.poll() is None
            assert alive or self.manager.hears(assignment, since), self.log()
            return self.manager.hears(assignment, since)

        until(heard, patience)

    def log(self) -> str:
        return self.journal.read_text()


def serve(results: Path) -> list[str]:
    return ["engine", "serve", "--testbed", "simulated", f"--results={results}", "--idle-time=inf"]


@pytest.mark.needs("mkfs.ext4")
def test_the_watchdog_hears_through_a_frozen_disk_in_a_run(tmp_path: Path) -> None:
    manager = Manager()
    with disk_image(tmp_path / "disk") as disk:
        own = manager.environment
        with EngineProcess(disk.folder / "results", "nominal", environment=own) as engine:
            engine.start(make_setup(countdown=1.0))
            with disk.stalled():
                assert manager.longest_silence(FROZEN) < WATCHDOG
                assert engine.snapshot().pulse.disk > 0
                assert engine.snapshot().run.phase is Phase.RUNNING
            assert manager.hears("STATUS=RUNNING, run 1 of subject 3; disk silent for")
            assert engine.result()["outcome"] == "completed"
    manager.close()


def test_the_watchdog_hears_nothing_of_a_core_that_hangs(tmp_path: Path) -> None:
    hang = tmp_path / "hang"
    with Service([sys.executable, "-c", HANGS_ON_REQUEST, str(hang), *serve(tmp_path)]) as service:
        service.wait_for("READY=1")
        service.wait_for("WATCHDOG=1")
        hang.touch()
        assert service.manager.longest_silence(2 * WATCHDOG) > WATCHDOG
        assert service.manager.hears("the engine has not moved for")
        service.process.send_signal(signal.SIGABRT)  # as the watchdog does
        assert service.process.wait(STARTING) == -signal.SIGABRT
        assert "in hanging" in service.log()  # where the core was


def test_a_service_says_when_it_is_ready_and_when_it_ends_and_logs_its_state(
    tmp_path: Path,
) -> None:
    command = [sys.executable, "-m", "madrob_console.cli.main", *serve(tmp_path / "results")]
    with Service(command) as service:
        service.wait_for("READY=1")
        service.wait_for("STATUS=")
        assert not list(service.state.rglob("*.log"))
        service.process.send_signal(signal.SIGTERM)
        assert service.process.wait(STARTING) == 0
        assert service.manager.hears("STOPPING=1")
        lines = service.log().splitlines()
    assert lines == ["NO RUN SET UP"]


def test_an_engine_that_fails_is_started_again_and_one_that_is_stopped_is_not(
    tmp_path: Path,
) -> None:
    fails = HANGS_ON_REQUEST.replace("time.sleep(0.05)", "raise MemoryError('no memory')")
    trigger = tmp_path / "fail"
    command = [sys.executable, "-c", fails, str(trigger), *serve(tmp_path / "results")]
    with Service(command) as service:
        service.wait_for("WATCHDOG=1")
        trigger.touch()
        assert service.process.wait(STARTING) == 1  # Restart=on-failure
        assert service.manager.hears("STATUS=the engine has failed: no memory")
        assert "MemoryError: no memory" in service.log()


def unit(capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, list[str]]:
    """The keys of a unit, with the words of each."""
    assert main(["engine", "unit", *options]) == 0
    text = capsys.readouterr().out
    pairs = (line.partition("=") for line in text.splitlines() if "=" in line and line[0] != "#")
    return {key: shlex.split(value.replace("%%", "%")) for key, _, value in pairs}


def test_what_the_unit_starts_ends_by_the_signal_of_systemd_and_nothing_else_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ours = "100% of 'our' $runs"
    keys = unit(capsys, "--testbed", "simulated", "--results", ours)
    other = [sys.executable, "-m", "madrob_console.cli.main", *serve(tmp_path / "other")]
    command = [word.replace("$$", "$") for word in keys["ExecStart"]]
    with Service(command) as service, Service(other) as beside:
        for one in (service, beside):
            one.wait_for("READY=1")
        assert (tmp_path / ours).is_dir()
        service.process.send_signal(signal.SIGTERM)
        assert service.process.wait(STARTING) == 0
        assert beside.process.poll() is None
        beside.wait_for("WATCHDOG=1", time.monotonic())


def test_a_login_finds_the_engine_of_a_service_that_has_another_state_folder(
    tmp_path: Path,
) -> None:
    command = [sys.executable, "-m", "madrob_console.cli.main", *serve(tmp_path / "results")]
    with Service(command) as service:
        service.wait_for("READY=1")
        status = subprocess.run(
            [sys.executable, "-m", "madrob_console.cli.main", "engine", "status"],
            env={**service.environment, "XDG_STATE_HOME": str(tmp_path)},
            cwd=ROOT, check=False, capture_output=True, text=True, timeout=STARTING,
        )  # fmt: skip
        assert f"pid {service.process.pid}" in status.stdout


@pytest.mark.needs("systemd-analyze")
@pytest.mark.parametrize("system", [False, True])
def test_systemd_takes_the_unit(
    system: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    options = ["--testbed", "ros", "--domain", "7", "--results", str(tmp_path / 'a "b" $c %d')]
    assert main(["engine", "unit", *options, *(["--system"] if system else [])]) == 0
    path = tmp_path / "madrob-ros-domain-7.service"
    path.write_text(capsys.readouterr().out)
    text = path.read_text()
    for line in ("Type=notify", "Restart=on-failure", "WatchdogSec=15", "OOMPolicy=continue"):
        assert line in text.splitlines()
    assert "Environment=RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in text
    assert "--domain=7" in text
    assert f"WantedBy={'multi-user' if system else 'default'}.target" in text
    done = subprocess.run(
        ["systemd-analyze", "verify", str(path)], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
