"""Processes of the program that begin with everything imported: they fork from one that waits.

A proof that starts an engine a thousand times would import for most of an hour. What is started
here runs `madrob` with its arguments as any process does; only its modules are there already. It
leads a process group of its own, so that it can be killed with all that it started.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

import msgspec

from madrob_console.engine import scoring_worker, supervisor

ROOT = Path(__file__).parents[2]


class _Order(msgspec.Struct):
    arguments: list[str]
    environment: dict[str, str]
    log: str


class WarmProcess:
    """A process that was started warm; what `subprocess.Popen` has of it."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._handle: int | None = os.pidfd_open(pid)

    def poll(self) -> int | None:
        """None while it runs, then 0: its exit code belongs to who forked it."""
        with suppress(subprocess.TimeoutExpired):
            return self.wait(0.0)
        return None

    def wait(self, timeout: float | None = None) -> int:
        """Until it has ended.

        Raises:
            subprocess.TimeoutExpired: it has not.
        """
        if self._handle is not None:
            if not select.select([self._handle], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            self.close()  # a proof starts more than a thousand
        return 0

    def send_signal(self, number: int) -> None:
        """Send it a signal; nothing if it has ended."""
        if self._handle is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, number)

    def kill(self) -> None:
        """SIGKILL, to all that it started, too."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    def close(self) -> None:
        """Let go of it."""
        handle, self._handle = self._handle, None
        if handle is not None:
            os.close(handle)


class WarmScoring(WarmProcess):
    """The process that scores for a process that was started warm."""

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL; it leads no group."""
        self.send_signal(signal.SIGKILL)


def _score_warm() -> None:
    """What scores for this process forks, too: from one that begins here, before any thread."""
    ours, theirs = socket.socketpair()
    if os.fork() == 0:
        ours.close()
        _fork_scorers(theirs)
    theirs.close()

    cold = supervisor.start_process

    def start(command: Sequence[str], link: socket.socket) -> supervisor.Started:
        if scoring_worker.__name__ not in command:
            return cold(command, link)
        socket.send_fds(ours, [b"!"], [link.fileno()])
        return WarmScoring(int.from_bytes(ours.recv(4)))

    supervisor.start_process = start


def _fork_scorers(link: socket.socket) -> NoReturn:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        asked, (*handles,), _, _ = socket.recv_fds(link, 1, 1)
        if not asked:
            os._exit(0)
        pid = os.fork()
        if pid == 0:
            link.close()
            sys.argv = ["scoring_worker", str(handles[0])]
            try:
                scoring_worker.main()
            finally:
                os._exit(0)
        os.close(handles[0])
        link.send(pid.to_bytes(4))


class WarmStarts:
    """The process that waits; may be asked from any thread.

    Args:
        preload: a library that what is started has loaded.
    """

    def __init__(self, preload: Path | None = None) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
        if preload is not None:
            environment["LD_PRELOAD"] = str(preload)
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.madrob_console.warm_starts"],
            env=environment,
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._process.communicate()

    def start(
        self, arguments: Sequence[str], environment: Mapping[str, str], log: Path
    ) -> WarmProcess:
        """Start `madrob` with arguments.

        Args:
            arguments: after `madrob`.
            environment: added to that of this process.
            log: gets what it says.
        """
        order = _Order(list(arguments), dict(environment), str(log))
        with self._lock:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            self._process.stdin.write(msgspec.json.encode(order) + b"\n")
            self._process.stdin.flush()
            return WarmProcess(int(self._process.stdout.readline()))


def _serve() -> None:
    """Fork for each order that comes."""
    _import()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody asks for exit codes
    for line in sys.stdin.buffer:
        order = msgspec.json.decode(line, type=_Order)
        pid = os.fork()
        if pid == 0:
            _run(order)
        sys.stdout.buffer.write(f"{pid}\n".encode())
        sys.stdout.buffer.flush()


def _import() -> None:
    """What an engine imports when it begins."""
    from madrob_console.config import load_settings  # noqa: F401
    from scoring.kinematics import load_filters

    load_filters()
    assert threading.active_count() == 1, "what forks must have no thread"


def _run(order: _Order) -> NoReturn:
    from madrob_console.cli.main import main

    os.setsid()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_RDONLY)
    log = os.open(order.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for file, number in ((nothing, 0), (log, 1), (log, 2)):
        os.dup2(file, number)
    os.environ.update(order.environment)
    sys.argv = ["madrob", *order.arguments]
    _score_warm()
    with suppress(AttributeError):  # nothing is preloaded
        ctypes.CDLL(None).each_call_arm()
    sys.exit(main(order.arguments))


if __name__ == "__main__":
    _serve()
