"""How many messages of a flood arrive.

    python -m tests.benchmarks.recording <messages>

receives a flood of topics from another process, and prints how many messages came.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from itertools import count

from madrob_console.messages.mapping import TopicMapping
from scoring.protocol import Signal
from tests.benchmarks.commands import ROOT
from tests.benchmarks.report import Figure
from tests.madrob_console import ros_peer
from tests.madrob_console.ros_peer import FLOOD, Taker, source

DURATION = 4.0  # s
RATE = 30_000
"""Messages/s on all topics together."""
SHARE = 0.9
"""Of them arrives on a busy machine."""
TOPICS = 10
SENT = TOPICS * (1 + round(DURATION * RATE / TOPICS))
"""The numbered messages, and one before them on each topic."""
HEADER = "std_msgs/msg/Header"
NAMES = [f"{FLOOD}_{number}" for number in range(TOPICS)]
PATIENCE = 4.0
"""So long without a message the flood is over, s."""
MOST = 2
"""Repeats of what takes seconds."""
_domains = count(100)


def arrived(repeats: int) -> list[Figure]:
    """Ten topics from another process."""
    repeats = min(repeats, MOST)
    counts = [_flooded() for _ in range(repeats)]
    name, sent = f"arrived of {RATE}/s", [SENT] * repeats
    return [Figure(name, "", counts, "sent", sent, SHARE, at_least=True)]


def _flooded() -> int:
    env = os.environ | {"ROS_DOMAIN_ID": str(100 + next(_domains) % 100)}
    flood = [str(TOPICS), str(SENT // TOPICS - 1), str(RATE / TOPICS)]
    with subprocess.Popen(
        [sys.executable, "-m", ros_peer.__name__, *flood],
        cwd=ROOT,
        env=env,
        stderr=subprocess.DEVNULL,
    ) as sender:
        try:
            done = subprocess.run(
                [sys.executable, "-m", __name__, str(SENT)],
                cwd=ROOT,
                env=env,
                capture_output=True,
                text=True,
                timeout=120,
                check=True,
            )
        finally:
            sender.kill()
    return int(done.stdout.splitlines()[-1])


def _receive(wanted: int) -> int:
    """Take until all is there, or nothing comes any more."""
    mappings = [TopicMapping(Signal.DOOR, name, HEADER, "stamp.sec") for name in NAMES]
    got, newest = 0, time.monotonic() + 30.0
    with Taker(source(*mappings)) as taker:
        while got < wanted and time.monotonic() < newest + PATIENCE:
            if taken := len(taker.source.take_messages(0.02)):
                got += taken
                newest = time.monotonic()
    return got


if __name__ == "__main__":
    print(_receive(int(sys.argv[1])))
