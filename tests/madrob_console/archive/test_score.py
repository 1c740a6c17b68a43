"""`madrob_console.archive.score`: what programs call."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shutil
from collections.abc import Callable
from functools import partial, reduce
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from madrob_console.archive import score
from madrob_console.archive.appeal import stored_result
from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import History
from madrob_console.archive.repair import repair
from madrob_console.archive.rule_change import RuleChange, next_issue
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import open_run, read_recorded_run
from madrob_console.cli.repairing import repair_all
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.pages.competition import competition_standings
from madrob_console.pages.related_runs import made_of
from madrob_console.referee.acts import Act, AddNote, Finalise, MarkIncident, Reissue, Rule
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin, read_journal
from madrob_console.referee.rebuild import mark_of
from madrob_console.referee.records import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.run_summary import RunSummary
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import Bag
from recorder.recovery import recover
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Condition, EventName, Step
from scoring.result import libraries_here
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import (
    completed,
    converted,
    copy_run,
    ended_after,
    note_again,
    publish,
    recorded,
)
from tests.madrob_console.robots import EVERY, Robot


def test_files_with_an_event_after_the_stop_score_as_the_recording_or_say_why(
    tmp_path: Path,
) -> None:
    """By the published rules; the robot is under the sensors when its time is over."""
    drive = Drive(tmp_path / "results", Robot.CLOSES_UNDER_SENSORS)
    drive.whole_run(make_setup(timeout=7.9, ruleset=RulesetName.EUROBENCH_2020))
    drive.engine.close()
    publish(drive.folder, tmp_path / "files")
    found = []
    for place in (tmp_path / "files", drive.folder):
        (scored,) = score(place, RulesetName.EUROBENCH_2020)
        result = scored.result
        values = {name: (one.value, one.reason) for name, one in result.indicators.items()}
        found.append((values, result.outcome, result.events))
    assert found[0] == found[1]
    names = [event.event for event in found[0][2]]
    assert names[-2:] == [EventName.BENCHMARK_STOP, EventName.MOVES_TO_CCW]


def test_a_recording_whose_chunks_lie_in_another_order_scores_the_same(tmp_path: Path) -> None:
    run = completed()
    (whole,), (again,) = score(run), score(converted(run, tmp_path / "again.mcap", chunk=500))
    assert again.result == whole.result


@pytest.mark.parametrize("without", ["nothing", "/event"], ids=["in the bag", "beside it"])
def test_a_recording_without_its_record_is_scored_from_its_journal_and_says_so(
    tmp_path: Path, without: str
) -> None:
    if without == "/event":
        shutil.copy(completed() / JOURNAL_FILE, tmp_path)
    converted(completed(), tmp_path / "converted_0.mcap", records=False, without=without)
    (whole,), (again,) = score(completed()), score(tmp_path)
    assert again.result.indicators == whole.result.indicators
    assert (again.result.events, again.label) == (whole.result.events, whole.label)
    words = "its record madrob_run was lost (converted?): set-up from its journal"
    (flag,) = [flag for flag in again.flags if flag.words.startswith(words)]
    assert flag.weight == "caution"


def test_a_recording_whose_set_up_is_lost_is_refused_with_the_remedy(tmp_path: Path) -> None:
    converted(completed(), tmp_path / "converted_0.mcap", records=False)
    journal = (completed() / JOURNAL_FILE).read_text()
    (tmp_path / JOURNAL_FILE).write_text(re.sub('.*"set up".*\n', "", journal))
    with pytest.raises(MadrobError, match=r"madrob_run was lost \(converted\?\).*original bag"):
        list(score(tmp_path))


def test_a_completion_that_did_not_reach_the_disk_is_named_and_can_be_confirmed(
    folder: Path,
) -> None:
    """The journal's line is on disk at once, what it was decided by half a second later."""
    for result in (*folder.glob("result*.json"), folder / "metadata.yaml"):
        result.unlink()
    (bag,) = folder.glob("*.mcap")

    def remarks() -> list[str]:
        (run,) = score(folder)
        assert run.result.outcome == "completed"
        return [remark for remark in run.result.quality.remarks if "was completed" in remark]

    assert remarks() == []  # nothing that counts is lost
    stop, size = read_recorded_run(folder).run.stop, bag.stat().st_size
    assert stop is not None
    for end in range(size, 0, -size // 100):
        os.truncate(bag, end)
        if max(message.receive_ns for message in Bag(folder).messages()) < 1e9 * stop:
            break
    (lost,) = remarks()
    assert "what was seen of step 5 and 6 is lost, only the referee can confirm it" in lost
    confirmed = [Rule(step, confirmed=True, reason="video") for step in (Step.CLOSE, Step.LOCK)]
    acted(folder, *confirmed)
    (run,) = score(folder)
    assert run.result.indicators[IndicatorName.CAPABILITY_LEVEL].value == 6
    assert remarks() == [lost]  # as it stands in the result


# ---------------------------------------------------------------- against its journal


FINAL = Finalise(TeamWord.PROTESTED, "Ada", "a foot stayed")
RULED = Rule(Step.TOUCH, confirmed=False, reason="it was a draught")
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
    """What a run consists of, by names."""
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
def folder(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A copy of a completed run, or of the one that a test names."""
    source: Path = getattr(request, "param", completed)()
    return shutil.copytree(source, tmp_path / "results" / source.name)


def acted(folder: Path, *acts: Act) -> Files:
    """The files after some acts on an earlier run."""
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(*acts)
    drive.engine.close()
    return files_of(folder)


def refused(folder: Path) -> str:
    """Why lists and standings do not take a result that is to be made again."""
    run = summary(folder)
    assert (run.repairable, run.valid) == (True, False)
    assert not competition_standings([run], made=0.0, official=False).groups
    return str(run.problem)


def repaired(folder: Path) -> Files:
    assert list(repair_all(folder.parent)) == []
    assert summary(folder).problem is None
    assert check_run(RunPath(folder)).differences == ()
    assert repair(folder) is None
    return files_of(folder)


@pytest.mark.parametrize(
    "folder", [partial(recorded, Scenario.TOUCH_ONLY)], ids=["short"], indirect=True
)
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
        assert "is not what the journal says" in refused(folder)
        assert set(found(folder)) & {"journal.lines", "journal.sha256"}
        assert repaired(folder).items() >= {name: after[name] for name in order}.items()
    *before_it, again = read_journal(folder / JOURNAL_FILE)[0]
    assert before_it == [*entries[:-1]]
    assert (again.what, again.details) == (entries[-1].what, entries[-1].details)
    cut_short = after | {JOURNAL_FILE: before[JOURNAL_FILE]}  # the result says more
    put(folder, cut_short)
    refused(folder)
    (line,) = repair_all(folder.parent)
    assert "journal.jsonl lacks lines that result.json was made of: put a copy of it back" in line
    assert files_of(folder) == cut_short


def test_opening_a_run_writes_its_result_again(folder: Path) -> None:
    before = files_of(folder)
    after = acted(folder, FINAL)
    put(folder, before | {JOURNAL_FILE: after[JOURNAL_FILE]})
    with Hold(folder / HOLD_FILE):
        run = summary(folder)  # the result is about to be written
        assert (run.problem, run.final) == (None, False)
        with pytest.raises(MadrobError, match="a console works on this run"):
            repair(folder)
    refused(folder)  # nothing of that was kept
    assert open_run(folder).out_of_date
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    assert drive.engine.run.phase is Phase.FINAL
    drive.engine.close()
    assert files_of(folder)[RESULT_FILE] == after[RESULT_FILE]
    assert not open_run(folder).out_of_date
    assert summary(folder).team_word == "protested"


@pytest.mark.parametrize(
    ("word", "false"),
    [(b'"protested"', b'"acknowledged"'), (b'"closure"', b'"none"'), (b"protested", b"prot\xff")],
    ids=["worded", "unsigned", "torn"],
)
def test_a_word_that_the_journal_does_not_say_never_counts(
    word: bytes, false: bytes, folder: Path
) -> None:
    after = acted(folder, FINAL)
    path = folder / RESULT_FILE
    path.write_bytes(path.read_bytes().replace(word, false))
    run = summary(folder)
    assert (run.problem is None, run.valid) == (False, False)
    assert repaired(folder)[RESULT_FILE] == after[RESULT_FILE]


def test_a_data_file_that_is_gone_or_cut_short_is_made_again(folder: Path) -> None:
    before = files_of(folder)
    next(folder.glob("*_event.csv")).unlink()
    os.truncate(next(folder.glob("*_wrench.csv")), 100)
    assert repair(folder) is not None
    assert files_of(folder) == before


def test_a_report_says_of_what_journal_it_was_made(folder: Path) -> None:
    acted(folder, FINAL)
    page = folder / "report.html"
    old = f'<meta name="journal" content="3 {"0" * 64}">'
    for text in ("<p>of a friend", old):  # it does not say, it says another one
        page.write_text(text)
        assert list(repair_all(folder.parent)) == []
        assert (page.read_text() == text) == (text != old)
    entries, _ = read_journal(folder / JOURNAL_FILE)
    mark = mark_of(entries)
    assert made_of(page.read_text())["journal"] == f"{mark.lines} {mark.sha256}"


def test_events_and_withdrawn_lines_are_no_part_of_a_mark() -> None:
    said = [Entry(1.0, Origin.SYSTEM, "run starts"), Entry(2.0, Origin.CLOCK, "run stops")]
    beside = [
        Entry(1.5, Origin.SENSOR, "event"),
        Entry(0.0, Origin.SYSTEM, "withdrawn"),
        Entry(3.0, Origin.SYSTEM, "result written"),
    ]
    assert mark_of([said[0], *beside, said[1]]) == mark_of([*said, *beside])
    assert mark_of(said) != mark_of(said[:1])


# ---------------------------------------------------------------- against its recording


Document = dict[str, Any]
Edit = Callable[[Document], object]


def change(folder: Path, *edits: Edit) -> None:
    """Edit the stored result of a run."""
    path = folder / RESULT_FILE
    document = msgspec.json.decode(path.read_bytes())
    for edit in edits:
        edit(document)
    path.write_bytes(msgspec.json.encode(document))


def found(folder: Path) -> list[str]:
    return [difference.what for difference in check_run(RunPath(folder)).differences]


CHECK = "score --check"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with rulings, a closure and a second issue."""
    return copy_run(tmp_path, 1, Scenario.NOMINAL)


def scaled(factor: float) -> Edit:
    def edit(document: Document) -> None:
        document["indicators"]["unsafety_of_door_operation"]["value"] *= factor

    return edit


def of_indicator(name: str, **fields: object) -> Edit:
    return lambda document: document["indicators"][name].update(fields)


EDITS: dict[str, Edit] = {
    "indicators.execution_time.value": lambda d: d["indicators"]["execution_time"].update(
        value=d["indicators"]["execution_time"]["value"] * (1 + 2**-52)
    ),
    "indicators.passage_time.reason": of_indicator("passage_time", reason="x"),
    "indicators.capability_level.value": of_indicator("capability_level", value=None),
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
    change(run, *EDITS.values())
    assert set(found(run)) == set(EDITS)
    change(run, lambda document: document["indicators"].clear())
    assert {f"indicators.{name}.value" for name in IndicatorName} <= set(found(run))


ROUNDED = scaled(1 + 1e-12)
"""As another SciPy may have it."""
UNSURE: tuple[Edit, ...] = (
    of_indicator("time_to_handle", uncertainty={"u": 1.0, "expanded": 2.0}),
    lambda d: d["indicators"]["execution_time"]["uncertainty"].update(u=0.5),
    of_indicator("passage_time", uncertainty=None),
)
DOUBTED = of_indicator("execution_time", doubts=["something else"])
HERE = libraries_here()
NOW = f"Python {HERE.python}, NumPy {HERE.numpy}, SciPy {HERE.scipy}, pandas {HERE.pandas}"
UNSAFETY = "indicators.unsafety_of_door_operation.value"
CHECKS: dict[str, tuple[tuple[Edit, ...], int, str, dict[str, list[str]]]] = {
    "nothing": ((), 0, "same digits\n", {}),
    "libraries alone": ((lambda d: d["libraries"].update(numpy="9"),), 0, "same digits\n", {}),
    "a value": (
        (EDITS["indicators.capability_level.value"],),
        *(1, "differs in 1\n  indicators.capability_level.value: stored null, now 6\n"),
        {"differences": ["indicators.capability_level.value"]},
    ),
    "uncertainties": (
        UNSURE,
        *(0, "same digits\n  uncertainties differ in 3: execution_time "),
        {
            "uncertainties": [
                "indicators.execution_time.uncertainty.u",
                "indicators.time_to_handle.uncertainty.u",
                "indicators.time_to_handle.uncertainty.expanded",
                "indicators.passage_time.uncertainty",
            ]
        },
    ),
    "doubts": (
        (DOUBTED,),
        *(1, "differs in 1, only doubts; the values: same digits\n"),  # section 11: three grades
        {"differences": ["indicators.execution_time.doubts"]},
    ),
    "doubts and last digits": (
        (DOUBTED, ROUNDED),
        *(1, "differs in 1, only doubts; the values: equal to 1e-9"),
        {"differences": ["indicators.execution_time.doubts"], "last_digits": [UNSAFETY]},
    ),
    "last digits of other libraries": (
        (ROUNDED, lambda d: d["libraries"].update(scipy="1.0.1", python="3.9.1")),
        0,
        (
            f"equal to 1e-9 (libraries differ: Python 3.9.1 stored, {HERE.python} now; "
            f"SciPy 1.0.1 stored, {HERE.scipy} now)\n  {UNSAFETY}: stored "
        ),
        {"last_digits": [UNSAFETY]},
    ),
    "last digits of the same libraries": (
        (ROUNDED,),
        *(0, f"equal to 1e-9 (the same libraries ({NOW}): another"),
        {"last_digits": [UNSAFETY]},
    ),
}


@pytest.mark.parametrize("case", CHECKS)
def test_a_check_says_in_which_grade_a_result_agrees_and_changes_nothing(
    case: str, run: Path, madrob: Madrob
) -> None:
    edits, code, words, expected = CHECKS[case]
    change(run, *edits)
    before = files_of(run)
    assert madrob(CHECK, run, code=code).startswith(f"{run}: {words}")
    (document,) = madrob.document(CHECK, run, code=code)["runs"]
    assert words.startswith(document["grade"])
    assert document["grade_but_for_doubts"] in words
    for kind in ("differences", "last_digits", "uncertainties"):
        assert [each["what"] for each in document[kind]] == expected.get(kind, [])
    assert document["libraries"]["now"] == msgspec.to_builtins(HERE)
    assert files_of(run) == before


def test_of_many_runs_it_is_counted_how_they_agree_and_a_difference_decides(
    tmp_path: Path, madrob: Madrob
) -> None:
    made: list[tuple[Edit, ...]] = [UNSURE, (DOUBTED,), (EDITS["stop"],), (), ()]
    runs = [copy_run(tmp_path, number) for number in range(1, 6)]
    for run, edits in zip(runs, made, strict=True):
        change(run, *edits)
    change(copy_run(tmp_path, 6, Scenario.NOMINAL), ROUNDED)
    (runs[-1] / RESULT_FILE).unlink()
    assert madrob.say(CHECK, tmp_path).out.splitlines()[-1] == (
        "2 same digits, 1 equal to 1e-9, "
        "2 differ (1 only in doubts: the values hold), 1 could not be checked; "
        "of 1 the uncertainties differ"
    )
    assert [madrob.say(CHECK, *some).code for some in ([tmp_path], runs[3:])] == [1, 2]


def last_digit(*keys: str | int) -> Edit:
    def edit(document: Document) -> None:
        *way, key = keys
        part = reduce(lambda part, step: part[step], way, cast("Any", document))
        part[key] = math.nextafter(part[key], math.inf)

    return edit


def test_times_and_counts_are_compared_to_the_last_digit_and_values_to_1e_9(
    run: Path,
) -> None:
    """1e-9 of the time since the epoch is more than a second."""
    before = (run / RESULT_FILE).read_bytes()
    level = of_indicator("capability_level", value=6 + 1e-12)
    times = ("start",), ("events", 1, "time"), ("events", 2, "since_start")
    change(run, level, *(last_digit(*keys) for keys in times))
    checked = check_run(RunPath(run))
    assert {difference.what for difference in checked.differences_of(Grade.DIFFERS)} == {
        *("start", "events[1].time", "events[2].since_start", "indicators.capability_level.value")
    }
    assert checked.differences_of(Grade.CLOSE) == ()
    for factor in (1 + 0.9e-9, 1 - 0.9e-9, 1 + 1.1e-9, 1 - 1.1e-9, -1):
        (run / RESULT_FILE).write_bytes(before)
        change(run, scaled(factor))
        (one,) = check_run(RunPath(run)).differences
        near = abs(factor - 1) < 1e-9
        assert (one.what, one.grade) == (UNSAFETY, Grade.CLOSE if near else Grade.DIFFERS)


def _files(run: Path) -> None:
    put_text(next(run.glob("*_event.csv")), "door_opens", "door_open$")
    (run / "condition_1.yaml").unlink()
    (run / "added.csv").write_text("time\n")


def remarked(run: Path, remark: str) -> None:
    change(run, lambda d: d["quality"]["remarks"].append(remark))


def _torn(run: Path) -> None:
    bag = next(run.glob("*.mcap"))
    os.truncate(bag, bag.stat().st_size - 200)
    change(run, lambda d: d.update(files={}))


def _torn_and_known(run: Path) -> None:
    _torn(run)
    (remark,) = check_run(RunPath(run)).differences
    remarked(run, remark.recomputed)
    assert found(run.rename(run.with_name("moved"))) == []
    run.with_name("moved").rename(run)


def _torn_before_its_result(run: Path) -> None:
    bag = next(run.glob("*.mcap"))
    os.truncate(bag, bag.stat().st_size - 200)
    content = bag.read_bytes()
    digest = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    change(run, lambda d: d["files"].update({bag.name: digest}))


def _recovered(run: Path) -> None:
    _torn_before_its_result(run)
    assert recover(run).torn is not None


def put_text(path: Path, old: str, new: str) -> None:
    """Other words in a file, or behind what it holds."""
    text = path.read_text()
    path.write_text(text.replace(old, new) if old else text + new)


FILES: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "changed and gone": (_files, ["files.condition_1.yaml", "files.{run}_event.csv.sha256"]),
    "metadata, which `recover` makes of the recording": (
        lambda run: put_text(run / "metadata.yaml", "", "# changed\n"),
        [],
    ),
    "losses that only the engine knew": (
        lambda run: change(run, lambda d: d["quality"]["lost"].append("/a: 3 messages")),
        [],
    ),
    "a torn recording": (_torn, ["quality.remarks"]),
    "a torn recording that the result knows": (_torn_and_known, []),
    "a recording that was torn before its result": (_torn_before_its_result, []),
    "what `recover` made of that": (_recovered, []),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_is_not_what_the_result_was_made_of_is_found(case: str, run: Path) -> None:
    spoil, expected = FILES[case]
    spoil(run)
    stem = next(run.glob("*_event.csv")).name.removesuffix("_event.csv")
    assert found(run) == [what.format(run=stem) for what in expected]


def test_without_a_result_or_a_recording_there_is_nothing_to_check(
    run: Path, tmp_path: Path, madrob: Madrob
) -> None:
    bag, published = next(run.glob("*.mcap")), tmp_path / "published"
    publish(run, published)
    none = "no stored result lies beside the recording"
    nothing = "has no result.json to check: name a run folder with a result\n"
    first, second = madrob.say(CHECK, bag, published).err.splitlines(keepends=True)
    assert (stored_result(bag), first) == (none, f"madrob: {bag}: {nothing}")
    assert "files without a recording" in second
    (run / RESULT_FILE).unlink()
    assert (stored_result(run), madrob.refusal(CHECK, run)) == (none, f"madrob: {run}: {nothing}")


def test_an_aborted_and_an_unfinished_run_and_one_cut_off_with_its_result_agree(
    folder: Path,
) -> None:
    for seconds in (0.5, 3.0):  # in the countdown, and later
        assert found(ended_after(seconds)) == []
    *lines, last = (folder / JOURNAL_FILE).read_text().splitlines(keepends=True)
    assert "result written" in last
    (folder / JOURNAL_FILE).write_text("".join(lines))
    assert found(folder) == []


def test_a_result_that_hides_damage_where_lists_do_not_look_is_named(
    run: Path, madrob: Madrob
) -> None:
    path, deep = run / RESULT_FILE, b"[" * 100_000 + b"]" * 100_000
    path.write_bytes(path.read_bytes().rstrip()[:-1] + b', "more": ' + deep + b"}")
    assert "result.json is damaged" in madrob.refusal(CHECK, run)


@pytest.mark.slow
def test_every_simulated_run_agrees(
    tmp_path: Path, pytestconfig: pytest.Config, madrob: Madrob
) -> None:
    scenarios, rulesets = (*EVERY, Scenario.WORN, Robot.RANDOM), list(RulesetName)
    for number in range(pytestconfig.getoption("--runs")):
        drive = Drive(tmp_path, scenarios[number % len(scenarios)], number, latch=number % 3 == 0)
        setup = make_setup(
            Condition.from_number(number % 20 + 1),
            run_number=number // 20 + 1,
            timeout=15.0,
            ruleset=rulesets[number % 2],
        )
        drive.whole_run(setup)
        drive.engine.close()
    madrob(f"{CHECK} --jobs 1", tmp_path)


# ---------------------------------------------------------------- by other rules


def test_a_result_that_was_put_beside_another_run_is_not_issued_again_as_that_one(
    folder: Path,
) -> None:
    change(folder, lambda document: document.update(subject=41))
    note_again(folder)
    by = RuleChange("rules of May", RulesetName.PROTOCOL, "Ada", 1_800_000_100.0)
    with pytest.raises(MadrobError, match=r"of another run .*subject: stored 41, now 3"):
        next_issue(RunPath(folder), by)
