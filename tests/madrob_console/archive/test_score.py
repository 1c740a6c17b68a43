"""`madrob_console.archive.score`: what programs call."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.archive.scored import read_recorded_run
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Rule
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import read_bag
from scoring.indicator_table import IndicatorName
from scoring.protocol import EventName, Step
from scoring.result import Result
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import completed, copy_run, publish, recorded


def test_a_run_folder_and_its_bag_give_the_result_of_the_run() -> None:
    folder = recorded(Scenario.TOUCH_ONLY)
    (run,) = score(folder)
    assert run.path == folder
    assert (run.result.outcome, run.result.ruleset) == ("timeout", "protocol")
    assert list(run.result.indicators) == list(IndicatorName)
    assert run.condition.number == 1
    assert run.rows.joint_state.time.size > 100
    (bag,) = folder.glob("*.mcap")
    (alone,) = score(str(bag))
    assert alone.result == run.result


def test_a_results_folder_gives_every_run_by_the_rules_that_were_asked_for(tmp_path: Path) -> None:
    names = [copy_run(tmp_path, number).name for number in (1, 2)]
    scored = list(score(tmp_path, RulesetName.EUROBENCH_2020))
    assert [run.path.name for run in scored] == names
    assert {run.result.ruleset for run in scored} == {RulesetName.EUROBENCH_2020}


def test_published_files_are_scored_as_they_stand(tmp_path: Path) -> None:
    publish(recorded(Scenario.NOMINAL), tmp_path)
    (run,) = score(tmp_path)
    assert run.result.quality.remarks[0].startswith("scored from published files")
    assert run.result.quality.remarks[1].startswith("no uncertainty is known of the values")
    assert run.condition.number == 1


def remarks_on(result: Result, indicator: str) -> list[str]:
    return [one for one in result.quality.remarks if one.startswith(indicator)]


def test_published_files_that_are_cut_to_the_run_say_that_unsafety_may_be_another(
    tmp_path: Path,
) -> None:
    folder = recorded(Scenario.TOUCH_ONLY)
    publish(folder, tmp_path)
    (cut,), (whole,) = score(tmp_path), score(folder)
    (remark,) = remarks_on(cut.result, "unsafety")
    assert "no acceleration from before and after the run" in remark
    assert remarks_on(whole.result, "unsafety") == []
    assert remarks_on(cut.result, "steps and outcome") == []  # the events are the protocol's


@pytest.fixture(scope="module")
def left_after_the_stop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by the published rules whose robot is under the sensors when its time is over."""
    root = tmp_path_factory.mktemp("results")
    drive = Drive(root, Scenario.CLOSES_UNDER_SENSORS)
    drive.whole_run(make_setup(timeout=7.9, ruleset=RulesetName.EUROBENCH_2020))
    drive.engine.close()
    return drive.folder


def test_files_with_an_event_after_the_stop_are_in_order_and_score_as_the_recording_does(
    left_after_the_stop: Path, tmp_path: Path
) -> None:
    publish(left_after_the_stop, tmp_path)
    (files,), (bag,) = score(tmp_path, RulesetName.EUROBENCH_2020), score(left_after_the_stop)
    names = [event.event for event in files.result.events]
    assert names[-2:] == [EventName.BENCHMARK_STOP, EventName.MOVES_TO_CCW]
    assert {name: (i.value, i.reason) for name, i in files.result.indicators.items()} == {
        name: (i.value, i.reason) for name, i in bag.result.indicators.items()
    }
    assert (files.result.outcome, files.result.events) == (bag.result.outcome, bag.result.events)
    assert remarks_on(files.result, "unsafety") == []  # its rows are the whole recording


def test_files_by_other_rules_say_that_outcome_and_filters_are_theirs(
    left_after_the_stop: Path, tmp_path: Path
) -> None:
    publish(left_after_the_stop, tmp_path)
    (files,) = score(tmp_path, RulesetName.PROTOCOL)
    for about in ("steps and outcome", "unsafety and smoothness"):
        (remark,) = remarks_on(files.result, about)
        assert "eurobench-2020" in remark
    last, stop = files.result.events[-2:]  # who leaves after the stop has left at the stop
    assert (last.event, stop.event) == (EventName.MOVES_TO_CCW, EventName.BENCHMARK_STOP)
    assert last.time == stop.time == files.result.stop


def test_what_is_no_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(MadrobError, match="nothing"):
        next(score(tmp_path / "nothing"))


def test_what_completed_a_run_and_did_not_reach_the_disk_is_named_and_can_be_confirmed(
    tmp_path: Path,
) -> None:
    """The journal's line is on disk at once, what it was decided by half a second later."""
    folder = tmp_path / completed().name
    shutil.copytree(completed(), folder)
    for result in (*folder.glob("result*.json"), folder / "metadata.yaml"):
        result.unlink()
    (bag,) = folder.glob("*.mcap")
    whole = bag.read_bytes()

    def remarks() -> list[str]:
        (run,) = score(folder)
        assert run.result.outcome == "completed"
        return [remark for remark in run.result.quality.remarks if "was completed" in remark]

    assert remarks() == []  # nothing that counts is lost
    stop = read_recorded_run(folder).run.stop
    assert stop is not None
    for end in range(len(whole), 0, -len(whole) // 100):
        bag.write_bytes(whole[:end])
        if max(message.receive_ns for message in read_bag(folder).messages()) < 1e9 * stop:
            break
    (lost,) = remarks()
    assert "what was seen of step 5 and 6 is lost, only the referee can confirm it" in lost
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(*(Rule(step, confirmed=True, reason="video") for step in (Step.CLOSE, Step.LOCK)))
    assert drive.scored().result.indicators[IndicatorName.CAPABILITY_LEVEL].value == 6
    drive.engine.close()
    assert remarks() == [lost]  # as it stands in the result
