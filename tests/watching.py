"""Waiting for what a thread or a process does, as long as it takes and no longer."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self, TypeVar

PATIENCE = 30.0  # s; only a test that fails waits so long
_BETWEEN_LOOKS = 0.005  # s
_WAKES = 4  # threads that wait for each other between a key and what it does
_MOST = 0.5  # s; what takes longer is no hiccup of the machine
_T = TypeVar("_T")


def until(look: Callable[[], _T], patience: float = PATIENCE) -> _T:
    """Look again and again until what is seen is true; what was seen.

    Raises:
        AssertionError: it did not become true within `patience` seconds; with what was seen last.
    """
    end, pause = time.monotonic() + patience, threading.Event()
    while not (seen := look()):
        assert time.monotonic() < end, f"waited {patience:g} s in vain, last seen: {seen!r}"
        pause.wait(_BETWEEN_LOOKS)
    return seen


def wait_gone(pid: int) -> None:
    """Until a process that is no child has gone."""

    def gone() -> bool:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return True
        return stat.rpartition(")")[2].split()[0] == "Z"

    until(gone)


def stop_process(pid: int) -> None:
    """Stop a process by a signal, until it stands still: its threads may take their time."""
    os.kill(pid, signal.SIGSTOP)
    tasks = Path(f"/proc/{pid}/task")
    until(
        lambda: all(
            stat.read_text().rpartition(")")[2].split()[0] == "T" for stat in tasks.glob("*/stat")
        )
    )


class Closing:
    """Closed at the end of a `with` block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End what was begun."""
        raise NotImplementedError


class Stutter(Closing):
    """How late this machine wakes those who wait, while inside: a limit on the clock allows for it.

    Attributes:
        worst: the latest so far, s.
    """

    def __init__(self) -> None:
        self.worst = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def _watch(self) -> None:
        while not self._over.is_set():
            began = time.monotonic()
            time.sleep(_BETWEEN_LOOKS)
            self.worst = max(self.worst, time.monotonic() - began - _BETWEEN_LOOKS)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def close(self) -> None:
        """Watch no more."""
        self._over.set()
        self._thread.join()

    @property
    def allowance(self) -> float:
        """What a request and its answer, between processes and threads, may take longer, s."""
        return min(_WAKES * self.worst, _MOST)


def alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def children_of(parent: int) -> dict[int, str]:
    """The command lines of what a process has started, by their ids; a zombie has none."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if int((path / "stat").read_text().rpartition(")")[2].split()[1]) == parent:
                found[int(path.name)] = (path / "cmdline").read_text().replace("\0", " ")
    return found
