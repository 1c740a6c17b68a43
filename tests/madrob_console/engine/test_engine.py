"""What a referee can rely on, with real files in virtual time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.archive.collection import matches
from madrob_console.archive.history import History
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.checks import CheckState
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.records import CheckName, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName
from scoring.protocol import LockDetection, Outcome, Step
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import completed


def values(path: Path) -> dict[str, object]:
    document = json.loads((path / "result.json").read_text())
    return {name: i["value"] for name, i in document["indicators"].items()}


def test_a_nominal_run_is_completed_recorded_and_scored(drive: Drive) -> None:
    drive.whole_run(make_setup())
    scored = drive.engine.scored
    assert scored is not None
    assert scored.result.outcome is Outcome.COMPLETED
    assert all(i.value is not None for i in scored.result.indicators.values())
    assert scored.result.quality.remarks == ()
    names = {path.name for path in drive.folder.iterdir()}
    names.remove(HOLD_FILE)  # while the engine has the run
    prefix = "subject_003_cond_001_run_001"
    assert drive.folder.name.startswith(prefix)
    assert names == {
        f"{drive.folder.name}_0.mcap", "metadata.yaml", f"run_info_{prefix}.yaml",
        "condition_1.yaml", f"{prefix}_event.csv", f"{prefix}_jointState.csv",
        f"{prefix}_wrench.csv", "journal.jsonl", "result.json",
        *(f"{name}.yaml" for name in IndicatorName),
    }  # fmt: skip


def test_abort_wins_at_once_keeps_the_run_and_opens_a_clean_next_one(drive: Drive) -> None:
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("robot on fire"))
    assert drive.engine.run.phase is Phase.STOPPED
    assert drive.engine.snapshot().elapsed == pytest.approx(3.0, abs=0.05)
    drive.finish()
    document = json.loads((drive.folder / "result.json").read_text())
    assert (document["outcome"], document["outcome_reason"]) == ("aborted", "robot on fire")
    assert {i["reason"] for i in document["indicators"].values()} == {"run aborted: invalid"}
    assert not list(drive.folder.glob("execution_time.yaml"))
    assert drive.engine.next_run_number(3, 1, practice=True).result() == 2
    drive.act(SetUp(make_setup(run_number=2)))
    clean = drive.engine.snapshot()
    assert (clean.result, clean.folder, clean.elapsed, clean.provisional) == (None, None, None, {})
    assert not clean.run.pose_confirmed


def test_a_timeout_ends_the_run_at_its_own_time(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.whole_run(make_setup(timeout=10.0))
    run = drive.engine.run
    assert run.start is not None
    assert (run.outcome, run.stop) == (Outcome.TIMEOUT, run.start + 10.0)


def test_a_declared_timeout_is_valid_and_counts_from_its_instant(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(make_setup())
    drive.wait(5.0)
    declared = drive.engine.now()
    drive.act(DeclareTimeout("gave up"))
    drive.finish()
    assert (drive.engine.run.outcome, drive.engine.run.stop) == (Outcome.TIMEOUT, declared)
    assert values(drive.folder)["execution_time"] == pytest.approx(5.0, abs=0.05)


def test_a_timeout_within_the_settle_time_waits_for_its_end(tmp_path: Path) -> None:
    needed = values(completed())[IndicatorName.EXECUTION_TIME]
    assert isinstance(needed, float)
    drive = Drive(tmp_path)
    drive.whole_run(make_setup(timeout=needed + 0.5))
    assert drive.engine.run.outcome is Outcome.COMPLETED
    assert values(drive.folder)["execution_time"] == pytest.approx(needed, abs=1e-6)
    late = Drive(tmp_path)
    late.whole_run(make_setup(timeout=needed - 0.05, run_number=2))
    assert late.engine.run.outcome is Outcome.TIMEOUT


def test_a_declared_timeout_within_the_settle_time_waits_too(drive: Drive) -> None:
    drive.start(make_setup())
    drive.wait_until(lambda: drive.engine.snapshot().settling)
    drive.act(DeclareTimeout("too slow"))
    drive.finish()
    assert drive.engine.run.outcome is Outcome.COMPLETED


def test_checks_stand_in_the_way_until_they_are_waived(drive: Drive) -> None:
    drive.act(SetUp(make_setup()))
    states = {c.name: c.state for c in drive.engine.snapshot().checks}
    assert states[CheckName.DOOR] is CheckState.NO_DATA
    drive.wait(1.5)
    refusal = drive.engine.perform(Start())
    assert refusal is not None
    assert refusal.startswith("F7 zeroes the handle")
    drive.act(Waive(CheckName.HANDLE, "spring is warm"), ConfirmPose())
    drive.act(Start())
    drive.finish()
    assert drive.engine.scored is not None
    assert "check waived: handle at rest: spring is warm" in (
        drive.engine.scored.result.quality.remarks
    )


def test_the_handle_zero_makes_the_touch_right(drive: Drive) -> None:
    drive.prepare(make_setup())
    assert drive.engine.run.handle_zero == pytest.approx(5.9, abs=0.05)
    drive.act(Start())
    drive.finish()
    touched = values(drive.folder)["time_to_handle"]
    assert isinstance(touched, float)
    assert touched > 1.0


def test_an_engine_that_was_started_again_says_why_it_wants_a_zero_again(tmp_path: Path) -> None:
    def handle(drive: Drive) -> str:
        checks = drive.engine.snapshot().checks
        return next(check.reason for check in checks if check.name is CheckName.HANDLE)

    first = Drive(tmp_path)
    first.whole_run(make_setup())
    first.engine.close()
    again = Drive(tmp_path)
    again.wait(1.5)
    assert handle(again) == "F7 zeroes the handle (not yet done since the engine started)"
    again.act(ZeroHandle())
    again.wait(0.1)
    assert "zeroes the handle" not in handle(again)


def test_a_false_start_is_shown_and_decided(drive: Drive) -> None:
    drive.prepare(make_setup(countdown=6.0))
    drive.act(Start())
    early = drive.clock.now_ns() - 2_500_000_000
    drive.source.testbed.start(early)  # this robot does not wait
    drive.wait_until(lambda: bool(drive.engine.run.false_starts))
    assert drive.engine.run.phase is Phase.COUNTDOWN
    drive.source.testbed.reset()
    drive.act(RestartCountdown())
    assert drive.engine.run.undecided_false_start is None
    drive.finish()
    scored = drive.engine.scored
    assert scored is not None
    assert scored.result.outcome is Outcome.COMPLETED
    assert next(score(drive.folder)).result == scored.result


def test_an_accepted_false_start_stands_in_the_result(drive: Drive) -> None:
    drive.prepare(make_setup(countdown=6.0))
    drive.act(Start())
    drive.source.testbed.start(drive.clock.now_ns() - 2_500_000_000)
    drive.wait_until(lambda: bool(drive.engine.run.false_starts))
    drive.act(AcceptFalseStart("a draught"))
    drive.wait(5.0)
    drive.act(Abort("enough"))
    drive.finish()
    document = json.loads((drive.folder / "result.json").read_text())
    assert document["false_starts"][0]["accepted"] == "a draught"


def test_an_undecided_false_start_is_signed_only_by_who_knows_of_it(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)  # the door of another would jump at the start
    drive.prepare(make_setup(countdown=6.0))
    drive.act(Start())
    drive.source.testbed.start(drive.clock.now_ns() - 2_500_000_000)
    drive.wait_until(lambda: bool(drive.engine.run.false_starts))
    drive.finish()
    words = "1 false start UNDECIDED (handle touched)"

    def stored() -> list[dict[str, object]]:
        document = json.loads((drive.folder / "result.json").read_text())
        flags: list[dict[str, object]] = document["flags"]
        return flags

    assert stored()[0] == {
        "kind": "false start", "words": words, "weight": "alarm", "undecided": True,
    }  # fmt: skip
    (listed,) = History(tmp_path).refresh()
    assert listed.flags[0].words == words
    assert matches(listed, "undecided")
    refused = drive.engine.perform(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
    assert refused == f"decide it first, or sign it knowing so: {words}"
    drive.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee", undecided=(words,)))
    drive.wait(1.0)
    assert drive.engine.snapshot().flags[0].words == words
    drive.act(Reissue("it was seen"), AcceptFalseStart("a draught"))
    drive.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
    drive.engine.close()
    assert [flag["words"] for flag in stored()] == [
        "1 false start accepted", "SIMULATED: not an official result",
    ]  # fmt: skip
    (listed,) = History(tmp_path).refresh()
    assert [flag.words for flag in listed.flags] == [flag["words"] for flag in stored()]


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
    document = json.loads((drive.folder / "result.json").read_text())
    step = document["steps"][3]
    assert document["indicators"]["capability_level"]["value"] == 3
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


def test_the_log_speaks_of_events_as_people_do(drive: Drive) -> None:
    drive.whole_run(make_setup())
    said = [line.text for line in drive.engine.log.lines if line.origin == "sensor"]
    assert set(said) == {
        "handle touched",
        "door opens",
        "robot approaches on the CCW side",
        "robot leaves the doorway on the CW side",
        "door closes",
    }
    assert not any("_" in line.text for line in drive.engine.log.lines)
