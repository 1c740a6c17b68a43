"""An engine, its simulated testbed and its disk, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import standard_types
from madrob_console.referee.acts import Act, ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from scoring.kinematics import load_filters
from tests.madrob_console.engine.drive import make_setup
from tests.slice.disk import Disk
from tests.slice.engine import Engine
from tests.slice.scoring_child import score
from tests.slice.virtual_loop import LoopClock, VirtualLoop
from tests.slice.worker import Worker

NOON = 1_800_000_000_000_000_000  # ns since the epoch
FEEDING = 0.05
"""How often the virtual testbed sends, s."""


T = TypeVar("T")


class SlowDisk(Disk):
    """A disk that takes its time, and refuses what it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.delay = 0.0
        self.refusals = 0

    async def run(self, work: Callable[[], Any]) -> Any:  # noqa: ANN401
        await asyncio.sleep(self.delay)
        if self.refusals:
            self.refusals -= 1
            raise OSError("No space left on device")
        return await super().run(work)


class InlineWorker(Worker):
    """Scores in this process."""

    async def ask(self, question: object) -> Any:  # noqa: ANN401
        return self._answer(question)


class Hall:
    """An engine, its simulated testbed and its disk, in virtual time."""

    def __init__(self, results: Path, scenario: Scenario = Scenario.NOMINAL) -> None:
        clock = LoopClock(asyncio.get_running_loop(), NOON)
        types = standard_types()
        source = SimulatedSource(SimulatedTestbed(scenario), clock, types)
        config = EngineConfig(results, DEFAULT_MAPPINGS, 0, lossless=True)
        self.disk = SlowDisk()
        self.engine = Engine(
            source, clock, config, types, self.disk, InlineWorker(score, load_filters)
        )
        source.open()
        self._tasks = [
            asyncio.create_task(self._feed()),
            asyncio.create_task(self.engine.judge()),
            asyncio.create_task(self.disk.work_off()),
        ]
        self._number = 0

    async def _feed(self) -> None:
        while True:
            self.engine.intake.take(0.0)
            await asyncio.sleep(FEEDING)

    async def act(self, act: Act) -> str | None:
        self._number += 1
        return await self.engine.acts.perform(act, str(self._number))

    async def make_ready(self, limit: float) -> None:
        await self.act(SetUp(make_setup(timeout=limit, countdown=1.0)))
        await asyncio.sleep(1.5)
        assert await self.act(ZeroHandle()) is None
        assert await self.act(ConfirmPose()) is None

    async def run(self, limit: float = 60.0) -> None:
        """Go through a whole run, up to its result."""
        await self.make_ready(limit)
        assert await self.act(Start()) is None
        await self.engine.current.stopped.wait()
        await asyncio.sleep(1.0)
        await self.engine.score_run()

    @property
    def folder(self) -> Path:
        recording = self.engine.current.recording
        assert recording is not None
        return recording.folder

    def lines(self) -> list[str]:
        """What stands in the journal on disk, acts and changes."""
        return [entry.what for entry in self.entries()]

    def entries(self) -> tuple[Entry, ...]:
        return read_journal(self.folder / "journal.jsonl")[0]

    async def close(self) -> None:
        self.disk.delay = 0.0
        await self.disk.all_done()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.engine.close()


def play(story: Coroutine[Any, Any, T]) -> T:
    """Play a story in virtual time."""
    loop = VirtualLoop()
    try:
        return loop.run_until_complete(story)
    finally:
        loop.close()
