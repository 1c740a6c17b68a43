"""How long the page and the figures of a run take."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from madrob_console.archive.scored import score_opened
from madrob_console.cli import aside
from madrob_console.engine.process.reporting import Papers
from tests.benchmarks.bags import copies, simulated_run
from tests.benchmarks.programs import MADROB, in_turns
from tests.benchmarks.report import Figure, Goal

PACKAGES = ("matplotlib",)

PAGE = Goal(1.5)  # s
MANY = 6


def reports(repeats: int) -> list[Figure]:
    """The page that an engine has made by itself; `madrob report`, from its launch to its end."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
        run = simulated_run(Path(folder))
        by_itself = [_by_itself(run) for _ in range(repeats)]
        runs = map(str, copies(run, MANY))
        programs = {
            "one": (*MADROB, "report", str(run)),
            "many": (*MADROB, "report", *runs),
            "figures": (*MADROB, "report", "--figures", "svg", str(run)),
        }
        took = in_turns(programs, repeats)
    more = [(many - one) / (MANY - 1) for many, one in zip(took["many"], took["one"], strict=True)]
    return [
        Figure("report.html after a result, beside the engine", "s", by_itself, PAGE),
        Figure("`madrob report` of a run of 20 s, cold", "s", took["one"], PAGE),
        Figure("`madrob report` of each more", "s", more, PAGE),
        Figure("the figures alone as svg, cold", "s", took["figures"], PAGE),
    ]


def _by_itself(run: Path) -> float:
    """From the result to the page; the process is of low priority, the engine does not wait."""
    scored = score_opened(run)
    papers = Papers(aside.COMMAND, lambda: False)
    began = time.perf_counter()
    papers.report(run, scored)
    assert papers.wait(60.0)
    took = time.perf_counter() - began
    assert papers.problem is None
    papers.close()
    return took


BENCHMARKS = (reports,)
