"""`madrob score --reissue`: results in bulk after a rule change."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from madrob_console.archive import repair
from madrob_console.archive.folders import RunPath
from madrob_console.archive.repair import RuleChange, next_issue, write_next_issue
from madrob_console.archive.scored import open_run
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import Hold
from madrob_console.export.table_columns import RUN_TABLES
from madrob_console.referee.acts import Abort, Rule
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Step
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import (
    appealed,
    completed,
    copy_run,
    recorded,
    without_digests,
)

ROBUST = ("--ruleset", "robust-2026")


def reissue(*arguments: object, reason: str = "rules of May") -> int:
    return main(["score", "--reissue", reason, "--jobs", "1", *map(str, arguments)])


def digest(root: Path) -> dict[str, str]:
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def result(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return found


def reissues(folder: Path) -> list[dict[str, Any]]:
    lines = map(json.loads, (folder / "journal.jsonl").read_text().splitlines())
    return [line for line in lines if line["what"] == Change.REISSUED]


def copy(source: Path, root: Path) -> Path:
    return Path(shutil.copytree(source, root / source.name))


def test_a_result_that_is_another_one_gets_its_next_issue_and_a_line_in_the_journal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy(completed(), tmp_path)
    before = result(folder)
    settings = tmp_path / "settings.toml"
    settings.write_text('[competition]\nreferee = "O. Rganiser"\n')
    assert reissue(folder, *ROBUST, "--settings", settings) == 0
    first, *summary = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{folder}: issue 2: ")
    assert "roughness of door actuation 18.0222 -> 12.0993" in first
    assert summary[0] == "1 re-issued, 0 unchanged, 0 left alone (see above)"
    after = result(folder)
    assert (after["issue"], after["ruleset"]) == (2, "robust-2026")
    assert after["setup"] == before["setup"]  # what was set stays on record
    (again,) = after["reissues"]
    assert (again["issue"], again["reason"]) == (2, "rules of May")
    assert (again["referee"], again["ruleset"]) == ("O. Rganiser", "robust-2026")
    assert json.loads((folder / "result_issue_1.json").read_text()) == before
    (line,) = reissues(folder)
    assert (line["origin"], line["referee"]) == ("referee", "O. Rganiser")
    assert (line["reason"], line["details"]) == ("rules of May", {"ruleset": "robust-2026"})


def test_a_re_issued_run_is_what_its_journal_says_for_everybody_who_reads_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy(completed(), tmp_path)
    assert reissue(folder, *ROBUST) == 0
    assert not open_run(folder).out_of_date
    assert main(["score", "--check", str(folder)]) == 0
    assert main(["recover", str(folder)]) == 0
    assert "made again" not in capsys.readouterr().out
    assert reissue(folder) == 0  # by the ruleset that it has now
    assert "0 re-issued, 1 unchanged" in capsys.readouterr().out
    assert reissue(folder, "--ruleset", "protocol") == 0
    assert result(folder)["issue"] == 3
    assert result(folder)["indicators"] == result(completed())["indicators"]


def test_a_final_result_is_to_be_signed_again_and_what_was_decided_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy(appealed(), tmp_path)
    before = result(folder)
    assert reissue(folder, *ROBUST) == 0
    assert "issue 3 (was final, acknowledged: not final any more): " in capsys.readouterr().out
    after = result(folder)
    assert after["closure"] is None
    assert after["rulings"] == before["rulings"]
    assert after["incidents"] == before["incidents"]
    run = open_run(folder).recorded.run
    assert (run.phase, run.issue, run.ruleset) == (Phase.STOPPED, 3, RulesetName.ROBUST_2026)


def test_a_dry_run_says_the_same_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "results"
    for hall, source in enumerate((completed(), appealed())):
        copy(source, root / str(hall))
    before = digest(tmp_path)
    assert reissue(root, *ROBUST, "--dry-run") == 0
    told = capsys.readouterr().out
    assert digest(tmp_path) == before
    assert "2 would be re-issued, 0 unchanged, 0 left alone" in told
    assert "0 of them count in the standings; 1 of them are final and to be signed again" in told
    assert "values that change: " in told
    assert reissue(root, *ROBUST) == 0
    done = capsys.readouterr().out
    assert done.splitlines()[:2] == told.splitlines()[:2]


def test_a_run_whose_level_changes_is_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy(completed(), tmp_path)
    assert reissue(tmp_path, "--ruleset", "eurobench-2020", "--dry-run") == 0
    assert "runs that change level: 6 -> 4: 1" in capsys.readouterr().out


def test_other_uncertainties_alone_make_no_next_issue(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy(completed(), tmp_path)
    document = result(folder)
    document["indicators"]["execution_time"]["uncertainty"] = {"u": 1.0, "expanded": 2.0}
    (folder / "result.json").write_text(json.dumps(document))
    without_digests(folder)
    assert reissue(folder) == 0
    assert "0 re-issued, 1 unchanged" in capsys.readouterr().out
    assert result(folder) == document


def test_unchanged_runs_are_left_alone_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (1, 2):
        copy_run(tmp_path, number)
    before = digest(tmp_path)
    assert reissue(tmp_path) == 0
    told = capsys.readouterr()
    assert told.out == "0 re-issued, 2 unchanged, 0 left alone (see above)\n"
    assert digest(tmp_path) == before


def test_an_aborted_run_has_no_indicators_to_re_issue(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(1.0)
    drive.act(Abort("fire"))
    drive.finish()
    drive.engine.close()
    assert reissue(tmp_path, *ROBUST) == 0
    assert "0 re-issued, 1 unchanged" in capsys.readouterr().out


def without_result(folder: Path) -> None:
    (folder / "result.json").unlink()


def without_journal(folder: Path) -> None:
    (folder / "journal.jsonl").unlink()


def without_recording(folder: Path) -> None:
    next(folder.glob("*.mcap")).unlink()


def with_another_recording(folder: Path) -> None:
    bag = next(folder.glob("*.mcap"))
    other = next(appealed().glob("*.mcap"))
    shutil.copy(other, bag)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (without_result, "has no result.json to re-issue"),
        (without_journal, "has no journal.jsonl, where a re-issue has to stand"),
        (without_recording, "No such file"),
        (with_another_recording, "the recording is not the one that its result was made of"),
    ],
)
def test_a_run_that_cannot_be_re_issued_is_one_line_and_stays_as_it_is(
    spoil: Callable[[Path], None], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(copy(completed(), tmp_path))
    before = digest(tmp_path)
    assert reissue(tmp_path, *ROBUST) == 2
    told = capsys.readouterr()
    assert words in told.err
    assert told.err.count("\n") == 1
    assert told.out == "0 re-issued, 0 unchanged, 1 left alone (see above)\n"
    assert digest(tmp_path) == before


def test_a_run_that_a_console_works_on_is_left_to_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy(completed(), tmp_path)
    before = digest(folder)
    with Hold(folder / HOLD_FILE):
        assert reissue(folder, *ROBUST) == 2
    assert "a console works on this run: leave it there, then try again" in capsys.readouterr().err
    assert digest(folder) == before


@pytest.mark.parametrize("source", [completed, appealed])
def test_what_the_referee_does_between_scoring_and_writing_is_not_overwritten(
    source: Callable[[], Path], tmp_path: Path
) -> None:
    folder = copy(source(), tmp_path)  # the second one is final, which no note changes
    made = next_issue(RunPath(folder), CHANGE)
    assert made is not None
    journal = folder / "journal.jsonl"
    note = {"time": 1700000099.0, "origin": "referee", "what": "note", "details": {"note": "wait"}}
    with journal.open("a") as file:
        file.write(json.dumps(note) + "\n")
    before = digest(folder)
    with pytest.raises(Exception, match="the referee went on meanwhile"):
        write_next_issue(made, 1700000100.0)
    assert digest(folder) == before


CHANGE = RuleChange("rules of May", RulesetName.ROBUST_2026, "", 1700000098.0)


class KilledError(BaseException):
    """Nothing after it is done."""


def test_whenever_it_is_killed_the_next_try_makes_one_whole_issue_and_no_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left, synced, fsync = 10**6, 0, os.fsync

    def counted(number: int) -> None:
        nonlocal left, synced
        if left == 0:
            raise KilledError
        fsync(number)
        left, synced = left - 1, synced + 1

    whole = copy(completed(), tmp_path / "undisturbed")  # recorded before anything is counted
    monkeypatch.setattr(os, "fsync", counted)
    assert reissue(whole, *ROBUST) == 0
    every, wanted = synced, result(whole)
    assert every > 8
    for at in sorted({0, 1, every // 2, every - 4, every - 3, every - 2, every - 1}):
        folder = copy(completed(), tmp_path / str(at))
        left = at
        with pytest.raises(KilledError):
            reissue(folder, *ROBUST)
        left = 10**6
        assert reissue(folder, *ROBUST) == 0
        assert len(reissues(folder)) == 1
        made = result(folder)
        assert made["indicators"] == wanted["indicators"]
        assert (made["issue"], made["ruleset"]) == (2, "robust-2026")
        assert json.loads((folder / "result_issue_1.json").read_text()) == result(completed())
        assert not (folder / "result_issue_2.json").exists()
        assert main(["score", "--check", str(folder)]) == 0


@pytest.mark.parametrize(
    ("rules", "count", "issue"), [("robust-2026", 1, 3), ("eurobench-2020", 2, 4)]
)
def test_an_issue_that_a_full_disk_refused_is_told_then_and_when_the_next_try_writes_it(
    rules: str,
    count: int,
    issue: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole, folder = copy(appealed(), tmp_path / "whole"), copy(appealed(), tmp_path / "refused")
    assert reissue(whole, *ROBUST) == 0
    line, *summary = capsys.readouterr().out.replace(str(whole), str(folder)).splitlines()
    assert "issue 3 (was final, acknowledged: not final any more): " in line

    def full(*_: object) -> None:
        raise MadrobError("not written (No space left on device)")

    with monkeypatch.context() as patch:
        patch.setattr(repair, "write_result", full)
        patch.setattr(repair, "write_result", full)
        for _ in range(2):
            assert reissue(folder, *ROBUST) == 2
            told = capsys.readouterr()
            assert "issue 3 is journalled, its result is not written yet: the same command" in (
                told.err
            )
            assert "(not written (No space left on device))" in told.err
            assert told.out.startswith("0 re-issued, 0 unchanged, 1 journalled and not written yet")
            assert told.out.endswith(", 0 left alone (see above)\n")
    assert reissue(folder, "--ruleset", rules) == 0
    found = capsys.readouterr().out.splitlines()
    assert found[0] == line
    assert f"{count} re-issued, 0 unchanged, 0 left alone (see above)" in found
    assert found[1:] == summary or count == 2
    assert (result(folder)["issue"], result(folder)["ruleset"]) == (issue, rules)


def test_reports_tell_of_the_issue_that_there_is(tmp_path: Path) -> None:
    folder = copy_run(tmp_path, 1, Scenario.TOUCH_ONLY)
    assert main(["report", str(folder)]) == 0
    assert reissue(folder, *ROBUST) == 0
    assert "issue 2" in (folder / "report.html").read_text()
    assert not list(recorded(Scenario.TOUCH_ONLY).glob("report.html"))


def test_the_report_of_a_run_that_a_console_works_on_is_left_to_it(tmp_path: Path) -> None:
    folder = copy(completed(), tmp_path)
    assert main(["report", str(folder)]) == 0
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(Rule(Step.CROSS, False, "came back"))
    drive.engine.close()
    before = digest(folder)
    with Hold(folder / HOLD_FILE):
        assert reissue(folder, *ROBUST) == 2
    assert digest(folder) == before
    assert reissue(folder, *ROBUST) == 0
    assert "issue 2" in (folder / "report.html").read_text()


TABLES = [table.name for table in RUN_TABLES]


def score(*arguments: object) -> int:
    try:
        return main(["score", *map(str, arguments)])
    except SystemExit as end:  # argparse
        return int(end.code or 0)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight runs, copies of two, and one that cannot be read."""
    root = tmp_path_factory.mktemp("results")
    for number in range(1, 9):
        # somebody renamed them: copies of one run are one run, so only two count
        copy_run(root, number, Scenario.NOMINAL if number % 2 else Scenario.TOUCH_ONLY)
    (root / "subject_009_cond_001_run_001_20231114_221323").mkdir()
    return root


def frame(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, keep_default_na=False)


def test_the_tables_of_fresh_results_are_those_of_the_stored_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(Scenario.NOMINAL)
    assert score(run, "--output", tmp_path / "out") == 0
    told = capsys.readouterr()
    assert told.out == f"{tmp_path / 'out'}: 1 runs, 0 of them cannot be read\n"
    for name in TABLES:
        assert main(["table", name, str(run)]) == 0
        stored = pd.read_csv(StringIO(capsys.readouterr().out), keep_default_na=False)
        pd.testing.assert_frame_equal(frame(tmp_path / f"out/{name}.csv"), stored)


def test_a_run_that_cannot_be_read_is_one_row_with_its_reason(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert score(results, "--output", tmp_path / "out", "--jobs", 1) == 2
    (row,) = frame(tmp_path / "out/unreadable.csv").to_dict("records")
    assert row["place"] == str(results / "subject_009_cond_001_run_001_20231114_221323")
    assert "no bag" in row["reason"]
    assert row["place"] in capsys.readouterr().err
    assert len(frame(tmp_path / "out/runs.csv")) == 2  # each run once


def test_a_path_that_is_no_text_is_one_in_tables_and_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / os.fsdecode(b"hall \xff")
    root.mkdir()
    shutil.copytree(recorded(Scenario.NOMINAL), root / recorded(Scenario.NOMINAL).name)
    assert score(root, "--output", tmp_path / "out") == 0
    (place,) = frame(tmp_path / "out" / "runs.csv")["place"]
    assert "hall \ufffd" in place
    capsys.readouterr()
    assert score(root, "--json") == 0
    assert "hall \ufffd" in json.loads(capsys.readouterr().out)["runs"][0]["path"]


def test_tables_are_there_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("madrob_console.cli.score_output.name_twins", interrupted)
    assert score(recorded(Scenario.TOUCH_ONLY), "--output", tmp_path / "out") == 130
    assert list(tmp_path.iterdir()) == []


def test_all_rulesets_stand_below_each_other_and_every_table_tells_them_apart(
    tmp_path: Path,
) -> None:
    run = recorded(Scenario.NOMINAL)
    assert score(run, "--output", tmp_path / "out", "--ruleset", "all") == 0
    for name in TABLES:
        assert set(frame(tmp_path / f"out/{name}.csv").ruleset) == set(RulesetName)
