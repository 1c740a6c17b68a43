"""`madrob tidy` as people and scripts use it."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.cli import tidy_command
from madrob_console.cli.main import main
from madrob_console.files.held import Hold
from madrob_console.referee.journal import HOLD_FILE
from recorder.listing import put_listing
from tests.madrob_console.recorded_runs import appealed, final, without_digests
from tests.recorder.samples import add_evidence, strings
from tests.terminal import Terminal

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
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
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
        assert re.fullmatch(r"--until-free 900.0 TB is not reached: \d+.\d TB are lacking", line)
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
    assert "removed by tidy on" in readme_of(root, "--team", "3", "--practice")
    dossier = readme_of(root, "--run", report.parent.name, "--dossier")
    assert "the evidence was removed by tidy on" in dossier
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


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ((), "say what stays: --keep-runs, --older-than or --until-free"),
        (("--keep-runs", "-1"), "--keep-runs: -1: use 0 or more"),
        (("--older-than", "7"), "'7' is no time, as 12h, 7d or 2w are"),
        (("--older-than", "7y"), "'7y' is no time, as 12h, 7d or 2w are"),
        (("--until-free", "50"), "'50' is no size, as 50GB or 500MB are"),
        (("--until-free", "9" * 400 + "GB"), "is no size, as 50GB or 500MB are"),
    ],
)
def test_what_cannot_be_used_is_named(
    root: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], words: str
) -> None:
    try:
        code = tidy(root, *flags)
    except SystemExit as error:
        code = int(str(error.code))
    assert code == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert len(evidence(root)) == 4


def test_a_folder_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tidy(tmp_path / "no", "--older-than", "7d") == 2
    assert "no such results folder; name one with --results" in capsys.readouterr().err


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
