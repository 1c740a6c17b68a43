"""How long runs on disk are read: a bag, and the list of a results folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader

from madrob_console.archive.history import History
from recorder.reader import Bag
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write

SIZES = (1_000, 10_000)
MOST = 3


def bag(repeats: int) -> list[Figure]:
    """The messages of a run, each as bytes with its times."""
    (path,) = completed().glob("*_0.mcap")

    def library() -> int:
        with path.open("rb") as file:
            return len(list(make_reader(file).iter_messages()))

    ours, bare = in_pairs(lambda: len(list(Bag(path).messages())), library, repeats)
    return [Figure("a bag of 17 s read", "ms", ours, "reader of mcap", bare, 0.4)]


def lists(repeats: int) -> list[Figure]:
    """All runs of a results folder, as history and standings list them."""
    figures = []
    for size in SIZES:
        with TemporaryDirectory() as folder:
            root = Path(folder)
            paths = [_written(root, number) for number in range(size)]

            def listed(root: Path = root) -> int:
                return sum(not run.problem for run in History(root).refresh())

            def decoded(paths: Iterable[Path] = paths) -> int:
                return len([json.loads(path.read_bytes()) for path in paths])

            ours, bare = in_pairs(listed, decoded, min(repeats, MOST))
        figures.append(Figure(f"a list of {size:,} runs", "ms", ours, "json.loads", bare, 4.8))
    return figures


def _written(root: Path, number: int) -> Path:
    run = summary(1 + number // 40, 1 + number % 20, 1 + number % 40 // 20, hour=number / 60)
    return write(root, run)


def in_pairs(
    ours: Callable[[], int], other: Callable[[], int], repeats: int
) -> tuple[list[float], list[float]]:
    """Processor time of two ways to the same number of things, in turns, after once each, ms."""
    took: tuple[list[float], list[float]] = ([], [])
    for _ in range(1 + repeats):
        counts = set()
        for work, times in zip((ours, other), took, strict=True):
            began = time.process_time()
            counts.add(work())
            times.append(1000 * (time.process_time() - began))
        assert len(counts) == 1, counts
    return took[0][1:], took[1][1:]
