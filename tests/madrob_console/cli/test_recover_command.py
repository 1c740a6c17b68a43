"""`madrob recover` as people and scripts use it."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.common.file_locks import Hold
from madrob_console.referee.journal import HOLD_FILE
from recorder.reader import Bag
from recorder.writer import BagWriter
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import completed
from tests.recorder.samples import strings, talk


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return shutil.copytree(completed(), tmp_path / completed().name)


def recording(folder: Path) -> Path:
    return next(folder.glob("*_0.mcap"))


def tear(folder: Path, share: float) -> None:
    """Leave a share of the recording, as a kill does."""
    path = recording(folder)
    os.truncate(path, int(share * path.stat().st_size))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.97])
@pytest.mark.parametrize("lost", [RESULT_FILE, JOURNAL_FILE, ""])
def test_a_torn_bag_is_repaired_in_one_line_and_the_result_stays_what_it_was(
    folder: Path, share: float, lost: str, madrob: Madrob
) -> None:
    tear(folder, share)
    if lost:
        (folder / lost).unlink()
    bag, count = recording(folder), sum(1 for _ in Bag(folder).messages())
    (before,) = score(folder)
    (line,) = madrob("recover", folder).splitlines()
    assert line.startswith(f"{folder}: {count} messages kept; cut: it is torn at byte ")
    assert f"the new file is {bag}, the old one is kept as {bag.name}.torn" in line
    assert f"; `madrob score {folder}` works" in line
    (after,) = score(folder)
    assert after.result == before.result
    assert any("is torn at byte" in remark for remark in after.result.quality.remarks)


def test_a_run_that_its_engine_still_holds_is_refused(folder: Path, madrob: Madrob) -> None:
    tear(folder, 0.6)
    before = recording(folder).read_bytes()
    with Hold(folder / HOLD_FILE):
        for path in (folder, recording(folder)):
            words = f"madrob: {folder}.*the engine still holds this run; end it"
            assert re.match(words, madrob.refusal("recover", path))
    assert recording(folder).read_bytes() == before
    madrob("recover", folder)


def test_a_bag_without_a_run_is_repaired_and_nothing_is_promised(
    tmp_path: Path, madrob: Madrob
) -> None:
    bag = tmp_path / "bag"
    with BagWriter(bag, [talk()], {}) as writer:
        for message in strings(["a", "b", "c"]):
            writer.put_message(message)
    tear(bag, 0.9)
    line = madrob("recover", bag)
    assert re.search("3 messages kept.*there is no run in it to be scored\n$", line)


def test_a_results_folder_is_repaired_run_by_run(tmp_path: Path, madrob: Madrob) -> None:
    source, results = completed(), tmp_path / "results"
    whole, torn, lost = (
        Path(shutil.copytree(source, results / place / source.name.replace("_run_001", name)))
        for place, name in ((".", "_run_001"), ("practice", "_run_002"), (".", "_run_003"))
    )
    tear(torn, 0.5)
    tear(lost, 0.0)
    said = madrob.say("recover", results)
    assert (said.code, said.err.count("\n"), str(lost) in said.err) == (2, 1, True)
    lines = f"{torn}: .*messages kept.*\n{whole}: .*nothing was written\n"
    assert re.fullmatch(lines, said.out)


@pytest.fixture
def nested(tmp_path: Path) -> Path:
    """A practice run whose result hides 100,000 brackets."""
    run = shutil.copytree(completed(), tmp_path / "results" / "practice" / completed().name)
    result = run / RESULT_FILE
    deep = "[" * 100_000 + "]" * 100_000
    result.write_text(result.read_text().rstrip()[:-1] + f', "more": {deep}' + "}")
    return run


def test_deeply_nested_result_is_made_again(nested: Path, madrob: Madrob) -> None:
    text = madrob("recover", nested)

    assert text.endswith("; its result was made again from journal and recording\n")
    assert (nested / RESULT_FILE).read_bytes() == (completed() / RESULT_FILE).read_bytes()


@pytest.mark.parametrize("line", ["score --check", "table runs", "standings --practice --results"])
def test_deeply_nested_result_is_one_line(line: str, nested: Path, madrob: Madrob) -> None:
    said = madrob.say(line, nested.parents[1])

    (words,) = said.err.splitlines()
    assert "result.json is damaged (nested without bounds): `madrob recover` makes it" in words
