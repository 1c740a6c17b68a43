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


@pytest.mark.machine
@pytest.mark.parametrize(("ci", "ends", "told"), [("", 0, "SKIPPED [1] "), ("true", 1, "ERROR ")])
def test_a_test_whose_program_is_absent_names_its_package_and_fails_in_ci(
    tmp_path: Path, ci: str, ends: int, told: str
) -> None:
    command = [sys.executable, "-m", "pytest", "-n", "0", f"{MARKED}[zsh]"]
    env = os.environ | {"CI": ci, "PATH": str(tmp_path)}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == ends, done.stdout
    (line,) = (line for line in done.stdout.splitlines() if line.startswith(told))
    assert line.endswith("needs zsh: apt install zsh")


def test_the_readme_says_of_every_package_what_it_adds() -> None:
    paper = (ROOT / "README.md").read_text()
    assert [one for one in programs.PACKAGES.values() if f"`{one}`" not in paper] == []
