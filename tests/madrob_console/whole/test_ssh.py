"""The console over a real SSH connection that is cut."""

from __future__ import annotations

import getpass
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from recorder.reader import read_bag
from tests.madrob_console.console_process import F10, ROOT, Hall, start_a_run
from tests.programs import found
from tests.terminal import Terminal
from tests.watching import until

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
            f"cd {ROOT} && TERM=xterm-256color LC_ALL=C.UTF-8 XDG_RUNTIME_DIR={hall.folder}"
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
                terminal.wait_for(f"run {number} of subject 1", timeout=30.0)
                attached.append(time.monotonic() - began)
                result = hall.wait_for_result(folder)
                terminal.send(F10)
                terminal.wait_for("Leave?")
                terminal.send("y")
                assert terminal.wait_exit() == 0
            assert result["outcome"] == "completed"
            assert result["indicators"]["capability_level"]["value"] == 6
            assert result["quality"]["remarks"] == []
            assert read_bag(folder).complete
    print(
        f"\nSSH connection killed: {count} of {count} runs finished, scored, bag complete; attached"
        f" again after {sum(attached) / count:.2f} s on average, {max(attached):.2f} s at most"
    )
