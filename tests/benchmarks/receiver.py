"""Records a flood of topics from another process, and says what it took.

python -m tests.benchmarks.receiver ours|rclpy <folder> <messages> <type> <topic>...

`ours` is the program's recorder. `rclpy` is what one writes first: callbacks of a
SingleThreadedExecutor that hand serialised messages to `mcap.Writer`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mcap.writer import Writer

from madrob_console.messages.codec import TopicMapping
from madrob_console.testbeds.ros.connection import load_message_class, load_module, load_rclpy
from madrob_console.testbeds.ros.intake import qos_profile
from madrob_console.testbeds.ros_domain import domain_id
from recorder.bag import Qos
from recorder.writer import BagWriter
from scoring.protocol import Signal
from tests.benchmarks.wire import ROOT
from tests.madrob_console.ros_peer import FLOOD, TYPES, Taker, source

TOPICS = 10
HEADER = "std_msgs/msg/Header"
NAMES = [f"{FLOOD}_{number}" for number in range(TOPICS)]
DEPTH = 1000
PATIENCE = 4.0
"""So long without a message the flood is over, s."""


def ours(folder: Path, wanted: int, kind: str, names: Sequence[str]) -> tuple[int, float]:
    """The messages recorded, and the CPU time of all threads, s."""
    mappings = [TopicMapping(Signal.DOOR, name, kind, "stamp.sec") for name in names]
    with Taker(source(*mappings)) as taker:
        while sum(status.publishers for status in taker.source.status()) < len(names):
            taker.source.take_messages(0.05)
        with BagWriter(folder / "bag", taker.source.topics(), {}) as writer:

            def take() -> int:
                messages = taker.source.take_messages(0.02)
                writer.put_all(messages)
                return len(messages)

            began = time.process_time()
            _until_over(take, wanted)
        return sum(writer.close().counts.values()), time.process_time() - began


def rclpy_executor(folder: Path, wanted: int, kind: str, names: Sequence[str]) -> tuple[int, float]:
    """The same with rclpy's executor and a bare writer."""
    rclpy = load_rclpy()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id(None, os.environ))
    node = rclpy.create_node("recorder", context=context)
    executor = load_module("rclpy.executors").SingleThreadedExecutor(context=context)
    executor.add_node(node)
    message_class = load_message_class(kind)
    count = 0
    with (folder / "baseline.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=768 * 1024)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", TYPES.definition(kind).encode())

        def subscribe(name: str) -> None:
            channel = writer.register_channel(name, "cdr", schema)

            def record(data: bytes) -> None:
                nonlocal count
                now = time.time_ns()
                writer.add_message(channel, now, data, now)
                count += 1

            qos = qos_profile(Qos(), DEPTH)
            node.create_subscription(message_class, name, record, qos, raw=True)

        for name in names:
            subscribe(name)
        while any(node.count_publishers(name) == 0 for name in names):
            executor.spin_once(0.05)
        began = time.process_time()

        def take() -> int:
            before = count
            executor.spin_once(0.02)
            return count - before

        _until_over(take, wanted)
        writer.finish()  # type: ignore[no-untyped-call]
        used = time.process_time() - began
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)
    return count, used


def _until_over(take: Callable[[], int], wanted: int) -> None:
    """Take until all is there, or nothing comes any more."""
    got, newest = 0, time.monotonic() + 30.0
    while got < wanted and time.monotonic() < newest + PATIENCE:
        if taken := take():
            got += taken
            newest = time.monotonic()


def record(
    which: str, folder: str, messages: int, kind: str, names: Sequence[str], env: Mapping[str, str]
) -> tuple[int, float]:
    """Have it recorded in a process: the messages received, and the CPU time of each, us."""
    words = [which, folder, str(messages), kind, *names]
    done = subprocess.run(
        [sys.executable, "-m", __name__, *words],
        cwd=ROOT,
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    last = done.stdout.splitlines()[-1]  # the middleware may have said something, too
    received, microseconds = last.split()
    return int(received), float(microseconds)


def main() -> None:
    """Record, and print how many messages were received and the CPU time a message, us."""
    which, folder, wanted, kind, *names = sys.argv[1:]
    recorder = {"ours": ours, "rclpy": rclpy_executor}[which]
    received, used = recorder(Path(folder), int(wanted), kind, names)
    print(received, 1e6 * used / max(1, received))


if __name__ == "__main__":
    main()
