"""`madrob recover` and `madrob tidy` as people and scripts use them."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock
from zipfile import ZipFile

import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import JOURNAL_FILE, REPORT_FILE, RESULT_FILE
from madrob_console.cli import tidy_command
from madrob_console.common.file_locks import Hold
from madrob_console.referee.journal import HOLD_FILE
from recorder.reader import Bag
from recorder.writer import BagWriter
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import (
    appealed,
    completed,
    final,
    list_files,
    without_digests,
)
from tests.recorder.samples import add_evidence, strings, talk


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


def test_evidence_that_was_cut_off_is_repaired_and_what_is_hopeless_is_named(
    folder: Path, madrob: Madrob
) -> None:
    for number, left in ((0, -100), (1, 5)):
        file = add_evidence(folder, strings(["a", "b"]), number)
        file.write_bytes(file.read_bytes()[:left])
    (line,) = madrob("recover", folder).splitlines()
    kept, hopeless = (f"{folder.name}_evidence_{number}.mcap" for number in (0, 1))
    told = f"{folder}: whole, .*; evidence {kept}: 2 messages kept, cut: "
    assert re.match(f"{told}.*; evidence stays as it is: .*{hopeless} is no evidence: ", line)
    madrob("score --check", folder)


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
def root(tmp_path: Path) -> Path:
    """Four runs with evidence, the second one protested; the higher its number the later."""
    results = tmp_path / "results"
    for number in range(1, 5):
        source = appealed() if number == 2 else final()
        stem = re.sub(r"_run_001_(\d{8})_\d{6}", rf"_run_{number:03d}_\1_{number:06d}", source.name)
        folder = shutil.copytree(source, results / stem)
        path = folder / RESULT_FILE
        stored = json.loads(path.read_text())
        own = {"run_number": number, "start": stored["start"] + number, "run_id": ""}
        path.write_text(json.dumps(stored | own))
        without_digests(folder)
        add_evidence(folder, strings(["a picture", "another"]))
        list_files(folder)
    return results


@pytest.fixture
def tidy(root: Path, madrob: Madrob) -> Callable[..., str]:
    """What it prints; all evidence may go."""
    return lambda flags, code=0: madrob(f"tidy {flags} --results", root, code=code)


ALL = "--keep-runs 0"


def files(root: Path) -> int:
    return len(list(root.glob("*/*_evidence_*")))


def test_a_dry_run_says_what_goes_what_stays_and_why(root: Path, tidy: Callable[..., str]) -> None:
    *lines, total = tidy(f"{ALL} --dry-run").splitlines()
    ends = [re.split(r" {2,}", line, maxsplit=3)[3] for line in lines]
    assert ends == ["goes", "stays: it was protested", "goes", "stays: it is the last practice run"]
    assert total.startswith("evidence of 2 runs, ")
    assert files(root) == 4


def test_room_that_cannot_be_made_is_told_in_the_last_line(tidy: Callable[..., str]) -> None:
    for flag in ("--dry-run", "--yes"):
        line = tidy(f"--until-free 900000GB {flag}").splitlines()[-1]
        assert re.fullmatch(r"--until-free 900 TB is not reached: \d+ TB are lacking", line)
    assert "--until-free" not in tidy("--until-free 1MB --dry-run")


@pytest.mark.parametrize(
    ("yes", "code", "end", "left"),
    [
        (False, tidy_command.NOT_REMOVED, "nothing was removed\n", 4),
        (True, 0, "of evidence of 2 of 2 runs; ", 2),
    ],
)
def test_it_asks_and_no_means_no(
    yes: bool, code: int, end: str, left: int,
    root: Path, tidy: Callable[..., str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    says_yes = Mock(return_value=yes)
    monkeypatch.setattr(tidy_command, "somebody_there", lambda: True)
    monkeypatch.setattr(tidy_command, "says_yes", says_yes)
    assert end in tidy(ALL, code=code)
    says_yes.assert_called_once_with("Remove the evidence of 2 runs for good? [y/N] ")
    assert files(root) == left


def test_without_anybody_to_ask_it_wants_to_be_told_so(root: Path, madrob: Madrob) -> None:
    said = madrob.complaint(f"tidy {ALL} --results", root)
    assert said == "madrob: nobody is there to be asked: --yes removes without asking\n"
    assert files(root) == 4


def test_report_and_zips_say_that_evidence_was_removed(
    root: Path, tidy: Callable[..., str], madrob: Madrob
) -> None:
    report, target = next(root.glob("*_run_001_*")) / REPORT_FILE, root.parent / "exported.zip"
    report.write_text("<html>")
    tidy(f"{ALL} --yes")
    words = r"Evidence removed.*on \d{4}-\d\d-\d\d [^<]*: 1 file, \d+\.\d MB"
    assert re.search(words, report.read_text(), re.DOTALL)
    for what, words in {
        "--subject 3 --practice": "removed by tidy on",
        f"--run {report.parent.name} --dossier": "evidence was removed by tidy on",
    }.items():
        madrob(f"export {what} --results", root, "--output", target)
        with ZipFile(target) as packed:
            assert words in packed.read("README.txt").decode()


def test_nothing_goes_while_a_run_goes_on(root: Path, madrob: Madrob) -> None:
    going = next(root.glob("*_run_004_*"))
    (going / RESULT_FILE).unlink()
    with Hold(going / HOLD_FILE):
        said = madrob.complaint(f"tidy {ALL} --yes --results", root)
    assert said == f"madrob: {going.name}: this run goes on: tidy after it\n"
    assert files(root) == 4


def test_a_run_that_refuses_is_named_and_the_rest_goes(root: Path, madrob: Madrob) -> None:
    tear(next(root.glob("*_run_001_*")), 0.99)
    said = madrob.say(f"tidy {ALL} --yes --results", root)
    assert (said.code, said.err.count("\n"), files(root)) == (2, 1, 3)
    assert "`madrob recover` repairs it" in said.err
    assert "of evidence of 1 of 2 runs; " in said.out


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
