"""Two referees over SSH, of whom one loses the connection."""

from __future__ import annotations

import getpass
import os
import shlex
import socket
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.stories.hands import Hall, system_program
from tests.stories.terminal import wait_until

pytestmark = [
    pytest.mark.machine,
    pytest.mark.needs("sshd", "ssh", "ssh-keygen"),
    pytest.mark.skipif(os.geteuid() != 0, reason="needs root: an sshd is started"),
]
SETTINGS = """\
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


@pytest.fixture
def login(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """The start of a command line that runs something over SSH, by a server of its own."""
    folder = tmp_path_factory.mktemp("ssh")
    for name in ("host", "user"):
        key = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(key, check=True)
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    config = folder / "config"
    config.write_text(SETTINGS.format(port=port, folder=folder))
    Path("/run/sshd").mkdir(exist_ok=True)
    argv = ["ssh", "-tt", "-p", str(port), "-i", str(folder / "user")]
    for option in ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR"):
        argv += ["-o", option]

    def answers() -> bool:
        with socket.socket() as knock:
            return knock.connect_ex(("127.0.0.1", port)) == 0

    command = [system_program("sshd"), "-D", "-e", "-f", str(config)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as server:
        wait_until(answers, "the SSH server")
        yield [*argv, f"{getpass.getuser()}@127.0.0.1"]
        server.terminate()


# Seen red: the engine is in the session of the console that started it.
def test_cut_connection_leaves_the_run_to_others(hall: Hall, login: list[str]) -> None:
    first = hall.console_of([*login, shlex.join(hall.over_ssh(speed=1.0))])
    first.open_run()
    second = hall.console_of([*login, shlex.join(hall.over_ssh(speed=1.0))])
    second.wait_for_run()
    first.kill()
    hall.run().wait_for_event()
    second.abort()
    second.wait_for("ABORTED")
    assert hall.run().outcome() == "aborted"
