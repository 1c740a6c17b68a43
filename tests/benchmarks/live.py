"""What the whole live system takes: a testbed over DDS, engine, recorder and console."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

from tests.benchmarks.programs import MADROB
from tests.benchmarks.report import Figure, Goal
from tests.benchmarks.wire import ROOT, STARTING, Cost, Wire
from tests.readme_console import ENTER, F5, F6, F7

PACKAGES = ("textual", "ros-jazzy-rclpy")

DOMAIN = 98
WHOLE = Goal(15)  # % of a core
KEYS = ((ENTER, "is set up"), (F7, "Done: zero"), (F6, "all passed or waived"), (F5, "RUNNING"))


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
    with tempfile.TemporaryDirectory(prefix="madrob-", ignore_cleanup_errors=True) as folder:
        env = {"XDG_RUNTIME_DIR": folder}
        settings = Path(folder, "madrob.toml")
        settings.write_text("[run]\ncountdown = 2\n")
        console = [*MADROB, "console", "--testbed", "ros", "--domain", str(DOMAIN)]
        console += ["--settings", str(settings), "--results", str(Path(folder, "results"))]
        try:
            with Wire(console, blind=False, env=env) as wire:
                wire.wait_for("all fresh and at rate", timeout=STARTING)
                for key, text in KEYS:
                    wire.send(key)
                    wire.wait_for(text, timeout=STARTING)
                return wire.cost()
        finally:
            stop = [*MADROB, "engine", "stop", "--force"]
            subprocess.run(
                stop, env=os.environ | env, cwd=ROOT, capture_output=True, timeout=60, check=False
            )


BENCHMARKS = (live_system,)
