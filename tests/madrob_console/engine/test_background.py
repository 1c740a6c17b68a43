"""Work beside the engine: one process at a time, and none while a run goes on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.engine.disk import DiskJobs, DiskThread, why_not
from tests.watching import PATIENCE, until


@pytest.mark.machine
def test_a_file_that_is_cut_short_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "a") as file:  # noqa: PT012
        file.write(b"half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


class Hang:
    """A job that is under way until it is let go."""

    def __init__(self) -> None:
        self.begun = threading.Event()
        self.over = threading.Event()

    def __call__(self) -> str:
        self.begun.set()
        assert self.over.wait(PATIENCE)
        return "over"


class HandClock:
    """A clock that is set by hand, s."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def keeper(clock: HandClock) -> Iterator[DiskThread]:
    keeper = DiskThread("a keeper", most_jobs=3, monotonic=clock)
    yield keeper
    keeper.close(PATIENCE)


def refuses() -> None:
    raise MadrobError("the disk refuses")


def breaks() -> None:
    raise ValueError("a bug")


def test_jobs_are_done_in_turn_and_told_of_in_the_thread_that_asks_for_it(
    keeper: DiskThread,
) -> None:
    done: list[tuple[int, str, str]] = []

    def told(answer: Future[tuple[int, str]]) -> None:
        done.append((*answer.result(), threading.current_thread().name))

    for number in range(3):
        keeper.submit_job(lambda number=number: (number, threading.current_thread().name), told)  # type: ignore[misc]
    until(lambda: keeper.wait_until_idle(0.0))
    here = threading.current_thread().name
    assert done == [(number, "a keeper", here) for number in range(3)]


def test_nothing_is_told_before_it_is_asked_for(keeper: DiskThread) -> None:
    done: list[int] = []
    answer = keeper.submit_job(lambda: 1, lambda answer: done.append(answer.result()))
    assert answer.result(PATIENCE) == 1
    assert done == []
    until(lambda: keeper.wait_until_idle(0.0))
    assert done == [1]


def test_a_job_that_fails_is_an_answer_and_ends_no_keeper(keeper: DiskThread) -> None:
    words: list[str | None] = []
    keeper.submit_job(refuses, lambda answer: words.append(why_not(answer)))
    keeper.submit_job(breaks, lambda answer: words.append(why_not(answer)))
    keeper.submit_job(lambda: 1, lambda answer: words.append(why_not(answer)))
    until(lambda: keeper.wait_until_idle(0.0))
    assert words == ["the disk refuses", "ValueError: a bug", None]


def test_one_that_hangs_is_silent_until_it_answers(keeper: DiskThread, clock: HandClock) -> None:
    hang = Hang()
    assert keeper.silent == 0.0
    keeper.submit_job(hang)
    assert hang.begun.wait(PATIENCE)
    clock.now += 7.0
    assert keeper.silent == 7.0
    hang.over.set()
    until(lambda: keeper.silent == 0.0)


def test_what_finds_no_room_is_refused_in_words(keeper: DiskThread) -> None:
    hang, words = Hang(), list[str | None]()
    keeper.submit_job(hang)
    assert hang.begun.wait(PATIENCE)
    for _ in range(3):
        keeper.submit_job(lambda: None)
    keeper.submit_job(lambda: None, lambda answer: words.append(why_not(answer)))
    keeper.deliver()
    assert words == ["too much waits for the disk: try again when it answers"]
    hang.over.set()


def test_what_is_cancelled_before_its_turn_never_happens(keeper: DiskThread) -> None:
    hang, done = Hang(), list[str]()
    keeper.submit_job(hang)
    assert hang.begun.wait(PATIENCE)
    given_up = keeper.submit_job(lambda: done.append("job"), lambda _: done.append("told"))
    assert given_up.cancel()
    hang.over.set()
    until(lambda: keeper.wait_until_idle(0.0))
    assert done == []


def test_settling_waits_for_what_answers_ask_for_too(keeper: DiskThread) -> None:
    done: list[str] = []

    def again(_answer: Future[None]) -> None:
        keeper.submit_job(lambda: "second", lambda answer: done.append(answer.result()))

    keeper.submit_job(lambda: None, again)
    until(lambda: keeper.wait_until_idle(0.0))
    assert done == ["second"]


def test_closing_leaves_a_job_that_hangs_to_itself(keeper: DiskThread) -> None:
    hang, words = Hang(), list[str | None]()
    keeper.submit_job(hang, lambda answer: words.append(why_not(answer)))
    assert hang.begun.wait(PATIENCE)
    assert not keeper.wait_until_idle(0.0)
    keeper.close(0.0)
    assert words == []
    with pytest.raises(MadrobError, match="the engine has ended"):
        keeper.submit_job(lambda: None).result(0.0)
    hang.over.set()


def test_closing_does_what_was_asked_for_before(clock: HandClock) -> None:
    keeper, done = DiskThread("another keeper", monotonic=clock), list[int]()
    for number in range(5):
        keeper.submit_job(lambda number=number: number, lambda answer: done.append(answer.result()))  # type: ignore[misc]
    keeper.close(PATIENCE)
    assert done == list(range(5))


def test_inline_it_is_done_and_told_before_asking_returns() -> None:
    keeper: DiskJobs = DiskJobs()
    done: list[str | None] = []
    assert (
        keeper.submit_job(lambda: 7, lambda answer: done.append(str(answer.result()))).result() == 7
    )
    keeper.submit_job(refuses, lambda answer: done.append(why_not(answer)))
    assert done == ["7", "the disk refuses"]
    assert keeper.wait_until_idle(0.0)
    assert keeper.silent == 0.0
