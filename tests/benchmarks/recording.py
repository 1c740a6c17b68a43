"""What taking messages from DDS and writing them costs, beside rclpy and the library of MCAP.

    python -m tests.benchmarks.recording ours|executor <messages>

receives a flood of topics from another process, and prints messages and CPU time of each, us.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from itertools import count

from mcap.writer import Writer

from madrob_console.messages.codec import TopicMapping
from madrob_console.testbeds.ros_domain import domain_id
from recorder.mcap_writer import CHUNK_BYTES, McapWriter
from scoring.protocol import Signal
from tests.benchmarks.commands import ROOT
from tests.benchmarks.report import Figure
from tests.madrob_console import ros_peer
from tests.madrob_console.ros_peer import FLOOD, Peer, Taker, source

MESSAGES = 100_000
DURATION = 4.0  # s
RATES = {3_000: 1.0, 30_000: 0.9}
"""Messages/s on all topics together, and the share of them that arrives on a busy machine."""
TOPICS = 10
HEADER = "std_msgs/msg/Header"
NAMES = [f"{FLOOD}_{number}" for number in range(TOPICS)]
PATIENCE = 4.0
"""So long without a message the flood is over, s."""
MOST = 2
"""Repeats of what takes seconds."""
_domains = count(100)


def mcap_writer(repeats: int) -> list[Figure]:
    """CPU of 100,000 small messages in one file, beside the library's own writer."""
    took = defaultdict[type, list[float]](list)
    for _ in range(repeats):
        for writer in (McapWriter, Writer):
            with tempfile.TemporaryFile() as file:
                ours = McapWriter(file.write) if writer is McapWriter else None
                took[writer].append(_written(ours or Writer(file, chunk_size=CHUNK_BYTES)))
    return [Figure("a message written", "us", took[McapWriter], "mcap.Writer", took[Writer], 0.3)]


def _written(writer: McapWriter | Writer) -> float:
    data, began = bytes(100), time.process_time()
    writer.start("ros2", "")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    channel = writer.register_channel("/load", "cdr", schema, {})
    for number in range(MESSAGES):
        writer.add_message(channel, number, data, number)
    writer.finish()
    return 1e6 * (time.process_time() - began) / MESSAGES


def take_loop(repeats: int) -> list[Figure]:
    """Ten topics from another process: CPU of a message, and how many arrive."""
    figures: list[Figure] = []
    repeats = min(repeats, MOST)
    for rate, share in RATES.items():
        runs = [(_flooded("ours", rate), _flooded("executor", rate)) for _ in range(repeats)]
        ours, theirs = ([pair[side] for pair in runs] for side in range(2))
        sent = [_sent(rate)] * repeats
        figures += [
            Figure(
                f"a message of {rate}/s",
                "us",
                [cost for _, cost in ours],
                "rclpy executor",
                [cost for _, cost in theirs],
                1 / 5,
            ),
            Figure(
                f"arrived of {rate}/s", "", [n for n, _ in ours], "sent", sent, share, at_least=True
            ),
        ]
    arrived = [n for n, _ in theirs]  # of the highest rate
    figures.append(Figure(f"arrived of {rate}/s by an executor", "", arrived, "sent", sent, 0.9))
    return figures


def _sent(rate: int) -> int:
    """The numbered messages, and one before them on each topic."""
    return TOPICS * (1 + round(DURATION * rate / TOPICS))


def _flooded(which: str, rate: int) -> tuple[int, float]:
    env = os.environ | {"ROS_DOMAIN_ID": str(100 + next(_domains) % 100)}
    flood = [str(TOPICS), str(_sent(rate) // TOPICS - 1), str(rate / TOPICS)]
    with subprocess.Popen(
        [sys.executable, "-m", ros_peer.__name__, *flood],
        cwd=ROOT,
        env=env,
        stderr=subprocess.DEVNULL,
    ) as sender:
        try:
            done = subprocess.run(
                [sys.executable, "-m", __name__, which, str(_sent(rate))],
                cwd=ROOT,
                env=env,
                capture_output=True,
                text=True,
                timeout=120,
                check=True,
            )
        finally:
            sender.kill()
    received, cost = done.stdout.splitlines()[-1].split()
    return int(received), float(cost)


def _receive(which: str, wanted: int) -> tuple[int, float]:
    """Messages, and the CPU time of all threads, s."""
    if which == "ours":
        mappings = [TopicMapping(Signal.DOOR, name, HEADER, "stamp.sec") for name in NAMES]
        with Taker(source(*mappings)) as taker:
            return _until_over(lambda: len(taker.source.take_messages(0.02)), wanted)
    with Peer(domain_id(None, os.environ)) as peer:
        heard = [peer.listen_raw(name, HEADER) for name in NAMES]

        def take() -> int:
            before = sum(map(len, heard))
            peer.spin(0.02)
            return sum(map(len, heard)) - before

        return _until_over(take, wanted)


def _until_over(take: Callable[[], int], wanted: int) -> tuple[int, float]:
    """Take until all is there, or nothing comes any more; what that cost from the first one on."""
    got, began, newest = 0, 0.0, time.monotonic() + 30.0
    while got < wanted and time.monotonic() < newest + PATIENCE:
        before = time.process_time()
        if taken := take():
            began = began or before
            got += taken
            newest = time.monotonic()
    return got, time.process_time() - began


if __name__ == "__main__":
    received, used = _receive(sys.argv[1], int(sys.argv[2]))
    print(received, 1e6 * used / max(1, received))
