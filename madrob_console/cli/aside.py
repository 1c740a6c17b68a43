"""`python -m madrob_console.cli.aside QUEUE PAUSE HANDLE`: work that gives way to everything.

It works off the chores in a folder (`ChoreQueue`), one after the other, and tells the engine at the
other end of the socket with this handle. When the engine has ended, it goes on until nothing is
due.
"""

from __future__ import annotations

import io
import os
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from select import select
from subprocess import DEVNULL, PIPE, STDOUT, Popen, TimeoutExpired

import msgspec

from madrob_console.common.names import terminal_safe
from madrob_console.engine.reports import (
    Chore,
    ChoreKind,
    ChoreQueue,
    Finished,
    Look,
    Resting,
)
from madrob_console.engine.wire import LENGTH, frame

COMMAND = (sys.executable, "-P", "-m", "madrob_console.cli.aside")
"""Command line that starts a process for such work."""

NICENESS = 10
"""Added to the niceness of the caller: the engine, a run, a screen come first."""


COMMAND_TIME = 60.0
"""The command of [results] and all that it starts may take this long, s."""

_AGAIN = 0.5  # s
_MOST_OUTPUT = 20_000  # last bytes of a command, in the log
_MOST_TOLD = 100  # characters of its last line on the screens


_starts = False
"""A command is being started: only then can it be ended."""


class _Terminated(BaseException):
    """A run begins: what is under way leaves no half-written file behind."""


class ChoreLink:
    """The socket to the engine, which may have ended."""

    def __init__(self, link: socket.socket) -> None:
        self.number = 0
        self._link = link
        self._coming = link.makefile("rb")

    def tell(self, message: msgspec.Struct) -> None:
        with suppress(OSError):
            self._link.sendall(frame(message))

    def wait_for_look(self) -> bool:
        """Wait until the engine asks for something; False once it has ended."""
        head = b""
        with suppress(ConnectionError):
            head = self._coming.read(LENGTH.size)
        if len(head) < LENGTH.size:
            return False
        data = self._coming.read(LENGTH.unpack(head)[0])
        self.number = msgspec.msgpack.decode(data, type=Look).number
        return True


def main() -> int:
    folder, pause, handle = sys.argv[1:]
    queue = ChoreQueue(Path(folder), float(pause))
    link = ChoreLink(socket.socket(fileno=int(handle)))
    try:
        for number in (signal.SIGTERM, signal.SIGALRM):
            signal.signal(number, _end)
        os.nice(NICENESS)
        queue.hold()
        while link.wait_for_look() or queue.rest == 0:
            while (chore := queue.take_next()) is not None:
                finished = carry_out(chore)
                if not finished.again:
                    queue.finish()
                link.tell(finished)
            link.tell(Resting(link.number, queue.rest))
    except _Terminated:
        signal.setitimer(signal.ITIMER_REAL, 0)
        queue.give_back()
        return 128 + signal.SIGTERM
    except (OSError, MemoryError) as error:  # it is started again
        print(f"madrob: reports, pages and zips wait: {error!r}", file=sys.stderr)
        return os.EX_TEMPFAIL
    return 0


def carry_out(chore: Chore) -> Finished:
    """Do a chore as the command of its name would, with what it prints caught."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = _code_of(chore)
    said, complained = (text.getvalue().strip().rpartition("\n")[2] for text in (out, err))
    return Finished(chore, code, said, complained)


def _code_of(chore: Chore) -> int:
    from madrob_console.archive.run_pictures import write_frames
    from madrob_console.cli.main import main as madrob
    from madrob_console.cli.output import BAD_INPUT, complain
    from madrob_console.cli.repairing import renew_all, renew_report, repair_all
    from madrob_console.common.errors import MadrobError
    from madrob_console.pages.surroundings import Surroundings

    folder = Path(chore.arguments[0])
    problems: Sequence[str] = ()
    try:
        match chore.kind:
            case ChoreKind.REPORT:
                renew_report(folder, Surroundings())
            case ChoreKind.RENEW:
                problems = list(renew_all(folder))
            case ChoreKind.REPAIR:
                problems = list(repair_all(folder))
            case ChoreKind.PICTURES:
                _, at, output = chore.arguments
                problems = write_frames(folder, at, Path(output))
            case ChoreKind.COMMAND:
                return run_command((*chore.arguments[1:], chore.arguments[0]))
            case _:
                return madrob([chore.kind.value, *chore.arguments])
    except (MadrobError, OSError, MemoryError) as error:
        complain(str(error) or "no memory: end other programs")
        # the disk, file handles or memory may come back; the run's folder does not
        return os.EX_TEMPFAIL if folder.is_dir() else BAD_INPUT
    except SystemExit as error:  # of wrong options
        return error.code if isinstance(error.code, int) else BAD_INPUT
    except Exception as error:  # noqa: BLE001  one bug costs one chore
        complain(f"{chore.name}: {error!r}")
        return BAD_INPUT
    for problem in problems:
        complain(problem)
    return BAD_INPUT if problems else 0


def run_command(command: Sequence[str], limit: float = COMMAND_TIME) -> int:
    """Run a command for `limit` s at most; its exit code. Its output goes to this process's log."""
    from madrob_console.cli.output import BAD_INPUT, complain

    global _starts  # noqa: PLW0603  so is the signal handler that reads it
    end, output, why = time.monotonic() + limit, b"", ""
    _starts = True
    try:
        process = Popen(command, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT, start_new_session=True)
    except OSError as error:
        _starts = False
        complain(f"{command[0]}: {error.strerror}")
        return BAD_INPUT
    with process:
        assert process.stdout is not None
        pipe = process.stdout.fileno()
        try:
            _starts = False
            while (left := end - time.monotonic()) > 0 and select([pipe], (), (), left)[0]:
                if not (data := os.read(pipe, 65536)):
                    break
                output = (output + data)[-_MOST_OUTPUT:]
            code = process.wait(max(0.0, end - time.monotonic()))
        except TimeoutExpired:
            code, why = BAD_INPUT, f"was killed after {limit:g} s"
        finally:
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
    lines = [terminal_safe(line) for line in output.decode(errors="replace").splitlines()]
    log = "".join(f"command of [results]: {line}\n" for line in lines)
    print(log, end="", file=sys.__stderr__, flush=True)
    if code:
        why = (
            why
            or f"ended with code {code}: {lines[-1][:_MOST_TOLD] if lines else 'it said nothing'}"
        )
        complain(f"{Path(command[0]).name} {why}")
    return code


def _end(_number: int, _frame: object) -> None:
    signal.setitimer(signal.ITIMER_REAL, _AGAIN)  # an import may have swallowed it
    if not _starts:
        raise _Terminated


if __name__ == "__main__":
    os._exit(main())  # at once: libraries' threads may be at work when a run begins
