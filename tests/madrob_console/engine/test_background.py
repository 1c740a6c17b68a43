"""Work beside the engine: on the disk, in a thread of its own; readings; questions to a process."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.engine.runtime.disk import ENDED, FULL, DiskThread, why_not
from madrob_console.engine.runtime.disk_watch import RepeatedReading
from madrob_console.engine.runtime.worker_questions import question_parts
from scoring.assessment import Assessment
from scoring.samples import DoorSample, HandleSample
from tests.madrob_console.engine.drive import PULL
from tests.watching import PATIENCE, until


def test_a_file_that_is_cut_short_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "a") as file:  # noqa: PT012
        file.write(b"half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


class Hall:
    """A disk thread, its clock, and what was told of its jobs."""

    def __init__(self) -> None:
        self.now = 100.0
        self.thread = DiskThread("a keeper", most_jobs=3, monotonic=lambda: self.now)
        self.go_on = threading.Event()
        self.told: list[str | None] = []

    def ask(self, job: Callable[[], object], *, first: bool = True) -> Future[object]:
        def done(answer: Future[object]) -> None:
            self.told.append(why_not(answer) or f"{answer.result()} {here()}")

        return self.thread.submit_job(job, done, first=first)

    def hang(self) -> None:
        """A job is under way until it may go on."""
        until(self.ask(lambda: self.go_on.wait(PATIENCE)).running)

    def settle(self) -> None:
        self.go_on.set()
        until(lambda: self.thread.wait_until_idle(0.0))


def here() -> str:
    return threading.current_thread().name


@pytest.fixture
def hall() -> Iterator[Hall]:
    hall = Hall()
    yield hall
    hall.go_on.set()
    hall.thread.close(PATIENCE)


def refuses() -> None:
    raise MadrobError("the disk refuses")


def breaks() -> None:
    raise ValueError("a bug")


def test_jobs_are_done_in_turn_and_told_of_in_the_thread_that_asks_for_it(hall: Hall) -> None:
    for job in (refuses, breaks, here):
        answer = hall.ask(job)
    assert answer.result(PATIENCE) == "a keeper"
    assert hall.told == []  # nothing is told before it is asked for
    hall.settle()
    assert hall.told == ["the disk refuses", "ValueError: a bug", f"a keeper {here()}"]


def test_one_that_hangs_is_silent_until_it_answers(hall: Hall) -> None:
    assert hall.thread.silent == 0.0
    hall.hang()
    hall.now += 7.0
    assert hall.thread.silent == 7.0
    hall.settle()
    assert hall.thread.silent == 0.0


def test_what_finds_no_room_is_refused_and_what_is_first_or_cancelled_goes_before(
    hall: Hall,
) -> None:
    hall.hang()
    others = [hall.ask(lambda n=number: n, first=False) for number in range(3)]  # type: ignore[misc]
    hall.ask(lambda: None, first=False)
    hall.thread.deliver()
    assert hall.told == [FULL]
    assert others[0].cancel()
    hall.ask(lambda: "a referee's", first=True)
    hall.settle()
    assert [str(told).split()[0] for told in hall.told[1:]] == ["True", "a", "1", "2"]


def test_settling_waits_for_what_answers_ask_for_too(hall: Hall) -> None:
    def again(_answer: Future[None]) -> None:
        hall.ask(lambda: "second")

    hall.thread.submit_job(lambda: None, again)
    hall.settle()
    assert hall.told == [f"second {here()}"]


def test_closing_does_what_was_asked_for_and_leaves_a_job_that_hangs_to_itself(hall: Hall) -> None:
    for number in range(3):
        hall.ask(lambda number=number: number)  # type: ignore[misc]
    hall.settle()
    assert len(hall.told) == 3
    hall.go_on.clear()
    hall.hang()
    waits = hall.ask(lambda: 7)
    assert not hall.thread.wait_until_idle(0.0)
    hall.thread.close(0.0)
    assert len(hall.told) == 3
    for one in (waits, hall.ask(lambda: None)):
        with pytest.raises(MadrobError, match=ENDED):
            one.result(PATIENCE)


NEVER = 1e6
"""A period in which nothing is looked at but by the test, s."""


class Archive:
    """A value that is read when a test says so."""

    def __init__(self, *, forgets: bool) -> None:
        self.asked: list[Future[str]] = []
        self.reading = RepeatedReading(str, self.submit, NEVER, "unknown", forgets=forgets)

    def submit(self, _job: Callable[[], str], done: Callable[[Future[str]], None]) -> None:
        self.asked.append(Future())
        self.asked[-1].add_done_callback(done)


def test_a_value_is_read_again_after_a_change_and_a_while_one_reading_at_a_time() -> None:
    archive = Archive(forgets=False)
    look = archive.reading.look
    assert look(0.0, "a result") == "unknown"
    archive.asked[-1].set_result("first")
    assert look(1.0, "a result") == "first"
    assert len(archive.asked) == 1
    assert look(1.0, "another") == look(2.0, "a third") == "first"  # the reading goes on
    assert len(archive.asked) == 2
    archive.asked[-1].set_result("second")
    assert look(2.0, "another") == "second"
    look(NEVER + 1.0, "another")
    assert len(archive.asked) == 3


@pytest.mark.parametrize("forgets", [False, True])
def test_a_value_that_cannot_be_read_is_forgotten_where_an_old_one_says_nothing(
    forgets: bool,
) -> None:
    archive, kept = Archive(forgets=forgets), "unknown" if forgets else "known"
    look = archive.reading.look
    look(0.0)
    archive.asked[-1].set_result("known")
    look(NEVER)
    assert look(NEVER + 1.0) == "known"  # its answer is not late yet
    assert look(2 * NEVER) == kept
    archive.asked[-1].set_exception(MadrobError("the disk is away"))
    assert look(2 * NEVER) == kept
    archive.asked[-1].set_result("known again")
    assert archive.reading.value == "known again"


def test_the_samples_of_a_run_are_sent_without_copying_them() -> None:
    run = Assessment(PULL, 100.0)
    for number in range(60_000):
        at = 100.0 + number / 500
        run.feed(DoorSample(at, at, 0.0))
        run.feed(HandleSample(at, at, 0.0))
    head, *parts = question_parts(7, run)
    copied = [part for part in parts if isinstance(part, bytes)]
    assert sum(map(len, copied)) < sum(map(len, parts)) / 10
    number, sizes = pickle.loads(head)
    arrays = [bytes(part) for part in parts if isinstance(part, memoryview)]
    assert (number, sizes) == (7, [len(each) for each in arrays])
    again = pickle.loads(b"".join(copied), buffers=arrays)
    assert (again.newest, again.quality()) == (run.newest, run.quality())
