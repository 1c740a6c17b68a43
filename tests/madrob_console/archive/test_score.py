"""`madrob_console.archive.score`: what programs call."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.check import Grade, check_run, stored_result
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, RunPath
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.repair import RuleChange, next_issue, repair, write_next_issue
from madrob_console.archive.scored import open_run, read_recorded_run, score_opened
from madrob_console.cli.main import main
from madrob_console.cli.repairing import repair_all
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import Hold
from madrob_console.export.pack import KnownRun
from madrob_console.pages.competition import competition_standings
from madrob_console.pages.surroundings import made_of
from madrob_console.referee.acts import Act, AddNote, Finalise, MarkIncident, Reissue, Rule, Start
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin, read_journal
from madrob_console.referee.rebuild import mark_of
from madrob_console.referee.records import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import read_bag
from recorder.survey import put_listing
from scoring.indicator_table import IndicatorName
from scoring.libraries import libraries_here
from scoring.protocol import Condition, EventName, Step
from scoring.quality import BY_THE_RULES
from scoring.result import Result
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import (
    completed,
    copy_run,
    publish,
    recorded,
    without_digests,
)
from tests.recorder.samples import add_evidence, strings


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


FINAL = Finalise(TeamWord.PROTESTED, "Ada", "a foot stayed")
RULED = Rule(Step.CROSS, confirmed=False, reason="one foot stayed")
STEPS: dict[str, tuple[Act, ...]] = {
    "note": (AddNote("a visitor"),),
    "incident": (MarkIncident(IncidentKind.FALL, "it fell"),),
    "ruling": (RULED,),
    "finalise": (FINAL,),
    "re-issue": (FINAL, Reissue("video")),
    "finalise again": (FINAL, Reissue("video"), RULED, Finalise(TeamWord.ACKNOWLEDGED, "Bob")),
}
Files = dict[str, bytes]


def files_of(folder: Path) -> Files:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name[0] != "."}


def put(folder: Path, files: Files) -> None:
    shutil.rmtree(folder)
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)


def summary(folder: Path) -> RunSummary:
    (run,) = History(folder.parent).refresh()
    return run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    source = completed()
    return shutil.copytree(source, tmp_path / "results" / source.name)


def acted(folder: Path, *acts: Act) -> Files:
    """The files after some acts on an earlier run."""
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(*acts)
    drive.engine.close()
    return files_of(folder)


@pytest.mark.parametrize("step", STEPS)
def test_a_cut_between_journal_and_result_ends_in_what_the_journal_says(
    folder: Path, step: str
) -> None:
    *earlier, last = STEPS[step]
    before = acted(folder, *earlier) if earlier else files_of(folder)
    after = acted(folder, last)
    written = [name for name in after if after[name] != before.get(name) and name != JOURNAL_FILE]
    order = sorted(written, key=lambda name: (name == RESULT_FILE, "issue" not in name))
    assert RESULT_FILE in written
    assert len(written) < 5  # only what changed is written
    entries, _ = read_journal(folder / JOURNAL_FILE)
    lines = after[JOURNAL_FILE].splitlines(keepends=True)
    assert json.loads(lines[-1])["what"] == "result written"
    for count in range(len(order)):  # of the files that were renamed before the power went
        put(folder, before | {name: after[name] for name in order[:count]})
        (folder / JOURNAL_FILE).write_bytes(b"".join(lines[:-1]))
        run = summary(folder)
        assert run.repairable
        assert "is not what the journal says" in (run.problem or "")
        assert not run.valid
        assert KnownRun.of(folder).damaged  # in a zip
        standings = competition_standings([run], made=0.0, official=False)
        assert not standings.groups
        found = {difference.what for difference in check_run(RunPath(folder)).found}
        assert found & {"journal.lines", "journal.sha256"}
        assert list(repair_all(folder.parent)) == []
        assert files_of(folder).items() >= {name: after[name] for name in order}.items()
        assert summary(folder).problem is None
        assert check_run(RunPath(folder)).found == ()
        assert repair(folder) is None
    *before_it, again = read_journal(folder / JOURNAL_FILE)[0]
    assert before_it == [*entries[:-1]]
    assert (again.what, again.details) == (entries[-1].what, entries[-1].details)


@pytest.mark.parametrize("step", STEPS)
def test_a_result_that_says_more_than_the_journal_is_taken_back(folder: Path, step: str) -> None:
    *earlier, last = STEPS[step]
    before = acted(folder, *earlier) if earlier else files_of(folder)
    after = acted(folder, last)
    put(folder, after | {JOURNAL_FILE: before[JOURNAL_FILE]})
    assert summary(folder).repairable
    assert list(repair_all(folder.parent)) == []
    assert files_of(folder)[RESULT_FILE] == before[RESULT_FILE]
    run = summary(folder)
    assert run.problem is None
    assert (run.final, run.issue) == (
        json.loads(before[RESULT_FILE])["closure"] is not None,
        json.loads(before[RESULT_FILE])["issue"],
    )


def test_opening_a_run_writes_its_result_again(folder: Path) -> None:
    before = files_of(folder)
    after = acted(folder, FINAL)
    put(folder, before | {JOURNAL_FILE: after[JOURNAL_FILE]})
    assert open_run(folder).out_of_date
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    assert drive.engine.run.phase is Phase.FINAL
    drive.engine.close()
    assert files_of(folder)[RESULT_FILE] == after[RESULT_FILE]
    assert not open_run(folder).out_of_date
    assert summary(folder).team_word == "protested"


def test_what_is_said_beside_a_final_result_changes_nothing(folder: Path) -> None:
    final = acted(folder, FINAL)
    noted = acted(folder, AddNote("the team was pleased"))
    assert noted[JOURNAL_FILE] != final[JOURNAL_FILE]
    assert noted[RESULT_FILE] == final[RESULT_FILE]
    assert summary(folder).problem is None
    assert check_run(RunPath(folder)).found == ()


def _worded(folder: Path) -> None:
    path = folder / RESULT_FILE
    path.write_text(path.read_text().replace('"protested"', '"acknowledged"'))


def _unsigned(folder: Path) -> None:
    path = folder / RESULT_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | {"closure": None}))


def _older(change: Callable[[Path], None]) -> Callable[[Path], None]:
    """Of a version that did not say of what journal a result was made."""

    def spoil(folder: Path) -> None:
        path = folder / RESULT_FILE
        content = json.loads(path.read_text())
        del content["journal"]
        path.write_text(json.dumps(content))
        without_digests(folder)
        change(folder)

    return spoil


def _torn(folder: Path) -> None:
    path = folder / RESULT_FILE
    path.write_bytes(path.read_bytes()[:-30])


@pytest.mark.parametrize("spoil", [_worded, _unsigned, _older(_worded), _older(_unsigned), _torn])
def test_a_word_that_the_journal_does_not_say_never_counts(
    folder: Path, spoil: Callable[[Path], None]
) -> None:
    after = acted(folder, FINAL)
    spoil(folder)
    run = summary(folder)
    assert run.problem is not None
    assert not run.valid
    assert list(repair_all(folder.parent)) == []
    assert files_of(folder)[RESULT_FILE] == after[RESULT_FILE]
    assert summary(folder).team_word == "protested"


def test_an_older_result_that_agrees_is_as_good_as_ever(folder: Path) -> None:
    acted(folder, FINAL)
    _older(lambda _: None)(folder)
    before = files_of(folder)
    assert summary(folder).problem is None
    assert list(repair_all(folder.parent)) == []
    assert files_of(folder) == before


def test_a_data_file_that_is_gone_or_cut_short_is_made_again(folder: Path) -> None:
    before = files_of(folder)
    next(folder.glob("*_event.csv")).unlink()
    wrench = next(folder.glob("*_wrench.csv"))
    wrench.write_bytes(wrench.read_bytes()[:100])
    assert repair(folder) is not None
    assert files_of(folder) == before


def test_nobody_repairs_a_run_that_somebody_works_on(folder: Path) -> None:
    before = files_of(folder)
    after = acted(folder, FINAL)
    put(folder, before | {JOURNAL_FILE: after[JOURNAL_FILE]})
    with Hold(folder / HOLD_FILE):
        run = summary(folder)  # the result is about to be written
        assert (run.problem, run.final) == (None, False)
        with pytest.raises(MadrobError, match="a console works on this run"):
            repair(folder)
    assert summary(folder).repairable  # nothing of that was kept
    assert files_of(folder)[RESULT_FILE] == before[RESULT_FILE]


def test_a_report_says_of_what_journal_it_was_made(folder: Path) -> None:
    acted(folder, FINAL)
    page = folder / "report.html"
    page.write_text("")
    put(folder, files_of(folder) | {"report.html": b"<p>of a friend"})
    assert list(repair_all(folder.parent)) == []
    assert page.read_bytes() == b"<p>of a friend"  # it does not say
    old = made_of(f'<meta name="journal" content="3 {"0" * 64}">')
    assert old is not None
    page.write_text(f'<meta name="journal" content="{old.lines} {old.sha256}">')
    assert list(repair_all(folder.parent)) == []
    entries, _ = read_journal(folder / JOURNAL_FILE)
    assert made_of(page.read_text()) == mark_of(entries)


def test_events_and_withdrawn_lines_are_no_part_of_a_mark() -> None:
    said = [Entry(1.0, Origin.SYSTEM, "run starts"), Entry(2.0, Origin.CLOCK, "run stops")]
    beside = [
        Entry(1.5, Origin.SENSOR, "event"),
        Entry(0.0, Origin.SYSTEM, "withdrawn"),
        Entry(3.0, Origin.SYSTEM, "result written"),
    ]
    assert mark_of([said[0], *beside, said[1]]) == mark_of([*said, *beside])
    assert mark_of(said) != mark_of(said[:1])


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
    folder = drive.folder
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
    "mappings[1].scale": lambda d: d["mappings"][1].update(scale=2.0),
    "closure": lambda d: d.update(closure={"team_word": "acknowledged"}),
    "team": lambda d: d.update(team="Nova"),
}


def test_whatever_is_changed_in_a_result_is_found(run: Path) -> None:
    for edit in EDITS.values():
        change(run, edit)
    assert set(found(run)) == set(EDITS)


def test_indicators_that_are_missing_are_found(run: Path) -> None:
    change(run, lambda document: document["indicators"].clear())
    assert set(found(run)) == {f"indicators.{name}.value" for name in IndicatorName}


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
    assert {difference.what for difference in checked.differences_of(Grade.DIFFERS)} == {
        "start",
        "events[1].time",
        "events[2].since_start",
        "indicators.capability_level.value",
    }
    assert checked.differences_of(Grade.CLOSE) == ()


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
        assert found(drive.folder) == []


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


NONE = "no stored result lies beside the recording"


def test_a_bag_alone_has_no_stored_result(tmp_path: Path) -> None:
    folder = copy_run(tmp_path, 1)
    (bag,) = folder.glob("*.mcap")
    assert stored_result(bag) == NONE
    (folder / "result.json").unlink()
    assert stored_result(folder) == NONE


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    return shutil.copytree(completed(), tmp_path / completed().name)


def reissue(folder: Path, rules: RulesetName) -> None:
    made = next_issue(RunPath(folder), RuleChange("rules of May", rules, "Ada", 1_800_000_100.0))
    assert made is not None
    write_next_issue(made, 1_800_000_101.0)


def told_of_rules(folder: Path) -> list[str]:
    remarks = score_opened(folder).result.quality.remarks
    return [remark for remark in remarks if remark.startswith(BY_THE_RULES)]


def test_where_other_rules_stop_a_run_is_said_only_while_they_count(finished: Path) -> None:
    reissue(finished, RulesetName.ROBUST_2026)
    assert len(told_of_rules(finished)) == 1
    reissue(finished, RulesetName.PROTOCOL)
    assert told_of_rules(finished) == []


def test_a_torn_recording_that_has_all_steps_has_lost_none_by_other_rules(finished: Path) -> None:
    reissue(finished, RulesetName.ROBUST_2026)
    bag = next(finished.glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[:-60])  # its footer
    remarks = open_run(finished).assessment.quality().remarks
    assert not any("is lost" in remark for remark in remarks)


def test_a_result_that_was_put_beside_another_run_is_not_issued_again_as_that_one(
    finished: Path,
) -> None:
    path = finished / "result.json"
    document = msgspec.json.decode(path.read_bytes())
    path.write_bytes(msgspec.json.encode(document | {"subject": 41}))
    without_digests(finished)
    change = RuleChange("rules of May", None, "Ada", 1_800_000_100.0)
    with pytest.raises(MadrobError, match=r"of another run .*subject: stored 41, now 3"):
        next_issue(RunPath(finished), change)
