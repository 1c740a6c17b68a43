"""What is said of troubles that end nothing."""

from __future__ import annotations

import asyncio
import threading
from contextlib import closing
from pathlib import Path

import pytest

from madrob_console.engine.process import troubles
from madrob_console.engine.process.local import LocalEngine
from madrob_console.engine.process.troubles import AGAIN, FallenThreads, Troubles
from tests.madrob_console.engine.served import simulated
from tests.watching import until

NO_HANDLES = OSError(24, "Too many open files")


class Passing:
    """Time that passes when it is told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_each_kind_of_trouble_is_a_line_and_is_said_again_only_after_a_while(
    capsys: pytest.CaptureFixture[str],
) -> None:
    time = Passing()
    found = Troubles(time)
    for _ in range(1000):
        found.tell("new screens must wait", NO_HANDLES)
        found.tell("new screens must wait", OSError(23, "Too many open files in system"))
        found.tell("a screen was let go", MemoryError())
    assert capsys.readouterr().err.splitlines() == [
        "madrob: new screens must wait ([Errno 24] Too many open files)",
        "madrob: a screen was let go (MemoryError)",
    ]
    time.now += AGAIN
    found.tell("new screens must wait", NO_HANDLES)
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_what_others_say_neither_fills_the_log_nor_reaches_a_terminal_raw(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = Troubles(Passing())
    for number in range(1000):
        found.tell(f"\x1b[2Jscreen {number}\n", ValueError("\x1b]0;owned\x07"))
    lines = capsys.readouterr().err
    assert len(lines.splitlines()) <= 50
    assert "\x1b" not in lines
    assert lines.startswith("madrob: screen 0  ()\n")


def test_a_loop_says_its_troubles_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    async def fail() -> None:
        raise ValueError("lost")

    async def forget_a_task() -> None:
        asyncio.get_running_loop().set_exception_handler(Troubles().of_loop)
        task = asyncio.create_task(fail())
        await asyncio.wait([task])
        del task

    asyncio.run(forget_a_task())
    said = capsys.readouterr().err
    assert said == "madrob: Task exception was never retrieved (lost)\n"


def test_what_must_go_on_is_begun_again_whatever_ends_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(troubles, "_PAUSE", 0.0)
    begun = 0

    async def work() -> None:
        nonlocal begun
        begun += 1
        if begun < 5:
            raise MemoryError

    asyncio.run(Troubles().lasting(work))
    assert begun == 5
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.machine
def test_a_thread_that_falls_is_a_fault_on_the_screens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise ValueError("\x1b[2Ja bug")

    fallen = FallenThreads()
    monkeypatch.setattr(threading, "excepthook", fallen.note)
    local = LocalEngine(simulated(tmp_path), fallen=lambda: fallen.problem)
    with closing(local):
        assert not any("has ended" in fault for fault in local.snapshot().faults)
        thread = threading.Thread(target=fail, name="intake")
        thread.start()
        thread.join()
        words = "a part of the engine has ended (intake: a bug): start it again after the run"
        until(lambda: words in local.snapshot().faults)
    assert "ValueError" in capsys.readouterr().err
