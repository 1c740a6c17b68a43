"""One testbed, one run after the other, in one event loop: here everything starts."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

from madrob_console.common.clock import Clock
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import refusals
from madrob_console.testbeds.source import Source
from scoring.kinematics import load_filters
from scoring.protocol import POST_ROLL
from tests.slice import wire
from tests.slice.acts import Acts
from tests.slice.current_run import CurrentRun
from tests.slice.disk import Disk
from tests.slice.intake import Intake
from tests.slice.scoring_child import Question, score
from tests.slice.server import Server
from tests.slice.worker import Worker

SLICE = 0.005
"""Longest work on messages between two turns of the loop, s."""

TICK = 0.02
"""The clock is looked at this often without messages, s."""

LATEST = 0.5
"""A message that is older is not shown, only judged, s."""

NEWEST_LINES = 50
"""Lines of the journal that screens show."""


class Engine:
    """Records, judges and scores the runs of a testbed.

    Made and run in one event loop.
    """

    def __init__(
        self,
        source: Source,
        clock: Clock,
        config: EngineConfig,
        types: MessageTypes,
        disk: Disk | None = None,
        worker: Worker | None = None,
    ) -> None:
        self._source = source
        self._clock = clock
        self.disk = disk or Disk()
        self.intake = Intake(source, clock)
        self.current = CurrentRun(source, clock, config, types, self.intake, self.disk)
        self.acts = Acts(self.current)
        self._worker = worker or Worker(score, load_filters)
        self.score_times: list[float] = []

    async def run(self, socket: Path) -> None:
        """Serve screens until this is cancelled.

        Every task starts here.
        """
        self._source.open()
        self._worker.warm()
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(asyncio.to_thread(self.intake.run))
                tasks.create_task(self.judge())
                tasks.create_task(self.disk.work_off())
                tasks.create_task(self.score_runs())
                tasks.create_task(Server(self).serve(socket))
        finally:
            self.close()

    def close(self) -> None:
        self.intake.close()
        self._source.close()
        self._worker.close()
        self.disk.close()
        self.current.close()

    async def judge(self) -> None:
        """Judge what has arrived, in slices, and look at the clock in between."""
        while True:
            await self.intake.arrival(TICK)
            self.judge_slice()
            self.current.advance()

    def judge_slice(self) -> None:
        """Judge messages for one slice of time."""
        waiting = self.intake.waiting
        ends = time.perf_counter() + SLICE
        while waiting and time.perf_counter() < ends:
            is_recorded, message = waiting.popleft()
            is_shown = self.intake.taken_until - message.receive_ns / 1e9 < LATEST
            self.current.observation.receive(message, recorded=is_recorded, shown=is_shown)

    async def score_runs(self) -> None:
        """Close and score each run that has stopped."""
        while True:
            await self.current.stopped.wait()
            self.current.stopped.clear()
            await asyncio.sleep(POST_ROLL)
            await self.score_run()

    async def score_run(self) -> None:
        """Finish the bag of the run that is over, and score it from the bag."""
        begun = time.monotonic()
        recording = self.current.recording
        assert recording is not None
        self.intake.record(None)
        self._clock.release()
        await asyncio.to_thread(recording.close_bag)
        question = Question(recording.folder, recording.record, self.current.run)
        result = await self._worker.ask(question)
        if recording is self.current.recording:  # else the referee has gone on
            self.current.result = result
        self.score_times.append(time.monotonic() - begun)

    def state(self, holder: str) -> wire.State:
        """Return what screens show now.

        `holder` has the right to act.
        """
        current = self.current
        observation = current.observation
        sensors = observation.sensors
        taken = self.intake.taken_until
        pending = self.acts.pending
        zero = current.run.handle_zero
        return wire.State(
            time=current.now(),
            holder=holder,
            run=current.run,
            pending="" if pending is None else pending.name,
            refusals=refusals(current.situation()),
            steps=observation.steps,
            provisional=dict(observation.provisional),
            events=observation.events,
            door=sensors.door_view(taken),
            handle=sensors.handle_view(taken, zero, observation.largest_force),
            latch=sensors.latch_view(taken),
            passage=sensors.passage_view(taken),
            topics=sensors.topics(self._source.status(), {}, taken),
            log=tuple(f"{line.what} {line.reason}" for line in current.lines[-NEWEST_LINES:]),
            result=self._values(),
            problems=self._problems(),
        )

    def _values(self) -> dict[str, float | None] | None:
        if self.current.result is None:
            return None
        indicators = self.current.result.indicators
        return {name.value: indicator.value for name, indicator in indicators.items()}

    def _problems(self) -> tuple[str, ...]:
        problems = []
        if self.disk.silent > 1.0:
            problems.append(f"the disk has not answered for {self.disk.silent:.0f} s")
        if self.disk.refused:
            problems.append(f"NOT ON DISK: {self.disk.refused}")
        if self.intake.unjudged:
            problems.append(f"{self.intake.unjudged} messages are recorded but not judged live")
        if self._worker.problem:
            problems.append(f"no result yet: {self._worker.problem}")
        return tuple(problems)
