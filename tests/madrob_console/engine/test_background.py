"""Work beside the engine: one process at a time, and none while a run goes on."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

from madrob_console.cli import aside
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import whole_file
from madrob_console.engine import reports
from madrob_console.engine.disk import DiskJobs, DiskThread, InlineDisk, why_not
from madrob_console.engine.reports import Background, Finished, Reporting
from madrob_console.engine.snapshot import ExportView
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.run_folders import summary, write
from tests.watching import PATIENCE, until

BEGIN = """
import signal, sys
from madrob_console.cli import aside
signal.signal(signal.SIGTERM, aside._end)
exec(sys.argv.pop(1))
"""

SLOW = """
import sys, time
from madrob_console.common.files import whole_file
from pathlib import Path
with whole_file(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    Path(sys.argv[1] + ".begun").touch()
    time.sleep(60)
"""

UNTIL_TOLD = """
import sys, time
from pathlib import Path
Path(sys.argv[1]).touch()
while not Path(sys.argv[2]).exists():
    time.sleep(0.01)
"""


SHORT_PAUSE = 0.2


class Hall:
    """A run goes on or not; what came of the chores."""

    def __init__(self, command: Sequence[str] = aside.COMMAND) -> None:
        self.busy = False
        self.done: list[tuple[str, Finished]] = []
        self.background = Background(command, lambda: self.busy, SHORT_PAUSE)

    def ask(self, name: str, *arguments: str) -> None:
        self.background.submit_chore(
            name, arguments, lambda finished: self.done.append((name, finished))
        )

    def close(self) -> None:
        self.background.close(PATIENCE)

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.done]


@pytest.fixture
def hall() -> Iterator[Hall]:
    hall = Hall()
    yield hall
    hall.close()


@pytest.fixture
def quick_hall() -> Iterator[Hall]:
    """Its chores are no `madrob`, to be quick: python code and its arguments."""
    hall = Hall((sys.executable, "-c", BEGIN))
    yield hall
    hall.close()


@pytest.mark.machine
def test_a_chore_comes_after_everything_else() -> None:
    code = "import atexit, os, sys; atexit.register(lambda: print(os.nice(0)));"
    code += "from madrob_console.cli import aside; sys.exit(aside.main())"
    told = subprocess.run(
        [sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=True
    )
    assert told.stdout.splitlines()[-1] == str(min(19, os.nice(0) + aside.NICENESS))


@pytest.mark.machine
def test_a_chore_is_a_madrob_command(hall: Hall) -> None:
    hall.ask("version", "--version")
    hall.ask("bad", "export", "--team=zero")
    assert hall.background.wait(PATIENCE)
    (_, good), (_, bad) = hall.done
    assert good.code == 0
    assert good.said.startswith("madrob ")
    assert bad.code == 2
    assert "zero" in bad.complained


@pytest.mark.machine
def test_what_is_asked_for_again_before_it_begins_is_done_once(quick_hall: Hall) -> None:
    quick_hall.busy = True
    for number in range(5):
        quick_hall.ask("report", f"print({number})")
    quick_hall.ask("zip", "print('zip')")
    time.sleep(3 * reports.PERIOD)
    assert quick_hall.done == []
    quick_hall.busy = False
    assert quick_hall.background.wait(PATIENCE)
    assert [(name, finished.said) for name, finished in quick_hall.done] == [
        ("report", "4"),
        ("zip", "zip"),
    ]


@pytest.mark.machine
def test_what_is_asked_for_while_it_is_done_is_done_once_more(
    quick_hall: Hall, tmp_path: Path
) -> None:
    begun, may_end = tmp_path / "begun", tmp_path / "may end"
    quick_hall.ask("report", UNTIL_TOLD, str(begun), str(may_end))
    until(begun.exists)
    quick_hall.ask("report", "print('second')")
    quick_hall.ask("report", "print('third')")
    may_end.touch()
    assert quick_hall.background.wait(PATIENCE)
    assert [finished.said for _, finished in quick_hall.done] == ["", "third"]


@pytest.mark.machine
def test_a_run_cuts_a_chore_short_which_leaves_nothing_and_is_done_again_after_it(
    quick_hall: Hall, tmp_path: Path
) -> None:
    target = tmp_path / "report.html"
    begun = tmp_path / "report.html.begun"
    quick_hall.ask("report", SLOW, str(target))
    until(begun.exists)
    assert len(list(tmp_path.iterdir())) == 2  # the file has another name still
    quick_hall.busy = True
    until(lambda: list(tmp_path.iterdir()) == [begun])
    begun.unlink()
    assert quick_hall.done == []
    quick_hall.ask("report", "print('after the run')")
    time.sleep(3 * reports.PERIOD)
    assert quick_hall.done == []
    quick_hall.busy = False
    assert quick_hall.background.wait(PATIENCE)
    assert [finished.said for _, finished in quick_hall.done] == ["after the run"]


@pytest.mark.machine
def test_a_process_that_cannot_be_started_is_told_in_words() -> None:
    reporting = Reporting(["/no/such/python"], lambda: False)
    reporting.report(Path("/results/run"))
    reporting.export(3)
    assert reporting.wait(PATIENCE)
    assert reporting.problem is not None
    assert "no report of run: no process could be started" in reporting.problem
    assert reporting.exported is not None
    assert "no process could be started" in reporting.exported.problem
    reporting.close(PATIENCE)


@contextmanager
def no_file_handles() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.machine
def test_without_file_handles_a_chore_is_told_with_the_remedy_and_done_when_there_are_some(
    quick_hall: Hall,
) -> None:
    with no_file_handles():
        quick_hall.ask("report", "print('made')")
        until(lambda: len(quick_hall.done) >= 2)
        assert quick_hall.background.wait(PATIENCE)  # nobody waits for what may never be
        for _, finished in quick_hall.done:
            assert (finished.code, finished.again) == (None, True)
            assert "Too many open files" in finished.complained
            assert "ulimit -n" in finished.complained
    until(lambda: quick_hall.done[-1][1] == Finished(0, "made", ""))


@pytest.mark.machine
@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.ENOMEM, "Cannot allocate memory")])
def test_without_memory_a_chore_is_told_with_the_remedy_and_done_when_there_is_some(
    quick_hall: Hall, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise error

    with monkeypatch.context() as short:
        short.setattr(subprocess, "Popen", refuse)
        quick_hall.ask("report", "print('made')")
        until(lambda: quick_hall.done)
        said = quick_hall.done[0][1]
        assert said.complained.endswith("(Cannot allocate memory); end other programs")
    until(lambda: quick_hall.done[-1][1] == Finished(0, "made", ""))


@pytest.mark.machine
def test_what_was_killed_or_says_that_it_may_work_later_is_done_again(
    quick_hall: Hall, tmp_path: Path
) -> None:
    for number, end in enumerate((f"sys.exit({os.EX_TEMPFAIL})", "os.kill(os.getpid(), 9)")):
        there = tmp_path / str(number)
        code = f"import os, sys; os.path.exists(sys.argv[1]) or {end}; print('made')"
        quick_hall.ask("report", code, str(there))
        until(lambda: quick_hall.done)
        assert quick_hall.done.pop()[1].again
        there.touch()
        until(lambda: quick_hall.done and quick_hall.done[-1][1] == Finished(0, "made", ""))
        quick_hall.done.clear()


@pytest.mark.machine
def test_what_rests_after_a_failure_gives_way_to_what_is_asked_anew(quick_hall: Hall) -> None:
    quick_hall.ask("report", f"sys.exit({os.EX_TEMPFAIL})")
    until(lambda: quick_hall.done)
    quick_hall.ask("report", "print('new')")
    until(lambda: quick_hall.done[-1][1].said == "new")
    time.sleep(3 * SHORT_PAUSE)
    assert quick_hall.done[-1][1].said == "new"


@pytest.mark.machine
def test_a_chore_that_can_never_be_done_is_told_once_and_the_next_one_is_done(
    quick_hall: Hall,
) -> None:
    quick_hall.ask("bad", "print('a null byte: \0')")
    quick_hall.ask("good", "print('good')")
    assert quick_hall.background.wait(PATIENCE)
    (_, bad), (_, good) = quick_hall.done
    assert (bad.code, bad.again) == (None, False)
    assert "null byte" in bad.complained
    assert good.said == "good"


@pytest.mark.machine
def test_a_temporary_folder_that_is_gone_stops_neither_reports_nor_exports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "gone"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    write(tmp_path / "runs", summary(3))
    with closing(Hall()) as hall:
        hall.ask("zip", "export", "--team=3", f"--results={tmp_path / 'runs'}")
        assert hall.background.wait(PATIENCE)
        [(_, finished)] = hall.done
        assert (finished.code, finished.said[-4:]) == (0, ".zip")


def scored_run(results: Path) -> Path:
    drive = Drive(results)
    drive.whole_run(make_setup(timeout=1.0))
    drive.engine.close()
    return drive.folder


@pytest.mark.machine
def test_a_report_that_the_disk_refuses_is_a_fault_until_it_is_made(tmp_path: Path) -> None:
    folder = scored_run(tmp_path)
    page = folder / "report.html"
    page.mkdir()
    reporting = Reporting(aside.COMMAND, lambda: False, pause=SHORT_PAUSE)
    reporting.report(folder)
    until(lambda: reporting.problem is not None)
    assert reporting.problem is not None
    assert f"no report of {folder.name}: " in reporting.problem
    assert "make room or choose another folder; it is tried again" in reporting.problem
    page.rmdir()
    until(lambda: reporting.problem is None)
    assert page.is_file()
    reporting.close(PATIENCE)


@pytest.mark.machine
def test_a_report_of_a_run_that_was_deleted_is_not_tried_again(tmp_path: Path) -> None:
    folder = scored_run(tmp_path)
    shutil.rmtree(folder)
    reporting = Reporting(aside.COMMAND, lambda: False, pause=SHORT_PAUSE)
    reporting.report(folder)
    assert reporting.wait(PATIENCE)
    assert reporting.problem is not None
    assert "tried again" not in reporting.problem
    reporting.close(PATIENCE)


@pytest.mark.machine
def test_an_export_that_failed_is_not_under_way_and_is_there_when_it_can_be(
    tmp_path: Path,
) -> None:
    write(tmp_path / "runs", summary(3))
    options = [f"--results={tmp_path / 'runs'}"]
    reporting = Reporting(aside.COMMAND, lambda: False, options, pause=SHORT_PAUSE)
    with no_file_handles():
        reporting.export(3)
        until(lambda: reporting.exported != ExportView(3))
        assert reporting.exported is not None
        assert "Too many open files" in reporting.exported.problem
        assert "tried again" in reporting.exported.problem
    until(lambda: reporting.exported is not None and reporting.exported.path != "")
    reporting.close(PATIENCE)


@pytest.mark.machine
def test_a_zip_that_cannot_be_made_is_told_in_a_line(tmp_path: Path) -> None:
    reporting = Reporting(aside.COMMAND, lambda: False, [f"--results={tmp_path}"])
    reporting.export(3)
    assert reporting.exported == ExportView(3)
    reporting.close(PATIENCE)
    assert reporting.problem is None
    assert reporting.exported is not None
    assert reporting.exported.path == ""
    assert "subject 3 has no runs" in reporting.exported.problem


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
    keeper: DiskJobs = InlineDisk()
    done: list[str | None] = []
    assert (
        keeper.submit_job(lambda: 7, lambda answer: done.append(str(answer.result()))).result() == 7
    )
    keeper.submit_job(refuses, lambda answer: done.append(why_not(answer)))
    assert done == ["7", "the disk refuses"]
    assert keeper.wait_until_idle(0.0)
    assert keeper.silent == 0.0
