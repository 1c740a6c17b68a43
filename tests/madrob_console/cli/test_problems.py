"""How commands say what is wrong with many things, and with where they write."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from madrob_console.cli.main import main

BROKEN = 60


def test_equal_problems_of_many_runs_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(1, BROKEN + 1):
        (tmp_path / f"subject_001_cond_001_run_{number:03d}_20260321_1000{number % 60:02d}").mkdir()
    assert main(["score", "--jobs", "1", str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4
    assert all("run_00" in line for line in lines[:3])
    assert lines[3].startswith("madrob: and 57 more like it: ")
    assert "subject" not in lines[3]


def test_problems_that_differ_are_all_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("no bag")
    assert main(["score", str(tmp_path / "none"), str(tmp_path / "notes.txt")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


@pytest.mark.machine
@pytest.mark.parametrize("command", ["settings", "schema", "--help"])
def test_a_full_disk_behind_the_output_is_one_line(command: str) -> None:
    with Path("/dev/full").open("w") as full:
        ran = subprocess.run(
            [sys.executable, "-m", "madrob_console.cli", command],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert ran.returncode == 2
    assert ran.stderr.count("\n") == 1
    assert "the output cannot be written (No space left on device)" in ran.stderr
