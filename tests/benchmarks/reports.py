"""How long the page and the figures of a run take, beside plain figures of matplotlib."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks.bags import copies, simulated_run
from tests.benchmarks.programs import MADROB, in_turns
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.madrob_console.engine.reporting import reporting_on

PACKAGES = ("matplotlib",)

PAGE = Goal(times=3.4)
MANY = 6
BARE = (sys.executable, "-m", "tests.benchmarks.bare_figures")


def reports(repeats: int) -> list[Figure]:
    """The page that an engine has made by itself; `madrob report`, from its launch to its end."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
        run = simulated_run(Path(folder))
        runs = map(str, copies(run, MANY))
        programs = {
            "one": (*MADROB, "report", str(run)),
            "many": (*MADROB, "report", *runs),
            "figures": (*MADROB, "report", "--figures", "svg", str(run)),
            "bare": (*BARE, "1"),
            "bare many": (*BARE, str(MANY)),
        }
        took = in_turns(programs, repeats)
        by_itself = [_by_itself(run) for _ in range(repeats)]
    page = Baseline("bare figures", took["bare"])
    more = _each_more(took["many"], took["one"])
    beside = Baseline("bare figures of each more", _each_more(took["bare many"], took["bare"]))
    return [
        Figure("report.html after a result, beside the engine", "s", by_itself, PAGE, page),
        Figure("`madrob report` of a run of 20 s, cold", "s", took["one"], PAGE, page),
        Figure("`madrob report` of each more", "s", more, PAGE, beside),
        Figure("the figures alone as svg, cold", "s", took["figures"], PAGE, page),
    ]


def _each_more(many: Sequence[float], one: Sequence[float]) -> list[float]:
    return [(all_ - first) / (MANY - 1) for all_, first in zip(many, one, strict=True)]


def _by_itself(run: Path) -> float:
    """From the result to the page; the process is of low priority, the engine does not wait."""
    with reporting_on(run.parent) as reporting:
        began = time.perf_counter()
        reporting.report(run)
        assert reporting.wait(60.0)
        took = time.perf_counter() - began
        assert reporting.problem is None
    return took


BENCHMARKS = (reports,)
