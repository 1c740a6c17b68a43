"""How long a bag is scored, with and without known layouts of messages."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from madrob_console.archive.scored import score_recording
from madrob_console.messages import codec
from scoring.kinematics import load_filters
from tests.benchmarks.report import Figure
from tests.madrob_console.recorded_runs import completed


def layouts(repeats: int) -> list[Figure]:
    """The same run, its messages read by their layout and decoded by the library."""
    load_filters()
    score_recording(completed())  # once before: files are in memory
    known, unknown = [], []
    for _ in range(repeats):
        known.append(_scored())
        with _library_alone():
            unknown.append(_scored())
    return [Figure("a run of 17 s scored", "s", known, "decoded by rosbags", unknown, 0.6)]


def _scored() -> float:
    began = time.process_time()
    score_recording(completed())
    return time.process_time() - began


@contextmanager
def _library_alone() -> Iterator[None]:
    with patch.object(codec, "Layout", side_effect=ValueError):
        yield
