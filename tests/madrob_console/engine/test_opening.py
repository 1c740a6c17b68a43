"""Opening an earlier run again: the referee goes on with it where it stands."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

import msgspec
import pytest

from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.folders import next_run_number
from madrob_console.archive.history import History
from madrob_console.archive.rule_change import RuleChange, next_issue, write_next_issue
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.referee.acts import Abort, Act, DeclareTimeout, Finalise, Rule, SetUp
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome, Step
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Drive, document, make_setup
from tests.madrob_console.recorded_runs import completed, without_digests

SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "Ada")


def finished(results: Path, run_number: int = 1) -> Path:
    """A completed run on disk."""
    source = completed(run_number)
    return shutil.copytree(source, results / source.name)


def cut_off(results: Path, *acts: Act) -> Path:
    """A run whose engine was killed: no stop in the journal, no result, no end of the bag."""
    drive = Drive(results.with_name("before"))
    drive.start(make_setup())
    drive.wait(6.0)
    for act in acts:
        drive.engine.submit(act, lambda _refused: None)
    folder = drive.cut_off_copy(results)
    drive.engine.close()
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def issued_by_other_rules(folder: Path) -> None:
    change = RuleChange("rules of May", RulesetName.EUROBENCH_2020, "Ada", 1_700_000_100.0)
    issue = next_issue(RunPath(folder), change)
    assert issue is not None
    write_next_issue(issue, 1_700_000_101.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return finished(tmp_path)


@contextmanager
def opened(folder: Path) -> Iterator[Drive]:
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    yield drive
    drive.engine.close()


def test_an_opened_run_shows_the_same_digits_and_writes_nothing(drive: Drive) -> None:
    drive.start(make_setup())
    live, folder = drive.scored_result(), drive.folder
    drive.engine.close()
    before = files(folder)
    with opened(folder) as later:
        snapshot = later.engine.snapshot()
        assert (snapshot.opened, snapshot.result) == (True, live)
        assert (snapshot.run.phase, snapshot.run.issue) == (Phase.STOPPED, 1)
        assert files(folder) == before | {HOLD_FILE: b""}
    assert files(folder) == before


@pytest.mark.parametrize("final", [False, True])
def test_a_run_re_issued_while_it_was_read_is_read_again_and_goes_on_by_its_rules(
    folder: Path, *, final: bool
) -> None:
    if final:
        with opened(folder) as drive:
            drive.act(SIGNED)
    drive = Drive(folder.parent)
    read = drive.engine.read_run(folder).result()
    issued_by_other_rules(folder)
    before, told = files(folder), list[str | None]()
    drive.engine.open_run(read, told.append)
    assert told == [f"{folder.name}: was changed meanwhile: open it once more"]
    assert (drive.engine.run.phase, drive.engine.folder) == (Phase.IDLE, None)
    assert not is_held(folder / "journal.jsonl")
    assert files(folder) == before
    with opened(folder) as drive:
        run = drive.engine.run
        assert (run.issue, run.phase, run.ruleset) == (
            *(2, Phase.STOPPED, RulesetName.EUROBENCH_2020),
        )
        drive.act(Rule(Step.CROSS, False, "came back"), SIGNED)
    stored = document(folder)
    assert (stored["issue"], stored["ruleset"], stored["closure"]["team_word"]) == (
        *(2, "eurobench-2020", "acknowledged"),
    )
    assert check_run(RunPath(folder)).grade is Grade.SAME


@pytest.mark.parametrize(
    ("acts", "outcome"),
    [((), Outcome.INTERRUPTED), ((DeclareTimeout("gave up"),), Outcome.TIMEOUT)],
    ids=["interrupted", "after a timeout"],
)
def test_a_run_that_was_cut_off_is_found_and_scored_as_it_stopped(
    tmp_path: Path, acts: Sequence[Act], outcome: Outcome
) -> None:
    results = tmp_path / "results"
    folder = cut_off(results, *acts)
    finished(results, run_number=2)
    (unfinished,) = Drive(results).engine.snapshot().unfinished
    assert (unfinished.folder, unfinished.phase) == (f"practice/{folder.name}", Phase.RUNNING)
    assert unfinished.recorded == sum(p.stat().st_size for p in folder.glob("*.mcap")) > 0
    words = "practice run 1 of subject 3 Delft was cut off while running, last line +"
    assert unfinished.words.startswith(words)
    assert acts or unfinished.last_event == "door opens"
    for _ in range(2):
        drive = Drive(results)
        assert drive.open(folder) is None
        drive.finish()
        shown, stored = drive.engine.snapshot(), document(folder)
        assert (shown.run.outcome, shown.unfinished, stored["outcome"]) == (outcome, (), outcome)
        assert 0 < (shown.elapsed or 0) < 10
        assert stored["outcome_reason"] == shown.run.outcome_reason
        assert not acts or shown.run.outcome_reason == "gave up"
        assert stored["indicators"]["time_to_handle"]["value"] is not None
        assert check_run(RunPath(folder)).differences == ()
        drive.engine.close()


def test_no_run_is_opened_while_one_goes_on_nor_by_two_consoles(
    folder: Path, tmp_path: Path, drive: Drive
) -> None:
    drive.start(make_setup(run_number=2))
    with closing(Drive(tmp_path).engine) as other:
        assert other.snapshot().unfinished == ()  # it was not cut off
        with pytest.raises(MadrobError, match="another console works on this run"):
            other.read_run(drive.folder).result()
    assert drive.open(folder) == "a run is going on"
    drive.act(Abort("enough"))
    assert drive.open(folder) == "the result of the last run is being written"
    drive.finish()
    assert drive.open(folder) is None


def test_the_handle_zero_of_today_outlives_a_look_at_an_earlier_run(
    folder: Path, drive: Drive
) -> None:
    drive.prepare(make_setup(run_number=2))
    zero = drive.engine.run.handle_zero
    assert drive.open(folder) is None
    drive.act(SetUp(make_setup(run_number=2)))
    assert drive.engine.run.handle_zero == zero != 0
    assert not drive.engine.snapshot().opened


def test_remarks_that_only_the_stored_result_knows_are_kept(folder: Path) -> None:
    lost = "/madrob/door/angle: 3 messages were lost on the way"
    changed = document(folder)
    changed["quality"]["remarks"].append(lost)
    (folder / "result.json").write_bytes(msgspec.json.encode(changed))
    without_digests(folder)
    with opened(folder) as drive:
        result = drive.engine.snapshot().result
        assert result is not None
        assert result.quality.remarks == (lost,)


def test_a_folder_without_its_journal_gets_one_again(folder: Path) -> None:
    (folder / "journal.jsonl").unlink()
    with opened(folder) as drive:
        drive.act(Finalise(TeamWord.ABSENT, "Ada"))
    with opened(folder) as drive:
        assert drive.engine.run.phase is Phase.FINAL


def never_started(results: Path) -> Path:
    """A run whose engine was killed when its folder was made and its countdown had not begun."""
    folder = finished(results)
    for path in folder.iterdir():
        if path.suffix not in (".mcap", ".jsonl") and path.name != "metadata.yaml":
            path.unlink()
    journal = folder / "journal.jsonl"
    before, _, _ = journal.read_text().partition('"what": "countdown begins"')
    journal.write_text(before[: before.rindex("\n") + 1])
    return folder


@pytest.mark.parametrize("why", ["", "the disk did not take it within 2 s"])
def test_a_run_that_was_never_started_is_not_asked_about_and_said_to_be_such(
    tmp_path: Path, why: str
) -> None:
    folder = never_started(tmp_path)
    if why:
        line = Entry(3.0, Origin.SYSTEM, "withdrawn", reason=why, details={"act": "start"})
        with (folder / "journal.jsonl").open("a") as journal:
            journal.write(line.to_json() + "\n")
    drive = Drive(tmp_path)
    assert drive.engine.snapshot().unfinished == ()
    with pytest.raises(MadrobError, match="the run was never started"):
        drive.open(folder)
    (run,) = History(tmp_path).refresh()
    never = "the run was never started" + (f": {why}" if why else "")
    assert (run.outcome_word, run.problem, run.team, run.never_ran) == (
        *("never ran", None, "Delft", never),
    )
    assert next_run_number(tmp_path, 3, 1) == 2
