"""What running processes cost: processor time, of one or of all that it has started."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.cli.engine_command import REPAIR_AFTER
from tests.benchmarks import swinging_door
from tests.benchmarks.commands import ROOT
from tests.benchmarks.swinging_door import TOPICS
from tests.madrob_console.engine_process import NO_REPORTS, STARTING, EngineProcess
from tests.watching import until

_SCHEDULED = 2  # of clock_gettime(2): the processor time of all threads
_domains = count(30)


def cpu_time(pid: int) -> float:
    """Of all threads of a process, user and system, s."""
    return time.clock_gettime(~pid << 3 | _SCHEDULED)


def family(pid: int) -> list[int]:
    """A process and all that it and its children have started."""
    lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [pid, *(each for child in " ".join(lists).split() for each in family(int(child)))]


def cores_used(pids: Mapping[str, int], seconds: float) -> dict[str, float]:
    """Of each process and its family the share of a core in the next seconds, %."""
    began = time.monotonic()
    before = {name: {each: cpu_time(each) for each in family(pid)} for name, pid in pids.items()}
    time.sleep(seconds)
    elapsed = time.monotonic() - began
    return {
        name: 100 / elapsed * sum(cpu_time(each) - before[name][each] for each in family(pid))
        for name, pid in pids.items()
    }


@contextmanager
def python(*arguments: str, domain: int) -> Iterator[subprocess.Popen[str]]:
    """A Python program in a ROS domain while inside."""
    with subprocess.Popen(
        [sys.executable, *arguments],
        cwd=ROOT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def hall(rate: int) -> Iterator[tuple[EngineProcess, int]]:
    """A testbed of so many messages/s and an engine that is at rest; it and the ROS domain."""
    domain = next(_domains)
    # on a busy machine, too, a run begins
    settings = f"rate = {rate / TOPICS}\nleast_rate = 0.2\nlargest_skew = 5.0\n{NO_REPORTS}"
    with (
        TemporaryDirectory(prefix="madrob-") as results,
        python("-m", swinging_door.__name__, str(rate), domain=domain),
        EngineProcess(
            Path(results), None, environment={"ROS_DOMAIN_ID": str(domain)}, settings=settings
        ) as engine,
    ):
        began = time.monotonic()
        engine.wait_for(
            lambda now: all(topic.received for topic in now.topics if not topic.optional)
        )
        time.sleep(max(0.0, began + REPAIR_AFTER + 1.0 - time.monotonic()))
        until(lambda: len(family(engine.process.pid)) == len(("engine", "scorer")), STARTING)
        yield engine, domain
