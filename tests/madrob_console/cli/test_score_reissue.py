"""`madrob score --reissue`: results in bulk after a rule change."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from functools import partial
from io import StringIO
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import msgspec
import pandas as pd
import pytest

from madrob_console.archive import issuing
from madrob_console.archive.rule_change import RuleChange, next_issue, write_next_issue
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import open_run
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.referee.acts import Rule
from madrob_console.referee.journal import HOLD_FILE, read_journal
from madrob_console.referee.rebuild import Change, mark_of
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import RulesetName
from scoring.protocol import Step
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.recorded_runs import (
    aborted,
    appealed,
    completed,
    note_again,
    recorded,
)

REISSUE = "score --jobs 1 --reissue 'rules of May'"
OTHER = f"{REISSUE} --ruleset eurobench-2020"


def digest(root: Path) -> dict[str, str]:
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != HOLD_FILE
    }


def result(folder: Path, name: str = "result.json") -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / name).read_text())
    return found


def reissues(folder: Path) -> list[dict[str, Any]]:
    lines = map(json.loads, (folder / "journal.jsonl").read_text().splitlines())
    return [line for line in lines if line["what"] == Change.REISSUED]


def copy(source: Path, root: Path) -> Path:
    return Path(shutil.copytree(source, root / source.name))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return copy(completed(), tmp_path / "results")


def test_a_result_that_is_another_one_gets_its_next_issue_and_a_line_in_the_journal(
    folder: Path, tmp_path: Path, madrob: Madrob
) -> None:
    before = result(folder)
    settings = tmp_path / "settings.toml"
    settings.write_text('[competition]\nreferee = "O. Rganiser"\n')
    first, counts = madrob(OTHER, folder, "--settings", settings).splitlines()
    assert first.startswith(f"{folder}: version 2: ")
    assert "capability level 6 -> 4" in first
    assert counts == "1 of 1 result re-issued"
    after = result(folder)
    assert (after["issue"], after["ruleset"]) == (2, "eurobench-2020")
    assert after["setup"] == before["setup"]  # what was set stays on record
    said = {"issue": 2, "reason": "rules of May", "ruleset": "eurobench-2020"}
    (again,) = after["reissues"]
    assert again.items() >= {**said, "referee": "O. Rganiser"}.items()
    assert result(folder, "result_issue_1.json") == before
    (line,) = reissues(folder)
    who = {"origin": "referee", "referee": "O. Rganiser", "reason": "rules of May"}
    assert {**line, **who, "details": {"ruleset": "eurobench-2020"}} == line


def test_a_final_result_is_to_be_signed_again_and_what_was_decided_stays(
    tmp_path: Path, madrob: Madrob
) -> None:
    folder = copy(appealed(), tmp_path)
    before = result(folder)
    assert "version 3 (was final, acknowledged: not final any more): " in madrob(OTHER, folder)
    after = result(folder)
    assert after["closure"] is None
    assert [after[key] for key in ("rulings", "incidents")] == [
        before[key] for key in ("rulings", "incidents")
    ]
    run = open_run(folder).recorded.run
    assert (run.phase, run.issue, run.ruleset) == (Phase.STOPPED, 3, RulesetName.EUROBENCH_2020)


def test_a_dry_run_says_the_same_and_writes_nothing(
    folder: Path, tmp_path: Path, madrob: Madrob
) -> None:
    copy(appealed(), folder.parent / "other")
    before = digest(tmp_path)
    told = madrob(f"{OTHER} --dry-run", folder.parent)
    assert "2 of 2 results would be re-issued" in told
    assert "capability level 6 -> 4" in told
    assert digest(tmp_path) == before
    assert madrob(OTHER, folder.parent).splitlines()[:2] == told.splitlines()[:2]


def unchanged(_folder: Path) -> None:
    """As it was recorded."""


def with_other_uncertainties(folder: Path) -> None:
    document = result(folder)
    document["indicators"]["execution_time"]["uncertainty"] = {"u": 1.0, "expanded": 2.0}
    (folder / "result.json").write_text(json.dumps(document))
    note_again(folder)


@pytest.mark.parametrize(
    ("source", "spoil", "line"),
    [
        (completed, with_other_uncertainties, REISSUE),
        (aborted, unchanged, OTHER),
        (partial(recorded, Scenario.TOUCH_ONLY), unchanged, REISSUE),
    ],
)
def test_unchanged_runs_are_left_alone(
    source: Callable[[], Path],
    spoil: Callable[[Path], None],
    line: str,
    tmp_path: Path,
    madrob: Madrob,
) -> None:
    spoil(copy(source(), tmp_path))
    before = digest(tmp_path)
    assert madrob(line, tmp_path) == "0 of 1 result re-issued\n"
    assert digest(tmp_path) == before


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda run: (run / "result.json").unlink(), "has no result.json to re-issue"),
        (lambda run: (run / "journal.jsonl").unlink(), "has no journal.jsonl, where a re-issue"),
        (lambda run: next(run.glob("*.mcap")).unlink(), "No such file"),
        (
            lambda run: shutil.copy(next(appealed().glob("*.mcap")), next(run.glob("*.mcap"))),
            "the recording is not the one that its result was made of",
        ),
        (
            lambda run: Hold(run / HOLD_FILE),
            "a console works on this run: leave it there, then try again",
        ),
    ],
)
def test_a_run_that_cannot_be_re_issued_is_one_line_and_stays_as_it_is(
    spoil: Callable[[Path], object], words: str, folder: Path, madrob: Madrob
) -> None:
    holding = spoil(folder)
    before = digest(folder)
    said = madrob.say(OTHER, folder.parent)
    if isinstance(holding, Hold):
        holding.release()
    assert (words in said.err, said.err.count("\n"), said.out) == (
        True,
        1,
        "0 of 1 result re-issued\n",
    )
    assert digest(folder) == before


@pytest.mark.parametrize("source", [completed, appealed])
def test_what_the_referee_does_between_scoring_and_writing_is_not_overwritten(
    source: Callable[[], Path], tmp_path: Path
) -> None:
    folder = copy(source(), tmp_path)  # the second one is final, which no note changes
    change = RuleChange("rules of May", RulesetName.EUROBENCH_2020, "", 1700000098.0)
    made = next_issue(RunPath(folder), change)
    assert made is not None
    note = {"time": 1700000099.0, "origin": "referee", "what": "note", "details": {"note": "wait"}}
    with (folder / "journal.jsonl").open("a") as file:
        file.write(json.dumps(note) + "\n")
    before = digest(folder)
    with pytest.raises(Exception, match="the referee went on meanwhile"):
        write_next_issue(made, 1700000100.0)
    assert digest(folder) == before


GONE = "robust-2026"


def of_rules_that_have_gone(folder: Path, madrob: Madrob) -> None:
    """A re-issue by rules that a stored result names and nobody has any more."""
    madrob(OTHER, folder)
    for name in ("journal.jsonl", "result.json"):
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace("eurobench-2020", GONE))
    document = result(folder)
    mark = mark_of(read_journal(folder / "journal.jsonl")[0])
    document["journal"] = msgspec.to_builtins(mark)
    (folder / "result.json").write_text(json.dumps(document))
    note_again(folder)


def test_a_result_of_rules_that_have_gone_is_shown_and_scored_by_those_that_stay(
    folder: Path, madrob: Madrob
) -> None:
    of_rules_that_have_gone(folder, madrob)
    stored = result(folder)["indicators"]["smoothness_of_door_actuation"]["value"]
    (row,) = pd.read_csv(StringIO(madrob("table runs", folder))).to_dict("records")
    assert (row["ruleset"], row["issue"], row["valid"]) == (GONE, 2, True)
    assert GONE in madrob("standings --practice --details", folder.parent)
    values = pd.read_csv(StringIO(madrob("table indicators", folder))).set_index("indicator")
    assert values.value["smoothness_of_door_actuation"] == stored
    words = f"{folder}: ruleset '{GONE}' is not known: use --ruleset protocol or eurobench-2020\n"
    for line in ("score", "score --check", "score --json", "report", REISSUE):
        assert madrob.say(line, folder).err == f"madrob: {words}"
    before = digest(folder)
    assert "ruleset protocol" in madrob("score --ruleset protocol", folder)
    drive = Drive(folder.parent)
    with pytest.raises(MadrobError, match="is not known: use --ruleset"):
        drive.open(folder)
    drive.engine.close()
    assert digest(folder) == before
    assert "1 of 1 result re-issued" in madrob(f"{REISSUE} --ruleset protocol", folder)
    assert (result(folder)["issue"], result(folder)["ruleset"]) == (3, "protocol")
    assert result(folder, "result_issue_2.json")["ruleset"] == GONE
    madrob("score --check", folder)


class KilledError(BaseException):
    """Nothing after it is done."""


ISSUED = "indicators", "issue", "ruleset"


def test_whenever_it_is_killed_a_repair_and_the_next_try_make_one_whole_issue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    left, every, fsync = count(10**6, -1), 10**6, os.fsync

    def counted(number: int) -> None:
        if next(left) == 0:
            raise KilledError
        fsync(number)

    whole = copy(appealed(), tmp_path / "undisturbed")  # recorded before anything is counted
    monkeypatch.setattr(os, "fsync", counted)
    madrob(OTHER, whole)
    every, wanted = every - next(left), result(whole)
    assert every > 8
    for at in sorted({0, 1, every // 2, *range(every - 4, every)}):
        folder, left = copy(appealed(), tmp_path / str(at)), count(at, -1)
        with pytest.raises(KilledError):
            madrob(OTHER, folder)
        madrob("recover", folder)
        madrob(OTHER, folder)
        assert len(reissues(folder)) == len(reissues(appealed())) + 1
        made = result(folder)
        assert [made[key] for key in ISSUED] == [wanted[key] for key in ISSUED]
        assert result(folder, "result_issue_2.json") == result(appealed())
        assert not (folder / "result_issue_3.json").exists()
        madrob("score --check", folder)


@pytest.mark.parametrize(
    ("rules", "count", "issue"), [("eurobench-2020", 0, 3), ("protocol", 1, 4)]
)
def test_an_issue_that_a_full_disk_refused_is_told_then_and_recover_writes_it(
    rules: str, count: int, issue: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    madrob: Madrob,
) -> None:  # fmt: skip
    folder = copy(appealed(), tmp_path)
    full = Mock(side_effect=MadrobError("not written (No space left on device)"))
    with monkeypatch.context() as patch:
        patch.setattr(issuing, "_write", full)
        first, second = (madrob.complaint(OTHER, folder) for _ in range(2))
    words = "version 3 is journalled, its result is not written yet: `madrob recover`"
    assert re.search(rf"{words}.*\(not written \(No space left on device\)\)", first)
    assert "result.json is not what the journal says: `madrob recover`" in second
    assert "its result was made again from journal and recording" in madrob("recover", folder)
    assert f"{count} of 1 result re-issued" in madrob(f"{REISSUE} --ruleset {rules}", folder)
    assert (result(folder)["issue"], result(folder)["ruleset"]) == (issue, rules)


def test_the_report_of_a_run_is_made_anew_unless_a_console_works_on_it(
    folder: Path, madrob: Madrob
) -> None:
    madrob("report", folder)
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(Rule(Step.CROSS, False, "came back"))
    drive.engine.close()
    before = digest(folder)
    with Hold(folder / HOLD_FILE):
        madrob(OTHER, folder, code=2)
    assert digest(folder) == before
    madrob(OTHER, folder)
    assert "version 2" in (folder / "report.html").read_text()


@pytest.mark.parametrize("line", ["score --json", "table runs", "standings --json --practice"])
def test_a_path_that_is_no_text_is_one_in_tables_and_json(
    line: str, tmp_path: Path, madrob: Madrob
) -> None:
    for name in (b"hall \xff", b"the same run"):
        copy(recorded(Scenario.NOMINAL), tmp_path / os.fsdecode(name))
    assert "hall \ufffd/" in madrob(line, tmp_path)
