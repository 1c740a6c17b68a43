"""`madrob doctor --archive`: one verdict whether the runs of an archive may be handed in."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Outcome
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import OfficialDrive, make_setup, signed
from tests.madrob_console.run_folders import UNDECIDED_START, document, summary, write

_kept: list[TemporaryDirectory[str]] = []


@cache
def official() -> Path:
    """A results folder with an official run that its team acknowledged; never to be changed."""
    _kept.append(TemporaryDirectory())
    drive = OfficialDrive(Path(_kept[-1].name) / "runs", competition="Cup")
    drive.whole_run(replace(make_setup(), testbed="Hall A"))
    drive.act(signed(drive.engine.snapshot()))
    drive.wait(3.0)
    drive.engine.close()
    return drive.folder.parent


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    return shutil.copytree(official(), tmp_path / "archive")


def run_in(archive: Path) -> Path:
    (folder,) = archive.glob("subject_*")
    return folder


def findings(madrob: Madrob, archive: Path, code: int) -> dict[str, dict[str, Any]]:
    """By subject; the lines for people say the same, each within 80 columns."""
    lines = madrob("doctor --archive", archive, code=code).splitlines()
    assert max(map(len, lines)) <= 80, lines
    told = json.loads(madrob("doctor --json --archive", archive, code=code))
    assert told["passed"] == (code == 0)
    assert lines[-1] == told["verdict"]
    assert [line.split() for line in lines[:-1]] == [
        f"{one['severity']} {one['subject']} {one['text']}".split() for one in told["findings"]
    ]
    return {one["subject"]: one for one in told["findings"]}


def test_an_archive_that_is_whole_signed_and_decided_may_be_handed_in(
    archive: Path, madrob: Madrob
) -> None:
    assert list(findings(madrob, archive, code=0)) == ["runs"]
    assert "may be handed in, 0 warnings" in madrob("doctor --archive", archive)


def change_a_table(run: Path) -> None:
    path = next(run.glob("*_wrench.csv"))
    path.write_text(path.read_text() + "\n")


def change_the_result(run: Path) -> None:
    path = run / RESULT_FILE
    path.write_text(path.read_text().replace('"completed"', '"timeout"'))


def lose_the_recording(run: Path) -> None:
    next(run.glob("*_0.mcap")).unlink()


def copy_the_run(run: Path) -> None:
    shutil.copytree(run, run.parent / "copied" / run.name)


def lose_lines(run: Path, of: str) -> None:
    path = run / JOURNAL_FILE
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if f'"what": "{of}"' not in line))


SPOILT: Mapping[str, tuple[Callable[[Path], None], str]] = {
    "check": (change_a_table, "differs in 2: files."),
    "damaged": (change_the_result, "was changed after it was written"),
    "check ": (lose_the_recording, "cannot read"),
    "check  ": (partial(lose_lines, of="event"), "journal.jsonl: stored \"'event' of"),
    "not noted": (partial(lose_lines, of="result written"), "no line of journal.jsonl has"),
    "twice": (copy_the_run, "is the same run as"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_what_disagrees_with_its_digest_or_is_there_twice_is_named(
    case: str, archive: Path, madrob: Madrob
) -> None:
    spoil, words = SPOILT[case]
    run = run_in(archive)
    spoil(run)
    finding = findings(madrob, archive, code=1)[case.strip()]
    assert finding["severity"] == "error"
    ((place, why),) = finding["runs"].items()
    assert Path(place).name == run.name
    assert words in why


def test_a_result_that_no_line_has_noted_is_noted_by_recover(archive: Path, madrob: Madrob) -> None:
    journal = run_in(archive) / JOURNAL_FILE
    *lines, last = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines))
    assert "not noted" in findings(madrob, archive, code=1)
    madrob("recover", run_in(archive))
    assert list(findings(madrob, archive, code=0)) == ["runs"]
    again = json.loads(journal.read_text().splitlines()[-1])
    assert again["details"] == json.loads(last)["details"]


def changed(run: RunSummary, **keys: object) -> Callable[[Path], None]:
    """Writes a run with other keys in its result."""

    def put(root: Path) -> None:
        write(root, run).write_text(json.dumps(document(run) | keys))

    return put


FIRST: dict[str, Any] = {"final": True, "team_word": "acknowledged", "testbed": "Hall A"}
SECOND: dict[str, Any] = {**FIRST, "run_number": 2, "hour": 1.0}
CASES: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "no result": (lambda root: write(root, summary(**SECOND)).rename(root / "away"), "error"),
    "not signed": (lambda root: write(root, summary(**SECOND | {"final": False})), "error"),
    "protest": (lambda root: write(root, summary(**SECOND, protest_filed=1.0)), "error"),
    "undecided": (lambda root: write(root, summary(**SECOND, flags=(UNDECIDED_START,))), "error"),
    "practice": (lambda root: write(root, summary(**SECOND, source="simulated")), "error"),
    "competition": (lambda root: write(root, summary(**SECOND, competition="Spring")), "error"),
    "ruleset": (lambda root: write(root, summary(**SECOND, ruleset="eurobench-2020")), "error"),
    "run number": (
        lambda root: write(root, summary(**FIRST, hour=1, outcome=Outcome.ABORTED, values={})),
        "error",
    ),
    "folder name": (
        lambda root: write(root / "b", summary(**FIRST | {"testbed": "B"}, run_id="b")),
        "warning",
    ),
    "team name": (lambda root: write(root, summary(**SECOND, team="Another")), "warning"),
    "subject": (lambda root: write(root, summary(4, **SECOND, team="Team 3")), "warning"),
    "thresholds": (
        lambda root: write(root, summary(**SECOND, thresholds={"lintel_height": 2.2})),
        "warning",
    ),
    "software": (changed(summary(**SECOND), software="madrob-console 0.3.0"), "warning"),
    "libraries": (
        changed(
            summary(**SECOND),
            libraries={"python": "3.11", "numpy": "2", "scipy": "1", "pandas": "3"},
        ),
        "warning",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_not_decided_or_not_alike_is_named_with_its_runs(
    case: str, tmp_path: Path, madrob: Madrob
) -> None:
    spoil, severity = CASES[case]
    for number in (7, 8, 9):
        write(tmp_path, summary(**FIRST, condition=number, hour=number - 7))
    before = findings(madrob, tmp_path, code=1)
    assert set(before) == {"runs", "check"}  # there are no recordings
    spoil(tmp_path)
    found = findings(madrob, tmp_path, code=1)
    assert set(found) - {"runs", "check"} == {case}
    assert found[case]["severity"] == severity
    assert re.match(r"[34]/7/[12]", found[case]["text"])
    assert all(found[case]["runs"].values())


def test_without_a_run_that_counts_nothing_is_handed_in(tmp_path: Path, madrob: Madrob) -> None:
    write(tmp_path, summary(outcome=Outcome.ABORTED))
    write(tmp_path / "practice", summary(practice=True))
    found = findings(madrob, tmp_path, code=1)["runs"]
    assert (found["severity"], found["text"][:12]) == ("error", "0 of 2 count")


def test_of_many_runs_as_many_are_named_as_there_is_room_for(
    tmp_path: Path, madrob: Madrob
) -> None:
    for number in range(1, 10):
        write(tmp_path, summary(999, 20, 990 + number, hour=number))
    text = findings(madrob, tmp_path, code=1)["not signed"]["text"]
    assert text == "999/20/991, 999/20/992 and 7 more: sign it (Enter, f)"


def test_a_path_without_runs_is_bad_input(tmp_path: Path, madrob: Madrob) -> None:
    assert "no such folder" in madrob.refusal("doctor --archive", tmp_path / "none")
    assert "holds no run: name a results folder" in madrob.refusal("doctor --archive", tmp_path)
    (tmp_path / "file").touch()
    assert "holds no run" in madrob.refusal("doctor --archive", tmp_path / "file")
    assert "is empty: name a path" in madrob.refusal("doctor --archive", "")
    assert madrob.say("doctor --reference --archive", tmp_path).code == 2


@pytest.mark.parametrize("kind", ["run", "hall"])
def test_a_link_that_no_list_follows_is_named(kind: str, archive: Path, madrob: Madrob) -> None:
    linked = shutil.move(run_in(archive) if kind == "run" else archive, archive.parent / "away")
    link = archive / "hall" if kind == "hall" else archive / run_in(official()).name
    shutil.copytree(official(), link.parent / "other")
    link.symlink_to(linked)
    found = findings(madrob, archive, code=1)["left out"]
    assert found["runs"] == {str(link): "is behind a link and left out: name the folder itself"}


def test_the_remedy_is_that_of_the_damage(archive: Path, madrob: Madrob) -> None:
    def remedy() -> str:
        return str(findings(madrob, archive, code=1)["damaged"]["text"])

    result = run_in(archive) / RESULT_FILE
    whole = result.read_text()
    result.write_text(whole.replace('"completed"', '"timeout"'))
    assert remedy() == "3/1/1: `madrob recover` mends or explains"
    result.unlink()
    result.symlink_to(archive / "nowhere")
    assert remedy() == "3/1/1: put a readable file in its place"


def test_one_number_in_two_halls_is_told_by_their_folders(tmp_path: Path, madrob: Madrob) -> None:
    for hall in ("a", "b"):
        write(tmp_path / hall, summary(**FIRST, run_id=hall, hour="ab".index(hall)))
    text = findings(madrob, tmp_path, code=1)["run number"]["text"]
    assert text == "3/7/1 in a, 3/7/1 in b: void repeats of one hall"


def test_a_threshold_that_is_not_alike_is_named_with_both_values(
    tmp_path: Path, madrob: Madrob
) -> None:
    for number in (7, 8, 9):
        unlike = {"lintel_height": 2.2} if number == 9 else None
        run = summary(**FIRST, condition=number, hour=number - 7, thresholds=unlike)
        write(tmp_path, run)
    text = findings(madrob, tmp_path, code=1)["thresholds"]["text"]
    assert re.fullmatch(r"3/9/1: lintel_height 2\.2, protocol [\d.]+: one hall only", text)


def test_a_path_with_a_renamed_run_alone_says_its_name(archive: Path, madrob: Madrob) -> None:
    run_in(archive).rename(archive / "the final")
    assert "is not called like a run and left out" in madrob.refusal("doctor --archive", archive)


def test_what_is_in_no_list_is_named(archive: Path, madrob: Madrob) -> None:
    shutil.copytree(run_in(archive), archive / "the final")
    found = findings(madrob, archive, code=1)["left out"]
    ((place, why),) = found["runs"].items()
    assert place.endswith("the final")
    assert why.startswith("is not called like a run and left out: call it subject_003_")
