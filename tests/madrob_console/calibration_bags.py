"""Recordings of the simulated testbed for a calibration, as `ros2 bag record` makes them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random

from madrob_console.messages.codec import describe_topic
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.simulated.encoder import Encoder
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from madrob_console.testbeds.simulated.sensor_model import (
    Reading,
    Scene,
    SensorModel,
    SensorSettings,
)
from recorder.bag import RawMessage
from recorder.writer import BagWriter
from scoring.protocol import Signal

START_NS = 1_700_000_000_000_000_000
TYPES = MessageTypes()

Spoil = Callable[[Signal, float, Reading], Reading | None]
"""(signal, s since the start, reading) -> another reading, or None for no message."""


def swing(time: float, speed: float = 0.5, reach: float = 1.3, times: int = 2) -> float:
    """The angle, rad, of a panel that goes `times` to each side and back, at `speed` rad/s."""
    turns = time * speed / (4 * reach)
    if not 0 < turns < times:
        return 0.0
    return reach * (2 / math.pi) * math.asin(math.sin(math.tau * turns))


def swing_time(speed: float = 0.5, reach: float = 1.3, times: int = 2) -> float:
    """How long `swing` takes, s."""
    return times * 4 * reach / speed


def record(
    folder: Path,
    scene: Callable[[float], Scene],
    duration: float,
    *,
    geometry: DoorGeometry | None = None,
    sensors: SensorSettings | None = None,
    mappings: Sequence[TopicMapping] = DEFAULT_MAPPINGS[:-1],
    spoil: Spoil = lambda _signal, _time, reading: reading,
    seed: int = 0,
) -> Path:
    """Record `duration` s of a scene; returns the bag."""
    settings = sensors or SensorSettings()
    model = SensorModel(geometry or DoorGeometry(), settings, seed)
    jitter = Random(seed)
    encoders = {mapping: Encoder(mapping, TYPES) for mapping in mappings}
    topics = [describe_topic(TYPES, m.topic, m.type) for m in mappings]
    with BagWriter(folder, topics, {}, block_when_full=True) as writer:
        for number in range(int(duration * settings.rate)):
            for mapping, encoder in encoders.items():
                time = number / settings.rate + jitter.gauss(0, settings.jitter)
                reading = spoil(mapping.signal, time, model.read(mapping.signal, scene(time)))
                if reading is None:
                    continue
                stamp = START_NS + round(time * 1e9)
                data = encoder.encode(stamp, reading)
                writer.put_message(
                    RawMessage(mapping.topic, mapping.type, data, stamp, stamp + 100_000)
                )
    return folder


def record_sweep(
    folder: Path,
    *,
    speed: float = 0.5,
    reach: float = 1.3,
    times: int = 2,
    geometry: DoorGeometry | None = None,
    sensors: SensorSettings | None = None,
    spoil: Spoil = lambda _signal, _time, reading: reading,
    seed: int = 0,
) -> Path:
    """Record a sweep of the door with nobody near; without the handle."""
    return record(
        folder,
        lambda time: Scene(angle=swing(time, speed, reach, times)),
        swing_time(speed, reach, times),
        geometry=geometry,
        sensors=sensors,
        mappings=[m for m in DEFAULT_MAPPINGS[:-1] if m.signal is not Signal.HANDLE],
        spoil=spoil,
        seed=seed,
    )


def record_handle(
    folder: Path,
    force: Callable[[float], float],
    *,
    scale: float = 1.0,
    offset: float = 0.0,
    seed: int = 0,
) -> Path:
    """Record 4 s of a handle on which a force (N, of s) acts; 50 Hz, 5.9 N offset, some noise.

    What is published is such that `published * scale + offset` is the load cell's reading.
    """
    mapping = next(m for m in DEFAULT_MAPPINGS if m.signal is Signal.HANDLE)
    return record(
        folder,
        lambda time: Scene(contact=force(time)),
        4.0,
        mappings=[replace(mapping, scale=scale, offset=offset)],
        seed=seed,
    )
