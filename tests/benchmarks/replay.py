"""How long a jump in a replay is waited for."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import make_reader

from madrob_console.engine.core import Engine
from madrob_console.engine.engine_config import EngineConfig
from madrob_console.engine.replay import Replay
from madrob_console.engine.requests import JumpTo
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.messages.message_types import MessageTypes
from tests.benchmarks.bags import long_bag, simulated_run
from tests.benchmarks.report import Baseline, Figure, Goal

PACKAGES = ("mcap", "rosbags")

LENGTH = 300.0
"""Of the jump, s."""
SHOWN = 0.05
"""Screens are told this often where the jump stands, s."""
JUMP = Goal(times=2.6)
"""Above four before a replay went the way of the engine."""


def jump(repeats: int) -> Iterator[Figure]:
    """From the beginning of a replay to five minutes later, beside the mere reading of its bag."""
    with tempfile.TemporaryDirectory(prefix="madrob-") as name:
        run = simulated_run(Path(name, "run"))
        bag = long_bag(run, Path(name, "long"), LENGTH + 10.0)
        (file,) = bag.glob("*.mcap")
        pairs = [(_jump(bag), _read(file)) for _ in range(repeats)]
        beside = Baseline("mcap's reader alone", [read for _, read in pairs])
        ours = [jumped for jumped, _ in pairs]
        yield Figure("replay: a jump of 5 minutes", "s", ours, JUMP, beside)


def _jump(bag: Path) -> float:
    types = MessageTypes()
    replay = Replay(bag, types)
    config = EngineConfig(bag.parent, DEFAULT_MAPPINGS, disk_needed=0)
    engine = Engine.of_recording(replay, config, types)
    engine.open()
    began = shown = time.perf_counter()
    assert engine.control(JumpTo(LENGTH)) is None
    while replay.source.clock.target is not None:
        engine.step(SHOWN)
        if time.perf_counter() - shown > SHOWN:
            engine.snapshot()
            shown = time.perf_counter()
    took = time.perf_counter() - began
    engine.close()
    return took


def _read(file: Path) -> float:
    began = time.perf_counter()
    with file.open("rb") as stream:
        for _ in make_reader(stream).iter_messages(log_time_order=False):
            pass
    return time.perf_counter() - began


BENCHMARKS = (jump,)
