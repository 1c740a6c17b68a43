"""What another user of the machine can do: a program that is `nobody` once it has begun."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

NOBODY = 65534

_BECOME = f"""
import os
os.setgroups([])
os.setresgid({NOBODY}, {NOBODY}, {NOBODY})
os.setresuid({NOBODY}, {NOBODY}, {NOBODY})
"""


@contextmanager
def stranger(
    program: str, *arguments: object, imports: str = ""
) -> Iterator[subprocess.Popen[str]]:
    """A Python program of another user while inside; `imports` run before it is one."""
    if os.getuid() != 0:
        pytest.skip("only root can be another user")
    with subprocess.Popen(
        [sys.executable, "-c", imports + _BECOME + program, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def said_by_stranger(program: str, *arguments: object, imports: str = "") -> str:
    with stranger(program, *arguments, imports=imports) as process:
        return process.communicate(timeout=60.0)[0].strip()


@contextmanager
def open_folder() -> Iterator[Path]:
    """A folder that every user can reach and write, while inside."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as name:
        folder = Path(name)
        folder.chmod(0o777)
        yield folder
