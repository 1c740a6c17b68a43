"""Programs run from their launch to their end."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
MADROB = (sys.executable, "-m", "madrob_console.cli.main")


def duration_of(argv: Sequence[str]) -> float:
    """How long a program runs, s."""
    began = time.perf_counter()
    subprocess.run(argv, cwd=ROOT, capture_output=True, check=True)
    return time.perf_counter() - began
