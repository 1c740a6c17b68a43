"""What a referee can rely on, with real files in virtual time."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace

from madrob_console.archive import score
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.replay import Replay
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes, referee_topics
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.journal import read_journal
from madrob_console.referee.preflight import CheckState
from madrob_console.referee.run import CheckName, IncidentKind, Phase, TeamWord
from madrob_console.testbeds.simulated import Scenario
from recorder.message import RawMessage
from recorder.reader import read_bag
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, LockDetection, Outcome, Step
from scoring.result import Result
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.faulty_source import FaultyDrive
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.testbeds.truth import truth_of_testbed
from tests.slowly import slow_but_for


def values(path: Path) -> dict[str, object]:
    document = json.loads((path / "result.json").read_text())
    return {name: i["value"] for name, i in document["indicators"].items()}


def folder_of(drive: Drive) -> Path:
    assert drive.engine.folder is not None
    return drive.engine.folder


def snapshot_faults(snapshot: Snapshot) -> str:
    return "\n".join(snapshot.faults)


def test_a_nominal_run_is_completed_recorded_and_scored(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    scored = drive.engine.scored
    assert scored is not None
    assert scored.result.outcome is Outcome.COMPLETED
    assert all(i.value is not None for i in scored.result.indicators.values())
    assert scored.result.quality.remarks == ()
    names = {path.name for path in folder_of(drive).iterdir()}
    prefix = "subject_003_cond_001_run_001"
    assert folder_of(drive).name.startswith(prefix)
    assert names == {
        f"{folder_of(drive).name}_0.mcap", "metadata.yaml", f"run_info_{prefix}.yaml",
        "condition_1.yaml", f"{prefix}_event.csv", f"{prefix}_jointState.csv",
        f"{prefix}_wrench.csv", "journal.jsonl", "result.json",
        *(f"{name}.yaml" for name in IndicatorName),
    }  # fmt: skip


def test_the_recording_has_a_second_before_the_start_and_after_the_stop(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup(countdown=0.0))
    run = drive.engine.run
    assert run.start is not None
    assert run.stop is not None
    times = [m.receive_ns / 1e9 for m in read_bag(folder_of(drive)).messages()]
    assert min(times) <= run.start - 0.99
    assert max(times) >= run.stop + 1.0 + 0.99  # the settle time, then the post-roll


@pytest.mark.parametrize("ruleset", list(RulesetName))
@pytest.mark.parametrize(
    "scenario",
    slow_but_for([Scenario.NOMINAL, Scenario.BOUNCES, Scenario.OPEN_ONLY], Scenario.BOUNCES),
)
def test_bag_replay_and_live_run_give_the_same_digits(
    scenario: Scenario, ruleset: RulesetName, tmp_path: Path
) -> None:
    drive = Drive(tmp_path, scenario, seed=5)
    drive.whole_run(make_setup(ruleset=ruleset, timeout=30.0))
    live, folder = drive.engine.scored, folder_of(drive)
    assert live is not None
    drive.engine.close()
    again = next(score(folder)).result
    assert again == live.result
    bag_alone = tmp_path / "elsewhere"
    bag_alone.mkdir()
    for name in (f"{folder.name}_0.mcap", "metadata.yaml"):
        (bag_alone / name).write_bytes((folder / name).read_bytes())
    assert next(score(bag_alone)).result == live.result
    assert replayed(folder) == live.result
    assert replayed(bag_alone) == live.result


def test_abort_wins_at_once_keeps_the_run_and_opens_a_clean_next_one(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("robot on fire"))
    assert drive.engine.run.phase is Phase.STOPPED
    assert drive.engine.snapshot().elapsed == pytest.approx(3.0, abs=0.05)
    drive.finish()
    document = json.loads((folder_of(drive) / "result.json").read_text())
    assert (document["outcome"], document["outcome_reason"]) == ("aborted", "robot on fire")
    assert {i["reason"] for i in document["indicators"].values()} == {"run aborted: invalid"}
    assert not list(folder_of(drive).glob("execution_time.yaml"))
    assert drive.engine.next_run_number(3, 1) == 2
    drive.act(SetUp(make_setup(run_number=2)))
    clean = drive.engine.snapshot()
    assert (clean.result, clean.folder, clean.elapsed, clean.provisional) == (None, None, None, {})
    assert not clean.run.pose_confirmed


def test_an_abort_in_the_countdown_is_kept_as_invalid(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.prepare(make_setup(countdown=5.0))
    drive.act(Start())
    drive.wait(1.0)
    drive.act(Abort())
    drive.finish()
    document = json.loads((folder_of(drive) / "result.json").read_text())
    assert (document["outcome"], document["events"]) == ("aborted", [])


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
    assert values(folder_of(drive))["execution_time"] == pytest.approx(5.0, abs=0.05)


def test_a_timeout_within_the_settle_time_waits_for_its_end(tmp_path: Path) -> None:
    needed = values(completed())[IndicatorName.EXECUTION_TIME]
    assert isinstance(needed, float)
    drive = Drive(tmp_path)
    drive.whole_run(make_setup(timeout=needed + 0.5))
    assert drive.engine.run.outcome is Outcome.COMPLETED
    assert values(folder_of(drive))["execution_time"] == pytest.approx(needed, abs=1e-6)
    late = Drive(tmp_path)
    late.whole_run(make_setup(timeout=needed - 0.05, run_number=2))
    assert late.engine.run.outcome is Outcome.TIMEOUT


def test_a_declared_timeout_within_the_settle_time_waits_too(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait_until(lambda: drive.engine.snapshot().settling)
    drive.act(DeclareTimeout("too slow"))
    drive.finish()
    assert drive.engine.run.outcome is Outcome.COMPLETED


def test_checks_stand_in_the_way_until_they_are_waived(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup()))
    states = {c.name: c.state for c in drive.engine.snapshot().checks}
    assert states[CheckName.DOOR] is CheckState.NO_DATA
    drive.wait(1.5)
    refusal = drive.engine.perform(Start())
    assert refusal is not None
    assert refusal.startswith("handle at rest")
    drive.act(Waive(CheckName.HANDLE, "spring is warm"), ConfirmPose())
    drive.act(Start())
    drive.finish()
    assert drive.engine.scored is not None
    assert "check waived: handle at rest: spring is warm" in (
        drive.engine.scored.result.quality.remarks
    )


def test_the_handle_zero_makes_the_touch_right(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.prepare(make_setup())
    assert drive.engine.run.handle_zero == pytest.approx(5.9, abs=0.05)
    drive.act(Start())
    drive.finish()
    touched = values(folder_of(drive))["time_to_handle"]
    assert isinstance(touched, float)
    assert touched > 1.0


def test_a_false_start_is_shown_and_decided(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
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
    assert next(score(folder_of(drive))).result == scored.result


def test_what_was_up_before_the_countdown_is_no_false_start(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup(countdown=3.0)))
    drive.wait(1.5)  # the handle is not zeroed: it counts as pressed all the time
    drive.act(Waive(CheckName.HANDLE, "stuck"), ConfirmPose(), Start())
    drive.wait(1.0)
    drive.act(RestartCountdown("again"))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    assert drive.engine.run.false_starts == ()
    drive.engine.close()


def test_an_accepted_false_start_stands_in_the_result(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.prepare(make_setup(countdown=6.0))
    drive.act(Start())
    drive.source.testbed.start(drive.clock.now_ns() - 2_500_000_000)
    drive.wait_until(lambda: bool(drive.engine.run.false_starts))
    drive.act(AcceptFalseStart("a draught"))
    drive.wait(5.0)
    drive.act(Abort("enough"))
    drive.finish()
    document = json.loads((folder_of(drive) / "result.json").read_text())
    assert document["false_starts"][0]["accepted"] == "a draught"


def test_the_referee_can_stop_a_run_that_only_he_can_judge(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup(lock_detection=LockDetection.REFEREE))
    drive.wait_until(lambda: drive.engine.snapshot().ask_referee is not None)
    drive.wait(2.0)
    judged = drive.engine.now()
    drive.act(Rule(Step.LOCK, confirmed=True, reason="heard the click"))
    drive.finish()
    assert (drive.engine.run.outcome, drive.engine.run.stop) == (Outcome.COMPLETED, judged)


def test_the_latch_sensor_decides_where_there_is_one(tmp_path: Path) -> None:
    drive = Drive(tmp_path, latch=True)
    drive.whole_run(make_setup())
    scored, truth = drive.engine.scored, truth_of_testbed(drive.source.testbed, 60.0)
    assert scored is not None
    assert truth is not None
    assert scored.result.lock_detection is LockDetection.SENSOR
    assert scored.result.stop == pytest.approx(truth.stop, abs=0.025)


def test_a_ruling_after_the_stop_changes_the_result_on_disk_and_keeps_what_was_found(
    tmp_path: Path,
) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    drive.act(Rule(Step.CROSS, confirmed=False, reason="arm only"))
    document = json.loads((folder_of(drive) / "result.json").read_text())
    step = document["steps"][3]
    assert document["indicators"]["capability_level"]["value"] == 3
    assert step["sensors"] is not None
    assert (step["referee"]["reason"], step["final"]) == ("arm only", None)
    assert next(score(folder_of(drive))).result == drive.engine.scored.result  # type: ignore[union-attr]


def test_a_reissue_gets_a_number_and_the_old_result_stays(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee", "they saw it differently"))
    first = (folder_of(drive) / "result.json").read_bytes()
    drive.act(Reissue("appeal granted"), Rule(Step.LOCK, confirmed=False, reason="video"))
    drive.act(Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"))
    assert (folder_of(drive) / "result_issue_1.json").read_bytes() == first
    second = json.loads((folder_of(drive) / "result.json").read_text())
    assert (second["issue"], second["closure"]["team_word"]) == (2, "acknowledged")


def test_every_act_and_change_is_in_the_journal_and_in_the_bag(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.act(MarkIncident(IncidentKind.COLLISION, "door frame"))
    drive.finish()
    entries, remarks = read_journal(folder_of(drive) / "journal.jsonl")
    assert remarks == ()
    what = [entry.what for entry in entries]
    assert what[:4] == ["set up", "zero the handle", "confirm the start pose", "start"]
    assert what[4:6] == ["run starts", "mark an incident"]
    assert what[-2:] == ["run stops", "result written"]
    assert {e.referee for e in entries if e.origin == "referee"} == {"R. Eferee"}
    bag = read_bag(folder_of(drive))
    counted = [m for m in bag.messages() if m.topic == "/madrob/referee/event"]
    assert len(counted) == len(entries) - 1  # the result is written after the bag is closed
    topics = {m.topic for m in bag.messages()}
    assert {"/madrob/referee/state", "/madrob/referee/start_pose"} <= topics


def test_robot_and_bag_hear_of_every_set_up_and_of_every_countdown(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup(timeout=5.0))
    again = SetUp(make_setup(run_number=2, timeout=5.0))
    drive.act(again)
    assert drive.engine.log.lines[0].relative is None  # not a time of the run before
    drive.act(again)
    drive.wait(1.5)
    drive.act(ZeroHandle(), ConfirmPose(), Start())
    drive.wait(1.0)
    drive.act(RestartCountdown())
    drive.finish()
    said = [m for m in read_bag(folder_of(drive)).messages() if "/referee/" in m.topic]
    assert [m.topic.rpartition("/")[2] for m in said[:3]] == ["event", "start_pose", "state"]
    states = [m.data for m in said if m.topic == "/madrob/referee/state"]
    phases = [str(json.loads(data[8:].rstrip(b"\0"))["phase"]) for data in states]
    assert phases == ["ready", "countdown", "countdown", "running", "stopped"]
    starts = [json.loads(data[8:].rstrip(b"\0"))["start_time"] for data in states]
    assert starts[2] == pytest.approx(starts[1] + 1.0, abs=0.05)


def test_what_is_recorded_of_the_console_is_what_it_published(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drive.whole_run(make_setup())
    assert drive.engine.folder is not None
    recorded = [m for m in read_bag(drive.engine.folder).messages() if "/referee/" in m.topic]
    published = drive.faulty.published
    in_bag = [(m.topic, m.type, m.data) for m in recorded]
    said = [(m.topic, m.type, m.data) for m in published]
    begin = said.index(in_bag[0])
    assert said[begin : begin + len(in_bag)] == in_bag
    assert {m.topic for m in recorded} == {topic.name for topic in referee_topics(MessageTypes())}
    assert all(m.publish_ns <= m.receive_ns for m in recorded)


def test_a_used_run_number_is_refused_and_nothing_is_overwritten(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup(timeout=5.0))
    before = {p.name: p.stat().st_size for p in folder_of(drive).iterdir()}
    first = folder_of(drive)
    drive.prepare(make_setup())
    refusal = drive.engine.perform(Start())
    assert refusal is not None
    assert "use run 2" in refusal
    assert drive.engine.run.phase is Phase.READY
    assert {p.name: p.stat().st_size for p in first.iterdir()} == before


def test_an_unwritable_results_folder_refuses_the_start_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("a file, not a folder")
    drive = Drive(tmp_path / "results")
    drive.prepare(make_setup())
    refusal = drive.engine.perform(Start())
    assert refusal is not None
    assert "\n" not in refusal
    assert str(tmp_path / "results") in refusal
    assert drive.engine.run.phase is Phase.READY


def test_closing_during_a_run_keeps_it_as_interrupted(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(4.0)
    drive.engine.close()
    document = json.loads((folder_of(drive) / "result.json").read_text())
    assert document["outcome"] == "interrupted"
    assert document["indicators"]["time_to_handle"]["value"] is not None
    assert document["indicators"]["execution_time"]["reason"] == "no benchmark stop"
    assert read_bag(folder_of(drive)).complete
    assert next(score(folder_of(drive))).result == drive.engine.scored.result  # type: ignore[union-attr]


def replayed(folder: Path) -> Result:
    config = EngineConfig(folder.parent, DEFAULT_MAPPINGS, disk_needed=0)
    types = MessageTypes()
    engine = Engine.of_recording(Replay(folder, types, speed=0), config, types)
    engine.open()
    while engine.scored is None:
        engine.step(0.02)
    return engine.scored.result


def test_a_recording_that_was_cut_off_is_interrupted_in_score_and_replay(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(6.0)
    drive.wait_for_disk()
    cut = tmp_path / "cut"
    shutil.copytree(folder_of(drive), cut)  # what a kill at this moment leaves behind
    drive.engine.close()
    scored = next(score(cut)).result
    assert scored.outcome is Outcome.INTERRUPTED
    assert replayed(cut) == scored
    assert scored.indicators[IndicatorName.EXECUTION_TIME].value is None
    assert scored.indicators[IndicatorName.TIME_TO_HANDLE].value is not None


class Silenced(Drive):
    """A testbed of which some topics can be made to say something else, or nothing."""

    def change(self, topic: str, data: bytes | None) -> None:
        take = self.source.take

        def changed(timeout: float) -> list[RawMessage]:
            messages = take(timeout)
            if data is None:
                return [m for m in messages if m.topic != topic]
            return [replace(m, data=data) if m.topic == topic else m for m in messages]

        self.source.take = changed  # type: ignore[method-assign]


def test_a_dead_topic_is_named_and_its_values_vanish(tmp_path: Path) -> None:
    drive = Silenced(tmp_path)
    drive.start(make_setup(timeout=8.0))
    assert snapshot_faults(drive.engine.snapshot()) == ""
    drive.change("/madrob/door/angle", None)
    drive.wait(1.0)
    stale = drive.engine.snapshot()
    assert stale.door.angle is None
    assert "/madrob/door/angle: stale" in snapshot_faults(stale)
    drive.wait(1.5)
    assert "/madrob/door/angle: lost" in snapshot_faults(drive.engine.snapshot())
    drive.finish()
    assert drive.engine.run.outcome is Outcome.TIMEOUT


def test_undecodable_bytes_are_recorded_named_and_counted(tmp_path: Path) -> None:
    drive = Silenced(tmp_path)
    drive.start(make_setup(timeout=4.0))
    drive.change("/madrob/handle/force", b"\x00\x01\x00\x00junk")
    drive.wait(0.5)
    assert "/madrob/handle/force" in snapshot_faults(drive.engine.snapshot())
    drive.finish()
    assert drive.engine.scored is not None
    remarks = drive.engine.scored.result.quality.remarks
    assert any("/madrob/handle/force" in r and "times" in r for r in remarks)
    junk = [m for m in read_bag(folder_of(drive)).messages() if m.data.endswith(b"junk")]
    assert len(junk) > 100
    assert next(score(folder_of(drive))).result.indicators == (
        drive.engine.scored.result.indicators
    )


def test_without_a_testbed_nothing_starts_and_nothing_is_shown_as_good(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
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


@pytest.mark.slow
def test_the_condition_decides_which_side_is_the_destination(tmp_path: Path) -> None:
    for number in (1, 6, 11, 16):
        condition = Condition.from_number(number)
        drive = Drive(tmp_path, seed=number)
        drive.whole_run(make_setup(condition))
        assert drive.engine.run.outcome is Outcome.COMPLETED, number
        names = [e.event for e in drive.engine.scored.result.events]  # type: ignore[union-attr]
        assert f"humanoid_moves_to_{condition.destination_side}_side" in names


def test_zeroing_without_data_is_refused(tmp_path: Path) -> None:
    assert Drive(tmp_path).engine.perform(ZeroHandle()) == "no fresh handle force"
