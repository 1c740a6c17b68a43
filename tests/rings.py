"""The rings of the tests, from what only computes to what needs the whole machine.

Every test is in exactly one: the one that it is marked with, else that of its folder.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

_HERE = Path(__file__).parent


class Ring(StrEnum):
    """What a test needs of the machine that it runs on."""

    PURE = "pure"  # its cores: time is virtual, nothing sleeps, no process is started
    SCREENS = "screens"  # textual as well, without a terminal
    STORIES = "stories"  # processes and terminals of the console itself
    MACHINE = "machine"  # processes, DDS, ssh, tmux, signals, real time


FOLDERS: Mapping[str, Ring] = {
    "benchmarks": Ring.PURE,
    "madrob_console/archive": Ring.PURE,
    "madrob_console/cli": Ring.PURE,
    "madrob_console/common": Ring.PURE,
    "madrob_console/common/test_version.py": Ring.MACHINE,
    "madrob_console/config": Ring.PURE,
    "madrob_console/engine": Ring.PURE,
    "madrob_console/export": Ring.PURE,
    "madrob_console/messages": Ring.PURE,
    "madrob_console/pages": Ring.PURE,
    "madrob_console/referee": Ring.PURE,
    "madrob_console/testbeds": Ring.PURE,
    "madrob_console/testbeds/ros": Ring.MACHINE,
    "madrob_console/ui": Ring.SCREENS,
    "madrob_console/whole": Ring.MACHINE,
    "recorder": Ring.PURE,
    "scoring": Ring.PURE,
    "slice": Ring.PURE,
    "corpus": Ring.PURE,
    "stories": Ring.STORIES,
    "test_papers.py": Ring.PURE,
}
WITH_PROCESSES = frozenset({Ring.STORIES, Ring.MACHINE})
LIMIT, MACHINE_LIMIT, SLOW_LIMIT = 60.0, 240.0, 600.0
"""A test that takes longer hangs, s, unless it says otherwise: with processes by the clock, else
of processor time, which other programs do not use up.
"""
PATIENCE = 20
"""So many times its limit a test may wait by the clock for a processor that others use."""
FEW_RUNS = 20  # of a slow proof, within its limit


class NeedsMachineError(RuntimeError):
    """A test outside of the rings with processes started one or slept."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}: watch for it, use virtual time, or mark it pytest.mark.machine")


def ring_of(item: pytest.Item) -> Ring:
    """The ring of a test.

    Raises:
        pytest.UsageError: it is in none, or in more than one.
    """
    marked = {ring for ring in Ring if item.get_closest_marker(ring) is not None}
    if len(marked) > 1:
        raise pytest.UsageError(f"{item.nodeid}: in the rings {', '.join(sorted(marked))}; use one")
    if marked:
        return marked.pop()
    inside = item.path.relative_to(_HERE)
    for place in (inside, *inside.parents):
        if ring := FOLDERS.get(place.as_posix()):
            return ring
    raise pytest.UsageError(f"{item.nodeid}: in no ring; add its folder to tests/rings.py")


def mark(items: Iterable[pytest.Item], runs: int) -> None:
    """Give each test its ring and the time after which it counts as hanging, by the clock.

    Args:
        items: the tests.
        runs: how often the slow proofs repeat themselves.
    """
    slow_limit = SLOW_LIMIT * max(1.0, runs / FEW_RUNS)
    for item in items:
        ring = ring_of(item)
        if item.get_closest_marker(ring) is None:
            item.add_marker(ring.value)
        slow, told = item.get_closest_marker("slow"), item.get_closest_marker("timeout")
        limit = MACHINE_LIMIT if ring in WITH_PROCESSES else LIMIT
        limit = float(told.args[0]) if told else slow_limit if slow else limit
        patience = 1 if ring in WITH_PROCESSES else PATIENCE
        item.add_marker(pytest.mark.timeout(patience * limit), append=False)


_STARTS = ("os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.system", "subprocess.Popen")
# while they are imported SciPy's filters (NumPy before 2.0) and, for the first time, Matplotlib ask
_WHILE_IMPORTED = {"lscpu", "fc-list"}
_watched = False
_sleep = time.sleep


def _heard(event: str, arguments: tuple[object, ...]) -> None:
    if _watched and event in _STARTS and _WHILE_IMPORTED.isdisjoint(arguments[:1]):
        raise NeedsMachineError(event)


def _slept(seconds: float) -> None:
    caller = Path(sys._getframe(1).f_code.co_filename)
    if caller.is_relative_to(_HERE.parent) and "site-packages" not in caller.parts:
        raise NeedsMachineError("time.sleep")
    _sleep(seconds)  # a library's


def _started(self: BaseProcess) -> None:
    raise NeedsMachineError(f"the process {self.name}")


sys.addaudithook(_heard)  # for good: it cannot be taken away again


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Fail what uses more processor time, in whatever thread; only in the main thread."""

    def end(number: int, frame: object) -> None:
        pytest.fail(f"it hangs: more than {seconds:g} s of processor time are used")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@contextmanager
def kept(item: pytest.Item) -> Iterator[None]:
    """While a test runs: no process, no sleep, a bound of its work, where its ring has none."""
    global _watched  # noqa: PLW0603  so is the hook that reads it
    limit = item.get_closest_marker("timeout")
    if ring_of(item) in WITH_PROCESSES or limit is None:
        yield
        return
    with pytest.MonkeyPatch.context() as patch, bounded(limit.args[0] / PATIENCE):
        patch.setattr(time, "sleep", _slept)
        patch.setattr(BaseProcess, "start", _started)
        _watched = True
        try:
            yield
        finally:
            _watched = False
