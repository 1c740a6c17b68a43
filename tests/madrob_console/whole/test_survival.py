"""Nothing ends a run but its stop: real terminals, real processes, real kill -9."""

from __future__ import annotations

import getpass
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import Change
from madrob_console.ui.keys.console_app import UNSEEN
from recorder.reader import read_bag
from scoring.protocol import EventName
from tests.madrob_console.console_process import (
    F8,
    F10,
    ROOT,
    STARTING,
    Hall,
    start_a_run,
    wait_gone,
)
from tests.programs import found
from tests.terminal import Terminal
from tests.watching import until


@pytest.fixture
def hall() -> Iterator[Hall]:
    with Hall() as hall:
        yield hall


@pytest.mark.parametrize("how", ["hang-up", "kill -9", "quit"])
def test_a_run_survives_the_end_of_its_console_and_is_scored(hall: Hall, how: str) -> None:
    with hall.console() as terminal:
        start_a_run(terminal)
        folder = hall.wait_for_running()
        match how:
            case "kill -9":
                os.kill(terminal.pid, signal.SIGKILL)
            case "quit":
                terminal.send(F10)
                terminal.wait_for("The run goes on without this screen")
                terminal.send("y")
                assert terminal.wait_exit() == 0
    result = hall.wait_for_result(folder)
    assert result["outcome"] == "completed"
    assert result["indicators"]["capability_level"]["value"] == 6
    assert result["quality"]["remarks"] == []
    assert read_bag(folder).complete


def test_a_console_that_comes_back_sees_the_live_run_and_can_abort_it(hall: Hall) -> None:
    hall.speed = 1.0  # the run is still there, however busy the machine is
    with hall.console() as terminal:
        start_a_run(terminal)
        folder = hall.wait_for_running()
    with hall.console() as terminal:
        terminal.wait_for("RUNNING")
        terminal.send(F8)
        terminal.wait_for("ABORT the run")
        terminal.send("1y")
        terminal.wait_for("ABORTED")
    assert hall.wait_for_result(folder)["outcome"] == "aborted"


def test_spectators_see_the_run_and_their_keys_do_nothing(hall: Hall) -> None:
    hall.speed = 1.0  # the run is still there, however busy the machine is
    with hall.console() as terminal:
        start_a_run(terminal)
        folder = hall.wait_for_running()
        with hall.console("watch") as spectator:
            spectator.wait_for("RUNNING")
            spectator.send(F8)
            spectator.wait_for("Refused: abort: `madrob console` can act, this screen only watches")
    assert hall.wait_for_result(folder)["outcome"] == "completed"


@pytest.mark.parametrize("big", [(), ("--big",)])
def test_spectators_find_the_engine_that_is_started_again(hall: Hall, big: tuple[str, ...]) -> None:
    with hall.console() as terminal:
        terminal.wait_for("2 of 9 in the way", timeout=STARTING)
        with hall.console("watch", *big) as spectator:
            spectator.wait_for("WATCHING", timeout=STARTING)
            hall.kill_engine()
            spectator.wait_for("the engine has ended")
            terminal.wait_for("the engine has ended")
            assert not any("Ctrl+R" in line or "^R" in line for line in spectator.screen())
            assert not hall.status()  # neither starts one by itself
            terminal.send("\x12")  # Ctrl+R
            terminal.wait_for("The engine is there again", timeout=STARTING)
            until(lambda: not any("ended" in line.lower() for line in spectator.screen()), 20.0)
            assert any("WATCHING" in line for line in spectator.screen())


def test_nobody_watches_where_no_engine_runs(hall: Hall) -> None:
    with hall.console("watch") as spectator:
        assert spectator.wait_exit(60.0) == 2
        assert any("no engine runs here to be watched" in line for line in spectator.screen())


def touches(entries: Iterable[Entry]) -> list[Entry]:
    """When the handle was touched, by the engine."""
    return [
        entry
        for entry in entries
        if entry.what == Change.EVENT and entry.details["event"] == EventName.HANDLE_IS_TOUCHED
    ]


def test_after_kill_9_of_the_engine_the_run_is_reported_and_scored_as_interrupted(
    hall: Hall,
) -> None:
    hall.speed = 1.0
    with hall.console() as terminal:
        start_a_run(terminal)
        folder = hall.wait_for_running()
        touched = until(lambda: touches(hall.journal(folder)))[0]
        until(lambda: any(m.receive_ns > 1e9 * touched.time for m in read_bag(folder).messages()))
        hall.kill_engine()
        terminal.wait_for("the engine has ended")
        terminal.send(F10)  # nothing is left that could be lost: no question
        assert terminal.wait_exit() == 0
    with hall.console() as terminal:
        terminal.wait_for("A RUN WAS CUT OFF: practice run 1 of subject 1", timeout=60.0)
        time.sleep(2 * UNSEEN)  # read before it is answered
        terminal.send("s")
        terminal.wait_for("INTERRUPTED")
    result = hall.wait_for_result(folder)
    assert result["outcome"] == "interrupted"
    assert result["indicators"]["time_to_handle"]["value"] is not None


def test_an_engine_started_twice_is_one_engine(hall: Hall) -> None:
    with hall.console() as one, hall.console() as other:
        for terminal in (one, other):
            terminal.wait_for("2 of 9 in the way", timeout=60.0)
        (line,) = hall.status()
        assert line.startswith("SIMULATED nominal: pid ")


def test_status_and_stop_are_for_people_and_systemd(hall: Hall) -> None:
    hall.speed = 1.0  # the run is still there, however busy the machine is
    named = f"--results={hall.results}"
    assert hall.status() == []
    nothing = hall.madrob("engine", "stop", named)
    assert nothing.returncode == 1
    assert nothing.stdout.startswith("the engine that is named does not run")
    with hall.console() as terminal:
        start_a_run(terminal)
        hall.wait_for_running()
        (line,) = hall.status()
        assert ", RUNNING, run 1 of subject 1, 1 screen, runs in " in line
        refused = hall.madrob("engine", "stop", named)
        assert refused.returncode == 1
        assert "a run is going on" in refused.stdout
        pid = hall.engine_pid()
        stopped = hall.madrob("engine", "stop", "--force", named)
        assert (stopped.returncode, stopped.stdout) == (0, "SIMULATED nominal: ended\n")
        wait_gone(pid)
    (folder,) = hall.run_folders()
    assert hall.wait_for_result(folder)["outcome"] == "interrupted"


def test_an_engine_that_cannot_start_says_why_in_one_line(hall: Hall) -> None:
    hall.speed = 5000.0
    with hall.console() as terminal:
        assert terminal.wait_exit(60.0) == 2
        assert any("--speed: 5000: use 0 to 1000" in line for line in terminal.screen())


@pytest.mark.slow
def test_killed_at_random_moments_a_console_loses_no_run(request: pytest.FixtureRequest) -> None:
    count, rng = max(3, request.config.getoption("--runs") // 4), random.Random(7)
    attached = []
    with Hall(speed=4.0) as hall:
        for number in range(count):
            with hall.console() as terminal:
                start_a_run(terminal)
                folder = hall.wait_for_running()
                time.sleep(rng.uniform(0.0, 3.0))
                os.kill(terminal.pid, signal.SIGKILL)
            began = time.monotonic()
            with hall.console() as terminal:
                terminal.wait_for(f"run {number + 1} of team 1", timeout=30.0)
                attached.append(time.monotonic() - began)
                result = hall.wait_for_result(folder)
                terminal.send(F10)
                terminal.wait_exit()
            assert result["outcome"] == "completed"
            assert read_bag(folder).complete
    print(
        f"\n{count} of {count} runs finished and were scored with their console killed; attached"
        f" again after {sum(attached) / count:.2f} s on average, {max(attached):.2f} s at most"
    )


@pytest.mark.slow
def test_killed_at_random_moments_an_engine_loses_half_a_second_at_most(
    request: pytest.FixtureRequest,
) -> None:
    count, rng = max(3, request.config.getoption("--runs") // 4), random.Random(8)
    losses = []
    for _ in range(count):
        with Hall(speed=1.0) as hall:
            with hall.console() as terminal:
                start_a_run(terminal)
                folder = hall.wait_for_running()
                time.sleep(rng.uniform(0.2, 5.0))
                pid = hall.engine_pid()
                os.kill(pid, signal.SIGKILL)
                killed = time.time_ns()
                wait_gone(pid)
            newest = max(message.receive_ns for message in read_bag(folder).messages())
            losses.append((killed - newest) / 1e9)
            opened = hall.madrob("score", str(folder), "--json")
            assert opened.returncode == 0, opened.stderr
            assert '"interrupted"' in opened.stdout
    mean = sum(losses) / count
    print(f"\nkill -9 of the engine, {count} runs: {mean:.2f} s lost, {max(losses):.2f} s at most")
    assert max(losses) <= 0.6  # half a second, and the time that the kill takes


@pytest.mark.slow
def test_a_terminal_left_unread_changes_no_event(request: pytest.FixtureRequest) -> None:
    unread = 5.0 if request.config.getoption("--runs") < 100 else 60.0
    seen = []
    for stalled in (False, True):
        with Hall(speed=1.0) as hall, hall.console(columns=160, lines=50) as terminal:
            start_a_run(terminal)
            folder = hall.wait_for_running()
            if stalled:
                time.sleep(unread)  # nobody reads the pty
            result = hall.wait_for_result(folder, 120.0)
            events = {e["event"]: e["since_start"] for e in result["events"]}
            seen.append(events)
            stop = next(e for e in hall.journal(folder) if e.what == Change.RUN_STOPS)
            assert stop.time - stop.details["time"] < 1.5
    assert seen[0].keys() == seen[1].keys()
    worst = max(abs(seen[0][name] - seen[1][name]) for name in seen[0])
    print(f"\nunread for {unread:g} s: event times differ by {1000 * worst:.1f} ms at most")
    assert worst <= 0.025, msgspec.json.encode(seen)


CONFIG = """\
ListenAddress 127.0.0.1
Port {port}
HostKey {folder}/host
AuthorizedKeysFile {folder}/user.pub
PidFile {folder}/sshd.pid
PermitRootLogin yes
PasswordAuthentication no
StrictModes no
UsePAM no
"""


class SshServer:
    """An sshd on loopback with keys of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._user = getpass.getuser()
        for name in ("host", "user"):
            subprocess.run(
                ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True
            )
        with closing(socket.create_server(("127.0.0.1", 0))) as free:
            self._port = free.getsockname()[1]
        config = folder / "config"
        config.write_text(CONFIG.format(port=self._port, folder=folder))
        Path("/run/sshd").mkdir(exist_ok=True)
        sshd = found("sshd") or "sshd"
        self._process = subprocess.Popen(
            [sshd, "-D", "-e", "-f", config], stderr=subprocess.DEVNULL
        )
        self._wait()

    def _wait(self) -> None:
        def answers() -> bool:
            with socket.socket() as knock:
                return knock.connect_ex(("127.0.0.1", self._port)) == 0

        until(answers)

    def console(self, hall: Hall) -> Terminal:
        """`madrob console` at the other end of a connection."""
        command = (
            f"cd {ROOT} && TERM=xterm-256color LC_ALL=C.UTF-8 XDG_STATE_HOME={hall.folder}"
            f" {sys.executable} -m madrob_console.cli.main console {' '.join(hall.testbed)}"
        )
        options = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR")
        argv = ["ssh", "-tt", "-p", str(self._port), "-i", str(self._folder / "user")]
        for option in options:
            argv += ["-o", option]
        return Terminal([*argv, f"{self._user}@127.0.0.1", command])

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[SshServer]:
    if os.geteuid() != 0:
        pytest.skip("an sshd for tests needs root")
    server = SshServer(tmp_path)
    yield server
    server.close()


@pytest.mark.needs("sshd", "ssh", "ssh-keygen")
@pytest.mark.slow
def test_a_cut_connection_loses_no_run(server: SshServer, request: pytest.FixtureRequest) -> None:
    count, rng = max(2, request.config.getoption("--runs") // 10), random.Random(11)
    attached = []
    with Hall(speed=4.0) as hall:
        for number in range(1, count + 1):
            with server.console(hall) as terminal:
                start_a_run(terminal)
                folder = hall.wait_for_running()
                time.sleep(rng.uniform(0.0, 3.0))
                os.kill(terminal.pid, signal.SIGKILL)
            began = time.monotonic()
            with server.console(hall) as terminal:
                terminal.wait_for(f"run {number} of team 1", timeout=30.0)
                attached.append(time.monotonic() - began)
                result = hall.wait_for_result(folder)
                terminal.send(F10)
                assert terminal.wait_exit() == 0
            assert result["outcome"] == "completed"
            assert result["indicators"]["capability_level"]["value"] == 6
            assert result["quality"]["remarks"] == []
            assert read_bag(folder).complete
    print(
        f"\nSSH connection killed: {count} of {count} runs finished, scored, bag complete; attached"
        f" again after {sum(attached) / count:.2f} s on average, {max(attached):.2f} s at most"
    )
