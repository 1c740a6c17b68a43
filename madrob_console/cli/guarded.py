"""The command of [results]: whatever it starts ends with it.

Two processes watch over it. Both are subreapers (prctl(2)): a process below them whose parent ends
becomes their child, whatever session it is in. One runs the command and kills what that leaves
behind; the other one does so when the first one is killed or stopped, and the first one when that
happens to the other.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from subprocess import DEVNULL, PIPE, STDOUT, Popen, TimeoutExpired
from typing import IO

from madrob_console.cli.output import BAD_INPUT, complain
from madrob_console.common.names import terminal_safe

COMMAND_TIME = 60.0
"""The command may take this long, s; then it gets SIGTERM."""

GRACE = 3.0
"""Time from SIGTERM to SIGKILL, s."""

_MOST_OUTPUT = 20_000  # last bytes of a command, in the log
_MOST_TOLD = 100  # characters of its last line on the screens

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h

ENDING = (signal.SIGTERM, signal.SIGALRM)
"""Signals at which a process leaves its work."""

_block_ending = partial(signal.pthread_sigmask, signal.SIG_BLOCK, ENDING)


class TerminatedError(BaseException):
    """A run begins: what is under way leaves no half-written file behind."""


def guarded(work: Callable[[], int]) -> int:
    """Do the work in a child process; its exit code. Whatever that has started ends with it."""
    outer = os.getpid()
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    child = os.fork()
    try:
        if child:
            _, status = os.waitpid(child, os.WUNTRACED)
            return os.WEXITSTATUS(status) if os.WIFEXITED(status) else os.EX_SOFTWARE
        _prctl(_PR_SET_CHILD_SUBREAPER, 1)
        _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)  # a SIGTERM to the outer one ends both
        return work() if os.getppid() == outer else os.EX_SOFTWARE
    finally:
        _block_ending()
        _end_descendants()


def _prctl(option: int, value: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _end_descendants() -> None:
    """Kill all that is below this process, which is a subreaper, until nothing is left."""
    with suppress(ChildProcessError):
        while True:
            for pid in _children():
                os.kill(pid, signal.SIGKILL)
            os.waitpid(-1, 0)  # its children have become those of this process


def _children() -> Iterator[int]:
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            _, parent, *_ = (place / "stat").read_text().rpartition(") ")[2].split()
            if int(parent) == os.getpid():
                yield int(place.name)


def _last_bytes(file: IO[bytes]) -> bytes:
    """Read a pipe to its end: until nobody holds it any more."""
    output = b""
    while data := os.read(file.fileno(), 65536):
        output = (output + data)[-_MOST_OUTPUT:]
    return output


def run_command(words: Sequence[str], limit: float = COMMAND_TIME) -> int:
    """Run a command, in a process that is `guarded`; its exit code.

    What it prints, and how it ended, goes to this process's log.
    """
    begun, name, cause = time.monotonic(), Path(words[0]).name, ""
    try:
        process = Popen(words, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT, start_new_session=True)
    except OSError as error:
        complain(f"{words[0]}: {error.strerror}")
        return BAD_INPUT
    # what this thread blocks does not come by way of the other one
    with process, ThreadPoolExecutor(initializer=_block_ending) as reader:
        assert process.stdout is not None
        output = reader.submit(_last_bytes, process.stdout)
        try:
            process.wait(limit)
        except TimeoutExpired:
            cause = f"its time of {limit:g} s was over"
            os.killpg(process.pid, signal.SIGTERM)
            with suppress(TimeoutExpired):
                process.wait(GRACE)
        except TerminatedError:
            cause = "a run begins, or the process above it was killed"
            raise
        finally:
            _block_ending()  # it ends all in any case
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            code = process.wait()
            _end_descendants()
            took = f"{name}: exit code {code} after {time.monotonic() - begun:.1f} s"
            said = output.result().decode(errors="replace")
            lines = [terminal_safe(line) for line in said.splitlines()]
            for line in (*lines, ": ".join(filter(None, (took, cause)))):
                print(f"command of [results]: {line}", file=sys.__stderr__, flush=True)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    if cause:
        complain(f"{name} was ended: {cause}")
        return BAD_INPUT
    if code:
        last = lines[-1][:_MOST_TOLD] if lines else "it said nothing"
        complain(f"{name} ended with code {code}: {last}")
    return code
