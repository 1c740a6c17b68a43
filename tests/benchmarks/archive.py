"""How long an archive of results is waited for: history, standings, the next run number.

Beside each is the least that has to be done: a plain loop over the same files.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec

from madrob_console.archive.folders import NUMBERS_FILE, RESULT_FILE, RunName, next_run_number
from madrob_console.archive.history import History
from madrob_console.archive.history_index import INDEX_FILE
from madrob_console.pages.tally import standings
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.madrob_console.run_folders import summary, write

PACKAGES = ("msgspec",)

SIZES = 10, 1_000, 10_000
FIRSTS = 2
OPENS = Goal(times=5)
NEXT_NUMBER = Goal(times=1)

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
    ids = [RunName(run.subject, run.condition, run.run_number) for run in runs]
    (root / NUMBERS_FILE).write_bytes(b"".join(msgspec.json.encode(one) + b"\n" for one in ids))


def _figures(root: Path, size: int, repeats: int) -> list[Figure]:
    took = defaultdict[str, list[float]](list)
    for repeat in range(repeats):
        if repeat < FIRSTS:
            (root / INDEX_FILE).unlink(missing_ok=True)
            took["first"].append(_timed(History(root).refresh)[0])
            took["each read"].append(_timed(partial(_read_each, root))[0])
        opened, runs = _timed(History(root).refresh)
        assert len(runs) == size
        took["opened"].append(opened)
        took["ranked"].append(opened + _timed(partial(standings, runs))[0])
        took["each looked at"].append(_timed(partial(_look_at_each, root))[0])
        took["number"].append(1000 * _timed(partial(next_run_number, root, 1, 1))[0])
        took["numbers read"].append(1000 * _timed(partial(_read_numbers, root))[0])
    goals = (OPENS, NEXT_NUMBER) if size == SIZES[-1] else (None, None)
    read = Baseline("json.loads of each result", took["each read"])
    looked = Baseline("a look at each result", took["each looked at"])
    numbers = Baseline("json.loads of each number", took["numbers read"])
    return [
        Figure(f"history of {size} runs, the first time", "s", took["first"], None, read),
        Figure(f"history of {size} runs", "s", took["opened"], goals[0], looked),
        Figure(f"standings of {size} runs", "s", took["ranked"], goals[0], looked),
        Figure(f"next run number among {size}", "ms", took["number"], goals[1], numbers),
    ]


def _results(root: Path) -> Iterator[Path]:
    return (Path(run.path, RESULT_FILE) for run in os.scandir(root) if run.is_dir())


def _look_at_each(root: Path) -> list[os.stat_result]:
    return [path.stat() for path in _results(root)]


def _read_each(root: Path) -> list[object]:
    return [json.loads(path.read_bytes()) for path in _results(root)]


def _read_numbers(root: Path) -> list[object]:
    return [json.loads(line) for line in (root / NUMBERS_FILE).read_bytes().splitlines()]


def _timed(work: Callable[[], _T]) -> tuple[float, _T]:
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


BENCHMARKS = (archives,)
