"""What the engine finds in random runs, against what the simulator knows from its own plan."""

from __future__ import annotations

import tempfile
from pathlib import Path

from madrob_console.testbeds.simulated import Scenario
from tests.benchmarks.report import Figure, Goal
from tests.madrob_console.engine.test_truth import CONDITIONS, compare, play

PACKAGES = ("numpy",)

RUNS = 200
"""Each time."""
ONE_SAMPLE = Goal(1.0)
ALL_RIGHT = Goal(100, at_least=True)


def truth(repeats: int) -> list[Figure]:
    """200 random runs each time: the largest error of an event's time, the capability level."""
    errors: list[float] = []
    raw_errors: list[float] = []
    right: list[float] = []
    for repeat in range(repeats):
        found = []
        for number in range(RUNS):
            seed = repeat * RUNS + number
            with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
                played = play(Path(folder), Scenario.RANDOM, seed, CONDITIONS[seed % 4])
            found.append(compare(played))
        errors.append(max(one.error for one in found))
        raw_errors.append(max(one.raw_error for one in found))
        right.append(100 * sum(one.level == one.true_level for one in found) / RUNS)
    return [
        Figure(f"largest event time error in {RUNS} random runs", "samples", errors, ONE_SAMPLE),
        Figure("  with the load cell's noise", "samples", raw_errors),
        Figure("capability level right", "%", right, ALL_RIGHT),
    ]


BENCHMARKS = (truth,)
