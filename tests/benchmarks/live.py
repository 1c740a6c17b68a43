"""What the whole live system takes: a testbed over DDS, engine, recorder and console."""

from __future__ import annotations

import subprocess

from tests.benchmarks.console import console, start_run
from tests.benchmarks.programs import MADROB
from tests.benchmarks.report import Figure, Goal
from tests.benchmarks.wire import ROOT, STARTING, Cost

PACKAGES = ("textual", "ros-jazzy-rclpy")

DOMAIN = 98
WHOLE = Goal(15)  # % of a core


def live_system(repeats: int) -> list[Figure]:
    """CPU of console and engine in a run, at the testbed's 300 messages/s over DDS."""
    testbed = [*MADROB, "testbed", "--repeat", "0", "--scenario", "slow", "--domain", str(DOMAIN)]
    costs: list[Cost] = []
    with subprocess.Popen(testbed, cwd=ROOT, stdout=subprocess.DEVNULL) as process:
        try:
            costs += [_cost() for _ in range(repeats)]
        finally:
            process.terminate()
    return [
        Figure("live run over DDS: console", "% core", [cost.share for cost in costs]),
        Figure("with engine and recorder", "% core", [cost.with_children for cost in costs], WHOLE),
    ]


def _cost() -> Cost:
    with console(("--testbed", "ros", "--domain", str(DOMAIN)), blind=False) as wire:
        wire.wait_for("all fresh and at rate", timeout=STARTING)
        start_run(wire)
        return wire.cost()


BENCHMARKS = (live_system,)
