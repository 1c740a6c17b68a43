"""How long a command of a shell makes people wait, beside what its imports take."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks.bags import simulated_run
from tests.benchmarks.programs import MADROB, in_turns
from tests.benchmarks.report import Baseline, Figure, Goal

PACKAGES = ("numpy", "pandas", "scipy", "msgspec")

LIBRARIES = (sys.executable, "-c", "import numpy, pandas, scipy.signal")
STANDARD = (sys.executable, "-c", "import argparse, dataclasses, pathlib, typing")
HELP = Goal(times=4)
SCORE = Goal(times=1.3)


def helps(repeats: int) -> list[Figure]:
    """How long `--help` takes."""
    commands = {"madrob --help": ("--help",), "madrob score --help": ("score", "--help")}
    programs: dict[str, Sequence[str]] = {
        name: (*MADROB, *words) for name, words in commands.items()
    }
    took = in_turns({"": STANDARD, **programs}, repeats)
    beside = Baseline("import argparse, dataclasses, ...", took[""])
    return [Figure(name, "s", took[name], HELP, beside) for name in commands]


def cold_score(repeats: int) -> list[Figure]:
    """`madrob score` of one run, from its launch to its end."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
        run = simulated_run(Path(folder))
        took = in_turns({"ours": (*MADROB, "score", str(run)), "libraries": LIBRARIES}, repeats)
    beside = Baseline("import numpy, pandas, scipy.signal", took["libraries"])
    return [Figure("madrob score of a run of 20 s, cold", "s", took["ours"], SCORE, beside)]


BENCHMARKS = (helps, cold_score)
