"""The core on values: which effects follow from an input, without a file, clock or thread."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeGuard

import pytest

from madrob_console.common.names import SourceKind
from madrob_console.engine.core.acting import DURABLE_WITHIN
from madrob_console.engine.core.effects import (
    Answer,
    ConfigureTestbed,
    Effect,
    OpenRecording,
    Publish,
    RetryWriting,
    WithdrawLine,
    WriteLine,
)
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.engine_core import Core
from madrob_console.engine.core.inputs import (
    DoAct,
    Input,
    LineWithdrawn,
    LineWritten,
    RecordingOpened,
    Tick,
)
from madrob_console.engine.core.now import DiskState, Now, TestbedState
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import (
    Act,
    AddNote,
    ConfirmPose,
    RestartCountdown,
    SetUp,
    Start,
    Waive,
)
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import Origin
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup

FOLDER = Path("results/practice/subject_003_cond_001_run_001_20260101_100000")
TESTBED = TestbedState(SourceKind.SIMULATED, "SIMULATED nominal")
NOON = Now(1e9, 50.0, 1e9, 1e9, TESTBED, DiskState(free=10**12, problem=""))


class Values:
    """A core whose inputs a test makes; `number` is that of the last act."""

    def __init__(self) -> None:
        config = EngineConfig(Path("results"), DEFAULT_MAPPINGS, disk_needed=0)
        self.core = Core(config, MessageTypes())
        self.now = NOON
        self.number = 0

    def take(self, happened: Input, after: float = 0.0) -> list[Effect]:
        now = self.now
        self.now = replace(
            now,
            time=now.time + after,
            monotonic=now.monotonic + after,
            taken=now.taken + after,
            judged=now.judged + after,
        )
        effects = self.core.step(happened, self.now)
        return [one for one in effects if not isinstance(one, RetryWriting)]  # comes by the clock

    def do(self, act: Act) -> list[Effect]:
        self.number += 1
        return self.take(DoAct(self.number, act, "", Origin.REFEREE))

    def ready(self) -> None:
        self.do(SetUp(make_setup()))
        self.do(ConfirmPose())
        for check in blocking(self.core.situation(self.now).checks):
            self.do(Waive(check.name, "nobody is here"))
        assert not blocking(self.core.situation(self.now).checks)

    def asked_to_start(self) -> OpenRecording:
        self.ready()
        (opening,) = self.do(Start())
        assert isinstance(opening, OpenRecording)
        return opening


@pytest.fixture
def values() -> Values:
    return Values()


def kinds(effects: list[Effect]) -> list[str]:
    return [
        type(one.what).__name__ if isinstance(one, Publish) else type(one).__name__
        for one in effects
    ]


def test_a_set_up_is_done_at_once_and_told_to_testbed_and_robot(values: Values) -> None:
    effects = values.do(SetUp(make_setup()))
    assert ConfigureTestbed(make_setup().condition) in effects
    assert Publish(make_setup().start_pose) in effects
    assert Answer(1, None) in effects
    assert values.core.current_run.run.phase is Phase.READY


def test_a_start_changes_nothing_until_its_line_is_on_disk(values: Values) -> None:
    opening, before = values.asked_to_start(), values.core.current_run.run
    assert opening.entries[-1].what == Start.name
    assert values.take(Tick(), 1.0) == []
    assert values.core.current_run.run is before
    opened = RecordingOpened(opening.entries[-1].id, FOLDER, None)
    effects = values.take(opened, 0.5)
    assert kinds(effects) == [
        "KeepRecording",
        "Entry",
        "WriteLine",
        "Entry",
        "PublishedState",
        "Answer",
    ]
    run = values.core.current_run.run
    assert (run.phase, run.countdown_began) == (Phase.COUNTDOWN, values.now.time)
    assert values.core.records


def test_a_start_that_is_withdrawn_never_takes_effect(values: Values) -> None:
    opening = values.asked_to_start()
    (withdraw,) = values.take(Tick(), DURABLE_WITHIN)
    assert isinstance(withdraw, WithdrawLine)
    why = "the disk did not take it within 2 s: it is withdrawn"
    assert values.take(LineWithdrawn(withdraw.withdrawal)) == [Answer(values.number, why)]
    late = values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    assert late == []
    assert values.core.current_run.run.phase is Phase.READY


def test_a_note_that_overtakes_an_act_stands_behind_it_as_on_disk(values: Values) -> None:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    handed = [one.entry for one in values.do(RestartCountdown("not ready")) if is_line(one)]
    handed += [one.entry for one in values.do(AddNote("meanwhile")) if is_line(one)]
    values.take(LineWritten(handed[0].id, None))
    stand = values.core.current_run.state.lines.entries
    assert [one.what for one in handed] == [RestartCountdown.name, AddNote.name]
    assert [one for one in stand if one in handed] == handed


def is_line(effect: Effect) -> TypeGuard[WriteLine]:
    return isinstance(effect, WriteLine)
