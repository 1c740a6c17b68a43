"""Which software it is: the release, and in a git checkout the commit."""

from __future__ import annotations

from functools import cache
from pathlib import Path

RELEASE = "0.2.0"
"""Set by hand, read by the build too; its changes stand in CHANGELOG.md."""

DISTRIBUTION = "madrob-console"

_ROOT = Path(__file__).parents[2]


@cache
def software_version() -> str:
    """The version of the running code, in the format of PEP 440.

    `0.2.0` as installed, `0.2.0+1557f39128` in a checkout, with `.dirty` if its files are changed.
    """
    if not (_ROOT / ".git").exists():
        return RELEASE
    import subprocess

    command = ("git", "describe", "--always", "--exclude=*", "--abbrev=10", "--dirty=.dirty")
    try:
        described = subprocess.run(
            command, cwd=_ROOT, capture_output=True, text=True, check=True, timeout=5.0
        )
    except (OSError, subprocess.SubprocessError):
        return RELEASE  # no git, or one that refuses the checkout
    return f"{RELEASE}+{described.stdout.strip()}"
