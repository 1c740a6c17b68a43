"""One supervisor keeps every child process of an engine running."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import closing

import msgspec
import pytest

from madrob_console.engine.runtime.supervisor import Supervisor, Worker
from tests.madrob_console.engine.scored_elsewhere import alive
from tests.watching import until

pytestmark = pytest.mark.machine

ECHO = """
import socket, sys, time
link = socket.socket(fileno=int(sys.argv[1]))
while data := link.recv(65536):
    if b"end" in data:
        sys.exit(3)
    if b"hang" in data:
        time.sleep(1000)
    while b"circle" in data:
        pass
    other = b"\\0\\0\\0\\1x" if b"other" in data else data
    link.sendall(b"\\xff" * 100 if b"nonsense" in data else other)
"""


class Word(msgspec.Struct, frozen=True):
    text: str


class Echo(Worker):
    patience = 1.5
    longest = 3.0

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-c", ECHO)) -> None:
        super().__init__(command)
        self.heard: list[str] = []
        self.lost: list[str] = []
        self.words: list[str] = []
        self.asked: float | None = None

    def begin(self) -> None:
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
    with closing(Supervisor(worker)):
        until(lambda: worker.heard == ["hello"])
        yield worker


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (signal.SIGKILL, "it was ended by SIGKILL"),
        (signal.SIGSTOP, "it was stopped for 2 s"),
        ("end", "it ended with code 3"),
        ("hang", "it did not move for"),
        ("circle", "it gave no answer for"),
        ("nonsense", "not a message"),
        ("other", "ValidationError"),
    ],
)
def test_a_process_that_ends_hangs_or_says_nonsense_is_started_again(
    echo: Echo, spoil: str | signal.Signals, why: str
) -> None:
    first = echo.pid
    assert first is not None
    if isinstance(spoil, signal.Signals):
        os.kill(first, spoil)
    else:
        echo.say(spoil)
    until(lambda: echo.heard == ["hello", "hello"])
    assert [why in one for one in echo.lost] == [True]
    echo.say("one")
    until(lambda: echo.heard[2:] == ["one"])
    until(lambda: not alive(first))


def test_a_process_that_cannot_be_started_is_named_and_tried_again() -> None:
    worker = Echo(("/nonexistent/program",))
    with closing(Supervisor(worker)):
        until(lambda: len(worker.lost) >= 2)
    assert worker.lost[0] == "no process can be started (No such file or directory)"
    assert worker.failures >= 2


def test_one_bad_worker_costs_the_other_nothing() -> None:
    bad = Echo((sys.executable, "-c", "pass"))
    good = Echo()
    with closing(Supervisor(bad, good)):
        until(lambda: len(bad.lost) >= 2 and good.heard == ["hello"])
        good.say("still here")
        until(lambda: good.heard[-1] == "still here")
        pid = good.pid
    assert pid is not None
    until(lambda: not alive(pid))
