"""How long a process could have worked: a disk or other programs may hold it up, and no bug."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

LOOK_PERIOD = 1.0
"""A process is looked at this often, s."""

_DISK = "D"
"""State of a thread that waits for a disk (proc(5))."""


@dataclass(frozen=True, slots=True)
class ThreadState:
    """A thread of a process.

    Attributes:
        state: as in proc(5).
        waited: for a processor, since it began, s.
    """

    state: str
    waited: float


class OwnTime:
    """Counts the time in which none of a process's threads waited for a disk or a processor.

    Args:
        now: s of a monotonic clock, as in all calls.
        threads: the process's threads by their numbers.
    """

    def __init__(self, now: float, threads: Callable[[], Mapping[int, ThreadState]]) -> None:
        self._threads = threads
        self._looked = now
        self._before: Mapping[int, ThreadState] = {}
        self._time = 0.0

    def begin(self, now: float) -> None:
        """Count anew."""
        self._looked, self._time, self._before = now, 0.0, {}

    def since(self, now: float) -> float:
        """How much there was since `begin`, s; looks at the process now and then."""
        passed = now - self._looked
        if passed < LOOK_PERIOD:
            return self._time
        threads, before = self._threads(), self._before
        self._looked, self._before = now, threads
        if not before or any(one.state == _DISK for one in threads.values()):
            return self._time
        waited = (one.waited - before[n].waited for n, one in threads.items() if n in before)
        self._time += max(0.0, passed - max(waited, default=0.0))
        return self._time


def threads_of(pid: int) -> Mapping[int, ThreadState]:
    """The threads of a process; those that end meanwhile are left out."""
    found: dict[int, ThreadState] = {}
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(OSError, ValueError, IndexError):
                state = (task / "stat").read_text().rpartition(")")[2].split()[0]
                found[int(task.name)] = ThreadState(state, _waited(task))
    return found


def _waited(task: Path) -> float:
    """For a processor, s; 0 where the kernel does not count it."""
    try:
        return int((task / "schedstat").read_text().split()[1]) / 1e9
    except (OSError, ValueError, IndexError):
        return 0.0
