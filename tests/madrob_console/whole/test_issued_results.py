"""What is issued stays: no recording, journal or damage puts another result in its place."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import JOURNAL_FILE, REPORT_FILE, RESULT_FILE
from madrob_console.archive.result_reader import read_result
from madrob_console.cli.repairing import repair_all
from madrob_console.engine.core.engine_core import RETRY_PERIOD
from madrob_console.referee.acts import Finalise, Reissue
from madrob_console.referee.records import TeamWord
from scoring.indicator_table import IndicatorName
from scoring.result import libraries_here, quantity_text
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.recorded_runs import completed, final
from tests.madrob_console.small_disk import memory_disk

LEVEL = IndicatorName.CAPABILITY_LEVEL
SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "Ada")
Files = dict[str, bytes]


@pytest.fixture
def madrob(capsys: pytest.CaptureFixture[str]) -> Madrob:
    return Madrob(capsys)


def files_of(folder: Path) -> Files:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name[0] != "."}


def put(folder: Path, files: Files) -> None:
    for name, content in files.items():
        (folder / name).write_bytes(content)


def result(folder: Path) -> Any:  # noqa: ANN401  JSON
    return json.loads((folder / RESULT_FILE).read_text())


def tear(folder: Path) -> None:
    """Leave half of the recording."""
    (path,) = folder.glob("*.mcap")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def flip_a_bit(folder: Path) -> None:
    path = folder / RESULT_FILE
    text, count = re.subn(r'("execution_time": {\s*"value": )1', r"\g<1>3", path.read_text())
    assert count == 1
    path.write_text(text)


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A signed run of level 6 whose recording ends where the disk was full."""
    place = tmp_path_factory.mktemp("short")
    with memory_disk(place / "disk") as disk:
        drive = Drive(disk.folder / "results")
        drive.start(make_setup())
        drive.wait(8.0)
        drive.wait_for_disk()
        disk.fill()
        drive.finish()
        disk.make_room()
        drive.wait(RETRY_PERIOD + STEP)
        drive.act(SIGNED)
        drive.wait(RETRY_PERIOD + STEP)
        assert drive.engine.refused == ""
        assert drive.engine.run.unrecorded > 0
        drive.engine.close()
        folder = shutil.copytree(drive.folder, place / drive.folder.name)
    issued = read_result(str(folder))
    assert issued.closure is not None
    assert issued.indicators[LEVEL].value == 6
    return folder


@pytest.fixture
def short(short_run: Path, tmp_path: Path) -> Path:
    return shutil.copytree(short_run, tmp_path / "results" / short_run.name)


def test_a_result_signed_after_a_full_disk_stays_when_its_recording_is_recovered(
    short: Path, madrob: Madrob
) -> None:
    before = {name: (short / name).read_bytes() for name in (RESULT_FILE, JOURNAL_FILE)}
    (line,) = madrob("recover", short.parent).splitlines()
    assert line.endswith("; its result stays as it was issued")
    assert {name: (short / name).read_bytes() for name in before} == before
    assert not list(short.glob("result_issue_*"))
    refused = madrob.refusal("score --check", short)
    assert re.search("cannot be checked: lacks [0-9]+ messages", refused)
    (bag,) = madrob.document("score", short)["runs"]
    assert bag["indicators"][LEVEL]["value"] < 6
    assert "nothing was written" in madrob("recover", short.parent)


@pytest.mark.parametrize("flags", ["", "--dry-run"])
def test_a_recording_that_lacks_messages_makes_no_next_issue_by_itself(
    flags: str, short: Path, madrob: Madrob
) -> None:
    before = files_of(short)
    line = f"score --reissue 'rules of May' --ruleset eurobench-2020 {flags}"
    words = "the recording is not the one that"
    assert words in madrob.complaint(line, short)
    assert files_of(short) == before
    drive = Drive(short.parent)
    assert drive.open(short) is None
    drive.act(Reissue("video"))
    drive.engine.close()
    assert (result(short)["issue"], result(short)["closure"]) == (2, None)
    assert (short / "result_issue_1.json").read_bytes() == before[RESULT_FILE]
    put(short, {RESULT_FILE: before[RESULT_FILE]})  # as a kill leaves it before the result
    assert words in madrob.complaint("recover", short)
    assert (short / RESULT_FILE).read_bytes() == before[RESULT_FILE]


def test_damage_to_a_result_of_a_recording_that_lacks_messages_is_named_and_stays(
    short: Path, madrob: Madrob
) -> None:
    flip_a_bit(short)
    before = files_of(short)
    (line,) = repair_all(short.parent)
    assert f"{short}: result.json is damaged, and what the recording gives is not the same" in line
    assert files_of(short) == before
    drive = Drive(short.parent)
    assert drive.open(short) is None
    drive.wait(STEP)
    assert "result.json is damaged" in drive.engine.refused
    drive.engine.close()
    assert files_of(short) == before
    said = madrob.complaint("recover", short)
    words = (
        r"result\.json is damaged and cannot be made again \(the recording lacks \d+ messages\): "
    )
    assert re.search(f"{words}put a copy of it back$", said)
    assert (short / RESULT_FILE).read_bytes() == before[RESULT_FILE]
    assert (short / JOURNAL_FILE).read_bytes() == before[JOURNAL_FILE]


def test_a_report_shows_what_was_issued(short: Path, madrob: Madrob) -> None:
    issued = read_result(str(short))
    madrob("report", short)
    page_words = " ".join(re.sub("<[^>]*>", " ", (short / REPORT_FILE).read_text()).split())
    (again,) = score(short)
    passage, other = (
        result.indicators[IndicatorName.PASSAGE_TIME] for result in (issued, again.result)
    )
    assert passage.value is not None
    assert passage.value != other.value
    assert quantity_text(passage.value, passage.uncertainty) in page_words
    assert again.result.indicators[LEVEL].value != 6
    assert "6 of 6 steps" in page_words


@pytest.fixture
def signed(tmp_path: Path) -> Path:
    return shutil.copytree(final(), tmp_path / "results" / final().name)


def of_other_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on results are not the same to the last byte."""
    other = replace(libraries_here(), numpy="9.9")
    monkeypatch.setattr("madrob_console.archive.result_files.libraries_here", lambda: other)


def test_a_damaged_result_becomes_the_signed_one_or_the_next_issue_by_recover_alone(
    signed: Path, monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    right = (signed / RESULT_FILE).read_bytes()
    flip_a_bit(signed)
    madrob("recover", signed)
    assert (signed / RESULT_FILE).read_bytes() == right
    of_other_libraries(monkeypatch)
    flip_a_bit(signed)
    damaged = files_of(signed)
    (line,) = repair_all(signed.parent)
    assert "try `madrob recover`: it makes the next version" in line
    assert files_of(signed) == damaged
    assert "its result was made again" in madrob("recover", signed)
    after = result(signed)
    assert (after["issue"], after["closure"]) == (2, None)
    assert after["indicators"] == json.loads(right)["indicators"]
    (why,) = after["reissues"]
    assert (why["what"], why["reason"]) == ("re-issued after damage", "result.json was damaged")
    assert (signed / "result_issue_1.json").read_bytes() == damaged[RESULT_FILE]
    lines = (signed / JOURNAL_FILE).read_text().splitlines()
    said = [json.loads(line)["what"] for line in lines[-2:]]
    assert said == ["re-issued after damage", "result written"]
    madrob("score --check", signed)


def out_of_date(folder: Path) -> None:
    """As a kill leaves it between the signature's line and the result."""
    before = files_of(folder)
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.act(SIGNED)
    drive.engine.close()
    put(folder, {name: before[name] for name in before if name != JOURNAL_FILE})
    journal = folder / JOURNAL_FILE
    *lines, written = journal.read_text().splitlines(keepends=True)
    assert "result written" in written
    journal.write_text("".join(lines))


def with_another_recording(folder: Path) -> None:
    out_of_date(folder)
    tear(folder)


def with_lost_lines(folder: Path) -> None:
    path = folder / JOURNAL_FILE
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if '"run stops"' not in line))


def without_a_journal(folder: Path) -> None:
    (folder / JOURNAL_FILE).unlink()
    (folder / RESULT_FILE).write_bytes(b"{")


def with_a_table_less(folder: Path) -> None:
    next(folder.glob("*_jointState.csv")).unlink()
    tear(folder)


def open_in_a_console(folder: Path) -> None:
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.wait(STEP)
    drive.engine.close()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            with_another_recording,
            "the recording is not the one that result.json was made of: put that back",
        ),
        (with_lost_lines, "journal.jsonl lacks lines that result.json was made of: put a copy"),
        (
            without_a_journal,
            "is damaged and cannot be made again (journal.jsonl is missing): put a",
        ),
        (with_a_table_less, "as result.json lists them: put copies back"),
    ],
)
def test_what_cannot_be_made_good_is_one_line_and_the_result_stays(
    spoil: Callable[[Path], None], words: str, tmp_path: Path, madrob: Madrob
) -> None:
    folder = shutil.copytree(completed(), tmp_path / "results" / completed().name)
    spoil(folder)
    stored, journal = (files_of(folder).get(name) for name in (RESULT_FILE, JOURNAL_FILE))
    assert words in madrob.complaint("recover", folder)
    assert all(str(folder) in line for line in repair_all(folder.parent))
    assert files_of(folder).get(JOURNAL_FILE) == journal
    open_in_a_console(folder)
    assert (folder / RESULT_FILE).read_bytes() == stored
    (folder / RESULT_FILE).rename(folder / "result_of_old.json")  # what the words say
    open_in_a_console(folder)
    assert read_result(str(folder)).issue == 1
