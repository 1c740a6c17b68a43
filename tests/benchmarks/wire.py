"""A terminal that takes the time and counts what a program in it takes."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from tests.terminal import Terminal

ROOT = Path(__file__).parents[2]

Size = tuple[int, int]
SMALL = 80, 24
STARTING = 60.0
SETTLING, SAMPLE = 1.0, 10.0  # s; CPU time counts in steps of 0.01 s
STARTED = b"started"


class Cost(NamedTuple):
    """What a program takes: kB/s on the line, % of a core alone and with what it started."""

    kilobytes: float
    share: float
    with_children: float


class Wire(Terminal):
    """A terminal that notes when the bytes came; while `blind` it does not draw them.

    What the program writes begins with a word of the shell, just before the program takes its
    place: there the clock of a launch begins.
    """

    def __init__(
        self,
        argv: Sequence[str],
        size: Size = SMALL,
        *,
        blind: bool = True,
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.blind = blind
        self._arrivals: list[tuple[float, int]] = []
        script = f'echo {STARTED.decode()}; exec "$@"'
        super().__init__(["sh", "-c", script, "sh", *argv], *size, env=env, cwd=ROOT)

    def arrival(self, text: bytes, since: int = 0, timeout: float = STARTING) -> float:
        """Wait until `text` is written, after `since` bytes; when that was, by time.monotonic.

        Raises:
            AssertionError: it does not come within `timeout` s, or the program ends.
        """
        deadline = time.monotonic() + timeout
        while (found := self.output.find(text, since)) < 0:
            self._read(0.1)
            if time.monotonic() > deadline:
                raise AssertionError(f"{text!r} did not come in {timeout:g} s: {self._tail()}")
        return max(at for at, position in self._arrivals if position <= found)

    def read_for(self, seconds: float) -> None:
        """Take what comes, as a terminal does."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._read(left)

    def cost(self) -> Cost:
        """What the program takes now."""
        self.read_for(SETTLING)
        children = _children(self.pid)
        written, began = len(self.output), time.monotonic()
        used = [cpu_time(pid) for pid in (self.pid, *children)]
        self.read_for(SAMPLE)
        elapsed = time.monotonic() - began
        shares = [
            100 * (cpu_time(pid) - before) / elapsed
            for pid, before in zip((self.pid, *children), used, strict=True)
        ]
        return Cost((len(self.output) - written) / 1000 / elapsed, shares[0], sum(shares))

    def _read(self, timeout: float) -> bool:
        if not self.blind:
            return super()._read(timeout)
        if not select.select([self._fd], [], [], timeout)[0]:
            return False
        try:
            data = os.read(self._fd, 65536)
        except OSError:
            raise AssertionError(f"the program has ended: {self._tail()}") from None
        self._arrivals.append((time.monotonic(), len(self.output)))
        self.output += data
        return bool(data)

    def _tail(self) -> str:
        return repr(bytes(self.output[-500:]))


def cpu_time(pid: int) -> float:
    """Of all threads of a process, user and system, s."""
    fields = _stat(pid)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _children(parent: int) -> list[int]:
    """The processes that a process has started."""
    children = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            if int(_stat(int(path.name))[1]) == parent:
                children.append(int(path.name))
    return children


def _stat(pid: int) -> list[str]:
    """What the kernel says of a process, from its state on."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
