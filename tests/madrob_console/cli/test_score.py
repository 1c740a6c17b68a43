"""`madrob score` over bags, run folders, published folders and results folders."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.run_paths import runs_at
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.archive.scored import score_run
from madrob_console.cli.output import MOST_ALIKE
from madrob_console.cli.result_lines import comparison_lines, result_lines
from madrob_console.cli.score_command import describe_run
from madrob_console.referee.acts import Rule
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Step
from scoring.result import Indicator, Result, Uncertainty
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import (
    aborted,
    completed,
    copy_run,
    publish,
    recorded,
)
from tests.recorder.samples import all_within

PUBLISHED = ("--ruleset", "eurobench-2020")
LABEL = ("subject", "team", "condition", "run", "run_id", "testbed", "competition")
"""What `score --json` says of each run besides its result."""


def scored(madrob: Madrob, *arguments: object) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(madrob.say("score --json", *arguments).out)["runs"]
    return found


def values(of: Mapping[str, Any]) -> dict[str, float | None]:
    return {name: one["value"] for name, one in of["indicators"].items()}


TWO = RulesetName.PROTOCOL, RulesetName.EUROBENCH_2020


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with three runs."""
    root = tmp_path / "results"
    copy_run(root, 2)
    copy_run(root, 3)
    copy_run(root, 1, Scenario.NOMINAL)
    return root


def test_every_run_of_a_results_folder_is_scored_in_the_order_of_their_names(
    results: Path, madrob: Madrob
) -> None:
    runs = sorted(map(str, results.glob("subject_*")))
    (results / "notes").mkdir()
    elsewhere = recorded(Scenario.NOMINAL)
    (results / elsewhere.name.replace("_run_001_", "_run_009_")).symlink_to(elsewhere)
    said = madrob.say("score", results)
    assert [line for line in said.out.splitlines() if line.startswith("/")] == runs
    assert said.err == f"madrob: note: {runs[2]} is the same run as {runs[1]}\n"


def test_a_run_has_the_digits_of_its_result_and_says_whose_and_which_it_is(madrob: Madrob) -> None:
    run = completed()
    stored = json.loads((run / "result.json").read_text())
    (told,) = scored(madrob, run)
    for key in ("indicators", "events", "quality"):
        assert told[key] == stored[key]
    assert (told["path"], told["outcome"]) == (str(run), "completed")
    names = {"condition": "condition_number", "run": "run_number"}
    assert {key: told[key] for key in LABEL} == {key: stored[names.get(key, key)] for key in LABEL}
    drift = told["rest"]["after"]["mean"] - stored["handle_zero"]
    assert told["rest"]["drift"] == drift
    words = r"handle at rest: 5\.\d{3} N before; 5\.\d{3} N after, drift [+-]\d\.\d{3} N"
    assert re.search(words, madrob("score", run))


def test_what_a_decision_hangs_on_comes_before_the_numbers(tmp_path: Path, madrob: Madrob) -> None:
    folder = shutil.copytree(completed(), tmp_path / completed().name)
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(Rule(Step.CROSS, confirmed=False, reason="a wheel stayed on the line"))
    drive.engine.close()
    assert madrob("score", folder).splitlines()[1:3] == [
        "  outcome: completed (3 of 6 steps count: the referee denied step 4), ruleset protocol",
        "  flags: step 4 denied; PRACTICE, SIMULATED: not an official result",
    ]
    (told,) = scored(madrob, folder)
    assert [(flag["kind"], flag["weight"], flag["undecided"]) for flag in told["flags"]] == [
        ("denied step", "caution", False),
        ("practice", "remark", False),
    ]


def test_an_aborted_run_has_one_reason_a_ruleset(madrob: Madrob) -> None:
    for ruleset, heads in {
        "protocol": ["indicators: none"],
        "all": sorted(f"indicators, {name}" for name in RulesetName),
    }.items():
        text = madrob(f"score --ruleset {ruleset}", aborted())
        told = re.findall("^  (.*): run aborted: invalid$", text, re.MULTILINE)
        assert sorted(told) == heads


def test_a_bad_run_is_named_and_the_rest_is_scored(results: Path, madrob: Madrob) -> None:
    empty = results / "subject_003_cond_001_run_004_20231114_221323"
    empty.mkdir()
    torn = next(results.glob("*_run_002_*"))
    (torn / "metadata.yaml").write_text("half a")
    os.truncate(next(torn.glob("*.mcap")), 40)
    said = madrob.say("score", results)
    assert (said.code, said.out.count("outcome: ")) == (2, 2)
    for line, named in zip(said.err.splitlines(), (torn, empty), strict=True):
        assert str(named) in line


def test_check_names_a_withdrawn_start(tmp_path: Path, madrob: Madrob) -> None:
    folder = tmp_path / completed().name
    folder.mkdir()
    before = (completed() / JOURNAL_FILE).read_text().partition('"what": "countdown begins"')[0]
    line = Entry(3.0, Origin.SYSTEM, "withdrawn", reason="the disk hung", details={"act": "start"})
    journal = f"{before[: before.rindex(chr(10))]}\n{line.to_json()}\n"
    (folder / JOURNAL_FILE).write_text(journal)

    text = madrob("score --check", folder)

    assert text == f"{folder}: withdrawn, no run\n"
    assert madrob.document("score --check", folder)["runs"][0]["grade"] == "withdrawn, no run"


def test_check_says_how_many_messages_a_recording_lacks(tmp_path: Path, madrob: Madrob) -> None:
    folder = copy_run(tmp_path, 1, Scenario.NOMINAL)
    line = Entry(3.0, Origin.SYSTEM, Change.UNRECORDED, details={"messages": 3})
    with (folder / JOURNAL_FILE).open("a") as journal:
        journal.write(f"{line.to_json()}\n")

    words = madrob.refusal("score --check", folder)

    assert f"{folder}: cannot be checked: lacks 3 messages; its result stays" in words


@pytest.mark.machine
def test_the_same_is_printed_however_the_work_is_shared(results: Path, madrob: Madrob) -> None:
    (results / "subject_003_cond_001_run_000_20231114_221323").mkdir()
    alone, shared = (madrob.say(f"score --jobs {jobs}", results) for jobs in (1, 2))
    assert alone == shared
    assert alone.code == 2


class Terminal(io.StringIO):
    """Says that somebody looks at it."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("runs", "bar"), [(1, "0/?"), (5, "5/5")])
def test_a_bar_shows_how_far_work_is_where_somebody_looks(
    runs: int, bar: str, monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert madrob("score", *(f"/nowhere/{number}" for number in range(runs)), code=2) == ""
    told = terminal.getvalue()
    assert bar in told
    assert all(f"/nowhere/{number}" in told for number in range(min(runs, MOST_ALIKE)))
    assert ("and 2 more like it" in told) is (runs == 5)


def test_all_rulesets_stand_side_by_side_with_their_differences(madrob: Madrob) -> None:
    runs = recorded(Scenario.NOMINAL), recorded(Scenario.TOUCH_ONLY)
    beside = scored(madrob, "--ruleset", "all", *runs)
    for name in TWO:
        alone = scored(madrob, "--ruleset", name, *runs)
        for key in ("path", "flags", *LABEL):
            assert [run[key] for run in beside] == [run.pop(key) for run in alone]
        assert [run["rulesets"][name] for run in beside] == alone
    for run in beside:
        one, two = (values(run["rulesets"][name]) for name in TWO)
        assert run["differences"] == {
            name: None if first is None or second is None else second - first
            for name, first, second in zip(one, one.values(), two.values(), strict=True)
        }


HEADS = r"^ +protocol +\+- +eurobench-2020 +\+- +difference"


def test_rulesets_are_a_table_for_people() -> None:
    nominal, touch_only = (
        run for of in (Scenario.NOMINAL, Scenario.TOUCH_ONLY) for run in runs_at(recorded(of))
    )
    text = "\n".join(describe_run(run, TWO).text for run in (nominal, touch_only))
    assert len(re.findall(f"{HEADS}$", text, re.MULTILINE)) == 2
    assert re.search(r"^  capability level +6 +4 +-2  steps$", text, re.MULTILINE)
    assert re.search(r"^  time to handle +\d\.\d +0\.\d +\d\.\d{6} +=  s$", text, re.MULTILINE)
    assert re.search(r"^  passage time +- +- +-  s$", text, re.MULTILINE)
    for name in TWO:
        assert f"\n  passage time, {name}: " in text
    three = (*TWO, RulesetName.PROTOCOL)
    text = describe_run(nominal, three).text
    assert len(re.findall(rf"{HEADS} +protocol +\+- +difference$", text, re.MULTILINE)) == 1
    assert re.search(r"^  capability level +6 +4 +-2 +6 +=  steps$", text, re.MULTILINE)
    document = json.loads(describe_run(nominal, three, as_json=True).text)
    assert document["differences"]["capability_level"] == {"protocol": 0, "eurobench-2020": -2}


def test_a_recording_with_another_ruleset_is_named_with_the_remedy(
    results: Path, madrob: Madrob
) -> None:
    path = next(results.glob("*_run_001_*"))
    bag = next(path.glob("*.mcap"))
    content = bag.read_bytes()
    assert RECORD_NAME.encode() in content
    bag.write_bytes(content.replace(b'"ruleset":"protocol"', b'"ruleset":"protokol"'))
    told = re.escape(f"madrob: {path}: ")
    remedy = ": use --ruleset protocol or eurobench-2020\n"
    assert re.fullmatch(f"{told}.*'protokol'.*{remedy}", madrob.refusal("score", path))


def test_published_files_are_scored_by_the_rules_of_2020(tmp_path: Path, madrob: Madrob) -> None:
    publish(completed(), tmp_path)
    (run,) = scored(madrob, tmp_path)
    assert run["ruleset"] == "eurobench-2020"
    assert run["quality"]["remarks"] == [
        "scored from published files: events and acceleration as they stand there, no steps",
        "the files were made by protocol: the recording gives other values",
    ]
    refusal = madrob.refusal("score --ruleset protocol", tmp_path)
    assert "csv files are scored by eurobench-2020: protocol needs the bag" in refusal


@pytest.mark.parametrize("command", ["score", "report"])
def test_a_run_that_goes_on_is_not_taken_for_one_that_was_cut_off(
    command: str, drive: Drive, madrob: Madrob
) -> None:
    drive.start(make_setup(timeout=2.0))
    for path in (drive.folder, drive.folder.parent):
        assert madrob.refusal(command, path) == (
            f"madrob: {drive.folder}: the run goes on, another console works on this run: "
            "wait for its result\n"
        )
    drive.finish()
    assert "outcome: timeout" in madrob("score", drive.folder)


def test_written_files_score_as_the_recordings_and_say_by_which_rules_they_were_made(
    results: Path, tmp_path: Path, madrob: Madrob
) -> None:
    before, written = all_within(results), tmp_path / "far" / "written"
    lines = madrob("score --write", written, *PUBLISHED, results).splitlines()
    folders = sorted(written.iterdir())
    assert [folder.name for folder in folders] == sorted(run.name for run in results.iterdir())
    assert [line.rpartition(" to ")[2] for line in lines] == [str(folder) for folder in folders]
    assert all_within(results) == before
    from_files, from_bags = scored(madrob, written), scored(madrob, *PUBLISHED, results)
    for files, bag in zip(from_files, from_bags, strict=True):
        assert (values(files), files["events"]) == (values(bag), bag["events"])
        assert (files["ruleset"], [flag["words"] for flag in files["flags"]]) == (
            "eurobench-2020",
            ["PRACTICE, SIMULATED: not an official result"],
        )
    assert {len(list(folder.glob("*.yaml"))) for folder in folders} == {10}
    next(folders[0].glob("run_info_*")).unlink()
    (bare,) = scored(madrob, folders[0])
    assert (bare["ruleset"], bare["flags"]) == ("eurobench-2020", [])


def test_what_is_there_already_is_not_written_over_and_the_rest_is_written(
    results: Path, tmp_path: Path, madrob: Madrob
) -> None:
    first, *others = sorted(run.name for run in results.iterdir())
    mine = tmp_path / "written" / first / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.touch()
    said = madrob.say("score --json --write", tmp_path / "written", results)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert said.err.endswith(f"{first}: is there already; move it away or choose another folder\n")
    assert [Path(run["written"]).name for run in json.loads(said.out)["runs"]] == others
    assert [*mine.parent.iterdir()] == [mine]
    assert {path.name for path in (tmp_path / "written").iterdir()} == {first, *others}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("{practice: true}", ["PRACTICE: not an official result"]),
        ("{practice: 'yes', source: [ros]}", []),
        ("{source: teleport, practice: true}", ["PRACTICE: not an official result"]),
        ("{source: ros, practice: false}", []),
        ("[simulated]", []),
    ],
)
def test_whatever_a_run_info_says_its_files_are_scored(
    settings: str, words: list[str], tmp_path: Path, madrob: Madrob
) -> None:
    publish(recorded(Scenario.TOUCH_ONLY), tmp_path)
    (info,) = tmp_path.glob("run_info_*")
    info.write_text(f"ruleset: [best]\nsettings: {settings}\n")
    (run,) = scored(madrob, tmp_path)
    assert (run["ruleset"], [flag["words"] for flag in run["flags"]]) == ("eurobench-2020", words)


@pytest.fixture(scope="module")
def one() -> Result:
    (run,) = runs_at(recorded(Scenario.NOMINAL))
    return score_run(run, (None,))[0].result


def with_value(
    of: Result, name: IndicatorName, value: float | None, expanded: float | None = None,
    reason: str | None = None, doubts: tuple[str, ...] = (),
) -> Result:  # fmt: skip
    known = None if expanded is None else Uncertainty(expanded / 2, expanded)
    indicator = Indicator(value, "s", reason, known, doubts)
    return replace(of, indicators={**of.indicators, name: indicator})


def test_a_result_for_people_has_uncertainties_and_doubts(one: Result) -> None:
    touch = "the touch rests on 1 sample"
    result = with_value(one, IndicatorName.EXECUTION_TIME, 13.8621, 0.018)
    result = with_value(result, IndicatorName.TIME_TO_HANDLE, 3.2, 0.018, doubts=(touch,))
    never = {"reason": "never closed", "doubts": (touch,)}
    result = with_value(result, IndicatorName.PASSAGE_TIME, None, None, **never)  # type: ignore[arg-type]
    text = "\n".join(result_lines(result))
    assert re.search(r"^execution time +13\.86  \+- 0\.02 s$", text, re.MULTILINE)
    assert re.search(r"^time to handle +3\.20\? \+- 0\.02 s$", text, re.MULTILINE)
    assert re.search(r"^passage time +-\? never closed$", text, re.MULTILINE)
    assert f"doubt: {touch} (time to handle, passage time)" in text
    beside = "\n".join(comparison_lines([result, one]))
    assert re.search(r"^time to handle +3\.20\? ", beside, re.MULTILINE)
    assert beside.count(f"doubt: {touch}") == 1


@pytest.mark.parametrize(
    ("value", "words"), [(299.99999976, "300"), (12.3456, "12.3456"), (0.0, "0"), (4, "4")]
)
def test_an_exact_value_has_the_digits_that_it_has(one: Result, value: float, words: str) -> None:
    text = "\n".join(result_lines(with_value(one, IndicatorName.EXECUTION_TIME, value, 0.0)))
    assert re.search(rf"^execution time +{re.escape(words)}  s$", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ((4.2, 0.3), (19.3232, 2.0), "+15"),  # the larger uncertainty leaves no decimal
        ((13.8621, 0.02), (13.8812, 0.02), "+0.02"),
        ((13.8621, 0.02), (13.8622, 0.02), "+0.00"),  # they differ, by nothing that can be seen
        ((13.8621, 0.02), (13.8621, 0.02), "="),
        ((300.0, 0.0), (287.5, 0.0), "-12.5"),
        ((300.0, None), (287.5, None), "-12.500000"),
    ],
)
def test_a_difference_of_rulesets_has_the_digits_that_the_uncertainties_leave(
    one: Result,
    first: tuple[float, float | None],
    second: tuple[float, float | None],
    words: str,
) -> None:
    results = [with_value(one, IndicatorName.PASSAGE_TIME, *known) for known in (first, second)]
    text = "\n".join(comparison_lines(results))
    assert re.search(rf"^passage time .* {re.escape(words)}  s$", text, re.MULTILINE)
