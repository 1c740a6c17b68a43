"""Runs that are scored in a process of its own: what comes of it is the same."""

from __future__ import annotations

import math
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from madrob_console.archive import score
from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import Scored
from madrob_console.engine.live.keeper import Keepers
from madrob_console.engine.live.scorer import InlineScorer, RenderedResult, ToScore
from madrob_console.engine.process.scoring_process import COMMAND, ScoringProcess
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.acts import (
    Abort,
    DeclareTimeout,
    Finalise,
    Reissue,
    RestartCountdown,
    Rule,
    Start,
)
from madrob_console.referee.on_record import TeamWord
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from madrob_console.ui.panes.result_head import ResultHead
from scoring.evaluate import LiveAssessment
from scoring.protocol import Signal, Step
from scoring.rulesets import RulesetName
from scoring.samples import DoorSample, HandleSample, Sample
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.scored_elsewhere import Referee, alive, ended, pid_of
from tests.watching import until

pytestmark = pytest.mark.machine


class Twins(ScoringProcess):
    """Has every run scored here, too, and keeps what comes of both."""

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        super().__init__(command)
        self.here = InlineScorer()
        self.pairs: list[tuple[RenderedResult, RenderedResult]] = []

    def follow(self, record: RunRecord, start: float) -> LiveAssessment:
        there, here = super().follow(record, start), self.here.follow(record, start)
        feed, report = there.feed, there.report_problem

        def fed(sample: Sample) -> None:
            feed(sample)
            here.feed(sample)

        def reported(text: str) -> None:
            report(text)
            here.report_problem(text)

        there.feed, there.report_problem = fed, reported  # type: ignore[method-assign]
        return there

    def score(self, wanted: ToScore, done: Callable[[RenderedResult], None]) -> None:
        mine: list[RenderedResult] = []
        self.here.score(wanted, mine.append)

        def both(theirs: RenderedResult) -> None:
            self.pairs.append((mine[0], theirs))
            done(theirs)

        super().score(wanted, both)


@pytest.fixture
def scorer() -> Iterator[ScoringProcess]:
    with ended(ScoringProcess()) as one:
        yield one


def told(report: bytes | memoryview) -> list[object]:
    """What a report is made from, to the last bit."""
    scored = pickle.loads(report)
    assert isinstance(scored, Scored)
    rows, joint = scored.rows, scored.rows.joint_state
    arrays = [getattr(rows, f.name) for f in fields(rows)] + [
        getattr(joint, f.name) for f in fields(joint)
    ]
    numbers = [each.tobytes() for each in arrays if isinstance(each, np.ndarray)]
    assert len(numbers) == 11
    return [scored.record, scored.run, scored.result, rows.problem, *numbers]


@pytest.mark.parametrize("ruleset", RulesetName)
def test_its_bytes_are_those_that_are_made_here(tmp_path: Path, ruleset: RulesetName) -> None:
    with ended(Twins()) as twins:
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
            assert told(here.report) == told(there.report)
        drive.engine.close()


def test_what_could_not_be_decoded_is_told_by_both(tmp_path: Path) -> None:
    with ended(Twins()) as twins:
        drive = Referee(tmp_path, twins, Scenario.NO_TOUCH)
        door = next(m.topic for m in DEFAULT_MAPPINGS if m.signal is Signal.DOOR)
        drive.start(make_setup(timeout=3.0))
        take = drive.source.take

        def spoilt(timeout: float) -> list[object]:
            return [
                m.__class__(m.topic, m.type, m.data[:9], m.publish_ns, m.receive_ns)
                if m.topic == door and m.receive_ns % 7 == 0
                else m
                for m in take(timeout)
            ]

        drive.source.take = spoilt  # type: ignore[method-assign, assignment]
        drive.finish()
        (pair,) = twins.pairs
        assert pair[0].result == pair[1].result
        assert any(door in remark for remark in pair[1].result.quality.remarks)
        assert drive.engine.folder is not None
        assert next(score(drive.engine.folder)).result == pair[1].result
        drive.engine.close()


def test_an_earlier_run_is_read_there_and_goes_on(tmp_path: Path, scorer: ScoringProcess) -> None:
    drive = Referee(tmp_path, scorer)
    drive.start(make_setup())
    drive.finish()
    drive.ruled(Rule(Step.TOUCH, confirmed=False, reason="seen"))
    first = drive.engine.folder
    assert first is not None
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
    drive.engine.close()


def test_what_cannot_be_read_is_refused_in_words_and_so_is_what_comes_too_late(
    tmp_path: Path, scorer: ScoringProcess
) -> None:
    (tmp_path / "run").mkdir()
    with pytest.raises(MadrobError, match="run"):
        scorer.read(tmp_path / "run").result()
    os.kill(pid_of(scorer), signal.SIGSTOP)
    waiting = scorer.read(tmp_path / "run")
    os.kill(pid_of(scorer), signal.SIGKILL)
    scorer.close()
    with pytest.raises((MadrobError, CancelledError)):
        waiting.result(10.0)


def test_a_result_that_is_out_of_date_is_not_shown_for_long(
    tmp_path: Path, scorer: ScoringProcess
) -> None:
    drive = Referee(tmp_path, scorer)
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
    head = [span.text for line in ResultHead().draw(shown, 80) for span in line]
    assert head == ["The result is being scored again: the one that was here is out of date."]
    assert "finalise" in shown.refusals
    os.kill(pid_of(scorer), signal.SIGCONT)
    drive.settle()
    again = drive.engine.snapshot()
    assert again.result is not None
    assert again.result.steps[Step.TOUCH - 1].denied
    assert not again.rescoring
    drive.verify()
    drive.engine.close()


@pytest.mark.slow
def test_a_run_of_three_hours_makes_nobody_wait_for_its_scoring(
    tmp_path: Path, scorer: ScoringProcess
) -> None:
    """Two sensors at 100 Hz: their samples are fed, for the recording is not what is measured."""
    hours, rate = 3.0, 100.0
    drive = Referee(tmp_path, scorer, Scenario.NO_CLOSE, Keepers.threads())
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
        if number % 10_000 == 0:
            until(lambda: len(scorer._questions) < 10_000)
    drive.source.take = lambda timeout: []  # type: ignore[method-assign]
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


def test_an_engine_that_is_closed_in_a_run_has_its_result(
    tmp_path: Path, scorer: ScoringProcess
) -> None:
    drive = Referee(tmp_path, scorer)
    drive.start(make_setup())
    drive.wait(4.0)
    pid = pid_of(scorer)
    drive.engine.close()
    assert drive.engine.scored is not None
    assert drive.engine.scored.result.outcome == "interrupted"
    assert drive.engine.folder is not None
    assert (drive.engine.folder / "result.json").exists()
    until(lambda: not alive(pid))
