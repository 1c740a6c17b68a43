"""The least that a recorder over ROS can do: rclpy's executor and the library of MCAP.

Says `there` with the first message, and goes on until it is ended.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable

from mcap.writer import Writer

from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.testbeds.ros.connection import load_message_class
from madrob_console.testbeds.ros.subscriptions import qos_profile
from madrob_console.testbeds.ros_domain import domain_id
from recorder.writer import CHUNK_BYTES
from tests.madrob_console.ros_peer import RELIABLE, TYPES, Peer

THERE = "there"


def main() -> None:
    """Record the testbed's topics."""
    with Peer(domain_id(None, os.environ)) as peer, tempfile.TemporaryFile() as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start("ros2", "")

        def record(channel: int) -> Callable[[bytes], None]:
            def write(data: bytes) -> None:
                now = time.time_ns()
                writer.add_message(channel, now, data, now)

            return write

        for topic, kind in {each.topic: each.type for each in DEFAULT_MAPPINGS}.items():
            text = TYPES.definition(kind).encode()
            channel = writer.register_channel(
                topic, "cdr", writer.register_schema(kind, "ros2msg", text), {}
            )
            peer.own.create_subscription(
                load_message_class(kind),
                topic,
                record(channel),
                qos_profile(RELIABLE, 1000),
                raw=True,
            )
        peer.until(file.tell)
        print(THERE, flush=True)
        while True:
            peer.spin(1.0)


if __name__ == "__main__":
    main()
