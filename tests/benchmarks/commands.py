"""How long a command of a shell makes people wait, beside what Python itself takes."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.benchmarks.bags import simulated_run
from tests.benchmarks.programs import MADROB, in_turns
from tests.benchmarks.report import Baseline, Figure, Goal

PACKAGES = ("numpy", "pandas", "scipy", "msgspec")

PLAIN = (sys.executable, "-c", "pass")
LIBRARIES = (sys.executable, "-c", "import numpy, pandas, scipy.signal")
ABOVE_PLAIN = Goal(0.25)  # s
SCORE = Goal(times=1.3)


def helps(repeats: int) -> list[Figure]:
    """What `--help` takes above Python's own start."""
    commands = {"madrob --help": ("--help",), "madrob score --help": ("score", "--help")}
    took = in_turns(
        {"": PLAIN} | {name: (*MADROB, *words) for name, words in commands.items()}, repeats
    )
    beside = Baseline("python -c pass", took[""])
    return [
        Figure(
            f"{name}, above python -c pass",
            "s",
            [ours - plain for ours, plain in zip(took[name], took[""], strict=True)],
            ABOVE_PLAIN,
        )
        for name in commands
    ] + [Figure("python -c pass", "s", beside.values)]


def cold_score(repeats: int) -> list[Figure]:
    """`madrob score` of one run, from its launch to its end."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
        run = simulated_run(Path(folder))
        took = in_turns({"ours": (*MADROB, "score", str(run)), "libraries": LIBRARIES}, repeats)
    beside = Baseline("import numpy, pandas, scipy.signal", took["libraries"])
    return [Figure("madrob score of a run of 20 s, cold", "s", took["ours"], SCORE, beside)]


BENCHMARKS = (helps, cold_score)
