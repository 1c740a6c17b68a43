"""A real engine as systemd would run it: what it tells, what it logs, what its unit says."""

from __future__ import annotations

import shlex
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import STARTING, EngineProcess, start_madrob
from tests.madrob_console.small_disk import disk_image
from tests.watching import Closing, until

WATCHDOG = 4.0
"""s; the service manager of a competition waits longer."""

FROZEN = 6.0
"""A disk does not answer for so long, s: longer than the watchdog waits."""

ON_REQUEST = """
import os, time
from madrob_console.engine.runtime.testbed_engine import Engine
step = Engine.step

def hanging(self, *arguments):
    while os.path.exists("{}"):
        {}
    return step(self, *arguments)

Engine.step = hanging
"""
"""An engine whose core does something while a file is there."""


class Manager(Closing):
    """A service manager, and the service that it starts.

    Attributes:
        environment: of the service.
        journal: its log.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="madrob-")
        folder = Path(self._folder.name)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        self._socket.setblocking(False)
        self._told: list[tuple[float, str]] = []
        self.journal = folder / "journal"
        self.journal.touch()
        found = self.journal.stat()
        self.environment = {
            "NOTIFY_SOCKET": str(folder / "notify"),
            "WATCHDOG_USEC": str(round(WATCHDOG * 1e6)),
            "JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}",
        }
        self.service: subprocess.Popen[str] | None = None

    def start(self, *arguments: str, before: str = "") -> subprocess.Popen[str]:
        """`madrob` as the service."""
        self.service = start_madrob(
            *arguments, before=before, output=self.journal, environment=self.environment
        )
        return self.service

    def close(self) -> None:
        if self.service is not None:
            self.service.kill()
            self.service.wait()
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

    def wait_for(self, words: str) -> None:
        until(lambda: self.hears(words), STARTING)

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


def serve(results: Path) -> list[str]:
    return ["engine", "serve", "--testbed", "simulated", f"--results={results}", "--idle-time=inf"]


@pytest.mark.needs("mkfs.ext4")
def test_the_watchdog_hears_through_a_frozen_disk_and_nothing_of_a_core_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    hang = tmp_path / "hang"
    hanging = ON_REQUEST.format(hang, "time.sleep(0.05)")
    with (
        Manager() as manager,
        disk_image(tmp_path / "disk") as disk,
        EngineProcess(
            disk.folder / "r", "nominal", environment=manager.environment, before=hanging
        ) as engine,
    ):
        engine.start(make_setup(countdown=1.0))
        with disk.stalled():
            assert manager.longest_silence(FROZEN) < WATCHDOG
            assert engine.snapshot().pulse.disk > 0
            assert engine.snapshot().run.phase is Phase.RUNNING
        assert manager.hears("STATUS=RUNNING, run 1 of subject 3; disk silent for")
        assert engine.result()["outcome"] == "completed"
        hang.touch()
        assert manager.longest_silence(2 * WATCHDOG) > WATCHDOG
        assert manager.hears("the engine has not moved for")
        engine.process.send_signal(signal.SIGABRT)  # as the watchdog does
        assert engine.process.wait(STARTING) == -signal.SIGABRT
        assert "in hanging" in engine.log.read_text()  # where the core was


def test_an_engine_that_fails_is_started_again(tmp_path: Path) -> None:
    fail = tmp_path / "fail"
    with Manager() as manager:
        serve = ("engine", "serve", "--testbed", "simulated", f"--results={tmp_path}")
        failing = ON_REQUEST.format(fail, "raise MemoryError('no memory')")
        service = manager.start(*serve, before=failing)
        manager.wait_for("WATCHDOG=1")
        fail.touch()
        assert service.wait(STARTING) == 1  # Restart=on-failure
        assert manager.hears("STATUS=the engine has failed: no memory")
        assert "MemoryError: no memory" in manager.journal.read_text()


def test_what_the_unit_starts_says_when_it_is_ready_and_ends_and_a_login_finds_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    ours = "100% of 'our' $runs"
    assert main(["engine", "unit", "--testbed", "simulated", "--results", ours]) == 0
    lines = capsys.readouterr().out.splitlines()
    (started,) = (line.partition("=")[2] for line in lines if line.startswith("ExecStart="))
    words = [word.replace("$$", "$") for word in shlex.split(started.replace("%%", "%"))]
    state = tmp_path / "another"
    assert f"Environment=XDG_STATE_HOME={state}" in lines  # where its consoles look for it
    with Manager() as manager:
        service = manager.start(*words[words.index("engine") :])
        manager.wait_for("READY=1")
        manager.wait_for("STATUS=")
        assert (tmp_path / ours).is_dir()
        assert not list(state.rglob("*.log"))
        assert main(["engine", "status"]) == 0
        assert f"pid {service.pid}" in capsys.readouterr().out
        service.send_signal(signal.SIGTERM)
        assert service.wait(STARTING) == 0
        assert manager.hears("STOPPING=1")
        assert manager.journal.read_text().splitlines() == ["NO RUN SET UP"]


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
    exposure = ["security", "--offline=yes", f"--threshold={40 if system else 65}"]
    for command in ["verify"], exposure:
        done = subprocess.run(
            ["systemd-analyze", *command, path], check=False, capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, ""), done.stdout
