"""What needs a program of the system says so, and is never skipped in silence."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import programs

ROOT = Path(__file__).parents[1]
MARKED = "tests/madrob_console/cli/test_processes.py::test_tab_starts_no_program"


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder of PATH."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


def put(folder: Path, program: str) -> str:
    folder.mkdir(exist_ok=True)
    file = folder / program
    file.touch(mode=0o755)
    return str(file)


def test_a_program_is_found_on_path_and_in_the_sbin_beside_it_and_nowhere_else(path: Path) -> None:
    assert programs.found("sshd") is None
    beside = put(path.with_name("sbin"), "sshd")
    assert programs.found("sshd") == beside
    first = put(path, "sshd")
    assert programs.found("sshd") == first


def test_what_is_no_program_is_found_where_it_lies(tmp_path: Path) -> None:
    header = tmp_path / "stdio.h"
    assert programs.found(str(header)) is None
    header.touch()
    assert programs.found(str(header)) == str(header)


@pytest.mark.machine
@pytest.mark.parametrize(("ci", "ends", "told"), [("", 0, "SKIPPED [1] "), ("true", 1, "ERROR ")])
def test_a_test_whose_program_is_absent_names_its_package_and_fails_in_ci(
    path: Path, ci: str, ends: int, told: str
) -> None:
    command = [sys.executable, "-m", "pytest", "-n", "0", f"{MARKED}[zsh]"]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"CI": ci}, capture_output=True, text=True, check=False
    )
    assert done.returncode == ends, done.stdout
    (line,) = (line for line in done.stdout.splitlines() if line.startswith(told))
    assert line.endswith("needs zsh: apt install zsh")


def test_the_readme_says_of_every_package_what_it_adds() -> None:
    paper = (ROOT / "README.md").read_text()
    assert [one for one in programs.PACKAGES.values() if f"`{one}`" not in paper] == []
