"""How long the page and the figures of a run take; the engine has them made by another process."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.benchmarks.bags import copies, simulated_run
from tests.benchmarks.programs import MADROB, in_turns
from tests.benchmarks.report import Figure, Goal

PACKAGES = ("matplotlib",)

PAGE = Goal(1.5)  # s
MANY = 6


def reports(repeats: int) -> list[Figure]:
    """`madrob report` of one run, from its launch to its end."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
        run = simulated_run(Path(folder))
        runs = map(str, copies(run, MANY))
        programs = {
            "one": (*MADROB, "report", str(run)),
            "many": (*MADROB, "report", *runs),
            "figures": (*MADROB, "report", "--figures", "svg", str(run)),
        }
        took = in_turns(programs, repeats)
    more = [(many - one) / (MANY - 1) for many, one in zip(took["many"], took["one"], strict=True)]
    return [
        Figure("report.html of a run of 20 s, cold", "s", took["one"], PAGE),
        Figure("report.html of each more", "s", more, PAGE),
        Figure("the figures alone as svg, cold", "s", took["figures"], PAGE),
    ]


BENCHMARKS = (reports,)
