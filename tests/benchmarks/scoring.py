"""How long a score is waited for: at the end of a run, of one bag, of an archive."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from scoring.kinematics import load_filters
from tests.benchmarks.bags import copies, long_bag, simulated_run
from tests.benchmarks.programs import MADROB, run_time
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.wire import ROOT
from tests.madrob_console.engine.drive import STEP, Drive, make_setup

PACKAGES = ("mcap", "rosbags", "numpy", "pandas", "scipy", "joblib")

JOBS = 2
ARCHIVE = 200
"""Runs."""
LENGTHS = 20.0, 120.0, 600.0
RESULT = Goal(0.10)  # s
REAL_TIME = Goal(300, at_least=True)
BAGS = {"20 s": (20.0, 1), "2 min": (120.0, 1), "10 min": (600.0, 1), "1 h": (3600.0, 1)}
DENSE = "1 h at 10x the rates", 3600.0, 10
MEMORY = Goal(600)  # MB


def after_the_run(repeats: int) -> list[Figure]:
    """From the end of the post-roll to the result on disk: bag closed, scored, written."""
    load_filters()  # as an engine does in its first second
    took: dict[float, list[float]] = {length: [] for length in LENGTHS}
    for length in LENGTHS:
        for _ in range(repeats if length < LENGTHS[-1] else min(repeats, 3)):
            with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
                took[length].append(_finish(Path(folder), length))
    first, second, third = LENGTHS
    growth = Goal(times=third / second)
    return [
        Figure(f"result of a run of {first:g} s", "s", took[first]),
        Figure(f"result of a run of {second:g} s", "s", took[second], RESULT),
        Figure(
            f"result of a run of {third:g} s",
            "s",
            took[third],
            growth,
            Baseline(f"of {second:g} s", took[second]),
        ),
    ]


def _finish(results: Path, length: float) -> float:
    drive = Drive(results, Scenario.NO_CLOSE)
    drive.start(make_setup(timeout=length))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED, patience=2 * length + 60)
    while True:
        began = time.perf_counter()
        drive.engine.step(STEP)
        took = time.perf_counter() - began
        if drive.engine.scored is not None:
            drive.engine.close()
            return took


def one_bag(repeats: int) -> list[Figure]:
    """How many times as fast as it was a run is scored from its bag."""
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory(prefix="madrob-") as name:
        run = simulated_run(Path(name, "run"))
        for text, (length, density) in BAGS.items():
            bag = long_bag(run, Path(name, text), length, density)
            few = repeats if length < 3600 else 1
            measured = [_measured(run, bag) for _ in range(few)]
            speeds = [length / took for took, _ in measured]
            figures.append(Figure(f"a bag of {text}: speed", "x real time", speeds, REAL_TIME))
            memory = [megabytes for _, megabytes in measured]
            figures.append(Figure(f"a bag of {text}: peak memory", "MB", memory, MEMORY))
            shutil.rmtree(bag.parent)
        text, length, density = DENSE
        took, megabytes = _measured(run, long_bag(run, Path(name, "dense"), length, density))
        figures.append(Figure(f"a bag of {text}: speed", "x real time", [length / took]))
        figures.append(Figure(f"a bag of {text}: peak memory", "MB", [megabytes], MEMORY))
    return figures


_SCORE_ONE = """
import resource, sys, time
from pathlib import Path
from madrob_console.archive.scored import score_recording
from scoring.kinematics import load_filters
load_filters()
score_recording(Path(sys.argv[1]))
began = time.perf_counter()
score_recording(Path(sys.argv[2]))
took = time.perf_counter() - began
print(took, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000)
"""


def _measured(first: Path, bag: Path) -> tuple[float, float]:
    """Seconds and megabytes for one bag, of a process that has scored another one before."""
    argv = [sys.executable, "-c", _SCORE_ONE, str(first), str(bag)]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=True)
    took, megabytes = done.stdout.split()
    return float(took), float(megabytes)


def archive(repeats: int) -> list[Figure]:
    """200 runs from their bags, beside a process for each run's ready-made csv files."""
    ours: list[float] = []
    beside: list[float] = []
    with tempfile.TemporaryDirectory(prefix="madrob-") as name:
        results = Path(name)
        first = simulated_run(results)
        folders = copies(first, ARCHIVE)
        for _ in range(repeats):
            score = (*MADROB, "score", "--json", "--jobs", str(JOBS), name)
            ours.append(ARCHIVE / run_time(score))
            few = folders[:: ARCHIVE // 20]
            beside.append(len(few) / _all(few, _csv_process))
    baseline = Baseline("a process for each run's csv files", beside)
    goal = Goal(times=10, at_least=True)
    return [Figure(f"runs scored from {ARCHIVE} bags, {JOBS} jobs", "1/s", ours, goal, baseline)]


def _all(folders: Sequence[Path], work: Callable[[Path], object]) -> float:
    began = time.perf_counter()
    with ThreadPoolExecutor(JOBS) as pool:
        list(pool.map(work, folders))
    return time.perf_counter() - began


def _csv_process(folder: Path) -> None:
    run_time((sys.executable, "-m", "tests.benchmarks.csv_scorer", str(folder)))


BENCHMARKS = (after_the_run, one_bag, archive)
