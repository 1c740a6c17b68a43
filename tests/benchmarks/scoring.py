"""How long a bag is scored, with and without known layouts of messages; and many runs at once."""

from __future__ import annotations

import subprocess
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from madrob_console.archive.scored import score_recording
from madrob_console.messages import codec
from madrob_console.testbeds.simulated import Scenario
from scoring.kinematics import load_filters
from tests.benchmarks.commands import MADROB, ROOT
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import completed, copy_run

RUNS = 24
CORES = {1: 3.5, 2: 3.5}
"""Processes at once, and the goal."""
MOST = 3
_PUBLISHED = ("*_event.csv", "*_wrench.csv", "*_jointState.csv", "condition_*.yaml")


def layouts(repeats: int) -> list[Figure]:
    """The same run, its messages read by their layout and decoded by the library."""
    load_filters()
    score_recording(completed())  # once before: files are in memory
    by_layout, by_library = [], []
    for _ in range(repeats):
        by_layout.append(_scored())
        with _library_alone():
            by_library.append(_scored())
    return [Figure("a run of 17 s scored", "s", by_layout, "decoded by rosbags", by_library, 0.6)]


def _scored() -> float:
    began = time.process_time()
    score_recording(completed())
    return time.process_time() - began


@contextmanager
def _library_alone() -> Iterator[None]:
    with patch.object(codec, "Layout", side_effect=ValueError):
        yield


def batch(repeats: int) -> list[Figure]:
    """Bags scored with uncertainties, beside a process for the csv files of each run."""
    ours, others = defaultdict[int, list[float]](list), defaultdict[int, list[float]](list)
    with TemporaryDirectory() as folder:
        runs = Path(folder, "runs")
        for number in range(RUNS):
            copy_run(runs, 1 + number, Scenario.NOMINAL)
        files = [str(next(completed().glob(pattern))) for pattern in _PUBLISHED]
        for sample in range(1 + min(repeats, MOST)):
            for cores in CORES:
                many = _rate(RUNS, (*MADROB, "score", f"--jobs={cores}", str(runs)))
                each = _rate(
                    cores,
                    *(
                        (*MADROB, "eurobench", *files, f"{folder}/{number}")
                        for number in range(cores)
                    ),
                )
                if sample:
                    ours[cores].append(many)
                    others[cores].append(each)
    return [
        Figure(
            f"runs scored on {cores} core{'s' * (cores > 1)}",
            "1/s",
            ours[cores],
            "a process for each run",
            others[cores],
            goal,
            at_least=True,
        )
        for cores, goal in CORES.items()
    ]


def _rate(runs: int, *programs: tuple[str, ...]) -> float:
    """So many runs by programs that run at once, 1/s."""
    began = time.perf_counter()
    started = [
        subprocess.Popen(argv, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for argv in programs
    ]
    assert [process.wait() for process in started] == [0] * len(programs)
    return runs / (time.perf_counter() - began)
