"""Programs run from their launch to their end, beside each other and in turns."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence

from tests.benchmarks.wire import ROOT

MADROB = (sys.executable, "-m", "madrob_console.cli.main")


def run_time(argv: Sequence[str], env: Mapping[str, str] | None = None) -> float:
    """How long a program runs, s.

    Raises:
        AssertionError: it fails.
    """
    began = time.perf_counter()
    done = subprocess.run(
        argv,
        cwd=ROOT,
        env={**os.environ, **(env or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    took = time.perf_counter() - began
    if done.returncode:
        raise AssertionError(f"{' '.join(argv)} ended with {done.returncode}: {done.stderr[-300:]}")
    return took


def in_turns(programs: Mapping[str, Sequence[str]], repeats: int) -> dict[str, list[float]]:
    """How long each of several programs runs, s; what else the machine does hits all of them."""
    for argv in programs.values():
        run_time(argv)  # once before: files are in memory and compiled
    took: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, argv in programs.items():
            took[name].append(run_time(argv))
    return took
