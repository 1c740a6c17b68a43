"""Programs run from their launch to their end, in turns, so that a busy machine hits all alike."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.benchmarks.report import Figure

ROOT = Path(__file__).parents[2]
MADROB = (sys.executable, "-m", "madrob_console.cli.main")
ARGPARSE = (sys.executable, "-c", "import argparse, dataclasses, pathlib, typing")


def in_turns(
    programs: Mapping[str, Sequence[str]], repeats: int, warm_up: int = 1
) -> dict[str, list[float]]:
    """How long each of several programs runs, s."""
    took: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(warm_up + repeats):
        for name, argv in programs.items():
            began = time.perf_counter()
            subprocess.run(argv, cwd=ROOT, capture_output=True, check=True)
            took[name].append(time.perf_counter() - began)
    # the first time files come into memory and are compiled
    return {name: times[warm_up:] for name, times in took.items()}


def help_text(repeats: int) -> list[Figure]:
    """How long `--help` takes, beside what argparse takes to start."""
    programs: dict[str, Sequence[str]] = {
        "madrob --help": (*MADROB, "--help"),
        "madrob score --help": (*MADROB, "score", "--help"),
    }
    took = in_turns({"argparse": ARGPARSE, **programs}, repeats)
    return [Figure(name, "s", took[name], "argparse", took["argparse"], 2.8) for name in programs]
