"""Runs that are scored in a process of its own: what comes of it is the same."""

from __future__ import annotations

import copy
import gc
import math
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.common.errors import MadrobError
from madrob_console.engine import scoring_process, supervisor
from madrob_console.engine.disk import DiskThreads
from madrob_console.engine.scorer import RenderedResult, Scorer, ToScore
from madrob_console.engine.scoring_process import ScoringProcess
from madrob_console.engine.supervisor import Supervisor
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.acts import (
    Abort,
    Correct,
    DeclareTimeout,
    Finalise,
    Reissue,
    RestartCountdown,
    Rule,
    Start,
)
from madrob_console.referee.checks import blocking
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from madrob_console.ui.panes.result_pane import ResultHead
from scoring.protocol import Condition, Signal, Step
from scoring.rulesets import RulesetName
from scoring.signals import DoorSample, HandleSample
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.scored_elsewhere import Referee, alive, kept_running, pid_of
from tests.madrob_console.engine_process import EngineProcess
from tests.watching import until

pytestmark = pytest.mark.machine


class Twins(ScoringProcess):
    """Has every run scored here, too, and keeps what comes of both."""

    def __init__(self) -> None:
        super().__init__()
        self.pairs: list[tuple[RenderedResult, RenderedResult]] = []

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        mine: list[RenderedResult] = []
        own = replace(wanted, assessment=copy.deepcopy(wanted.assessment))
        Scorer().score(own, mine.append)

        def both(theirs: RenderedResult) -> None:
            self.pairs.append((mine[0], theirs))
            done(theirs)

        super().score(wanted, both)


@pytest.fixture
def scorer() -> Iterator[ScoringProcess]:
    with kept_running(ScoringProcess()) as one:
        yield one


@pytest.fixture
def drive(tmp_path: Path, scorer: ScoringProcess) -> Iterator[Referee]:
    drive = Referee(tmp_path, scorer)
    yield drive
    drive.engine.close()


@pytest.mark.parametrize("ruleset", RulesetName)
def test_its_bytes_are_those_that_are_made_here(tmp_path: Path, ruleset: RulesetName) -> None:
    with kept_running(Twins()) as twins:
        drive = Referee(tmp_path, twins, Scenario.SLAM)
        drive.prepare(make_setup(ruleset=ruleset))
        drive.act(Start())
        drive.wait(1.0)
        drive.act(RestartCountdown("a person in the doorway"))
        drive.finish()
        drive.ruled(
            Rule(Step.TOUCH, confirmed=False, reason="seen"),
            Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"),
            Reissue("again"),
        )
        drive.verify()
        drive.start(make_setup(ruleset=ruleset, run_number=2))
        drive.act(Abort("enough"))
        drive.finish()
        drive.verify()
        assert len(twins.pairs) >= 4
        for here, there in twins.pairs:
            assert (here.result, here.past, here.run) == (there.result, there.past, there.run)
            assert {**here.files} == {name: bytes(each) for name, each in there.files.items()}
            assert list(here.files) == list(there.files)
            assert here.curves == there.curves
        drive.engine.close()


def test_what_could_not_be_decoded_is_told_by_both(tmp_path: Path) -> None:
    with kept_running(Twins()) as twins:
        drive = Referee(tmp_path, twins, Scenario.NO_TOUCH)
        door = next(m.topic for m in DEFAULT_MAPPINGS if m.signal is Signal.DOOR)
        drive.start(make_setup(timeout=3.0))
        take = drive.source.take_messages

        def spoilt(timeout: float) -> list[object]:
            return [
                m.__class__(m.topic, m.type, m.data[:9], m.publish_ns, m.receive_ns)
                if m.topic == door and m.receive_ns % 7 == 0
                else m
                for m in take(timeout)
            ]

        drive.source.take_messages = spoilt  # type: ignore[method-assign, assignment]
        drive.finish()
        (pair,) = twins.pairs
        assert pair[0].result == pair[1].result
        assert any(door in remark for remark in pair[1].result.quality.remarks)
        assert next(score(drive.folder)).result == pair[1].result
        drive.engine.close()


def test_an_earlier_run_is_read_there_and_goes_on(drive: Referee, scorer: ScoringProcess) -> None:
    drive.start(make_setup())
    drive.finish()
    drive.ruled(Rule(Step.TOUCH, confirmed=False, reason="seen"))
    first = drive.folder
    shown = drive.engine.snapshot()
    drive.start(make_setup(run_number=2))
    drive.finish()
    assert drive.open(first) is None
    again = drive.engine.snapshot()
    for name in ("result", "steps", "provisional", "run"):
        assert getattr(again, name) == getattr(shown, name), name
    os.kill(pid_of(scorer), signal.SIGKILL)
    drive.ruled(Rule(Step.TOUCH, confirmed=None, reason="right"))
    drive.verify()


def test_what_cannot_be_read_is_refused_in_words_and_so_is_what_comes_too_late(
    tmp_path: Path,
) -> None:
    (tmp_path / "run").mkdir()
    scorer = ScoringProcess()
    running = Supervisor(scorer)
    with pytest.raises(MadrobError, match="run"):
        scorer.read(tmp_path / "run").result()
    os.kill(pid_of(scorer), signal.SIGSTOP)
    waiting = scorer.read(tmp_path / "run")
    running.close()
    with pytest.raises(MadrobError, match="the engine has ended"):
        waiting.result(10.0)


def test_a_result_that_is_out_of_date_is_not_shown_for_long(
    drive: Referee, scorer: ScoringProcess
) -> None:
    drive.start(make_setup())
    drive.finish()
    assert drive.engine.snapshot().result is not None
    os.kill(pid_of(scorer), signal.SIGSTOP)
    drive.act(Rule(Step.TOUCH, confirmed=False, reason="seen"))

    def old() -> bool:
        drive.engine.step(0.0)
        return drive.engine.snapshot().rescoring

    until(old, 5.0)
    shown = drive.engine.snapshot()
    assert shown.result is None
    assert shown.steps[Step.TOUCH - 1].denied
    head = [span.text for line in ResultHead().draw_lines(shown, 80) for span in line]
    assert head == ["The result is being scored again: the one that was here is out of date."]
    assert "finalise" in shown.refusals
    os.kill(pid_of(scorer), signal.SIGCONT)
    drive.settle()
    again = drive.engine.snapshot()
    assert again.result is not None
    assert again.result.steps[Step.TOUCH - 1].denied
    assert not again.rescoring
    drive.verify()


@pytest.mark.slow
def test_a_run_of_three_hours_makes_nobody_wait_for_its_scoring(
    tmp_path: Path, scorer: ScoringProcess
) -> None:
    """Two sensors at 100 Hz: their samples are fed, for the recording is not what is measured."""
    hours, rate = 3.0, 100.0
    drive = Referee(tmp_path, scorer, Scenario.NO_CLOSE, DiskThreads.threads())
    drive.prepare(make_setup(timeout=86_400.0))

    def ready() -> bool:
        drive.engine.step(0.0)
        return not blocking(drive.engine.situation().checks)

    until(ready)
    drive.act(Start())
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    course, start = drive.engine._observation.course, drive.engine.run.start
    assert course is not None
    assert start is not None
    for number in range(int(hours * 3600 * rate)):
        at = start + 30.0 + number / rate
        course.feed(DoorSample(at, at, 0.5 + 0.4 * math.sin(number / 150)))
        course.feed(HandleSample(at, at, 5.0 * math.cos(number / 90)))
    drive.source.take_messages = lambda timeout: []  # type: ignore[method-assign]
    drive.clock.sleep(hours * 3600 + 60.0)
    drive.act(DeclareTimeout("enough"))
    deaf: list[float] = []
    before = time.monotonic()
    while not drive.engine.situation().scored:
        drive.clock.sleep(0.01)
        drive.engine.step(0.0)
        now = time.monotonic()
        deaf.append(now - before)
        before = now
        time.sleep(0.001)
    assert drive.engine.scored is not None
    files = drive.engine.scored.files
    took, size = sum(deaf), sum(map(len, files.values()))
    print(f"\nscored in {took:.1f} s, {size / 1e6:.0f} MB, deaf for {1000 * max(deaf):.0f} ms")
    assert scorer.problem is None
    assert size > 100_000_000
    assert took > 1.0
    assert max(deaf) <= 0.1
    drive.engine.close()


def test_an_engine_that_is_closed_in_a_run_has_its_result(tmp_path: Path) -> None:
    with kept_running(ScoringProcess()) as scorer:
        drive = Referee(tmp_path, scorer)
        drive.start(make_setup())
        drive.wait(4.0)
        pid = pid_of(scorer)
        drive.engine.close()
        assert drive.engine.scored is not None
        assert drive.engine.scored.result.outcome == "interrupted"
        assert (drive.folder / "result.json").exists()
    assert not alive(pid)


def test_samples_come_from_the_engine_once_and_else_from_the_bag(
    drive: Referee, scorer: ScoringProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[int] = []
    send = scorer.send_parts

    def measured(parts: Sequence[bytes]) -> None:
        sent.append(sum(map(len, parts)))
        send(parts)

    monkeypatch.setattr(scorer, "send_parts", measured)
    drive.start(make_setup())
    drive.finish()
    (bag,) = drive.folder.glob("*.mcap")
    away = bag.rename(bag.with_suffix(".away"))
    drive.ruled(Rule(Step.TOUCH, confirmed=False, reason="seen"))
    killed = pid_of(scorer)
    os.kill(killed, signal.SIGKILL)
    until(lambda: scorer.pid not in (None, killed))
    drive.ruled(Rule(Step.TOUCH, confirmed=None, reason="right"))
    first, corrected, again = sent
    assert corrected < 10_000 < first
    assert again == pytest.approx(first, rel=0.1)
    away.rename(bag)
    drive.verify()
    drive.ruled(Correct(7, Condition.from_number(4), "typed wrongly"))
    assert sent[-1] < 10_000
    drive.verify()


class Moment(StrEnum):
    BEFORE = "before the start"
    COUNTDOWN = "in the countdown"
    RUNNING = "in the run"
    POST_ROLL = "after the stop"
    SCORING = "while it scores"
    RESULT = "when the result is there"


@pytest.mark.parametrize("moment", Moment)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_its_end_costs_a_moment_and_no_result(
    drive: Referee, scorer: ScoringProcess, moment: Moment, number: signal.Signals
) -> None:
    spoilt: list[int] = []

    def spoil(now: Moment) -> None:
        if now is moment:
            spoilt.append(pid_of(scorer))
            os.kill(spoilt[-1], number)
            until(lambda: scorer.pid not in (None, spoilt[-1]))
            drive.look()

    spoil(Moment.BEFORE)
    drive.prepare(make_setup(countdown=3.0))
    drive.act(Start())
    drive.wait(1.0)
    spoil(Moment.COUNTDOWN)
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    drive.wait(3.0)
    spoil(Moment.RUNNING)
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED)
    spoil(Moment.POST_ROLL)
    if moment is Moment.SCORING:
        os.kill(pid_of(scorer), signal.SIGSTOP)
    drive.stop()
    drive.wait(0.5)
    spoil(Moment.SCORING)
    drive.settle()
    drive.verify()
    spoil(Moment.RESULT)
    drive.ruled(Rule(Step.TOUCH, confirmed=False, reason="seen"))
    drive.verify()
    assert len(spoilt) == 1
    why = "stopped for 2 s" if number == signal.SIGSTOP else "SIGKILL"
    assert any(why in fault for fault in drive.faults)
    drive.ruled(Finalise(TeamWord.ABSENT, "R. Eferee"))
    drive.verify()


@pytest.mark.parametrize("waits", [True, False])
def test_a_process_without_memory_leaves_the_run_safe_and_the_engine_alive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    monkeypatch.setattr(supervisor, "DELAYS", (0.0, 0.1))
    poor = tmp_path / "poor"
    limited = (
        "import pathlib, resource, runpy, sys\n"
        f"if pathlib.Path({str(poor)!r}).exists():\n"
        "    resource.setrlimit(resource.RLIMIT_AS, (250_000_000,) * 2)\n"
        "runpy.run_module('madrob_console.engine.scoring_worker', run_name='__main__')\n"
    )
    poor.touch()
    with kept_running(ScoringProcess((sys.executable, "-c", limited))) as scorer:
        drive = Referee(tmp_path / "runs", scorer, Scenario.NO_TOUCH)
        drive.start(make_setup(timeout=2.0))
        drive.stop()
        folder = drive.folder

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

            def is_named() -> bool:  # once the results folder was looked through
                drive.look()
                unfinished = [run.folder for run in drive.engine.snapshot().unfinished]
                return unfinished == [f"practice/{folder.name}"]

            until(is_named, 60.0)
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
    drive: Referee, scorer: ScoringProcess
) -> None:
    drive.start(make_setup())
    pid = pid_of(scorer)
    until(lambda: scorer.problem is None)
    size = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.prlimit(pid, resource.RLIMIT_AS, (size, size))
    drive.finish()
    drive.verify()


@pytest.mark.parametrize(
    "nonsense", ["b'\\xff' * 100", "b'\\0\\0\\0\\1x'", "b'\\0\\0\\0\\2\\xc0\\xc0'"]
)
def test_nonsense_is_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nonsense: str
) -> None:
    monkeypatch.setattr(supervisor, "DELAYS", (0.0, 0.1))
    bad = tmp_path / "bad"
    bad.touch()
    program = (
        "import pathlib, runpy, socket, sys, time\n"
        f"if pathlib.Path({str(bad)!r}).exists():\n"
        "    link = socket.socket(fileno=int(sys.argv[1]))\n"
        "    link.recv(1)\n"
        f"    link.sendall({nonsense})\n"
        "    time.sleep(60)\n"
        "runpy.run_module('madrob_console.engine.scoring_worker', run_name='__main__')\n"
    )
    with kept_running(ScoringProcess((sys.executable, "-c", program))) as scorer:
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


def test_one_that_hangs_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScoringProcess, "patience", 4.0)
    monkeypatch.setattr(scoring_process, "SOON", 0.5)
    hangs = tmp_path / "hangs"
    hangs.touch()
    program = (
        "import pathlib, runpy, time\n"
        f"if pathlib.Path({str(hangs)!r}).exists():\n"
        "    time.sleep(600)\n"
        "runpy.run_module('madrob_console.engine.scoring_worker', run_name='__main__')\n"
    )
    with kept_running(ScoringProcess((sys.executable, "-c", program))) as scorer:
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
        monkeypatch.setattr(ScoringProcess, "patience", 30.0)
        drive.settle()
        drive.verify()
        drive.engine.close()


def test_one_that_works_for_long_is_said_to(
    tmp_path: Path, scorer: ScoringProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = Referee(tmp_path, scorer, Scenario.NO_TOUCH)
    drive.start(make_setup(timeout=2.0))
    monkeypatch.setattr(scoring_process, "SOON", 1e-9)
    monkeypatch.setattr(ScoringProcess, "moved", math.inf)
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
            told.update(shown.all_faults)
            return shown.result is not None

        until(there, ScoringProcess.patience - 1.0)
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
    monkeypatch.setattr(supervisor, "DELAYS", (0.0, 0.1))
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
            if b"scoring_worker" in Path(f"/proc/{pid}/cmdline").read_bytes():
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
