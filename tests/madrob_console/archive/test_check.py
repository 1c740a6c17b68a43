"""`madrob score --check`: stored results against their recordings."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.grades import Grade
from madrob_console.archive.repair import repair
from madrob_console.archive.run_paths import RunPath
from madrob_console.cli.main import main
from madrob_console.referee.acts import Start
from madrob_console.testbeds.simulated import Scenario
from recorder.listing import put_listing
from scoring.libraries import libraries_here
from scoring.protocol import Condition
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import copy_run, publish
from tests.recorder.samples import add_evidence, strings

Document = dict[str, Any]


def check(*paths: Path, flags: tuple[str, ...] = ()) -> int:
    return main(["score", "--check", *flags, *map(str, paths)])


def change(folder: Path, edit: Callable[[Document], object]) -> None:
    """Edit the stored result of a run."""
    path = folder / "result.json"
    document = msgspec.json.decode(path.read_bytes())
    edit(document)
    path.write_bytes(msgspec.json.encode(document))


def found(folder: Path) -> list[str]:
    return [difference.what for difference in check_run(RunPath(folder)).found]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with rulings, a closure and a second issue."""
    return copy_run(tmp_path, 1, Scenario.NOMINAL)


def test_a_result_agrees_with_its_recording_and_the_referees_decisions(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = json.loads((run / "result.json").read_text())
    assert (stored["issue"], len(stored["rulings"])) == (2, 2)
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    assert check(run) == 0
    assert capsys.readouterr().out == f"{run}: same digits\n"
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_a_run_that_was_cut_off_as_soon_as_its_result_was_written_agrees(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    folder = drive.engine.folder
    assert folder is not None
    drive.engine.close()
    journal = folder / "journal.jsonl"
    *lines, last = journal.read_text().splitlines(keepends=True)
    assert "result written" in last
    journal.write_text("".join(lines))
    assert found(folder) == []


def _scaled(document: Document, factor: float) -> None:
    part = document["indicators"]["unsafety_of_door_operation"]
    part["value"] *= factor


def rounded_otherwise(document: Document) -> None:
    """As another SciPy may have it."""
    _scaled(document, 1 + 1e-12)


EDITS: dict[str, Callable[[Document], object]] = {
    "indicators.execution_time.value": lambda d: d["indicators"]["execution_time"].update(
        value=d["indicators"]["execution_time"]["value"] * (1 + 2**-52)
    ),
    "indicators.passage_time.reason": lambda d: d["indicators"]["passage_time"].update(reason="x"),
    "indicators.capability_level.value": lambda d: d["indicators"]["capability_level"].update(
        value=None
    ),
    "outcome": lambda d: d.update(outcome="timeout"),
    "outcome_reason": lambda d: d.update(outcome_reason="gave up"),
    "stop": lambda d: d.update(stop=None),
    "ruleset": lambda d: d.update(ruleset="best-of-2031"),
    "events[2].time": lambda d: d["events"][2].update(time=0.0),
    "steps[3].final": lambda d: d["steps"][3].update(final=None),
    "steps[3].referee.reason": lambda d: d["steps"][3]["referee"].update(reason="no"),
    "quality.signals[0].samples": lambda d: d["quality"]["signals"][0].update(samples=7),
    "rulings": lambda d: d["rulings"].pop(),
    "closure": lambda d: d.update(closure={"team_word": "acknowledged"}),
    "team": lambda d: d.update(team="Nova"),
}


def test_whatever_is_changed_in_a_result_is_found(run: Path) -> None:
    for edit in EDITS.values():
        change(run, edit)
    assert set(found(run)) == set(EDITS)


def test_a_difference_is_told_with_both_values(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(run, EDITS["indicators.capability_level.value"])
    assert check(run) == 1
    assert capsys.readouterr().out == (
        f"{run}: differs in 1\n  indicators.capability_level.value: stored null, now 6\n"
    )
    assert check(run, flags=("--json",)) == 1
    (document,) = json.loads(capsys.readouterr().out)["runs"]
    assert document["grade"] == "differs"
    assert document["differences"] == [
        {"what": "indicators.capability_level.value", "stored": None, "recomputed": 6}
    ]


def other_uncertainties(document: Document) -> None:
    document["indicators"]["time_to_handle"]["uncertainty"] = {"u": 1.0, "expanded": 2.0}
    document["indicators"]["execution_time"]["uncertainty"]["u"] = 0.5
    document["indicators"]["passage_time"]["uncertainty"] = None


def other_doubts(document: Document) -> None:
    document["indicators"]["execution_time"]["doubts"] = ["something else"]


def test_uncertainties_have_a_line_of_their_own_and_never_differ(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trust = {
        name: indicator["uncertainty"]
        for name, indicator in json.loads((run / "result.json").read_text())["indicators"].items()
    }
    change(run, other_uncertainties)
    assert check(run) == 0
    passage = json.dumps(trust["passage_time"], separators=(",", ":"))
    assert capsys.readouterr().out == (
        f"{run}: same digits\n  uncertainties differ in 3: "
        f"execution_time {trust['execution_time']['u']} was 0.5, "
        f"time_to_handle {trust['time_to_handle']['expanded']} was 2.0, "
        f"passage_time {passage} was null\n"
    )
    change(run, rounded_otherwise)
    assert check(run, flags=("--json",)) == 0
    (document,) = json.loads(capsys.readouterr().out)["runs"]
    assert (document["grade"], document["differences"]) == ("equal to 1e-9", [])
    assert len(document["last_digits"]) == 1
    assert {each["what"]: each["stored"] for each in document["uncertainties"]} == {
        "indicators.execution_time.uncertainty.u": 0.5,
        "indicators.time_to_handle.uncertainty.u": 1.0,
        "indicators.time_to_handle.uncertainty.expanded": 2.0,
        "indicators.passage_time.uncertainty": None,
    }


def test_where_only_doubts_differ_the_values_are_said_to_hold(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(run, other_doubts)
    assert check(run) == 1  # section 11 knows three grades
    words = f"{run}: differs in 1, only doubts; the values: same digits\n"
    assert capsys.readouterr().out.startswith(words)
    change(run, rounded_otherwise)
    assert check(run, flags=("--json",)) == 1
    (document,) = json.loads(capsys.readouterr().out)["runs"]
    key = "grade_but_for_doubts"
    assert (document["grade"], document[key]) == ("differs", "equal to 1e-9")
    change(run, lambda document: document.update(outcome="timeout"))
    assert not check_run(RunPath(run)).values_hold


def test_of_many_runs_it_is_counted_where_the_values_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (1, 2, 3):
        copy_run(tmp_path, number)
    change(next(tmp_path.glob("*_run_001_*")), other_uncertainties)
    change(next(tmp_path.glob("*_run_002_*")), other_doubts)
    change(next(tmp_path.glob("*_run_003_*")), lambda document: document.update(outcome="aborted"))
    assert check(tmp_path) == 1
    assert capsys.readouterr().out.splitlines()[-1] == (
        "1 same digits, 0 equal to 1e-9, "
        "2 differ (1 only in doubts: the values hold), 0 could not be checked; "
        "of 1 the uncertainties differ"
    )


def test_other_last_digits_are_no_difference_and_the_libraries_are_named(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change(run, rounded_otherwise)
    change(run, lambda d: d["libraries"].update(scipy="1.0.1", python="3.9.1"))
    here = libraries_here()
    assert check(run) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == (
        f"{run}: equal to 1e-9 (libraries differ: Python 3.9.1 stored, {here.python} now; "
        f"SciPy 1.0.1 stored, {here.scipy} now)"
    )
    assert second.startswith("  indicators.unsafety_of_door_operation.value: stored ")
    assert check(run, flags=("--json",)) == 0
    (document,) = json.loads(capsys.readouterr().out)["runs"]
    assert (document["grade"], document["differences"]) == ("equal to 1e-9", [])
    assert [each["what"] for each in document["last_digits"]] == [
        "indicators.unsafety_of_door_operation.value"
    ]
    assert document["libraries"]["stored"]["scipy"] == "1.0.1"
    assert document["libraries"]["now"] == msgspec.to_builtins(here)


def test_other_last_digits_of_the_same_libraries_or_of_unknown_ones_are_said_to_be_so(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = libraries_here()
    now = f"Python {here.python}, NumPy {here.numpy}, SciPy {here.scipy}, pandas {here.pandas}"
    change(run, rounded_otherwise)
    assert check(run) == 0
    assert f"equal to 1e-9 (the same libraries ({now}): another" in capsys.readouterr().out
    change(run, lambda d: d.pop("libraries"))
    assert check(run) == 0
    said = f"equal to 1e-9 (the stored result does not name its libraries, now {now})"
    assert said in capsys.readouterr().out


def test_libraries_alone_are_no_difference(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change(run, lambda d: d["libraries"].update(numpy="99.0"))
    assert check(run) == 0
    assert capsys.readouterr().out == f"{run}: same digits\n"


def test_no_time_counts_and_words_are_compared_to_the_last_digit(run: Path) -> None:
    """1e-9 of the time since the epoch is more than a second."""

    def last_digit(part: Document, key: str) -> None:
        part[key] = math.nextafter(part[key], math.inf)

    change(run, lambda d: last_digit(d, "start"))
    change(run, lambda d: last_digit(d["events"][1], "time"))
    change(run, lambda d: last_digit(d["events"][2], "since_start"))
    change(run, lambda d: d["indicators"]["capability_level"].update(value=6 + 1e-12))
    checked = check_run(RunPath(run))
    assert {difference.what for difference in checked.of(Grade.DIFFERS)} == {
        "start",
        "events[1].time",
        "events[2].since_start",
        "indicators.capability_level.value",
    }
    assert checked.of(Grade.CLOSE) == ()


def test_1e_9_is_the_border(run: Path) -> None:
    value = "indicators.unsafety_of_door_operation.value"

    def times(factor: float) -> Grade:
        stored = json.loads((run / "result.json").read_text())
        change(run, lambda d: _scaled(d, factor))
        checked = check_run(RunPath(run))
        assert {difference.what for difference in checked.found} == {value}
        (run / "result.json").write_text(json.dumps(stored))
        return checked.grade

    assert times(1 + 0.9e-9) is times(1 - 0.9e-9) is Grade.CLOSE
    assert times(1 + 1.1e-9) is times(1 - 1.1e-9) is times(-1) is Grade.DIFFERS


def test_a_file_that_was_changed_or_is_gone_is_found(run: Path) -> None:
    table = next(run.glob("*_event.csv"))
    table.write_text(table.read_text().replace("door_opens", "door_open$"))
    (run / "condition_1.yaml").unlink()
    (run / "added.csv").write_text("time\n")
    assert found(run) == ["files.condition_1.yaml", f"files.{table.name}.sha256"]


def list_files(run: Path) -> None:
    fd = os.open(run, os.O_DIRECTORY)
    assert put_listing(fd) is not None
    os.close(fd)


def test_evidence_that_comes_after_the_result_and_goes_again_is_no_difference(run: Path) -> None:
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    evidence = add_evidence(run, strings(["a picture"]))
    list_files(run)
    assert (run / "metadata.yaml").read_bytes() != before["metadata.yaml"]
    assert found(run) == []
    assert repair(run) is None
    evidence.unlink()
    assert found(run) == []
    list_files(run)
    assert found(run) == []
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_a_result_that_is_made_beside_evidence_stands_when_that_is_gone(run: Path) -> None:
    evidence = add_evidence(run, strings(["a picture"]))
    list_files(run)
    (run / "result.json").write_text("{")
    assert repair(run) is not None
    assert found(run) == []
    evidence.unlink()
    list_files(run)
    assert found(run) == []
    assert repair(run) is None


def test_the_metadata_of_a_bag_without_evidence_is_compared(run: Path) -> None:
    with (run / "metadata.yaml").open("a") as file:
        file.write("# changed\n")
    assert found(run) == ["files.metadata.yaml.sha256", "files.metadata.yaml.bytes"]


def test_a_result_of_a_version_that_kept_no_digests_can_be_checked(run: Path) -> None:
    change(run, lambda d: d.pop("files", None))
    change(run, lambda d: d["quality"]["signals"][0].pop("skew"))
    (run / "condition_1.yaml").unlink()
    assert found(run) == []


def test_remarks_that_only_the_engine_could_make_are_no_difference(run: Path) -> None:
    change(run, lambda d: d["quality"]["remarks"].append("/a: 3 messages are not in the recording"))
    assert found(run) == []


def test_a_torn_recording_is_a_difference_unless_the_result_knows_it(run: Path) -> None:
    bag = next(run.glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[:-200])
    change(run, lambda d: d.pop("files", None))
    (first,) = check_run(RunPath(run)).found
    assert (first.what, first.stored) == ("quality.remarks", None)
    change(run, lambda d: d["quality"]["remarks"].append(first.recomputed))
    assert found(run) == []
    assert found(run.rename(run.parent / "moved")) == []


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (lambda d: d.update(format=2), "use a newer madrob-console"),
        (lambda d: d.pop("indicators"), "is damaged"),
        (lambda d: d.update(steps=[1e300] * 3, format="one"), "is damaged"),
    ],
)
def test_a_result_that_cannot_be_used_is_named_on_one_line(
    edit: Callable[[Document], object],
    named: str,
    run: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    change(run, edit)
    assert check(run) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"madrob: {run}: result.json ")
    assert named in error


def test_half_a_result_is_named_on_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = run / "result.json"
    for content in (path.read_bytes()[:300], b"", b'{"format": 1e999}', b"[" * 5000, b"\xff"):
        path.write_bytes(content)
        assert check(run) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "result.json is damaged" in error


def test_without_a_result_or_a_recording_there_is_nothing_to_check(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, published = next(run.glob("*.mcap")), tmp_path / "published"
    publish(run, published)
    assert check(bag, published) == 2
    (run / "result.json").unlink()
    assert check(run) == 2
    errors = capsys.readouterr().err.splitlines()
    assert (
        errors[0] == f"madrob: {bag}: has no result.json to check: name a run folder with a result"
    )
    assert "holds no recording" in errors[1]
    assert errors[2].startswith(f"madrob: {run}: has no result.json")


def test_a_difference_decides_the_exit_code_and_every_run_is_checked(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = copy_run(tmp_path, 2)
    bad = copy_run(tmp_path, 3)
    (bad / "result.json").unlink()
    assert check(tmp_path) == 2
    change(run, EDITS["stop"])
    change(copy_run(tmp_path, 4, Scenario.NOMINAL), rounded_otherwise)
    assert check(tmp_path) == 1
    printed = capsys.readouterr().out.splitlines()
    assert f"{other}: same digits" in printed
    assert printed[-1] == "1 same digits, 1 equal to 1e-9, 1 differ, 1 could not be checked"


def test_an_aborted_and_an_unfinished_run_can_be_checked(tmp_path: Path) -> None:
    for number, seconds in ((1, 0.5), (2, 3.0)):  # in the countdown, and later
        drive = Drive(tmp_path)
        drive.prepare(make_setup(run_number=number))
        drive.act(Start())
        drive.wait(seconds)
        drive.engine.close()
        assert drive.engine.folder is not None
        assert found(drive.engine.folder) == []


def test_check_and_ruleset_do_not_go_together(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        check(run, flags=("--ruleset", "protocol"))
    assert "not allowed with" in capsys.readouterr().err


@pytest.mark.slow
def test_every_simulated_run_agrees(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    count = pytestconfig.getoption("--runs")
    scenarios, rulesets = list(Scenario), list(RulesetName)
    for number in range(count):
        drive = Drive(tmp_path, scenarios[number % len(scenarios)], number, latch=number % 3 == 0)
        setup = make_setup(
            Condition.from_number(number % 20 + 1),
            run_number=number // 20 + 1,
            timeout=15.0,
            ruleset=rulesets[number % 2],
        )
        drive.whole_run(setup)
        drive.engine.close()
    assert check(tmp_path, flags=("--jobs", "1")) == 0


def test_a_result_that_hides_damage_where_lists_do_not_look_is_named(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = run / "result.json"
    deep = b"[" * 100_000 + b"]" * 100_000
    path.write_bytes(path.read_bytes().rstrip()[:-1] + b', "more": ' + deep + b"}")
    assert check(run) == 2
    said = capsys.readouterr().err
    assert "result.json is damaged" in said
    assert said.count("\n") == 1
