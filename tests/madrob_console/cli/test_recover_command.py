"""`madrob recover` as people and scripts use it."""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from zipfile import ZipFile

import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import JOURNAL_FILE, REPORT_FILE, RESULT_FILE
from madrob_console.cli import recover_command, tidy_command
from madrob_console.cli.main import main
from madrob_console.common.files import Hold
from madrob_console.referee.journal import HOLD_FILE, Journal
from recorder.bag import BAG_INFORMATION
from recorder.reader import read_bag
from recorder.survey import put_listing
from recorder.writer import BagWriter
from tests.madrob_console.recorded_runs import appealed, final, without_digests
from tests.recorder.samples import add_evidence, strings, talk
from tests.terminal import Terminal


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run."""
    root = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(root / "config"))
        flags = ["--subject", "3", "--countdown", "1", "--no-report", "--results", str(root)]
        assert main(["run", "--testbed", "simulated", "--speed", "0", *flags]) == 0
    (folder,) = root.glob("practice/subject_*")
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / finished.name)


def recording(folder: Path) -> Path:
    return folder / f"{folder.name}_0.mcap"


def tear(folder: Path, share: float) -> None:
    """Leave a share of the recording, as a kill does."""
    path = recording(folder)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])


def recover(*paths: Path) -> int:
    return recover_command.recover.main(argparse.Namespace(paths=list(paths)))


def one_line(text: str) -> str:
    assert text.count("\n") == 1, text
    assert "Traceback" not in text
    return text


@contextmanager
def held(journal: Path) -> Iterator[None]:
    """An engine that goes on with the run."""
    engine = Journal()
    engine.reopen(journal)
    try:
        yield
    finally:
        engine.close()


def test_a_torn_bag_is_repaired_in_one_line_that_says_what_became_of_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tear(folder, 0.6)
    count = sum(1 for _ in read_bag(folder).messages())
    assert count > 0
    assert recover(folder) == 0
    line = one_line(capsys.readouterr().out)
    assert line.startswith(f"{folder}: {count} messages kept; cut: it is torn at byte ")
    assert f"the new file is {recording(folder)}, the old one is kept as" in line
    assert f"{folder.name}_0.mcap.torn; `madrob score {folder}` works" in line


def test_a_run_that_was_cut_off_in_its_middle_is_said_to_be_scorable(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / RESULT_FILE).unlink()
    tear(folder, 0.6)
    assert recover(folder) == 0
    assert one_line(capsys.readouterr().out).endswith(f"; `madrob score {folder}` works\n")
    assert len(list(score(folder))) == 1


def test_evidence_that_was_cut_off_is_repaired_and_what_is_hopeless_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (0, 1):
        file = add_evidence(folder, strings(["a", "b"]), number)
        file.write_bytes(file.read_bytes()[: -100 if number == 0 else 5])
    (before,) = score(folder)
    assert recover(folder) == 0
    line = one_line(capsys.readouterr().out)
    assert line.startswith(f"{folder}: whole, ")
    assert f"; evidence {folder.name}_evidence_0.mcap: 2 messages kept, cut: " in line
    assert "; evidence stays as it is: " in line
    assert f"{folder.name}_evidence_1.mcap is no evidence: " in line
    (after,) = score(folder)
    assert after.result == before.result
    assert main(["score", "--check", str(folder)]) == 0


def test_a_whole_bag_is_left_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert recover(folder, recording(folder)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ", 1)[0] for line in lines] == [str(folder), str(recording(folder))]
    for line in lines:
        assert line.endswith(" messages; nothing was written")
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_a_bag_whose_metadata_yaml_was_not_finished_gets_a_new_one(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "metadata.yaml").unlink()
    assert recover(folder) == 0
    line = one_line(capsys.readouterr().out)
    assert "whole, " in line
    assert "metadata.yaml was written anew; `madrob score" in line
    assert BAG_INFORMATION in (folder / "metadata.yaml").read_text()


@pytest.mark.parametrize("share", [0.3, 0.6, 0.97])
@pytest.mark.parametrize("journal", [True, False])
def test_the_result_after_the_repair_is_the_result_before_it(
    folder: Path, share: float, journal: bool
) -> None:
    tear(folder, share)
    if not journal:
        (folder / JOURNAL_FILE).unlink()
    (before,) = score(folder)
    assert recover(folder) == 0
    (after,) = score(folder)
    assert after.result == before.result
    assert any("is torn at byte" in remark for remark in after.result.quality.remarks)


def test_a_run_that_its_engine_still_holds_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tear(folder, 0.6)
    before = recording(folder).read_bytes()
    with held(folder / JOURNAL_FILE):
        assert recover(folder) == 2
        assert recover(recording(folder)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    for line in captured.err.splitlines():
        assert line.startswith(f"madrob: {folder}")
        assert "the engine still holds this run; end it" in line
    assert recording(folder).read_bytes() == before
    assert recover(folder) == 0


def test_a_bad_path_is_named_and_the_rest_is_repaired(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tear(folder, 0.6)
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"not a bag at all")
    assert recover(junk, tmp_path / "missing", folder) == 2
    captured = capsys.readouterr()
    errors = captured.err.splitlines()
    assert len(errors) == 2
    assert errors[0].startswith(f"madrob: {junk} is no bag: it does not begin like an MCAP file; ")
    assert errors[1].startswith(f"madrob: cannot repair {tmp_path / 'missing'}: No such file")
    assert "messages kept" in one_line(captured.out)


def test_a_bag_without_a_run_is_repaired_and_nothing_is_promised(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    with BagWriter(bag, [talk()], {}) as writer:
        for message in strings(["a", "b", "c"]):
            writer.put_message(message)
    tear(bag, 0.9)
    assert recover(bag) == 0
    line = one_line(capsys.readouterr().out)
    assert "3 messages kept" in line
    assert line.endswith("there is no run in it to be scored\n")


def test_a_name_cannot_steer_the_terminal(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "evil\x1b]0;owned\x07\nname"
    shutil.copytree(finished, folder)
    assert recover(folder, tmp_path / "\x1b[2Jmissing") == 2
    captured = capsys.readouterr()
    assert one_line(captured.out)[:-1].isprintable()
    assert one_line(captured.err)[:-1].isprintable()


def test_a_results_folder_is_repaired_run_by_run(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    whole, torn, lost = (
        Path(shutil.copytree(finished, results / place / finished.name.replace("_run_001", name)))
        for place, name in ((".", "_run_001"), ("practice", "_run_002"), (".", "_run_003"))
    )
    bags = {folder: folder / f"{finished.name}_0.mcap" for folder in (whole, torn, lost)}
    content = bags[torn].read_bytes()
    bags[torn].write_bytes(content[: len(content) // 2])
    bags[lost].write_bytes(b"")
    assert main(["recover", str(results)]) == 2
    told = capsys.readouterr()
    lines = told.out.splitlines()
    assert [line.partition(": ")[0] for line in lines] == [str(torn), str(whole)]
    assert "messages kept" in lines[0]
    assert lines[1].endswith("nothing was written")
    assert str(lost) in one_line(told.err)
    assert main(["score", str(torn)]) == 0


FRAMES = strings(["a picture", "another"])


def place(root: Path, source: Path, number: int) -> Path:
    """A run with evidence, the higher its number the later."""
    name = re.sub(r"_run_001_(\d{8})_\d{6}", rf"_run_{number:03d}_\1_{number:06d}", source.name)
    folder = shutil.copytree(source, root / name)
    path = folder / "result.json"
    document = json.loads(path.read_text())
    start = document["start"] + number
    path.write_text(json.dumps(document | {"run_number": number, "start": start, "run_id": ""}))
    without_digests(folder)
    add_evidence(folder, FRAMES)
    fd = os.open(folder, os.O_DIRECTORY)
    assert put_listing(fd) is not None
    os.close(fd)
    return folder


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four runs with evidence, the second one protested."""
    results = tmp_path / "results"
    for number in range(1, 5):
        place(results, appealed() if number == 2 else final(), number)
    return results


def tidy(root: Path, *flags: str) -> int:
    return main(["tidy", "--results", str(root), *flags])


def evidence(root: Path) -> list[str]:
    return sorted(path.name[:26][-7:] for path in root.glob("*/*_evidence_*"))


def answers(monkeypatch: pytest.MonkeyPatch, said: str) -> list[str]:
    """Somebody sits there and says the same to every question."""
    asked: list[str] = []
    monkeypatch.setattr(tidy_command, "somebody_there", lambda: True)

    def says_yes(question: str) -> bool:
        asked.append(question)
        return said == "y"

    monkeypatch.setattr(tidy_command, "says_yes", says_yes)
    return asked


def test_a_dry_run_says_what_goes_what_stays_and_why(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tidy(root, "--keep-runs", "0", "--dry-run") == 0
    *lines, total = capsys.readouterr().out.splitlines()
    ends = [re.split(r" {2,}", line, maxsplit=3)[3] for line in lines]
    assert ends == ["goes", "stays: it was protested", "goes", "stays: it is the last practice run"]
    assert total.startswith("evidence of 2 runs, ")
    assert len(evidence(root)) == 4


def test_room_that_cannot_be_made_is_told_in_the_last_line(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for flag in ("--dry-run", "--yes"):
        assert tidy(root, "--until-free", "900000GB", flag) == 0
        line = capsys.readouterr().out.splitlines()[-1]
        assert re.fullmatch(r"--until-free 900 TB is not reached: \d+ TB are lacking", line)
    assert tidy(root, "--until-free", "1MB", "--dry-run") == 0
    assert "--until-free" not in capsys.readouterr().out


def test_it_asks_and_no_means_no(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = answers(monkeypatch, "n")
    assert tidy(root, "--keep-runs", "0") == tidy_command.NOT_REMOVED
    assert asked == ["Remove the evidence of 2 runs for good? [y/N] "]
    assert capsys.readouterr().out.endswith("nothing was removed\n")
    assert len(evidence(root)) == 4
    answers(monkeypatch, "y")
    assert tidy(root, "--keep-runs", "0") == 0
    assert len(evidence(root)) == 2
    assert "of evidence of 2 of 2 runs; " in capsys.readouterr().out


def test_without_anybody_to_ask_it_wants_to_be_told_so(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tidy(root, "--keep-runs", "0") == 2
    assert capsys.readouterr().err == (
        "madrob: nobody is there to be asked: --yes removes without asking\n"
    )
    assert len(evidence(root)) == 4
    assert tidy(root, "--keep-runs", "0", "--yes") == 0
    assert len(evidence(root)) == 2


def test_the_report_says_that_evidence_was_removed(root: Path) -> None:
    report = next(root.glob("*_run_001_*")) / REPORT_FILE
    report.write_text("<html>")
    assert tidy(root, "--keep-runs", "0", "--yes") == 0
    page = report.read_text()
    assert "Evidence removed" in page
    assert "removed by tidy on" in readme_of(root, "--subject", "3", "--practice")
    dossier = readme_of(root, "--run", report.parent.name, "--dossier")
    assert "evidence was removed by tidy on" in dossier
    assert re.search(r"on \d{4}-\d\d-\d\d [^<]*: 1 file, \d+\.\d MB", page)


def readme_of(root: Path, *what: str) -> str:
    target = root.parent / "exported.zip"
    assert main(["export", *what, "--results", str(root), "--output", str(target)]) == 0
    with ZipFile(target) as packed:
        return packed.read("README.txt").decode()


def test_nothing_goes_while_a_run_goes_on(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    going = next(root.glob("*_run_004_*"))
    (going / "result.json").unlink()
    with Hold(going / HOLD_FILE):
        assert tidy(root, "--keep-runs", "0", "--yes") == 2
        assert capsys.readouterr().err == f"madrob: {going.name}: this run goes on: tidy after it\n"
    assert len(evidence(root)) == 4


def test_a_run_that_refuses_is_named_and_the_rest_goes(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = next(root.glob("*_run_001_*/*_0.mcap"))
    recording.write_bytes(recording.read_bytes()[:-50])
    assert tidy(root, "--keep-runs", "0", "--yes") == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert "`madrob recover` repairs it" in said.err
    assert "of evidence of 1 of 2 runs; " in said.out
    assert len(evidence(root)) == 3


@pytest.mark.machine
def test_on_a_narrow_terminal_no_word_is_broken(root: Path, tmp_path: Path) -> None:
    (root / "practice").mkdir()
    *_, last = sorted(root.glob("subject_*"))
    last.rename(root / "practice" / last.name)
    line = ["tidy", "--results", str(root), "--keep-runs", "0", "--dry-run"]
    where = {"XDG_CONFIG_HOME": str(tmp_path / "config")}
    with Terminal([sys.executable, "-m", "madrob_console.cli", *line], env=where) as terminal:
        assert terminal.wait_exit() == 0
        told = terminal.output.decode().splitlines()
    assert "  stays: it was protested" in told
    assert "  stays: it is the last practice run" in told
    assert all(len(row) <= 80 for row in told[:-1])
