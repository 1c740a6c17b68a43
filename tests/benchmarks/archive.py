"""How long runs on disk are worked on: one is scored, many are listed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader

from madrob_console.archive.history import History
from madrob_console.archive.scored import score_recording
from scoring.kinematics import load_filters
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write

RUNS = 1_000


def run_scored(repeats: int) -> list[Figure]:
    """A recorded run, beside a reader that hands out its messages."""
    load_filters()
    (path,) = completed().glob("*_0.mcap")

    def read() -> None:
        with path.open("rb") as file:
            list(make_reader(file).iter_messages())

    ours, bare = in_pairs(lambda: score_recording(completed()), read, repeats)
    return [Figure("a run of 17 s scored", "ms", ours, "reader of mcap", bare, 3.5)]


def lists(repeats: int) -> list[Figure]:
    """All runs of a results folder, as history and standings list them."""
    with TemporaryDirectory() as folder:
        root = Path(folder)
        paths = [_written(root, number) for number in range(RUNS)]
        ours, bare = in_pairs(
            lambda: History(root).refresh(),
            lambda: [json.loads(path.read_bytes()) for path in paths],
            repeats,
        )
    return [Figure(f"a list of {RUNS:,} runs", "ms", ours, "json.loads", bare, 4.8)]


def _written(root: Path, number: int) -> Path:
    run = summary(1 + number // 40, 1 + number % 20, 1 + number % 40 // 20, hour=number / 60)
    return write(root, run)


def in_pairs(
    ours: Callable[[], object], other: Callable[[], object], repeats: int
) -> tuple[list[float], list[float]]:
    """Processor time of two ways, in turns, after once each, ms."""
    took: tuple[list[float], list[float]] = ([], [])
    for _ in range(1 + repeats):
        for work, times in zip((ours, other), took, strict=True):
            began = time.process_time()
            work()
            times.append(1000 * (time.process_time() - began))
    return took[0][1:], took[1][1:]
