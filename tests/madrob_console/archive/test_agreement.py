"""The journal's line is what counts: a cut anywhere in a finalise ends in either state."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import History, RunSummary
from madrob_console.archive.repair import repair
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import open_run
from madrob_console.cli.repairing import repair_all
from madrob_console.errors import MadrobError
from madrob_console.files.held import Hold
from madrob_console.referee.acts import Act, AddNote, Finalise, MarkIncident, Reissue, Rule
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin, read_journal
from madrob_console.referee.journal_mark import mark_of
from madrob_console.referee.on_record import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.report.markup import made_of
from madrob_console.standings.competition import competition_standings
from scoring.protocol import Step
from tests.madrob_console.engine.drive import Drive
from tests.madrob_console.recorded_runs import completed, without_digests

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
