"""What waits beside the engine: messages, jobs on the disk, readings, questions to a process."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.engine.runtime.backlog import CAPACITY, LATEST, Backlog
from madrob_console.engine.runtime.disk import ENDED, FULL, DiskThread, why_not
from madrob_console.engine.runtime.disk_watch import RepeatedReading
from madrob_console.engine.runtime.worker_questions import question_parts
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.acts import Abort, DeclareTimeout, Start
from madrob_console.referee.run import Phase
from recorder.bag import RawMessage
from scoring.assessment import Assessment
from scoring.protocol import Outcome, Signal
from scoring.samples import DoorSample, HandleSample
from tests.madrob_console.engine.drive import PULL, STEP, TIMEOUT, Drive, FaultyDrive, make_setup
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
        run.release(at)
    head, *parts = question_parts(7, run)
    copied = [part for part in parts if isinstance(part, bytes)]
    assert sum(map(len, copied)) < sum(map(len, parts)) / 10
    number, sizes = pickle.loads(head)
    arrays = [bytes(part) for part in parts if isinstance(part, memoryview)]
    assert (number, sizes) == (7, [len(each) for each in arrays])
    again = pickle.loads(b"".join(copied), buffers=arrays)
    assert (again.newest, again.quality()) == (run.newest, run.quality())


class Looking:
    """Who looks at messages, and a monotonic clock that each of them moves on by what it takes."""

    def __init__(self, cost: float = 0.0) -> None:
        self.now = 100.0
        self.cost = cost
        self.seen: list[tuple[int, bool, bool]] = []
        self.backlog = Backlog(self.observe, lambda: self.now)

    def observe(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        self.now += self.cost
        self.seen.append((message.receive_ns, recorded, shown))

    def add(self, count: int, first: int = 0, size: int = 1, *, recorded: bool = False) -> None:
        numbers = range(first, first + count)
        messages = [RawMessage("/t", "t", bytes(size), n, n) for n in numbers]
        self.backlog.add_messages(messages, recorded=recorded)


@pytest.mark.parametrize(
    ("cost", "waits", "seen"),
    [(0.0, True, 1), (0.0, False, 9), (0.015, False, 2)],
    ids=[
        "its owner has a turn when it wants one",
        "else it goes on",
        "but for no longer than this",
    ],
)
def test_between_two_messages_its_owner_may_have_a_turn(
    cost: float, waits: bool, seen: int
) -> None:
    looking = Looking(cost)
    looking.add(9, recorded=True)
    looking.backlog.work_off(lambda: waits)
    assert looking.seen == [(number, True, True) for number in range(seen)]
    assert len(looking.backlog) == looking.backlog.recorded == 9 - seen


def test_what_is_late_is_judged_but_not_shown_and_that_is_said_for_a_while() -> None:
    looking = Looking(cost=0.1)
    backlog = looking.backlog
    looking.add(10, recorded=True)
    while len(backlog):
        backlog.work_off(lambda: False)
    assert looking.seen == [(number, True, number < 6) for number in range(10)]
    assert "4 messages are recorded but not shown" in str(backlog.problem)
    looking.now += 2.1
    assert backlog.problem is None
    looking.cost = 1.0
    looking.add(5)
    backlog.work_off()
    assert [shown for *_, shown in looking.seen[10:]] == [True] * 5  # to the end nothing is late


def test_who_is_behind_says_how_far_and_up_to_when_all_was_seen() -> None:
    looking = Looking()
    backlog = looking.backlog
    assert (backlog.behind, backlog.judged_until(50.0), backlog.problem) == (0.0, 50.0, None)
    looking.add(2, first=20 * NS)
    looking.now += LATEST + 0.3
    assert backlog.judged_until(50.0) == 20.0
    assert backlog.behind == pytest.approx(0.8)
    assert str(backlog.problem).startswith("the engine is 0.8 s behind")
    backlog.note_pause(3.54)
    assert backlog.problem == "the engine stood still for 3.5 s"


def test_what_waits_is_bounded_in_bytes() -> None:
    looking = Looking()
    looking.add(8, size=CAPACITY // 8)
    assert looking.backlog.full
    looking.backlog.work_off(lambda: True)
    assert not looking.backlog.full


# ---------------------------------------------------------------------- the engine


class HeldUp(FaultyDrive):
    """An engine that somebody wants something of after each message, from `hold_up` on."""

    def __init__(self, results: Path) -> None:
        super().__init__(results, lossless=False)

    def hold_up(self, duration: float) -> None:
        """Six messages come in a step, one is looked at."""
        end = self.engine.now() + duration
        while self.engine.now() < end:
            self.engine.step(STEP, lambda: True)
            self.clock.sleep(STEP)


def test_an_abort_takes_effect_though_hundreds_of_messages_wait_and_all_are_judged(
    tmp_path: Path,
) -> None:
    drive = HeldUp(tmp_path)
    drive.set_up()
    drive.begin()
    drive.wait(4.0)
    drive.hold_up(3.0)
    said = drive.engine.now()
    drive.act(Abort("enough"))
    assert (drive.engine.run.phase, drive.engine.run.stop) == (Phase.STOPPED, said)
    drive.hold_up(1.5)  # the post-roll is over, and what it recorded waits
    assert drive.engine.scored is None
    result = drive.scored_result()
    assert drive.rescored() == result


@pytest.mark.parametrize("declared", [False, True])
def test_a_timeout_is_judged_by_all_that_was_measured_before_it(
    declared: bool, tmp_path: Path
) -> None:
    drive = HeldUp(tmp_path)
    drive.set_up()
    drive.begin()
    drive.wait(13.5)  # the robot is done 13.85 s after the start, which is 1 s after that
    drive.hold_up(1.6 if declared else TIMEOUT - 12.5)
    if declared:
        drive.act(DeclareTimeout("it was done, was it not?"))
    drive.hold_up(0.5)
    run = drive.engine.run
    assert (run.phase, run.timeout_at is not None) == (Phase.RUNNING, True)
    result = drive.scored_result()
    assert drive.engine.run.outcome is Outcome.COMPLETED
    assert drive.rescored() == result
    for topic in drive.topics():
        assert drive.recorded(topic) == drive.handed(topic)[: len(drive.recorded(topic))]


def test_what_waited_when_the_recording_began_is_judged_in_a_replay_too(tmp_path: Path) -> None:
    headerless = [
        TopicMapping(m.signal, m.topic, "std_msgs/msg/Float64", "data")
        if m.signal in (Signal.DOOR, Signal.HANDLE)
        else m
        for m in DEFAULT_MAPPINGS
    ]
    drive = Drive(tmp_path, mappings=headerless)
    drive.prepare(make_setup())
    drive.clock.sleep(0.24)  # so long nothing is taken by a busy machine: twelve samples
    drive.act(Start())
    drive.same_everywhere()
