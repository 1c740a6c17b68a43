"""The programs of the system that some tests need: `pytest.mark.needs("tmux")`.

Where one is absent, the test is skipped and says which package has it; with `CI=true` it fails.

    python -m tests.programs

prints each program and its package, a line each; it needs nothing but Python.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

PACKAGES: Mapping[str, str] = {
    "git": "git",
    "mkfs.ext4": "e2fsprogs",
    "ssh": "openssh-client",
    "ssh-keygen": "openssh-client",
    "sshd": "openssh-server",
    "systemd-analyze": "systemd",
    "tmux": "tmux",
}
"""Program, or file -> the Debian package that has it."""


def found(program: str) -> str | None:
    """Where a program lies: on PATH, or in the `sbin` beside a folder of it; None = nowhere."""
    if "/" in program:
        return shutil.which(program, mode=os.F_OK)
    folders = [Path(folder) for folder in os.get_exec_path()]
    beside = [folder.with_name("sbin") for folder in folders if folder.name]
    return shutil.which(program, path=os.pathsep.join(map(str, [*folders, *beside])))


def look_for(item: pytest.Item) -> None:
    """Skip a test, or fail it in CI, where a program that it is marked to need is absent."""
    import pytest

    absent = {
        program: PACKAGES[program]
        for mark in item.iter_markers("needs")
        for program in mark.args
        if found(program) is None
    }
    if absent:
        packages = " ".join(sorted(set(absent.values())))
        why = f"needs {', '.join(absent)}: apt install {packages}"
        if os.environ.get("CI") == "true":
            pytest.fail(why, pytrace=False)
        pytest.skip(why)


if __name__ == "__main__":
    for program, package in PACKAGES.items():
        print(program, package)
