"""How much memory the processes of a testbed take, beside Python with the same libraries."""

from __future__ import annotations

import subprocess
import sys

from tests.benchmarks.commands import MADROB
from tests.benchmarks.engine import RATES
from tests.benchmarks.processes import family, hall, resident
from tests.benchmarks.report import Figure
from tests.benchmarks.screens import FOOTER, SETTLING, Wire

_FILES = ("lz4.frame", "mcap.reader", "msgspec", "numpy", "rosbags.typesys", "yaml", "zstandard")
LIBRARIES = {
    "engine": (*_FILES, "rclpy.executors", "rcl_interfaces.srv", "rosidl_generator_py"),
    "scorer": (*_FILES, "pandas", "scipy.signal"),
    "console": ("msgspec", "platformdirs", "rich", "textual.app", "textual.widgets"),
}
GOALS = {"engine": 2.0, "scorer": 1.4, "console": 2.6}


def memory(_repeats: int) -> list[Figure]:
    """An engine, its scoring process and a screen, at rest before a run; once."""
    with hall(RATES[0]) as (engine, domain):
        pids = dict(zip(("engine", "scorer"), family(engine.process.pid), strict=True))
        watch = (*MADROB, "watch", "--testbed", "ros", f"--results={engine.results}")
        with Wire(watch, {"ROS_DOMAIN_ID": str(domain)}) as wire:
            wire.arrival(FOOTER)
            wire.read_for(SETTLING)
            taken = {name: resident(pid) for name, pid in (pids | {"console": wire.pid}).items()}
    return [
        Figure(f"memory of the {name}", "MB", [size], "its libraries", [_with(name)], GOALS[name])
        for name, size in taken.items()
    ]


def _with(name: str) -> float:
    program = f"import {', '.join(LIBRARIES[name])}; print('there', flush=True); input()"
    argv = [sys.executable, "-c", program]
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"there\n"
        size = resident(process.pid)
        process.kill()
    return size
