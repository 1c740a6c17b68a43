"""Runs that are scored in a process of its own: what comes of it is the same."""

from __future__ import annotations

import copy
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec import structs

from madrob_console.archive import score
from madrob_console.common.errors import MadrobError
from madrob_console.engine.core.scored_run import RenderedResult, ScoringRequest
from madrob_console.engine.runtime import scoring_process, supervisor
from madrob_console.engine.runtime.disk import DiskThreads
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.scoring_process import ScoringProcess
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.referee.acts import (
    Abort,
    Act,
    Correct,
    Finalise,
    Reissue,
    RestartCountdown,
    Rule,
)
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import RawMessage
from scoring.indicator_table import RulesetName
from scoring.protocol import Condition, Signal, Step
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.served import kept_running
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.robots import Played
from tests.watching import alive, children_of, until

pytestmark = pytest.mark.machine

DENIED = Rule(Step.TOUCH, confirmed=False, reason="seen")
BACK = Rule(Step.TOUCH, confirmed=None, reason="right")
DOOR = next(m.topic for m in DEFAULT_MAPPINGS if m.signal is Signal.DOOR)


class Referee(Drive):
    """An engine whose results come from elsewhere: they are waited for, time stands still."""

    def __init__(
        self,
        results: Path,
        scorer: ScoringProcess,
        scenario: Played = Scenario.NOMINAL,
        disk: DiskThreads | None = None,
    ) -> None:
        super().__init__(results, scenario, scorer=scorer, disk=disk)
        self.faults: set[str] = set()

    def look(self) -> None:
        self.engine.step(0.0)
        self.faults |= set(self.engine.snapshot().all_faults)

    def until_told(self, words: str) -> None:
        """Until screens show this fault."""

        def told() -> bool:
            self.look()
            return any(words in fault for fault in self.faults)

        until(told, 60.0)

    def settle(self) -> None:
        """Until there is the result that was asked for."""

        def there() -> bool:
            self.look()
            return self.engine.situation().scored

        until(there, 60.0)

    def finish(self) -> None:
        self.stop()
        self.settle()

    def stop(self) -> None:
        """Until the result is asked for."""
        self.wait_until(lambda: self.engine.run.issue > 0)

    def ruled(self, *acts: Act) -> None:
        for act in acts:
            self.act(act)
            self.settle()

    def verify(self) -> None:
        """The bag gives the digits that are shown, and they are on disk; nothing is wrong."""
        assert self.engine.scored is not None
        again, shown = next(score(self.folder)).result, self.engine.scored.result
        assert again == replace(shown, quality=again.quality)
        assert again.quality.signals == shown.quality.signals
        assert self.engine.snapshot().all_faults == ()
        for name, content in self.engine.scored.files.items():
            assert (self.folder / name).read_bytes() == content, name


@pytest.fixture
def scorer() -> Iterator[ScoringProcess]:
    with kept_running(ScoringProcess()) as one:
        yield one


@pytest.fixture
def drive(tmp_path: Path, scorer: ScoringProcess) -> Iterator[Referee]:
    drive = Referee(tmp_path, scorer)
    yield drive
    drive.engine.close()


def pid_of(scorer: ScoringProcess) -> int:
    pid = until(lambda: scorer.pid)
    assert pid is not None
    return pid


def kill(scorer: ScoringProcess, number: signal.Signals = signal.SIGKILL) -> None:
    """Its process, once it is ready, is killed or stopped."""
    until(lambda: scorer.failures == 0)
    os.kill(pid_of(scorer), number)
    if number is signal.SIGKILL:
        until(lambda: scorer.failures or scorer.pid is None)


class Twins(ScoringProcess):
    """Has every run scored here, too, and what comes of both is the same.

    Attributes:
        pairs: so many runs were scored twice.
    """

    pairs = 0

    def score(self, wanted: ScoringRequest, done: Callable[[RenderedResult], None]) -> None:
        mine: list[RenderedResult] = []
        own = replace(wanted, assessment=copy.deepcopy(wanted.assessment))
        Scorer().score(own, mine.append)

        def both(theirs: RenderedResult) -> None:
            (here,) = mine
            assert (here.result, here.past, here.run) == (theirs.result, theirs.past, theirs.run)
            assert {**here.files} == {name: bytes(each) for name, each in theirs.files.items()}
            assert here.curves == theirs.curves
            views = [type(each) for each in theirs.files.values()]
            assert {*views} == {memoryview}  # the core copies none of it
            self.pairs += 1
            done(theirs)

        super().score(wanted, both)


@pytest.mark.parametrize("ruleset", RulesetName)
def test_its_bytes_are_those_that_are_made_here(
    tmp_path: Path, ruleset: RulesetName, monkeypatch: pytest.MonkeyPatch
) -> None:
    with kept_running(Twins()) as twins:
        drive = Referee(tmp_path, twins, Scenario.SLAM)
        drive.count_down(make_setup(ruleset=ruleset))
        drive.wait(1.0)
        drive.act(RestartCountdown("a person in the doorway"))
        drive.finish()
        drive.ruled(DENIED, Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"), Reissue("again"))
        drive.verify()
        drive.start(make_setup(ruleset=ruleset, run_number=2))
        take = drive.source.take_messages

        def take_spoilt(timeout: float) -> list[RawMessage]:
            """Some of the door cannot be decoded."""
            return [
                structs.replace(m, data=m.data[:9])
                if m.topic == DOOR and not m.receive_ns % 7
                else m
                for m in take(timeout)
            ]

        with monkeypatch.context() as patched:
            patched.setattr(drive.source, "take_messages", take_spoilt)
            drive.wait(0.5)
        drive.wait(3.0)
        drive.act(Abort("enough"))
        drive.finish()
        drive.verify()
        assert twins.pairs >= 4
        assert DOOR in "".join(drive.scored_result().quality.remarks)
        drive.engine.close()


def test_an_earlier_run_is_read_there_and_goes_on(drive: Referee, scorer: ScoringProcess) -> None:
    drive.start(make_setup())
    drive.finish()
    drive.ruled(DENIED)
    first, shown = drive.folder, drive.engine.snapshot()
    drive.start(make_setup(run_number=2, timeout=2.0))
    drive.finish()
    assert drive.open(first) is None
    again = drive.engine.snapshot()
    for name in ("result", "steps", "provisional", "run"):
        assert getattr(again, name) == getattr(shown, name), name
    os.kill(pid_of(scorer), signal.SIGKILL)
    drive.ruled(BACK)
    drive.verify()


def test_what_cannot_be_read_is_refused_in_words_and_so_is_what_comes_too_late(
    tmp_path: Path,
) -> None:
    (tmp_path / "run").mkdir()
    with kept_running(ScoringProcess()) as scorer:
        with pytest.raises(MadrobError, match="run"):
            scorer.read(tmp_path / "run").result()
        os.kill(pid_of(scorer), signal.SIGSTOP)
        waiting = scorer.read(tmp_path / "run")
    with pytest.raises(MadrobError, match="the engine has ended"):
        waiting.result(10.0)


def test_an_engine_that_is_closed_in_a_run_has_its_result(
    drive: Referee, scorer: ScoringProcess
) -> None:
    drive.start(make_setup())
    drive.wait(4.0)
    drive.engine.close()
    assert drive.scored_result().outcome == "interrupted"
    assert (drive.folder / "result.json").exists()


def test_samples_come_from_the_engine_where_the_bag_is_away(
    drive: Referee, scorer: ScoringProcess
) -> None:
    drive.start(make_setup())
    drive.finish()
    (bag,) = drive.folder.glob("*.mcap")
    away = bag.rename(bag.with_suffix(".away"))
    drive.ruled(DENIED)
    kill(scorer)
    drive.ruled(BACK)
    away.rename(bag)
    drive.verify()
    drive.ruled(Correct(7, Condition.from_number(4), "typed wrongly"))
    drive.verify()


def test_its_end_at_any_moment_costs_a_moment_and_no_result(
    drive: Referee, scorer: ScoringProcess
) -> None:
    kill(scorer)
    drive.count_down(make_setup(countdown=3.0))
    drive.wait(1.0)
    kill(scorer)
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    drive.wait(3.0)
    kill(scorer)
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED)
    kill(scorer)
    kill(scorer, signal.SIGSTOP)
    drive.stop()
    drive.wait(0.5)
    kill(scorer)  # while it scores
    drive.settle()
    drive.verify()
    kill(scorer)
    drive.ruled(DENIED)
    drive.verify()
    assert any("SIGKILL" in fault for fault in drive.faults)
    drive.ruled(Finalise(TeamWord.ABSENT, "R. Eferee"))
    drive.verify()


@contextmanager
def ailing(
    tmp_path: Path, ill: str, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Referee, Callable[[], None]]]:
    """A run that was stopped, whose scoring process is ill until it is healed."""
    monkeypatch.setattr(supervisor, "DELAYS", (0.0, 0.1))
    mark = tmp_path / "ill"
    mark.touch()
    program = (
        "import pathlib, resource, runpy, socket, sys, time\n"
        f"if pathlib.Path({str(mark)!r}).exists():\n"
        f"    {ill}\n"
        "runpy.run_module('madrob_console.engine.runtime.scoring_worker', run_name='__main__')\n"
    )
    with kept_running(ScoringProcess((sys.executable, "-c", program))) as scorer:
        drive = Referee(tmp_path / "runs", scorer, Scenario.NO_TOUCH)
        drive.start(make_setup(timeout=2.0))
        drive.stop()
        yield drive, mark.unlink
        drive.settle()
        drive.verify()
        drive.engine.close()


POOR = "resource.setrlimit(resource.RLIMIT_AS, (250_000_000,) * 2)"
NONSENSE = r"socket.socket(fileno=int(sys.argv[1])).sendall(b'\0\0\0\2\xc0\xc0'); time.sleep(60)"


@pytest.mark.parametrize(
    ("ill", "told"),
    [
        (POOR, ["`madrob score subject_003_cond_001_run_001"]),
        (NONSENSE, ["not a message"]),
        (
            "time.sleep(600)",
            [
                "computed: the scoring process does not move; the run is safe on disk",
                "the scoring process is started again: it did not move for 4 s; the",
            ],
        ),
    ],
    ids=["without memory", "says nonsense", "hangs"],
)
def test_an_ailing_process_is_named_and_the_result_comes_when_it_is_well(
    ill: str, told: Sequence[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ScoringProcess, "patience", 4.0)
    monkeypatch.setattr(scoring_process, "SOON", 0.5)
    with ailing(tmp_path, ill, monkeypatch) as (drive, heal):
        for words in told:
            drive.until_told(words)
        assert drive.engine.scored is None
        refused = drive.engine.perform(Finalise(TeamWord.ABSENT, "R. Eferee"))
        assert refused == "the result is being written"
        monkeypatch.setattr(ScoringProcess, "patience", 30.0)
        heal()


def test_a_run_is_called_safe_on_disk_only_while_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_process, "SOON", 0.5)
    with ailing(tmp_path, "time.sleep(600)", monkeypatch) as (drive, heal):
        folder, gone = drive.folder, tmp_path / "gone"
        drive.until_told("; the run is safe on disk")
        folder.rename(gone)
        drive.wait(2.0)
        drive.until_told("; it is in memory alone: do not end the engine")
        assert "safe on disk" not in "".join(drive.engine.snapshot().all_faults)
        gone.rename(folder)
        drive.wait(2.0)
        assert "; the run is safe on disk" in "".join(drive.engine.snapshot().all_faults)
        heal()


def test_a_run_whose_result_does_not_come_is_named_and_keeps_no_next_one_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ailing(tmp_path, POOR, monkeypatch) as (drive, heal):
        first = f"practice/{drive.folder.name}"
        drive.until_told("`madrob score")
        drive.start(make_setup(timeout=2.0, run_number=2))

        def is_named() -> bool:  # once the results folder was looked through
            drive.look()
            return [run.folder for run in drive.engine.snapshot().unfinished] == [first]

        until(is_named, 60.0)
        heal()
        drive.stop()


def test_no_scoring_process_survives_an_engine_that_is_killed(tmp_path: Path) -> None:
    with EngineProcess(tmp_path, "no-touch") as engine:

        def workers() -> list[int]:
            children = children_of(engine.process.pid)
            return [pid for pid, line in children.items() if "scoring_worker" in line]

        (child,) = until(workers)
        engine.start(make_setup(countdown=1.0))
        engine.process.kill()
        until(lambda: not alive(child))
