"""How long the page and the figures of a run take; the engine has them made by another process."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.benchmarks.bags import simulated_run
from tests.benchmarks.programs import MADROB, in_turns
from tests.benchmarks.report import Figure, Goal

PACKAGES = ("matplotlib",)

PAGE = Goal(1.5)  # s


def reports(repeats: int) -> list[Figure]:
    """`madrob report` of one run, from its launch to its end."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
        run = str(simulated_run(Path(folder)))
        programs = {
            "report.html of a run of 20 s": (*MADROB, "report", run),
            "its figures alone, as svg": (*MADROB, "report", "--figures", "svg", run),
        }
        took = in_turns(programs, repeats)
    return [Figure(name, "s", values, PAGE) for name, values in took.items()]


BENCHMARKS = (reports,)
