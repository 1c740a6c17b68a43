"""A recorded run that is gone through once more, in time that a test lets pass."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.requests import PlaybackCommand, PlaybackView, PlayOrPause, SetSpeed
from madrob_console.engine.runtime.replay import Replay
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import Snapshot
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.messages.message_types import MessageTypes


@dataclass
class RealTime:
    """Real time for a test: it passes only where somebody waits or works."""

    now: float = 50.0
    work: float = 0.0

    def monotonic(self) -> float:
        self.now += self.work
        return self.now

    def wait(self, duration: float) -> None:
        self.now += duration


class Deck:
    """A replay in time that a test lets pass."""

    def __init__(self, path: Path, speed: float = 1.0, work: float = 0.0) -> None:
        self.world = RealTime(work=work)
        config = EngineConfig(path.parent / "never made", DEFAULT_MAPPINGS, disk_needed=0)
        types = MessageTypes()
        replay = Replay(path, types, speed, self.world.monotonic, self.world.wait)
        self.engine = Engine.of_recording(replay, config, types)
        self.engine.open()

    def step(self, count: int = 1) -> None:
        for _ in range(count):
            self.engine.step(0.02)

    def let_pass(self, duration: float) -> None:
        end = self.world.now + duration
        while self.world.now < end - 1e-6:
            self.engine.step(0.02)

    def do(self, *commands: PlaybackCommand) -> None:
        for command in commands:
            assert self.engine.control(command) is None
            while self.at.jumping_to is not None:
                self.engine.step(0.02)

    def to_the_end(self) -> Snapshot:
        self.engine.control(SetSpeed(0))
        if self.at.paused:
            self.engine.control(PlayOrPause())
        while not self.at.ended:
            self.engine.step(0.02)
        return self.shown

    @property
    def shown(self) -> Snapshot:
        return self.engine.snapshot()

    @property
    def at(self) -> PlaybackView:
        playback = self.shown.playback
        assert playback is not None
        return playback
