"""`madrob recover` as people and scripts use it."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.cli.main import main as madrob
from madrob_console.cli.recover_command import main
from madrob_console.referee.journal import Journal
from recorder.bag import BAG_INFORMATION
from recorder.reader import read_bag
from recorder.writer import BagWriter
from tests.recorder.samples import add_evidence, strings, talk


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run."""
    root = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(root / "config"))
        flags = ["--subject", "3", "--countdown", "1", "--no-report", "--results", str(root)]
        assert madrob(["run", "--testbed", "simulated", "--speed", "0", *flags]) == 0
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
    return main(argparse.Namespace(paths=list(paths)))


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
    assert madrob(["score", "--check", str(folder)]) == 0


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
            writer.put(message)
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
    assert madrob(["recover", str(results)]) == 2
    told = capsys.readouterr()
    lines = told.out.splitlines()
    assert [line.partition(": ")[0] for line in lines] == [str(torn), str(whole)]
    assert "messages kept" in lines[0]
    assert lines[1].endswith("nothing was written")
    assert str(lost) in one_line(told.err)
    assert madrob(["score", str(torn)]) == 0


def test_a_folder_without_runs_is_named_with_what_to_give(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert madrob(["recover", str(tmp_path)]) == 2
    told = one_line(capsys.readouterr().err)
    assert str(tmp_path) in told
    assert "choose a rosbag2 bag folder or an .mcap file" in told
