"""What recording costs a message, and what it loses."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from itertools import count
from pathlib import Path

from mcap.writer import Writer

from recorder.bag import RawMessage, Topic
from recorder.writer import BagWriter
from tests.benchmarks import receiver
from tests.benchmarks.report import Baseline, Figure, Goal
from tests.benchmarks.wire import ROOT
from tests.madrob_console import ros_peer

PACKAGES = ("mcap", "ros-jazzy-rclpy")

MESSAGES = 100_000
PAYLOAD = 100  # bytes
WRITER = Goal(times=1.5)

DURATION = 5.0  # s
CHEAPER = Goal(times=1 / 5)
NONE_LOST = Goal(None)
MOST = {300: 2, 3_000: 6, 30_000: 2}
"""Messages/s on all topics together, and repeats: each takes half a minute. One pair by itself gave
anything from a sixth to a fourth where there is a goal."""
_domains = count(100)


def writer_alone(repeats: int) -> list[Figure]:
    """The recorder's queue, thread and file, beside `mcap.Writer` in a loop."""
    ours: list[float] = []
    bare: list[float] = []
    topic = Topic("/load", "std_msgs/msg/String", "string data\n", "")
    data = bytes(PAYLOAD)
    messages = [
        RawMessage(topic.name, topic.type, data, number, number) for number in range(MESSAGES)
    ]
    for _ in range(repeats):
        with tempfile.TemporaryDirectory(prefix="madrob-") as folder:
            ours.append(_recorded(Path(folder), topic, messages))
            bare.append(_written(Path(folder), topic, messages))
    beside = Baseline("mcap.Writer", bare)
    return [Figure("writer alone, CPU a message", "us", ours, WRITER, beside)]


def _recorded(folder: Path, topic: Topic, messages: list[RawMessage]) -> float:
    began = time.process_time()
    with BagWriter(folder / "bag", [topic], {}, block_when_full=True) as writer:
        for message in messages:
            writer.put_message(message)
    return 1e6 * (time.process_time() - began) / len(messages)


def _written(folder: Path, topic: Topic, messages: list[RawMessage]) -> float:
    began = time.process_time()
    with (folder / "bare.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=768 * 1024)
        writer.start(profile="ros2")
        schema = writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
        channel = writer.register_channel(topic.name, "cdr", schema)
        for message in messages:
            writer.add_message(channel, message.receive_ns, message.data, message.publish_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return 1e6 * (time.process_time() - began) / len(messages)


def over_dds(repeats: int) -> list[Figure]:
    """Ten topics from another process: CPU a message and messages lost, at three rates."""
    cost = defaultdict[tuple[str, int], list[float]](list)
    lost = defaultdict[tuple[str, int], list[float]](list)
    for rate, most in MOST.items():
        for _ in range(min(repeats, most)):
            for which in ("ours", "rclpy"):
                received, microseconds, sent = _flooded(which, rate)
                cost[which, rate].append(microseconds)
                lost[which, rate].append(100 * (1 - received / sent))
    figures: list[Figure] = []
    for rate in MOST:
        beside = Baseline("rclpy executor", cost["rclpy", rate])
        goal = CHEAPER if rate >= 3_000 else None
        name = f"{rate} messages/s"
        figures.append(Figure(f"{name}: CPU a message", "us", cost["ours", rate], goal, beside))
        beside = Baseline("rclpy executor", lost["rclpy", rate])
        figures.append(Figure(f"{name}: lost", "%", lost["ours", rate], NONE_LOST, beside))
    return figures


def _flooded(which: str, rate: int) -> tuple[int, float, int]:
    """Messages received, CPU time a message in us, messages sent."""
    each = round(DURATION * rate / receiver.TOPICS)
    sent = each * receiver.TOPICS
    env = os.environ | {"ROS_DOMAIN_ID": str(100 + next(_domains) % 100)}
    flood = [sys.executable, "-m", ros_peer.__name__, str(receiver.TOPICS), str(each)]
    flood.append(str(rate / receiver.TOPICS))
    with (
        tempfile.TemporaryDirectory(prefix="madrob-") as folder,
        subprocess.Popen(flood, cwd=ROOT, env=env, stderr=subprocess.DEVNULL) as sender,
    ):
        try:
            received, microseconds = receiver.record(
                which, folder, sent, receiver.HEADER, receiver.NAMES, env
            )
        finally:
            sender.kill()
    return received, microseconds, sent


BENCHMARKS = (writer_alone, over_dds)
