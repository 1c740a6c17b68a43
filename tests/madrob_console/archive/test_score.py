"""`madrob_console.archive.score`: what programs call."""

from __future__ import annotations

from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.errors import MadrobError
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName
from scoring.rulesets import RulesetName
from tests.madrob_console.recorded_runs import copy_run, publish, recorded


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
    assert run.condition.number == 1


def test_what_is_no_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(MadrobError, match="nothing"):
        next(score(tmp_path / "nothing"))
