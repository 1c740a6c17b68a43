"""How long an archive of results is waited for: history, standings, the next run number."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec

from madrob_console.archive.folders import NUMBERS_FILE, RunId, next_run_number
from madrob_console.archive.history import INDEX_FILE, History
from madrob_console.standings.tally import standings
from tests.benchmarks.report import Figure, Goal
from tests.madrob_console.run_folders import summary, write

PACKAGES = ("msgspec",)

SIZES = 10, 1_000, 10_000
OPENS = Goal(0.3)  # s
NEXT_NUMBER = Goal(20)  # ms

_T = TypeVar("_T")


def archives(repeats: int) -> list[Figure]:
    """History, standings and next run number among 10 to 10,000 runs."""
    figures: list[Figure] = []
    for size in SIZES:
        with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
            root = Path(folder)
            _fill(root, size)
            figures += _figures(root, size, repeats)
    return figures


def _fill(root: Path, size: int) -> None:
    runs = [
        summary(number // 200 + 1, number // 10 % 20 + 1, number % 10 + 1, hour=number / 10)
        for number in range(size)
    ]
    for run in runs:
        write(root, run)
    ids = [RunId(run.subject, run.condition, run.run_number) for run in runs]
    (root / NUMBERS_FILE).write_bytes(b"".join(msgspec.json.encode(one) + b"\n" for one in ids))


def _figures(root: Path, size: int, repeats: int) -> list[Figure]:
    largest = size == SIZES[-1]
    first = [_first(root) for _ in range(min(repeats, 3))]
    opened: list[float] = []
    ranked: list[float] = []
    numbers: list[float] = []
    for _ in range(repeats):
        took, runs = _timed(History(root).refresh)
        assert len(runs) == size
        opened.append(took)
        ranked.append(took + _timed(partial(standings, runs))[0])
        numbers.append(1000 * _timed(lambda: next_run_number(root, 1, 1))[0])
    goal = OPENS if largest else None
    return [
        Figure(f"history of {size} runs, the first time", "s", first),
        Figure(f"history of {size} runs", "s", opened, goal),
        Figure(f"standings of {size} runs", "s", ranked, goal),
        Figure(f"next run number among {size}", "ms", numbers, NEXT_NUMBER if largest else None),
    ]


def _first(root: Path) -> float:
    (root / INDEX_FILE).unlink(missing_ok=True)
    return _timed(History(root).refresh)[0]


def _timed(work: Callable[[], _T]) -> tuple[float, _T]:
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


BENCHMARKS = (archives,)
