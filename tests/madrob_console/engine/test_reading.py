"""What only reads is read beside the core, and tells what came of it when asked to."""

from __future__ import annotations

import threading
from concurrent.futures import Future

import pytest

from madrob_console.engine.live.reading import BUSY, MOST_WAITING, THREADS, ThreadReader
from madrob_console.errors import MadrobError
from tests.watching import PATIENCE, until

pytestmark = pytest.mark.machine


def breaks() -> None:
    raise ValueError("a bug")


def test_what_the_core_asked_is_told_in_its_thread_and_not_before_it_asks_for_it() -> None:
    reader, told = ThreadReader(), list[str]()
    answer = reader.ask(lambda: 7, lambda _: told.append(threading.current_thread().name))
    assert answer.result(PATIENCE) == 7
    assert told == []

    def delivered() -> bool:
        reader.deliver()
        return bool(told)

    until(delivered)
    assert told == [threading.current_thread().name]
    reader.close()


def test_a_bug_is_an_answer_in_words_and_ends_no_thread() -> None:
    reader = ThreadReader()
    for _ in range(THREADS + 1):
        with pytest.raises(MadrobError, match="it cannot be read: ValueError"):
            reader.ask(breaks).result(PATIENCE)
    assert reader.ask(lambda: 7).result(PATIENCE) == 7
    reader.close()


def test_the_disk_is_silent_while_it_owes_the_core_an_answer() -> None:
    """A screen that waits long, as for the bag of a run, says nothing of the disk."""
    reader, go_on, begun = ThreadReader(), threading.Event(), list[int]()

    def hangs() -> bool:
        begun.append(1)
        return go_on.wait(PATIENCE)

    screen = reader.ask(hangs)
    until(lambda: len(begun) == 1)
    assert reader.silent == 0.0
    core = reader.ask(hangs, lambda _: None)
    until(lambda: len(begun) == 2)
    until(lambda: reader.silent > 0.0)
    go_on.set()
    assert screen.result(PATIENCE)
    assert core.result(PATIENCE)
    until(lambda: reader.silent == 0.0)
    reader.close()


def test_a_disk_that_hangs_holds_up_so_many_readings_and_refuses_more() -> None:
    reader, go_on, order = ThreadReader(), threading.Event(), list[int]()

    def asked(number: int, *, first: bool = False) -> Future[int]:
        def read() -> int:
            assert go_on.wait(30.0)
            order.append(number)
            return number

        return reader.ask(read, first=first)

    hanging = [asked(number) for number in range(THREADS)]
    until(lambda: reader._of_screens.count(first=False) == 0)
    core = reader.ask(lambda: 7, lambda _: None)
    assert core.result(PATIENCE) == 7  # it waits for nothing that screens ask
    waiting = [asked(100 + number) for number in range(MOST_WAITING)]
    with pytest.raises(MadrobError, match=BUSY):
        asked(1000).result()
    referee = [asked(200, first=True), asked(201, first=True)]
    assert waiting[0].cancel()
    go_on.set()
    assert [one.result(30.0) for one in (*hanging, *referee, *waiting[1:])]
    assert 100 not in order
    assert max(order.index(200), order.index(201)) <= THREADS + 1
    reader.close()
    with pytest.raises(MadrobError, match="the engine has ended"):
        asked(300).result()
