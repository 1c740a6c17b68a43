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
from tests.slice.engine import Engine


async def serve(results: Path, socket: Path) -> None:
    """Run an engine until SIGTERM or SIGINT."""
    clock = SystemClock()
    types = standard_types()
    source = RosSource(DEFAULT_MAPPINGS, types, clock)
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
    arguments = parser.parse_args()
    asyncio.run(serve(arguments.results, arguments.socket))
