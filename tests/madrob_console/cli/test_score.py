"""`madrob score` over bags, run folders, published folders and results folders."""

from __future__ import annotations

import io
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive.folders import runs_at
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.archive.scored import score_run
from madrob_console.cli.main import main
from madrob_console.cli.output import MOST_ALIKE
from madrob_console.cli.score_command import describe_run
from madrob_console.cli.score_output import comparison_lines, result_lines
from madrob_console.referee.acts import Abort, Rule
from madrob_console.testbeds.simulated import Scenario
from scoring.indicator_table import IndicatorName
from scoring.protocol import Step
from scoring.result import Indicator, Uncertainty
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import copy_run, publish, recorded


def score(*arguments: object) -> int:
    try:
        return main(["score", *map(str, arguments)])
    except SystemExit as end:  # argparse
        return int(end.code or 0)


def scored(capsys: pytest.CaptureFixture[str], *arguments: object) -> list[dict[str, Any]]:
    score("--json", *arguments)
    runs: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["runs"]
    return runs


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that is said."""
    assert score(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1, captured.err
    return captured.err


LABEL = ("subject", "team", "condition", "run", "run_id", "testbed", "competition")
"""What `score --json` says of each run besides its result."""


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with three runs."""
    root = tmp_path / "results"
    copy_run(root, 2)
    copy_run(root, 3)
    copy_run(root, 1, Scenario.NOMINAL)
    return root


def test_every_run_of_a_results_folder_is_scored_in_the_order_of_their_names(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = sorted(map(str, results.glob("subject_*")))
    (results / "notes").mkdir()
    elsewhere = recorded(Scenario.NOMINAL)
    (results / elsewhere.name.replace("_run_001_", "_run_009_")).symlink_to(elsewhere)
    assert score(results) == 0
    captured = capsys.readouterr()
    assert [line for line in captured.out.splitlines() if line.startswith("/")] == runs
    first, second, _ = runs[1:] + runs[:1]
    assert captured.err == f"madrob: note: {second} is the same run as {first}\n"


def test_the_handle_at_rest_before_and_after_the_run_and_its_drift_are_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = recorded(Scenario.NOMINAL)
    assert score(folder) == 0
    words = r"handle at rest: 5\.\d{3} N before; 5\.\d{3} N after, drift [+-]\d\.\d{3} N"
    assert re.search(words, capsys.readouterr().out)
    (run,) = scored(capsys, folder)
    assert run["rest"]["drift"] == run["rest"]["after"]["mean"] - stored_zero(folder)


def stored_zero(folder: Path) -> float:
    zero: float = json.loads((folder / "result.json").read_text())["handle_zero"]
    return zero


def test_what_a_decision_hangs_on_comes_before_the_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    drive.act(Rule(Step.CROSS, confirmed=False, reason="a wheel stayed on the line"))
    drive.engine.close()
    folder = drive.engine.folder
    assert score(folder) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:3] == [
        "  outcome: completed (3 of 6 steps count: the referee denied step 4), ruleset protocol",
        "  flags: step 4 denied; SIMULATED: not an official result",
    ]
    (told,) = scored(capsys, folder)
    assert [(flag["kind"], flag["weight"], flag["undecided"]) for flag in told["flags"]] == [
        ("denied step", "caution", False),
        ("practice", "remark", False),
    ]


@pytest.mark.parametrize("ruleset", ["protocol", "all"])
def test_an_aborted_run_has_one_reason_a_ruleset(
    drive: Drive, capsys: pytest.CaptureFixture[str], ruleset: str
) -> None:
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("robot unsafe"))
    drive.finish()
    assert score(drive.engine.folder, "--ruleset", ruleset) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "run aborted" in line]
    if ruleset == "protocol":
        assert told == ["  indicators: none: run aborted: invalid"]
    else:
        assert sorted(told) == sorted(
            f"  indicators, {name}: run aborted: invalid" for name in RulesetName
        )


def test_a_bad_run_is_named_and_the_rest_is_scored(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = results / "subject_003_cond_001_run_004_20231114_221323"
    empty.mkdir()
    torn = next(results.glob("*_run_002_*"))
    (torn / "metadata.yaml").write_text("half a")
    bag = next(torn.glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[:40])
    assert score(results) == 2
    captured = capsys.readouterr()
    assert captured.out.count("outcome: ") == 2
    assert str(torn) in captured.err.splitlines()[0]
    assert str(empty) in captured.err.splitlines()[1]
    assert len(captured.err.splitlines()) == 2


@pytest.mark.machine
def test_the_same_is_printed_however_the_work_is_shared(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (results / "subject_003_cond_001_run_000_20231114_221323").mkdir()
    assert score("--jobs", "1", results) == 2
    alone = capsys.readouterr()
    assert score("--jobs", "2", results) == 2
    assert capsys.readouterr() == alone


def test_one_run_needs_no_other_process(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "concurrent.futures.process", None)
    assert score("--jobs", "8", recorded(Scenario.TOUCH_ONLY)) == 0
    assert "outcome: timeout" in capsys.readouterr().out


class Terminal(io.StringIO):
    """Says that somebody looks at it."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("runs", "bar"), [(1, "0/?"), (5, "5/5")])
def test_a_bar_shows_how_far_work_is_where_somebody_looks(
    runs: int, bar: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert score(*(f"/nowhere/{number}" for number in range(runs))) == 2
    told = terminal.getvalue()
    assert bar in told
    assert all(f"/nowhere/{number}" in told for number in range(min(runs, MOST_ALIKE)))
    assert ("and 2 more like it" in told) is (runs == 5)
    assert capsys.readouterr().out == ""


def test_lines_tell_how_far_work_is_where_there_is_no_terminal(
    results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert score(results) == 0
    before = capsys.readouterr().err.splitlines()
    monkeypatch.setattr("madrob_console.cli.output._EVERY", 0.0)
    assert score(results) == 0
    count = len(runs_at(results))
    told = [f"madrob: note: {done} of {count} runs" for done in range(count + 1)]
    assert capsys.readouterr().err.splitlines() == [*told, *before]


def test_all_rulesets_stand_side_by_side_with_their_differences(
    capsys: pytest.CaptureFixture[str],
) -> None:
    runs = recorded(Scenario.NOMINAL), recorded(Scenario.TOUCH_ONLY)
    beside = scored(capsys, "--ruleset", "all", *runs)
    for name in RulesetName:
        alone = scored(capsys, "--ruleset", name, *runs)
        for key in ("path", "flags", *LABEL):
            assert [run[key] for run in beside] == [run.pop(key) for run in alone]
        assert [run["rulesets"][name] for run in beside] == alone


def test_each_run_says_whose_and_which_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    run = recorded(Scenario.NOMINAL)
    stored = json.loads((run / "result.json").read_text())
    (told,) = scored(capsys, run)
    assert {key: told[key] for key in LABEL} == {
        **{key: stored[key] for key in ("subject", "team", "run_id", "testbed", "competition")},
        "condition": stored["condition_number"],
        "run": stored["run_number"],
    }


TWO = RulesetName.PROTOCOL, RulesetName.EUROBENCH_2020


def test_of_two_rulesets_each_indicator_has_one_difference() -> None:
    for scenario, level in ((Scenario.NOMINAL, -2), (Scenario.TOUCH_ONLY, None)):
        (of,) = runs_at(recorded(scenario))
        run = json.loads(describe_run(of, TWO, as_json=True).text)
        protocol, published = (run["rulesets"][name]["indicators"] for name in TWO)
        for name, by in run["differences"].items():
            values = protocol[name]["value"], published[name]["value"]
            assert by == (None if None in values else values[1] - values[0])
        assert level is None or run["differences"]["capability_level"] == level


def test_both_rulesets_are_a_table_for_people() -> None:
    runs = [run for of in (Scenario.NOMINAL, Scenario.TOUCH_ONLY) for run in runs_at(recorded(of))]
    text = "\n".join(describe_run(run, TWO).text for run in runs)
    heads = r"^ +protocol +\+- +eurobench-2020 +\+- +difference$"
    assert len(re.findall(heads, text, re.MULTILINE)) == 2
    assert re.search(r"^  capability level +6 +4 +-2  steps$", text, re.MULTILINE)
    assert re.search(r"^  time to handle +(\d\.\d\d +0\.\d\d) +\1 +=  s$", text, re.MULTILINE)
    assert re.search(r"^  passage time +- +- +-  s$", text, re.MULTILINE)
    for name in TWO:
        assert f"\n  passage time, {name}: " in text


def test_three_rulesets_stand_side_by_side_each_with_its_difference_to_the_first() -> None:
    (run,) = runs_at(recorded(Scenario.NOMINAL))
    rules = (RulesetName.PROTOCOL, RulesetName.EUROBENCH_2020, RulesetName.PROTOCOL)
    text = describe_run(run, rules).text
    heads = r"^ +protocol +\+- +eurobench-2020 +\+- +difference +protocol +\+- +difference$"
    assert len(re.findall(heads, text, re.MULTILINE)) == 1
    assert re.search(r"^  capability level +6 +4 +-2 +6 +=  steps$", text, re.MULTILINE)
    document = json.loads(describe_run(run, rules, as_json=True).text)
    assert document["differences"]["capability_level"] == {"protocol": 0, "eurobench-2020": -2}


def test_a_recording_with_a_ruleset_of_a_newer_version_is_named(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = next(results.glob("*_run_001_*"))
    bag = next(path.glob("*.mcap"))
    content = bag.read_bytes()
    assert RECORD_NAME.encode() in content
    newer = content.replace(b'"ruleset":"protocol"', b'"ruleset":"protokol"')
    assert newer != content
    bag.write_bytes(newer)
    line = refusal(capsys, path)
    assert line.startswith(f"madrob: {path}: ")
    assert "'protokol'" in line
    assert line.endswith(": use the madrob-console that recorded it\n")


def test_a_bad_run_among_published_ones_is_named_and_the_rest_is_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(recorded(Scenario.NOMINAL), tmp_path)
    for path in list(tmp_path.glob("subject_*.csv")):
        shutil.copy(path, tmp_path / path.name.replace("run_001", "run_002"))
        shutil.copy(path, tmp_path / path.name.replace("run_001", "run_003"))
    (tmp_path / "subject_003_cond_001_run_002_event.csv").unlink()
    assert score(tmp_path) == 2
    captured = capsys.readouterr()
    assert captured.out.count("outcome: completed") == 2
    assert captured.err.count("\n") == 1
    assert "run_002_event.csv: is missing" in captured.err


def test_rows_that_are_missing_in_published_files_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(recorded(Scenario.NOMINAL), tmp_path)
    path = next(tmp_path.glob("*_jointState.csv"))
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[50:200], *rows[300:-150]]) + "\n")
    (run,) = scored(capsys, tmp_path)
    told = [remark for remark in run["quality"]["remarks"] if remark.startswith("jointState")]
    assert told == [
        "jointState: no rows in the first 1.0 s of the run",
        "jointState: 1 gaps, the longest 2.020 s",
        "jointState: no rows in the last 2.0 s of the run",
    ]


def test_published_files_without_rows_are_scored_with_reasons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(recorded(Scenario.NOMINAL), tmp_path)
    path = next(tmp_path.glob("*_wrench.csv"))
    path.write_text("time,force_x\n")
    (run,) = scored(capsys, tmp_path)
    assert run["indicators"]["roughness_of_door_actuation"]["value"] is None
    assert "wrench: no rows" in run["quality"]["remarks"]


def test_a_timeout_value_is_no_number_in_a_table_and_no_matter_in_an_old_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(recorded(Scenario.NOMINAL), tmp_path)
    (tmp_path / "execution_time.yaml").write_text("type: scalar\nvalue: TIMEOUT\n")
    (run,) = scored(capsys, tmp_path)
    assert run["indicators"]["execution_time"]["value"] > 0
    path = next(tmp_path.glob("*_wrench.csv"))
    path.write_text("time,force_x\n1.0,TIMEOUT\n")
    assert "line 2, column force_x: 'TIMEOUT' is no finite number" in refusal(capsys, tmp_path)


@pytest.mark.parametrize("command", ["score", "report"])
def test_a_run_that_goes_on_is_not_taken_for_one_that_was_cut_off(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = Drive(tmp_path / "results")
    drive.start(make_setup(timeout=2.0))
    folder = drive.folder
    for path in (folder, tmp_path / "results"):
        assert main([command, str(path)]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err == (
            f"madrob: {folder}: the run goes on, another console works on this run: wait for its "
            "result\n"
        )
    drive.finish()
    assert score(folder) == 0
    assert "outcome: timeout" in capsys.readouterr().out
    drive.engine.close()


def test_a_run_that_was_cut_off_is_scored_as_such(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(1.0)
    drive.engine.close()
    (drive.folder / "result.json").unlink()
    assert score(drive.folder) == 0
    assert "outcome: interrupted" in capsys.readouterr().out


@pytest.mark.machine
@pytest.mark.slow
def test_processes_give_what_one_process_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(1, 13):
        copy_run(tmp_path, number, Scenario.NOMINAL if number % 2 else Scenario.TOUCH_ONLY)
    assert score("--jobs", "1", tmp_path) == 0
    alone = capsys.readouterr().out
    assert score("--jobs", "3", tmp_path) == 0
    assert capsys.readouterr().out == alone


def test_run_folders_that_somebody_renamed_are_scored_under_their_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("subject_003_cond_001_run_001_20260321_100000_old", "Delft, second try"):
        shutil.copytree(recorded(Scenario.NOMINAL), tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "Delft, second try")
    assert score(tmp_path) == 0
    said = capsys.readouterr()
    assert len(said.err.splitlines()) == 1  # they are the same run
    named = [line for line in said.out.splitlines() if not line.startswith(" ")]
    assert [Path(line).name for line in named] == [
        "Delft, second try",
        "subject_003_cond_001_run_001_20260321_100000_old",
    ]


def test_files_by_another_ruleset_score_as_the_recordings_do_by_it(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    written = tmp_path / "far" / "written"
    assert score("--write", written, "--ruleset", "eurobench-2020", results) == 0
    lines = capsys.readouterr().out.splitlines()
    folders = sorted(written.iterdir())
    assert [folder.name for folder in folders] == sorted(run.name for run in results.iterdir())
    assert [line.rpartition(" to ")[2] for line in lines] == [str(folder) for folder in folders]
    from_files = scored(capsys, "--ruleset", "eurobench-2020", written)
    from_bags = scored(capsys, "--ruleset", "eurobench-2020", results)
    for files, bag in zip(from_files, from_bags, strict=True):
        values = (
            {name: i["value"] for name, i in one["indicators"].items()} for one in (files, bag)
        )
        assert next(values) == next(values)
        assert files["events"] == bag["events"]
    for folder in folders:
        assert len(list(folder.glob("*.yaml"))) == 10
        assert "ruleset: eurobench-2020" in next(folder.glob("run_info_*")).read_text()
    assert {path: path.read_bytes() for path in results.rglob("*") if path.is_file()} == before


def test_what_is_there_already_is_not_written_over_and_the_rest_is_written(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, *others = sorted(run.name for run in results.iterdir())
    mine = tmp_path / "written" / first / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    assert score("--json", "--write", tmp_path / "written", results) == 2
    said = capsys.readouterr()
    assert said.err.endswith(f"{first}: is there already; move it away or choose another folder\n")
    assert said.err.count("\n") == 1
    assert [Path(run["written"]).name for run in json.loads(said.out)["runs"]] == others
    assert [path.name for path in mine.parent.iterdir()] == ["mine.txt"]
    assert {path.name for path in (tmp_path / "written").iterdir()} == {first, *others}


def test_written_files_say_of_what_run_they_are_and_by_which_rules_they_were_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(Scenario.NOMINAL)
    assert score("--write", tmp_path, "--ruleset", "eurobench-2020", run) == 0
    capsys.readouterr()
    (bag,), (files,) = (
        scored(capsys, *given)
        for given in (("--ruleset", "eurobench-2020", run), (tmp_path / run.name,))
    )
    assert files["ruleset"] == "eurobench-2020"
    values = ({k: one["value"] for k, one in of["indicators"].items()} for of in (bag, files))
    assert next(values) == next(values)
    assert [flag["words"] for flag in files["flags"]] == ["SIMULATED: not an official result"]
    (other,) = scored(capsys, "--ruleset", "protocol", tmp_path / run.name)
    assert other["ruleset"] == "protocol"
    next((tmp_path / run.name).glob("run_info_*")).unlink()
    (bare,) = scored(capsys, tmp_path / run.name)
    assert (bare["ruleset"], bare["flags"]) == ("protocol", [])


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
    settings: str, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(recorded(Scenario.TOUCH_ONLY), tmp_path)
    (info,) = tmp_path.glob("run_info_*")
    info.write_text(f"ruleset: [best]\nsettings: {settings}\n")
    (run,) = scored(capsys, tmp_path)
    assert run["ruleset"] == "protocol"
    assert [flag["words"] for flag in run["flags"]] == words


def test_a_result_for_people_has_uncertainties_and_doubts() -> None:
    (run,) = runs_at(recorded(Scenario.NOMINAL))
    (one,) = score_run(run, (None,))
    touch = "the touch rests on 1 sample"
    known = {
        IndicatorName.EXECUTION_TIME: Indicator(13.8621, "s", None, Uncertainty(0.009, 0.018)),
        IndicatorName.TIME_TO_HANDLE: Indicator(
            3.2, "s", None, Uncertainty(0.009, 0.018), (touch,)
        ),
        IndicatorName.PASSAGE_TIME: Indicator(None, "s", "never closed", None, (touch,)),
    }
    result = replace(one.result, indicators={**one.result.indicators, **known})
    text = "\n".join(result_lines(result))
    assert re.search(r"^execution time +13\.86  \+- 0\.02 s$", text, re.MULTILINE)
    assert re.search(r"^time to handle +3\.20\? \+- 0\.02 s$", text, re.MULTILINE)
    assert re.search(r"^passage time +-\? never closed$", text, re.MULTILINE)
    assert f"doubt: {touch} (time to handle, passage time)" in text
    beside = "\n".join(comparison_lines([result, one.result]))
    assert re.search(r"^time to handle +3\.20\? ", beside, re.MULTILINE)
    assert beside.count(f"doubt: {touch}") == 1


def exactly(value: float) -> Indicator:
    return Indicator(value, "s", None, Uncertainty(0.0, 0.0))


def test_an_exact_value_has_the_digits_that_it_has() -> None:
    (run,) = runs_at(recorded(Scenario.NOMINAL))
    (one,) = score_run(run, (None,))
    for value, words in ((299.99999976, "300"), (12.3456, "12.3456"), (0.0, "0"), (4, "4")):
        told = {IndicatorName.EXECUTION_TIME: exactly(value)}
        text = "\n".join(result_lines(replace(one.result, indicators=told)))
        assert re.search(rf"^execution time +{re.escape(words)}  s$", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("one", "two", "words"),
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
    one: tuple[float, float | None], two: tuple[float, float | None], words: str
) -> None:
    (run,) = runs_at(recorded(Scenario.NOMINAL))
    (scored_one,) = score_run(run, (None,))
    results = []
    for value, expanded in (one, two):
        known = None if expanded is None else Uncertainty(expanded / 2, expanded)
        told = {IndicatorName.PASSAGE_TIME: Indicator(value, "s", None, known)}
        results.append(replace(scored_one.result, indicators=told))
    text = "\n".join(comparison_lines(results))
    assert re.search(rf"^passage time .* {re.escape(words)}  s$", text, re.MULTILINE)
