"""`python -m madrob_console.aside ...`: a `madrob` command that gives way to everything else."""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

NICENESS = 10
"""Added to the niceness of who starts it: the engine, a run, a screen come first."""


def main() -> int:
    """Run `madrob` with low priority; a TERM leaves no half file behind."""
    signal.signal(signal.SIGTERM, _end)
    os.nice(NICENESS)
    from madrob_console.cli import main as madrob

    return madrob()


def _end(number: int, _frame: object) -> NoReturn:
    sys.exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
