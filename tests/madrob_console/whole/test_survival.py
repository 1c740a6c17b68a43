"""Nothing ends a run but its stop: real terminals, real processes, real kill -9."""

from __future__ import annotations

import getpass
import os
import random
import re
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from madrob_console.referee.rebuild import Change
from madrob_console.ui.keys.type_ahead import UNSEEN
from recorder.reader import Bag
from scoring.protocol import EventName
from tests.madrob_console.engine_process import (
    ROOT,
    STARTING,
    Console,
    Hall,
    journal_of,
    remarks_of,
    result_of,
)
from tests.programs import found
from tests.watching import Stutter, until


@pytest.fixture
def hall() -> Iterator[Hall]:
    with Hall() as hall:
        yield hall


def check_whole(hall: Hall, folder: Path) -> None:
    """The run was completed, recorded and scored, and nothing is said of it."""
    result = result_of(folder, STARTING)
    assert result["outcome"] == "completed"
    assert result["indicators"]["capability_level"]["value"] == 6
    assert remarks_of(result, hall.stutter) == []
    assert Bag(folder).complete


def test_a_run_survives_the_ends_of_its_consoles_and_is_scored(hall: Hall) -> None:
    hall.speed = 1.0  # the run is there, however busy the machine is
    with hall.console() as terminal:
        terminal.start_a_run()
        folder = hall.wait_for_running()
        terminal.press("F10")
        terminal.wait_for("The run goes on without this screen")
        terminal.send("y")
        assert terminal.wait_exit() == 0
    with hall.console() as terminal:  # and the next one hangs up
        terminal.wait_for("run 1 of team 1", timeout=STARTING)
    check_whole(hall, folder)


def test_a_console_that_comes_back_sees_the_live_run_and_can_abort_it(hall: Hall) -> None:
    """Keys of spectators do nothing, and `madrob engine stop` ends no run that goes on."""
    hall.speed, hall.scenario = 1.0, "no-touch"  # the run is there, however busy the machine is
    with hall.console() as terminal:
        terminal.start_a_run()
        folder = hall.wait_for_running()
    with hall.console("watch") as spectator:
        spectator.wait_for("RUNNING", timeout=STARTING)
        spectator.press("F8")
        spectator.wait_for("Refused: abort: `madrob console` can act, this screen only watches")
        (line,) = hall.status()
        assert ", RUNNING, run 1 of subject 1, 1 screen, runs in " in line
        refused = hall.madrob("engine", "stop", f"--results={hall.results}")
        assert (refused.returncode, "a run is going on" in refused.stdout) == (1, True)
    with hall.console() as terminal:
        terminal.wait_for("RUNNING", timeout=STARTING)
        terminal.press("F8")
        terminal.wait_for("ABORT the run")
        terminal.send("1y")
        terminal.wait_for("ABORTED")
    assert result_of(folder, STARTING)["outcome"] == "aborted"


def test_spectators_find_the_engine_that_is_started_again(hall: Hall) -> None:
    """And a second console does; two consoles that start at once have one engine."""
    with hall.console() as terminal, hall.console() as other:
        for console in (terminal, other):
            console.wait_for("2 of 9 checks fail", timeout=STARTING)
        assert len(hall.status()) == 1
        with hall.console("watch") as small, hall.console("watch", "--big") as big:
            for spectator in (small, big):
                spectator.wait_for("WATCHING", timeout=STARTING)
            hall.kill_engine()
            big.wait_for("PAUSED - technical problem")
            for screen in (small, terminal, other):
                screen.wait_for("the engine has ended")
            for spectator in (small, big):
                assert not any("Ctrl+R" in line or "^R" in line for line in spectator.screen())
            assert not hall.status()  # none starts one by itself
            terminal.press("Ctrl+R")
            terminal.wait_for("The engine is there again", timeout=STARTING)
            for screen in (small, big, other):
                until(lambda s=screen: not re.search("ended|PAUSED", " ".join(s.screen())))  # type: ignore[misc]
            for spectator in (small, big):
                assert any("WATCHING" in line for line in spectator.screen())


def test_after_kill_9_of_the_engine_the_run_is_reported_and_scored_as_interrupted(
    hall: Hall,
) -> None:
    hall.speed = 1.0

    def touches() -> list[float]:
        """When the handle was touched, by the engine."""
        events = (line for line in journal_of(folder) if line.what == Change.EVENT)
        return [e.time for e in events if e.details["event"] == EventName.HANDLE_IS_TOUCHED]

    with hall.console() as terminal:
        terminal.start_a_run()
        folder = hall.wait_for_running()
        touched = until(touches)[0]
        until(lambda: any(m.receive_ns > 1e9 * touched for m in Bag(folder).messages()))
        hall.kill_engine()
        terminal.wait_for("the engine has ended")
        terminal.press("F10")  # nothing is left that could be lost: no question
        assert terminal.wait_exit() == 0
    with hall.console() as terminal:
        terminal.wait_for("A RUN WAS CUT OFF: practice run 1 of subject 1", timeout=STARTING)
        time.sleep(2 * UNSEEN)  # read before it is answered
        terminal.send("s")
        terminal.wait_for("INTERRUPTED")
    result = result_of(folder, STARTING)
    assert result["outcome"] == "interrupted"
    assert result["indicators"]["time_to_handle"]["value"] is not None


@pytest.mark.slow
def test_killed_at_random_moments_an_engine_loses_half_a_second_at_most(
    request: pytest.FixtureRequest,
) -> None:
    rng = random.Random(8)
    for _ in range(max(2, request.config.getoption("--runs") // 4)):
        with Hall(speed=1.0) as hall:
            with hall.console() as terminal, Stutter() as stutter:
                terminal.start_a_run()
                folder = hall.wait_for_running()
                time.sleep(rng.uniform(0.2, 5.0))
                killed = hall.kill_engine()
            newest = max(message.receive_ns for message in Bag(folder).messages())
            lost = (killed - newest) / 1e9
            print(f"\nkill -9 of the engine: {lost:.2f} s lost")
            assert lost <= 0.6 + stutter.allowance  # half a second, and the time of the kill
            opened = hall.madrob("score", str(folder), "--json")
            assert (opened.returncode, '"interrupted"' in opened.stdout) == (0, True)


SSHD = """\
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

Open = Callable[[Hall], Console]
"""A console of a hall, in a terminal."""


@contextmanager
def over_ssh(folder: Path) -> Iterator[Open]:
    """Consoles at the other end of connections to an sshd on loopback with keys of its own."""
    for name in ("host", "user"):
        key = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(key, check=True)
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    config = folder / "config"
    config.write_text(SSHD.format(port=port, folder=folder))
    Path("/run/sshd").mkdir(exist_ok=True)
    argv = ["ssh", "-tt", "-p", str(port), "-i", str(folder / "user")]
    for option in ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR"):
        argv += ["-o", option]

    def console(hall: Hall) -> Console:
        command = (
            f"cd {ROOT} && TERM=xterm-256color LC_ALL=C.UTF-8 XDG_STATE_HOME={hall.folder}"
            f" {' '.join(hall.command())}"
        )
        return Console([*argv, f"{getpass.getuser()}@127.0.0.1", command])

    def answers() -> bool:
        with socket.socket() as knock:
            return knock.connect_ex(("127.0.0.1", port)) == 0

    sshd = [found("sshd") or "sshd", "-D", "-e", "-f", str(config)]
    with subprocess.Popen(sshd, stderr=subprocess.DEVNULL) as server:
        try:
            until(answers)
            yield console
        finally:
            server.terminate()


def kill_consoles(console: Open, count: int) -> None:
    """Kill so many consoles at moments by chance; the line that opened one comes back."""
    rng, worst = random.Random(7), 0.0
    with Hall(speed=4.0) as hall:
        for number in range(1, count + 1):
            with console(hall) as terminal:
                terminal.start_a_run()
                folder = hall.wait_for_running()
                time.sleep(rng.uniform(0.0, 3.0))
                os.kill(terminal.pid, signal.SIGKILL)
            began = time.monotonic()
            with console(hall) as terminal:
                terminal.wait_for(f"run {number} of team 1")
                worst = max(worst, time.monotonic() - began)
                check_whole(hall, folder)
                terminal.press("F10")
                assert terminal.wait_exit() == 0
    print(f"\n{count} runs with a console killed: attached again after {worst:.2f} s at most")


@pytest.mark.slow
def test_killed_at_random_moments_a_console_loses_no_run(request: pytest.FixtureRequest) -> None:
    kill_consoles(Hall.console, max(2, request.config.getoption("--runs") // 4))


@pytest.mark.needs("sshd", "ssh", "ssh-keygen")
@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="an sshd for tests needs root")
def test_a_cut_connection_loses_no_run(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    with over_ssh(tmp_path) as console:
        kill_consoles(console, max(2, request.config.getoption("--runs") // 10))
