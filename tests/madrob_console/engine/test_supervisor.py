"""One supervisor keeps every child process of an engine running."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator

import msgspec
import pytest

from madrob_console.engine.supervisor import Supervisor, Worker
from tests.madrob_console.engine.scored_elsewhere import alive
from tests.watching import until

pytestmark = pytest.mark.machine

ECHO = """
import socket, sys
link = socket.socket(fileno=int(sys.argv[1]))
while data := link.recv(65536):
    if b"end" in data:
        sys.exit(3)
    if b"hang" in data:
        import time
        time.sleep(1000)
    link.sendall(data)
"""


class Word(msgspec.Struct, frozen=True):
    text: str


class Echo(Worker):
    patience = 1.5

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-c", ECHO)) -> None:
        super().__init__(command)
        self.heard: list[str] = []
        self.lost: list[str] = []
        self.begun = 0
        self.words: list[str] = []
        self.asked: float | None = None

    def begin(self) -> None:
        self.begun += 1
        self.send(Word("hello"))

    def work(self, now: float) -> float:
        while self.words and self.pid is not None:
            self.send(Word(self.words.pop(0)))
            self.asked = now
        return 10.0

    def take(self, data: memoryview) -> None:
        self.asked = None
        self.heard.append(msgspec.msgpack.decode(data, type=Word).text)

    def lose(self, why: str) -> None:
        self.asked = None
        self.lost.append(why)

    def due(self) -> float | None:
        return self.asked

    def say(self, word: str) -> None:
        self.words.append(word)
        self.ring()


@pytest.fixture
def echo() -> Iterator[Echo]:
    worker = Echo()
    supervisor = Supervisor(worker)
    until(lambda: worker.heard == ["hello"])
    yield worker
    supervisor.close()


def test_what_is_sent_is_answered(echo: Echo) -> None:
    echo.say("one")
    until(lambda: echo.heard == ["hello", "one"])
    assert echo.lost == []


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda pid: os.kill(pid, signal.SIGKILL), "it was ended by SIGKILL"),
        (lambda pid: os.kill(pid, signal.SIGSTOP), "it was stopped for 2 s"),
    ],
)
def test_a_process_that_is_killed_or_stopped_is_started_again(
    echo: Echo, spoil: Callable[[int], None], why: str
) -> None:
    first = echo.pid
    assert first is not None
    spoil(first)
    until(lambda: echo.heard == ["hello", "hello"])
    assert echo.lost == [why]
    assert echo.pid != first


@pytest.mark.parametrize(
    ("word", "why"), [("end", "it ended with code 3"), ("hang", "it did not move for")]
)
def test_a_process_that_ends_or_hangs_is_started_again(echo: Echo, word: str, why: str) -> None:
    echo.say(word)
    until(lambda: echo.heard == ["hello", "hello"])
    assert [one[: len(why)] for one in echo.lost] == [why]


def test_a_process_that_cannot_be_started_is_named_and_tried_again() -> None:
    worker = Echo(("/nonexistent/program",))
    supervisor = Supervisor(worker)
    until(lambda: len(worker.lost) >= 2)
    assert worker.lost[0] == "no process can be started (No such file or directory)"
    assert worker.failures >= 2
    supervisor.close()


def test_one_bad_worker_costs_the_other_nothing() -> None:
    bad, good = Echo((sys.executable, "-c", "pass")), Echo()
    supervisor = Supervisor(bad, good)
    until(lambda: len(bad.lost) >= 2 and good.heard == ["hello"])
    good.say("still here")
    until(lambda: good.heard[-1] == "still here")
    pid = good.pid
    supervisor.close()
    assert pid is not None
    until(lambda: not alive(pid))
