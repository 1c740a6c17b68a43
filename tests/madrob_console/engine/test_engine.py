"""What a referee can rely on, with real files in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.referee.acts import (
    Abort,
    DeclareTimeout,
    Rule,
    SetUp,
    Start,
    Void,
)
from madrob_console.referee.checks import CheckState
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName
from scoring.protocol import LockDetection, Outcome, Step
from tests.madrob_console.engine.drive import Drive, document, make_setup


def value(path: Path, name: IndicatorName) -> float:
    found: float = document(path)["indicators"][name]["value"]
    return found


def test_a_nominal_run_is_completed_recorded_scored_and_told(drive: Drive) -> None:
    drive.whole_run(make_setup())
    scored = drive.engine.scored
    assert scored is not None
    assert scored.result.outcome is Outcome.COMPLETED
    assert all(i.value is not None for i in scored.result.indicators.values())
    assert scored.result.quality.remarks == ()
    assert value(drive.folder, IndicatorName.TIME_TO_HANDLE) > 1.0  # by the handle's zero
    names = {path.name for path in drive.folder.iterdir()}
    prefix = "subject_003_cond_001_run_001"
    assert drive.folder.name.startswith(prefix)
    assert names == {
        f"{drive.folder.name}_0.mcap", "metadata.yaml", f"run_info_{prefix}.yaml",
        "condition_1.yaml", f"{prefix}_event.csv", f"{prefix}_jointState.csv",
        f"{prefix}_wrench.csv", "journal.jsonl", "result.json", HOLD_FILE,
        *(f"{name}.yaml" for name in IndicatorName),
    }  # fmt: skip
    said = [line.text for line in drive.engine.log.lines if line.origin == "sensor"]
    assert set(said) == {
        "handle touched",
        "door opens",
        "robot approaches on the CCW side",
        "robot leaves the doorway on the CW side",
        "door closes",
    }
    assert not any("_" in line.text for line in drive.engine.log.lines)


def test_abort_wins_at_once_keeps_the_run_and_opens_a_clean_next_one(drive: Drive) -> None:
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("robot on fire"))
    assert drive.engine.run.phase is Phase.STOPPED
    assert drive.engine.snapshot().elapsed == pytest.approx(3.0, abs=0.05)
    drive.finish()
    stored = document(drive.folder)
    assert (stored["outcome"], stored["outcome_reason"]) == ("aborted", "robot on fire")
    assert {i["reason"] for i in stored["indicators"].values()} == {"run aborted: invalid"}
    assert not list(drive.folder.glob("execution_time.yaml"))
    assert drive.engine.next_run_number(3, 1, practice=True).result() == 2
    drive.act(SetUp(make_setup(run_number=2)))
    clean = drive.engine.snapshot()
    assert (clean.result, clean.folder, clean.elapsed, clean.provisional) == (None, None, None, {})
    assert not clean.run.pose_confirmed


def test_a_declared_timeout_counts_from_its_instant(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(make_setup())
    drive.wait(5.0)
    declared = drive.engine.now()
    drive.act(DeclareTimeout("gave up"))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED)
    drive.act(Void("it fell on somebody"))  # before it is scored
    drive.finish()
    assert (drive.engine.run.outcome, drive.engine.run.stop) == (Outcome.TIMEOUT, declared)
    assert document(drive.folder)["voided"]["reason"] == "it fell on somebody"
    assert document(drive.folder)["issue"] == 1
    assert value(drive.folder, IndicatorName.EXECUTION_TIME) == pytest.approx(5.0, abs=0.05)


def test_the_referee_can_stop_a_run_that_only_he_can_judge(drive: Drive) -> None:
    drive.start(make_setup(lock_detection=LockDetection.REFEREE))
    drive.wait_until(lambda: drive.engine.snapshot().ask_referee is not None)
    drive.wait(2.0)
    judged = drive.engine.now()
    drive.act(Rule(Step.LOCK, confirmed=True, reason="heard the click"))
    drive.finish()
    assert (drive.engine.run.outcome, drive.engine.run.stop) == (Outcome.COMPLETED, judged)


def test_a_ruling_after_the_stop_changes_the_result_on_disk_and_keeps_what_was_found(
    drive: Drive,
) -> None:
    drive.whole_run(make_setup())
    drive.act(Rule(Step.CROSS, confirmed=False, reason="arm only"))
    step = document(drive.folder)["steps"][3]
    assert value(drive.folder, IndicatorName.CAPABILITY_LEVEL) == 3
    assert step["sensors"] is not None
    assert (step["referee"]["reason"], step["final"]) == ("arm only", None)
    assert next(score(drive.folder)).result == drive.engine.scored.result  # type: ignore[union-attr]


def test_without_a_testbed_nothing_starts_and_nothing_is_shown_as_good(drive: Drive) -> None:
    drive.source.close()
    drive.act(SetUp(make_setup()))
    drive.wait(1.0)
    shown = drive.engine.snapshot()
    assert {c.state for c in shown.checks} >= {CheckState.NO_DATA, CheckState.FAILED}
    assert not any(c.state is CheckState.OK for c in shown.checks if c.name in {
        CheckName.TOPICS, CheckName.DOOR, CheckName.HANDLE, CheckName.DOORWAY, CheckName.CLOCK
    })  # fmt: skip
    assert shown.door.angle is None
    assert {s.occupied for s in shown.passage} == {None}
    assert drive.engine.perform(Start()) is not None
