"""`madrob doctor --archive`: one verdict whether the runs of an archive may be handed in."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.referee.run_summary import RunSummary
from scoring.protocol import Outcome
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import OfficialDrive, make_setup, signed
from tests.madrob_console.recorded_runs import new_drive
from tests.madrob_console.run_folders import UNDECIDED_START, document, summary, write


@cache
def official() -> Path:
    """A results folder with an official run that its team acknowledged; never to be changed."""
    drive = new_drive(competition="Cup", of=OfficialDrive)
    drive.whole_run(make_setup())
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


def test_an_archive_that_is_whole_signed_and_decided_may_be_handed_in(madrob: Madrob) -> None:
    assert list(findings(madrob, official(), code=0)) == ["runs"]
    assert "may be handed in, 0 warnings" in madrob("doctor --archive", official())


def changed(name: str, old: str, new: str) -> Callable[[Path], object]:
    """Writes other words into a file of a run."""

    def change(run: Path) -> None:
        (path,) = run.glob(name)
        path.write_text(re.sub(old, new, path.read_text()))

    return change


def without(of: str) -> Callable[[Path], object]:
    return changed(JOURNAL_FILE, f'.*"what": "{of}".*\n', "")


SPOILT: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "check": (changed("*_wrench.csv", "$", "\n"), "differs in 2: files."),
    "damaged": (changed(RESULT_FILE, '"completed"', '"timeout"'), "was changed after it was writ"),
    "check ": (lambda run: next(run.glob("*_0.mcap")).unlink(), "cannot read"),
    "check  ": (without("event"), "journal.jsonl: stored \"'event' of"),
    "not noted": (without("result written"), "no line of journal.jsonl has"),
    "twice": (
        lambda run: shutil.copytree(run, run.parent / "copied" / run.name),
        "is the same run as",
    ),
}


@pytest.mark.parametrize("case", SPOILT)
def test_what_disagrees_with_its_digest_or_is_there_twice_is_named(
    case: str, archive: Path, madrob: Madrob
) -> None:
    spoil, words = SPOILT[case]
    name = run_in(archive).name
    spoil(run_in(archive))
    finding = findings(madrob, archive, code=1)[case.strip()]
    ((place, why),) = finding["runs"].items()
    assert (finding["severity"], Path(place).name, words in why) == ("error", name, True)


def test_a_result_that_no_line_has_noted_is_noted_by_recover(archive: Path, madrob: Madrob) -> None:
    journal = run_in(archive) / JOURNAL_FILE
    last = json.loads(journal.read_text().splitlines()[-1])
    without("result written")(run_in(archive))
    assert "not noted" in findings(madrob, archive, code=1)
    madrob("recover", run_in(archive))
    assert list(findings(madrob, archive, code=0)) == ["runs"]
    again = json.loads(journal.read_text().splitlines()[-1])
    assert again["details"] == last["details"]


def rewritten(run: RunSummary, **keys: object) -> Callable[[Path], None]:
    """Writes a run with other keys in its result."""

    def put(root: Path) -> None:
        write(root, run).write_text(json.dumps(document(run) | keys))

    return put


FIRST: dict[str, Any] = {"final": True, "team_word": "acknowledged", "testbed": "Hall A"}
SECOND: dict[str, Any] = {**FIRST, "run_number": 2, "hour": 1.0}
CASES: Mapping[str, tuple[Callable[[Path], object], str, str]] = {
    "no result": (lambda root: write(root, summary(**SECOND)).rename(root / "away"), "error", ""),
    "not signed": (lambda root: write(root, summary(**SECOND | {"final": False})), "error", ""),
    "protest": (lambda root: write(root, summary(**SECOND, protest_filed=1.0)), "error", ""),
    "undecided": (
        lambda root: write(root, summary(**SECOND, flags=(UNDECIDED_START,))),
        "error",
        "",
    ),
    "practice": (lambda root: write(root, summary(**SECOND, source="simulated")), "error", ""),
    "competition": (lambda root: write(root, summary(**SECOND, competition="Spring")), "error", ""),
    "ruleset": (
        lambda root: write(root, summary(**SECOND, ruleset="eurobench-2020")),
        "error",
        "",
    ),
    "run number": (
        lambda root: write(root, summary(**FIRST, hour=1, outcome=Outcome.ABORTED, values={})),
        "error",
        "",
    ),
    "run number ": (
        lambda root: [
            write(root / hall, summary(**FIRST, condition=4, hour="ab".index(hall), run_id=hall))
            for hall in "ab"
        ],
        "error",
        "3/4/1 in a, 3/4/1 in b: void repeats of one hall",
    ),
    "folder name": (
        lambda root: write(root / "b", summary(**FIRST | {"testbed": "B"}, run_id="b")),
        "warning",
        "",
    ),
    "team name": (lambda root: write(root, summary(**SECOND, team="Another")), "warning", ""),
    "subject": (lambda root: write(root, summary(4, **SECOND, team="Team 3")), "warning", ""),
    "thresholds": (
        lambda root: write(root, summary(**SECOND, thresholds={"lintel_height": 2.2})),
        "warning",
        r"3/7/2: lintel_height 2\.2, protocol [\d.]+: one hall only",
    ),
    "software": (rewritten(summary(**SECOND), software="madrob-console 0.3.0"), "warning", ""),
    "libraries": (
        rewritten(
            summary(**SECOND),
            libraries={"python": "3.11", "numpy": "2", "scipy": "1", "pandas": "3"},
        ),
        "warning",
        "",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_not_decided_or_not_alike_is_named_with_its_runs(
    case: str, tmp_path: Path, madrob: Madrob
) -> None:
    spoil, severity, text = CASES[case]
    for number in (7, 8, 9):
        write(tmp_path, summary(**FIRST, condition=number, hour=number - 7))
    before = findings(madrob, tmp_path, code=1)
    assert set(before) == {"runs", "check"}  # there are no recordings
    spoil(tmp_path)
    found = findings(madrob, tmp_path, code=1)
    (name,) = set(found) - {"runs", "check"}
    assert (name, found[name]["severity"]) == (case.strip(), severity)
    assert re.fullmatch(text or "[34]/7/[12].*", found[name]["text"]), found[name]["text"]
    assert all(found[name]["runs"].values())


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


@pytest.mark.parametrize("kind", ["run", "hall"])
def test_a_link_that_no_list_follows_is_named(kind: str, archive: Path, madrob: Madrob) -> None:
    linked = shutil.move(run_in(archive) if kind == "run" else archive, archive.parent / "away")
    link = archive / "hall" if kind == "hall" else archive / run_in(official()).name
    shutil.copytree(official(), link.parent / "other")
    link.symlink_to(linked)
    found = findings(madrob, archive, code=1)["left out"]
    assert found["runs"] == {str(link): "is behind a link and left out: name the folder itself"}


def test_the_remedy_is_that_of_the_damage(archive: Path, madrob: Madrob) -> None:
    result = run_in(archive) / RESULT_FILE
    changed(RESULT_FILE, '"completed"', '"timeout"')(run_in(archive))
    damaged = findings(madrob, archive, code=1)["damaged"]
    assert damaged["text"] == "3/1/1: `madrob recover` mends or explains"
    result.unlink()
    result.symlink_to(archive / "nowhere")
    damaged = findings(madrob, archive, code=1)["damaged"]
    assert damaged["text"] == "3/1/1: put a readable file in its place"


def test_what_is_in_no_list_is_named(archive: Path, madrob: Madrob) -> None:
    shutil.copytree(run_in(archive), archive / "the final")
    found = findings(madrob, archive, code=1)["left out"]
    ((place, why),) = found["runs"].items()
    assert place.endswith("the final")
    assert why.startswith("is not called like a run and left out: call it subject_003_")
