"""How long a score is waited for: at the end of a run, of one bag, of an archive."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

from madrob_console.engine.core import HURRIED_STEP
from madrob_console.engine.scoring_process import ScoringProcess
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.writer import RecorderState
from scoring.kinematics import load_filters
from scoring.protocol import POST_ROLL
from tests.benchmarks import csv_scorer
from tests.benchmarks.bags import copies, long_bag, simulated_run
from tests.benchmarks.programs import MADROB, run_time
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.wire import ROOT, cpu_time
from tests.madrob_console.engine.drive import STEP, Drive, make_setup

PACKAGES = ("mcap", "rosbags", "numpy", "pandas", "scipy")

JOBS = 2
ARCHIVE = 200
"""Runs."""
MOST = 2
"""Repeats of it."""
LENGTHS = {20.0: 5, 120.0: 3, 600.0: 2}
"""Lengths of runs, s, and how often each is played at most."""
RESULT = Goal(times=25)
WAITING = 10_000
"""Samples that may wait for the scoring process while a run is played faster than it was."""
QUIET = 0.1
"""A process that used nothing for so long has no work, s."""
BAGS = {
    "20 s": (20.0, 1, 5, 0.28),
    "2 min": (120.0, 1, 3, 0.4),
    "10 min": (600.0, 1, 2, 0.4),
    "1 h": (3600.0, 1, 1, 0.4),
    "10 min at 10x the rates": (600.0, 10, 1, 0.4),
}
"""Length, s; so many times the rates; how often it is scored at most; how soon."""
MEMORY = Goal(times=3.8)


def after_the_run(repeats: int) -> Iterator[Figure]:
    """From the end of the post-roll to the result on disk: bag closed, scored, written.

    As an engine of screens has it, by the process that followed the run, and as `madrob run` has
    it, by itself.
    """
    load_filters()  # as an engine does in its first second
    for length, most in LENGTHS.items():
        beside_engine: list[float] = []
        inline: list[float] = []
        bare: list[float] = []
        for _ in range(min(repeats, most)):
            with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
                with closing(ScoringProcess()) as scorer:
                    beside_engine.append(_finish(Path(folder, "beside"), length, scorer)[0])
                took, run = _finish(Path(folder, "inline"), length)
                inline.append(took)
                bare += [_from_csv(run) for _ in range(3)][1:]
        beside = Baseline("from ready-made csv files", bare)
        yield Figure(f"result of a run of {length:g} s", "s", beside_engine, RESULT, beside)
        yield Figure(f"the same in `madrob run`, {length:g} s", "s", inline, RESULT, beside)


def _finish(
    results: Path, length: float, scorer: ScoringProcess | None = None
) -> tuple[float, Path]:
    """Seconds, and the run's folder."""
    drive = Drive(results, Scenario.NO_CLOSE, scorer=scorer)
    engine = drive.engine
    engine.warm()
    drive.start(make_setup(timeout=length))
    while engine.run.phase is not Phase.STOPPED:
        engine.step(STEP)
        if scorer is not None:
            _give_time(scorer, most=WAITING)
    drive.wait(POST_ROLL - 2 * STEP)
    assert engine.snapshot().recorder.state == RecorderState.RECORDING
    if scorer is not None:
        _give_time(scorer)
    while engine.snapshot().recorder.state == RecorderState.RECORDING:
        began = time.perf_counter()
        engine.step(STEP)
    while engine.scored is None:
        time.sleep(HURRIED_STEP)  # an engine waits for messages
        engine.step(0.0)
    took = time.perf_counter() - began
    engine.close()
    assert engine.folder is not None
    return took, engine.folder


def _give_time(scorer: ScoringProcess, most: int = 0) -> None:
    """Wait until it has followed the run so far, as it does where a run takes its time.

    Args:
        scorer: of the run.
        most: samples that may wait for it; 0 = and it has looked at all others.
    """
    while len(scorer._questions) > most:
        time.sleep(HURRIED_STEP)
    assert scorer.pid is not None
    used = -1.0
    while most == 0 and used != (used := cpu_time(scorer.pid)):
        time.sleep(QUIET)


def _from_csv(run: Path) -> float:
    began = time.perf_counter()
    csv_scorer.values(run)
    return time.perf_counter() - began


def one_bag(repeats: int) -> Iterator[Figure]:
    """How many times as fast as it was a run is scored from its bag, beside its mere reading."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as name:
        run = simulated_run(Path(name, "run"))
        for text, (length, density, most, times) in BAGS.items():
            bag = long_bag(run, Path(name, text), length, density)
            (file,) = bag.glob("*.mcap")
            scored, read = [], []
            for _ in range(min(repeats, most)):
                scored.append(_measured(_SCORE_ONE, run, bag))
                read.append(_measured(_READ_ONE, file))
            shutil.rmtree(bag.parent)
            speeds = [[length / took for took, _ in each] for each in (scored, read)]
            beside = Baseline("mcap's reader alone", speeds[1])
            yield Figure(
                f"a bag of {text}: speed",
                "x real time",
                speeds[0],
                Goal(times, at_least=True),
                beside,
            )
            memory = [[megabytes for _, megabytes in each] for each in (scored, read)]
            beside = Baseline("the libraries alone", memory[1])
            yield Figure(f"a bag of {text}: peak memory", "MB", memory[0], MEMORY, beside)


_SCORE_ONE = """
import resource, sys, time
from pathlib import Path
from madrob_console.archive.scored import score_recording
from recorder.writer import RecorderState
from scoring.kinematics import load_filters
from scoring.protocol import POST_ROLL
load_filters()
score_recording(Path(sys.argv[1]))
began = time.perf_counter()
score_recording(Path(sys.argv[2]))
took = time.perf_counter() - began
print(took, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000)
"""
_READ_ONE = """
import resource, sys, time
import numpy, pandas, scipy.signal
from mcap.reader import make_reader
libraries = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
began = time.perf_counter()
with open(sys.argv[1], "rb") as file:
    for message in make_reader(file).iter_messages(log_time_order=False):
        pass
print(time.perf_counter() - began, libraries)
"""


def _measured(program: str, *paths: Path) -> tuple[float, float]:
    """Seconds and megabytes, as a program for a process of its own tells them."""
    argv = [sys.executable, "-c", program, *map(str, paths)]
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
        for _ in range(min(repeats, MOST)):
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
