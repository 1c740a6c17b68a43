"""What is said of a run after a rule change, beside its values."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import pytest

from madrob_console.archive.rule_change import RuleChange, next_issue, write_next_issue
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import open_run, score_opened
from madrob_console.errors import MadrobError
from scoring.quality import BY_THE_RULES
from scoring.rulesets import RulesetName
from tests.madrob_console.recorded_runs import completed, without_digests


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return shutil.copytree(completed(), tmp_path / completed().name)


def reissue(folder: Path, rules: RulesetName) -> None:
    made = next_issue(RunPath(folder), RuleChange("rules of May", rules, "Ada", 1_800_000_100.0))
    assert made is not None
    write_next_issue(made, 1_800_000_101.0)


def told_of_rules(folder: Path) -> list[str]:
    remarks = score_opened(folder).result.quality.remarks
    return [remark for remark in remarks if remark.startswith(BY_THE_RULES)]


def test_where_other_rules_stop_a_run_is_said_only_while_they_count(run: Path) -> None:
    reissue(run, RulesetName.ROBUST_2026)
    assert len(told_of_rules(run)) == 1
    reissue(run, RulesetName.PROTOCOL)
    assert told_of_rules(run) == []


def test_a_torn_recording_that_has_all_steps_has_lost_none_by_other_rules(run: Path) -> None:
    reissue(run, RulesetName.ROBUST_2026)
    bag = next(run.glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[:-60])  # its footer
    remarks = open_run(run).assessment.quality().remarks
    assert not any("is lost" in remark for remark in remarks)


def test_a_result_that_was_put_beside_another_run_is_not_issued_again_as_that_one(
    run: Path,
) -> None:
    path = run / "result.json"
    document = msgspec.json.decode(path.read_bytes())
    path.write_bytes(msgspec.json.encode(document | {"subject": 41}))
    without_digests(run)
    change = RuleChange("rules of May", None, "Ada", 1_800_000_100.0)
    with pytest.raises(MadrobError, match=r"of another run .*subject: stored 41, now 3"):
        next_issue(RunPath(run), change)
