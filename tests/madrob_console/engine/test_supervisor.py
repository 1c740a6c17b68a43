"""One supervisor keeps every child process of an engine running."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine.runtime.supervisor import Supervisor, Worker
from tests.watching import alive, until

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


ANSWER = """
import os, pathlib, signal, sys, time
from madrob_console.engine.runtime.worker_questions import answer_questions

def answer(question):
    path, deaths, duration = question
    tries = pathlib.Path(path)
    with tries.open("a") as file:
        file.write("x")
    if len(tries.read_text()) <= deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(duration)
    return len(tries.read_text())

answer_questions(int(sys.argv[1]), answer)
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


@pytest.fixture
def answering() -> Iterator[Worker]:
    worker = Worker((sys.executable, "-c", ANSWER))
    with closing(Supervisor(worker)):
        yield worker


NUMBER = msgspec.msgpack.Decoder(int)


def test_a_question_is_asked_again_after_the_first_loss_of_its_process_only(
    answering: Worker, tmp_path: Path
) -> None:
    for name, deaths, retries in (("one", 1, 1), ("two", 2, 2)):
        question = (str(tmp_path / name), deaths, 0.0)
        assert answering.ask(question, NUMBER, retries=retries).result(60.0) == deaths + 1
    failed = answering.ask((str(tmp_path / "three"), 2, 0.0), NUMBER)
    with pytest.raises(MadrobError, match="its process is started again: it was ended by SIGKILL"):
        failed.result(60.0)
    assert answering.ask((str(tmp_path / "four"), 0, 0.0), NUMBER).result(60.0) == 1
    assert (tmp_path / "three").read_text() == "xx"


def test_a_question_that_is_cancelled_or_too_late_is_never_sent(
    answering: Worker, tmp_path: Path
) -> None:
    slow = answering.ask((str(tmp_path / "slow"), 0, 1.0), NUMBER)
    until((tmp_path / "slow").exists)
    late = answering.ask((str(tmp_path / "late"), 0, 0.0), NUMBER, deadline=time.monotonic() + 0.1)
    assert answering.ask((str(tmp_path / "late"), 0, 0.0), NUMBER).cancel()
    last = answering.ask((str(tmp_path / "last"), 0, 0.0), NUMBER)
    with pytest.raises(MadrobError, match="Nothing was done"):
        late.result(60.0)
    assert (slow.result(60.0), last.result(60.0)) == (1, 1)
    assert not (tmp_path / "late").exists()


def test_every_question_is_answered_when_the_engine_ends(tmp_path: Path) -> None:
    worker = Worker((sys.executable, "-c", ANSWER))
    with closing(Supervisor(worker)):
        waiting = [worker.ask((str(tmp_path / "slow"), 0, 60.0), NUMBER) for _ in range(2)]
        until((tmp_path / "slow").exists)
    waiting.append(worker.ask((str(tmp_path / "slow"), 0, 60.0), NUMBER))  # after its end
    for answer in waiting:
        with pytest.raises(MadrobError, match="the engine has ended"):
            answer.result(10.0)
