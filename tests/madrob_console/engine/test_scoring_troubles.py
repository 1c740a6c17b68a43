"""Whatever becomes of the process that scores, runs get their results."""

from __future__ import annotations

import gc
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.engine.process import scoring_process, scoring_questions
from madrob_console.engine.process.child import Child
from madrob_console.engine.process.scoring_process import ScoringProcess
from madrob_console.referee.acts import (
    DeclareTimeout,
    Finalise,
    Rule,
    Start,
)
from madrob_console.referee.on_record import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Step
from tests.madrob_console.engine.drive import STEP, make_setup
from tests.madrob_console.engine.scored_elsewhere import Referee, alive, ended, pid_of
from tests.madrob_console.engine_process import EngineProcess
from tests.watching import until

pytestmark = pytest.mark.machine


@pytest.fixture
def scorer() -> Iterator[ScoringProcess]:
    with ended(ScoringProcess()) as one:
        yield one


class Moment(StrEnum):
    BEFORE = "before the start"
    COUNTDOWN = "in the countdown"
    RUNNING = "in the run"
    POST_ROLL = "after the stop"
    SCORING = "while it scores"
    RESULT = "when the result is there"


@pytest.mark.parametrize("moment", Moment)
def test_its_end_costs_a_moment_and_no_result(
    tmp_path: Path, scorer: ScoringProcess, moment: Moment
) -> None:
    drive = Referee(tmp_path, scorer)
    killed: list[int] = []

    def kill(now: Moment) -> None:
        if now is moment:
            killed.append(pid_of(scorer))
            os.kill(killed[-1], signal.SIGKILL)
            until(lambda: scorer.pid != killed[-1])
            drive.look()

    kill(Moment.BEFORE)
    drive.prepare(make_setup(countdown=3.0))
    drive.act(Start())
    drive.wait(1.0)
    kill(Moment.COUNTDOWN)
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    drive.wait(3.0)
    kill(Moment.RUNNING)
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED)
    kill(Moment.POST_ROLL)
    if moment is Moment.SCORING:
        os.kill(pid_of(scorer), signal.SIGSTOP)
    drive.stop()
    drive.wait(0.5)
    kill(Moment.SCORING)
    drive.settle()
    drive.verify()
    kill(Moment.RESULT)
    drive.ruled(Rule(Step.TOUCH, confirmed=False, reason="seen"))
    drive.verify()
    assert len(killed) == 1
    assert any("SIGKILL" in fault for fault in drive.faults)
    drive.ruled(Finalise(TeamWord.ABSENT, "R. Eferee"))
    drive.verify()
    drive.engine.close()


@pytest.mark.parametrize("waits", [True, False])
def test_a_process_without_memory_leaves_the_run_safe_and_the_engine_alive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    monkeypatch.setattr(scoring_questions, "DELAYS", (0.0, 0.1))
    poor = tmp_path / "poor"
    limited = (
        "import pathlib, resource, runpy, sys\n"
        f"if pathlib.Path({str(poor)!r}).exists():\n"
        "    resource.setrlimit(resource.RLIMIT_AS, (250_000_000,) * 2)\n"
        "runpy.run_module('madrob_console.engine.process.scoring_program', run_name='__main__')\n"
    )
    poor.touch()
    with ended(ScoringProcess((sys.executable, "-c", limited))) as scorer:
        drive = Referee(tmp_path / "runs", scorer, Scenario.NO_TOUCH)
        drive.start(make_setup(timeout=2.0))
        drive.stop()
        folder = drive.engine.folder
        assert folder is not None

        def told() -> bool:
            drive.look()
            return any(f"`madrob score {folder.name}`" in fault for fault in drive.faults)

        until(told, 60.0)
        assert drive.engine.scored is None
        refused = drive.engine.perform(Finalise(TeamWord.ABSENT, "R. Eferee"))
        assert refused == "the result is being written"
        if waits:
            poor.unlink()
            drive.settle()
            drive.verify()
        else:
            drive.start(make_setup(timeout=2.0, run_number=2))
            unfinished = [run.folder for run in drive.engine.snapshot().unfinished]
            assert unfinished == [f"practice/{folder.name}"]
            assert next(score(folder)).result.outcome == "timeout"
            poor.unlink()
            drive.finish()
            drive.verify()
            assert drive.open(folder) is None
            drive.settle()
            drive.verify()
            assert drive.engine.snapshot().unfinished == ()
        drive.engine.close()


def test_a_process_that_finds_no_room_in_the_middle_costs_that_try(
    tmp_path: Path, scorer: ScoringProcess
) -> None:
    drive = Referee(tmp_path, scorer)
    drive.start(make_setup())
    pid = pid_of(scorer)
    until(lambda: scorer.problem is None)
    size = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.prlimit(pid, resource.RLIMIT_AS, (size, size))
    drive.finish()
    drive.verify()
    drive.engine.close()


@pytest.mark.parametrize(
    "nonsense", ["b'\\xff' * 100", "b'\\0\\0\\0\\1x'", "b'\\0\\0\\0\\2\\xc0\\xc0'"]
)
def test_nonsense_is_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nonsense: str
) -> None:
    monkeypatch.setattr(scoring_questions, "DELAYS", (0.0, 0.1))
    bad = tmp_path / "bad"
    bad.touch()
    program = (
        "import pathlib, runpy, socket, sys, time\n"
        f"if pathlib.Path({str(bad)!r}).exists():\n"
        "    link = socket.socket(fileno=int(sys.argv[1]))\n"
        "    link.recv(1)\n"
        f"    link.sendall({nonsense})\n"
        "    time.sleep(60)\n"
        "runpy.run_module('madrob_console.engine.process.scoring_program', run_name='__main__')\n"
    )
    with ended(ScoringProcess((sys.executable, "-c", program))) as scorer:
        drive = Referee(tmp_path / "runs", scorer, Scenario.NO_TOUCH)
        drive.start(make_setup(timeout=2.0))
        drive.stop()

        def told() -> bool:
            drive.look()
            return any("not a message" in fault for fault in drive.faults)

        until(told)
        bad.unlink()
        drive.settle()
        drive.verify()
        drive.engine.close()


def test_one_that_cannot_keep_up_holds_up_nobody_and_fills_no_memory(
    tmp_path: Path, scorer: ScoringProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_questions, "MOST_WAITING", 3_000)
    drive = Referee(tmp_path, scorer, Scenario.NO_CLOSE)
    drive.start(make_setup(timeout=60.0))
    os.kill(pid_of(scorer), signal.SIGSTOP)
    slowest = 0.0
    while drive.engine.run.phase is Phase.RUNNING:
        began = time.monotonic()
        drive.engine.step(STEP)
        slowest = max(slowest, time.monotonic() - began)
        assert len(scorer._questions) <= 3_001
    assert not scorer._questions.following  # it was given up
    assert slowest < 1.0
    os.kill(pid_of(scorer), signal.SIGCONT)
    drive.finish()
    drive.verify()
    drive.engine.close()


def test_one_that_hangs_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scoring_process, "PATIENCE", 4.0)
    monkeypatch.setattr(scoring_process, "SOON", 0.5)
    hangs = tmp_path / "hangs"
    hangs.touch()
    program = (
        "import pathlib, runpy, time\n"
        f"if pathlib.Path({str(hangs)!r}).exists():\n"
        "    time.sleep(600)\n"
        "runpy.run_module('madrob_console.engine.process.scoring_program', run_name='__main__')\n"
    )
    with ended(ScoringProcess((sys.executable, "-c", program))) as scorer:
        drive = Referee(tmp_path / "runs", scorer, Scenario.NO_TOUCH)
        drive.start(make_setup(timeout=2.0))
        hanging = pid_of(scorer)
        drive.stop()

        def said(words: str) -> bool:
            drive.look()
            return any(words in fault for fault in drive.faults)

        until(lambda: said("computed: the scoring process does not move; the run is safe on disk"))
        assert scorer.pid == hanging
        hangs.unlink()
        until(lambda: said("the scoring process is started again: it did not move for 4 s; the"))
        monkeypatch.setattr(scoring_process, "PATIENCE", 30.0)
        drive.settle()
        drive.verify()
        drive.engine.close()


def test_one_that_works_for_long_is_said_to(
    tmp_path: Path, scorer: ScoringProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = Referee(tmp_path, scorer, Scenario.NO_TOUCH)
    drive.start(make_setup(timeout=2.0))
    monkeypatch.setattr(scoring_process, "SOON", 1e-9)
    monkeypatch.setattr(Child, "moved", lambda _, now: now)
    drive.finish()
    (fault,) = [fault for fault in drive.faults if "computed" in fault]
    assert fault == (
        "the result is being computed: the scoring process works on it; the run is safe on disk"
    )
    drive.verify()
    drive.engine.close()


def test_one_that_somebody_stopped_is_replaced_and_the_result_is_soon_there(
    tmp_path: Path,
) -> None:
    with EngineProcess(tmp_path, "no-touch") as engine:
        stopped = until(lambda: scorers_of(engine.process.pid))
        engine.start(make_setup(countdown=1.0, timeout=600.0))
        os.kill(stopped[0], signal.SIGSTOP)
        engine.act(DeclareTimeout("enough"))
        began, told = time.monotonic(), set[str]()

        def there() -> bool:
            shown = engine.client.snapshot()
            told.update(shown.faults)
            return shown.result is not None

        until(there, scoring_process.PATIENCE - 1.0)
        print(f"\na result {time.monotonic() - began:.1f} s after the stop")
        words = (
            "the result is being computed: the scoring process is started again: it was stopped "
            "for 2 s; the run is safe on disk"
        )
        assert words in told
        assert stopped != scorers_of(engine.process.pid)


def test_no_handles_for_a_process_is_told_and_tried_again(
    tmp_path: Path, scorer: ScoringProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_questions, "DELAYS", (0.0, 0.1))
    drive = Referee(tmp_path, scorer, Scenario.NO_TOUCH)
    drive.start(make_setup(timeout=2.0))
    first = pid_of(scorer)
    gc.collect()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        os.kill(first, signal.SIGKILL)
        until(lambda: "Too many open files" in (scorer.problem or ""))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    drive.finish()
    drive.verify()
    drive.engine.close()


def scorers_of(parent: int) -> list[int]:
    found = []
    for pid in children_of(parent):
        with suppress(OSError):
            if b"scoring_program" in Path(f"/proc/{pid}/cmdline").read_bytes():
                found.append(pid)
    return found


def children_of(parent: int) -> list[int]:
    found = Path(f"/proc/{parent}/task/{parent}/children")
    tasks = Path(f"/proc/{parent}/task").glob("*/children")
    return [int(pid) for path in (found, *tasks) for pid in path.read_text().split()]


def test_nothing_of_it_survives_the_engine(tmp_path: Path) -> None:
    with EngineProcess(tmp_path, "no-touch") as engine:
        pids = until(lambda: children_of(engine.process.pid))
        engine.start(make_setup(countdown=1.0))
        engine.process.send_signal(signal.SIGKILL)
        engine.process.wait(30.0)
        until(lambda: not any(map(alive, pids)))
