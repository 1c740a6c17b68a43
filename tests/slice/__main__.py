"""`python -m tests.slice RESULTS SOCKET`: an engine for the testbed of this ROS domain."""

from __future__ import annotations

import argparse
import asyncio
import signal
from contextlib import suppress
from pathlib import Path

from madrob_console.common.clock import SystemClock
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import standard_types
from madrob_console.testbeds.ros import RosSource
from recorder import RawMessage
from tests.slice.engine import Engine


class Flood(RosSource):
    """A testbed whose messages come several times over, for trials."""

    times = 1

    def take_messages(self, timeout: float) -> list[RawMessage]:
        messages = super().take_messages(timeout)
        return [message for message in messages for _ in range(self.times)]


async def serve(results: Path, socket: Path, times: int) -> None:
    """Run an engine until SIGTERM or SIGINT."""
    clock = SystemClock()
    types = standard_types()
    source = Flood(DEFAULT_MAPPINGS, types, clock)
    source.times = times
    engine = Engine(source, clock, EngineConfig(results, DEFAULT_MAPPINGS, 0), types)
    running = asyncio.create_task(engine.run(socket))
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    with suppress(asyncio.CancelledError):
        await running


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("socket", type=Path)
    parser.add_argument("--times", type=int, default=1, help="each message so many times")
    arguments = parser.parse_args()
    asyncio.run(serve(arguments.results, arguments.socket, arguments.times))
