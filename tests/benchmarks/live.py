"""What the whole live system takes: a testbed over DDS, engine, recorder and console."""

from __future__ import annotations

import subprocess

from tests.benchmarks.console import console, start_run
from tests.benchmarks.programs import MADROB
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.terminal import MOST, bare_cost
from tests.benchmarks.wire import ROOT, SMALL, STARTING, Cost

PACKAGES = ("textual", "ros-jazzy-rclpy")

DOMAIN = 98
WHOLE = Goal(times=9)


def live_system(repeats: int) -> list[Figure]:
    """CPU of console and engine in a run, at the testbed's 300 messages/s over DDS."""
    testbed = [*MADROB, "testbed", "--repeat", "0", "--scenario", "slow", "--domain", str(DOMAIN)]
    costs: list[Cost] = []
    bare: list[float] = []
    with subprocess.Popen(testbed, cwd=ROOT, stdout=subprocess.DEVNULL) as process:
        try:
            for _ in range(min(repeats, MOST)):
                costs.append(_cost())
                bare.append(bare_cost(SMALL).share)
        finally:
            process.terminate()
    shares = [cost.share for cost in costs], [cost.with_children for cost in costs]
    beside = Baseline("bare app", bare)
    return [
        Figure("live run over DDS: console", "% core", shares[0], None, beside),
        Figure("with engine and recorder", "% core", shares[1], WHOLE, beside),
    ]


def _cost() -> Cost:
    with console(("--testbed", "ros", "--domain", str(DOMAIN)), blind=False) as wire:
        wire.wait_for("2 of 9 in the way", timeout=STARTING)
        start_run(wire)
        return wire.cost()


BENCHMARKS = (live_system,)
